"""``preload identify``: joints from a modal table, from frequency responses and from a session, on the command line."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor_core.effects import Form, Law, Variable, varying
from monitor_core.fitting.observations import ModalObservation
from monitor_core.fitting.residuals.natural_frequencies import NaturalFrequencyProblem
from monitor_core.fitting.solver.global_search import SearchSettings
from monitor_core.identification import IdentifyOptions
from monitor_core.identification.cases import FrequencyCase
from monitor_core.identification.identify_joints import question_of
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.receptance import ReceptanceParameters
from monitor_core.recordings.effect_file import effect_file_text
from monitor_core.recordings.frf_set import FrequencyResponseSet, MeasuredResponse, write_frf_set
from monitor_core.recordings.modal_csv import read_modal_table
from monitor_core.recordings.model_file import read_model_file
from tests.conftest import PROJECT_ROOT
from tests.identification import tian
from tests.identification.test_identify import finite_element_responses
from tests.models.finite_elements import Assembly
from tests.models.test_receptance import axis_of
from tests.service.test_cli import assert_refused

MODEL = PROJECT_ROOT / "replay_data" / "models" / "receptance.toml"
PEAKS = PROJECT_ROOT / "replay_data" / "published" / "tian_modal_table.csv"
STIFFNESSES = ("bearing_stiffness_n_per_m", "far_bearing_stiffness_n_per_m", "nut_stiffness_n_per_m")
JOINTS = (
    *STIFFNESSES, "coupling_stiffness_nm_per_rad", "bearing_damping_ns_per_m", "far_bearing_damping_ns_per_m",
    "nut_damping_ns_per_m", "coupling_damping_nms_per_rad",
)  # fmt: skip


def identified(*words: str | Path | float) -> dict[str, Any]:
    """Run the command in a process of its own, as a user does, and return its one document."""
    command = [sys.executable, "-m", "service.cli.main", "identify", *map(str, words), "--json"]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    assert answer.stderr == ""
    document = json.loads(answer.stdout)
    assert isinstance(document, dict)
    return document


def model_file(folder: Path, name: str, *uncertain: str, **parameters: float) -> Path:
    """Tian's model with other parameters, of which a fit may move some."""
    lines = MODEL.read_text(encoding="utf-8").splitlines()
    for key, value in parameters.items():
        lines = [f"{key} = {value}" if line.startswith(f"{key} ") else line for line in lines]
    path = folder / name
    path.write_text("\n".join([*lines, "", "[uncertain]", *(f"{key} = 0.5" for key in uncertain)]), encoding="utf-8")
    return path


def modal_table(folder: Path, *rows: str) -> Path:
    path = folder / "peaks.csv"
    path.write_text("\n".join(["position_mm,frequency_hz", *rows]) + "\n", encoding="utf-8")
    return path


# --- the published peaks


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    out = tmp_path_factory.mktemp("identified") / "axis.toml"
    words = (PEAKS, "--model", MODEL, "--hold-out-mm", 800, 1300, 1900, "--workers", 2, "--out", out)
    return identified(*words), out


def test_the_bundled_table_is_that_of_the_paper() -> None:
    rows, paper = read_modal_table(PEAKS), tian.measured(*tian.POSITIONS)
    assert [(row.position, row.frequency, row.mode) for row in rows] == [
        (observation.conditions.position, observation.frequency, observation.order) for observation in paper
    ]
    for row, observation in zip(rows, paper, strict=True):
        assert row.amplitude == (
            None if observation.amplitude is None else pytest.approx(observation.amplitude, rel=1e-12)
        )


