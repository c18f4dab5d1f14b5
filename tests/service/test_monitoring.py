"""A loss of preload from the first window to the cleared alarm; calibrations with their history; the trend by pages."""

from collections.abc import Iterator
from datetime import timedelta
from typing import Any

import numpy as np
import pytest

from tests.service.conftest import START, Api, assert_problem, axial_frequency, readings, simulated_measurement

N_HEALTHY, N_LOST = 10, 6


@pytest.fixture(scope="module")
def worn(shared_api: Api) -> Iterator[Api]:
    """Run an axis ``worn`` whose preload falls from 300 N to 200 N after ten measurements, a day apart."""
    shared_api.register("worn", windows_per_measurement=10)
    shared_api.calibrate("worn")
    rng = np.random.default_rng(1)
    for i in range(N_HEALTHY + N_LOST):
        windows = simulated_measurement(
            rng,
            f"m{i:02d}",
            preload=300.0 if i < N_HEALTHY else 200.0,
            position_mm=(400.0, 500.0, 600.0)[i % 3],
            started_at=START + timedelta(days=i),
            n_windows=10,
        )
        shared_api.accept("worn", windows)
    return shared_api


def test_loss_is_alarmed_with_evidence(worn: Api) -> None:
    points = worn.trend("worn")
    assert [point["state"] for point in points[:N_HEALTHY]] == ["learning"] * 7 + ["normal"] * 3
    assert points[-1]["state"] == "alarm"
    (alarm,) = worn.http.get("/v1/alarms", params={"axis": "worn"}).json()["alarms"]
    assert (alarm["kind"], alarm["status"]) == ("preload-loss", "active")
    evidence = alarm["evidence"]
    # 10 windows and the calibration's scatter of 0.1 Hz: some ten newtons
    assert evidence["baseline_preload_n"] == pytest.approx(300.0, abs=20.0)
    assert evidence["preload_loss_n"] == pytest.approx(100.0, abs=30.0)
    # one size, in every sentence: that of the session, here of one measurement a day
    raised = next(point for point in points if point["at"] == evidence["at"])
    assert evidence["preload_loss_n"] == pytest.approx(evidence["baseline_preload_n"] - raised["preload_n"], abs=2.0)
    size = f"{evidence['preload_loss_n']:.0f} N"
    assert f"{size} below the baseline's" in evidence["sentence"]
    assert f"had lost {size} of its baseline" in worn.http.get(f"/alarms/{alarm['id']}").text
    assert evidence["onset"] == "2026-03-12T06:00:00Z"  # the first measurement after the fall
    assert worn.axis("worn")["open_alarms"] == 1
    assert 'preload_alarms_total{kind="preload-loss"} 1.0' in worn.http.get("/metrics").text


def test_trend_by_range(worn: Api) -> None:
    everything = worn.trend("worn")
    assert len(everything) == N_HEALTHY + N_LOST
    start, end = START + timedelta(days=1), START + timedelta(days=5)
    part = worn.trend("worn", **{"from": start.isoformat(), "to": end.isoformat()})
    assert [point["measurement"] for point in part] == ["m01", "m02", "m03", "m04"]  # from is in it, to is not
    elsewhere = {"from": "2026-03-03T07:00:00+01:00", "to": "2026-03-03T06:00:00.000001Z"}
    assert [point["measurement"] for point in worn.trend("worn", **elsewhere)] == ["m01"]


def test_trend_by_pages(worn: Api) -> None:
    collected: list[dict[str, Any]] = []
    query: dict[str, Any] = {"limit": 5}
    sizes = []
    while True:
        page = worn.http.get("/v1/axes/worn/trend", params=query).json()
        collected += page["points"]
        sizes.append(len(page["points"]))
        if page["next_cursor"] is None:
            break
        query["cursor"] = page["next_cursor"]
    assert sizes == [5, 5, 5, 1]
    assert collected == worn.trend("worn")


def test_coarse_trend_keeps_the_extremes(worn: Api) -> None:
    full, coarse = worn.trend("worn"), worn.trend("worn", max_points=4)
    assert len(coarse) <= 4
    assert all(point in full for point in coarse)
    preloads = [point["preload_n"] for point in full]
    assert {min(preloads), max(preloads)} <= {point["preload_n"] for point in coarse}
    assert [point["at"] for point in coarse] == sorted(point["at"] for point in coarse)


def test_etag_says_whether_the_trend_has_changed(worn: Api) -> None:
    first = worn.http.get("/v1/axes/worn/trend")
    etag = first.headers["etag"]
    assert etag.startswith('"')  # strong
    same = worn.http.get("/v1/axes/worn/trend", headers={"if-none-match": f'"other", {etag}'})
    assert (same.status_code, same.content, same.headers["etag"]) == (304, b"", etag)
    other = worn.http.get("/v1/axes/worn/trend", params={"limit": 3}, headers={"if-none-match": etag})
    assert other.status_code == 200


