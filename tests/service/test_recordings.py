"""Recordings over HTTP: taken whole or not at all, and stored windows out again without loss."""

import asyncio
import hashlib
import io
import os
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import fields, replace
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import httpx
import numpy as np
import pytest

from monitor_core.recording import Direction, Session, Window
from monitor_core.recordings import import_session, read_channel_map
from monitor_core.recordings.session_hdf5 import read_session, write_session
from service import app
from service.api.http import limits
from service.operations import foreign_file
from service.operations.foreign_file import BOUNDS
from service.operations.monitoring.intake.ingest import Ingest
from service.operations.own_process import Bounds
from service.operations.recordings import look, recordings
from service.operations.recordings.look import Look, look_into
from service.store import recordings as store
from service.store.safekeeping.backup import back_up, restore
from tests.service import stand_in_readers as stand_ins
from tests.service.conftest import (
    START,
    Api,
    ServerProcess,
    assert_problem,
    free_port,
    running_service,
    simulated_measurement,
)
from tests.service.test_jobs import wait_for

N_MEASUREMENTS, N_WINDOWS = 4, 8
MIB = 2**20

MAP = """axis_id = "axis"
[excitation]
channel = "torque"
quantity = "torque"
source = "sensor"
unit = "N.m"
[response]
channel = "acc"
unit = "m/s2"
[window]
sample_rate_hz = 1024
started_at = 2026-03-02T06:00:00Z
position_mm = 500.0
position_span_mm = 0.0
temperature_c = 21.5
payload_kg = 0.0
windows_in = "rows"
window_interval_s = 2.0
"""


def recorded(seed: int = 1, n_measurements: int = N_MEASUREMENTS, **fields: Any) -> list[Window]:
    rng = np.random.default_rng(seed)
    return [
        window
        for i in range(n_measurements)
        for window in simulated_measurement(
            rng, f"m{i}", n_windows=N_WINDOWS, started_at=START + timedelta(hours=i), **fields
        )
    ]


def session_bytes(folder: Path, windows: list[Window], axis: str = "axis") -> bytes:
    write_session(folder / "written.session.h5", Session(axis, tuple(windows)))
    return (folder / "written.session.h5").read_bytes()


def raw_bytes(seed: int = 3) -> bytes:
    """Return a file of one measurement, written by NumPy."""
    windows = simulated_measurement(np.random.default_rng(seed), "x", n_windows=N_WINDOWS)
    file = io.BytesIO()
    np.savez(file, torque=np.stack([w.excitation for w in windows]), acc=np.stack([w.response for w in windows]))
    return file.getvalue()


def upload(api: Api, *files: tuple[str, bytes], channel_map: str | None = None, axis: str = "axis") -> httpx.Response:
    parts: list[tuple[str, Any]] = [("file", (name, content)) for name, content in files]
    if channel_map is not None:
        parts.append(("map", ("mill.map.toml", channel_map)))
    return api.http.post(f"/v1/axes/{axis}/recordings", files=parts)


def uploaded(api: Api, *files: tuple[str, bytes], **options: Any) -> dict[str, Any]:
    """Upload, wait for the end of the job, and return the recording."""
    answer = upload(api, *files, **options)
    assert answer.status_code == 202, answer.text
    job = answer.json()
    assert answer.headers["location"] == f"/v1/jobs/{job['id']}"
    assert job["kind"] == "import"
    assert wait_for(api, job["id"], "done", "failed")["status"] == "done", job
    return get(api, job["arguments"]["recording"], axis=options.get("axis", "axis"))


def get(api: Api, number: int, axis: str = "axis") -> dict[str, Any]:
    answer = api.http.get(f"/v1/axes/{axis}/recordings/{number}")
    assert answer.status_code == 200, answer.text
    return answer.json()


def left_over(api: Api) -> list[Path]:
    return sorted((api.data_dir / "recordings").glob("*"))


def stored_windows(api: Api) -> list[Path]:
    return sorted((api.data_dir / "raw").rglob("*.zst"))


def assert_nothing_is_kept(api: Api, axis: str = "axis") -> None:
    assert left_over(api) == []
    assert stored_windows(api) == []
    assert api.http.get(f"/v1/axes/{axis}/recordings").json() == {"recordings": [], "next_cursor": None}
    assert api.http.get("/v1/jobs").json()["jobs"] == []


@pytest.fixture
def taking(api: Api) -> Api:
    api.register("axis", windows_per_measurement=N_WINDOWS)
    return api


# A session


