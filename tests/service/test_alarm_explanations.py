"""An alarm says which change of the axis explains it: sessions of the plant, end to end over HTTP."""

import time
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import numpy as np
import pytest

from monitor_core.modal import ModalMeasurement, ModeGate, measure_mode
from monitor_core.pipeline import AxisSettings, calibrate_from_measurements
from monitor_core.recording import Window
from monitor_core.recordings.calibration_file import calibration_document
from monitor_core.recordings.session_hdf5 import open_session
from service.operations.monitoring.alarms import EXPLANATION
from service.settings import BUNDLED_SESSIONS
from service.store.database import Database
from service.store.tables import JobRow
from tests.conftest import canary
from tests.hidden_effects.running.sessions import description
from tests.plant.chain import Condition
from tests.plant.measurements import Acquisition, Scatter, simulate_measurements, to_windows
from tests.service.conftest import Api, assert_problem, simulated_measurement

BAND = (140.0, 230.0)
PLACES = (0.30, 0.50, 0.70)  # measured in turn, one a day [m]
N_BASELINE = 2 * len(PLACES)
N_CHANGED = len(PLACES)
N_WINDOWS = 10
ACQUISITION = Acquisition(n_windows=N_WINDOWS)
START = datetime(2026, 3, 1, 6, tzinfo=UTC)
MODEL = description()


@pytest.fixture(scope="module")
def calibration() -> dict[str, Any]:
    """Calibrate the machine of the plant on every other measurement of the bundled session."""
    with open_session(BUNDLED_SESSIONS / "calibration.session.h5") as session:
        windows = [session.windows_of(name) for name in session.measurements[::2]]
    modes = [measure_mode(of_measurement, band=BAND, gate=ModeGate()) for of_measurement in windows]
    sound = [mode for mode in modes if isinstance(mode, ModalMeasurement)]
    return calibration_document(calibrate_from_measurements(sound, settings=AxisSettings(search_band=BAND)))


def session_of(changed: Condition) -> tuple[list[Window], list[Window]]:
    """Measure the healthy axis, and the axis under a condition that no window tells of."""
    positions = [PLACES[i % len(PLACES)] for i in range(N_BASELINE + N_CHANGED)]
    tagged = [Condition(x) for x in positions]
    true = [*tagged[:N_BASELINE], *(replace(changed, position=window.position) for window in tagged[N_BASELINE:])]
    recorded = simulate_measurements(true, np.random.default_rng(11), ACQUISITION, scatter=Scatter())
    starts = [START + timedelta(days=i) for i in range(len(tagged))]
    windows = list(to_windows(recorded, tagged, starts, ACQUISITION, preload_known=False))
    return windows[: N_BASELINE * N_WINDOWS], windows[N_BASELINE * N_WINDOWS :]


def watch(api: Api, axis: str, calibration: dict[str, Any], **configuration: Any) -> None:
    """Register an axis of the machine of the plant."""
    api.register(axis, **({"baseline_size": N_BASELINE, "search_band_hz": list(BAND)} | configuration))
    own = api.http.post(f"/v1/axes/{axis}/calibrations", json={"document": calibration, "comment": ""}).json()
    api.http.post(f"/v1/axes/{axis}/calibrations/{own['id']}/activate", json={"reason": "test"}).raise_for_status()


def alarm_of(api: Api, axis: str) -> dict[str, Any]:
    (alarm,) = api.http.get("/v1/alarms", params={"axis": axis}).json()["alarms"]
    return dict(alarm)


def finished_jobs(api: Api, axis: str) -> list[dict[str, Any]]:
    """Return the jobs of an axis when all have ended, newest first."""
    deadline = time.monotonic() + 120.0
    while True:
        found = api.http.get("/v1/jobs", params={"axis": axis}).json()["jobs"]
        if all(job["status"] not in ("queued", "running") for job in found):
            return list(found)
        assert time.monotonic() < deadline
        time.sleep(0.1)


# --- the cause is named


