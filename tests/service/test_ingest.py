"""Windows in: every encoding, every repetition, every order; and what is refused."""

import base64
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import msgpack
import numpy as np
import pytest
import zstandard

from service.cli.remote.client import window_document
from service.operations.monitoring.intake import ingest
from service.store.window_format import content_sha256
from tests.service.conftest import START, Api, assert_problem, axial_frequency, running_service, simulated_measurement


def as_lists(document: dict[str, Any]) -> dict[str, Any]:
    return {key: np.frombuffer(v, "<f4").tolist() if isinstance(v, bytes) else v for key, v in document.items()}


def as_base64(document: dict[str, Any]) -> dict[str, Any]:
    return {key: base64.b64encode(v).decode() if isinstance(v, bytes) else v for key, v in document.items()}


def stored_frames(data_dir: Path) -> list[tuple[Path, bytes]]:
    """Return what requests left in the waveform files: the file and the bytes of each frame."""
    frames = []
    for file in sorted((data_dir / "raw").rglob("*.zst")):
        rest = file.read_bytes()
        while rest:
            reader = zstandard.ZstdDecompressor().decompressobj()
            reader.decompress(rest)
            frames.append((file, rest[: len(rest) - len(reader.unused_data)]))
            rest = reader.unused_data
    return frames


def test_whole_way_from_windows_to_newtons(shared_api: Api) -> None:
    shared_api.register("whole")
    shared_api.calibrate("whole")
    windows = simulated_measurement(np.random.default_rng(1), "m1", preload=250.0, position_mm=600.0)
    answer = shared_api.accept("whole", windows)
    assert answer["accepted"] == 15
    (outcome,) = answer["measurements"]
    # the fit of 15 windows scatters by some hundredths of a hertz here
    assert outcome["frequency_hz"] == pytest.approx(axial_frequency(250.0, 0.6), abs=0.2)
    low, high = outcome["interval_95_n"]
    assert low < 250.0 < high
    (point,) = shared_api.trend("whole")
    assert point["preload_n"] == outcome["preload_n"]
    assert point["interval_95_n"] == [low, high]
    assert point["state"] == "learning"
    detail = shared_api.http.get(f"/v1/axes/whole/measurements/{point['measurement_id']}").json()
    assert detail["outcome"] == outcome
    assert len(detail["windows"]) == 15
    assert len(detail["response"]["frequency_hz"]) == len(detail["response"]["real"]) > 10


def test_all_encodings_store_the_same_window(shared_api: Api) -> None:
    (window,) = simulated_measurement(np.random.default_rng(2), "m", n_windows=1)
    document = window_document(window)
    frames = []
    for axis, send in (
        ("lists", {"json": as_lists(document)}),
        ("base64", {"json": as_base64(document)}),
        ("packed", {"content": msgpack.packb(document), "headers": {"content-type": "application/msgpack"}}),
    ):
        shared_api.register(axis)
        answer = shared_api.http.post(f"/v1/axes/{axis}/windows", **send)
        assert answer.status_code == 201, answer.text
        assert answer.json()["accepted"] == 1
        (frame,) = [frame for path, frame in stored_frames(shared_api.data_dir) if path.parent.name == axis]
        frames.append(frame)
        for again in ({"json": as_lists(document)}, {"json": as_base64(document)}):
            assert shared_api.http.post(f"/v1/axes/{axis}/windows", **again).json()["already_there"] == 1
    assert frames[0] == frames[1] == frames[2]


def test_conversion_of_units_does_not_make_another_window() -> None:
    (window,) = simulated_measurement(np.random.default_rng(2), "m", n_windows=1, position_mm=512.3)
    # the same position by way of the wire: metres → millimetres → metres costs the last bit
    conditions = replace(window.conditions, position=np.nextafter(window.conditions.position, 1.0))
    assert content_sha256(replace(window, conditions=conditions)) == content_sha256(window)
    # the same samples in double precision, as a session file may hold them
    double = replace(window, excitation=window.excitation.astype(np.float64), response=window.response.astype(float))
    assert content_sha256(double) == content_sha256(window)
    other = replace(window, conditions=replace(window.conditions, position=window.conditions.position + 1e-6))
    assert content_sha256(other) != content_sha256(window)