def test_session_is_taken_as_live_windows_are_kept_and_downloaded(taking: Api, tmp_path: Path) -> None:
    windows, total = recorded(), N_MEASUREMENTS * N_WINDOWS
    content = session_bytes(tmp_path, windows)
    found = uploaded(taking, ("march.session.h5", content))
    assert found["state"] == "imported"
    assert (found["name"], found["size_bytes"]) == ("march.session.h5", len(content))
    assert found["sha256"] == hashlib.sha256(content).hexdigest()
    assert found["files"] == [{"name": "march.session.h5", "size_bytes": len(content), "sha256": found["sha256"]}]
    assert (found["n_windows"], found["n_measurements"], found["map"]) == (total, N_MEASUREMENTS, None)
    assert (found["problems"], found["left_out"]) == ([], [])
    assert [(c["name"], c["unit"], c["shape"], c["sample_rate_hz"]) for c in found["channels"]] == [
        ("excitation", "N.m", [total * 1024], 1024.0),
        ("response", "m/s2", [total * 1024], 1024.0),
    ]
    job = found["job"]
    assert (job["status"], job["done"], job["total"]) == ("done", total, total)
    assert job["result"] == {"windows_posted": total, "windows_refused": 0, "windows_already_there": 0}
    answer = taking.http.get(f"/v1/axes/axis/recordings/{found['id']}/file")
    assert answer.content == content
    assert answer.headers["content-length"] == str(len(content))
    assert 'filename="march.session.h5"' in answer.headers["content-disposition"]
    assert taking.http.get(f"/v1/axes/axis/recordings/{found['id']}/session").content == content
    part = taking.http.get(f"/v1/axes/axis/recordings/{found['id']}/file", headers={"range": "bytes=8-15"})
    assert (part.status_code, part.content) == (206, content[8:16])
    assert len(left_over(taking)) == 1


def test_recording_gives_the_trend_that_posted_windows_give_and_twice_the_same(taking: Api, tmp_path: Path) -> None:
    windows = recorded()
    taking.calibrate("axis")
    taking.register("posted", windows_per_measurement=N_WINDOWS)
    taking.calibrate("posted")
    for i in range(N_MEASUREMENTS):
        taking.accept("posted", windows[i * N_WINDOWS : (i + 1) * N_WINDOWS], complete=True)
    uploaded(taking, ("s.session.h5", session_bytes(tmp_path, windows)))

    def told(axis: str) -> list[dict[str, Any]]:
        return [{**point, "measurement_id": None, "calibration": None} for point in taking.trend(axis)]

    trend = told("axis")
    assert len(trend) == N_MEASUREMENTS
    assert trend == told("posted")
    again = uploaded(taking, ("s.session.h5", session_bytes(tmp_path, windows)))
    assert again["job"]["result"] == {
        "windows_posted": 0, "windows_refused": 0, "windows_already_there": N_MEASUREMENTS * N_WINDOWS,
    }  # fmt: skip
    assert told("axis") == trend


def test_recording_of_another_axis_is_taken_and_says_so(taking: Api, tmp_path: Path) -> None:
    found = uploaded(taking, ("s.session.h5", session_bytes(tmp_path, recorded(n_measurements=1), axis="mill-7")))
    (problem,) = found["problems"]
    assert "'mill-7'" in problem
    assert "'axis'" in problem


def test_recordings_are_listed_newest_first_in_pages(taking: Api, tmp_path: Path) -> None:
    for number in range(3):
        started_at = START + timedelta(hours=number)
        rng = np.random.default_rng(number)
        windows = simulated_measurement(rng, f"m{number}", n_windows=2, started_at=started_at)
        content = session_bytes(tmp_path, windows)
        uploaded(taking, (f"{number}.session.h5", content))
    page = taking.http.get("/v1/axes/axis/recordings", params={"limit": 2}).json()
    assert [item["name"] for item in page["recordings"]] == ["2.session.h5", "1.session.h5"]
    rest = taking.http.get("/v1/axes/axis/recordings", params={"limit": 2, "cursor": page["next_cursor"]}).json()
    assert [item["name"] for item in rest["recordings"]] == ["0.session.h5"]
    assert rest["next_cursor"] is None
    assert_problem(taking.http.get("/v1/axes/nobody/recordings"), 404, "unknown-resource")
    taking.register("other")
    number = page["recordings"][0]["id"]
    for path in ("", "/file", "/session"):
        assert_problem(taking.http.get(f"/v1/axes/other/recordings/{number}{path}"), 404, "unknown-resource")


