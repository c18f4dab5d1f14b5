"""MDF 4 as asammdf writes it: packed in three ways, clocks of the groups, and files that are cut off."""

import itertools
import struct
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest

from monitor_core.errors import MissingReaderError
from monitor_core.recordings.raw.binary import mdf4
from tests.recordings.test_raw import refusal

asammdf = pytest.importorskip("asammdf")
TIMES = 0.5 + np.arange(200) / 1000.0
START = datetime(2025, 3, 1, 7, 0, tzinfo=timezone(timedelta(hours=1)))


def signal(values, times, name, unit="", **settings):
    return asammdf.Signal(np.asarray(values), times, unit=unit, name=name, **settings)


def written(path, *groups, version="4.10", packing=0, start=START):
    with asammdf.MDF(version=version) as file:
        file.start_time = start
        for group in groups:
            file.append(list(group))
        file.save(path, overwrite=True, compression=packing)
    return path


CURRENT = np.sin(TIMES * 40.0) / 3.0


@pytest.fixture
def mdf_file(tmp_path):
    return written(
        tmp_path / "a.mf4",
        [
            signal(CURRENT, TIMES, "Current", "A"),
            signal(np.arange(200, dtype="i2"), TIMES, "Voltage", "V", conversion={"a": 0.25, "b": -1.0}),
        ],
        [
            signal(np.cos(TIMES[:50]).astype("f4"), TIMES[:50] * 4, "Acc", "g"),
            signal(np.array([b"remark"] * 50), TIMES[:50] * 4, "Remark", encoding="utf-8"),
        ],
    )


def test_samples_are_what_was_written_in_each_version_and_packing(tmp_path, subtests):
    for packing, version in itertools.product([0, 1, 2], ["4.00", "4.10", "4.11"]):
        with subtests.test(packing=packing, version=version):
            path = written(
                tmp_path / "a.mf4", [signal(CURRENT, TIMES, "Current", "A")], version=version, packing=packing
            )
            channels = mdf4.read_channels(path)
            assert channels.names == ("time", "Current")
            np.testing.assert_array_equal(channels.channel("Current").samples, CURRENT)
            np.testing.assert_array_equal(channels.channel("time").samples, TIMES)


def test_each_group_has_its_clock_and_conversions_are_applied(mdf_file):
    channels = mdf4.read_channels(mdf_file)
    assert channels.names == ("1/time", "Current", "Voltage", "2/time", "Acc")
    assert [channel.time.clock for channel in channels.channels] == [None, "1/time", "1/time", None, "2/time"]
    assert [channel.unit for channel in channels.channels] == ["s", "A", "V", "s", "g"]
    np.testing.assert_array_equal(channels.channel("Voltage").samples, 0.25 * np.arange(200) - 1.0)
    assert channels.channel("Acc").samples.dtype == np.float32
    np.testing.assert_array_equal(channels.channel("2/time").samples, TIMES[:50] * 4)


def test_a_channel_starts_at_its_first_sampling_time(mdf_file):
    channels = mdf4.read_channels(mdf_file)
    assert channels.started_at(channels.channel("Current")) == datetime(2025, 3, 1, 6, 0, 0, 500_000, tzinfo=UTC)
    assert channels.started_at(channels.channel("Acc")) == datetime(2025, 3, 1, 6, 0, 2, tzinfo=UTC)


def test_a_local_time_without_zone_is_no_start(tmp_path):
    path = written(tmp_path / "a.mf4", [signal(CURRENT, TIMES, "Current")], start=datetime(2025, 3, 1, 7))  # noqa: DTZ001
    assert mdf4.read_channels(path).channel("Current").time.zero is None


def test_samples_that_the_file_calls_invalid_are_nan(tmp_path):
    invalid = np.zeros(200, bool)
    invalid[[3, 7]] = True
    path = written(tmp_path / "a.mf4", [
        signal(CURRENT, TIMES, "Current", invalidation_bits=invalid),
        signal(CURRENT, TIMES, "Dead", invalidation_bits=np.ones(200, bool)),
    ])  # fmt: skip
    channels = mdf4.read_channels(path)
    assert channels.names == ("time", "Current")
    np.testing.assert_array_equal(channels.channel("Current").samples, np.where(invalid, np.nan, CURRENT))


def test_a_long_channel_of_arrays_is_left_out_as_a_short_one_is(tmp_path, subtests):
    for n in (1000, 40_000):
        with subtests.test(n=n):
            times, arrays = np.arange(n) / 1000.0, np.zeros(n, dtype=[("arrays", "<f8", (3,))])
            path = written(tmp_path / "a.mf4", [signal(np.sin(times), times, "T"), signal(arrays, times, "arrays")])
            read = mdf4.read_channels(path)
            np.testing.assert_array_equal(read.channel("T").samples, np.sin(times))
            assert "arrays" not in read.names


def test_other_versions_and_unfinished_files_are_named(tmp_path):
    path = tmp_path / "a.mdf"
    with asammdf.MDF(version="3.30") as file:
        file.append([signal(CURRENT, TIMES, "Current")])
        file.save(path, overwrite=True)
    assert "expected MDF of version 4; got '3.30': convert it to version 4" in refusal(mdf4.read_channels, path)
    path.write_bytes(b"UnFinMF 4.10".ljust(200, b"\0"))
    assert "its writer never closed it" in refusal(mdf4.read_channels, path)
    path.write_bytes(b"hello")
    assert "it begins with b'hello'" in refusal(mdf4.read_channels, path)


def changed(path, place, layout, *values):
    content = bytearray(path.read_bytes())
    struct.pack_into(layout, content, place, *values)
    path.write_bytes(content)


def test_more_records_than_there_are_is_a_file_that_is_cut_off(mdf_file):
    at = mdf_file.read_bytes().index(b"##CG")
    changed(mdf_file, at + 24 + 6 * 8 + 8, "<Q", 201)
    assert "expected 201 samples as its header says; got 200: it is cut off" in refusal(mdf4.read_channels, mdf_file)


def test_a_formula_in_the_file_is_not_evaluated(tmp_path):
    path = written(tmp_path / "a.mf4", [signal(np.arange(200), TIMES, "x", conversion={"formula": "X*2+1"})])
    assert "a formula as text, which is not evaluated" in refusal(mdf4.read_channels, path)


def test_a_missing_library_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(__import__("sys").modules, "asammdf", None)
    with pytest.raises(MissingReaderError, match=r"pip install asammdf"):
        mdf4.read_channels(tmp_path / "a.mf4")
