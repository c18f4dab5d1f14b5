"""Damaged bytes: every reader reads or raises ``RecordingFormatError``, nothing else, within bounds of time and memory.

The readers run in a process of their own with limited memory: HDF5 and scipy are known to end the process on some
damaged files (see ``elements/hdf5.py`` and ``raw/binary/mat.py``).
"""

import importlib
import io
import json
import os
import random
import resource
import subprocess
import sys
import time
import warnings
import wave
import zipfile
from datetime import UTC, datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

from monitor_core.errors import RecordingFormatError
from monitor_core.recording import Conditions, Session, Window
from monitor_core.recordings import write_session
from tests.recordings.test_raw import SAMPLES, uff_set

N_DAMAGED = int(os.environ.get("PRELOAD_FUZZ", "150"))
MEMORY = 2**32  # [bytes] of address space, most of which the libraries only reserve
SLOWEST = 2.0  # [s] for files of a few kB


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


def _mat_7_3(path):
    with h5py.File(path, "w", userblock_size=512) as file:
        matrix = file.create_dataset("m", data=np.arange(300.0).reshape(3, 100), chunks=(1, 50), compression="gzip")
        matrix.attrs["MATLAB_class"] = np.bytes_("double")
        file.create_group("record")["force"] = SAMPLES[None]
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + path.read_bytes()[512:])


def _packed_session(path):
    _session(path)
    with h5py.File(path, "a") as file:
        for window in file["windows"].values():
            samples = window["response"][()]
            del window["response"]
            window.create_dataset("response", data=samples, chunks=(8,), compression="gzip", fletcher32=True)


def _wav(path):
    with wave.open(str(path), "wb") as file:
        file.setparams((2, 3, 51_200, 0, "NONE", "NONE"))
        file.writeframes(bytes(range(240)))


def _mdf4(path):
    asammdf = pytest.importorskip("asammdf")
    times = np.arange(60) / 1e3
    with asammdf.MDF(version="4.10") as file:
        file.append(
            [
                asammdf.Signal(np.sin(times), times, unit="A", name="Current"),
                asammdf.Signal(np.arange(60, dtype="i2"), times, name="Counts", conversion={"a": 0.5, "b": 1.0}),
            ]
        )
        file.append([asammdf.Signal(np.cos(times[:20]).astype("f4"), times[:20], unit="g", name="Acc")])
        written = file.save(path.with_suffix(".mf4"), compression=2)
    written.rename(path)  # fmt: skip


def _parquet(path):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    table = pa.table({"t": pa.array(range(60), pa.timestamp("us", "UTC")), "f": np.arange(60.0), "n": [1, None] * 30})
    pq.write_table(table, path, compression="zstd")


def _xlsx(path):
    book = pytest.importorskip("openpyxl").Workbook()
    for row in [("t", "f", "remark"), *((i / 1e3, i * 0.25, "x") for i in range(30))]:
        book.active.append(row)
    book.save(path)


def _frf_58(path):
    pyuff = pytest.importorskip("pyuff")
    frequency = np.arange(20.0)
    file = pyuff.UFF(str(path.with_suffix(".uff")))
    for binary in (0, 1):
        response = pyuff.prepare_58(
            binary=binary, func_type=4, id1=f"H{binary}", x=frequency, data=frequency * 1j, abscissa_spacing=1,
            rsp_node=1, rsp_dir=1, ref_node=2, ref_dir=1, ordinate_spec_data_type=12, orddenom_spec_data_type=13,
        )  # fmt: skip
        with warnings.catch_warnings(action="ignore"):  # pyuff leaves its file open
            file.write_sets(response, "add")
    path.with_suffix(".uff").rename(path)


