"""``preload explain`` on the command line: every kind of data, what it prints and writes, what it refuses."""

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor_core.effects import DRIVE_EFFECTS
from monitor_core.fitting.axis import AxisDescription
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.models.protocol import DriveConditions, DriveModel, ExcitationPoint, ResponsePoint
from monitor_core.recording import ExcitationQuantity, MotionRecord
from monitor_core.recordings.frf_set import FrequencyResponseSet, MeasuredResponse, write_frf_set
from monitor_core.recordings.model_file import read_model_file, write_model_file
from monitor_core.recordings.motion_csv import write_motion_record
from tests.conftest import PROJECT_ROOT
from tests.models.simulated_motion import Truth, simulated_record
from tests.service.test_cli import assert_refused

MODELS = PROJECT_ROOT / "replay_data" / "models"
TABLE2 = PROJECT_ROOT / "replay_data" / "published" / "nguyen_table2.csv"
TIAN = read_model_file(MODELS / "receptance.toml")
POSITIONS = (0.4, 0.775, 1.15, 1.525, 1.9)
#: Stated in the baseline, and what the far bearing of Tian's axis has beyond it.
STATED_FAR = 2.2e7
MISSING = TIAN.parameters["far_bearing_stiffness_n_per_m"] - STATED_FAR
UNCERTAIN = {"bearing_stiffness_n_per_m": 0.2, "nut_stiffness_n_per_m": 0.1}
#: The keys of the answer that scripts of others rely on.
KEYS = {"outcome", "effects", "localisation", "gap", "steps", "candidates", "next_measurement", "model"}
HANDWHEEL = """
from dataclasses import replace
from monitor_core.effects.effect import Effect, EffectParameter

def _add(axis, values):
    inertia = axis.bodies.rotor_inertia + values["inertia_kg_m2"]
    return replace(axis, bodies=replace(axis.bodies, rotor_inertia=inertia))

EFFECTS = (
    Effect(
        key="handwheel", name="Handwheel at the motor", physics="It turns with the rotor.",
        source="no source: a rigid body in rotation",
        parameters=(EffectParameter("inertia_kg_m2", "kg·m²", lower=0.0, upper=0.1, scale=1e-4),), add=_add,
    ),
)
"""


def changed(model: AxisDescription, **parameters: float) -> AxisDescription:
    return replace(model, parameters={**model.parameters, **parameters})


BASELINE = replace(changed(TIAN, far_bearing_stiffness_n_per_m=STATED_FAR), uncertain=UNCERTAIN)


def measured(
    axis: DriveModel, seed: int, band: tuple[float, float] = (60.0, 250.0), **conditions: Any
) -> list[FrequencyResponseObservation]:
    """Return hammer tests of an axis by its family's own equations, with noise and an error of the gain."""
    rng = np.random.default_rng(seed)
    frequency = np.linspace(*band, 40)
    points = ExcitationPoint.FORCE_AT_TABLE, ResponsePoint.ACCELERATION_AT_TABLE
    tests = []
    for position in POSITIONS:
        true = axis.frequency_response(
            frequency, DriveConditions(position), excitation=points[0], response=points[1]
        ).response
        deviation = np.full(frequency.size, 0.003 * np.sqrt(np.mean(np.abs(true) ** 2)))
        noise = deviation * (rng.standard_normal(frequency.size) + 1j * rng.standard_normal(frequency.size))
        response = true * (1.0 + 0.002 * rng.standard_normal()) + noise
        tests.append(
            FrequencyResponseObservation(
                DriveConditions(position, **conditions), frequency, response, deviation, *points
            )
        )
    return tests


def frf_file(path: Path, observations: list[FrequencyResponseObservation]) -> Path:
    write_frf_set(path, FrequencyResponseSet(tuple(MeasuredResponse(observation) for observation in observations)))
    return path


def model_in(path: Path, model: AxisDescription) -> Path:
    write_model_file(path, model)
    return path


@pytest.fixture(scope="module")
def responses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return frf_file(tmp_path_factory.mktemp("explain") / "axis.frf.h5", measured(TIAN.build(), 1))