def test_alarm_is_acknowledged_and_cleared_with_history(worn: Api) -> None:
    (alarm,) = worn.http.get("/v1/alarms", params={"axis": "worn"}).json()["alarms"]
    path = f"/v1/alarms/{alarm['id']}"
    seen = worn.http.post(f"{path}/acknowledge", json={"comment": "nut ordered"}).json()
    assert seen["status"] == "acknowledged"
    assert worn.axis("worn")["state"] == "alarm"  # to have seen it changes nothing
    assert_problem(worn.http.post(f"{path}/acknowledge", json={"comment": "again"}), 409, "conflict")
    cleared = worn.http.post(f"{path}/clear", json={"comment": "nut replaced"}).json()
    assert [(event["old_status"], event["new_status"], event["reason"]) for event in cleared["events"]] == [
        (None, "active", "raised by measurement"),
        ("active", "acknowledged", "nut ordered"),
        ("acknowledged", "cleared", "nut replaced"),
    ]
    assert worn.http.get(path).json() == cleared
    assert_problem(worn.http.post(f"{path}/clear", json={"comment": "again"}), 409, "conflict")
    axis = worn.axis("worn")
    assert (axis["state"], axis["open_alarms"]) == ("unknown", 0)
    assert worn.http.get("/v1/alarms", params={"axis": "worn", "status": "active"}).json()["alarms"] == []
    windows = simulated_measurement(
        np.random.default_rng(2), "new nut", started_at=START + timedelta(days=30), n_windows=10
    )
    (outcome,) = worn.accept("worn", windows)["measurements"]
    assert outcome["state"] == "learning"


def test_measurement_that_arrives_late_is_put_into_the_charts_at_its_time(shared_api: Api) -> None:
    shared_api.register("past", windows_per_measurement=10)
    shared_api.calibrate("past")
    rng = np.random.default_rng(3)
    shared_api.accept("past", simulated_measurement(rng, "now", n_windows=10))
    earlier = simulated_measurement(rng, "earlier", n_windows=10, started_at=START - timedelta(days=1))
    (outcome,) = shared_api.accept("past", earlier)["measurements"]
    assert outcome["charted"]
    assert shared_api.axis("past")["state_since"] == shared_api.trend("past")[0]["at"]
    assert [point["measurement"] for point in shared_api.trend("past")] == ["earlier", "now"]


def test_measurement_that_arrives_too_late_is_shown_and_counted(shared_api: Api) -> None:
    shared_api.register("too-late", windows_per_measurement=10)
    shared_api.calibrate("too-late")
    rng = np.random.default_rng(3)
    shared_api.accept("too-late", simulated_measurement(rng, "now", n_windows=10))
    since = shared_api.axis("too-late")["state_since"]
    old = simulated_measurement(rng, "old", n_windows=10, started_at=START - timedelta(days=2000))
    (outcome,) = shared_api.accept("too-late", old)["measurements"]
    assert (outcome["charted"], outcome["uncharted"]) == (False, "too-late")
    assert outcome["preload_n"] is not None
    assert shared_api.axis("too-late")["state_since"] == since
    assert shared_api.axis("too-late")["uncharted"] == {"too-late": 1}
    assert [point["uncharted"] for point in shared_api.trend("too-late")] == ["too-late", None]
    assert 'preload_uncharted_measurements_total{reason="too-late"} 1.0' in shared_api.http.get("/metrics").text


