"""Where the accelerometer of a session sits: found from the session, stated, and what that does to what is found."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor_core.discrepancy import ExplainOptions, Outcome, explain
from monitor_core.fitting.accelerometer import PLACES, place_accelerometer
from monitor_core.fitting.axis import AxisDescription
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, ResponsePoint
from monitor_core.recordings.model_file import read_model_file, write_model_file
from monitor_core.recordings.session_hdf5 import read_session, write_session
from tests.conftest import PROJECT_ROOT
from tests.service.conftest import Api, assert_problem
from tests.service.test_cli import assert_refused
from tests.service.test_jobs import wait_for

REPLAY = PROJECT_ROOT / "replay_data"
MACHINE = read_model_file(REPLAY / "models" / "replay-axis.toml")
NUT = "nut_stiffness_n_per_m"


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return what the bundled calibration has of one preload: from a plant whose accelerometer is on the nut."""
    whole = read_session(REPLAY / "calibration.session.h5")
    kept = [
        window
        for window in whole.windows
        if (window.conditions.preload, window.conditions.temperature) == (200.0, 22.0)
    ]
    path = tmp_path_factory.mktemp("accelerometer") / "nut.session.h5"
    write_session(path, replace(whole, windows=tuple(window for window in kept if not window.conditions.payload_mass)))
    return path


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the machine with a nut that is said to be a fifth too soft, and nothing else uncertain."""
    path = tmp_path_factory.mktemp("accelerometer") / "machine.toml"
    parameters = {**MACHINE.parameters, NUT: 0.8 * MACHINE.parameters[NUT]}
    write_model_file(path, replace(MACHINE, parameters=parameters, uncertain={NUT: 0.3}))
    return path


@pytest.mark.release
def test_a_session_of_the_nut_is_explained_as_one(preload: Any, session: Path) -> None:
    words = ("explain", session, "--baseline", REPLAY / "models" / "replay-axis.toml", "--json")
    document = preload(*words).json()
    sentence, exact = document["taken_as"]  # of one temperature
    assert exact.startswith("Taken as exact, since [uncertain] does not list it: nut_mass_kg")
    assert sentence.startswith("The accelerometer is taken to be on the nut, where the model leaves 1.")
    assert "σ on the table); state it if it is elsewhere." in sentence
    # the plant's friction, which no window of a session can vary, is what is left
    assert document["gap"]["before"]["fit"] < 1.5 * document["gap"]["noise_floor"]
    assert all(channel.startswith("acceleration-at-nut") for channel in document["gap_by_channel"])


@pytest.mark.release
def test_joints_are_those_of_the_plant(preload: Any, session: Path, machine: Path) -> None:
    document = preload("identify", session, "--model", machine, "--json").json()
    assert "taken to be on the nut" in document["taken_as"][0]
    # friction, which the plant has and no model, raises the frequency by 0.3 Hz of 190 (replay_data/README.md): 0.3 %
    # of the stiffness, which is 4 % of a nut that makes a thirteenth of the compliance
    assert document["parameters"][NUT]["value"] == pytest.approx(MACHINE.parameters[NUT], rel=0.05)


@pytest.mark.release
def test_stated_place_is_kept_though_the_other_fits_better(preload: Any, session: Path, machine: Path) -> None:
    words = ("identify", session, "--model", machine, "--accelerometer", "table", "--json")
    document = preload(*words).json()
    (sentence,) = document["taken_as"]
    assert sentence.startswith("The accelerometer is on the table, as stated, where the model leaves ")
    assert " σ; on the nut it would leave 1." in sentence
    assert abs(document["parameters"][NUT]["value"] / MACHINE.parameters[NUT] - 1.0) > 0.1


@pytest.mark.release
def test_a_simulated_session_is_of_the_table(preload: Any, tmp_path: Path) -> None:
    model, path = REPLAY / "models" / "lumped.toml", tmp_path / "trial.session.h5"
    preload("simulate", model, "--out", path, "--preload-n", 200)
    answer = preload("explain", path, "--baseline", model)
    assert "\nThe accelerometer is taken to be on the table, where the model leaves 0." in answer.out


def responses_at(point: ResponsePoint, model: AxisDescription) -> list[FrequencyResponseObservation]:
    """Return responses of a family's own equations, with noise."""
    frequency, rng = np.linspace(20.0, 400.0, 80), np.random.default_rng(4)
    made = []
    for position in (0.2, 0.5, 0.8):
        conditions = DriveConditions(position, 200.0)
        at = ExcitationPoint.TORQUE_AT_SCREW, point
        exact = model.build().frequency_response(frequency, conditions, excitation=at[0], response=at[1]).response
        deviation = 0.003 * np.abs(exact)
        noisy = exact + deviation * (rng.standard_normal(80) + 1j * rng.standard_normal(80))
        unplaced = ResponsePoint.ACCELERATION_AT_TABLE
        made.append(
            FrequencyResponseObservation(conditions, frequency, noisy, deviation, at[0], unplaced, placed=False)
        )
    return made


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(("name", "error"), [("bracket_stiffness_n_per_m", 0.7), ("table_mass_kg", 1.2), (NUT, 0.5)])
def test_place_is_found_though_the_description_is_wrong(place: str, name: str, error: float) -> None:
    """What is missing or misprinted must not be taken for another place."""
    observed = responses_at(PLACES[place], MACHINE)
    wrong = replace(MACHINE, parameters={**MACHINE.parameters, name: error * MACHINE.parameters[name]}, uncertain={})
    placed = place_accelerometer(observed, None, wrong.drive())
    assert {observation.response_point for observation in placed.observations} == {PLACES[place]}
    assert f"on the {place}, where" in placed.sentences[0]


