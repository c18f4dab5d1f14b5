"""Kinds of files that people reported to the makers of their readers, each with the value that is right."""

import struct
from datetime import UTC, datetime

import numpy as np
import pytest

from monitor_core.recordings.check import check_file
from monitor_core.recordings.raw.binary import mat, uff58
from monitor_core.recordings.raw.formats import read_channels
from tests.recordings.test_raw import SAMPLES, refusal, uff_set


def test_a_universal_file_whose_last_line_is_filled_up_with_zeros_is_read(tmp_path):
    pytest.importorskip("pyuff")
    path, values = tmp_path / "a.uff", [*SAMPLES[:5], 0.0]
    path.write_bytes(uff_set(values, n_points=5))
    np.testing.assert_array_equal(uff58.read_channels(path).channels[0].samples, values[:5])
    path.write_bytes(uff_set([*values[:5], 7.0], n_points=5))
    assert "expected 5 samples as its header says; got 6" in refusal(uff58.read_channels, path)


def test_binary_samples_may_end_with_a_line_of_their_own(tmp_path):
    pytest.importorskip("pyuff")
    path, content = tmp_path / "a.uff", uff_set(SAMPLES, binary=True)
    end = content.rindex(b"    -1")
    path.write_bytes((content[:end] + b"\r\n" + content[end:]) * 2)
    for channel in uff58.read_channels(path).channels:
        np.testing.assert_array_equal(channel.samples, SAMPLES)


def test_doubles_that_matlab_stored_as_bytes_are_doubles(tmp_path):
    def element(kind, content):
        return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)

    array = element(6, struct.pack("<II", 6, 0)) + element(5, struct.pack("<ii", 1, 4)) + element(1, b"counts")
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<HH", 0x0100, 0x4D49)
    (tmp_path / "a.mat").write_bytes(head + element(14, array + element(2, bytes([0, 1, 2, 3]))))
    (channel,) = mat.read_channels(tmp_path / "a.mat").channels
    np.testing.assert_array_equal(channel.samples - 1.0, [-1.0, 0.0, 1.0, 2.0])


def test_dates_of_a_sheet_that_counts_from_1904_are_those_that_it_shows(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.epoch = openpyxl.utils.datetime.CALENDAR_MAC_1904
    book.active.append(["time", "force"])
    for milliseconds in range(5):
        book.active.append([datetime(2025, 3, 1, 6, 0, 0, 1000 * milliseconds), 1.0])  # noqa: DTZ001  # has none
    book.save(tmp_path / "a.xlsx")
    time = read_channels(tmp_path / "a.xlsx").channel("time")
    np.testing.assert_allclose(time.samples, 1e-3 * np.arange(5), atol=1e-6)


def test_instants_of_spark_have_no_zone_so_that_the_file_states_no_start(tmp_path):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    instants = pa.array(
        [datetime(2025, 3, 1, 6, 0, second, tzinfo=UTC) for second in range(3)], pa.timestamp("us", "UTC")
    )
    table = pa.table({"t": instants, "force": [1.0, 2.0, 3.0]})
    pq.write_table(table, tmp_path / "a.parquet", use_deprecated_int96_timestamps=True, store_schema=False)
    channels = read_channels(tmp_path / "a.parquet")
    np.testing.assert_array_equal(channels.channel("t").samples, [0.0, 1.0, 2.0])
    assert {channel.started_at for channel in check_file(tmp_path / "a.parquet").channels} == {None}
