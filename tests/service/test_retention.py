"""Keeping and letting go: what the rule keeps stays bit by bit, the rest is given back to the disk, no row is lost."""

import json
import shutil
import sqlite3
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from service.cli.main import preload
from service.clock import now
from service.store.safekeeping.backup import back_up, restore
from service.store.safekeeping.purge_lock import no_purge
from tests.service.conftest import Api, assert_problem, running_service
from tests.service.plant_history import (
    N_WINDOWS,
    RULE,
    History,
    arriving_at,
    day,
    files_without_rows,
    lived,
    measurement,
    number_of,
    row_counts,
    stored_names,
)
from tests.service.test_cli_identify import MODEL
from tests.service.test_database import database_url  # noqa: F401 - the fixture
from tests.service.test_jobs import wait_for

#: Of the disk, between what is said and what `du` finds. A file takes whole blocks of 4 KiB, and one of these tests
#: holds some 100 KiB; a frame of which a part is kept compresses a little differently.
WITHIN = 0.02


def retention(api: Api) -> dict[str, Any]:
    answer = api.http.get("/v1/retention")
    assert answer.status_code == 200, answer.text
    return answer.json()


def purge(api: Api) -> dict[str, Any]:
    answer = api.http.post("/v1/retention/purges")
    assert answer.status_code == 202, answer.text
    assert answer.json()["axis"] is None
    return wait_for(api, answer.json()["id"], "done", "failed")


def du(folder: Path) -> int:
    """Measure what files take, with the tool of the system."""
    lines = subprocess.run(
        ["du", "--apparent-size", "--block-size=1", "--all", folder], check=True, capture_output=True, text=True
    ).stdout.splitlines()
    sizes = [line.split("\t") for line in lines]
    return sum(int(size) for size, name in sizes if Path(name).is_file())


def session_of(api: Api, name: str) -> bytes:
    answer = api.http.get(f"/v1/axes/axis/measurements/{number_of(api, 'axis', name)}/windows?format=csv")
    assert answer.status_code == 200, answer.text
    return answer.content


def alarm_kept(api: Api, history: History) -> set[str]:
    """Return the old measurements around the alarms, by what these say of themselves."""
    kept: set[str] = set()
    for alarm in api.http.get("/v1/alarms").json()["alarms"]:
        begin = datetime.fromisoformat(alarm["evidence"]["onset"]) - timedelta(days=RULE["keep_before_alarm_days"])
        end = datetime.fromisoformat(alarm["evidence"]["at"]) + timedelta(days=RULE["keep_after_alarm_days"])
        kept |= {name for name, windows in history.old.items() if begin <= windows[0].started_at <= end}
    return kept


#: By this rule today's purge has not begun yet, in the folder of :func:`prepared`.
SHORTER = {**RULE, "keep_raw_days": 29}


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, History]:
    """Make a data folder with a history; today's purge came before it and found nothing."""
    folder = tmp_path_factory.mktemp("prepared") / "var"
    with running_service(folder, **RULE) as api:
        assert purge(api)["result"]["windows"] == 0
        return folder, lived(api)


@pytest.fixture
def history(prepared: tuple[Path, History], tmp_path: Path) -> History:
    """Copy that folder to the one of this test."""
    shutil.copytree(prepared[0], tmp_path / "var")
    return prepared[1]


@pytest.fixture
def living(history: History, tmp_path: Path) -> Iterator[tuple[Api, History]]:
    with running_service(tmp_path / "var", **RULE) as api:
        yield api, history


