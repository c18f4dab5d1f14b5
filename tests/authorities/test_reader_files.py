"""Files that other programs wrote: each is read with the numbers its writer meant, or refused with one sentence."""

import time
from datetime import UTC, datetime

import numpy as np
import pytest
import scipy.io

from monitor_core.errors import RecordingFormatError
from monitor_core.recording import ExcitationQuantity
from monitor_core.recordings import check_file, import_session, read_channel_map, read_channels

pytest.importorskip("nptdms")
pytest.importorskip("pyuff")

# name → (channels, samples of the first, unit of the first, sample rate of the first [Hz])
READ = {
    "tdms/Digital_Input.tdms": (3, 20_000, None, 2_000.0),
    "tdms/big_endian.tdms": (2, 3_500, None, 1_000.0),
    "tdms/raw1.tdms": (7, 2_000, "Volts", 50_000.0),
    "tdms/raw_timestamps.tdms": (1, 128, None, 1_000.0),
    "uff/MPSTD#Set001_2024_10_08_10_27_07.uff": (4, 222_400, "m/s2", 3_200.0),
    "uff/Sample_UFF58b_bin.uff": (1, 79_292, "Pa", 65_536.0),
    "uff/binary8byte.uff": (1, 250, "g", 100.0),
    "uff/time-history-not-all-columns-filled.uff": (1, 13, "m/s²", 20_000.0),
}
REFUSED = {
    "uff/dataset_milestone_in_header.uff": "expected 2508876 samples as its header says; got 42",
    "uff/TestLab 161 164 18 15 82.uff": "expected a time history or an FRF in data set 58; got data sets 151, 164, 18",
    "uff/sample_dataset58_psd.uff": "got function type 9 (power spectral density)",
}
# name → (responses, lines of the first, unit of the first as the file has it)
RESPONSES = {
    "uff/measurement.uff": (3, 1001, None),
    "uff/non_ascii_header.uff": (1, 6, "(1/N)*(m/s\ufffd)"),
}


@pytest.mark.parametrize("name", READ)
def test_a_good_file_is_read(measured_data, name):
    n_channels, n_samples, unit, sample_rate = READ[name]
    channels = read_channels(measured_data / "readers" / name)
    first = channels.channels[0]
    assert (len(channels.channels), first.samples.size, first.unit) == (n_channels, n_samples, unit)
    # the increment in a UFF header has six digits
    (run,) = first.time.runs
    assert run.sample_rate == pytest.approx(sample_rate, rel=1e-6)
    assert np.all(np.isfinite(first.samples))
    assert check_file(measured_data / "readers" / name).valid


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_without_a_whole_time_history_is_refused_at_once(measured_data, name):
    begin = time.perf_counter()
    with pytest.raises(RecordingFormatError) as caught:
        read_channels(measured_data / "readers" / name)
    assert REFUSED[name] in str(caught.value)
    assert "\n" not in str(caught.value)
    assert time.perf_counter() - begin < 5.0  # [s]; the file of 1.5 kB claims 2.5 million points


@pytest.mark.parametrize("name", RESPONSES)
def test_frequency_responses_of_an_analyser_are_read(measured_data, name):
    channels = read_channels(measured_data / "readers" / name)
    n_responses, n_lines, unit = RESPONSES[name]
    first = channels.responses[0]
    assert (len(channels.responses), first.frequency.size, first.response_unit) == (n_responses, n_lines, unit)
    assert not channels.channels
    assert np.all(np.isfinite(first.response))


def test_every_file_there_is_listed_here(measured_data):
    there = {
        str(p.relative_to(measured_data / "readers"))
        for k in ("tdms", "uff")
        for p in (measured_data / "readers" / k).iterdir()
    }
    assert there == READ.keys() | REFUSED.keys() | RESPONSES.keys()


