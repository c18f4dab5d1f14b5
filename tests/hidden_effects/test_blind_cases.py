"""What the blind benchmark draws, its d', and that it goes on where it stopped."""

import itertools
import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.blind_cases import IN_STEPS, NOT_LINEAR, ON_LINES, Job, composition, drawn
from benchmarks.detectability import detectability, detectability_of_record
from benchmarks.hidden_effects import chosen, seed_of
from monitor_core.fitting.residuals.model_form import ModelFormError
from tests.conftest import canary
from tests.hidden_effects.cases import draw_case
from tests.hidden_effects.machines import BENCH, GANTRY, MACHINES
from tests.hidden_effects.situations import SCATTERS, Situation, WrongRecord, wrongly_set
from tests.hidden_effects.truth import transmission_line
from tests.hidden_effects.truth.measurement import Recorder, Scatter, measure, random_torque, set_truly

FORM = ModelFormError()


def test_the_draw_is_as_large_as_is_asked_and_spread_over_machines_and_designs() -> None:
    jobs = composition(4)
    assert len(jobs) >= 400
    assert sum(job.healthy for job in jobs) >= 100
    assert sum(job.outside for job in jobs) >= 60
    assert {job.machine for job in jobs} == {machine.name for machine in MACHINES}
    machines = Counter(job.machine for job in jobs if job.family == "receptance")
    assert max(machines.values()) - min(machines.values()) <= 1
    assert {job.design for job in jobs} == {"rich", "usual", "poor"}
    assert {job.scatter for job in jobs} == set(SCATTERS)
    assert jobs == composition(4)
    assert [job.machine for job in jobs] != [job.machine for job in composition(5)]


def test_each_plant_is_asked_for_what_it_has() -> None:
    for job in composition(6):
        parts = set(job.kind.split("+"))
        assert not (parts & set(ON_LINES) and job.plant == "finite elements")
        assert not (parts & set(IN_STEPS) and job.plant != "finite elements")
        assert not (parts & set(NOT_LINEAR) and job.disturbance == "loop")


def test_a_run_keeps_its_seed_and_a_fresh_one_draws_one(tmp_path) -> None:
    assert seed_of(tmp_path, None) == seed_of(tmp_path, None)
    with pytest.raises(SystemExit, match="holds a run of seed"):
        seed_of(tmp_path, -1)
    (tmp_path / "other").mkdir()
    assert seed_of(tmp_path / "other", 12) == 12
    assert 0 < len(chosen(0.1, 12)) < len(chosen(0.5, 12)) < len(composition(12))


@pytest.mark.parametrize("law", ["normal", "uniform", "heavy"])
def test_errors_of_settings_are_as_large_as_is_said(law) -> None:
    rng = np.random.default_rng(2)
    stated = Situation().settings(rng) * 400
    scatter = Scatter(position=1e-3, preload=0.02, law=law)
    true = set_truly(stated, scatter, rng)
    moved = [was.position - said.position for was, said in zip(true, stated, strict=True)]
    assert np.std(moved) == pytest.approx(1e-3, rel=0.1)
    largest = np.max(np.abs(moved)) / 1e-3
    assert {"uniform": largest < 1.74, "normal": 3.0 < largest < 6.0, "heavy": largest > 6.0}[law]


def test_a_wrong_tag_is_of_one_setting_that_has_what_it_tags() -> None:
    rng = np.random.default_rng(3)
    stated = Situation().settings(rng)
    for fault, name in (("position-tag", "position"), ("preload-tag", "preload"), ("payload-tag", "payload"),
                        ("temperature-tag", "temperature_deviation")):  # fmt: skip
        true, which = wrongly_set(WrongRecord(fault, 1), stated, stated, BENCH.parts.screw_length, rng)
        assert [k for k, pair in enumerate(zip(true, stated, strict=True)) if pair[0] != pair[1]] == [which]
        assert getattr(true[which], name) != getattr(stated[which], name)
        assert 0.0 < true[which].position < BENCH.parts.screw_length