def test_calibration_from_stored_measurements(shared_api: Api) -> None:
    """The whole guided calibration: windows with their preload → k1…k4 → activation → newtons."""
    shared_api.register("guided", windows_per_measurement=10)
    rng = np.random.default_rng(4)
    places = [(x, p) for x in (300.0, 450.0, 600.0, 700.0) for p in (100.0, 200.0, 400.0)]
    for i, (position_mm, preload) in enumerate(places):
        windows = simulated_measurement(
            rng,
            f"c{i}",
            preload=preload,
            position_mm=position_mm,
            set_preload=preload,
            started_at=START + timedelta(hours=i),
            n_windows=10,
        )
        (outcome,) = shared_api.accept("guided", windows)["measurements"]
        assert (outcome["refused"], outcome["preload_n"], outcome["uncharted"]) == (False, None, "preload-set")
        assert outcome["frequency_hz"] == pytest.approx(axial_frequency(preload, position_mm * 1e-3), abs=0.3)
    # one without a stated preload is no part of it
    shared_api.accept("guided", simulated_measurement(rng, "m0", n_windows=10, started_at=START + timedelta(days=1)))
    answer = shared_api.http.post("/v1/axes/guided/calibrations", json={"measurements": {}, "comment": "guided"})
    assert answer.status_code == 201, answer.text
    calibration = answer.json()
    assert calibration["document"]["n_readings"] == len(places)
    assert answer.headers["location"] == f"/v1/axes/guided/calibrations/{calibration['id']}"
    assert shared_api.http.get(answer.headers["location"]).json() == calibration
    shared_api.http.post(f"{answer.headers['location']}/activate", json={"reason": "reviewed"}).raise_for_status()
    windows = simulated_measurement(
        rng, "m1", preload=250.0, position_mm=500.0, n_windows=10, started_at=START + timedelta(days=2)
    )
    (outcome,) = shared_api.accept("guided", windows)["measurements"]
    low, high = outcome["interval_95_n"]
    assert low < 250.0 < high
    # the part of it from noon holds six measurements at three positions
    span = {"from": (START + timedelta(hours=6)).isoformat(), "to": (START + timedelta(hours=12)).isoformat()}
    answer = shared_api.http.post("/v1/axes/guided/calibrations", json={"measurements": span})
    assert answer.status_code in (201, 422)
    if answer.status_code == 422:
        assert_problem(answer, 422, "not-identifiable")


def test_calibrations_are_activated_and_rolled_back_with_history(shared_api: Api) -> None:
    shared_api.register("history")
    first = shared_api.calibrate("history")
    path = "/v1/axes/history/calibrations"
    none_yet = {"if-match": '"none"'}  # it was so before the first
    assert_problem(
        shared_api.http.post(f"{path}/{first}/activate", json={"reason": "x"}, headers=none_yet),
        412,
        "precondition-failed",
    )
    document = shared_api.http.get(f"{path}/{first}").json()["document"]
    second = shared_api.http.post(path, json={"document": document, "comment": "brought"}).json()
    assert second["document"]["coefficients"] == document["coefficients"]
    assert second["document"]["covariance"] == document["covariance"]
    assert not second["active"]

    stale = {"if-match": '"99"'}
    problem = assert_problem(
        shared_api.http.post(f"{path}/{second['id']}/activate", json={"reason": "x"}, headers=stale),
        412,
        "precondition-failed",
    )
    assert f'"{first}"' in problem["detail"]
    shared_api.accept("history", simulated_measurement(np.random.default_rng(5), "m"))
    assert shared_api.axis("history")["state"] == "learning"
    for number, reason in ((second["id"], "try"), (second["id"], "sent again"), (first, "roll back")):
        answer = shared_api.http.post(f"{path}/{number}/activate", json={"reason": reason})
        assert answer.status_code == 200
    overview = shared_api.http.get(path).json()
    assert [(entry["calibration"], entry["reason"]) for entry in overview["history"]] == [
        (first, "roll back"),
        (second["id"], "try"),
        (first, "test"),
    ]
    assert [item["active"] for item in overview["calibrations"]] == [False, True]
    assert shared_api.axis("history")["active_calibration"] == first
    assert shared_api.axis("history")["state"] == "unknown"  # another calibration, another baseline


def test_readings_without_scatter_are_weighted_alike(shared_api: Api) -> None:
    shared_api.register("weights")
    path = "/v1/axes/weights/calibrations"
    plain = shared_api.http.post(path, json={"readings": readings()}).json()
    assert plain["document"]["weighting"] == "none"
    scattered = [reading | {"frequency_std_hz": 0.1} for reading in readings()]
    assert shared_api.http.post(path, json={"readings": scattered}).json()["document"]["weighting"] == "std"


def test_configuration_can_be_changed_and_keeps_what_is_stored(shared_api: Api) -> None:
    shared_api.register("changed")
    shared_api.accept("changed", simulated_measurement(np.random.default_rng(6), "m1"))
    answer = shared_api.http.put("/v1/axes/changed", json={"name": "New name", "configuration": {"baseline_size": 8}})
    assert answer.status_code == 200
    assert answer.json()["name"] == "New name"
    assert answer.json()["configuration"]["windows_per_measurement"] == 15
    assert len(shared_api.trend("changed")) == 1
    assert "changed" in [axis["id"] for axis in shared_api.http.get("/v1/axes").json()["axes"]]


def test_pages_and_probes_answer(worn: Api) -> None:
    for path in ("/", "/axes/worn", "/docs"):
        page = worn.http.get(path)
        assert page.status_code == 200
        assert page.headers["content-type"].startswith("text/html")
    assert worn.http.get("/healthz").json() == {"status": "ok"}
    assert worn.http.get("/readyz").json() == {"status": "ok"}