@pytest.mark.release
def test_joints_of_the_published_axis(published: tuple[dict[str, Any], Path]) -> None:
    document, _ = published
    joints = document["parameters"]
    assert tuple(joints) == JOINTS
    assert joints["nut_stiffness_n_per_m"]["unit"] == "N/m"
    assert 6.0e8 < joints["nut_stiffness_n_per_m"]["value"] < 7.5e8
    assert document["identifiable"]["nut_stiffness_n_per_m"]
    for name in ("nut_damping_ns_per_m", *STIFFNESSES[:2]):
        assert not document["identifiable"][name]
    for name, joint in joints.items():
        low, high = joint["interval_95"]
        assert low <= joint["value"] <= high
        assert joint["verdict"] in ("determined", "poorly determined", "not determined")
        assert joint["at_limit"] == (
            f"{name} is not determined by these data: it ended at its limit" in _said(document)
        )
    (bearings,) = document["sums"]
    assert set(bearings["of"]) == set(STIFFNESSES[:2])
    assert 7.0e7 < bearings["value"] < 7.7e7
    # the sum is known far better than its parts, which add up to it
    assert bearings["value"] == pytest.approx(sum(joints[name]["value"] for name in STIFFNESSES[:2]), rel=1e-12)
    near, far = (joints[name]["standard_uncertainty"] for name in STIFFNESSES[:2])
    rho = document["correlations"]["matrix"][0][1]
    variance = near**2 + far**2 + 2.0 * rho * near * far
    assert bearings["standard_uncertainty"] == pytest.approx(variance**0.5, rel=1e-6)
    assert 3.0 * bearings["standard_uncertainty"] < min(near, far)


def _said(document: dict[str, Any]) -> list[str]:
    sentences: list[str] = document["not_identifiable"]
    return sentences


@pytest.mark.release
def test_what_the_published_peaks_leave_open_is_said(published: tuple[dict[str, Any], Path]) -> None:
    document, _ = published
    sentences = _said(document)
    assert any(sentence.startswith("nut_damping_ns_per_m is not determined by these data") for sentence in sentences)
    assert any("are not told apart: their correlation is -0.97" in sentence for sentence in sentences)
    (missing,) = document["missing_modes"]
    assert missing.startswith("mode 3 near ")
    assert missing.endswith("has no peak at 1300 mm: the table stands at its node")
    correlations = np.array(document["correlations"]["matrix"])
    assert document["correlations"]["names"] == list(JOINTS)
    np.testing.assert_allclose(correlations, correlations.T, atol=1e-12)
    np.testing.assert_allclose(np.diag(correlations), 1.0)


@pytest.mark.release
def test_published_positions_predict_the_others(published: tuple[dict[str, Any], Path]) -> None:
    document, _ = published
    held_out = document["held_out"]
    assert held_out["kind"] == "positions not used"
    assert len(held_out["errors"]) == 11
    worst, *others = sorted(held_out["errors"], key=lambda error: -abs(error["error_percent"]))
    # order 1 at 1900 mm is printed as 23 Hz
    assert (worst["position_mm"], worst["mode"], worst["measured_hz"]) == (1900.0, 1, 23.0)
    assert worst["predicted_hz"] == pytest.approx(23.64, abs=0.01)
    assert held_out["worst_percent"] == worst["error_percent"] == pytest.approx(2.77, abs=0.02)
    assert max(abs(error["error_percent"]) for error in others) <= 2.75
    for error in held_out["errors"]:
        assert error["error_percent"] == pytest.approx(100.0 * (error["predicted_hz"] / error["measured_hz"] - 1.0))


@pytest.mark.release
def test_one_position_fits_itself_and_several_predict_the_others(published: tuple[dict[str, Any], Path]) -> None:
    document, _ = published
    fits = {tuple(each["from_mm"]): each for each in document["robustness"]}
    assert list(fits) == [(600.0,), (1000.0,), (1600.0,), (600.0, 1000.0, 1600.0)]
    together = fits[600.0, 1000.0, 1600.0]
    values = {name: joint["value"] for name, joint in document["parameters"].items()}
    assert together["parameters"] == pytest.approx(values, rel=1e-12)
    worst = {
        positions: {
            place: max(abs(error["error_percent"]) for error in each["errors"] if error["position_mm"] == place)
            for place in (600.0, 800.0, 1000.0, 1300.0, 1600.0, 1900.0)
        }
        for positions, each in fits.items()
    }
    held_out = {
        positions: max(errors[place] for place in (800.0, 1300.0, 1900.0)) for positions, errors in worst.items()
    }
    assert held_out[600.0, 1000.0, 1600.0] == document["held_out"]["worst_percent"]
    for (own,), errors in ((positions, errors) for positions, errors in worst.items() if len(positions) == 1):
        assert errors[own] < worst[600.0, 1000.0, 1600.0][own]  # Tables 5 to 7: it fits itself best
        assert held_out[own,] > 1.5 * held_out[600.0, 1000.0, 1600.0]  # Tables 8 and 9: and the others worse
    # Table 5: the joints of 1600 mm alone have the bearings wrong about, and a nut a third stiffer
    alone, both = (fits[positions]["parameters"] for positions in ((1600.0,), (600.0, 1000.0, 1600.0)))
    assert alone[STIFFNESSES[0]] < 0.3 * both[STIFFNESSES[0]]
    assert alone[STIFFNESSES[1]] > 2.0 * both[STIFFNESSES[1]]
    assert 1.2 < alone["nut_stiffness_n_per_m"] / both["nut_stiffness_n_per_m"] < 1.5