def test_repeating_a_request_changes_nothing(shared_api: Api) -> None:
    shared_api.register("repeat")
    windows = simulated_measurement(np.random.default_rng(3), "m")
    first = shared_api.post("repeat", windows)
    before = stored_frames(shared_api.data_dir)
    second = shared_api.post("repeat", windows, complete=True)
    assert (first.status_code, second.status_code) == (201, 200)
    assert second.json()["already_there"] == 15
    assert second.json()["measurements"] == first.json()["measurements"]  # who missed the answer gets it now
    assert stored_frames(shared_api.data_dir) == before
    assert len(shared_api.trend("repeat")) == 1


def test_window_twice_in_one_request_is_stored_once(shared_api: Api) -> None:
    shared_api.register("twice")
    (window,) = simulated_measurement(np.random.default_rng(3), "m", n_windows=1)
    answer = shared_api.accept("twice", [window, window])
    assert [item["status"] for item in answer["windows"]] == ["accepted", "already-there"]
    assert (answer["accepted"], answer["already_there"]) == (1, 1)


def test_conflicting_window_is_refused_and_nothing_of_its_request_stored(shared_api: Api) -> None:
    shared_api.register("conflict")
    rng = np.random.default_rng(4)
    first, *others = simulated_measurement(rng, "m", n_windows=4)
    shared_api.accept("conflict", [first])
    before = stored_frames(shared_api.data_dir)
    (contradiction,) = simulated_measurement(rng, "m", n_windows=1)
    problem = assert_problem(shared_api.post("conflict", [*others, contradiction]), 409, "conflict")
    assert "2026-03-02T06:00:00Z" in problem["detail"]
    # also when the two contradict each other within one request
    at_odds = [others[0], replace(others[0], response=others[1].response)]
    assert_problem(shared_api.post("conflict", at_odds), 409, "conflict")
    assert stored_frames(shared_api.data_dir) == before
    assert shared_api.accept("conflict", others)["accepted"] == 3


def test_one_by_one_in_any_order_gives_what_one_request_gives(shared_api: Api) -> None:
    windows = simulated_measurement(np.random.default_rng(5), "m")
    outcomes = []
    for axis, requests in (
        ("at-once", [windows]),
        ("one-by-one", [[window] for window in windows]),
        ("shuffled", [[windows[i]] for i in np.random.default_rng(5).permutation(15)]),
    ):
        shared_api.register(axis)
        shared_api.calibrate(axis)
        answers = [shared_api.accept(axis, request) for request in requests]
        assert all(answer["measurements"] == [] for answer in answers[:-1])
        (outcome,) = answers[-1]["measurements"]
        outcomes.append({key: value for key, value in outcome.items() if key not in ("measurement_id", "calibration")})
    assert outcomes[0]["preload_n"] is not None
    assert outcomes[1] == outcomes[0]
    assert outcomes[2] == outcomes[0]


@pytest.mark.parametrize(("n_windows", "minimum"), [(1, 2), (7, 8)])
def test_too_few_averages_are_never_judged(shared_api: Api, n_windows: int, minimum: int) -> None:
    axis = f"few-{n_windows}"
    shared_api.register(axis, minimum_averages=minimum)
    shared_api.calibrate(axis)
    windows = simulated_measurement(np.random.default_rng(6), "m", n_windows=n_windows)
    (outcome,) = shared_api.accept(axis, windows, complete=True)["measurements"]
    assert outcome["refused"]
    assert outcome["reason"] == "too-few-averages"
    assert outcome["preload_n"] is None
    assert shared_api.axis(axis)["state"] == "unknown"