def test_a_loop_clipping_and_hum_do_what_they_say() -> None:
    """Without noise a loop changes no H1; clipping at 2.5 σ takes erf(2.5/√2) of a Gaussian; hum is at 50 Hz."""
    case = draw_case("none", seed=3, respond=transmission_line.respond, situation=Situation(design="poor"))
    settings = case.settings[:2]

    def seen(noise: float, **changes: float) -> np.ndarray:
        recorder, scatter = replace(Recorder(), **changes), Scatter(sensor_noise=noise, gain=0.0)
        rng = np.random.default_rng(5)
        frfs = measure(case.axis, settings, settings, scatter, rng, respond=transmission_line.respond,
                       recorder=recorder)  # fmt: skip
        return np.array([frf.response for frf in frfs])

    plain = seen(0.0)
    assert np.median(np.abs(seen(0.0, loop=50.0) / plain - 1.0)) < 3e-3
    clipped = np.median(np.abs(seen(0.0, clipped_at=2.5)[::2] / plain[::2]))
    assert clipped == pytest.approx(math.erf(2.5 / math.sqrt(2.0)), abs=3e-3)
    hummed = np.abs(np.log(np.abs(seen(0.0, hum=0.1) / plain)))
    near = np.abs(case.measured[0].frequency - 50.0) < 2.0
    assert np.max(hummed[:, near]) > 10.0 * np.median(hummed[:, case.measured[0].frequency > 200.0])


def test_pink_noise_is_larger_at_low_frequency_and_of_the_same_rms() -> None:
    rng, scatter = np.random.default_rng(1), Scatter(sensor_noise=0.05, gain=0.0)
    setting = Situation().settings(rng)[0]

    def silent(_axis, _settings, torque, _rate):
        return torque, np.zeros_like(torque) + torque

    deviation = {}
    for pink in (False, True):
        frfs = measure(None, [setting], [setting], scatter, rng, respond=silent, recorder=Recorder(pink=pink))
        deviation[pink] = frfs[0].standard_deviation
    assert np.mean(deviation[True][:10]) > 2.0 * np.mean(deviation[False][:10])
    assert np.mean(deviation[True][-10:]) < np.mean(deviation[False][-10:])
    torque = random_torque(np.array([1.0]), rng, GANTRY.recorder)
    assert np.std(torque) == pytest.approx(1.0, rel=0.03)


def one_effect(size: float, **changes):
    """Return a case of a mass on the table of the poor design, and its d'."""
    case = draw_case("added-mass", "large", seed=8, respond=transmission_line.respond,
                     situation=Situation(design="poor"))  # fmt: skip
    hidden = replace(case.axis.hidden, added_mass=size)
    case = replace(case, axis=replace(case.axis, hidden=hidden), **changes)
    return case, detectability(case, BENCH.recorder, FORM)


@pytest.mark.release
def test_d_prime_of_what_a_tolerance_takes_up_is_how_many_tolerances_that_is() -> None:
    """A mass on the table is a table that is heavier: at most (size/tolerance), whatever the noise."""
    case, of_two = one_effect(0.01 * Situation().machine.parts.table_mass)
    assert 1.0 < of_two <= 2.02
    noisier = tuple(replace(frf, standard_deviation=5.0 * frf.standard_deviation) for frf in case.measured)
    assert detectability(replace(case, measured=noisier), BENCH.recorder, FORM) < of_two
    _, of_ten = one_effect(0.05 * Situation().machine.parts.table_mass)
    assert 4.0 * of_two < of_ten <= 10.1


@pytest.mark.release
def test_what_is_alike_in_all_settings_is_not_seen_better_in_more_of_them() -> None:
    """A delay turns every response alike, and so may the form of a model, whose error all settings share."""
    found = {}
    for design in ("poor", "rich"):
        case = draw_case("angle-delay", "large", seed=8, respond=transmission_line.respond,
                         situation=Situation(design=design))  # fmt: skip
        exact = tuple(replace(frf, standard_deviation=1e-6 * np.abs(frf.response)) for frf in case.measured)
        found[len(case.settings)] = detectability(replace(case, measured=exact), BENCH.recorder, FORM)
    (few, of_few), (many, of_many) = sorted(found.items())
    assert many > 2 * few
    assert of_many == pytest.approx(of_few, rel=0.15)