MAKERS = {
    "session_hdf5.read_session": _session,
    "session_hdf5.read_session packed": _packed_session,
    "raw.binary.npz.read_channels": _npz,
    "raw.binary.npz.read_channels npy": lambda p: p.write_bytes(_npy(np.arange(60.0).reshape(3, 20))),
    "raw.binary.mat.read_channels 7.3": _mat_7_3,
    "raw.binary.mat.read_channels structure": lambda p: scipy.io.savemat(
        p, {"r": {"force": SAMPLES, "inner": {"a": np.ones((2, 3))}}}, appendmat=False
    ),
    "raw.binary.wav.read_channels": _wav,
    "raw.binary.mdf4.read_channels": _mdf4,
    "raw.binary.parquet.read_channels": _parquet,
    "raw.binary.xlsx.read_channels inside": _xlsx,
    "raw.binary.uff58.read_channels frf": _frf_58,
    "raw.binary.mat.read_channels": lambda p: scipy.io.savemat(p, {"x": SAMPLES, "y": np.arange(9)}, appendmat=False),
    "raw.binary.mat.read_channels version 4": lambda p: scipy.io.savemat(
        p, {"x": SAMPLES}, format="4", appendmat=False
    ),
    "raw.binary.tdms.read_channels": _tdms,
    "raw.binary.uff58.read_channels": lambda p: p.write_bytes(uff_set(SAMPLES) + uff_set(SAMPLES, binary=True)),
    "raw.text.columns.read_channels": lambda p: p.write_text(
        "t,a\n" + "".join(f"{i},{i / 4}\n" for i in range(40))
    ),
    "motion_csv.read_motion_record": lambda p: p.write_text(
        "time_s,position_m,force_n\n" + "".join(f"{i / 1000},{i / 4},{i % 7}\n" for i in range(150))
    ),
    "modal_csv.read_modal_table": lambda p: p.write_text("position_mm,frequency_hz,mode\n" + "250,189.25,1\n" * 20),
    "raw.mapping.channel_map.read_channel_map": lambda p: p.write_bytes(
        b'axis_id = "x"\n[excitation]\nchannel = "f"\nquantity = "force"\nsource = "sensor"\nunit = "N"\n[response]\n'
        b'channel = "a"\nunit = "g"\n[window]\nposition_mm = 1\nposition_span_mm = 0\n'
    ),
}  # fmt: skip


def _npy(array):
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def damaged_inside(content: bytes, rng: random.Random) -> bytes:
    """Damage a part of an archive, whose checksums then hold."""
    result = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as archive, zipfile.ZipFile(result, "w") as written:
        unlucky = rng.choice(archive.namelist())
        for name in archive.namelist():
            part = archive.read(name)
            written.writestr(name, damaged(part, rng) if name == unlucky else part)
    return result.getvalue()


def damaged(content: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.2:
        return content[: rng.randrange(1, len(content))]
    result = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 8))):
        head = min(len(result), 1000)  # headers are where lies are told
        at = rng.randrange(head if rng.random() < 0.5 else len(result))
        result[at] = rng.choice((0, 255, 127, 128, rng.randrange(256)))
    return bytes(result)


@pytest.mark.release
@pytest.mark.parametrize("case", MAKERS)
def test_damaged_files_are_read_or_refused(tmp_path, case):
    good = tmp_path / "good"
    MAKERS[case](good)
    rng = random.Random(case)  # noqa: S311  # seeded, so that a failure comes back
    folder = tmp_path / "damaged"
    folder.mkdir()
    for number in range(N_DAMAGED):
        damage = damaged_inside if case.endswith("inside") else damaged
        (folder / f"{number:03d}").write_bytes(damage(good.read_bytes(), rng))
    run = subprocess.run(
        [sys.executable, "-W", "error", "-m", "tests.recordings.test_damage", case.split()[0], str(folder)],
        cwd=Path(__file__).parents[2], capture_output=True, text=True, timeout=240 + N_DAMAGED, check=False,
    )  # fmt: skip
    assert run.returncode == 0, f"last file {run.stdout.splitlines()[-1:]}: {run.stderr[-2000:]}"
    outcome = json.loads(run.stdout.splitlines()[-1])
    assert outcome["read"] + outcome["refused"] == N_DAMAGED
    assert outcome["refused"] > N_DAMAGED // 10  # damage was done
    assert outcome["lines"] == 1  # one sentence
    assert outcome["slowest_s"] < SLOWEST
    assert outcome["memory_mib"] < 1024


def peak_mib() -> int:
    """Return the most memory of this process; ``ru_maxrss`` would begin with that of the process that started it."""
    (line,) = (line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) // 1024


def _read_all(reader: str, folder: Path) -> None:
    module, _, function = reader.rpartition(".")
    read = getattr(importlib.import_module(f"monitor_core.recordings.{module}"), function)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    if (good := folder.parent / "good").exists():
        read(good)  # loads the library, which is not the file's time
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
    outcome["memory_mib"] = peak_mib()
    print(json.dumps(outcome))


if __name__ == "__main__":
    _read_all(sys.argv[1], Path(sys.argv[2]))
