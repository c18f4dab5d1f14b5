"""A history judged anew says, byte for byte, what a new service says that is fed the same windows."""

import json
import shutil
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from monitor_core.recording import Window
from service.operations.monitoring import rejudgements
from tests.conftest import free_port
from tests.service.arrivals import AXIS, history, said_of
from tests.service.conftest import (
    START,
    Api,
    ServerProcess,
    assert_problem,
    readings,
    running_service,
    simulated_measurement,
)

CONFIGURATION = {
    "windows_per_measurement": 3,
    "minimum_averages": 2,
    "measurement_timeout_s": 1e6,
    "measurement_pause_s": 600.0,
    "baseline_size": 5,
}


def other_readings() -> list[dict[str, float]]:
    """Return a modal table whose preloads are a tenth higher, and whose positions are 30 mm off."""
    rng = np.random.default_rng(9)
    return [
        row | {"preload_n": 1.1 * row["preload_n"], "frequency_hz": row["frequency_hz"] + rng.normal(0.0, 0.2)}
        for row in readings()
    ]


def with_both(api: Api, *, active: int) -> None:
    """Register the axis, store two calibrations, and put one of them in force."""
    api.register(AXIS, **CONFIGURATION)
    for table in (readings(), other_readings()):
        answer = api.http.post(f"/v1/axes/{AXIS}/calibrations", json={"readings": table})
        assert answer.status_code == 201, answer.text
    answer = api.http.post(f"/v1/axes/{AXIS}/calibrations/{active}/activate", json={"reason": "test"})
    assert answer.status_code == 200, answer.text


def feed(api: Api, windows: list[Window]) -> None:
    for window in windows:
        api.accept(AXIS, [window])
    first = {window.measurement: window for window in reversed(windows)}
    api.accept(AXIS, list(first.values()), complete=True)


def start(api: Api, **asked: Any) -> dict[str, Any]:
    answer = api.http.post(f"/v1/axes/{AXIS}/rejudgements", json=asked)
    assert answer.status_code == 202, answer.text
    return answer.json()


def ended(api: Api, job: dict[str, Any]) -> dict[str, Any]:
    deadline = time.monotonic() + 60.0
    while (found := api.http.get(f"/v1/jobs/{job['id']}").json())["status"] in ("queued", "running"):
        assert time.monotonic() < deadline, found
        time.sleep(0.02)
    return found


def as_bytes(document: object) -> bytes:
    return json.dumps(document, sort_keys=True).encode()


@pytest.fixture(scope="module")
def windows() -> list[Window]:
    return history(5, 28)