@pytest.mark.release
def test_the_objective_says_what_it_rests_on(published: tuple[dict[str, Any], Path]) -> None:
    objective = published[0]["objective"]
    assert (objective["kind"], objective["positions_mm"]) == ("peaks", [600.0, 1000.0, 1600.0])
    assert objective["degrees_of_freedom"] == 12 + 12 - 8
    assert objective["residual_standard_deviation"] == pytest.approx((objective["chi_squared"] / 16) ** 0.5)
    assert (objective["starts"], objective["seed"]) == (SearchSettings().n_starts, 1)
    assert not objective["lack_of_fit"]  # no uncertainty is stated that could be exceeded
    assert objective["eq_26"] > 0.0


@pytest.mark.release
def test_order_four_at_its_most_sensitive_is_to_be_monitored(published: tuple[dict[str, Any], Path]) -> None:
    best, *others = published[0]["modes_to_monitor"]
    assert (best["mode"], best["position_mm"]) == (4, 1300.0)  # published: 2.4 times as sensitive as at 600 mm
    assert 0.03 < best["minimum_detectable_preload_loss"] < 0.06
    losses = [mode["minimum_detectable_preload_loss"] for mode in others]
    assert losses == sorted(losses, key=lambda loss: 2.0 if loss is None else loss)
    nearest = published[0]["next_positions"]
    by_nut = [position["relative_standard_uncertainties"]["nut_stiffness_n_per_m"] for position in nearest]
    assert by_nut == sorted(by_nut)
    nut = published[0]["parameters"]["nut_stiffness_n_per_m"]
    assert by_nut[0] < nut["standard_uncertainty"] / nut["value"]


@pytest.mark.release
def test_the_written_model_is_the_one_that_was_found(published: tuple[dict[str, Any], Path]) -> None:
    document, out = published
    assert out.read_text(encoding="utf-8") == document["model"]
    before, found = read_model_file(MODEL).parameters, read_model_file(out).parameters
    for name in found:
        value = document["parameters"][name]["value"] if name in JOINTS else before[name]
        assert found[name] == pytest.approx(value, rel=1e-12)
    assert set(found) == set(before)
    # what was held out is predicted by finite elements of the written model too
    axis = ReceptanceParameters.from_file_names(found, "receptance")
    assembly = Assembly(axis_of(axis, MotorEnd.FREE), 190, 70, 1.9)  # of 1 cm: off by 2e-5
    predicted = [error["predicted_hz"] for error in document["held_out"]["errors"] if error["position_mm"] == 1900.0]
    assert len(predicted) == 4
    for frequency in predicted:
        near = frequency * np.linspace(0.98, 1.02, 41)
        level = np.log(np.abs(assembly.response(2.0 * np.pi * near, assembly.table)[:, 0]))
        k = int(level.argmax())
        below, top, above = level[k - 1 : k + 2]
        peak = near[k] + 0.5 * (below - above) / (below - 2.0 * top + above) * (near[1] - near[0])
        assert peak == pytest.approx(frequency, rel=2e-4)


# --- which joints are free


