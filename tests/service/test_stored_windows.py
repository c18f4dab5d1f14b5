"""Stored windows out again over HTTP, without loss; large recordings within little memory."""

import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import fields, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from monitor_core.recording import Direction, Session, Window
from monitor_core.recordings.session_hdf5 import read_session, write_session
from tests.service.conftest import N_WINDOWS, START, Api, assert_problem, running_service, simulated_measurement
from tests.service.uploads import MAP, MIB, left_over, recorded, session_bytes, uploaded


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


@pytest.mark.release
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