@pytest.fixture(scope="module")
def baseline(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return model_in(tmp_path_factory.mktemp("explain") / "baseline.toml", BASELINE)


def value_of(document: dict[str, Any], key: str, name: str) -> dict[str, Any]:
    """Return the parameter of the one effect that was found, with nothing like it."""
    (effect,) = document["effects"]
    assert (effect["key"], effect["equivalent_to"]) == (key, [])
    parameter: dict[str, Any] = effect["parameters"][name]
    return parameter


# --- frequency responses


@pytest.mark.release
def test_named_from_responses_and_the_gap_closes_where_nothing_was_fitted(
    preload: Any, responses: Path, baseline: Path, tmp_path: Path
) -> None:
    out, report = tmp_path / "augmented.toml", tmp_path / "new" / "report"
    answer = preload("explain", responses, "--baseline", baseline, "--report", report, "--out", out, "--json")
    document = answer.json()
    assert answer.err == ""
    assert document.keys() >= KEYS
    assert document["outcome"] == "named"
    found = value_of(document, "far-bearing-stiffness", "stiffness_n_per_m")
    assert found["value"] == pytest.approx(MISSING, abs=3.0 * found["standard_uncertainty"])
    (far,) = (effect for effect in DRIVE_EFFECTS if effect.key == "far-bearing-stiffness")
    of_formula = far.form_share * found["value"]
    assert math.sqrt(found["standard_uncertainty"] ** 2 - of_formula**2) < 0.01 * MISSING
    gap = document["gap"]
    assert gap["unit"] == "sigma"
    assert gap["noise_floor"] == pytest.approx(1.0, abs=0.1)  # in standard deviations
    assert gap["before"]["held_out"] > 10.0
    # rms of 160 values about 1, a little less for the share that errors of settings take
    assert 0.6 < gap["after"]["held_out"] < 1.2
    assert document["steps"][-1]["gap_held_out"] == gap["after"]["held_out"]
    # what is written is what was said
    assert json.loads((report / "explanation.json").read_text(encoding="utf-8")) == document
    assert out.read_text(encoding="utf-8") == document["model"]
    assert (report / "model.toml").read_text(encoding="utf-8") == document["model"]
    page = (report / "explanation.html").read_text(encoding="utf-8")
    assert "axis.frf.h5 against baseline.toml" in page
    _assert_augmented_model_is_the_axis(preload, out, baseline)


def _assert_augmented_model_is_the_axis(preload: Callable[..., Any], out: Path, baseline: Path) -> None:
    assert read_model_file(out).uncertain == UNCERTAIN
    truth = [mode.frequency for mode in TIAN.build().natural_frequencies(DriveConditions(0.9)) if mode.frequency > 1.0]
    frequencies = {
        path: preload("modes", path, "--position-mm", 900, "--json").json()["positions"][0]["modes"]
        for path in (out, baseline)
    }
    # the mode that was measured, the second: missed by more than 1 % before
    assert frequencies[out][1]["frequency_hz"] == pytest.approx(truth[1], rel=5e-4)
    assert abs(frequencies[baseline][1]["frequency_hz"] / truth[1] - 1.0) > 0.01


@pytest.mark.release
def test_people_read_verdict_values_gaps_and_candidates(preload: Any, responses: Path, baseline: Path) -> None:
    answer = preload("explain", responses, "--baseline", baseline)
    assert (answer.exit_code, answer.err) == (0, "")
    verdict, *_ = answer.out.splitlines()
    assert verdict.startswith("The model lacks “Axial stiffness of the far bearing”: with it the gap falls, from ")
    assert re.search(r"σ, on data that were not fitted \(noise floor [\d.]+ σ\)\.$", verdict)
    for words in (
        "Where model and measurement differ", "  stiffness  ", "× 10⁶ N/m", "  yes",
        "1. with Axial stiffness of the far bearing: ", "held-out data", "What else was considered",
    ):  # fmt: skip
        assert words in answer.out


def test_nothing_is_named_where_nothing_is_missing(preload: Any, responses: Path, tmp_path: Path) -> None:
    sound = model_in(tmp_path / "sound.toml", replace(TIAN, uncertain=UNCERTAIN))
    answer = preload("explain", responses, "--baseline", sound, "--report", tmp_path / "report")
    document = json.loads((tmp_path / "report" / "explanation.json").read_text(encoding="utf-8"))
    assert (document["outcome"], document["effects"], document["steps"]) == ("none", [], [])
    limits = {candidate["key"]: candidate["detection_limit"] for candidate in document["candidates"]}
    # what was found above would have been seen here
    assert 0.0 < limits["far-bearing-stiffness"] < MISSING
    assert answer.out.startswith("Nothing is missing that these data would show: ")
    assert "What could still hide" in answer.out
    more = len(document["candidates"]) - 5
    assert f"{more} more: --report DIR or --json lists them." in answer.out
    assert answer.out.splitlines()[-1] == f"Written: {tmp_path / 'report' / 'explanation.html'}"


@pytest.mark.release
def test_what_is_held_out_is_what_is_asked_for(preload: Any, responses: Path, tmp_path: Path) -> None:
    """With nothing to adjust the gap at some positions is the same whether these are fitted or held out."""
    fixed = model_in(tmp_path / "fixed.toml", replace(BASELINE, uncertain={}))
    words = ("explain", responses, "--baseline", fixed, "--json", "--hold-out-mm")
    first = preload(*words, 400, 1525).json()
    some, exact = first["gap"]["before"], first["taken_as"][-1]
    assert exact.startswith("Taken as exact, since [uncertain] does not list it: ")
    assert all(name in exact for name in BASELINE.parameters)
    others = preload(*words, 775, 1150, 1900).json()["gap"]["before"]
    assert some["held_out"] == pytest.approx(others["fit"], rel=1e-6)
    assert some["fit"] == pytest.approx(others["held_out"], rel=1e-6)
    assert some["fit"] != pytest.approx(some["held_out"], rel=0.01)


@pytest.mark.release
def test_effects_of_the_baseline_stay_and_grow(preload: Any, responses: Path, tmp_path: Path) -> None:
    started = replace(BASELINE, effects={"far-bearing-stiffness": {"stiffness_n_per_m": 3e6}})
    document = preload("explain", responses, "--baseline", model_in(tmp_path / "b.toml", started), "--json").json()
    found = value_of(document, "far-bearing-stiffness", "stiffness_n_per_m")
    assert found["value"] == pytest.approx(MISSING - 3e6, abs=3.0 * found["standard_uncertainty"])
    (tmp_path / "after.toml").write_text(document["model"], encoding="utf-8")
    after = read_model_file(tmp_path / "after.toml").effects["far-bearing-stiffness"]
    assert after["stiffness_n_per_m"] == pytest.approx(3e6 + found["value"], rel=1e-6)


@pytest.mark.release
def test_effect_of_a_users_own_is_found(preload: Any, tmp_path: Path) -> None:
    own = tmp_path / "own.py"
    own.write_text(HANDWHEEL, encoding="utf-8")
    truth = changed(TIAN, motor_inertia_kg_m2=1.5e-3)  # stated: 1e-3
    data = frf_file(tmp_path / "axis.frf.h5", measured(truth.build(), 2, (10.0, 200.0)))
    stated = model_in(tmp_path / "stated.toml", replace(TIAN, uncertain=UNCERTAIN))
    document = preload("explain", data, "--baseline", stated, "--effects", own, "--json").json()
    found = value_of(document, "handwheel", "inertia_kg_m2")
    assert found["value"] == pytest.approx(5e-4, abs=3.0 * found["standard_uncertainty"])
    assert "[effects.handwheel]" in document["model"]


@pytest.mark.release
def test_one_preload_for_all_is_that_of_the_nut(preload: Any, responses: Path, baseline: Path, tmp_path: Path) -> None:
    same = frf_file(tmp_path / "same.frf.h5", measured(TIAN.build(), 1, preload=300.0))
    with_preload, without = (
        preload("explain", data, "--baseline", baseline, "--json").json() for data in (same, responses)
    )
    assert with_preload == without
    two = measured(TIAN.build(), 1, preload=300.0)[:2] + measured(TIAN.build(), 1, preload=400.0)[2:]
    answer = preload("explain", frf_file(tmp_path / "two.frf.h5", two), "--baseline", baseline)
    assert_refused(answer, "without dynamic_load_rating_n has the nut rigidity of one preload; got measurements at 300")


# --- modal tables


def modal_table(path: Path, rows: list[tuple[float, float | None, float]]) -> Path:
    """Write positions in millimetres, preloads and frequencies, each known to 0.1 %."""
    lines = [f"{x},{'' if p is None else p},{f},{0.001 * f}" for x, p, f in rows]
    path.write_text("\n".join(["position_mm,preload_n,frequency_hz,frequency_std_hz", *lines]) + "\n", encoding="utf-8")
    return path


@pytest.mark.release
@pytest.mark.parametrize(
    ("family", "preloads", "lowest"), [("lumped", (100.0, 300.0), 1.0), ("receptance", (None,), 60.0)]
)
def test_first_mode_of_a_sound_axis_lacks_nothing(
    preload: Any, tmp_path: Path, family: str, preloads: tuple[float | None, ...], lowest: float
) -> None:
    """The motor end is held as the family's paper has it: else the modes would be others."""
    path, rng = MODELS / f"{family}.toml", np.random.default_rng(3)
    axis = read_model_file(path).build()
    rows = []
    for position in (0.25, 0.5, 0.75):
        for preload_n in preloads:
            modes = axis.natural_frequencies(DriveConditions(position, preload_n))
            first = next(mode.frequency for mode in modes if mode.frequency > lowest)
            rows.append((1e3 * position, preload_n, first * (1.0 + 0.001 * rng.standard_normal())))
    document = preload("explain", modal_table(tmp_path / "table.csv", rows), "--baseline", path, "--json").json()
    assert document["effects"] == []
    assert document["gap"]["unit"] == "Hz"
    assert document["gap"]["before"]["fit"] < 2.0 * document["gap"]["noise_floor"]


@pytest.mark.release
@pytest.mark.parametrize(("family", "options"), [("lumped", ("--preload-n", 200)), ("transmission-line", ())])
def test_a_session_of_a_sound_axis_lacks_nothing(
    preload: Any, tmp_path: Path, family: str, options: tuple[Any, ...]
) -> None:
    """Short moves in Hann windows show a peak that is up to a tenth off."""
    path, session = MODELS / f"{family}.toml", tmp_path / "trial.session.h5"
    preload("simulate", path, "--out", session, *options)
    document = preload("explain", session, "--baseline", path, "--json").json()
    assert document["outcome"] == "none"
    assert document["gap"]["before"]["fit"] < 1.1 * document["gap"]["noise_floor"]
    assert document["gap"]["before"]["held_out"] is None


@pytest.mark.release
def test_what_a_session_shows_to_be_wrong_is_named(preload: Any, tmp_path: Path) -> None:
    path, session, wrong = MODELS / "lumped.toml", tmp_path / "trial.session.h5", tmp_path / "wrong.toml"
    preload("simulate", path, "--out", session, "--preload-n", 200)
    axis = read_model_file(path)
    write_model_file(wrong, changed(axis, table_mass_kg=1.05 * axis.parameters["table_mass_kg"]))
    document = preload("explain", session, "--baseline", wrong, "--json").json()
    (found,) = document["effects"]
    (ratio,) = found["parameters"].values()
    assert (document["outcome"], found["key"]) == ("named", "wrong-parameter:table_mass_kg")
    assert abs(ratio["value"] + math.log(1.05)) < 3.0 * ratio["standard_uncertainty"] < 0.006
    gap = document["gap"]
    assert gap["before"]["fit"] > 3.0 * gap["noise_floor"] > 2.7 * gap["after"]["fit"]


# --- motion


MOTION = AxisDescription(
    "motion", {"moving_mass_kg": 80.0, "viscous_friction_ns_per_m": 300.0}, {"moving_mass_kg": 0.02}
)
FRICTION = 20.0


@pytest.fixture(scope="module")
def motion() -> MotionRecord:
    return simulated_record(Truth(coulomb=FRICTION))


@pytest.mark.release
def test_friction_is_named_from_a_motion_of_force_or_of_torque(
    preload: Any, motion: MotionRecord, tmp_path: Path
) -> None:
    lead = 0.006
    torque = replace(motion, drive=motion.drive * lead / (2.0 * np.pi), quantity=ExcitationQuantity.TORQUE)
    values = []
    for record, model in ((motion, MOTION), (torque, changed(MOTION, screw_lead_m=lead))):
        data, out = tmp_path / f"{record.quantity}.csv", tmp_path / f"{record.quantity}.toml"
        write_motion_record(data, record)
        baseline = model_in(tmp_path / "motion.toml", model)
        document = preload("explain", data, "--baseline", baseline, "--out", out, "--json").json()
        found = value_of(document, "coulomb-friction", "friction_n")
        assert found["value"] == pytest.approx(FRICTION, abs=3.0 * found["standard_uncertainty"])
        gap = document["gap"]
        assert gap["unit"] == "%"
        assert gap["after"]["held_out"] < 1.2 * gap["noise_floor"] < 0.01 * gap["before"]["held_out"]
        axis = read_model_file(out).build_motion().physics
        assert axis.coulomb_friction == pytest.approx(found["value"], rel=1e-6)
        values.append(found["value"])
    assert values[0] == pytest.approx(values[1], rel=1e-6)


# --- refusals


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory, responses: Path, baseline: Path, motion: MotionRecord) -> Path:
    """Return a folder with every kind of file, good and bad."""
    folder = tmp_path_factory.mktemp("inputs")
    (folder / "axis.frf.h5").write_bytes(responses.read_bytes())
    (folder / "baseline.toml").write_bytes(baseline.read_bytes())
    write_motion_record(folder / "motion.csv", motion)
    model_in(folder / "motion.toml", MOTION)
    (folder / "other.csv").write_text("time_s,position_m\n0,0\n", encoding="utf-8")
    model_in(folder / "unknown.toml", replace(BASELINE, effects={"gremlin": {"size_m": 1.0}}))
    wrong = {"wrong-parameter:bearing_stiffness_n_per_m": {"ln_ratio": 1e3}}
    model_in(folder / "absurd.toml", replace(BASELINE, effects=wrong))
    own = folder / "own.py"
    own.write_text(HANDWHEEL, encoding="utf-8")
    for name, key in (("taken.py", "added-mass"), ("prefixed.py", "wrong-parameter:handwheel")):
        (folder / name).write_text(HANDWHEEL.replace('"handwheel"', f'"{key}"'), encoding="utf-8")
    (folder / "spaced.py").write_text(HANDWHEEL.replace("inertia_kg_m2", "inertia kg m2"), encoding="utf-8")
    (folder / "file").write_text("in the way", encoding="utf-8")
    return folder


