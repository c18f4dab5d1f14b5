"""Recordings over HTTP: sessions and raw files are taken as live windows are, cancelled, and kept through a crash."""

import hashlib
import io
import os
import socket
import sys
import threading
import time
from collections.abc import Callable
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from monitor_core.recordings import import_session, read_channel_map
from monitor_core.recordings.session_hdf5 import write_session
from service.operations import foreign_file
from service.operations.foreign_file import BOUNDS
from service.operations.monitoring.intake.ingest import Ingest
from service.operations.own_process import Bounds
from service.operations.recordings import recordings
from service.operations.recordings.look import Look, look_into
from service.store import recordings as store
from service.store.safekeeping.backup import back_up, restore
from tests.conftest import canary, free_port
from tests.service import stand_in_readers as stand_ins
from tests.service.conftest import (
    N_WINDOWS,
    START,
    Api,
    ServerProcess,
    assert_problem,
    running_service,
    simulated_measurement,
)
from tests.service.test_jobs import wait_for
from tests.service.test_notices import wait_until
from tests.service.uploads import (
    MAP,
    N_MEASUREMENTS,
    assert_nothing_is_kept,
    get,
    left_over,
    raw_bytes,
    recorded,
    session_bytes,
    upload,
    uploaded,
)


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
    canary(
        [
            (stand_ins.aborts, BOUNDS, "by signal SIGABRT"),
            (stand_ins.never_ends, Bounds(2**30, 3.0), "is read within"),
            (stand_ins.takes_all_memory, Bounds(2**30, 900.0), "1024 MiB of memory"),
        ]
    ),
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