@pytest.fixture(scope="module")
def under_first(windows: list[Window], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the data folder of a service that took all windows under the first calibration."""
    folder = tmp_path_factory.mktemp("first") / "var"
    with running_service(folder) as api:
        with_both(api, active=1)
        feed(api, windows)
    return folder


@pytest.fixture(scope="module")
def under_second(windows: list[Window], tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """Return what a new service says that was fed the windows under the second calibration."""
    with running_service(tmp_path_factory.mktemp("second") / "var") as api:
        with_both(api, active=2)
        feed(api, windows)
        return said_of(api)


@pytest.fixture
def service(under_first: Path, tmp_path: Path) -> Iterator[Api]:
    shutil.copytree(under_first, tmp_path / "var")
    with running_service(tmp_path / "var") as api:
        yield api


@contextmanager
def held_up(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], None]]:
    """Hold a job up before its second measurement until it is let go on."""
    reached, may_go_on, real = threading.Event(), threading.Event(), rejudgements.judged_anew

    def wait(*arguments: Any) -> Any:
        if reached.is_set():
            may_go_on.wait(30.0)
        reached.set()
        return real(*arguments)

    monkeypatch.setattr(rejudgements, "AT_ONCE", 1)
    monkeypatch.setattr(rejudgements, "judged_anew", wait)
    yield may_go_on.set
    may_go_on.set()


@pytest.mark.release
def test_it_says_what_a_new_service_says_byte_for_byte(service: Api, under_second: dict[str, object]) -> None:
    before = said_of(service)
    assert as_bytes(before) != as_bytes(under_second)
    job = ended(service, start(service, calibration=2))
    assert (job["status"], job["done"], job["total"]) == ("done", 29, 29)  # one has a window elsewhere, on its own
    assert as_bytes(said_of(service)) == as_bytes(under_second)
    column = job["result"]["new"]
    assert column["n_alarms"] == 1
    assert column["median_preload_n"] > 1.05 * job["result"]["old"]["median_preload_n"]
    back = ended(service, start(service, calibration=1))
    assert back["status"] == "done"
    assert as_bytes(said_of(service)) == as_bytes(before)


@pytest.mark.release
def test_one_that_ended_as_the_service_did_is_not_done_twice(under_first: Path, tmp_path: Path) -> None:
    """Everything stands with its comparison; only that the job is done was not stored any more."""
    shutil.copytree(under_first, tmp_path / "var")
    with running_service(tmp_path / "var") as api:
        job = ended(api, start(api, calibration=2))
        stands = said_of(api)
    with closing(sqlite3.connect(tmp_path / "var" / "preload.db")) as database:
        database.execute("UPDATE jobs SET status = 'running' WHERE id = ?", (job["id"],))
        database.commit()
    with running_service(tmp_path / "var") as api:
        again = ended(api, job)
        assert (again["status"], again["result"]) == ("done", job["result"])
        assert as_bytes(said_of(api)) == as_bytes(stands)


def test_a_dry_run_compares_and_changes_nothing(service: Api) -> None:
    before, etag = said_of(service), service.http.get(f"/v1/axes/{AXIS}/trend").headers["etag"]
    job = ended(service, start(service, calibration=2, dry_run=True))
    assert as_bytes(said_of(service)) == as_bytes(before)
    assert service.http.get(f"/v1/axes/{AXIS}/trend").headers["etag"] == etag
    result = job["result"]
    assert result["dry_run"]
    assert (result["old"]["calibration"], result["new"]["calibration"]) == (1, 2)
    (alarm,) = service.http.get("/v1/alarms").json()["alarms"]
    assert result["old"]["first_alarm_at"] == alarm["evidence"]["at"]
    assert result["old"]["states"].keys() >= {"learning", "normal", "alarm"}
    done = ended(service, start(service, calibration=2))["result"]
    assert done == result | {"dry_run": False}


def test_until_it_is_done_the_old_values_are_stale(service: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    with held_up(monkeypatch) as go_on:
        job = start(service, calibration=2)
        stale = {"job": job["id"], "calibration": 2}
        assert service.axis(AXIS)["stale"] == stale
        answer = service.http.get(f"/v1/axes/{AXIS}/trend")
        assert answer.json()["stale"] == stale
        assert service.http.get(f"/v1/axes/{AXIS}/history").json()["stale"] == stale
        assert service.http.get("/v1/axes").json()["axes"][0]["stale"] == stale
        refused = service.http.post(f"/v1/axes/{AXIS}/rejudgements", json={"calibration": 1})
        assert job["id"] in assert_problem(refused, 409, "conflict")["detail"]
        go_on()
        assert ended(service, job)["status"] == "done"
    assert service.axis(AXIS)["stale"] is None


@pytest.mark.release
def test_windows_that_come_meanwhile_count(
    service: Api, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, windows: list[Window]
) -> None:
    more = simulated_measurement(
        np.random.default_rng(77), "new", preload=240.0, started_at=START + timedelta(days=30), n_windows=3
    )
    late = simulated_measurement(
        np.random.default_rng(78), "late", preload=300.0, started_at=START + timedelta(days=1, hours=3), n_windows=2
    )
    with held_up(monkeypatch) as go_on:
        job = start(service, calibration=2)
        assert service.accept(AXIS, more)["measurements"][0]["calibration"] == 1
        service.accept(AXIS, late)  # still open when the rest is judged anew
        go_on()
        assert ended(service, job)["status"] == "done"
    service.accept(AXIS, late[:1], complete=True)
    with running_service(tmp_path / "new") as api:
        with_both(api, active=2)
        feed(api, [*windows, *more, *late])
        assert as_bytes(said_of(service)) == as_bytes(said_of(api))


@pytest.mark.release
def test_measurements_that_are_joined_meanwhile_are_judged_as_one(
    service: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second of them is gone between being read and being kept aside."""
    parts = [
        simulated_measurement(
            np.random.default_rng(79), "bridged", preload=300.0, started_at=START + timedelta(minutes=at), n_windows=2
        )
        for at in (-100, -93, -86)
    ]
    for part in (parts[0], parts[2]):
        service.accept(AXIS, part, complete=True)
    n_before = len(service.trend(AXIS))
    with held_up(monkeypatch) as go_on:
        job = start(service, calibration=2)
        while service.http.get(f"/v1/jobs/{job['id']}").json()["done"] == 0:  # it is at the second
            time.sleep(0.02)
        service.accept(AXIS, parts[1], complete=True)
        go_on()
        assert ended(service, job)["status"] == "done"
    after = service.trend(AXIS)
    assert len(after) == n_before - 1
    assert {point["calibration"] for point in after if point["preload_n"]} == {2}
    view = service.http.get(f"/v1/axes/{AXIS}/measurements/{after[0]['measurement_id']}").json()
    assert (view["outcome"]["measurement"], round(view["outcome"]["n_averages"])) == ("bridged", 6)


@pytest.mark.release
def test_a_cancelled_one_leaves_everything_as_it_was(service: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    before = said_of(service)
    with held_up(monkeypatch) as go_on:
        job = start(service, calibration=2)
        assert service.http.post(f"/v1/jobs/{job['id']}/cancel").json()["status"] == "cancelled"
        go_on()
    assert as_bytes(said_of(service)) == as_bytes(before)
    assert ended(service, start(service, calibration=2))["status"] == "done"


def test_what_has_no_waveform_any_more_stands_as_it_was(service: Api) -> None:
    before = {point["measurement"]: point for point in service.trend(AXIS)}
    for path in sorted((service.data_dir / "raw").rglob("*.zst")):
        content = path.read_bytes()
        path.write_bytes(content[: len(content) // 2])
    shutil.copytree(service.data_dir, service.data_dir.with_name("restarted"))
    with running_service(service.data_dir.with_name("restarted")) as api:  # it remembers no windows
        result = ended(api, start(api, calibration=2))["result"]
        after = {point["measurement"]: point for point in api.trend(AXIS)}
        gone = [name for name, point in after.items() if point["uncharted"] == "waveform-gone"]
        assert 0 < len(gone) < len(after)
        assert result["waveforms_gone"] >= len(gone)
        assert all(after[name]["preload_n"] == before[name]["preload_n"] for name in gone)
        assert {after[name]["calibration"] for name in gone} == {1}
        assert {after[name]["calibration"] for name in after.keys() - gone if after[name]["preload_n"]} == {2}
        assert api.axis(AXIS)["uncharted"]["waveform-gone"] == len(gone)


def test_part_of_a_history_begins_its_charts_where_it_begins(service: Api) -> None:
    before = service.trend(AXIS)
    middle = before[12]["at"]
    refused = service.http.post(f"/v1/axes/{AXIS}/rejudgements", json={"calibration": 2, "to": middle})
    assert_problem(refused, 422, "invalid-request")
    assert ended(service, start(service, **{"calibration": 2, "from": middle}))["status"] == "done"
    after = service.trend(AXIS)
    assert after[:12] == before[:12]
    assert {point["calibration"] for point in after[12:]} == {2}
    assert after[12]["state"] == "learning"


@pytest.mark.release
def test_inspections_and_new_nuts_begin_where_they_did(
    under_first: Path, tmp_path: Path, windows: list[Window]
) -> None:
    nut = {"at": (START + timedelta(days=9.9)).isoformat(), "who": "Anna", "kind": "nut-replaced"}
    shutil.copytree(under_first, tmp_path / "var")
    with running_service(tmp_path / "var") as api, running_service(tmp_path / "new") as new:
        api.http.post(f"/v1/axes/{AXIS}/maintenance", json=nut).raise_for_status()
        assert ended(api, start(api, calibration=2))["status"] == "done"
        with_both(new, active=2)
        feed(new, windows)
        new.http.post(f"/v1/axes/{AXIS}/maintenance", json=nut).raise_for_status()
        found, wanted = (said_of(service) for service in (api, new))
        assert as_bytes(found) == as_bytes(wanted)


def test_it_goes_on_after_kill_9(
    under_first: Path, tmp_path: Path, fork_server: Callable[..., ServerProcess], under_second: dict[str, object]
) -> None:
    shutil.copytree(under_first, tmp_path / "var")
    port = free_port()

    def n_aside() -> int:
        with closing(sqlite3.connect(tmp_path / "var" / "preload.db")) as database:
            return int(database.execute("SELECT count(*) FROM rejudged_measurements").fetchone()[0])

    def is_half_way() -> bool:
        return 0 < n_aside() < 28

    job: dict[str, Any] | None = None
    for is_time in (lambda: True, is_half_way, lambda: True):  # before anything, half way, and at once after it
        server = fork_server(tmp_path / "var", port)
        server.wait_until_up()
        with httpx.Client(base_url=server.url, trust_env=False, timeout=60.0) as http:
            job = job or start(Api(http, tmp_path / "var"), calibration=2)
            while not is_time():
                assert http.get(f"/v1/jobs/{job['id']}").json()["status"] in ("queued", "running")
        server.process.kill()
        server.process.wait()
    assert n_aside() > 0
    server = fork_server(tmp_path / "var", port)
    server.wait_until_up()
    with httpx.Client(base_url=server.url, trust_env=False, timeout=60.0) as http:
        api = Api(http, tmp_path / "var")
        assert job is not None
        assert ended(api, job)["status"] == "done"
        assert as_bytes(said_of(api)) == as_bytes(under_second)
    assert n_aside() == 0
