"""HDF5 as other programs write it: what attributes state is used, or refused where they differ; the rest is named."""

from datetime import UTC, datetime, timedelta

import h5py
import numpy as np
import pytest

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.check import check_file
from monitor_core.recordings.raw.binary import hdf5
from monitor_core.recordings.raw.channels import HEAD, Stored
from monitor_core.recordings.raw.inspection import read_as_proposed
from monitor_core.recordings.raw.mapping.channel_map import parse_channel_map, read_channel_map
from monitor_core.recordings.raw.mapping.imported import import_session
from monitor_core.recordings.raw.proposal.map_proposal import proposed_map

RATE, N = 2000.0, 3 * HEAD + 7
TORQUE = np.random.default_rng(5).normal(size=N)
ACC = 0.5 * TORQUE[::-1]


def on_the_dataset(file):  # h5labview, dascore, scripts with h5py
    for name, values, unit in (("scope/torque", TORQUE, "N.m"), ("scope/acceleration", ACC, "m/s2")):
        dataset = file.create_dataset(name, data=values, chunks=(4096,), compression="gzip")
        dataset.attrs.update({"unit": unit, "sampling_rate": RATE, "start_time": "2025-03-01T06:00:00Z"})


def on_the_group(file):
    run = file.create_group("run1")
    run.attrs.update({"dt": np.array([1.0 / RATE]), "t0": 0.25, "operator": "nobody"})
    run.create_dataset("torque", data=TORQUE.astype("f4")[:, None]).attrs["units"] = np.bytes_("N.m")
    run.create_dataset("acceleration", data=ACC).attrs["UNITS"] = "m/s2"


def by_scales(file):  # netCDF 4
    file["t"] = np.arange(N) / RATE
    file["t"].attrs["units"] = "seconds since 2025-03-01 06:00:00"
    file["t"].make_scale("t")
    for name, values in (("torque", TORQUE), ("acceleration", ACC)):
        file[name] = values
        file[name].dims[0].attach_scale(file["t"])
    file["torque"].attrs.update({"scale_factor": 2.0, "add_offset": 1.0, "_FillValue": TORQUE[3]})


def as_records(file):  # PyTables
    table = np.zeros(N, dtype=[("torque", "f8"), ("acceleration", "f4"), ("label", "S3")])
    table["torque"], table["acceleration"] = TORQUE, ACC
    file["table"] = table
    file["table"].attrs["fs"] = RATE


def in_columns(file):
    file["data"] = np.stack([TORQUE, ACC], axis=1)
    file["data"].attrs["sample_rate"] = int(RATE)
    file["wide"] = np.stack([TORQUE, ACC])


def read(tmp_path, write):
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        write(file)
    return path, hdf5.read_channels(path)


def test_datasets_are_channels_with_what_their_attributes_state(tmp_path):
    start = datetime(2025, 3, 1, 6, tzinfo=UTC)
    for write, names, unit, rate, starts in (
        (on_the_dataset, ("scope/acceleration", "scope/torque"), "N.m", RATE, start),
        (on_the_group, ("run1/acceleration", "run1/torque"), "N.m", RATE, None),
        (as_records, ("table.torque", "table.acceleration"), None, RATE, None),
    ):
        _, channels = read(tmp_path, write)
        torque = next(channel for channel in channels.channels if channel.name.endswith("torque"))
        assert channels.names == names
        assert (torque.unit, torque.time.rates, torque.time.started_at) == (unit, (rate,), starts)
        assert isinstance(torque.stored, Stored)
        np.testing.assert_array_equal(torque.samples, TORQUE.astype(torque.samples.dtype))
    assert read(tmp_path, on_the_group)[1].channel("run1/torque").time.runs[0].start == 0.25
    _, channels = read(tmp_path, in_columns)
    for name, expected in (("data", np.stack([TORQUE, ACC], axis=1)), ("wide", np.stack([TORQUE, ACC]))):
        channel = channels.channel(name)
        np.testing.assert_array_equal(np.concatenate(list(channel.pieces())), expected.reshape(-1))
        np.testing.assert_array_equal(channel.samples, expected)
        assert channel.head.shape[0 if name == "wide" else 1] == 2


def test_scales_are_clocks_and_numbers_of_netcdf_are_scaled(tmp_path):
    _, channels = read(tmp_path, by_scales)
    torque = channels.channel("torque")
    assert torque.time.clock == "t"
    assert channels.started_at(torque) == datetime(2025, 3, 1, 6, tzinfo=UTC)
    expected = np.where(np.arange(N) == 3, np.nan, 2.0 * TORQUE + 1.0)
    np.testing.assert_allclose(torque.samples, expected, rtol=1e-15)


