"""What the history of an axis says: baseline, line, own rate of false alarms; what sisters lend."""

from collections.abc import Iterator
from datetime import timedelta
from typing import Any

import numpy as np
import pytest

from tests.service.conftest import START, Api, running_service, simulated_measurement

DAYS = 90
N_WINDOWS = 4
SETTINGS: dict[str, Any] = {"windows_per_measurement": N_WINDOWS, "minimum_averages": 2, "axis_type": "VMC 850, X"}


def watch(api: Api, axis: str, rng: np.random.Generator, preloads: list[float], first_day: int = 0) -> None:
    """Send a measurement a day."""
    windows = []
    for day, preload in enumerate(preloads, start=first_day):
        at = START + timedelta(days=day)
        windows += simulated_measurement(rng, f"d{day:03d}", preload=preload, started_at=at, n_windows=N_WINDOWS)
    for i in range(0, len(windows), 20 * N_WINDOWS):
        api.accept(axis, windows[i : i + 20 * N_WINDOWS])


@pytest.fixture(scope="module")
def old(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """Run a service with an axis that was healthy for ninety days, and a new one of its type."""
    with running_service(tmp_path_factory.mktemp("history") / "var") as api:
        for axis in ("old", "young"):
            api.register(axis, **SETTINGS)
        api.calibrate("old")
        rng = np.random.default_rng(3)
        watch(api, "old", rng, (300.0 + 2.0 * rng.standard_normal(DAYS)).tolist())
        yield api


def history(api: Api, axis: str) -> dict[str, Any]:
    answer = api.http.get(f"/v1/axes/{axis}/history")
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


@pytest.mark.release
def test_a_healthy_season_gives_baseline_line_and_rate(old: Api) -> None:
    found = history(old, "old")
    assert old.axis("old")["state"] == "normal"
    baseline = found["baseline"]
    measured = np.mean([point["preload_n"] for point in old.trend("old")])
    assert baseline["preload_n"] == pytest.approx(measured, abs=3.0)  # scatter of 9 N, of a mean 1 N
    assert baseline["size"] > 60  # it goes on learning
    assert baseline["not_seen"][0].startswith("other seasons than those")
    assert baseline["sisters"] == {"n_sisters": 0, "weight_in_scatter": 0.0, "contradicted": False}
    line = found["trend_line"]
    low, high = line["interval_95_n_per_year"]
    assert low <= line["slope_n_per_year"] <= high
    assert low < 0.0 < high  # nothing is lost
    rate = found["false_alarms"]
    assert rate["stated_per_year"] == 1.0
    assert rate["n_sessions"] == pytest.approx(DAYS - 9, abs=2)  # eight make the baseline, the last is not over
    assert rate["interval_95_per_year"][0] <= rate["found_per_year"] <= rate["interval_95_per_year"][1]
    assert rate["sentence"] in old.http.get("/axes/old").text


@pytest.mark.release
def test_an_old_sister_lends_a_young_axis_its_scatter(old: Api) -> None:
    old.calibrate("young")
    rng = np.random.default_rng(4)
    watch(old, "young", rng, (300.0 + 2.0 * rng.standard_normal(10)).tolist())  # as its sister scatters
    lent = history(old, "young")["baseline"]["sisters"]
    assert lent["n_sisters"] == 1
    assert 0.1 < lent["weight_in_scatter"] < 0.9
    assert not lent["contradicted"]


def test_an_axis_without_calibration_has_no_history(old: Api) -> None:
    old.register("bare")
    assert history(old, "bare") == {
        "axis": "bare",
        "baseline": None,
        "trend_line": None,
        "false_alarms": None,
        "alert": None,
        "together": None,
        "events": [],
        "stale": None,
    }


@pytest.mark.release
def test_what_an_inspection_clears_is_part_of_the_history(api: Api) -> None:
    api.register("worn", **SETTINGS)
    api.calibrate("worn")
    rng = np.random.default_rng(5)
    watch(api, "worn", rng, [300.0] * 20 + [250.0] * 4)
    (alarm,) = api.http.get("/v1/alarms", params={"axis": "worn"}).json()["alarms"]
    n_before = history(api, "worn")["false_alarms"]["n_sessions"]
    api.http.post(f"/v1/alarms/{alarm['id']}/clear", json={"comment": "in order"}).raise_for_status()
    after = history(api, "worn")
    assert after["false_alarms"]["n_sessions"] > n_before  # somebody has said that the alarm was false
    assert after["trend_line"] is None  # a step is no rate, and four sessions since tell none
    watch(api, "worn", rng, [250.0] * 11, first_day=24)
    assert api.axis("worn")["state"] == "normal"
    assert history(api, "worn")["baseline"]["size"] > 20  # scatter and dependence are known still
    line = history(api, "worn")["trend_line"]
    assert line["changed_at"].startswith(f"{START + timedelta(days=20):%Y-%m-%d}")
    assert line["interval_95_n_per_year"][0] < 0.0 < line["interval_95_n_per_year"][1]


@pytest.mark.release
def test_a_scatter_that_the_calibration_did_not_know_widens_the_interval(api: Api) -> None:
    api.register("restless", **SETTINGS)
    api.calibrate("restless")
    rng = np.random.default_rng(6)
    watch(api, "restless", rng, (300.0 + 25.0 * rng.standard_normal(40)).tolist())
    points = api.trend("restless")
    halves = np.array([0.5 * (p["interval_95_n"][1] - p["interval_95_n"][0]) for p in points])
    assert halves[-10:].mean() > 1.7 * halves[:8].mean()  # 22 N, and 1.96 times 24 N on top
    last = api.axis("restless")["last_measurement"]
    assert last["interval_95_n"] == points[-1]["interval_95_n"]
    assert sum(last["variance_shares"].values()) == pytest.approx(1.0)
    assert last["variance_shares"]["between_session"] > 0.5
    covered = [p["interval_95_n"][0] <= 300.0 <= p["interval_95_n"][1] for p in points[10:]]
    assert np.mean(covered) > 0.85


def test_an_alert_that_stands_says_how_far_the_preload_is_off_and_what_to_do(api: Api) -> None:
    api.register("axis", **SETTINGS)
    api.calibrate("axis")
    rng = np.random.default_rng(5)
    watch(api, "axis", rng, [300.0] * 12 + [360.0] * 8)
    assert api.axis("axis")["state"] == "alert"
    alert = history(api, "axis")["alert"]
    assert alert["direction"] == "rise"
    assert alert["mean_change_n"] == pytest.approx(60.0, abs=25.0)  # of the mean since the average turned
    assert "no loss" in alert["sentence"]
    page = api.http.get("/axes/axis").text
    assert f"the preload is {alert['mean_change_n']:.0f} N above the baseline on average. That is no loss." in page
    watch(api, "axis", rng, [300.0] * 25, first_day=20)
    assert history(api, "axis")["alert"] is None