def test_what_is_kept_stays_and_the_rest_is_given_back(living: tuple[Api, History]) -> None:
    api, history = living
    around_alarm = alarm_kept(api, history)
    assert len(around_alarm) >= 4
    kept = history.kept | around_alarm
    gone = history.old.keys() - kept
    assert len(gone) >= 20

    before, rows, trend = retention(api), row_counts(api.data_dir), api.trend("axis", limit=10_000)
    sessions = {name: session_of(api, name) for name in kept}
    said = {name: detail(api, name) for name in history.old}
    used = du(api.data_dir / "raw")
    assert used == pytest.approx(before["bytes"], rel=WITHIN)
    assert before["to_let_go"]["windows"] == N_WINDOWS * len(gone)
    shares = {share["why"]: share["windows"] // N_WINDOWS for share in before["kept"]}
    assert shares == {
        "young": 1, "pin": 5, "calibration": 1, "alarm": len(around_alarm - history.kept)
    }  # fmt: skip
    assert sum(share["bytes"] for share in before["kept"]) + before["to_let_go"]["bytes"] == before["bytes"]

    job = purge(api)
    assert job["status"] == "done", job
    assert job["result"]["windows"] == N_WINDOWS * len(gone)

    after, left = retention(api), du(api.data_dir / "raw")
    assert left == pytest.approx(after["bytes"], rel=WITHIN)
    assert used - left == pytest.approx(before["to_let_go"]["bytes"], rel=WITHIN)
    assert used - left == pytest.approx(job["result"]["freed_bytes"], rel=WITHIN)
    assert after["to_let_go"] == {"windows": 0, "bytes": 0}
    assert after["let_go_windows"] == N_WINDOWS * len(gone)
    assert [share["windows"] for share in after["kept"]] == [share["windows"] for share in before["kept"]]

    assert row_counts(api.data_dir) == rows
    assert api.trend("axis", limit=10_000) == trend
    assert {name: session_of(api, name) for name in kept} == sessions  # bit by bit
    assert stored_names(api.data_dir) == dict.fromkeys([*kept, "young"], N_WINDOWS)
    assert files_without_rows(api.data_dir) == set()
    for name in history.old:
        now_said = detail(api, name)
        assert now_said["outcome"] == said[name]["outcome"]
        assert now_said["response"] == said[name]["response"]
        today = f"let go on {now():%Y-%m-%d} by the rule of 30 days"
        assert now_said["let_go"] == (today if name in gone else None)
        assert {window["let_go"] for window in now_said["windows"]} == {name in gone}

    purges = [entry for entry in api.http.get("/v1/audit").json()["entries"] if entry["action"].startswith("purge")]
    assert [(entry["who"], entry["status"]) for entry in purges] == [("anyone on this machine", 200)] * 2
    assert purges[0]["target"].startswith(f"purge 2: {N_WINDOWS * len(gone)} windows")


def detail(api: Api, name: str) -> dict[str, Any]:
    return api.http.get(f"/v1/axes/axis/measurements/{number_of(api, 'axis', name)}").json()


def test_what_was_let_go_is_refused_and_still_known(living: tuple[Api, History]) -> None:
    api, history = living
    assert purge(api)["status"] == "done"
    name = "day-10-a"
    number, rows, stored = number_of(api, "axis", name), row_counts(api.data_dir), stored_names(api.data_dir)
    assert name not in stored
    back = api.http.get(f"/v1/axes/axis/measurements/{number}/windows")
    problem = assert_problem(back, 410, "let-go")
    assert problem["detail"].startswith(f"the waveforms of measurement {number} were let go on ")
    span = {"from": day(10).isoformat(), "to": day(11).isoformat()}
    asked = api.http.post("/v1/axes/axis/identifications", json={"model": MODEL.read_text(), "measurements": span})
    assert_problem(asked, 410, "let-go")
    pinned = api.http.post("/v1/axes/axis/pins", json={"measurement": number, "reason": "too late"})
    assert_problem(pinned, 410, "let-go")

    again = api.accept("axis", history.old[name])
    assert (again["accepted"], again["already_there"]) == (0, N_WINDOWS)
    assert {window["reason"] for window in again["windows"]} == {None}
    assert again["measurements"][0]["preload_n"] == detail(api, name)["outcome"]["preload_n"]
    late = measurement(name, history.old[name][-1].started_at + timedelta(seconds=2))[:1]
    answer = api.accept("axis", late)
    assert answer["windows"][0]["reason"] == "too-late"
    assert "let go on" in answer["windows"][0]["detail"]
    assert row_counts(api.data_dir) == rows | {"windows": rows["windows"] + 1}
    assert detail(api, name)["outcome"]["refused"] is False
    # what is kept for calibrations can still be calibrated from: one position is too few, nothing is missing
    fit = api.http.post("/v1/axes/axis/calibrations", json={"measurements": {}})
    assert_problem(fit, 422, "not-identifiable")


def test_unpinned_is_let_go_by_the_next_purge(living: tuple[Api, History]) -> None:
    api, history = living
    purge(api)
    pins = api.http.get("/v1/axes/axis/pins").json()["pins"]
    assert [(pin["kind"], pin["reason"], pin["who"]) for pin in pins] == [
        ("span", "acceptance test", "anyone on this machine"), ("measurement", "reference", "anyone on this machine")
    ]  # fmt: skip
    again = api.http.post("/v1/axes/axis/pins", json={"measurement": history.pinned, "reason": "another"}).json()
    assert (again["id"], again["reason"]) == (pins[1]["id"], "another")
    for pin in pins:
        assert api.http.delete(f"/v1/axes/axis/pins/{pin['id']}").status_code == 200
        assert_problem(api.http.delete(f"/v1/axes/axis/pins/{pin['id']}"), 404, "unknown-resource")
    assert retention(api)["to_let_go"]["windows"] == 5 * N_WINDOWS
    assert purge(api)["result"]["windows"] == 5 * N_WINDOWS
    assert "set" in stored_names(api.data_dir)
    actions = [entry["action"] for entry in api.http.get("/v1/audit").json()["entries"]]
    assert actions.count("POST /v1/axes/{axis}/pins") == 3
    assert actions.count("DELETE /v1/axes/{axis}/pins/{pin}") == 4


@pytest.mark.parametrize(
    ("members", "sentence"),
    [
        ({}, "either measurement or both from and to are expected; got none"),
        ({"measurement": 1, "from": "2026-03-01T00:00:00Z"}, "got measurement, from"),
        ({"to": "2026-03-01T00:00:00Z"}, "got to"),
        ({"from": "2026-03-02T00:00:00Z", "to": "2026-03-01T00:00:00Z"}, "from must be before to"),
    ],
)
def test_a_pin_is_of_a_measurement_or_of_a_span(
    living: tuple[Api, History], members: dict[str, object], sentence: str
) -> None:
    answer = living[0].http.post("/v1/axes/axis/pins", json={**members, "reason": "neither"})
    assert sentence in assert_problem(answer, 422, "invalid-request")["detail"]


def test_without_a_rule_everything_is_kept(history: History, tmp_path: Path) -> None:
    with running_service(tmp_path / "var") as api:
        said = retention(api)
        assert [pace["gb_per_year"] for pace in said["axes"]] == [None]  # registered a moment ago
        assert said["rule"]["keep_raw_days"] is None
        assert [share["why"] for share in said["kept"]] == ["for-ever"]
        assert said["kept"][0]["windows"] == N_WINDOWS * (len(history.old) + 1)
        problem = assert_problem(api.http.post("/v1/retention/purges"), 409, "conflict")
        assert "PRELOAD_KEEP_RAW_DAYS" in problem["detail"]


def test_purge_begins_by_itself_and_waits_for_a_backup(history: History, tmp_path: Path) -> None:
    stored = stored_names(tmp_path / "var")
    with no_purge(tmp_path / "var"), running_service(tmp_path / "var", **SHORTER) as api:
        job = next_purge(api)
        assert job["status"] in ("queued", "running")
        time.sleep(0.5)
        assert stored_names(api.data_dir) == stored
    # stopped while it waited: it goes on at the next start, and no second one begins on this day
    with running_service(tmp_path / "var", **SHORTER) as api:
        assert wait_for(api, job["id"], "done", "failed")["status"] == "done"
        assert history.kept < stored_names(api.data_dir).keys() < stored.keys()
    with running_service(tmp_path / "var", **SHORTER) as api:
        time.sleep(0.5)
        assert purges(api)[0]["id"] == job["id"]


def purges(api: Api) -> list[dict[str, Any]]:
    return [row for row in api.http.get("/v1/jobs").json()["jobs"] if row["kind"] == "purge"]


def next_purge(api: Api) -> dict[str, Any]:
    """Wait for the purge that begins by itself; one was there before."""
    deadline = time.monotonic() + 60.0
    while len(found := purges(api)) < 2:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return found[0]


@pytest.mark.release
@pytest.mark.usefixtures("history")
def test_purge_can_be_cancelled_and_a_longer_rule_overtakes_it(tmp_path: Path) -> None:
    stored = stored_names(tmp_path / "var")
    with no_purge(tmp_path / "var"), running_service(tmp_path / "var", **SHORTER) as api:
        job = next_purge(api)
        assert api.http.post(f"/v1/jobs/{job['id']}/cancel").json()["status"] == "cancelled"
    with running_service(tmp_path / "var", **SHORTER) as api:
        time.sleep(0.5)
        assert stored_names(api.data_dir) == stored
    with no_purge(tmp_path / "var"), running_service(tmp_path / "var", **RULE) as api:
        job = api.http.post("/v1/retention/purges").json()
    with running_service(tmp_path / "var", keep_raw_days=3000) as api:
        ended = wait_for(api, job["id"], "done", "failed")
        assert (ended["status"], ended["result"]["windows"]) == ("done", 0)
        assert stored_names(api.data_dir) == stored


def test_window_of_today_that_was_healed_keeps_its_file(living: tuple[Api, History]) -> None:
    """A file that may still grow is left alone, however old the windows in it are."""
    api, history = living
    name = "day-10-a"
    (path,) = paths_of(api.data_dir, name)
    (api.data_dir / path).unlink()
    again = api.accept("axis", history.old[name])
    assert {window["reason"] for window in again["windows"]} == {"waveform-restored"}
    assert purge(api)["status"] == "done"
    assert name in stored_names(api.data_dir)


def paths_of(data_dir: Path, name: str) -> set[str]:
    query = "SELECT file_path FROM windows w JOIN measurements m ON m.id = w.measurement_id WHERE m.name = ?"
    with closing(sqlite3.connect(data_dir / "preload.db")) as connection:
        return {path for (path,) in connection.execute(query, (name,))}


def test_file_whose_kept_part_is_damaged_stays(living: tuple[Api, History]) -> None:
    api, _ = living
    (path,) = paths_of(api.data_dir, "day-02-a")
    file = api.data_dir / path
    content = bytearray(file.read_bytes())
    content[len(content) // 4] ^= 1  # in the frame of the pinned one, which came first that day
    file.write_bytes(content)
    assert purge(api)["status"] == "done"
    assert paths_of(api.data_dir, "day-02-a") == paths_of(api.data_dir, "day-02-b") == {path}
    assert file.read_bytes() == bytes(content)
    assert files_without_rows(api.data_dir) == set()
    assert paths_of(api.data_dir, "day-03-a") == {""}


@pytest.mark.usefixtures("history")
def test_backup_of_a_purged_folder_is_whole(tmp_path: Path) -> None:
    with running_service(tmp_path / "var", **RULE) as api:
        purge(api)
        trend, stored = api.trend("axis", limit=10_000), stored_names(api.data_dir)
        manifest = back_up(tmp_path / "var", tmp_path / "backup", lambda _: None)
    assert manifest.damaged == ()
    restore(tmp_path / "backup", tmp_path / "restored", lambda _: None)
    assert stored_names(tmp_path / "restored") == stored
    with running_service(tmp_path / "restored", **RULE) as api:
        assert api.trend("axis", limit=10_000) == trend
        assert detail(api, "day-10-a")["let_go"] is not None


@pytest.mark.release
def test_reading_back_while_a_purge_moves_what_is_read(living: tuple[Api, History]) -> None:
    api, history = living
    expected, wrong, stop = session_of(api, "day-02-a"), list[str](), threading.Event()

    def read() -> None:
        number = history.pinned
        while not stop.is_set():
            answer = api.http.get(f"/v1/axes/axis/measurements/{number}/windows?format=csv")
            if answer.content != expected:
                wrong.append(answer.text[:200])

    readers = [threading.Thread(target=read) for _ in range(3)]
    for reader in readers:
        reader.start()
    assert purge(api)["status"] == "done"
    stop.set()
    for reader in readers:
        reader.join()
    assert wrong == []


def test_command_line_says_the_same_and_does_the_same(
    history: History, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with running_service(tmp_path / "var", **RULE) as api:
        said = retention(api)
    for name, value in RULE.items():
        monkeypatch.setenv(f"PRELOAD_{name.upper()}", str(value))

    def command(*words: str) -> dict[str, Any]:
        preload.main(["retention", *words, "--data-dir", str(tmp_path / "var"), "--json"], standalone_mode=False)
        return json.loads(capsys.readouterr().out)

    changing = {"at", "axes", "gb_per_year"}
    shown, dry = command("show"), command("run", "--dry-run")
    for found in (shown, dry):
        assert {**found, **dict.fromkeys(changing)} == {**said, **dict.fromkeys(changing)}
    assert command("show", "--days", "3000")["to_let_go"]["windows"] == 0
    done = command("run")
    assert done["windows"] == said["to_let_go"]["windows"]
    assert stored_names(tmp_path / "var").keys() > history.kept
    with running_service(tmp_path / "var", **RULE) as api:
        (entry, _) = [e for e in api.http.get("/v1/audit").json()["entries"] if e["action"].startswith("purge")]
        assert entry["who"].startswith("command line (")


@pytest.mark.release
def test_pace_is_what_a_year_of_the_same_would_take(tmp_path: Path) -> None:
    """Ten days ago an axis began: one measurement a day since. A year holds 36.5 times as much."""
    with running_service(tmp_path / "var") as api:
        api.register("axis", windows_per_measurement=N_WINDOWS)
        with closing(sqlite3.connect(tmp_path / "var" / "preload.db")) as connection, connection:
            began = (now() - timedelta(days=10)).replace(tzinfo=None).isoformat(sep=" ")
            connection.execute("UPDATE axes SET created_at = ?", (began,))
        for number in range(10):
            at = now() - timedelta(days=number + 0.01)
            with arriving_at(at):
                api.accept("axis", measurement(f"m{number}", at - timedelta(seconds=30)))
        (pace,) = retention(api)["axes"]
        assert pace["days"] == pytest.approx(10.0, abs=0.01)
        assert pace["bytes"] == du(tmp_path / "var" / "raw")
        assert pace["gb_per_year"] == pytest.approx(du(tmp_path / "var" / "raw") * 36.525 / 1e9, rel=0.001)


@pytest.mark.release
def test_on_either_database(database_url: str, tmp_path: Path) -> None:  # noqa: F811 - the fixture
    with running_service(tmp_path / "var", database_url=database_url, **RULE) as api:
        history = lived(api)
        expected = alarm_kept(api, history) | history.kept
        trend = api.trend("axis", limit=10_000)
        job = purge(api)
        assert job["result"]["windows"] == N_WINDOWS * (len(history.old) - len(expected))
        assert {name for name in history.old if detail(api, name)["let_go"] is None} == expected
        for name in expected:
            session_of(api, name)
        assert api.trend("axis", limit=10_000) == trend
        after = retention(api)
        assert after["bytes"] == du(tmp_path / "var" / "raw")
        assert after["to_let_go"]["windows"] == 0
