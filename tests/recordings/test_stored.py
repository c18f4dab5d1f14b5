"""Long channels stay in their file: a look goes through it once and keeps a part, an import reads what is named."""

import math
import struct
import subprocess
import sys

import numpy as np
import pytest
from asammdf import MDF, Signal
from nptdms import ChannelObject, TdmsWriter
from nptdms.tdms_segment import TdmsSegment

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.check import check_file
from monitor_core.recordings.raw.channels import HEAD, Channel, Stored
from monitor_core.recordings.raw.formats import read_channels
from monitor_core.recordings.raw.inspection import summary_of
from monitor_core.recordings.raw.text.columns import read_as_proposed
from monitor_core.recordings.raw.text.table import _csv_of_arrow

N = 2**18 + 77  # more than one piece of any reader
RATE = 4096.0


def signals(n: int = N) -> dict[str, np.ndarray]:
    """Signals whose remarkable samples are far behind the beginning; all are exact in seven digits."""
    noise = np.random.default_rng(3)
    times = np.arange(n) / RATE
    times[n - 50_000 :] += 1.0  # a pause
    torque = noise.integers(-4000, 4000, n) / 1000.0
    torque[n - 10] = 9.5
    acceleration = np.clip(noise.integers(-3000, 3000, n) / 1000.0, -1.5, None)  # clipped
    return {"time": times, "torque": torque, "acceleration": acceleration}


def write_tdms(path, columns):
    with TdmsWriter(path) as writer:
        for start in range(0, columns["time"].size, 100_000):
            writer.write_segment([ChannelObject("g", n, v[start : start + 100_000]) for n, v in columns.items()])


def write_mdf(path, columns):
    with MDF(version="4.10") as file:
        times = columns["time"]
        file.append([Signal(v, times, name=n) for n, v in columns.items() if n != "time"])
        file.save(path, overwrite=True)


def write_parquet(path, columns):
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table(columns), path, row_group_size=100_000)


def write_csv(path, columns):
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    path.write_text(",".join(columns) + "\n" + "\n".join(",".join(map(repr, row)) for row in rows) + "\n")


WRITERS = {"a.tdms": write_tdms, "a.mf4": write_mdf, "a.parquet": write_parquet, "a.csv": write_csv}


def test_of_a_long_file_a_look_sees_all_samples_and_an_import_reads_those_that_are_named(tmp_path):
    columns, faults = signals(), []
    for name, write in WRITERS.items():
        path = tmp_path / name
        write(path, columns)
        read = read_as_proposed(path)[0] if name == "a.csv" else read_channels(path)
        by_name = {channel.name.rpartition("/")[2]: channel for channel in read.channels}
        summaries = {summary.name.rpartition("/")[2]: summary for summary in check_file(path).channels}
        for column, values in columns.items():
            channel, summary = by_name[column], summaries[column]
            stays = name == "a.csv" or isinstance(channel.stored, Stored)
            expected = (True, (N,), float(values.min()), float(values.max()), True, True)
            found = (
                stays, channel.shape, summary.minimum, summary.maximum,
                np.array_equal(channel.head, values[:HEAD]), np.array_equal(channel.samples, values),
            )  # fmt: skip
            faults += [(name, column, found)] if found != expected else []
        faults += [
            (name, "time", r) for r in summaries["time"].remarks if "samples are missing behind sample 212220" not in r
        ]
        faults += [name] if not summaries["time"].remarks or not summaries["acceleration"].is_clipped else []
        faults += [name] if summaries["torque"].remarks else []
    assert not faults, faults


def test_what_the_segments_of_a_tdms_file_say_is_read_once(tmp_path, monkeypatch):
    write_tdms(tmp_path / "a.tdms", signals())
    read, n_read = TdmsSegment.read_segment_objects, []
    monkeypatch.setattr(TdmsSegment, "read_segment_objects", lambda *of: [n_read.append(1), read(*of)][1])
    assert check_file(tmp_path / "a.tdms").valid
    assert len(n_read) == 3  # of 100 000 rows each


def test_of_a_long_channel_what_a_part_of_it_shows_is_found():
    noise = np.random.default_rng(1).normal(size=2**20)
    stuck, gap, late = noise.copy(), noise.copy(), 0.25 * np.arange(2**20)
    stuck[700_000:900_000] = 2.5
    gap[-3] = np.nan
    late[-1] -= 0.4
    assert [summary_of(Channel("acc", values)).is_stuck for values in (noise, stuck)] == [False, True]
    assert "stuck: holds 2.5 for about 2e+05 values" in summary_of(Channel("acc", stuck)).remarks[0]
    assert summary_of(Channel("acc", gap)).n_not_finite == 1
    assert summary_of(Channel("acc", np.repeat(noise[::8], 8))).remarks[0].startswith("repeated: each value stands 8")
    assert "they run back by 0.15 s behind sample 1048574" in summary_of(Channel("time", late, "s")).remarks[0]
    assert summary_of(Channel("acc", noise)).remarks == ()


def test_a_channel_that_is_shorter_than_its_file_said_is_refused():
    def pieces(wanted):
        yield from ((number, np.zeros(70)) for number in wanted)

    with pytest.raises(RecordingFormatError, match="expected 100 samples as its header says; got 70"):
        _ = Channel("acc", Stored((100,), np.zeros(10), 0, pieces)).samples


def test_numbers_of_a_long_table_are_those_of_python():
    read, forms = _csv_of_arrow(), ("%r", "%.6f", "%.17g", "%.3e", "%+.9g")
    bits = struct.unpack("<5000d", np.random.default_rng(1).bytes(40_000))
    shown = [forms[i % len(forms)] % value for i, value in enumerate(bits) if math.isfinite(value)]
    for decimal in ".,":
        text = "\n".join(f"{cell}; 1" for cell in shown).replace(".", decimal)
        np.testing.assert_array_equal(read(text, 2, ";", decimal)[0][0], list(map(float, shown)))
    assert read("1;2\n\n3;4", 2, ";", ".") is read("\n3;4", 2, ";", ".") is read("3;4\n", 2, ";", ".") is None
    odd = ["", " ", "1_0", "1.5", "x", "NA", "null", '"1"', "1 2", "0x1", "1'000", "--1", "1;2", "1\n\n2;3"]
    assert [cell for cell in odd if read(f"{cell};1\n2;3", 2, ";", ",") is not None] == []


@pytest.mark.release
@pytest.mark.parametrize("name", [*WRITERS])
def test_a_look_at_a_long_file_holds_a_small_part_of_it(tmp_path, name):
    n = 4 * N
    columns = signals(n)
    WRITERS[name](tmp_path / name, {**columns, **{f"ch{i}": columns["torque"] for i in range(7)}})
    (tmp_path / "few.csv").write_text("a,b\n1,2\n3,4\n")
    program = (
        "import resource, sys, pathlib, pyarrow.csv, pyarrow.parquet, asammdf, nptdms\n"
        "from monitor_core.recordings.check import check_file\n"
        "check_file(pathlib.Path(sys.argv[1]))\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "assert check_file(pathlib.Path(sys.argv[2])).valid\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)\n"
    )
    arguments = [sys.executable, "-c", program, tmp_path / "few.csv", tmp_path / name]
    held = int(subprocess.run(arguments, check=True, capture_output=True, text=True).stdout) * 1024
    in_memory = 8 * n * 10
    assert held < in_memory / 2, f"{held >> 20} MiB of {in_memory >> 20}"