def test_a_stated_start_is_that_of_sampling_times_unless_they_count_from_some_day(tmp_path):
    def with_times(file, first=0.0, unit="s"):
        file.attrs["start_time"] = "2025-03-01T06:00:00Z"
        for name, values in (("time", first + np.arange(N) / RATE), ("torque", TORQUE), ("acceleration", ACC)):
            file[name] = values
        for name, its_unit in (("time", unit), ("torque", "Nm"), ("acceleration", "g")):
            file[name].attrs["units"] = its_unit

    def with_scale(file, first=0.0):
        with_times(file, first)
        file["time"].make_scale("time")
        for name in ("torque", "acceleration"):
            file[name].dims[0].attach_scale(file["time"])

    text = """axis_id = "a"
    excitation = {channel = "torque", quantity = "torque", source = "sensor"}
    response = {channel = "acceleration"}
    [window]
    position_mm = 0
    position_span_mm = 0
    """
    begin, other = datetime(2025, 3, 1, 6, tzinfo=UTC), "started_at = 2020-01-01T00:00:00Z\n"
    for write, time in ((with_times, '[time]\nchannel = "time"\n'), (with_scale, "")):
        for first, says in ((0.0, ""), (0.25, ""), (1.7e9, other)):
            path, _ = read(tmp_path, lambda file, write=write, first=first: write(file, first))
            (window,) = import_session([path], parse_channel_map(text + says + time, "map.toml")).session.windows
            expected = datetime(2020, 1, 1, tzinfo=UTC) if says else begin + timedelta(seconds=first)
            assert window.started_at == expected, (write, first)
        path, _ = read(tmp_path, write)
        with pytest.raises(RecordingFormatError, match="expected the start stated once"):
            import_session([path], parse_channel_map(text + other + time, "map.toml"))
    _, channels = read(tmp_path, lambda file: with_times(file, 45_000.0, "d"))
    assert channels.channel("time").time.zero is None


def test_a_rate_is_read_in_the_unit_of_its_name(tmp_path):
    stated = {"dt_ms": 0.5, "sampling_interval_us": 500.0, "sample_rate_khz": 2.0, "Sampling Rate [kHz]": 2.0,
              "Sampling-Rate": RATE, "dt": 1.0 / RATE, "sampling_frequency_hz": RATE}  # fmt: skip

    def each(file):
        for number, (name, value) in enumerate(stated.items()):
            file[f"x{number}"] = TORQUE
            file[f"x{number}"].attrs[name] = value

    _, channels = read(tmp_path, each)
    assert dict(zip(stated, (c.time.sample_rate for c in channels.channels), strict=True)) == pytest.approx(
        dict.fromkeys(stated, RATE)
    )


def test_what_contradicts_itself_or_is_no_channel_is_said(tmp_path):
    def twice(file):
        on_the_dataset(file)
        file["scope/torque"].attrs["dt"] = 1e-3

    with pytest.raises(RecordingFormatError, match="scope/torque: expected attributes that state one sample rate; got"):
        read(tmp_path, twice)

    def others(file):
        file["force"] = TORQUE
        file["gain"] = 2.5
        file["cube"] = np.zeros((2, 3, 4))
        file["h"] = np.ones(4, complex)
        file["words"] = [b"a", b"b"]
        file["elsewhere"] = h5py.ExternalLink("another.h5", "/x")
        file["force"].attrs["sensitivity"] = 4.0
        file["again"] = file["/"]  # a group that holds itself
        file.create_dataset("never", (10,), "f8")

    path, channels = read(tmp_path, others)
    assert channels.names == ("force",)
    assert channels.numbers == {"gain": 2.5, "force.sensitivity": 4.0}
    left = "cube (3 dimensions); elsewhere (a link); h (complex); never (they were announced but never written)"
    assert "; ".join(channels.left_out) == f"{left}; words (texts)"
    assert check_file(path).valid


def test_two_commands_lead_from_hdf5_of_another_program_to_windows(tmp_path):
    path, _ = read(tmp_path, on_the_dataset)
    read_again = read_as_proposed(path, "hdf5")
    text = proposed_map(read_again.channels).toml()
    assert "the file says 2000 Hz" in text
    assert "the file says 2025-03-01T06:00:00+00:00" in text
    (tmp_path / "map.toml").write_text(text.replace("# position_mm =", "position_mm = 250 #"))
    session = import_session([path], read_channel_map(tmp_path / "map.toml")).session
    assert {window.sample_rate for window in session.windows} == {RATE}
    np.testing.assert_array_equal(session.windows[0].excitation, TORQUE[: session.windows[0].n_samples])