def test_late_window_changes_the_value_as_if_it_had_come_in_time(shared_api: Api) -> None:
    shared_api.register("late")
    shared_api.register("in-time", windows_per_measurement=16)
    *windows, late = simulated_measurement(np.random.default_rng(7), "m", n_windows=16)
    shared_api.accept("late", windows)
    (before,) = shared_api.trend("late")
    (outcome,) = shared_api.accept("late", [late])["measurements"]
    assert outcome["frequency_hz"] != before["frequency_hz"]
    shared_api.accept("in-time", [*windows, late])
    (after,), (in_time,) = shared_api.trend("late"), shared_api.trend("in-time")
    assert after | {"measurement_id": 0} == in_time | {"measurement_id": 0}


def test_window_from_a_clock_ahead_is_stored_and_refused(shared_api: Api) -> None:
    shared_api.register("ahead", windows_per_measurement=8)
    rng, ahead = np.random.default_rng(7), datetime.now(UTC) + timedelta(minutes=11)
    answer = shared_api.accept("ahead", simulated_measurement(rng, "m", n_windows=8, started_at=ahead))
    assert {window["reason"] for window in answer["windows"]} == {"clock-ahead"}
    assert shared_api.axis("ahead")["refused_windows"] == {"clock-ahead": 8}
    # what is measured afterwards is not too old for it
    (outcome,) = shared_api.accept("ahead", simulated_measurement(rng, "n", n_windows=8))["measurements"]
    assert outcome["frequency_hz"] is not None


def test_place_that_is_left_ends_a_measurement(shared_api: Api) -> None:
    shared_api.register("elsewhere")
    windows = simulated_measurement(np.random.default_rng(8), "m", n_windows=9)
    windows[3] = replace(windows[3], conditions=replace(windows[3].conditions, position=0.6))
    answer = shared_api.accept("elsewhere", windows, complete=True)
    assert answer["accepted"] == 9
    assert [outcome.get("n_averages") for outcome in answer["measurements"]] == [
        pytest.approx(3.0, abs=1e-9), None, pytest.approx(5.0, abs=1e-9)
    ]  # fmt: skip
    (alone,) = [point for point in shared_api.trend("elsewhere") if point["refusal_reason"] == "too-few-averages"]
    assert alone["position_mm"] == pytest.approx(600.0)


def test_bad_windows_are_stored_refused_and_counted(shared_api: Api) -> None:
    shared_api.register("bad", sample_rate_hz=1024.0)
    windows = simulated_measurement(np.random.default_rng(9), "m", n_windows=15)
    nan = windows[0].response.copy()
    nan[100] = np.nan
    windows[0] = replace(windows[0], response=nan)
    windows[1] = replace(windows[1], response=np.zeros_like(nan))
    windows[2] = replace(windows[2], position_span=0.5)
    windows[3] = replace(windows[3], sample_rate=2048.0)
    answer = shared_api.accept("bad", windows, complete=True)
    assert (answer["accepted"], answer["refused"]) == (11, 4)
    counts = {"not-finite": 1, "dead-channel": 1, "position-span-too-wide": 1, "sample-rate-mismatch": 1}
    assert shared_api.axis("bad")["refused_windows"] == counts
    metrics = shared_api.http.get("/metrics").text
    for reason in counts:
        assert f'preload_windows_total{{outcome="{reason}"}} 1.0' in metrics
    assert shared_api.accept("bad", windows)["already_there"] == 15  # NaN equals itself where windows are compared


def test_measurement_closes_by_time_and_not_by_the_next_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ingest, "CLOSED_EVERY_S", 0.2)
    rng = np.random.default_rng(10)
    with running_service(tmp_path) as api:
        api.register("next", measurement_timeout_s=2.0)
        api.accept("next", simulated_measurement(rng, "m1", n_windows=9))
        later = simulated_measurement(rng, "m2", n_windows=15, started_at=START + timedelta(hours=8))
        answer = api.accept("next", later)
        assert [outcome["measurement"] for outcome in answer["measurements"]] == ["m2"]
        deadline = time.monotonic() + 60.0
        while len(api.trend("next")) < 2 and time.monotonic() < deadline:
            time.sleep(0.1)
        assert [point["measurement"] for point in api.trend("next")] == ["m1", "m2"]