def test_removed_recording_leaves_its_windows_and_its_number_to_nobody(taking: Api, tmp_path: Path) -> None:
    content = session_bytes(tmp_path, recorded(n_measurements=1))
    found = uploaded(taking, ("s.session.h5", content))
    trend = taking.trend("axis")
    answer = taking.http.delete(f"/v1/axes/axis/recordings/{found['id']}")
    assert answer.status_code == 200
    removed = answer.json()
    assert (removed["id"], removed["name"], removed["windows_stay"]) == (found["id"], "s.session.h5", N_WINDOWS)
    assert "stay" in removed["detail"]
    assert left_over(taking) == []
    assert taking.trend("axis") == trend
    for method, path in (("GET", ""), ("GET", "/file"), ("DELETE", "")):
        answer = taking.http.request(method, f"/v1/axes/axis/recordings/{found['id']}{path}")
        assert_problem(answer, 404, "unknown-resource")
    again = uploaded(taking, ("s.session.h5", content))
    assert again["id"] > found["id"]
    assert again["job"]["result"]["windows_already_there"] == N_WINDOWS


# Raw files


def test_upload_of_raw_and_map_is_the_import_of_the_command_line_byte_for_byte(taking: Api, tmp_path: Path) -> None:
    raw = raw_bytes()
    (tmp_path / "p500.npz").write_bytes(raw)
    (tmp_path / "map.toml").write_text(MAP)
    write_session(
        tmp_path / "cli.session.h5",
        import_session([tmp_path / "p500.npz"], read_channel_map(tmp_path / "map.toml")).session,
    )
    found = uploaded(taking, ("p500.npz", raw), channel_map=MAP)
    made = taking.http.get(f"/v1/axes/axis/recordings/{found['id']}/session")
    assert made.content == (tmp_path / "cli.session.h5").read_bytes()
    assert 'filename="p500.session.h5"' in made.headers["content-disposition"]
    assert taking.http.get(f"/v1/axes/axis/recordings/{found['id']}/file").content == raw
    assert found["map"] == MAP
    assert [(c["file"], c["name"], c["shape"], c["unit"]) for c in found["channels"]] == [
        ("p500.npz", "torque", [N_WINDOWS, 1024], None), ("p500.npz", "acc", [N_WINDOWS, 1024], None),
    ]  # fmt: skip
    assert [point["measurement"] for point in taking.trend("axis")] == ["p500"]


def test_files_that_the_map_puts_at_the_same_time_are_refused(taking: Api) -> None:
    files = {f"p{i}.npz": raw_bytes(i) for i in (1, 2)}
    answer = upload(taking, *files.items(), channel_map=MAP)
    assert (
        "expected file_interval_s, or a start of each file in [[files]]"
        in assert_problem(answer, 422, "recording-format")["detail"]
    )
    assert_nothing_is_kept(taking)


