"""Make a data folder by an older program, with what it says of it: ``python -m tests.service.older_folder COMMIT``.

The program runs from a checkout of its commit, with the packages of this environment, and is spoken to over HTTP as any
sender does. What comes of it is ``older/alarms/COMMIT.tar.xz``, which ``test_older_folders.py`` opens with the program
of now. Where that needs a step in between, ``--then OTHER COMMAND…`` runs a command of another commit on the folder.
"""

import argparse
import json
import os
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import IO

import httpx
import numpy as np

from tests.service.conftest import CONFIGURATION, START, Api, simulated_measurement

ARCHIVES = Path(__file__).parent / "older" / "alarms"
REPOSITORY = Path(__file__).parents[2]
#: What is told of an axis, and of alarms.
PATHS = ("/v1/axes/worn", "/v1/axes/repaired", "/v1/axes/worn/trend?limit=1000", "/v1/axes/repaired/trend?limit=1000",
         "/v1/alarms?limit=100")  # fmt: skip
#: Newtons, day by day: both lose a third; one gets a new nut and is healthy again.
WORN = [300.0] * 20 + [200.0] * 4
REPAIRED = [*WORN, *[300.0] * 12]
#: Known to every program; two windows are enough for a measurement of a simulated axis.
OF_AXES = {name: CONFIGURATION[name] for name in ("search_band_hz", "silent_after_hours", "baseline_size")}
OF_AXES |= {"windows_per_measurement": 2, "minimum_averages": 2}


@contextmanager
def checkout(commit: str) -> Iterator[Path]:
    """Yield a folder with the program of a commit."""
    with tempfile.TemporaryDirectory() as folder:
        git = ["git", "-C", str(REPOSITORY), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", folder, commit], check=True)
        try:
            yield Path(folder)
        finally:
            subprocess.run([*git, "remove", "--force", folder], check=True)


def command(program: Path, *words: str, log: IO[bytes] | None = None) -> "subprocess.Popen[bytes]":
    """Start ``preload`` of a checkout."""
    called = "import sys; from service.cli.main import main; sys.argv[0] = 'preload'; main()"
    environment = os.environ | {"PYTHONPATH": str(program)}
    return subprocess.Popen([sys.executable, "-c", called, *words], env=environment, cwd=program, stderr=log)


@contextmanager
def serving(program: Path, data_dir: Path) -> Iterator[Api]:
    """Run the service of a checkout on a port that is free, which it names in its first line."""
    log = data_dir.parent / "log"
    with log.open("wb") as writer:
        process = command(program, "serve", "--port", "0", "--data-dir", str(data_dir), log=writer)
    try:
        while not (named := [line for line in log.read_text().splitlines() if line.startswith("dashboard: ")]):
            assert process.poll() is None, log.read_text()
            time.sleep(0.2)
        url, patient = named[0].split()[1], httpx.HTTPTransport(retries=10)  # it is named before it listens
        with httpx.Client(base_url=url, transport=patient, timeout=60.0) as http:
            yield Api(http, data_dir)
    finally:
        process.terminate()
        process.wait()


def write(api: Api) -> None:
    """Let two axes wear; somebody sees both alarms, and clears that of the one that gets a new nut."""
    rng = np.random.default_rng(51)
    for axis, preloads in (("worn", WORN), ("repaired", REPAIRED)):
        api.http.put(f"/v1/axes/{axis}", json={"name": axis, "configuration": OF_AXES}).raise_for_status()
        api.calibrate(axis)
        for day, preload in enumerate(preloads):
            if day == len(WORN):
                _change_alarm(api, axis, "acknowledge", "looked at")
                _change_alarm(api, axis, "clear", "a new nut")
            started_at = START + timedelta(days=day)
            api.accept(
                axis, simulated_measurement(rng, f"d{day:02}", preload=preload, started_at=started_at, n_windows=2)
            )
    _change_alarm(api, "worn", "acknowledge", "seen, ordered a nut")


def _change_alarm(api: Api, axis: str, change: str, comment: str) -> None:
    (alarm,) = [alarm for alarm in api.http.get("/v1/alarms").json()["alarms"] if alarm["axis"] == axis]
    api.http.post(f"/v1/alarms/{alarm['id']}/{change}", json={"comment": comment}).raise_for_status()


def make(commit: str, then: list[str]) -> Path:
    """Return the archive of the folder that a commit wrote, and of what it said of it."""
    with tempfile.TemporaryDirectory() as folder:
        data_dir = Path(folder) / "var"
        with checkout(commit) as program, serving(program, data_dir) as api:
            write(api)
            answers = {path: api.http.get(path).raise_for_status().json() for path in PATHS}
        if then:
            with checkout(then[0]) as program:
                assert command(program, *then[1:], "--data-dir", str(data_dir)).wait() == 0
        (Path(folder) / "answers.json").write_text(json.dumps(answers))
        archive = ARCHIVES / f"{commit}.tar.xz"
        with tarfile.open(archive, "w:xz", preset=9) as writer:
            for name in ("answers.json", "var/preload.db"):  # waveforms are large, and no chart reads them
                writer.add(Path(folder) / name, name)
    return archive


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commit")
    parser.add_argument("--then", nargs="+", default=[], metavar=("COMMIT", "WORD"))
    asked = parser.parse_args()
    made = make(asked.commit, asked.then)
    print(f"{made}: {made.stat().st_size} bytes")
