"""Recordings that are refused over HTTP: whole, in one sentence, within bounds, and nothing of them is kept."""

import asyncio
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest

from service import app
from service.api.http import limits
from service.operations.recordings import look
from service.store import recordings as store
from tests.service.conftest import N_WINDOWS, Api, assert_problem, running_service
from tests.service.test_notices import wait_until
from tests.service.uploads import (
    MAP,
    MIB,
    N_MEASUREMENTS,
    assert_nothing_is_kept,
    left_over,
    raw_bytes,
    recorded,
    session_bytes,
    upload,
)

REFUSED = {
    "no part at all": ({"files": [("other", ("x", b"1"))]}, 422, "invalid-request", "'file'"),
    "no file": ({"files": [("map", ("m.toml", MAP))]}, 422, "invalid-request", "'file'"),
    "raw without a map": ({"files": [("file", ("x.npz", raw_bytes()))]}, 422, "recording-format", "map"),
    "two maps": (
        {"files": [("map", ("a", MAP)), ("map", ("b", MAP)), ("file", ("x.npz", raw_bytes()))]},
        422, "invalid-request", "got two",
    ),
    "map is no TOML": (
        {"files": [("file", ("x.npz", raw_bytes())), ("map", ("a", "torque: yes"))]}, 422, "recording-format", "TOML",
    ),
    "map is no text": (
        {"files": [("file", ("x.npz", raw_bytes())), ("map", ("a", b"\xff\xfe"))]}, 422, "invalid-request", "UTF-8",
    ),
    "map is long": (
        {"files": [("file", ("x.npz", raw_bytes())), ("map", ("a", "#" * 2**18 + "\n"))]},
        413, "body-too-large", "channel map",
    ),
    "map names another channel": (
        {"files": [("file", ("x.npz", raw_bytes())), ("map", ("a", MAP.replace('"acc"', '"a1"')))]},
        422, "recording-format", "'a1'",
    ),
    "file is not what its ending says": (
        {"files": [("file", ("x.npz", b"PK no")), ("map", ("a", MAP))]}, 422, "recording-format", "x.npz",
    ),
    "unknown ending": (
        {"files": [("file", ("x.exe", b"MZ")), ("map", ("a", MAP))]}, 422, "recording-format", ".exe",
    ),
    "hidden name": ({"files": [("file", (".bashrc", b"x"))]}, 422, "invalid-request", "dot"),
    "name of a folder": ({"files": [("file", ("..", b"x"))]}, 422, "invalid-request", "dot"),
    "twice one name": (
        {"files": [("file", ("a.npz", b"x")), ("file", ("b/a.npz", b"y"))]}, 422, "invalid-request", "distinct",
    ),
    "nameless file": ({"files": [("file", ("", b"x"))]}, 422, "invalid-request", "name of a file"),
    "broken HDF5": (
        {"files": [("file", ("s.session.h5", b"\x89HDF\r\n\x1a\n" + bytes(100)))]}, 422, "recording-format", "HDF5",
    ),
    "JSON": ({"json": {"file": "x"}}, 415, "unsupported-content", "multipart/form-data"),
    "no boundary": (
        {"content": b"x", "headers": {"content-type": "multipart/form-data"}}, 415, "unsupported-content", "boundary",
    ),
    "not a form": (
        {"content": b"x" * 50, "headers": {"content-type": "multipart/form-data; boundary=b"}},
        400, "unreadable-body", "multipart/form-data",
    ),
    "cut off": (
        {
            "content": b'--b\r\nContent-Disposition: form-data; name="file"; filename="a.npz"\r\n\r\nabc',
            "headers": {"content-type": "multipart/form-data; boundary=b"},
        },
        400, "unreadable-body", "last boundary",
    ),
    "long headers": (
        {
            "content": b'--b\r\nX: ' + b"a" * 10_000 + b"\r\n\r\nabc\r\n--b--",
            "headers": {"content-type": "multipart/form-data; boundary=b"},
        },
        400, "unreadable-body", "multipart/form-data",
    ),
    "part without a name": (
        {"content": b"--b\r\nX: y\r\n\r\nabc\r\n--b--", "headers": {"content-type": "multipart/form-data; boundary=b"}},
        400, "unreadable-body", "name",
    ),
    "from a foreign page": (
        {"files": [("file", ("x.npz", raw_bytes()))], "headers": {"origin": "http://evil.example"}},
        403, "foreign-origin", "page",
    ),
    "by a foreign name": (
        {"files": [("file", ("x.npz", raw_bytes()))], "headers": {"host": "evil.example"}},
        421, "unknown-host", "asked",
    ),
}  # fmt: skip


def test_what_is_no_recording_is_refused_in_one_sentence_and_nothing_is_kept(
    refusing: Api, subtests: pytest.Subtests
) -> None:
    for name, (request, status, kind, word) in REFUSED.items():
        with subtests.test(name=name):
            answer = refusing.http.post("/v1/axes/axis/recordings", **request)
            assert word in assert_problem(answer, status, kind)["detail"]
            assert_nothing_is_kept(refusing)