@pytest.mark.release
def test_uncertain_frees_only_what_it_names(preload: Any, tmp_path: Path) -> None:
    model = model_file(tmp_path, "nut.toml", "nut_stiffness_n_per_m")
    found = preload("identify", PEAKS, "--model", model, "--hold-out-mm", 800, "--json").json()
    assert tuple(found["parameters"]) == ("nut_stiffness_n_per_m",)
    table = preload("identify", PEAKS, "--model", model, "--hold-out-mm", 800).out
    value = found["parameters"]["nut_stiffness_n_per_m"]["value"]
    alone = found["robustness"][0]["parameters"]["nut_stiffness_n_per_m"]
    for word in (
        "(peaks, 5 positions)", f"{value:.4g} N/m", "worst error, positions not used", "measure next at",
        "One position against several", "from 600, 1000, 1300, 1600, 1900 mm", "worst error at 800 mm", f"{alone:.4g}",
    ):  # fmt: skip
        assert word in table
    # a prior that is sure of a value holds the joint there
    text = model.read_text(encoding="utf-8")
    sure = tmp_path / "sure.toml"
    sure.write_text(text.replace("nut_stiffness_n_per_m = 0.5", "nut_stiffness_n_per_m = 1e-4"), encoding="utf-8")
    held = preload("identify", PEAKS, "--model", sure, "--hold-out-mm", 800, "--json").json()
    assert held["parameters"]["nut_stiffness_n_per_m"]["value"] == pytest.approx(7.09e8, rel=1e-3)
    assert abs(value / 7.09e8 - 1.0) > 5e-3


@pytest.mark.release
def test_limits_hold(preload: Any, tmp_path: Path) -> None:
    model = model_file(tmp_path, "two.toml", "nut_stiffness_n_per_m", "bearing_stiffness_n_per_m")
    words = ("identify", PEAKS, "--model", model, "--hold-out-mm", 800, "--limit", "nut_stiffness_n_per_m", 1e9, 3e9)
    found = preload(*words, "--json").json()
    nut = found["parameters"]["nut_stiffness_n_per_m"]
    assert nut["value"] == pytest.approx(1e9, rel=1e-9)
    assert nut["at_limit"]


# --- responses and sessions


@pytest.fixture(scope="module")
def responses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a hammer test of Tian's axis in finite elements, with noise of 5 %."""
    path = tmp_path_factory.mktemp("responses") / "axis.frf.h5"
    measured = finite_element_responses(tian.axis(), (0.6, 1.0, 1.6), np.random.default_rng(6))
    write_frf_set(path, FrequencyResponseSet(tuple(MeasuredResponse(observation) for observation in measured)))
    return path


@pytest.mark.release
def test_responses_give_the_axis_back(preload: Any, responses: Path) -> None:
    document = preload("identify", responses, "--model", MODEL, "--json").json()
    truth = read_model_file(MODEL).parameters
    joints = document["parameters"]
    assert joints["nut_stiffness_n_per_m"]["value"] == pytest.approx(truth["nut_stiffness_n_per_m"], rel=0.005)
    for name, joint in joints.items():
        if "stiffness" in name:
            low, high = joint["interval_95"]
            assert abs(joint["value"] - truth[name]) < 0.75 * (high - low)  # three standard uncertainties
    objective = document["objective"]
    assert objective["kind"] == "whole responses"
    assert not objective["lack_of_fit"]
    # 1020 residuals less 8: the standard deviation of their rms is 0.022
    assert objective["residual_standard_deviation"] == pytest.approx(1.0, abs=0.07)
    assert "eq_26" not in objective
    assert document["held_out"]["kind"] == "leave one position out"
    assert [error["position_mm"] for error in document["held_out"]["errors"]] == [600.0, 1000.0, 1600.0]
    assert document["missing_modes"] == []


@pytest.mark.release
def test_a_table_of_wrong_mass_is_called_a_lack_of_fit(preload: Any, responses: Path, tmp_path: Path) -> None:
    heavy = model_file(tmp_path, "heavy.toml", "nut_stiffness_n_per_m", table_mass_kg=1.05 * 272)
    words = ("identify", responses, "--model", heavy, "--hold-out-mm", 1000)
    document = preload(*words, "--json").json()
    objective = document["objective"]
    assert objective["lack_of_fit"]
    assert objective["residual_standard_deviation"] > 1.2
    # 5 % of mass moves the nut by many times what the scatter of the residuals says: an interval of that would lie
    (nut,) = document["parameters"].values()
    assert (nut["interval_95"], nut["standard_uncertainty"], document["sums"]) == (None, None, [])
    assert nut["verdict"] != "determined"
    assert any("so that none is stated, and no calibration is predicted" in sentence for sentence in _said(document))
    assert "none: lack of fit" in preload(*words).out


