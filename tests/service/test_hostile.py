"""Bodies, headers, senders and pages that mean harm, or do not know better: bounded, named, and nothing is changed."""

import asyncio
import base64
import json
import socket
import time
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
import zstandard
from hypothesis import given, strategies as st

from monitor_core.recordings.model_file import RecordingFormatError, parse_model
from service.api.http import limits as connection_module
from service.api.http.body import ROOM_FOR_LISTS, parse_body
from service.api.http.limits import LARGEST_AT_ONCE, LARGEST_DOCUMENT, MOST_HEADER_BYTES, RequestLimits
from service.api.http.samples import MOST_SAMPLES, decode_samples
from service.api.windows import WindowsIn
from service.cli.remote.client import window_document
from service.errors import ServiceError
from service.store.waveform_files import LARGEST_CONTENT_BYTES, FolderFiles, compressed
from tests.service.conftest import Api, assert_problem, running_service, simulated_measurement
from tests.service.hostile import JSON, MSGPACK, bodies, window
from tests.service.test_ingest import as_base64, as_lists

MIB = 2**20
NAMES = tuple(bodies(MIB))


@pytest.fixture(scope="module")
def hostile_bodies() -> dict[str, tuple[str, bytes]]:
    return bodies(16 * MIB)


@pytest.fixture(scope="module")
def axis(shared_api: Api) -> str:
    shared_api.register("hostile")
    return "hostile"


# Memory


@pytest.mark.release
def test_no_encoding_takes_more_than_twice_its_bytes_beside_them(
    hostile_bodies: dict[str, tuple[str, bytes]], subtests: pytest.Subtests
) -> None:
    for name in NAMES:
        with subtests.test(name=name):
            content_type, body = hostile_bodies[name]
            tracemalloc.start()
            try:
                WindowsIn.model_validate(parse_body(body, content_type))
            except (ServiceError, ValueError):
                pass  # the benchmark shows what the sender is told
            finally:
                _, peak = tracemalloc.get_traced_memory()
                tracemalloc.stop()
            assert peak <= 2 * max(len(body), ROOM_FOR_LISTS)


def test_frame_that_promises_more_than_was_ever_written_is_refused(tmp_path: Path) -> None:
    for size in (6, LARGEST_CONTENT_BYTES):  # in one step, and part by part
        (tmp_path / "ours").write_bytes(b"".join(compressed(lambda: [b"abc", b"", b"def"], size)))
        assert FolderFiles(tmp_path).read("ours", 0) == b"abcdef"
    bomb = zstandard.ZstdCompressor(level=1).compressobj()
    (tmp_path / "without-size").write_bytes(bomb.compress(bytes(MIB)) + bomb.flush())
    header = b"\x28\xb5\x2f\xfd" + b"\xe0" + (2**40).to_bytes(8, "little")  # RFC 8878, 3.1.1: one segment of a TiB
    (tmp_path / "large").write_bytes(header + bytes(16))
    for damaged in ("without-size", "large"):
        with pytest.raises(ValueError, match="a frame must say"):
            FolderFiles(tmp_path).read(damaged, 0)


# Encodings


@pytest.mark.release
@given(
    st.lists(
        st.one_of(st.floats(allow_nan=False, allow_infinity=False), st.integers(-(2**60), 2**60), st.just(0.5)),
        min_size=300,
        max_size=400,
    )
)
def test_long_lists_are_read_as_the_numbers_they_are(numbers: list[float]) -> None:
    """Against numpy on the numbers themselves, to the bit; short enough texts are as good in float32."""
    sent = {"excitation": numbers}
    for body, kind in ((json.dumps(sent).encode(), JSON), (msgpack.packb(sent), MSGPACK)):
        read = decode_samples(parse_body(body, kind)["excitation"])  # type: ignore[index]
        expected = np.array(numbers, dtype=np.float64)
        with np.errstate(over="ignore"):
            single = expected.astype(np.float32)
        assert np.array_equal(read, expected if read.dtype == np.float64 else single)
        assert not read.flags.writeable


LONG = ",".join(["1.25"] * 200)


