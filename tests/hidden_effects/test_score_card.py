"""The score card judges what it says it judges: the size of an effect, by its own parameter."""

import math
from dataclasses import replace

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


def beside(case: Scored, job: Job | None = None, **answer) -> Scored:
    """Return a case with other parts of its answer."""
    return replace(case, answer=case.answer | answer, job=job or case.job)


def test_a_record_counts_by_its_setting() -> None:
    """Two responses a setting: setting 7 is responses 14 and 15."""
    job = Job(5, "none", "medium", 0.003, "receptance", "finite elements", fault="gain")
    case = replace(scored(5, "none", {}, outcome="none"), job=job, wrong_setting=7)
    named = beside(case, records=[{"observations": [15], "fault": "gain"}])
    other = beside(case, records=[{"observations": [13], "fault": "gain"}])
    assert (named.record_named, other.record_named, case.record_named) == (True, False, False)
    assert "| 1 of 2 (50.0 %) |" in row(card(named, other), "a wrong record, all: named")
    assert "The wrong record is not named, others are: ['gain']" in card(other)
    assert not job.healthy


@pytest.mark.parametrize(
    ("said", "counted"),
    [
        ({"place": "nut", "parameter": "nut_stiffness_n_per_m", "frequency_hz": None}, True),
        ({"place": "table", "parameter": "nut_stiffness_n_per_m", "frequency_hz": None}, False),
        ({"place": "nut", "parameter": "table_mass_kg", "frequency_hz": None}, False),
    ],
)
def test_a_stranger_is_described_at_its_place_by_its_parameter(said, counted) -> None:
    case = scored(3, "outside:nut-softening", {"outside:nut-softening": {"share": 0.3}}, outcome="described")
    assert beside(case, described=[said]).well_described is counted
    assert not case.wrong


@pytest.mark.parametrize(
    ("kind", "equivalent_to", "wrong"),
    [
        ("outside:backlash", ["amplitude-law"], False),
        ("outside:backlash", [], True),
        ("outside:preload-drift", ["amplitude-law"], True),  # which is no law of the amplitude
        ("outside:preload-drift", ["time-law"], False),
        ("outside:backlash", ["time-law"], True),
    ],
)
def test_a_law_that_is_left_open_is_right_of_one(kind, equivalent_to, wrong) -> None:
    found = {"key": "cubic-stiffness", "equivalent_to": equivalent_to, "same_as": [], "parameters": {},
             "delta_bic": 60.0}  # fmt: skip
    case = beside(scored(3, kind, {kind: {"size": 0.3}}, outcome="equivalent"), effects=[found])
    assert (case.wrong, case.leaves_it_open) == (wrong, not wrong)
    text = card(case)
    assert f"| {wrong:d} of 1 " in row(text, "outside the catalogue: a wrong name")
    assert f"| {not wrong:d} of 1 " in row(text, "outside: a name, and beside it, right")
    assert case.true_keys == set()


@pytest.mark.parametrize(("frequency", "counted"), [(308.0, True), (330.0, False), (None, False)])
def test_an_absorber_is_described_by_its_frequency_within_five_percent(frequency, counted) -> None:
    kind = "outside:wandering-absorber"
    case = scored(3, kind, {kind: {"mass_kg": 0.4, "frequency_hz": 300.0}}, outcome="described")
    said = {"place": "table", "parameter": "table_mass_kg", "frequency_hz": frequency}
    assert beside(case, described=[said]).well_described is counted


def test_a_miss_says_what_the_answer_says_of_it() -> None:
    truth = {"added-mass": {"mass_kg": 2.0}}
    case = scored(1, "added-mass", truth, outcome="unknown", limits={"added-mass": 3.0}, d_prime=20.0)
    text = card(beside(case, pulls={"position": 4.2}, contradictions=["more is left than there was"]))
    (line,) = [line for line in text.splitlines() if line.startswith("- case-0001")]
    for words in ("added-mass of 2 not found", "below the limit of 3", "Strained: position 4.2", "Contradicts itself"):
        assert words in line
    assert "| 1 of 4 " in row(text, "answers that contradict themselves")
