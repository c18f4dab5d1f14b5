"""An axis without a calibration is watched from its first measurement: percent of its frequency, never newtons."""

import re
import time
from collections.abc import Iterator
from datetime import timedelta

import numpy as np
import pytest

from tests.service.conftest import START, Api, axial_frequency, simulated_measurement

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
    assert f"fell by {evidence['frequency_fall_percent']:.3g} ±" in evidence["sentence"]


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