def test_daqmx_scaling_and_time_stamps_of_tdms(measured_data):
    channels = read_channels(measured_data / "readers" / "tdms" / "raw1.tdms").channels
    slope = 0.0003051850947599719  # [V] per count, 10/32767, as the file's own linear scale says
    counts = channels[0].samples / slope
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    assert np.ptp(np.round(counts)) > 0
    assert channels[0].time.started_at == datetime(2016, 12, 15, 22, 35, 21, tzinfo=UTC)
    swept = read_channels(measured_data / "readers" / "tdms" / "big_endian.tdms").channels[0]
    assert swept.time.started_at is None  # recorded with relative time
    assert np.max(np.abs(swept.samples)) < 20.0  # a wrong byte order gives numbers of 1e±100


def test_binary_universal_file_is_the_sine_it_says(measured_data):
    channel = read_channels(measured_data / "readers" / "uff" / "binary8byte.uff").channels[0]
    times = np.arange(250) / 100.0
    # "sine 5 Hz", with the argument in single precision: numbers up to 78 rad are 7.6e-6 apart
    np.testing.assert_allclose(channel.samples, np.sin(2 * np.pi * 5.0 * times), rtol=0.0, atol=7.7e-6)


def test_emps_matlab_file_agrees_with_scipy(measured_data):
    path = measured_data / "emps" / "DATA_EMPS.mat"
    channels, reference = read_channels(path), scipy.io.loadmat(path)
    assert channels.names == ("qg", "qm", "t", "vir")  # the gains are single numbers, no channels
    for name in channels.names:
        np.testing.assert_array_equal(channels.channel(name).samples, reference[name][:, 0])


def test_pcb_shocks_become_windows(measured_data, tmp_path):
    (tmp_path / "map.toml").write_text(
        'axis_id = "board"\n[excitation]\nchannel = "X"\nquantity = "force"\nsource = "sensor"\nunit = "N"\n'
        '[response]\nchannel = "Y"\nunit = "m/s2"\n[window]\nsample_rate_hz = 51200\nposition_mm = 0\n'
        'position_span_mm = 0\nstarted_at = 2022-01-01T00:00:00Z\nwindows_in = "rows"\nwindow_interval_s = 60\n'
    )  # the input is a table acceleration: quantity and unit are a stand-in, the pipeline's ratio does not mind
    session = import_session(
        [measured_data / "pcb_shock" / "pcb_shock.npz"], read_channel_map(tmp_path / "map.toml")
    ).session
    assert len(session.windows) == 32
    assert session.windows[0].n_samples == 51_200
    assert session.windows[0].excitation.dtype == np.float32


def test_raw_hammer_hit_as_text(measured_data, tmp_path):
    (tmp_path / "map.toml").write_text(
        'axis_id = "tool"\n[excitation]\nchannel = "2"\nquantity = "force"\nsource = "sensor"\nunit = "N"\n'
        '[response]\nchannel = "3"\nunit = "m/s2"\n[time]\nchannel = "1"\nunit = "s"\n'
        "[window]\nposition_mm = 0\nposition_span_mm = 0\nstarted_at = 2020-01-01T00:00:00+08:00\n"
    )
    (window,) = import_session(
        [measured_data / "tool_frf" / "Impact_Point1_Channel1_CH1.txt"], read_channel_map(tmp_path / "map.toml")
    ).session.windows
    assert window.n_samples == 51_200
    assert window.sample_rate == pytest.approx(51_200.0, rel=1e-6)  # times are printed with seven digits
    assert window.excitation_quantity is ExcitationQuantity.FORCE
    # a hammer hit: the largest force stands far above the rest of the record
    assert np.max(window.excitation) > 100 * np.std(window.excitation[25_600:])


def test_a_text_with_a_preamble_is_refused_with_its_row(measured_data):
    with pytest.raises(RecordingFormatError, match=r"slow10_test0\.txt, row 3, column .*: expected"):
        read_channels(measured_data / "dropbear" / "slow10_test0.txt")