def test_without_a_bracket_there_is_nothing_to_settle() -> None:
    rigid = {
        name: value for name, value in MACHINE.parameters.items() if "bracket" not in name and "nut_mass" not in name
    }
    model = replace(MACHINE, parameters=rigid, uncertain={})
    observed = responses_at(ResponsePoint.ACCELERATION_AT_NUT, model)
    placed = place_accelerometer(observed, None, model.drive())
    assert placed.sentences == ()
    assert {observation.response_point for observation in placed.observations} == {ResponsePoint.ACCELERATION_AT_TABLE}
    (sentence,) = place_accelerometer(observed, "nut", model.drive()).sentences
    assert sentence == (
        "The accelerometer is on the nut, as stated; to this model, without a bracket between nut and table, that "
        "makes no difference."
    )


def test_a_bracket_too_stiff_to_show_leaves_the_place_open() -> None:
    stiff = replace(MACHINE, parameters={**MACHINE.parameters, "bracket_stiffness_n_per_m": 1e12}, uncertain={})
    placed = place_accelerometer(responses_at(PLACES["nut"], stiff), None, stiff.drive())
    assert placed.sentences == (
        "The session does not tell whether the accelerometer is on the nut; it is taken to be on the table.",
    )


@pytest.mark.parametrize("place", PLACES)
def test_what_says_where_it_was_taken_stays_there(place: str) -> None:
    placed = [
        replace(observation, response_point=PLACES[place], placed=True)
        for observation in responses_at(PLACES["nut"], MACHINE)
    ]
    for stated in (None, "table", "nut"):
        found = place_accelerometer(placed, stated, MACHINE.drive())
        assert (found.observations, found.sentences) == (tuple(placed), ())


def test_healthy_machines_are_placed_each_by_itself() -> None:
    """A file of responses that says it is of the table teaches nothing of a bracket that the session's nut sees."""
    model = replace(MACHINE, uncertain={})
    session = tuple(responses_at(PLACES["nut"], model))
    of_table = tuple(
        replace(observation, placed=True, response=observation.response)
        for observation in responses_at(PLACES["table"], model)
    )
    explanation = explain(model, session, ExplainOptions(healthy=(of_table, session)))
    assert explanation.outcome is Outcome.NONE
    assert all(channel.startswith("acceleration-at-nut") for channel in explanation.gap_by_channel)


@pytest.mark.release
def test_jobs_of_stored_measurements_take_the_place_too(shared_api: Api, session: Path, machine: Path) -> None:
    windows = list(read_session(session).windows)
    shared_api.register("nut", windows_per_measurement=15)
    shared_api.accept("nut", windows)
    for stated, sentence in ((None, "taken to be on the nut"), ("nut", "is on the nut, as stated.")):
        body: dict[str, Any] = {"model": machine.read_text(encoding="utf-8"), "measurements": {}}
        body |= {} if stated is None else {"accelerometer": stated}
        answer = shared_api.http.post("/v1/axes/nut/identifications", json=body)
        job = wait_for(shared_api, answer.json()["id"], "done", "failed")
        assert job["status"] == "done", job["error"]
        assert sentence in job["result"]["taken_as"][0]


@pytest.mark.release
def test_no_calibration_from_natural_frequencies_that_have_the_nut_elsewhere(
    preload: Any, session: Path, machine: Path, tmp_path: Path
) -> None:
    words = ("identify", session, "--model", machine, "--accelerometer", "nut", "--calibration", tmp_path / "k.json")
    stated = "mode_hz = [120, 260], preload_n = 200, preload_standard_uncertainty_n = 5, scatter_hz = 0.3"
    words += ("--prediction", stated)
    assert_refused(preload(*words), "in which the nut's mass moves with the table: expected responses of the")
    assert not (tmp_path / "k.json").exists()


@pytest.mark.parametrize(("kind", "model"), [("identifications", "model"), ("discrepancies", "baseline")])
def test_peaks_are_of_the_table(shared_api: Api, kind: str, model: str) -> None:
    shared_api.register("peaks-of-the-table")
    body = {model: "family = ", "peaks": [{"position_mm": 600, "frequency_hz": 118}], "accelerometer": "nut"}
    answer = shared_api.http.post(f"/v1/axes/peaks-of-the-table/{kind}", json=body)
    problem = assert_problem(answer, 422, "invalid-request")
    assert "accelerometer goes with measurements; peaks are of the table" in str(problem)


def test_other_data_say_where_they_are_of(preload: Any, tmp_path: Path) -> None:
    table = tmp_path / "peaks.csv"
    table.write_text("position_mm,frequency_hz\n300,180\n", encoding="utf-8")
    for command, model in (("explain", "--baseline"), ("identify", "--model")):
        words = (command, table, model, REPLAY / "models" / "replay-axis.toml", "--accelerometer", "nut")
        assert_refused(preload(*words), "--accelerometer goes with a session; a set of frequency responses says")
