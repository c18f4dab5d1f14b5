"""An axis without a calibration is watched from its first measurement: percent of its frequency, never newtons."""

import json
import re
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from datetime import timedelta

import numpy as np
import pytest
import scipy.signal

from monitor_core import identification
from monitor_core.axis_state import AxisState, advance
from monitor_core.modal import ModalMeasurement
from monitor_core.pipeline import AxisSettings, judge_measurement
from monitor_core.preload import DriveLaw
from monitor_core.recording import Window
from monitor_core.recordings.model_file import model_file_text
from monitor_core.trend import DetectorSettings, LossDirection, design_detector
from monitor_core.uncertainty import plus_minus
from service.operations.monitoring.axis_configuration import drive_law
from service.operations.monitoring.intake.chart_state import load_state
from service.store import jobs
from tests.identification.test_described_calibration import AXES, Plant
from tests.service.conftest import SAMPLE_RATE, START, Api, axial_frequency, simulated_measurement
from tests.service.test_calibrating import windows_of

N_HEALTHY, N_LOST = 12, 5
PLACES_MM = (400.0, 500.0, 600.0)


@pytest.fixture(scope="module")
def watched(shared_api: Api) -> Iterator[Api]:
    """Run an axis ``watched``, at one of three places a day, whose preload falls from 300 N to 100 N."""
    shared_api.register("watched", windows_per_measurement=10)
    rng = np.random.default_rng(21)
    for i in range(N_HEALTHY + N_LOST):
        windows = simulated_measurement(
            rng,
            f"m{i:02d}",
            preload=300.0 if i < N_HEALTHY else 100.0,
            position_mm=PLACES_MM[i % 3],
            started_at=START + timedelta(days=i),
            n_windows=10,
        )
        shared_api.accept("watched", windows)
    return shared_api


def test_a_loss_is_alarmed_without_a_calibration_and_without_newtons(watched: Api) -> None:
    points = watched.trend("watched")
    assert [point["status"] for point in points] == ["judged"] * (N_HEALTHY + N_LOST)
    assert [point["state"] for point in points[:N_HEALTHY]] == ["learning"] * 7 + ["normal"] * (N_HEALTHY - 7)
    assert points[-1]["state"] == "alarm"
    assert {point["preload_n"] for point in points} == {None}
    (alarm,) = watched.http.get("/v1/alarms", params={"axis": "watched"}).json()["alarms"]
    evidence = alarm["evidence"]
    assert evidence["onset"] == (START + timedelta(days=N_HEALTHY)).isoformat().replace("+00:00", "Z")
    at = PLACES_MM[(N_HEALTHY + N_LOST - 1) % 3] * 1e-3
    true_fall = 100.0 * (1.0 - axial_frequency(100.0, at) / axial_frequency(300.0, at))
    lower, upper = points[-1]["frequency_fall_interval_95_percent"]
    assert lower < true_fall < upper
    least, most = evidence["preload_lost_if_preload_percent"]
    assert least < 100.0 * (1.0 - 100.0 / 300.0) < most
    assert " N " not in evidence["sentence"]
    lower, upper = evidence["frequency_fall_interval_95_percent"]
    said = plus_minus(evidence["frequency_fall_percent"], 0.5 * (upper - lower))
    assert f"fell by {said} %; if that is preload" in evidence["sentence"]


def test_a_drive_model_tells_the_law_of_places_that_an_axis_has_not_shown(api: Api) -> None:
    """Learnt at one place of a finite-element axis, then measured 40 mm beside it: compared where there is a model."""
    plant = Plant(AXES["small"], np.random.default_rng(31))
    models = {"modelled": {"drive_model": model_file_text(AXES["small"])}, "bare": {}}
    seen = {}
    for axis, model in models.items():
        api.register(axis, windows_per_measurement=4, search_band_hz=[120, 300], **model)
        for day in range(10):
            reading = plant.reading(0.3 if day < 9 else 0.34)
            windows = [
                replace(window, started_at=window.started_at + timedelta(days=day))
                for window in windows_of(reading, day)
            ]
            api.accept(axis, windows)
        seen[axis] = [point["uncharted"] for point in api.trend(axis)]
    assert seen == {"modelled": [None] * 10, "bare": [None] * 9 + ["not-comparable"]}


