"""The client in Python: what it reads is what the service says, and it repeats what may be repeated."""

import asyncio
import inspect
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import preload_client
from monitor_core.recording import Session
from monitor_core.recordings.session_hdf5 import write_session
from preload_client import AsyncClient, Client, JobFailedError, ProblemError, UnreachableError, client
from service.app import create_app
from service.cli.remote.client import window_document
from service.settings import Settings
from tests.conftest import free_port
from tests.service.conftest import K3, START, Api, readings, simulated_measurement
from tests.service.uploads import recorded


def test_it_brings_no_more_than_httpx() -> None:
    heavy = ("numpy", "fastapi", "pydantic", "sqlalchemy", "monitor_core", "service")
    code = f"import sys, preload_client; print([name for name in {heavy} if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


@pytest.fixture(scope="module")
def schemas() -> dict[str, Any]:
    return create_app(Settings()).openapi()["components"]["schemas"]


@pytest.mark.parametrize(
    ("record", "schema"),
    [
        (preload_client.Axis, "AxisOut"), (preload_client.TrendPoint, "TrendPointOut"),
        (preload_client.WindowStatus, "WindowOut"), (preload_client.Receipt, "WindowsOut"),
        (preload_client.AlarmEvent, "AlarmEventOut"), (preload_client.Alarm, "AlarmOut"),
        (preload_client.Job, "JobOut"), (preload_client.Calibration, "CalibrationOut"),
        (preload_client.Calibrations, "CalibrationsOut"), (preload_client.MaintenanceEntry, "MaintenanceOut"),
        (preload_client.Measurement, "MeasurementOut"),
    ],
)  # fmt: skip
def test_records_have_the_members_of_the_api(schemas: dict[str, Any], record: Any, schema: str) -> None:
    assert list(record.__annotations__) == list(schemas[schema]["properties"])


@pytest.fixture(scope="module")
def service(shared_api: Api) -> Iterator[Client]:
    shared_api.register("mill")
    shared_api.calibrate("mill")
    with Client(str(shared_api.http.base_url)) as opened:
        yield opened