@pytest.mark.release
def test_a_simulated_session_gives_its_stiffnesses_back(preload: Any, tmp_path: Path) -> None:
    session = tmp_path / "axis.session.h5"
    words = ("simulate", MODEL, "--out", session, "--position-mm", 600, 1000, 1600, "--windows", 10)
    assert preload(*words).exit_code == 0
    model = model_file(tmp_path, "stiff.toml", *STIFFNESSES, nut_stiffness_n_per_m=5e8, bearing_stiffness_n_per_m=6e7)
    # the mean of ten windows at 600 mm is not 600 mm to the last bit, and could not be held out once
    words = ("identify", session, "--model", model, "--band-hz", 60, 250, "--hold-out-mm", 600, "--json")
    document = preload(*words).json()
    truth = read_model_file(MODEL).parameters
    for name in STIFFNESSES:
        # 2 %: guide friction, which the record has and the model has not, raises the frequency by so much at most
        assert document["parameters"][name]["value"] == pytest.approx(truth[name], rel=0.02)
    assert document["objective"]["positions_mm"] == [1000.0, 1600.0]
    assert document["objective"]["lack_of_fit"]  # which is why


# --- refusals


def test_bad_input_is_one_line_and_nothing_is_written(preload: Any, tmp_path: Path, subtests: pytest.Subtests) -> None:
    for words, complaint in [
        ((PEAKS, "--model", MODEL, "--hold-out-mm", 700), "600, 800, 1000, 1300, 1600, 1900 mm; got 700 mm"),
        (
            (PEAKS, "--model", MODEL, "--hold-out-mm", 600, 800, 1000, 1300, 1600),
            "joints must be identified from peaks at 2 positions at least; got 1",
        ),
        ((PEAKS, "--model", MODEL, "--limit", "spring_stiffness", 1, 2), "a limit must be of a free joint, bearing_"),
        ((PEAKS, "--model", MODEL, "--limit", "table_mass_kg", 1, 2), "got table_mass_kg"),
        (
            (PEAKS, "--model", MODEL, "--limit", STIFFNESSES[2], 3e9, 1e8),
            "limits of nut_stiffness_n_per_m must be positive, finite and rising; got 3e+09 and 1e+08",
        ),
        ((PEAKS, "--model", MODEL, "--limit", STIFFNESSES[2], 0, 1e8), "finite and rising; got 0 and 1e+08"),
        ((PEAKS, "--model", MODEL, "--limit", STIFFNESSES[2], 1e8, "inf"), "finite and rising; got 1e+08 and inf"),
        ((PEAKS, "--model", MODEL, "--limit", STIFFNESSES[2], 1e8), "--limit"),
        ((PEAKS, "--model", MODEL.parent / "lumped.toml"), "state the preload"),
        ((PEAKS, "--model", MODEL.parent / "hybrid.toml"), "the peak at 24 Hz at 600 mm is nearest to"),
        ((PEAKS, "--model", "none.toml"), "none.toml: expected a file; nothing is"),
        ((PEAKS, "--model", PEAKS), "tian_modal_table.csv: expected a drive model in TOML"),
        ((PEAKS,), "--model"),
        (("none.csv", "--model", MODEL), "none.csv: expected a file; nothing is"),
        (("none.frf.h5", "--model", MODEL), "none.frf.h5"),
        ((MODEL, "--model", MODEL), "receptance.toml"),
        ((PEAKS, "--model", MODEL, "--objective", "eq-27"), "eq-27"),
        ((PEAKS, "--model", MODEL, "--seed", -1), "--seed"),
        ((PEAKS, "--model", MODEL, "--workers", 0), "--workers"),
        ((PEAKS, "--model", MODEL, "--band-hz", 60, 250), "--band-hz goes with a session; got tian_modal_table.csv"),
        ((PEAKS, "--model", MODEL.parent / "lumped.toml", "--objective", "eq-26"), "got a lumped model"),
        ((PEAKS, "--model", MODEL, "--calibration", "a.json"), "--calibration and --prediction go together"),
        ((PEAKS, "--model", MODEL, "--prediction", "mode_hz = [1"), "expected a table such as"),
        ((PEAKS, "--model", MODEL, "--prediction", "mode_hz = [1, 2]"), "preload_n: Field required"),
        ((PEAKS, "--model", MODEL, "--prediction", "mode_hz = 2020-01-01"), "mode_hz: "),
    ]:
        with subtests.test(words=words, complaint=complaint):
            out = tmp_path / "found.toml"
            assert_refused(preload("identify", *words, "--out", out), complaint)
            assert not out.exists()