def test_a_drive_model_is_asked_while_nothing_is_locked_and_also_where_it_comes_later(
    api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def law_of_drive(*_: object) -> DriveLaw:
        with closing(sqlite3.connect(api.data_dir / "preload.db", timeout=0.0)) as other:
            other.execute("BEGIN IMMEDIATE")  # raises while somebody else writes
        asked.append(DriveLaw((3e-5, 0.0, 0.0), tuple((1e-8 * np.eye(3)).ravel().tolist())))
        return asked[-1]

    monkeypatch.setattr(identification, "law_of_drive", law_of_drive)
    drive_law.cache_clear()
    for number, model in enumerate(({}, {"drive_model": model_file_text(AXES["large"])})):
        api.register("axis", windows_per_measurement=10, **model)
        windows = simulated_measurement(
            np.random.default_rng(number), f"m{number}", n_windows=10, started_at=START + timedelta(days=number)
        )
        api.accept("axis", windows)
    with closing(sqlite3.connect(api.data_dir / "preload.db")) as connection:
        ((text,),) = connection.execute("SELECT monitor_state FROM axes WHERE id = 'axis'").fetchall()
    assert [load_state(json.loads(text)).drive] == asked
    drive_law.cache_clear()


def test_every_page_says_it_in_percent(watched: Api) -> None:
    number = watched.http.get("/v1/alarms", params={"axis": "watched"}).json()["alarms"][0]["id"]
    for path in ("/axes/watched", f"/alarms/{number}", "/alarms", "/", "/wall"):
        page = watched.http.get(path)
        assert page.status_code == 200, path
        text = re.sub(r"<[^>]+>", " ", page.text)
        assert re.search(r"−\d+[.,]?\d* +%", text), path
        assert not re.search(r"\d N\b(?!·)", text), path
    assert "if that is preload" in watched.http.get("/axes/watched").text


def test_a_calibration_judges_the_history_anew_and_its_alarm_stays_the_same(watched: Api) -> None:
    """Runs last: it calibrates the axis. Somebody has seen the alarm, which says percent; then it says newtons."""
    (before,) = watched.http.get("/v1/alarms", params={"axis": "watched"}).json()["alarms"]
    watched.http.post(f"/v1/alarms/{before['id']}/acknowledge", json={"comment": "seen"}).raise_for_status()
    watched.calibrate("watched")
    deadline = time.monotonic() + 60.0
    while watched.axis("watched")["stale"] is not None and time.monotonic() < deadline:
        time.sleep(0.2)
    points = watched.trend("watched")
    assert all(point["preload_n"] is not None for point in points)
    assert {point["frequency_fall_percent"] for point in points} == {None}
    (after,) = watched.http.get("/v1/alarms", params={"axis": "watched"}).json()["alarms"]
    assert (after["id"], after["status"]) == (before["id"], "acknowledged")
    assert after["evidence"]["preload_loss_n"] == pytest.approx(200.0, abs=60.0)
    assert after["evidence"]["onset"] == before["evidence"]["onset"]
    assert watched.axis("watched")["state"] == "alarm"


def test_a_calibration_whose_history_cannot_be_judged_now_comes_into_force_later_with_it(
    api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was in force after 503, and the same request, sent again, left the history without newtons."""
    api.register("busy", windows_per_measurement=10)
    api.accept("busy", simulated_measurement(np.random.default_rng(24), "m", n_windows=10))
    with monkeypatch.context() as busy:
        busy.setattr(jobs, "count_unfinished", lambda *_: 10**6)
        with pytest.raises(AssertionError, match="come back later"):
            api.calibrate("busy")
    assert api.axis("busy")["active_calibration"] is None
    api.calibrate("busy")
    deadline = time.monotonic() + 60.0
    while api.trend("busy")[0]["preload_n"] is None and time.monotonic() < deadline:
        time.sleep(0.05)
    assert api.trend("busy")[0]["preload_n"] == pytest.approx(300.0, abs=60.0)


def test_charts_of_the_service_take_for_scatter_what_is_new_in_each_measurement(shared_api: Api) -> None:
    """As the core does with the same windows; a second mode makes errors of the model, which are many times larger."""
    windows = [_with_second_mode(window) for window in simulated_measurement(np.random.default_rng(1), "m")]
    shared_api.register("two-modes", windows_per_measurement=len(windows))
    shared_api.accept("two-modes", windows)
    outcome = judge_measurement(windows, AxisSettings(search_band=(140.0, 230.0)), None)
    assert isinstance(outcome.modal, ModalMeasurement)
    frequency = outcome.modal.mode.frequency
    design = design_detector(DetectorSettings(loss=LossDirection.RISE))
    live = advance(AxisState(), outcome, windows[0].started_at, calibration=None, design=design).detector.session
    with closing(sqlite3.connect(shared_api.data_dir / "preload.db")) as connection:
        ((text,),) = connection.execute("SELECT monitor_state FROM axes WHERE id = 'two-modes'").fetchall()
    stored = load_state(json.loads(text)).detector.session
    assert live is not None
    assert stored is not None
    assert stored.own_variance == pytest.approx(live.own_variance, rel=1e-6)
    whole = 2.0 * frequency.standard_uncertainty / frequency.value**3
    assert stored.own_variance < (0.2 * whole) ** 2


def _with_second_mode(window: Window) -> Window:
    """Add a mode at 200 Hz to the response, a third as strong as the axial one at 179.5 Hz."""
    omega = 2.0 * np.pi * 200.0
    b, a = scipy.signal.bilinear([0.3, 0.0, 0.0], [1.0, 0.04 * omega, omega**2], SAMPLE_RATE)
    response = window.response + scipy.signal.lfilter(b, a, window.excitation)
    return replace(window, response=response.astype(np.float32))