def test_unknown_axis_is_refused_before_the_body_is_read(refusing: Api) -> None:
    assert_problem(upload(refusing, ("x.npz", bytes(3 * MIB)), axis="nobody"), 404, "unknown-resource")
    assert left_over(refusing) == []


def test_one_bad_window_among_good_ones_keeps_all_from_being_stored(refusing: Api, tmp_path: Path) -> None:
    content = session_bytes(tmp_path, recorded())
    path = tmp_path / "bad.session.h5"
    for change, word in (
        (lambda group: group.attrs.update({"sample_rate_hz": -1.0}), "sample_rate_hz"),
        (lambda group: group.attrs.update({"sample_rate_hz": 1e9}), "sample_rate_hz"),
        (lambda group: group.attrs.update({"position_mm": 1e9}), "position_mm"),
        (lambda group: group.attrs.update({"measurement": "a\x07b"}), "measurement"),
        (lambda group: group.attrs.update({"measurement": "a" * 201}), "measurement"),
        (lambda group: group.attrs.update({"started_at": "2300-01-01T00:00:00Z"}), "started_at"),
        (lambda group: group.attrs.update({"excitation_unit": "Nm"}), "excitation_unit"),
        (lambda group: group.__delitem__("response"), "response"),
    ):
        path.write_bytes(content)
        with h5py.File(path, "r+") as file:
            change(file[f"windows/{N_MEASUREMENTS * N_WINDOWS - 1:06d}"])
        detail = assert_problem(upload(refusing, ("bad.session.h5", path.read_bytes())), 422, "recording-format")[
            "detail"
        ]
        assert word in detail
        assert "bad.session.h5" in detail
        assert_nothing_is_kept(refusing)


def test_small_file_that_would_become_large_is_refused_before_it_does(refusing: Api, tmp_path: Path) -> None:
    """An HDF5 file of zeros, compressed by a thousand."""
    (tmp_path / "bomb.session.h5").write_bytes(session_bytes(tmp_path, recorded(n_measurements=1)))
    with h5py.File(tmp_path / "bomb.session.h5", "r+") as file:
        group = file["windows/000003"]
        for name in ("excitation", "response"):
            del group[name]
            group.create_dataset(name, data=np.zeros(2**24, "f4"), chunks=(2**20,), compression="gzip")
    content = (tmp_path / "bomb.session.h5").read_bytes()
    assert len(content) < MIB
    problem = assert_problem(upload(refusing, ("bomb.session.h5", content)), 422, "recording-format")
    assert "at most 1048576 samples" in problem["detail"]
    assert_nothing_is_kept(refusing)


def test_samples_of_a_recording_and_of_a_measurement_have_a_bound(
    refusing: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = session_bytes(tmp_path, recorded())
    monkeypatch.setattr(look, "LARGEST_MEASUREMENT_BYTES", 50_000)
    problem = assert_problem(upload(refusing, ("s.session.h5", content)), 413, "body-too-large")
    assert "one measurement" in problem["detail"]
    monkeypatch.undo()
    monkeypatch.setattr(look, "MOST_EXPANSION", 0)
    problem = assert_problem(upload(refusing, ("s.session.h5", content)), 413, "body-too-large")
    assert "PRELOAD_MAX_RECORDING_MIB" in problem["detail"]
    assert_nothing_is_kept(refusing)


def form(*chunks: bytes) -> Iterator[bytes]:
    yield b'--b\r\nContent-Disposition: form-data; name="file"; filename="a.npz"\r\n\r\n'
    yield from chunks
    yield b"\r\n--b--\r\n"


FORM = {"content-type": "multipart/form-data; boundary=b"}


def test_upload_beyond_the_setting_is_refused_as_it_arrives(tmp_path: Path) -> None:
    with running_service(tmp_path / "var", max_recording_mib=1) as api:
        api.register("axis")
        declared = api.http.post("/v1/axes/axis/recordings", content=bytes(3 * MIB), headers=FORM)
        assert_problem(declared, 413, "body-too-large")
        streamed = api.http.post("/v1/axes/axis/recordings", content=form(*[bytes(2**16)] * 20), headers=FORM)
        assert "PRELOAD_MAX_RECORDING_MIB" in assert_problem(streamed, 413, "body-too-large")["detail"]
        endless = api.http.post("/v1/axes/axis/recordings", content=form(*[bytes(2**16)] * 40), headers=FORM)
        assert_problem(endless, 413, "body-too-large")
        assert_nothing_is_kept(api)
        assert upload(api, ("x.npz", bytes(MIB)), channel_map=MAP).status_code == 422  # a whole MiB is read


def test_other_routes_take_no_large_bodies(refusing: Api) -> None:
    """What a recording may, no other body may: the bound of documents holds besides."""
    for method, path in (
        ("PUT", "/v1/axes/axis/recordings"),
        ("POST", "/v1/axes/axis/recordings/1"),
        ("POST", "/v1/axes/axis/recordings/"),
        ("POST", "/v1/recordings"),
        ("POST", "/v1/axes/a/b/recordings"),
        ("DELETE", "/v1/axes/axis/recordings/1"),
        ("POST", "/v1/axes/axis/replays"),
    ):
        answer = refusing.http.request(method, path, content=bytes(limits.LARGEST_DOCUMENT + 1), headers=FORM)
        assert_problem(answer, 413, "body-too-large")


def test_slow_upload_ends_at_a_pause_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "RequestLimits", partial(limits.RequestLimits, body_time_s=0.5))
    with running_service(tmp_path / "var") as api:
        api.register("axis")
        address = (api.http.base_url.host, api.http.base_url.port)
        head = (
            b"POST /v1/axes/axis/recordings HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 100000\r\n"
            b"Content-Type: multipart/form-data; boundary=b\r\n\r\n"
        )
        begun = b'--b\r\nContent-Disposition: form-data; name="file"; filename="a.npz"\r\n\r\n'
        for sent in (b"", begun, begun + bytes(2**15)):
            with socket.create_connection(address) as connection:
                connection.sendall(head + sent)
                answer = b""
                while part := connection.recv(2**16):  # it is closed: what is still on its way is not read
                    answer += part
            assert b" 408 " in answer
            assert b"body-too-slow" in answer
        with socket.create_connection(address) as connection:  # a drop at a time is no pause, and too slow all the same
            connection.sendall(head + begun)
            began = time.monotonic()
            with suppress(OSError):
                while time.monotonic() - began < 60.0:
                    connection.sendall(b"x")
                    time.sleep(0.1)
                    connection.setblocking(False)
                    with suppress(BlockingIOError):
                        if b" 408 " in connection.recv(2**16):
                            break
                    connection.setblocking(True)
            assert 0.4 < time.monotonic() - began < 60.0
        assert_nothing_is_kept(api)
        assert api.http.get("/healthz").status_code == 200


