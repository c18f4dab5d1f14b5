"""The score card judges what it says it judges: the size of an effect, by its own parameter."""

import math

import pytest

from benchmarks.blind_cases import Job
from benchmarks.score_card import Scored, score_card


def scored(number, kind, truth, *, outcome="none", found=None, limits=None, d_prime=math.nan):
    """Return a case with its answer; found is the parameters of the true effect, value and interval of each."""
    effects = []
    if found is not None:
        effects = [{"key": kind, "equivalent_to": [], "same_as": [], "parameters": found, "delta_bic": 100.0}]
    gap = {"before": {"fit": 2.0, "held_out": 2.0}, "after": {"fit": 1.0, "held_out": 1.0}, "noise_floor": 1.0}
    candidates = {key: [limit, 0.0, None] for key, limit in (limits or {}).items()}
    answer = {"outcome": outcome, "effects": effects, "gap": gap, "candidates": candidates, "seconds": 1.0,
              "pulls": {}, "records": [], "described": [], "contradictions": []}  # fmt: skip
    return Scored(Job(number, kind, "large", 0.003, "receptance", "finite elements"), truth, answer, d_prime)


def card(*cases):
    healthy = [scored(900 + k, "none", {}) for k in range(2)]
    noisier = Scored(Job(902, "none", "medium", 0.01, "receptance", "finite elements"), {}, healthy[0].answer, math.nan)
    return score_card([*cases, *healthy, noisier], "0" * 64, 1)


def row(text, what):
    return next(line for line in text.splitlines() if line.startswith(f"| {what}"))


@pytest.mark.parametrize(("limit", "counted"), [(0.5, 1), (0.3, 0), (None, 1)])
def test_a_limit_is_held_against_the_size_of_both_components(limit, counted) -> None:
    """A periodic preload of 0.3 and 0.4 is one of 0.5; without a limit it is said that nothing moves with it."""
    truth = {"periodic-preload": {"sine_amplitude": 0.4, "cosine_amplitude": 0.29}}  # 0.494
    text = card(scored(1, "periodic-preload", truth, limits={"periodic-preload": limit}, d_prime=1.0))
    assert f"| {counted} of 1 " in row(text, "d' < 3: none, and the truth is below")


def test_parameters_that_a_family_does_not_have_are_null() -> None:
    """The lumped family's torsion has an inertia share besides; the truth of a receptance axis states none."""
    truth = {"torsional-flexibility": {"compliance_share": 0.06}}
    text = card(scored(1, "torsional-flexibility", truth, limits={"torsional-flexibility": 0.08}, d_prime=1.0))
    assert "| 1 of 1 " in row(text, "d' < 3: none, and the truth is below")


def test_the_size_is_judged_and_not_what_stands_first_in_the_file() -> None:
    truth = {"second-mode": {"damping_ratio": 0.02, "frequency_hz": 300.0, "residue_per_kg": 1e-5}}
    found = {
        "residue_per_kg": [1.05e-5, 0.85e-5, 1.25e-5],
        "frequency_hz": [310.0, 309.0, 311.0],
        "damping_ratio": [0.5, 0.4, 0.6],
    }
    text = card(scored(1, "second-mode", truth, outcome="named", found=found, d_prime=50.0))
    assert "| 1 of 1 (100.0 %) |" in row(text, "95 % intervals that cover")
    assert "| 1 of 1 (100.0 %) |" in row(text, "error of the parameter at d' ≥ 30")
    assert "| 5.0, 5.0, 5.0 % |" in row(text, "the same: median, 90 %, largest")
    assert "| 1 | 5.0 % | 10.2 % |" in row(text, "second-mode")
