"""A backup taken under load is what the database held at one moment; damage to it is noticed by name."""

import json
import os
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from service.errors import DataFolderError
from service.store.safekeeping.backup import DATABASE, MANIFEST, back_up, restore
from tests.service.conftest import START, Api, running_service, simulated_measurement

N_BEFORE, N_AFTER, N_WINDOWS = 10, 30, 8


def nothing(_: str) -> None:
    """Tell nobody."""


def prepare(api: Api) -> None:
    api.register("axis", windows_per_measurement=N_WINDOWS)
    api.calibrate("axis")


def measurement(number: int) -> list:
    return simulated_measurement(
        np.random.default_rng(number),
        f"m{number:03d}",
        preload=300.0 if number < 20 else 220.0,
        started_at=START + timedelta(days=number),
        n_windows=N_WINDOWS,
    )


def run(*words: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "service.cli.main", *words]
    return subprocess.run(
        command, check=False, capture_output=True, text=True, timeout=60, env=os.environ | environment
    )


def test_backup_under_load_restores_the_trend_of_its_moment(tmp_path: Path) -> None:
    with running_service(tmp_path / "var") as api:
        prepare(api)
        for number in range(N_BEFORE):
            api.accept("axis", measurement(number))
        half_way = threading.Event()

        def post() -> None:
            for number in range(N_BEFORE, N_BEFORE + N_AFTER):
                windows = measurement(number)
                api.accept("axis", windows[:3])  # open measurements are caught, too
                if number == N_BEFORE + 2:
                    half_way.set()
                api.accept("axis", windows[3:])

        posting = threading.Thread(target=post)
        posting.start()
        assert half_way.wait(30.0)
        acknowledged = len(api.trend("axis"))
        manifest = back_up(tmp_path / "var", tmp_path / "backup", nothing)
        assert posting.is_alive()  # it was taken under load
        posting.join()
        whole = api.trend("axis", limit=10_000)
        alarms = api.http.get("/v1/alarms").json()
    assert manifest.damaged == ()
    restore(tmp_path / "backup", tmp_path / "restored", nothing)
    with running_service(tmp_path / "restored") as api:
        trend = api.trend("axis", limit=10_000)
        assert acknowledged <= len(trend) < len(whole)
        assert trend == whole[: len(trend)]
        assert api.axis("axis")["last_measurement"]["measurement"] == trend[-1]["measurement"]
        for number in range(len(trend), N_BEFORE + N_AFTER):  # the charts go on from there as they did
            api.accept("axis", measurement(number))
        again = api.trend("axis", limit=10_000)
        assert [point["state"] for point in again] == [point["state"] for point in whole]
        assert [point["preload_n"] for point in again] == [point["preload_n"] for point in whole]
        kinds = [(alarm["kind"], alarm["evidence"]) for alarm in api.http.get("/v1/alarms").json()["alarms"]]
        assert kinds == [(alarm["kind"], alarm["evidence"]) for alarm in alarms["alarms"]]
        assert kinds  # there was one


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a data folder of two days."""
    folder = tmp_path_factory.mktemp("kept") / "var"
    with running_service(folder) as api:
        prepare(api)
        for number in range(3):
            api.accept("axis", measurement(number))
    (folder / "reports").mkdir()
    (folder / "reports" / "job.html").write_text("<p>report</p>", encoding="utf-8")
    return folder


def spoil_waveform(folder: Path) -> str:
    (file,) = folder.rglob("*.zst")
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    return str(file.relative_to(folder))


def lose_waveform(folder: Path) -> str:
    (file,) = folder.rglob("*.zst")
    file.unlink()
    return str(file.relative_to(folder))


def spoil_report(folder: Path) -> str:
    (folder / "reports" / "job.html").write_text("", encoding="utf-8")
    return "reports/job.html"


def lose_rows(folder: Path) -> str:
    with closing(sqlite3.connect(folder / DATABASE)) as connection:
        connection.execute("DELETE FROM windows WHERE id = 1")
        connection.commit()
    return DATABASE


def cut_database(folder: Path) -> str:
    (folder / DATABASE).write_bytes((folder / DATABASE).read_bytes()[:-5000])
    return DATABASE


def lose_manifest(folder: Path) -> str:
    (folder / MANIFEST).unlink()
    return MANIFEST


@pytest.mark.parametrize("harm", [spoil_waveform, lose_waveform, spoil_report, lose_rows, cut_database, lose_manifest])
def test_damage_to_a_backup_is_noticed_by_name_and_nothing_is_restored(
    kept: Path, tmp_path: Path, harm: Callable[[Path], str]
) -> None:
    back_up(kept, tmp_path / "backup", nothing)
    name = harm(tmp_path / "backup")
    with pytest.raises(DataFolderError, match=name):
        restore(tmp_path / "backup", tmp_path / "restored", nothing)
    assert not (tmp_path / "restored").exists()


def test_what_there_is_of_a_damaged_backup_can_be_had(kept: Path, tmp_path: Path) -> None:
    back_up(kept, tmp_path / "backup", nothing)
    name = spoil_waveform(tmp_path / "backup")
    done = run("restore", tmp_path / "backup", "--data-dir", tmp_path / "restored", "--despite-damage")
    assert done.returncode == 1
    assert f"preload: damaged: {name} is not what was backed up" in done.stderr
    with running_service(tmp_path / "restored") as api:
        assert len(api.trend("axis")) == 3
        answers = [api.accept("axis", measurement(number)) for number in range(3)]  # and healed
    reasons = [item["reason"] for answer in answers for item in answer["windows"]]
    assert reasons.count("waveform-restored") == 1


def test_damage_of_the_data_itself_is_told_and_does_not_keep_it_from_being_restored(kept: Path, tmp_path: Path) -> None:
    back_up(kept, tmp_path / "first", nothing)
    restore(tmp_path / "first", tmp_path / "var", nothing)
    name = spoil_waveform(tmp_path / "var")
    done = run("backup", tmp_path / "second", "--data-dir", tmp_path / "var")
    assert done.returncode == 1
    assert name in done.stderr
    _, damaged = restore(tmp_path / "second", tmp_path / "restored", nothing)
    assert damaged == []  # known before


@pytest.mark.release
def test_commands(kept: Path, tmp_path: Path) -> None:
    done = run("backup", tmp_path / "backup", "--data-dir", kept, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    document = json.loads(done.stdout)
    assert document["rows"]["windows"] == 3 * N_WINDOWS
    assert {"preload.db", "reports/job.html"} < document["files"].keys()
    again = run("backup", tmp_path / "backup", "--data-dir", kept)
    assert (again.returncode, again.stderr.count("\n")) == (2, 1)
    assert "expected a new or empty folder" in again.stderr
    done = run("restore", tmp_path / "backup", "--data-dir", tmp_path / "restored")
    assert (done.returncode, done.stderr) == (0, "")
    assert "24 windows" in done.stdout
    with running_service(tmp_path / "restored") as api:
        refused = run("restore", tmp_path / "backup", "--data-dir", api.data_dir)
        assert refused.returncode == 2
        assert len(api.trend("axis")) == 3
    nowhere = run("backup", tmp_path / "other", "--data-dir", tmp_path / "nowhere")
    assert nowhere.returncode == 2
    assert "expected an embedded database" in nowhere.stderr
    elsewhere = run(
        "backup", tmp_path / "other", "--data-dir", kept, PRELOAD_DATABASE_URL="postgresql+psycopg://u:p@h/d"
    )
    assert elsewhere.returncode == 2
    assert "pg_dump" in elsewhere.stderr
    assert not (tmp_path / "other").exists()