@pytest.mark.parametrize(
    ("rows", "complaint"),
    [
        (("600,24", "600,118", "600,523"), "peaks at 2 positions at least; got 1"),
        (("600,24", "800,118", "800,250"), "the peak at 250 Hz at 800 mm is nearest to one at"),
        (("600,118", "600,119", "800,118"), "both belong to mode 2"),
        (("600,118", "800,118"), "8"),  # joints are more than data
        (("2700,118", "800,118"), "position must lie on the screw"),
    ],
)
def test_bad_table_is_one_line(preload: Any, tmp_path: Path, rows: tuple[str, ...], complaint: str) -> None:
    assert_refused(preload("identify", modal_table(tmp_path, *rows), "--model", MODEL), complaint)


def test_joints_that_all_end_at_a_limit_are_refused(preload: Any, tmp_path: Path) -> None:
    model, out = model_file(tmp_path, "nut.toml", "nut_stiffness_n_per_m"), tmp_path / "found.toml"
    words = ("identify", PEAKS, "--model", model, "--hold-out-mm", 800, "--out", out)
    answer = preload(*words, "--limit", "nut_stiffness_n_per_m", 1.2e9, 1.3e9)
    assert_refused(answer, "at least one of nut_stiffness_n_per_m must lie within its limits")
    assert not out.exists()


OWN_EFFECT = "\n[effects.bearing-along]\nchange = -0.5\n"
ADDED_MASS = "\n[effects.added-mass]\nmass_kg = 3\n"


@pytest.fixture
def own_effects(tmp_path: Path) -> Path:
    """Return a bearing that is half as stiff at 500 mm as at 100 mm, as a law in a file of a user."""
    law = Law(Variable.POSITION, Form.LINEAR, 0.1, 0.4)
    own = tmp_path / "mine.py"
    own.write_text(effect_file_text([varying("joints", "bearing_stiffness", law, key="bearing-along")]), "utf-8")
    return own


@pytest.mark.release
def test_joints_are_identified_beside_the_effects_of_a_model(preload: Any, tmp_path: Path, own_effects: Path) -> None:
    """The modes of a machine with an effect give its nut back to a model that states the effect, and to no other."""
    text, effect = (MODEL.parent / "hybrid.toml").read_text(encoding="utf-8"), OWN_EFFECT
    stated = read_model_file(MODEL.parent / "hybrid.toml").parameters["nut_stiffness_n_per_m"]
    machine, model, out = (tmp_path / name for name in ("machine.toml", "model.toml", "out.toml"))
    machine.write_text(text + effect, encoding="utf-8")
    at = ("--position-mm", 100, 500, "--motor-end", "free", "--effects", own_effects, "--json")
    rows = [
        f"{place['position_mm']},{mode['frequency_hz']}"
        for place in preload("modes", machine, *at).json()["positions"]
        for mode in place["modes"][:1]
    ]
    lines = [line for line in text.splitlines() if not line.startswith("nut_stiffness")]
    section = lines.index("[parameters]") + 1
    lines.insert(section, f"nut_stiffness_n_per_m = {0.6 * stated!r}")
    uncertain = "\n[uncertain]\nnut_stiffness_n_per_m = 0.9\n"
    words = ("identify", modal_table(tmp_path, *rows), "--model", model, "--effects", own_effects)
    model.write_text("\n".join(lines) + effect + uncertain, encoding="utf-8")
    found = preload(*words, "--out", out, "--json").json()["parameters"]["nut_stiffness_n_per_m"]
    assert found["value"] == pytest.approx(stated, rel=2e-3)
    assert read_model_file(out).effects == read_model_file(machine).effects
    model.write_text("\n".join(lines) + uncertain, encoding="utf-8")
    without = preload(*words, "--json").json()["parameters"]["nut_stiffness_n_per_m"]
    assert abs(without["value"] / stated - 1.0) > 0.02


