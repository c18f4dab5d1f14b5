"""Parquet as pyarrow writes it: types, packings, instants, and tables that would fill the memory."""

import itertools
from datetime import UTC, datetime

import numpy as np
import pytest

from monitor_core.errors import MissingReaderError
from monitor_core.recordings.raw.binary import parquet
from monitor_core.recordings.raw.channels import Stored
from monitor_core.recordings.raw.mapping.channel_map import parse_channel_map
from monitor_core.recordings.raw.mapping.imported import import_session
from tests.recordings.test_raw import refusal

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")
FORCE = np.random.default_rng(24).normal(size=5000)


def written(tmp_path, columns, **settings):
    pq.write_table(pa.table(columns), tmp_path / "a.parquet", **settings)
    return tmp_path / "a.parquet"


def test_numbers_are_what_was_written_in_each_packing(tmp_path, subtests):
    for packing, version in itertools.product(["none", "snappy", "gzip", "zstd", "brotli", "lz4"], ["1.0", "2.0"]):
        with subtests.test(packing=packing, version=version):
            path = written(
                tmp_path,
                {"force": FORCE, "count": np.arange(5000, dtype="u2") % 7, "single": FORCE.astype("f4")},
                compression=packing, data_page_version=version, row_group_size=1700, data_page_size=4096,
            )  # fmt: skip
            channels = parquet.read_channels(path)
            assert channels.names == ("force", "count", "single")
            np.testing.assert_array_equal(channels.channel("force").samples, FORCE)
            np.testing.assert_array_equal(channels.channel("count").samples, np.arange(5000) % 7)
            assert channels.channel("single").samples.dtype == np.float32


def test_of_a_map_that_states_the_rate_only_what_it_names_is_read(tmp_path, monkeypatch):
    columns = {name: FORCE.repeat(10) for name in ("speed", "force", "acc", "temperature")}
    path, read = written(tmp_path, columns), list[str]()

    def noted(stored, where, of_file=Stored.read):
        read.append(where)
        return of_file(stored, where)

    monkeypatch.setattr(Stored, "read", noted)
    text = """axis_id = "a"
    excitation = {channel = "force", quantity = "force", source = "sensor", unit = "N"}
    response = {channel = "acc", unit = "m/s2"}
    [window]
    sample_rate_hz = 1000
    started_at = 2025-03-01T06:00:00Z
    position_mm = 0
    position_span_mm = 0
    """
    assert import_session([path], parse_channel_map(text, "map.toml")).session.windows[0].n_samples == 50_000
    assert {name.rpartition(", ")[2] for name in read} <= {"force", "acc"}


@pytest.mark.parametrize(("unit", "per_second"), [("ms", 10**3), ("us", 10**6), ("ns", 10**9)])
def test_instants_become_seconds_from_the_first_which_is_the_start(tmp_path, unit, per_second):
    instants = 1_740_808_800 * per_second + 250 * per_second // 1000 + np.arange(5) * per_second // 1000
    columns = {
        "utc": pa.array(instants, pa.timestamp(unit, "Europe/Berlin")),
        "local": pa.array(instants, pa.timestamp(unit)),
    }
    channels = parquet.read_channels(written(tmp_path, columns, coerce_timestamps=None))
    for name in ("utc", "local"):
        np.testing.assert_array_equal(channels.channel(name).samples, np.arange(5) / 1000)
        assert channels.channel(name).unit == "s"
    assert channels.started_at(channels.channel("utc")) == datetime(2025, 3, 1, 6, 0, 0, 250_000, tzinfo=UTC)
    assert channels.channel("local").time.started_at is None


def test_units_come_from_the_metadata_of_a_column_and_gaps_are_nan(tmp_path):
    schema = pa.schema([
        pa.field("force", pa.float64(), metadata={"unit": "N"}),
        pa.field("acc", pa.int32(), metadata={"Units": "g"}),
    ])  # fmt: skip
    pq.write_table(pa.table({"force": [1.5, 2.5, 3.5], "acc": [1, None, 3]}, schema=schema), tmp_path / "a.parquet")
    channels = parquet.read_channels(tmp_path / "a.parquet")
    assert [channel.unit for channel in channels.channels] == ["N", "g"]
    np.testing.assert_array_equal(channels.channel("acc").samples, [1.0, np.nan, 3.0])


def test_what_is_no_channel_is_left_out(tmp_path):
    path = written(tmp_path, {
        "x": [1.0, 2.0], "text": ["a", "b"], "truth": [True, False], "list": [[1], [2]], "record": [{"a": 1}, {"a": 2}],
    })  # fmt: skip
    assert parquet.read_channels(path).names == ("x",)


def test_a_file_that_is_cut_off_or_none_is_refused(tmp_path):
    path = written(tmp_path, {"x": FORCE})
    content = path.read_bytes()
    path.write_bytes(content[:-10])
    assert "expected a Parquet file" in refusal(parquet.read_channels, path)
    path.write_bytes(b"x,y\n1,2\n")
    assert "which begins with PAR1" in refusal(parquet.read_channels, path)


@pytest.mark.parametrize("packing", ["gzip", "zstd", "brotli", "lz4"])  # snappy packs 64 bytes into 3 at best
def test_a_file_that_unpacks_to_a_thousand_times_its_size_is_refused_by_its_size(tmp_path, packing):
    path = written(tmp_path, {"x": np.zeros(2**24)}, compression=packing, use_dictionary=False)
    assert "save it without compression" in refusal(parquet.read_channels, path)


def test_values_that_repeat_are_counted_as_what_they_become(tmp_path):
    path = written(tmp_path, {f"x{number}": np.zeros(2**22) for number in range(3)})
    assert "it announces 100663296: save it without compression" in refusal(parquet.read_channels, path)


def test_a_missing_library_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow.parquet", None)
    with pytest.raises(MissingReaderError, match=r"pip install pyarrow"):
        parquet.read_channels(tmp_path / "a.parquet")