@pytest.mark.parametrize(
    ("cause", "changed", "size"),
    canary([("preload", Condition(0.0, preload=200.0), -100.0), ("payload", Condition(0.0, payload=1.0), 1.0)]),
)
def test_alarm_says_what_has_changed(
    shared_api: Api, calibration: dict[str, Any], cause: str, changed: Condition, size: float
) -> None:
    watch(shared_api, cause, calibration, drive_model=MODEL)
    healthy, after = session_of(changed)
    shared_api.accept(cause, healthy, complete=True)
    assert shared_api.axis(cause)["state"] == "normal"
    answer = shared_api.accept(cause, after, complete=True)  # at once: one job
    assert answer["measurements"][-1]["state"] == "alarm"
    (job,) = finished_jobs(shared_api, cause)
    assert (job["kind"], job["status"]) == ("alarm-explanation", "done")
    alarm = alarm_of(shared_api, cause)
    explanation = alarm["explanation"]
    assert (explanation["examined"], explanation["outcome"], explanation["cause"]) == (True, "named", cause)
    assert job["result"]["sentence"] == explanation["sentence"]
    assert explanation["confidence"] > 0.9
    first = explanation["changes"][0]
    assert abs(first["size"] - size) < 3.0 * first["size_standard_uncertainty"] < 0.5 * abs(size)
    assert first["probability"] == pytest.approx(explanation["confidence"], abs=0.1)
    assert {change["cause"] for change in explanation["changes"]} >= {
        "preload",
        "payload",
        "bearing",
        "position",
        "sensor",
    }
    assert sum(change["probability"] for change in explanation["changes"]) <= 1.0 + 1e-9
    assert explanation["reference"]["n_measurements"] == N_BASELINE
    assert explanation["recent"]["n_measurements"] == N_CHANGED
    assert alarm["events"][-1]["reason"] == f"explained: {explanation['sentence']}"
    assert alarm["status"] == "active"
    page = shared_api.http.get(f"/axes/{cause}").text
    assert explanation["sentence"].split(" (95 %)")[0] in page
    assert ("of preload were lost since" in page) == (cause == "preload")


# --- or why it was not examined


def lose_preload(api: Api, axis: str, places_mm: Sequence[float]) -> None:
    """Measure a simple resonator at these places in turn, then with less preload once at each of them."""
    rng = np.random.default_rng(5)
    at = [places_mm[i % len(places_mm)] for i in range(6)]
    for i, (position_mm, preload) in enumerate([*((x, 300.0) for x in at), *((x, 120.0) for x in places_mm)]):
        windows = simulated_measurement(
            rng, f"m{i}", preload=preload, position_mm=position_mm, n_windows=8, started_at=START + timedelta(days=i)
        )
        api.accept(axis, windows, complete=True)


def measure_on(api: Api, axis: str, days: int) -> None:
    """Measure the resonator once a day, here and there, and send all of it at once."""
    last = datetime.fromisoformat(api.axis(axis)["last_measurement"]["started_at"])
    rng, windows = np.random.default_rng(last.day), []
    for day in range(1, days + 1):
        at = last + timedelta(days=day)
        place = 400.0 + 100.0 * (day % 3)
        windows += simulated_measurement(rng, f"{at:%d}", preload=120.0, position_mm=place, n_windows=8, started_at=at)
    api.accept(axis, windows, complete=True)


def watch_resonator(api: Api, axis: str, **configuration: Any) -> None:
    api.register(axis, windows_per_measurement=8, baseline_size=6, **configuration)
    api.calibrate(axis)


def test_axis_without_a_drive_model_says_so(shared_api: Api) -> None:
    watch_resonator(shared_api, "bare")
    lose_preload(shared_api, "bare", (400.0, 500.0, 600.0))
    assert shared_api.axis("bare")["state"] == "alarm"
    assert finished_jobs(shared_api, "bare") == []
    alarm = alarm_of(shared_api, "bare")
    sentence = "cause not examined: the axis has no drive model"
    assert alarm["explanation"] == {"examined": False, "reason": "no-drive-model", "sentence": sentence, "recent": None}
    assert sentence in shared_api.http.get("/axes/bare").text
    problem = assert_problem(ask(shared_api, alarm["id"]), 422, "not-identifiable")
    assert "expected drive_model in the configuration of the axis" in problem["detail"]
    assert_problem(ask(shared_api, 10**6), 404, "unknown-resource")


def test_too_few_places_are_waited_for(shared_api: Api) -> None:
    watch_resonator(shared_api, "two", drive_model=MODEL)
    lose_preload(shared_api, "two", (400.0, 600.0))
    alarm = alarm_of(shared_api, "two")
    assert finished_jobs(shared_api, "two") == []
    assert alarm["explanation"]["reason"] == "too-few-places"
    assert alarm["explanation"]["sentence"].endswith("three positions, and since the onset there are two")
    problem = assert_problem(ask(shared_api, alarm["id"]), 422, "not-identifiable")
    assert problem["detail"].endswith("; got 2")


def test_a_job_of_an_earlier_alarm_keeps_no_later_one_from_its_own(shared_api: Api) -> None:
    watch_resonator(shared_api, "again", drive_model=MODEL)
    at = datetime.now(UTC)
    with Database(f"sqlite:///{shared_api.data_dir / 'preload.db'}").write() as session:
        waiting = {"id": "of-an-earlier-alarm", "kind": EXPLANATION, "axis_id": "again", "arguments": {"alarm": 10**6}}
        session.add(JobRow(**waiting, status="queued", done=0, created_at=at, updated_at=at))  # nobody was woken for it
    lose_preload(shared_api, "again", (400.0, 500.0, 600.0))
    own, earlier = finished_jobs(shared_api, "again")
    assert (earlier["id"], earlier["status"]) == ("of-an-earlier-alarm", "failed")
    assert (own["arguments"], own["status"]) == ({"alarm": alarm_of(shared_api, "again")["id"]}, "done")