@pytest.mark.parametrize("family", ["lumped", "hybrid", "receptance", "transmission-line"])
def test_the_model_of_a_fit_has_the_effects_of_its_file(family: str) -> None:
    """At the values as stated it has the modes of the model that the file builds, and other ones than without."""
    file = replace(read_model_file(MODEL.parent / f"{family}.toml"), effects={"added-mass": {"mass_kg": 3.0}})
    where = [DriveConditions(x, 200.0 if family == "lumped" else None) for x in (0.2, 0.3, 0.4)]
    model = file.build()
    measured = [
        ModalObservation(at, next(mode.frequency for mode in model.natural_frequencies(at) if mode.frequency > 0.0))
        for at in where
    ]
    question = question_of(file, measured, IdentifyOptions())
    assert isinstance(question.case, FrequencyCase)
    drive, peaks = question.case.drive, [each.frequency for each in measured]
    predicted = NaturalFrequencyProblem(drive, question.case.peaks).predict(drive.start)
    assert predicted == pytest.approx(peaks, rel=1e-9)
    plain = NaturalFrequencyProblem(replace(drive, effects={}), question.case.peaks).predict(drive.start)
    assert np.all(plain > (1.0 + 1e-4) * predicted)


def test_an_effect_that_nobody_defines_is_refused_before_the_search(preload: Any, tmp_path: Path) -> None:
    model = tmp_path / "effect.toml"
    model.write_text(MODEL.read_text(encoding="utf-8") + OWN_EFFECT, encoding="utf-8")
    assert_refused(preload("identify", PEAKS, "--model", model), "got 'bearing-along'")
    missing = ("--effects", tmp_path / "none.py")
    assert_refused(preload("identify", PEAKS, "--model", model, *missing), "none.py: expected a file; nothing is")


def test_the_papers_objective_is_of_a_model_without_effects(preload: Any, tmp_path: Path) -> None:
    model = tmp_path / "effect.toml"
    model.write_text(MODEL.read_text(encoding="utf-8") + ADDED_MASS, encoding="utf-8")
    answer = preload("identify", PEAKS, "--model", model, "--objective", "eq-26")
    assert_refused(answer, "Eq. (26) compares peaks with a model of the receptance family; got one with the effect")


@pytest.mark.release
def test_one_preload_for_all_is_that_of_the_nut(preload: Any, tmp_path: Path) -> None:
    model = model_file(tmp_path, "nut.toml", "nut_stiffness_n_per_m")
    rows = [line.split(",") for line in PEAKS.read_text(encoding="utf-8").split()[1:]]
    tables = {}
    for name, preloads in (("one.csv", ("300",)), ("two.csv", ("300", "400")), ("none.csv", ("",))):
        lines = [f"{row[0]},{row[1]},{preloads[k % len(preloads)]}" for k, row in enumerate(rows)]
        tables[name] = tmp_path / name
        tables[name].write_text("\n".join(["position_mm,frequency_hz,preload_n", *lines]) + "\n", encoding="utf-8")
    words = ("--model", model, "--hold-out-mm", 800)
    rated, none = (preload("identify", tables[name], *words, "--json").json() for name in ("one.csv", "none.csv"))
    assert rated["parameters"] == none["parameters"]
    assert_refused(preload("identify", tables["two.csv"], *words), "state the rating")


def test_help(preload: Any) -> None:
    answer = preload("identify", "--help")
    assert (answer.exit_code, answer.err) == (0, "")
    for word in ("--hold-out-mm X…", "--limit NAME LOW HIGH", "--objective [weighted|eq-26]", "--workers"):
        assert word in answer.out