def test_windows_in_and_trend_out(service: Client, shared_api: Api, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    windows = [window_document(window) for window in simulated_measurement(rng, "m", n_windows=4)]
    for window in windows:
        window["response"] = np.frombuffer(window["response"], "<f4").astype(float)  # type: ignore[arg-type]
    assert service.post_windows("mill", windows, complete=True)["accepted"] == 4
    windows[0]["excitation"] = np.frombuffer(windows[0]["excitation"], "<f4").tolist()  # type: ignore[arg-type]
    assert service.post_windows("mill", windows, complete=True)["already_there"] == 4
    point = next(service.trend("mill"))
    assert [point] == shared_api.trend("mill")
    arrays = service.trend_arrays("mill")
    assert arrays["preload_n"].tolist() == [point["preload_n"]]
    assert arrays["at"][0] == np.datetime64("2026-03-02T06:00:00")
    assert arrays["lower_n"][0] < arrays["preload_n"][0] < arrays["upper_n"][0]
    assert service.axis("mill") in service.axes()
    table = service.table("/v1/axes/mill/trend", tmp_path / "trend.parquet")
    assert pq.read_table(table)["preload_n"].to_pylist() == [point["preload_n"]]


def test_an_axis_is_calibrated_and_its_maintenance_told(service: Client, shared_api: Api) -> None:
    shared_api.register("lathe")
    fitted = service.calibrate("lathe", readings=readings(), comment="new nut")
    assert (fitted["comment"], fitted["active"]) == ("new nut", False)
    assert fitted["document"]["coefficients"]["k3_s2_n13"] == pytest.approx(K3, rel=0.05)
    brought = service.calibrate("lathe", document=fitted["document"])
    assert service.activate("lathe", brought["id"], "reviewed")["history"][0]["calibration"] == brought["id"]
    assert [each["active"] for each in service.request("GET", "/v1/axes/lathe/calibrations")["calibrations"]] == [
        True, False
    ]  # fmt: skip
    with pytest.raises(ProblemError, match="/calibrations was refused with 422: "):
        service.calibrate("lathe", start=START)
    entry = service.post_maintenance("lathe", START, "Anna", "lubricated", note="grease")
    assert service.post_maintenance("lathe", START.isoformat(), "Anna", "lubricated", note="grease") == entry
    assert service.maintenance("lathe") == [entry]


def test_an_event_loop_asks_what_a_caller_who_waits_asks(service: Client, shared_api: Api, tmp_path: Path) -> None:
    """One description of requests, two who send them: each answers the other's questions alike, many at once."""
    shared_api.register("press")
    shared_api.calibrate("press")
    url = str(shared_api.http.base_url)
    session = tmp_path / "press.session.h5"
    write_session(session, Session("press", tuple(recorded(n_measurements=7))))

    async def ask() -> tuple[list[Any], list[Any], Any, Path]:
        async with AsyncClient(url) as client:
            await client.wait(await client.upload("press", [session]), every_s=0.01)
            axes = await asyncio.gather(*[client.axis("press") for _ in range(20)])
            points = [point async for point in client.trend("press")]
            with pytest.raises(ProblemError, match="no axis 'nobody'"):
                await client.axis("nobody")
            measurement = await client.measurement("press", points[0]["measurement_id"])
            return axes, points, measurement, await client.table("/v1/axes/press/trend", tmp_path / "trend.parquet")

    axes, points, measurement, table = asyncio.run(ask())
    assert axes == in_a_notebook(
        url, lambda client: 20 * [next(each for each in client.axes() if each["id"] == "press")]
    )
    assert len(points) == 7
    assert points == list(service.trend("press"))
    assert measurement == service.measurement("press", points[0]["measurement_id"])
    assert measurement["outcome"]["preload_n"] == points[0]["preload_n"]
    assert pq.read_table(table)["preload_n"].to_pylist() == [point["preload_n"] for point in points]


def test_both_clients_have_the_same_methods() -> None:
    def methods(of: type) -> dict[str, list[str]]:
        return {
            name: list(inspect.signature(member).parameters)
            for name, member in inspect.getmembers(of, inspect.isfunction)
            if not name.startswith("_")
        }

    assert methods(Client) == methods(AsyncClient)


def test_an_upload_is_waited_for_with_its_progress(service: Client, tmp_path: Path) -> None:
    service.register("saw", "Saw")
    session = tmp_path / "saw.session.h5"
    write_session(session, Session("saw", tuple(recorded(n_measurements=7))))
    seen: list[int] = []
    job = service.wait(service.upload("saw", [session]), lambda each: seen.append(each["done"]), every_s=0.01)
    assert seen == sorted(seen)
    assert seen[-1] == job["total"] > 0
    assert job in service.jobs("saw")
    assert len(list(service.records("/v1/axes/saw/trend", "points", {"limit": 3}))) > 6  # several pages


def test_a_refusal_carries_its_document(service: Client) -> None:
    with pytest.raises(ProblemError, match="GET /v1/axes/nobody was refused with 404: ") as caught:
        service.axis("nobody")
    assert (caught.value.status, caught.value.name) == (404, "unknown-resource")
    assert caught.value.document["detail"] == caught.value.detail
    with pytest.raises(ProblemError, match="Input should be 'csv' or 'parquet'; got 'xml'"):
        service.table("/v1/alarms", "alarms.xml")
    with pytest.raises(ValueError, match="/v1/machines is no table"):
        service.table("/v1/machines", "machines.csv")
    with pytest.raises(ProblemError, match="no alarm"):
        service.acknowledge(7, "seen")


def test_a_job_that_fails_is_an_error() -> None:
    job = {"id": "7", "kind": "replay", "axis": "a", "status": "failed", "error": "no room"}
    with answering([(200, job)]) as (url, _), pytest.raises(JobFailedError, match="is failed: no room"):
        Client(url).wait(job)  # type: ignore[arg-type]


@contextmanager
def answering(answers: list[tuple[int, object]]) -> Iterator[tuple[str, list[str]]]:
    """Answer requests as stated, one after another (0: break the connection); yield the address and what was asked."""
    asked: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.rfile.read(int(self.headers.get("content-length", 0)))
            asked.append(self.command)
            status, document = answers[min(len(asked), len(answers)) - 1]
            if status == 0:
                self.close_connection = True
                return
            self.send_response(status)
            self.send_header("Content-Type", "application/json" if status < 300 else "application/problem+json")
            self.send_header("Retry-After", "1")
            body = document if isinstance(document, bytes) else json.dumps(document).encode()
            if body.startswith(BROKEN_GZIP):
                self.send_header("Content-Encoding", "gzip")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        do_POST = do_PUT = do_GET  # noqa: N815 - the names of the library

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", asked
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def at_once(url: str, ask: Callable[[Any], Any], **settings: Any) -> object:
    with Client(url, **settings) as service:
        return ask(service)


def in_a_loop(url: str, ask: Callable[[Any], Any], **settings: Any) -> object:
    async def run() -> object:
        async with AsyncClient(url, **settings) as service:
            return await ask(service)

    return asyncio.run(run())


def in_a_notebook(url: str, ask: Callable[[Any], Any], **settings: Any) -> object:
    """Ask as a caller who waits, where an event loop runs in the same thread."""

    async def run() -> object:
        return at_once(url, ask, **settings)

    return asyncio.run(run())


BROKEN_GZIP = b"\x1f\x8b and no more of it"
BUSY, BROKEN, FINE = (503, {"detail": "busy"}), (0, None), (200, {"id": "a", "next_cursor": None})


@pytest.mark.parametrize(
    ("answers", "ask", "n_asked", "error"),
    [
        ([BUSY, BUSY, FINE], lambda c: c.acknowledge(1, "seen"), 3, None),  # nothing was changed
        ([BROKEN, FINE], lambda c: c.axis("a"), 2, None),
        ([BROKEN, FINE], lambda c: c.post_windows("a", []), 2, None),
        ([(502, {"detail": "gone"}), FINE], lambda c: c.post_windows("a", []), 2, None),
        ([BROKEN, FINE], lambda c: c.acknowledge(1, "seen"), 1, UnreachableError),  # it may have been carried out
        ([(502, {"detail": "gone"}), FINE], lambda c: c.clear(1, "seen"), 1, ProblemError),
        ([(409, {"detail": "no"}), FINE], lambda c: c.axis("a"), 1, ProblemError),
        ([BUSY], lambda c: c.axis("a"), 6, ProblemError),
        ([(200, "<p>Welcome</p>")], lambda c: c.axis("a"), 1, UnreachableError),
        ([FINE], lambda c: c.axes(), 1, UnreachableError),
        ([FINE], lambda c: c.maintenance("a"), 1, UnreachableError),
        ([(200, BROKEN_GZIP)], lambda c: c.axis("a"), 1, UnreachableError),
        ([(200, b"[" * 100_000)], lambda c: c.axis("a"), 1, UnreachableError),
        ([(500, b"<p>Sorry</p>")], lambda c: c.axis("a"), 1, ProblemError),
        ([(500, [])], lambda c: c.axis("a"), 1, ProblemError),
        ([(500, b"[" * 100_000)], lambda c: c.axis("a"), 1, ProblemError),
        ([FINE], lambda c: c.request("GET", "http://[::1"), 0, UnreachableError),
    ],
)
def test_what_may_be_repeated_is(
    answers: Any, ask: Any, n_asked: int, error: type[Exception] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits: list[float] = []

    async def wait(_: AsyncClient, seconds: float) -> None:
        waits.append(seconds)

    monkeypatch.setattr(client.time, "sleep", waits.append)
    monkeypatch.setattr(AsyncClient, "_pause", wait)
    for asked_by in (at_once, in_a_notebook, in_a_loop):
        waits.clear()
        with answering(answers) as (url, asked):
            with nullcontext() if error is None else pytest.raises(error):
                asked_by(url, ask)
            assert len(asked) == n_asked
        assert len(waits) == max(n_asked - 1, 0)
        assert waits == sorted(waits)
        assert max(waits, default=0.0) <= 30.0


def test_who_does_not_listen_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []
    monkeypatch.setattr(client.time, "sleep", waits.append)
    with Client(f"http://127.0.0.1:{free_port()}") as nobody, pytest.raises(UnreachableError, match="no answer from"):
        nobody.acknowledge(1, "seen")
    assert waits == [0.5, 1.0, 2.0, 4.0, 8.0]


def test_what_is_no_table_and_no_address_is_an_error_of_the_client(tmp_path: Path) -> None:
    for asked_by in (at_once, in_a_loop):
        with answering([(200, BROKEN_GZIP)]) as (url, _), pytest.raises(UnreachableError, match=url):
            asked_by(url, lambda c: c.table("/v1/axes/a/trend", tmp_path / "trend.json"))
        with pytest.raises(UnreachableError, match="Invalid port"):
            asked_by("http://[::1", lambda c: c.axes())