@pytest.mark.parametrize("status", ["queued", "running", "failed", "cancelled"])
def test_what_an_alarm_says_of_its_cause_is_how_it_stands_now(shared_api: Api, status: str) -> None:
    axis = f"looks-{status}"
    watch_resonator(shared_api, axis)
    lose_preload(shared_api, axis, (400.0, 500.0, 600.0))
    alarm = alarm_of(shared_api, axis)
    assert alarm["explanation"]["reason"] == "no-drive-model"
    shared_api.register(axis, windows_per_measurement=8, baseline_size=6, drive_model=MODEL)
    assert alarm_of(shared_api, axis)["explanation"]["reason"] == "not-yet"
    at = datetime.now(UTC)
    with Database(f"sqlite:///{shared_api.data_dir / 'preload.db'}").write() as session:
        job = {"id": axis, "kind": EXPLANATION, "axis_id": axis, "arguments": {"alarm": alarm["id"]}, "status": status}
        lease = {"owner": "another", "lease_until": at + timedelta(days=1)}
        session.add(JobRow(**job, **lease, done=0, created_at=at, updated_at=at))
    reason = {"failed": "failed", "cancelled": "not-yet"}.get(status, "under-way")
    assert alarm_of(shared_api, axis)["explanation"]["reason"] == reason
    page = shared_api.http.get(f"/alarms/{alarm['id']}").text
    assert (f'action="/alarms/{alarm["id"]}/explanations"' in page) == (reason != "under-way")
    if reason == "under-way":  # once is enough
        assert_problem(ask(shared_api, alarm["id"]), 409, "conflict")
    clear = shared_api.http.post(f"/v1/alarms/{alarm['id']}/clear", json={"comment": "nut replaced"})
    assert clear.json()["explanation"]["reason"] == "closed"


@pytest.mark.release
def test_model_of_another_machine_is_refused_in_the_alarm_and_asked_again(shared_api: Api) -> None:
    watch_resonator(shared_api, "other", drive_model=MODEL)
    lose_preload(shared_api, "other", (400.0, 500.0, 600.0))
    (first,) = finished_jobs(shared_api, "other")
    alarm = alarm_of(shared_api, "other")
    assert first["status"] == "done"
    assert first["result"]["sentence"] == alarm["explanation"]["sentence"]
    assert alarm["explanation"]["reason"] == "refused"
    assert "the model must describe the reference of its axis" in alarm["explanation"]["sentence"]
    assert alarm["events"][-1]["reason"] == alarm["explanation"]["sentence"]

    answer = ask(shared_api, alarm["id"])
    assert answer.status_code == 202
    assert answer.headers["location"] == f"/v1/jobs/{answer.json()['id']}"
    assert answer.json()["arguments"] == {"alarm": alarm["id"]}
    finished_jobs(shared_api, "other")
    assert alarm_of(shared_api, "other")["events"] == alarm["events"]  # the same answer is no change

    for days, n_jobs, n_recent in ((1, 3, 4), (8, 4, 8), (1, 4, 8)):  # until eight were taken after the alarm
        measure_on(shared_api, "other", days)
        assert len(finished_jobs(shared_api, "other")) == n_jobs
        assert alarm_of(shared_api, "other")["explanation"]["recent"]["n_measurements"] == n_recent

    alarm, path = alarm_of(shared_api, "other"), f"/v1/alarms/{alarm['id']}"
    shared_api.http.post(f"{path}/clear", json={"comment": "nut replaced"}).raise_for_status()
    assert_problem(ask(shared_api, alarm["id"]), 409, "conflict")
    assert shared_api.http.get(path).json()["explanation"] == alarm["explanation"]


@pytest.mark.parametrize(
    ("model", "name", "words"),
    [
        ("family = ", "recording-format", "expected a drive model in TOML"),
        (MODEL.replace("dynamic_load_rating_n", "# "), "outside-validity", "expected dynamic_load_rating_n"),
    ],
)
def test_drive_model_that_explains_nothing_is_refused_at_registration(
    shared_api: Api, model: str, name: str, words: str
) -> None:
    answer = shared_api.http.put("/v1/axes/unsound", json={"name": "x", "configuration": {"drive_model": model}})
    assert words in assert_problem(answer, 422, name)["detail"]
    assert shared_api.http.get("/v1/axes/unsound").status_code == 404


def ask(api: Api, alarm_id: int) -> httpx.Response:
    return api.http.post(f"/v1/alarms/{alarm_id}/explanations")