def test_client_that_goes_away_leaves_nothing(refusing: Api) -> None:
    with socket.create_connection((refusing.http.base_url.host, refusing.http.base_url.port)) as connection:
        connection.sendall(
            b"POST /v1/axes/axis/recordings HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 100000\r\n"
            b"Content-Type: multipart/form-data; boundary=b\r\n\r\n"
            b'--b\r\nContent-Disposition: form-data; name="file"; filename="a.npz"\r\n\r\nabc'
        )
        wait_until(lambda: left_over(refusing) != [])
    wait_until(lambda: left_over(refusing) == [])
    assert_nothing_is_kept(refusing)


def test_few_uploads_at_one_time_and_no_sender_has_them_all() -> None:
    async def scenario() -> list[int]:
        statuses, release = list[int](), asyncio.Event()

        async def route(_scope: Any, _receive: Any, send: Any) -> None:
            await release.wait()
            await send({"type": "http.response.start", "status": 202, "headers": []})

        takes = limits.RequestLimits(route, largest_body=10, most_waiting=8, largest_recording=10)

        async def send(message: dict[str, Any]) -> None:
            if message["type"] == "http.response.start":
                statuses.append(message["status"])

        async def never() -> Any:
            await asyncio.Event().wait()

        def call(sender: str) -> "asyncio.Task[None]":
            scope = {"type": "http", "method": "POST", "path": "/v1/axes/x/recordings", "headers": []}
            return asyncio.create_task(takes(scope | {"client": (sender, 1)}, never, send))

        calls = [call("greedy") for _ in range(5)] + [call("other"), call("third")]
        await asyncio.sleep(0.01)
        release.set()
        await asyncio.gather(*calls)
        calls = [call("greedy")]
        await asyncio.gather(*calls)
        return statuses

    assert asyncio.run(scenario()) == [503, 503, 503, *[202] * 5]


def test_full_disk_is_told_before_the_upload_and_while_it_arrives(
    refusing: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = iter([store.ROOM_LEFT_BYTES + 10])

    def usage(_path: Path) -> Any:
        return SimpleNamespace(free=next(free, 0))

    monkeypatch.setattr(store.shutil, "disk_usage", usage)
    problem = assert_problem(upload(refusing, ("x.npz", bytes(MIB))), 503, "storage-failed")
    assert "0 MiB" not in problem["detail"].split(";")[0]
    assert "Free some" in problem["detail"]
    free = iter([2**40])  # enough for the file, and not for the session that is made of it
    answer = upload(refusing, ("p500.npz", raw_bytes()), channel_map=MAP)
    assert_problem(answer, 503, "storage-failed")
    free = iter([2**40, 2**40])
    answer = refusing.http.post("/v1/axes/axis/recordings", content=form(*[bytes(MIB)] * 60), headers=FORM)
    assert_problem(answer, 503, "storage-failed")
    assert_nothing_is_kept(refusing)