def test_silent_axis_is_unknown(shared_api: Api) -> None:
    shared_api.register("silent", silent_after_hours=24.0)
    shared_api.calibrate("silent")
    windows = simulated_measurement(np.random.default_rng(11), "m", started_at=START - timedelta(days=365))
    (outcome,) = shared_api.accept("silent", windows)["measurements"]
    assert outcome["state"] == "learning"  # so it stood after that measurement; it is a year ago
    axis = shared_api.axis("silent")
    assert axis["state"] == "unknown"
    assert axis["state_since"].startswith("2025-03-03T06:00:00")


def test_restart_keeps_everything(tmp_path: Path) -> None:
    rng = np.random.default_rng(12)
    windows = simulated_measurement(rng, "m1")
    following = simulated_measurement(rng, "m2", started_at=START + timedelta(hours=1))
    with running_service(tmp_path) as api:
        api.register("axis")
        api.calibrate("axis")
        api.accept("axis", windows)
        before = api.axis("axis"), api.trend("axis"), api.http.get("/v1/axes/axis/calibrations").json()
    with running_service(tmp_path) as api:
        assert (api.axis("axis"), api.trend("axis"), api.http.get("/v1/axes/axis/calibrations").json()) == before
        assert api.accept("axis", windows)["already_there"] == 15
        (outcome,) = api.accept("axis", following)["measurements"]
        assert outcome["state"] == "learning"
        assert len(api.trend("axis")) == 2


def test_damaged_waveform_is_a_named_refusal(tmp_path: Path) -> None:
    *windows, last = simulated_measurement(np.random.default_rng(13), "m", set_preload=300.0)
    with running_service(tmp_path) as api:
        api.register("axis")
        api.accept("axis", windows)
        ((file, _),) = stored_frames(tmp_path)
        content = bytearray(file.read_bytes())
        content[len(content) // 2] ^= 1
        file.write_bytes(content)
    with running_service(tmp_path) as api:  # started again: nothing is remembered
        (outcome,) = api.accept("axis", [last])["measurements"]
        assert (outcome["refused"], outcome["reason"]) == (True, "waveform-damaged")
        assert_problem(api.http.post("/v1/axes/axis/calibrations", json={"measurements": {}}), 500, "waveform-damaged")
        file.unlink()
        assert_problem(api.http.post("/v1/axes/axis/calibrations", json={"measurements": {}}), 500, "waveform-damaged")


def test_axes_in_parallel_and_one_axis_from_two_threads(shared_api: Api) -> None:
    """No window is lost or stored twice, whoever posts when; each measurement is judged once."""
    url = shared_api.http.base_url
    sessions = {}
    for number, axis in enumerate(("left", "right")):
        shared_api.register(axis)
        rng = np.random.default_rng(20 + number)
        sessions[axis] = [
            simulated_measurement(rng, f"m{i}", n_windows=8, started_at=START + timedelta(hours=i)) for i in range(4)
        ]

    def post_all(axis: str) -> list[dict[str, Any]]:
        with httpx.Client(base_url=url, timeout=60.0, trust_env=False) as http:
            api = Api(http, shared_api.data_dir)
            halves = [half for windows in sessions[axis] for half in (windows[:4], windows)]
            return [api.accept(axis, half, complete=len(half) == 8) for half in halves]

    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(post_all, ["left", "right", "left", "right"]))
    for axis, mine in (("left", answers[0::2]), ("right", answers[1::2])):
        stored = [item for answer in mine for item in answer]
        counts = {key: sum(answer[key] for answer in stored) for key in ("accepted", "refused", "already_there")}
        assert counts["refused"] == 0
        assert counts["accepted"] == 4 * 8
        points = shared_api.trend(axis)
        assert [point["measurement"] for point in points] == ["m0", "m1", "m2", "m3"]
        for point in points:
            detail = shared_api.http.get(f"/v1/axes/{axis}/measurements/{point['measurement_id']}").json()
            assert len(detail["windows"]) == 8