FRF = ("axis.frf.h5", "--baseline", "baseline.toml")


def test_bad_input_is_one_line_and_nothing_is_written(
    preload: Any, inputs: Path, monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests
) -> None:
    for words, complaint in [
        (("axis.frf.h5",), "Missing option '--baseline'"),
        (("none.frf.h5", "--baseline", "baseline.toml"), "none.frf.h5: expected a file; nothing is"),
        (("axis.frf.h5", "--baseline", "none.toml"), "none.toml: expected a file; nothing is"),
        (("axis.frf.h5", "--baseline", "motion.csv"), "motion.csv: expected a drive model in TOML"),
        (
            ("baseline.toml", "--baseline", "baseline.toml"),
            "expected a session, a set of frequency responses, a motion record",
        ),
        (("other.csv", "--baseline", "baseline.toml"), "with which preload import other.csv --map other.toml"),
        (("motion.csv", "--baseline", "baseline.toml"), "expected a model of the family motion; got one of receptance"),
        (("axis.frf.h5", "--baseline", "motion.toml"), "got a motion model, which is a rigid axis"),
        (("motion.csv", "--baseline", "motion.toml", "--hold-out-mm", 10), "of a motion the second half is held out"),
        ((*FRF, "--hold-out-mm", 401), "must be a measured one, 400, 775, 1150, 1525, 1900 mm; got 401 mm"),
        ((*FRF, "--hold-out-mm", 400, 775, 1150, 1525, 1900), "must be left for the fit; got all of them"),
        ((*FRF, "--band-hz", 60, 250), "--band-hz goes with a session; got axis.frf.h5"),
        ((*FRF, "--healthy", "axis.frf.h5"), "--healthy takes machines that lack nothing; axis.frf.h5 is the one"),
        ((*FRF, "--effects", "none.py"), "none.py: expected a file; nothing is"),
        ((*FRF, "--effects", "taken.py"), "needs a key that the product does not use; got 'added-mass'"),
        ((*FRF, "--effects", "prefixed.py"), "does not use; got 'wrong-parameter:handwheel'"),
        ((*FRF, "--effects", "spaced.py"), "expected a name of letters, digits and _ . : -; got 'inertia kg m2'"),
        (("axis.frf.h5", "--baseline", "unknown.toml"), "the key of an effect must be one of "),
        (("axis.frf.h5", "--baseline", "absurd.toml"), "ln_ratio must lie within ±200; got 1000"),
        ((*FRF, "--out", "nowhere/model.toml"), "folder nowhere does not exist"),
        ((*FRF, "--report", "file"), "'--report'"),
        (("axis.frf.h5", "--baseline", str(MODELS / "lumped.toml")), "position must lie on the screw"),
    ]:
        with subtests.test(words=words, complaint=complaint):
            monkeypatch.chdir(inputs)
            there = sorted(inputs.iterdir())
            more = () if "--report" in words else ("--report", "report")
            more += () if "--out" in words else ("--out", "out.toml")
            assert_refused(preload("explain", *words, *more), complaint)
            assert sorted(inputs.iterdir()) == there


def test_help(preload: Any) -> None:
    answer = preload("explain", "--help")
    assert (answer.exit_code, answer.err) == (0, "")
    for word in ("--baseline", "--report DIR", "--hold-out-mm X…", "--effects FILE", "--out MODEL", "--band-hz"):
        assert word in answer.out


def test_a_time_limit_gives_the_best_answer_so_far_and_says_so(preload: Any) -> None:
    asked = ("explain", TABLE2, "--baseline", MODELS / "lumped.toml", "--time-limit", "0.01")
    answer = preload(*asked, "--json").json()
    assert answer["outcome"] in ("unknown", "partial")
    assert answer["unfinished"].startswith("Time was up while ")
    shown = preload(*asked).out
    assert shown.startswith("Time was up")
    assert "no fit had tried" in " ".join(shown.split())