def test_what_is_no_list_of_finite_numbers_is_refused(shared_api: Api, axis: str, subtests: pytest.Subtests) -> None:
    for text in [
        f"[{LONG},]",
        f"[{LONG},,1]",
        f"[,{LONG}]",
        f"[{LONG},01]",
        f"[{LONG},+1]",
        f"[{LONG},.5]",
        f"[{LONG},1e999]",
        f"[{LONG},1-1]",
        f"[{' ' * 600}1 1]",
        f"[{','.join(['1' + '0' * 400] * 3)}]",
        f"[{' ' * 600}]",
    ]:
        with subtests.test(text=text):
            body = json.dumps(window(0, "@", [1.0] * 201)).replace('"@"', text).encode()
            answer = shared_api.http.post(f"/v1/axes/{axis}/windows", content=body, headers={"content-type": JSON})
            assert "expected" in assert_problem(answer, 422, "invalid-request")["detail"]


def test_escapes_and_marks_in_json_mean_what_they_say(shared_api: Api, axis: str) -> None:
    (simulated,) = simulated_measurement(np.random.default_rng(2), "marks", n_windows=1)
    document = as_base64(window_document(simulated))
    escaped = json.dumps(document).replace("/", "\\/").encode()
    for body, status in ((escaped, 201), (json.dumps(document, indent=2).encode(), 200)):
        answer = shared_api.http.post(f"/v1/axes/{axis}/windows", content=body, headers={"content-type": JSON})
        assert answer.status_code == status, answer.text
    for forged in ("\x000", "\x009", "\x00"):  # what stands for samples that were cut out
        answer = shared_api.http.post(f"/v1/axes/{axis}/windows", json=document | {"response": forged})
        assert_problem(answer, 422, "invalid-request") if forged != "\x000" else None
        answer = shared_api.http.post(f"/v1/axes/{axis}/windows", json=document | {"measurement": forged})
        assert_problem(answer, 422, "invalid-request")


def test_window_of_too_many_samples_is_refused(shared_api: Api, axis: str) -> None:
    many = base64.b64encode(bytes(4 * (MOST_SAMPLES + 1))).decode()
    answer = shared_api.http.post(f"/v1/axes/{axis}/windows", json=window(0, many, many))
    assert f"at most {MOST_SAMPLES} samples" in assert_problem(answer, 422, "invalid-request")["detail"]


DEEP = (b"\x91" * 3000, b"\x81\xa7windows\x91" * 3000, b"\x81\xa6window" * 3000, b"\x81\x81" * 3000)


def test_packed_bodies_that_end_early_or_go_on_are_refused(shared_api: Api) -> None:
    axis = "packed"
    shared_api.register(axis)
    (simulated,) = simulated_measurement(np.random.default_rng(3), "ends", n_windows=1)
    whole = msgpack.packb(window_document(simulated))
    for body in (*(whole[:n] for n in (0, 1, 9, 40, 200, len(whole) - 1)), whole + b"\x00", b"\xc1", *DEEP):
        answer = shared_api.http.post(f"/v1/axes/{axis}/windows", content=body, headers={"content-type": MSGPACK})
        assert answer.status_code in (400, 422), body[:20]
    lists = msgpack.packb(as_lists(window_document(simulated)))
    for body, status in ((whole, 201), (lists, 200)):
        answer = shared_api.http.post(f"/v1/axes/{axis}/windows", content=body, headers={"content-type": MSGPACK})
        assert answer.status_code == status, answer.text


def test_content_type_must_be_stated(shared_api: Api, axis: str) -> None:
    """A form of a foreign page can send text; it cannot call it JSON without asking first."""
    for kind in ({}, {"content-type": "text/plain"}):
        answer = shared_api.http.post(f"/v1/axes/{axis}/windows", content=b"{}", headers=kind)
        assert "Content-Type must be application/json" in assert_problem(answer, 415, "unsupported-content")["detail"]


def test_deep_toml_is_refused(shared_api: Api) -> None:
    for text in ("a = " + "[" * 20_000, "a = " + "{b = " * 20_000):
        with pytest.raises(RecordingFormatError, match=r"nested too deeply|in TOML"):
            parse_model(text, "model.toml")
        body = {"name": "x", "configuration": {"drive_model": text}}
        assert 400 <= shared_api.http.put("/v1/axes/deep", json=body).status_code < 500


