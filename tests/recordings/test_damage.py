"""Damaged bytes: every reader reads or raises ``RecordingFormatError``, nothing else, within bounds of time and memory.

The readers run in a process of their own with limited memory: HDF5 and scipy are known to end the process on some
damaged files (see ``hdf5_heap`` and ``mat``), and a length in a damaged HDF5 text may claim up to 4 GB.
"""

import importlib
import json
import random
import resource
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from monitor_core.errors import RecordingFormatError
from monitor_core.recording import Conditions, Session, Window
from monitor_core.recordings import write_session
from tests.recordings.test_raw import SAMPLES, uff_set

N_DAMAGED = 150
MEMORY = 2**31  # [bytes] of address space; the readers themselves need about a quarter
SLOWEST = 5.0  # [s] for files of a few kB, on a busy machine


def _session(path):
    start = datetime(2025, 3, 1, tzinfo=UTC)
    windows = (
        Window(np.arange(32.0), np.ones(32), 1e3, start + timedelta(seconds=i), Conditions(0.1), "a") for i in (0, 1)
    )
    write_session(path, Session("x", tuple(windows)))


def _tdms(path):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(path) as file:
        for _ in range(2):
            file.write_segment([nptdms.ChannelObject("g", "c", SAMPLES, properties={"wf_increment": 1e-4})])


def _npz(path):
    with path.open("wb") as stream:
        np.savez(stream, x=SAMPLES, y=np.ones((3, 4), "f4"))


MAKERS = {
    "session_hdf5.read_session": _session,
    "npz.read_channels": _npz,
    "mat.read_channels": lambda p: scipy.io.savemat(p, {"x": SAMPLES, "y": np.arange(9)}, appendmat=False),
    "mat.read_channels version 4": lambda p: scipy.io.savemat(p, {"x": SAMPLES}, format="4", appendmat=False),
    "tdms.read_channels": _tdms,
    "uff58.read_channels": lambda p: p.write_bytes(uff_set(SAMPLES) + uff_set(SAMPLES, binary=True)),
    "csv_samples.read_channels": lambda p: p.write_text("t,a\n" + "".join(f"{i},{i / 4}\n" for i in range(40))),
    "modal_csv.read_modal_table": lambda p: p.write_text("position_mm,frequency_hz,mode\n" + "250,189.25,1\n" * 20),
    "channel_map.read_channel_map": lambda p: p.write_bytes(
        b'axis_id = "x"\n[excitation]\nchannel = "f"\nquantity = "force"\nsource = "sensor"\nunit = "N"\n[response]\n'
        b'channel = "a"\nunit = "g"\n[window]\nposition_mm = 1\nposition_span_mm = 0\n'
    ),
}  # fmt: skip


def damaged(content: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.2:
        return content[: rng.randrange(1, len(content))]
    result = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 8))):
        head = min(len(result), 1000)  # headers are where lies are told
        at = rng.randrange(head if rng.random() < 0.5 else len(result))
        result[at] = rng.choice((0, 255, 127, 128, rng.randrange(256)))
    return bytes(result)


@pytest.mark.slow
@pytest.mark.parametrize("case", MAKERS)
def test_damaged_files_are_read_or_refused(tmp_path, case):
    good = tmp_path / "good"
    MAKERS[case](good)
    rng = random.Random(case)  # noqa: S311  # seeded, so that a failure comes back
    folder = tmp_path / "damaged"
    folder.mkdir()
    for number in range(N_DAMAGED):
        (folder / f"{number:03d}").write_bytes(damaged(good.read_bytes(), rng))
    run = subprocess.run(
        [sys.executable, "-W", "error", "-m", "tests.recordings.test_damage", case.split()[0], str(folder)],
        cwd=Path(__file__).parents[2], capture_output=True, text=True, timeout=240, check=False,
    )  # fmt: skip
    assert run.returncode == 0, f"last file {run.stdout.splitlines()[-1:]}: {run.stderr[-2000:]}"
    outcome = json.loads(run.stdout.splitlines()[-1])
    assert outcome["read"] + outcome["refused"] == N_DAMAGED
    assert outcome["refused"] > N_DAMAGED // 10  # damage was done
    assert outcome["lines"] == 1  # one sentence
    assert outcome["slowest_s"] < SLOWEST


def _read_all(reader: str, folder: Path) -> None:
    module, _, function = reader.partition(".")
    raw = module in ("npz", "mat", "tdms", "uff58", "csv_samples", "channel_map")
    package = "monitor_core.recordings.raw" if raw else "monitor_core.recordings"
    read = getattr(importlib.import_module(f"{package}.{module}"), function)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    outcome = {"read": 0, "refused": 0, "slowest_s": 0.0, "lines": 0}
    for path in sorted(folder.iterdir()):
        print(path.name, flush=True)
        begin = time.process_time()
        try:
            read(path)
            outcome["read"] += 1
        except RecordingFormatError as error:
            outcome["refused"] += 1
            outcome["lines"] = max(outcome["lines"], len(str(error).splitlines()))
        outcome["slowest_s"] = max(outcome["slowest_s"], time.process_time() - begin)
    print(json.dumps(outcome))


if __name__ == "__main__":
    _read_all(sys.argv[1], Path(sys.argv[2]))