@pytest.mark.release
def test_the_scatter_of_a_torque_is_no_trace_of_what_depends_on_it(monkeypatch) -> None:
    """What a stronger torque makes of a spring that hardens little is mostly noise, which no other torque repeats."""
    case = draw_case("cubic-stiffness", "small", seed=8, respond=transmission_line.respond,
                     situation=Situation(design="usual"))  # fmt: skip
    of_two = detectability(case, BENCH.recorder, FORM)
    monkeypatch.setattr("benchmarks.detectability._TORQUES", (0,))
    assert of_two < 0.5 * detectability(case, BENCH.recorder, FORM)


@pytest.mark.release
def test_d_prime_of_twins_is_nothing() -> None:
    """A series compliance beside a bracket that is wrong, free to be anything: the data cannot tell the two."""
    case = draw_case("series-compliance", "large", seed=8, respond=transmission_line.respond,
                     situation=Situation(design="poor"))  # fmt: skip
    alone = detectability(case, BENCH.recorder, FORM)
    beside = replace(case, truth={**case.truth, "wrong-parameter:bracket_stiffness_n_per_m": {"ln_ratio": 1e-3}})
    assert alone > 3.0
    assert detectability(beside, BENCH.recorder, FORM) < 0.1


def test_a_job_is_drawn_as_it_says() -> None:
    job = Job(
        1, "none", "medium", 0.01, "receptance", "transmission line", "gantry", "poor", "larger", "hum", "gain", 2
    )
    case = drawn(job, 100)
    assert len(case.settings) == 12
    assert case.wrong_setting is not None
    assert case.measured[0].resolution == GANTRY.recorder.sample_rate / 4096.0
    assert not job.healthy


def test_d_prime_of_a_wrong_part_is_at_most_how_many_tolerances_it_is_off() -> None:
    key = "wrong-parameter:bearing_stiffness_n_per_m"
    case = draw_case(key, "large", seed=8, respond=transmission_line.respond, situation=Situation(design="poor"))
    off = abs(case.truth[key]["ln_ratio"]) / 0.2
    assert 3.0 < detectability(case, BENCH.recorder, FORM) <= 1.001 * off


def one_record(fault: str, size: int, kind: str = "none"):
    """Return the d' of a record that is wrong, and how many tolerances its gain or preload is off."""
    situation = Situation(design="usual", wrong=WrongRecord(fault, size))
    case = draw_case(kind, "large", seed=8, respond=transmission_line.respond, situation=situation)
    true, said = case.settings[case.wrong_setting], case.measured[2 * case.wrong_setting].stated
    off = math.log(true.preload / said.preload) / 0.03 if fault == "preload-tag" else {0: 0.04, 2: 0.3}[size] / 0.005
    return detectability_of_record(case, BENCH.recorder, FORM), abs(off)


@pytest.mark.release
@pytest.mark.parametrize(("size", "kind"), canary(itertools.product([0, 2], ["none", "far-bearing-stiffness"])))
def test_d_prime_of_a_gain_is_how_many_tolerances_it_is_off(size, kind) -> None:
    """Nothing but the gain of its record does what a gain does, beside an effect or not."""
    found, off = one_record("gain", size, kind)
    assert 0.95 * off < found <= off


@pytest.mark.release
def test_d_prime_of_a_tag_is_at_most_how_many_tolerances_it_is_off_and_less_where_that_hardly_matters() -> None:
    for size in (0, 2):
        found, off = one_record("preload-tag", size)
        assert found <= 1.1 * off  # and its position errs, too
    near, _ = one_record("position-tag", 0)
    far, _ = one_record("position-tag", 2)
    assert near < 0.2 * far


def test_no_wrong_record_has_no_d_prime() -> None:
    case = draw_case("none", "medium", seed=8, respond=transmission_line.respond, situation=Situation(design="poor"))
    assert math.isnan(detectability_of_record(case, BENCH.recorder, FORM))
