"""An axis that loses preload from its first day: its alarm, its pages, and the next baseline."""

from dataclasses import replace
from datetime import timedelta

import numpy as np
import pytest

from tests.browser.states import CONFIGURATION
from tests.service.conftest import START, Api, simulated_measurement

N_DAYS = 12
LOST = 120.0  # of 300 N, by the last day


@pytest.fixture
def falling(api: Api, request: pytest.FixtureRequest) -> Api:
    """Measure an axis ``mill`` that falls all the while, and would have a baseline on the eighth day.

    The temperature of the first day is stated or not.
    """
    api.register("mill", **CONFIGURATION)
    api.calibrate("mill")
    preloads = [300.0 - LOST * day / (N_DAYS - 1) for day in range(N_DAYS)]
    measure(api, range(1), preloads[:1], stated=getattr(request, "param", True))
    measure(api, range(1, N_DAYS), preloads[1:])
    return api


def measure(api: Api, days: range, preloads: list[float], *, stated: bool = True) -> None:
    for day, preload in zip(days, preloads, strict=True):
        rng, at = np.random.default_rng(100 + day), START + timedelta(days=day)
        windows = simulated_measurement(rng, f"day-{day}", preload=preload, started_at=at, n_windows=4)
        if not stated:
            windows = [replace(w, conditions=replace(w.conditions, temperature=None)) for w in windows]
        api.accept("mill", windows)


@pytest.mark.parametrize(
    "falling",
    [pytest.param(True, id="stated"), pytest.param(False, id="unstated", marks=pytest.mark.release)],
    indirect=True,
)
def test_it_is_said_until_somebody_has_looked_and_nothing_of_it_is_learnt(
    falling: Api, request: pytest.FixtureRequest
) -> None:
    points = falling.trend("mill")
    n_before = [point["state"] for point in points].index("alarm")
    assert [point["state"] for point in points] == ["learning"] * n_before + ["alarm"] * (N_DAYS - n_before)
    assert falling.http.get("/v1/axes/mill/history").json()["baseline"] is None
    (alarm,) = falling.http.get("/v1/alarms", params={"axis": "mill"}).json()["alarms"]
    evidence = alarm["evidence"]
    assert (alarm["kind"], evidence["chart"], evidence["onset"]) == ("preload-loss", "trend", "2026-03-02T06:00:00Z")
    assert alarm["explanation"]["reason"] == "no-baseline"
    # the true loss on the day that raised it, within what is said
    assert points[n_before]["at"] == evidence["at"]
    lower, upper = evidence["loss_interval_95_percent"]
    assert lower <= 100.0 * LOST * n_before / (N_DAYS - 1) / 300.0 <= upper
    assert ("not stated" in evidence["sentence"]) == ("unstated" in request.node.name)
    for page in ("/axes/mill", f"/alarms/{alarm['id']}"):
        assert "The preload falls while its baseline is being learnt: −" in falling.http.get(page).text
    assert falling.axis("mill")["state"] == "alarm"


def test_clearing_begins_the_baseline_anew(falling: Api) -> None:
    (alarm,) = falling.http.get("/v1/alarms").json()["alarms"]
    falling.http.post(f"/v1/alarms/{alarm['id']}/clear", json={"comment": "tightened"}).raise_for_status()
    measure(falling, range(N_DAYS, N_DAYS + 9), [300.0] * 9)
    states = [point["state"] for point in falling.trend("mill")[N_DAYS:]]
    assert states == ["learning"] * 7 + ["normal"] * 2


def test_what_arrives_late_and_shows_that_it_does_not_fall_takes_the_alarm_back(falling: Api) -> None:
    """Before the first day it stood as low as on the last."""
    measure(falling, range(-8, 0), [200.0, 190.0, 210.0, 185.0, 215.0, 195.0, 205.0, 200.0])
    (alarm,) = falling.http.get("/v1/alarms", params={"status": "withdrawn"}).json()["alarms"]
    assert alarm["events"][-1]["new_status"] == "withdrawn"


def test_without_a_calibration_the_page_asks_to_clear_it_and_no_cause_is_looked_for(
    api: Api, caplog: pytest.LogCaptureFixture
) -> None:
    api.register("mill", **CONFIGURATION)
    measure(api, range(N_DAYS), [300.0 - LOST * day / (N_DAYS - 1) for day in range(N_DAYS)])
    (alarm,) = api.http.get("/v1/alarms", params={"axis": "mill"}).json()["alarms"]
    assert (alarm["evidence"]["chart"], alarm["explanation"]["reason"]) == ("trend", "no-baseline")
    assert alarm["evidence"]["frequency_fall_percent"] > 0.0
    page = api.http.get("/axes/mill").text
    assert "the natural frequency fell by" in page
    assert "clear the alarm: a new baseline is learnt" in page
    assert "waits for its explanation" not in caplog.text