def test_large_documents_are_for_windows_only(shared_api: Api, axis: str) -> None:
    answer = shared_api.http.put(
        f"/v1/axes/{axis}", content=b" " * (LARGEST_DOCUMENT + 1), headers={"content-type": JSON}
    )
    assert str(LARGEST_DOCUMENT) in assert_problem(answer, 413, "body-too-large")["detail"]


# Hosts and origins


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8710", "localhost.evil.example", "", "[::1", "127.0.0.1.nip"]
)
def test_foreign_host_name_is_not_served(shared_api: Api, host: str) -> None:
    for method, path in (("GET", "/"), ("GET", "/v1/axes"), ("POST", "/v1/alarms/1/clear")):
        assert_problem(shared_api.http.request(method, path, headers={"host": host}), 421, "unknown-host")


def test_own_names_and_addresses_are_served(tmp_path: Path) -> None:
    with running_service(tmp_path, host_names="monitor.plant, mill-3") as api:
        for host in ("localhost:1", "192.0.2.7:8710", "[::1]:8710", "monitor.plant", "MILL-3:80", socket.gethostname()):
            assert api.http.get("/v1/axes", headers={"host": host}).status_code == 200, host


FOREIGN = (
    {"sec-fetch-site": "cross-site"},
    {"sec-fetch-site": "same-site"},
    {"origin": "http://evil.example"},
    {"origin": "null"},
    {"origin": "http://127.0.0.1:1"},
)


@pytest.mark.parametrize("headers", FOREIGN)
def test_page_of_others_changes_nothing(shared_api: Api, headers: dict[str, str]) -> None:
    body = {"name": "from a foreign page"}
    assert_problem(shared_api.http.put("/v1/axes/foreign", json=body, headers=headers), 403, "foreign-origin")
    assert_problem(shared_api.http.get("/v1/axes/foreign"), 404, "unknown-resource")
    assert "access-control-allow-origin" not in shared_api.http.get("/v1/axes", headers=headers).headers


def test_own_pages_and_programs_may_change_things(shared_api: Api) -> None:
    own = f"http://127.0.0.1:{shared_api.http.base_url.port}"
    for headers in ({}, {"origin": own}, {"sec-fetch-site": "same-origin"}, {"sec-fetch-site": "none"}):
        assert shared_api.http.put("/v1/axes/own", json={"name": "own"}, headers=headers).status_code in (200, 201)


@pytest.mark.parametrize("path", ["/", "/axes/hostile", "/v1/axes", "/nowhere", "/docs", "/static/live.js"])
def test_browsers_are_told_to_run_and_frame_nothing(shared_api: Api, axis: str, path: str) -> None:
    headers = shared_api.http.get(path.replace("hostile", axis)).headers
    policy = dict(part.strip().split(" ", 1) for part in headers["content-security-policy"].split(";"))
    assert policy["frame-ancestors"] == "'none'"
    assert "unsafe" not in policy["default-src"] + policy.get("script-src", "")
    if path != "/docs":
        assert "unsafe" not in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"


# Slow and greedy senders

Send = Callable[[dict[str, Any]], Any]


class Caller:
    """Calls RequestLimits as a server does, and notes the statuses in the order of the answers."""

    def __init__(self, **limits: Any) -> None:
        self.release, self.statuses = asyncio.Event(), list[int]()
        self.limits = RequestLimits(self._app, **limits)

    async def _app(self, _scope: Any, receive: Any, send: Send) -> None:
        assert not (await receive()).get("more_body")
        await self.release.wait()
        await send({"type": "http.response.start", "status": 200, "headers": []})

    def call(self, receive: Any, sender: str = "a") -> "asyncio.Task[None]":
        async def send(message: dict[str, Any]) -> None:
            if message["type"] == "http.response.start":
                self.statuses.append(message["status"])

        scope = {"type": "http", "method": "POST", "path": "/v1/axes/x/windows", "headers": [], "client": (sender, 1)}
        return asyncio.create_task(self.limits(scope, receive, send))


async def whole() -> Any:
    return {"type": "http.request", "body": b"{}"}


async def never() -> Any:
    await asyncio.Event().wait()


def test_slow_bodies_take_no_place_and_end() -> None:
    async def scenario() -> list[int]:
        caller = Caller(largest_body=10, most_waiting=2, body_time_s=0.2)
        slow = [caller.call(never) for _ in range(50)]
        await asyncio.sleep(0)
        caller.release.set()
        await caller.call(whole)
        await asyncio.gather(*slow)
        return caller.statuses

    assert asyncio.run(scenario()) == [200, *([408] * 50)]