def test_format_whose_reader_is_not_installed_is_named(taking: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    content = tdms_bytes(1, START)
    monkeypatch.setattr(recordings, "look_into", look_without_tdms)
    answer = upload(taking, ("p1.tdms", content), channel_map=MAP)
    assert "pip install" in assert_problem(answer, 501, "missing-reader")["detail"]
    assert_nothing_is_kept(taking)


# A process of its own, whose work is handed over by name


def look_without_tdms(*arguments: Any) -> Look:
    sys.modules["nptdms"] = None  # type: ignore[assignment]  # what an import finds that there is not
    return look_into(*arguments)


def look_not_in(service: int, *arguments: Any) -> Look:
    assert os.getpid() != service
    return look_into(*arguments)


@pytest.mark.parametrize(
    ("broken", "bounds", "word"),
    [
        (stand_ins.aborts, BOUNDS, "by signal SIGABRT"),
        (stand_ins.never_ends, Bounds(2**30, 3.0), "is read within"),
        (stand_ins.takes_all_memory, Bounds(2**30, 900.0), "1024 MiB of memory"),
    ],
)
def test_recording_that_ends_its_reader_does_not_end_the_service(
    taking: Api, monkeypatch: pytest.MonkeyPatch, broken: Callable[..., Look], bounds: Bounds, word: str
) -> None:
    """Libraries behind the formats are not ours: what they do to their process is one sentence for the sender."""
    monkeypatch.setattr(recordings, "look_into", broken)
    monkeypatch.setattr(foreign_file, "BOUNDS", bounds)
    detail = assert_problem(upload(taking, ("p.npz", raw_bytes()), channel_map=MAP), 422, "recording-format")["detail"]
    assert detail.startswith("p.npz: expected a recording that")
    assert word in detail
    assert_nothing_is_kept(taking)
    monkeypatch.undo()
    assert uploaded(taking, ("p.npz", raw_bytes()), channel_map=MAP)["state"] == "imported"


def test_recording_is_read_beside_the_service(taking: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recordings, "look_into", partial(look_not_in, os.getpid()))
    assert uploaded(taking, ("p.npz", raw_bytes()), channel_map=MAP)["state"] == "imported"


def test_map_as_text_of_a_field_and_a_form_of_a_browser(taking: Api) -> None:
    """A form without a script sends empty parts for what was not chosen, and whole paths from some systems."""
    answer = taking.http.post(
        "/v1/axes/axis/recordings",
        files=[
            ("file", ("C:\\Messung\\März 1.npz", raw_bytes())),
            ("file", ("", b"")),
            ("map", (None, MAP.replace("\n", "\r\n"))),
        ],
    )
    assert answer.status_code == 202, answer.text
    wait_for(taking, answer.json()["id"], "done")
    found = get(taking, answer.json()["arguments"]["recording"])
    assert [file["name"] for file in found["files"]] == ["März 1.npz"]
    assert [point["measurement"] for point in taking.trend("axis")] == ["März 1"]


def test_session_with_an_empty_map_is_a_session(taking: Api, tmp_path: Path) -> None:
    content = session_bytes(tmp_path, recorded(n_measurements=1))
    answer = taking.http.post(
        "/v1/axes/axis/recordings", files=[("file", ("s.session.h5", content)), ("map", ("", b""))]
    )
    assert answer.status_code == 202, answer.text
    wait_for(taking, answer.json()["id"], "done")


def tdms_bytes(seed: int, started_at: datetime) -> bytes:
    """Return a file that states its rate, its units and its start, as an acquisition system writes it."""
    nptdms = pytest.importorskip("nptdms")
    (window,) = simulated_measurement(np.random.default_rng(seed), "x", n_windows=1)
    file = io.BytesIO()
    with nptdms.TdmsWriter(file) as writer:
        for name, samples, unit in (("torque", window.excitation, "N.m"), ("acc", window.response, "m/s2")):
            stated = {
                "wf_increment": 1 / 1024,
                "wf_start_time": np.datetime64(started_at.replace(tzinfo=None)),
                "unit_string": unit,
            }
            writer.write_segment([nptdms.ChannelObject("axis", name, samples, stated)])
    return file.getvalue()


def test_several_raw_files_are_one_recording_each_of_them_downloaded_by_name(taking: Api) -> None:
    facts = ("sample_rate_hz", "started_at", "windows_in", "window_interval_s")
    lines = [line for line in MAP.splitlines() if not line.startswith(facts)]
    tdms_map = "\n".join(lines).replace('"torque"\nquantity', '"axis/torque"\nquantity').replace('"acc"', '"axis/acc"')
    files = {f"p{i}.tdms": tdms_bytes(i, START + timedelta(hours=i)) for i in (2, 1)}
    found = uploaded(taking, *files.items(), channel_map=tdms_map)
    assert [file["name"] for file in found["files"]] == ["p2.tdms", "p1.tdms"]
    assert found["sha256"] == hashlib.sha256(files["p2.tdms"] + files["p1.tdms"]).hexdigest()
    assert {(c["file"], c["unit"], c["sample_rate_hz"]) for c in found["channels"]} == {
        (name, unit, 1024.0) for name in files for unit in ("N.m", "m/s2")
    }
    assert [c["started_at"] for c in found["channels"]][::2] == ["2026-03-02T08:00:00Z", "2026-03-02T07:00:00Z"]
    path = f"/v1/axes/axis/recordings/{found['id']}/file"
    for name, content in files.items():
        assert taking.http.get(path, params={"name": name}).content == content
    assert "p1.tdms" in assert_problem(taking.http.get(path), 422, "invalid-request")["detail"]
    assert_problem(taking.http.get(path, params={"name": "../map.toml"}), 404, "unknown-resource")
    assert (found["n_windows"], found["n_measurements"]) == (2, 2)


# Refused


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


@pytest.fixture(scope="module")
def refusing(shared_api: Api) -> Api:
    shared_api.register("axis")
    return shared_api


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


def wait_until(true: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60.0
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.01)


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


# Jobs


def test_job_is_cancelled_and_a_recording_under_way_is_not_removed(
    taking: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, go_on, ingest = threading.Event(), threading.Event(), Ingest.ingest

    def waiting(self: Ingest, axis: str, windows: Any, *, complete: bool) -> Any:
        receipt = ingest(self, axis, windows, complete=complete)
        begun.set()
        go_on.wait(20.0)
        return receipt

    monkeypatch.setattr(Ingest, "ingest", waiting)
    job = upload(taking, ("s.session.h5", session_bytes(tmp_path, recorded()))).json()
    number = job["arguments"]["recording"]
    assert begun.wait(20.0)
    answer = taking.http.delete(f"/v1/axes/axis/recordings/{number}")
    assert job["id"] in assert_problem(answer, 409, "conflict")["detail"]
    assert get(taking, number)["state"] == "checked"
    assert taking.http.post(f"/v1/jobs/{job['id']}/cancel").json()["status"] == "cancelled"
    go_on.set()
    assert taking.http.delete(f"/v1/axes/axis/recordings/{number}").status_code == 200
    assert len(taking.trend("axis")) == 1  # what was taken stays
    assert left_over(taking) == []


def test_window_that_contradicts_a_stored_one_fails_the_job_and_says_which(taking: Api, tmp_path: Path) -> None:
    taking.accept("axis", recorded(seed=7, n_measurements=1)[:3])
    job = upload(taking, ("s.session.h5", session_bytes(tmp_path, recorded()))).json()
    failed = wait_for(taking, job["id"], "failed")
    assert "2026-03-02T06:00:00" in failed["error"]
    assert get(taking, job["arguments"]["recording"])["state"] == "checked"
    assert taking.http.delete(f"/v1/axes/axis/recordings/{job['arguments']['recording']}").json()["windows_stay"] == 0


@pytest.mark.release
def test_kill_at_any_moment_loses_no_recording_that_was_answered(
    tmp_path: Path, fork_server: Callable[..., ServerProcess]
) -> None:
    """Killed while a recording arrives, while it is taken, and again: the trend is that of calm."""
    windows = recorded(n_measurements=40)
    content = session_bytes(tmp_path, windows)
    with running_service(tmp_path / "calm") as api:
        api.register("axis", windows_per_measurement=N_WINDOWS)
        api.calibrate("axis")
        uploaded(api, ("s.session.h5", content))
        expected = api.trend("axis")
    data_dir, port = tmp_path / "var", free_port()
    server = fork_server(data_dir, port)
    server.wait_until_up()
    with httpx.Client(base_url=server.url, timeout=30.0, trust_env=False) as http:
        api = Api(http, data_dir)
        api.register("axis", windows_per_measurement=N_WINDOWS)
        api.calibrate("axis")
        with socket.create_connection(("127.0.0.1", port)) as arriving:
            arriving.sendall(
                b"POST /v1/axes/axis/recordings HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 100000\r\n"
                b"Content-Type: multipart/form-data; boundary=b\r\n\r\n"
                b'--b\r\nContent-Disposition: form-data; name="file"; filename="a.npz"\r\n\r\nabc'
            )
            wait_until(lambda: left_over(api) != [])
            job = upload(api, ("s.session.h5", content)).json()
            server.process.kill()
            server.process.wait()
    assert any(path.suffix == ".part" for path in left_over(api))
    progress = 0
    for number in range(4):
        server = fork_server(data_dir, port)
        server.wait_until_up()
        if number < 3:
            time.sleep(0.05 * number)
            found = httpx.get(f"{server.url}/v1/jobs/{job['id']}", trust_env=False, timeout=60.0).json()
            assert found["done"] >= progress
            progress = found["done"]
            server.process.kill()
            server.process.wait()
    with httpx.Client(base_url=server.url, timeout=30.0, trust_env=False) as http:
        api = Api(http, data_dir)
        job = wait_for(api, job["id"], "done", "failed")
        assert (job["status"], job["done"]) == ("done", len(windows)), job
        assert api.trend("axis") == expected
        found = get(api, job["arguments"]["recording"])
        assert found["state"] == "imported"
        assert [path.suffix for path in left_over(api)] == [""]  # what arrived when it was killed is gone
        assert api.http.get(f"/v1/axes/axis/recordings/{found['id']}/file").content == content


def test_start_settles_what_a_crash_left_half_done(tmp_path: Path) -> None:
    with running_service(tmp_path / "var") as api:
        api.register("axis", windows_per_measurement=N_WINDOWS)
        found = [
            uploaded(api, (f"{i}.session.h5", session_bytes(tmp_path, recorded(n_measurements=1)))) for i in range(2)
        ]
        first, second = sorted(left_over(api), key=lambda path: sorted(path.rglob("*.h5"))[0].name)
    first.rename(first.with_suffix(".part"))  # committed, and not named yet
    second.rename(second.with_suffix(".gone"))  # to be removed, and its row was not
    for name in ("a.part", "b.gone"):
        (tmp_path / "var" / "recordings" / name / "files").mkdir(parents=True)
    held = store.RecordingFiles(tmp_path / "var").begin()  # of another process on the same folder
    with running_service(tmp_path / "var") as api:
        assert left_over(api) == sorted([first, second, held.path])
        for item in found:
            assert api.http.get(f"/v1/axes/axis/recordings/{item['id']}/file").status_code == 200
    held.close()


def test_backup_holds_recordings(tmp_path: Path) -> None:
    with running_service(tmp_path / "var") as api:
        api.register("axis", windows_per_measurement=N_WINDOWS)
        content = session_bytes(tmp_path, recorded(n_measurements=1))
        found = uploaded(api, ("s.session.h5", content))
        store.RecordingFiles(tmp_path / "var").begin()  # one that arrives is not copied
        back_up(tmp_path / "var", tmp_path / "backup", lambda _: None)
    _, damages = restore(tmp_path / "backup", tmp_path / "again", lambda _: None)
    assert damages == []
    with running_service(tmp_path / "again") as api:
        assert len(left_over(api)) == 1
        assert api.http.get(f"/v1/axes/axis/recordings/{found['id']}/file").content == content


# Stored windows


def with_every_field(windows: list[Window]) -> list[Window]:
    """Double precision, a position trace, a direction, and a temperature of many digits."""
    rng = np.random.default_rng(9)
    return [
        replace(
            window,
            response=window.response.astype(np.float64) + 1e-12,
            position_trace=0.5 + np.cumsum(rng.normal(0.0, 1e-6, window.n_samples)),
            position_span=0.00123,
            direction=Direction.POSITIVE,
            conditions=replace(window.conditions, temperature=21.1234567890123, payload_mass=None),
        )
        for window in windows
    ]


def assert_same(sent: Window, read: Window) -> None:
    for name in ("excitation", "response", "position_trace"):
        first, second = getattr(sent, name), getattr(read, name)
        if first is None or second is None:
            assert first is second, name
        else:
            assert (first.dtype, first.tobytes()) == (second.dtype, second.tobytes()), name
    for field in fields(Window):
        if field.name not in ("excitation", "response", "position_trace"):
            assert getattr(sent, field.name) == getattr(read, field.name), field.name


def test_stored_windows_are_read_back_bit_by_bit(taking: Api, tmp_path: Path) -> None:
    windows = with_every_field(recorded(n_measurements=1))
    uploaded(taking, ("s.session.h5", session_bytes(tmp_path, windows)))
    (point,) = taking.trend("axis")
    path = f"/v1/axes/axis/measurements/{point['measurement_id']}/windows"
    answer = taking.http.get(path)
    assert answer.headers["content-type"] == "application/x-hdf5"
    assert answer.headers["content-length"] == str(len(answer.content))
    (tmp_path / "back.session.h5").write_bytes(answer.content)
    session = read_session(tmp_path / "back.session.h5")
    assert session.axis_id == "axis"
    assert len(session.windows) == N_WINDOWS
    for sent, read in zip(windows, session.windows, strict=True):
        assert_same(sent, read)
    assert answer.content == session_bytes(tmp_path, windows)  # the file itself, too
    assert taking.http.get(path).content == answer.content
    third = taking.http.get(path, params={"window": 3, "format": "hdf5"})
    (tmp_path / "back.session.h5").write_bytes(third.content)
    (window,) = read_session(tmp_path / "back.session.h5").windows
    assert_same(window, windows[2])
    assert len(left_over(taking)) == 1


def test_stored_windows_as_a_table(taking: Api, tmp_path: Path) -> None:
    windows = with_every_field(recorded(n_measurements=1))
    uploaded(taking, ("s.session.h5", session_bytes(tmp_path, windows)))
    (point,) = taking.trend("axis")
    path = f"/v1/axes/axis/measurements/{point['measurement_id']}/windows"
    answer = taking.http.get(path, params={"format": "csv"})
    assert answer.headers["content-type"].startswith("text/csv")
    header, *rows = answer.text.splitlines()
    assert header == "window,time_s,torque_nm,acceleration_m_s2,position_m"
    table = np.array([row.split(",") for row in rows], dtype=np.float64)
    assert table.shape == (N_WINDOWS * 1024, 5)
    for number, window in enumerate(windows, start=1):
        (part,) = (table[table[:, 0] == number],)
        np.testing.assert_array_equal(part[:, 1], np.arange(1024) / 1024.0)
        assert part[:, 2].astype(np.float32).tobytes() == window.excitation.tobytes()
        assert part[:, 3].tobytes() == window.response.tobytes()
        assert window.position_trace is not None
        assert part[:, 4].tobytes() == window.position_trace.tobytes()
    second = taking.http.get(path, params={"window": 2}, headers={"accept": "text/csv"}).text.splitlines()
    assert second == [header, *rows[1024:2048]]


@pytest.mark.parametrize(
    ("accept", "kind"),
    [("*/*", "application/x-hdf5"), ("text/csv", "text/csv"),
     ("text/csv;q=0.5, application/x-hdf5", "application/x-hdf5"),
     ("text/html, text/*;q=0.2", "text/csv"), ("application/x-hdf5;q=0, text/csv;q=0.1", "text/csv")],
)  # fmt: skip
def test_accept_chooses_the_format(refusing: Api, accept: str, kind: str) -> None:
    refusing.register("formats", windows_per_measurement=2)
    refusing.accept("formats", recorded(n_measurements=1)[:2], complete=True)
    number = refusing.trend("formats")[0]["measurement_id"]
    path = f"/v1/axes/formats/measurements/{number}/windows"
    answer = refusing.http.get(path, headers={"accept": accept})
    assert answer.headers["content-type"].partition(";")[0] == kind
    for bad in ("application/json", "text/csv;q=0", "image/png, audio/*", "text/csv;q=x"):
        assert_problem(refusing.http.get(path, headers={"accept": bad}), 406, "not-acceptable")
    assert_problem(refusing.http.get(path, params={"format": "wav"}), 422, "invalid-request")
    assert_problem(refusing.http.get(path, params={"window": 3}), 404, "unknown-resource")
    assert_problem(refusing.http.get(f"/v1/axes/axis/measurements/{number}/windows"), 404, "unknown-resource")


def test_refused_windows_are_read_back_too_in_the_order_of_the_measurement(taking: Api, tmp_path: Path) -> None:
    windows = recorded(n_measurements=1)
    dead = replace(windows[3], response=np.zeros_like(windows[3].response))
    taking.accept("axis", [*windows[:3], dead, *windows[4:]], complete=True)
    (point,) = taking.trend("axis")
    path = f"/v1/axes/axis/measurements/{point['measurement_id']}"
    told = taking.http.get(path).json()["windows"]
    assert told[3]["refusal_reason"] == "dead-channel"
    (tmp_path / "w.session.h5").write_bytes(taking.http.get(f"{path}/windows").content)
    session = read_session(tmp_path / "w.session.h5")
    assert [datetime.fromisoformat(item["started_at"]) for item in told] == [w.started_at for w in session.windows]
    assert not session.windows[3].response.any()


def test_session_from_one_site_is_posted_to_another_without_loss(tmp_path: Path) -> None:
    """Sent window by window at one site, downloaded there, uploaded at the other: values and charts byte by byte."""
    said = []
    sessions = dict[str, bytes]()
    for site in ("one", "other"):
        with running_service(tmp_path / site) as api:
            api.register("axis", windows_per_measurement=N_WINDOWS)
            api.calibrate("axis")
            if site == "one":
                for i in range(12):
                    preload = 300.0 if i < 9 else 220.0
                    windows = simulated_measurement(
                        np.random.default_rng(i), f"m{i}", preload=preload, n_windows=N_WINDOWS,
                        started_at=START + timedelta(days=i), position_mm=(400.0, 500.0, 600.1)[i % 3],
                    )  # fmt: skip
                    api.accept("axis", with_every_field(windows) if i % 2 else windows, complete=True)
                for point in api.trend("axis"):
                    path = f"/v1/axes/axis/measurements/{point['measurement_id']}/windows"
                    sessions[f"{point['measurement']}.session.h5"] = api.http.get(path).content
            else:
                for name, content in sessions.items():
                    uploaded(api, (name, content))
            said.append([
                api.http.get("/v1/axes/axis/trend").content,
                *(api.http.get(f"/v1/axes/axis/measurements/{i + 1}/windows").content for i in range(12)),
                *(without_moments(api.http.get(f"/v1/axes/axis/measurements/{i + 1}").json()) for i in range(12)),
            ])  # fmt: skip
            said[-1].append(charts_of(tmp_path / site / "preload.db"))
    assert said[0] == said[1]
    assert b'"preload_n":2' in said[0][0]


def without_moments(document: Any) -> Any:
    """Leave out when something was judged: that is another moment at every site."""
    if isinstance(document, dict):
        return {name: without_moments(value) for name, value in document.items() if name not in ("judged_at",)}
    return [without_moments(item) for item in document] if isinstance(document, list) else document


def charts_of(path: Path) -> tuple[str, ...]:
    with closing(sqlite3.connect(path)) as database:
        (row,) = database.execute("SELECT monitor_state, epoch, state, since_checkpoint FROM axes").fetchall()
    return tuple(map(str, row))


# Memory


#: Windows of a MiB each.
N_LARGE = 384
SERVED = """
import os, sys, threading, time
from pathlib import Path
import httpx
from service.cli.remote.server import embedded_service
from service.settings import Settings

folder, name = Path(sys.argv[1]), sys.argv[2]
def peak():
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM")) * 1024
def private(process):
    try:
        rows = (process / "smaps_rollup").read_text().splitlines()
    except OSError:
        return 0  # it has ended
    return sum(int(row.split()[1]) for row in rows if row.startswith("Private_")) * 1024
readers, watching = [0], True
def watch():
    # what the processes of the fork server take besides what they share with it
    while watching:
        for process in Path("/proc").glob("[0-9]*"):
            try:
                parent = int((process / "stat").read_text().rsplit(")", 1)[1].split()[1])
                grandparent = int(Path(f"/proc/{parent}/stat").read_text().rsplit(")", 1)[1].split()[1])
            except OSError:
                continue
            if grandparent == os.getpid():
                readers.append(private(process))
        time.sleep(0.05)
watcher = threading.Thread(target=watch)
watcher.start()
with embedded_service(Settings(data_dir=folder / "var", port=0)) as url:
    with httpx.Client(base_url=url, timeout=600.0, trust_env=False) as http:
        http.put("/v1/axes/axis", json={"name": "axis", "configuration": {"windows_per_measurement": 20}})
        http.get("/v1/axes/axis/recordings")
        before = peak()
        with open(folder / name, "rb") as file:
            parts = {"file": (name, file)} | ({"map": Path(sys.argv[3]).read_text()} if sys.argv[3:] else {})
            answer = http.post("/v1/axes/axis/recordings", files=parts)
        assert answer.status_code == 202, answer.text
        while (job := http.get("/v1/jobs/" + answer.json()["id"]).json())["status"] in ("queued", "running"):
            time.sleep(0.2)
        assert job["status"] == "done", job
        watching = False
        watcher.join()
        print(before, peak(), max(readers), job["done"])
"""


@pytest.mark.release
def test_large_session_is_taken_measurement_by_measurement_with_flat_memory(tmp_path: Path) -> None:
    """A session of 384 MiB, window by window refused (a dead response), so that judging takes no memory of its own."""
    rng = np.random.default_rng(1)
    noise = rng.standard_normal(2**17).astype("f4")
    (window,) = simulated_measurement(rng, "x", n_windows=1)
    with h5py.File(tmp_path / "large.session.h5", "w") as file:
        file.attrs.update({"format": "preload-session", "version": 1, "axis_id": "axis"})
        for number in range(N_LARGE):
            large = replace(
                window, excitation=np.roll(noise, number), response=np.zeros_like(noise),
                measurement=f"m{number // 20}", started_at=START + timedelta(minutes=4 * number),
            )  # fmt: skip
            write_session(tmp_path / "one.session.h5", Session("axis", (large,)))
            with h5py.File(tmp_path / "one.session.h5") as source:
                source.copy("windows/000000", file, f"windows/{number:06d}")
    assert (tmp_path / "large.session.h5").stat().st_size > N_LARGE * MIB
    done = subprocess.run(
        [sys.executable, "-c", SERVED, tmp_path, "large.session.h5"],
        check=True, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    before, peak, reader, n_windows = map(int, done.stdout.split())
    assert n_windows == N_LARGE
    assert 0 < reader < 32 * MIB, reader / MIB  # a window at a time
    # a measurement is 20 MiB, held while it is written, and the windows written last stay in memory (64 MiB)
    assert peak - before + reader < 160 * MIB, (peak - before) / MIB


@pytest.mark.release
def test_raw_file_takes_three_times_its_size_at_most(tmp_path: Path) -> None:
    """Arrays of float32, refused window by window as above: what remains is the reading and the session."""
    noise = np.random.default_rng(1).standard_normal((96, 2**17)).astype("f4")
    np.savez(tmp_path / "large.npz", torque=noise, acc=np.zeros_like(noise))
    size = (tmp_path / "large.npz").stat().st_size
    assert size > 95 * MIB
    (tmp_path / "map.toml").write_text(MAP.replace("window_interval_s = 2.0", "window_interval_s = 240.0"))
    done = subprocess.run(
        [sys.executable, "-c", SERVED, tmp_path, "large.npz", tmp_path / "map.toml"],
        check=True, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    before, peak, reader, n_windows = map(int, done.stdout.split())
    assert n_windows == 96
    assert reader > size  # it is the one that reads
    assert peak - before + reader < 3 * size, (peak - before + reader) / size