def test_the_longest_under_way_gives_way_where_memory_ends() -> None:
    def large() -> Any:
        parts = iter([{"type": "http.request", "body": b"x" * 10, "more_body": True}])

        async def receive() -> Any:
            return next(parts, None) or await never()

        return receive

    async def scenario() -> list[int]:
        caller = Caller(largest_body=10, most_waiting=2)
        first = caller.call(large())
        others = [caller.call(large()) for _ in range(LARGEST_AT_ONCE)]
        await first
        assert not any(task.done() for task in others)
        for task in others:
            task.cancel()
        return caller.statuses

    assert asyncio.run(scenario()) == [408]


def test_no_sender_takes_every_place() -> None:
    async def scenario() -> list[int]:
        caller = Caller(largest_body=10, most_waiting=8)
        greedy = [caller.call(whole, "greedy") for _ in range(20)]
        while len(caller.statuses) < 14:
            await asyncio.sleep(0)
        other = caller.call(whole, "other")
        await asyncio.sleep(0.01)
        caller.release.set()
        await asyncio.gather(*greedy, other)
        return caller.statuses

    statuses = asyncio.run(scenario())
    assert statuses[:14] == [503] * 14  # six of eight places
    assert statuses[14:] == [200] * 7


def test_half_headers_are_given_up_and_long_ones_refused(shared_api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection_module, "HEADER_TIME_S", 0.3)

    def said(sent: bytes) -> bytes:
        with socket.create_connection((shared_api.http.base_url.host, shared_api.http.base_url.port)) as open_:
            answer = b""
            with suppress(ConnectionResetError):  # the service does not read on
                open_.sendall(sent)
                while part := open_.recv(2**16):
                    answer += part
            return answer

    began = time.monotonic()
    head = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n"
    assert b" 408 " in said(head + b"X-Half: ")
    assert time.monotonic() - began >= 0.3
    assert b"headers-too-slow" in said(b"")
    assert b" 431 " in said(head + b"X-Long: " + b"a" * (MOST_HEADER_BYTES + 1))
    assert b" 200 " not in said(head + b"".join(b"X-%d: 1\r\n" % i for i in range(20_000)) + b"\r\n")
    assert b"unreadable-request" in said(b"\x16\x03\x01\x00\xa5 TLS?\r\n\r\n")
    long_but_whole = head + b"X-Long: " + b"a" * MOST_HEADER_BYTES + b"\r\nConnection: close\r\n\r\n"
    assert b"headers-too-large" in said(long_but_whole)
    assert shared_api.http.get("/healthz").status_code == 200


def test_body_may_come_in_any_parts(shared_api: Api, axis: str) -> None:
    """As one, byte by byte, and in parts that wait for each other: what is read is the same."""
    rng = np.random.default_rng(3)
    samples = rng.standard_normal(2**15).astype("<f4").tobytes()  # larger than uvicorn lets wait
    body = msgpack.packb({"windows": [window(3000 + i, samples, samples) for i in range(2)]})
    head = f"POST /v1/axes/{axis}/windows HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: {MSGPACK}\r\n".encode()

    def answered(part_bytes: int, *, chunked: bool) -> bytes:
        parts = [body[at : at + part_bytes] for at in range(0, len(body), part_bytes)]
        with socket.create_connection((shared_api.http.base_url.host, shared_api.http.base_url.port)) as open_:
            if chunked:
                open_.sendall(head + b"Transfer-Encoding: chunked\r\n\r\n")
                open_.sendall(b"".join(b"%x\r\n%b\r\n" % (len(part), part) for part in parts) + b"0\r\n\r\n")
            else:
                open_.sendall(head + b"Content-Length: %d\r\n\r\n" % len(body))
                for part in parts:
                    open_.sendall(part)
            return open_.recv(2**16)

    assert answered(len(body), chunked=False).startswith(b"HTTP/1.1 201")
    for part_bytes, chunked in ((70_000, False), (1000, False), (10, True), (1, True)):
        assert answered(part_bytes, chunked=chunked).startswith(b"HTTP/1.1 200"), part_bytes  # the same windows
