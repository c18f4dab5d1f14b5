"""Raw files of several clocks, files and shapes become one session, motion record or FRF set; what is left is said."""

import math
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
import scipy.io

from monitor_core.errors import RecordingFormatError
from monitor_core.models.protocol import ExcitationPoint, ResponsePoint
from monitor_core.recording import Conditions, Direction, ExcitationQuantity, ExcitationSource, Session, Window
from monitor_core.recordings import read_motion_record, read_session, write_motion_record, write_session
from monitor_core.recordings.elements.units import Quantity, factor_to_si, response_factor, sensor_factor
from monitor_core.recordings.raw.channel_time import ChannelTime, Run
from monitor_core.recordings.raw.mapping import resampled
from monitor_core.recordings.raw.mapping.channel_map import parse_channel_map
from monitor_core.recordings.raw.mapping.imported import import_motion, import_session
from monitor_core.recordings.raw.mapping.imported_frf import import_frf_set
from monitor_core.recordings.raw.mapping.map_records import ResampleMethod, Resampling

START = datetime(2025, 3, 1, 6, tzinfo=UTC)
MAP = """
axis_id = "mill-3-x"
excitation = {channel = "force", quantity = "force", source = "sensor", unit = "N"}
response = {channel = "acc", unit = "m/s2"}
[window]
position_mm = 100.0
position_span_mm = 0.0
started_at = 2025-03-01T06:00:00Z
sample_rate_hz = 1000
"""
TIMED = MAP.replace("sample_rate_hz = 1000\n", "")


def saved(tmp_path, name="hit.npz", **arrays):
    np.savez(tmp_path / name, **arrays)
    return tmp_path / name


def noise(seed=1, n=400):
    return np.random.default_rng(seed).normal(size=(2, n))


def imported(paths, text):
    return import_session(paths if isinstance(paths, list) else [paths], parse_channel_map(text, "map.toml"))


def refusal(paths, text):
    with pytest.raises(RecordingFormatError) as caught:
        imported(paths, text)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# ---- shapes --------------------------------------------------------------------------------------------------------


def test_what_fills_no_window_is_left_out_and_said(tmp_path):
    force, acc = noise()
    made = imported(saved(tmp_path, force=force, acc=acc), MAP + "samples_per_window = 150\n")
    assert [window.n_samples for window in made.session.windows] == [150, 150]
    (left,) = made.left_out
    assert left.what == "the last 100 of 400 samples of hit.npz (0.1 s)"
    assert left.why == "they make no whole window of 150 samples"


def test_numbers_of_the_file_are_used_where_the_map_names_them(tmp_path):
    force, acc = noise()
    text = MAP.replace("sample_rate_hz = 1000", 'sample_rate_hz = "fs"') + 'samples_per_window = "nrofs"\n'
    for number, (rate, period) in enumerate(((2000.0, 100), (5000.0, 40))):  # one map for both
        numbers = {"fs": rate, "nrofs": np.uint16(period)}
        made = imported(saved(tmp_path, f"{number}.npz", force=force, acc=acc, **numbers), text)
        assert {(window.sample_rate, window.n_samples) for window in made.session.windows} == {(rate, period)}
        assert len(made.session.windows) == 400 // period
    step = saved(tmp_path, "step.npz", force=force, acc=acc, dt=0.0005, nrofs=100)
    made = imported(step, text.replace('"fs"', '"dt"'))
    assert made.session.windows[0].sample_rate == pytest.approx(2000.0)
    named = "expected a positive number 'fs', which sample_rate_hz of the map names; got none of that name"
    assert named in refusal(step, text)
    broken = saved(tmp_path, "broken.npz", force=force, acc=acc, fs=2000.0, nrofs=12.5)
    whole = "expected a whole number 'nrofs', which samples_per_window of the map names; got 12.5"
    assert whole in refusal(broken, text)


@pytest.mark.parametrize(("word", "turn"), [("row", np.asarray), ("column", np.transpose)])
def test_rows_and_columns_of_an_array_are_channels(tmp_path, word, turn):
    table = np.vstack([np.arange(400) / 1000.0, noise()])
    np.save(tmp_path / "hit.npy", turn(table))
    text = TIMED.replace('"force"', f'"array", {word} = 2', 1).replace('"acc"', f'"array", {word} = 3')
    text += f'[time]\nchannel = "array"\n{word} = 1\nunit = "s"\n'
    text = text.replace('quantity = "array", row = 2', 'quantity = "force"')
    (window,) = imported(tmp_path / "hit.npy", text).session.windows
    np.testing.assert_array_equal(window.excitation, table[1])
    np.testing.assert_array_equal(window.response, table[2])
    assert window.sample_rate == 1000.0
    far = text.replace(f"{word} = 3", f"{word} = 9")
    assert f"expected a {word} up to 3; got 9" in refusal(tmp_path / "hit.npy", far)


def test_counts_have_an_offset_and_a_sensitivity(tmp_path):
    counts = np.array([32768, 32868, 32668, 32768] * 50, dtype=np.uint16)
    text = MAP.replace(
        'unit = "N"}', 'unit = "count", offset = 32768, sensitivity = 0.5, sensitivity_unit = "N/count"}'
    )
    made = imported(saved(tmp_path, force=counts, acc=noise(n=200)[0]), text)
    np.testing.assert_array_equal(made.session.windows[0].excitation[:4], [0.0, 50.0, -50.0, 0.0])


def test_units_of_pounds_are_exact():
    # NIST SP 811 (2008), appendix B.8: lbf 4.448 222 N, lbf·in 0.112 984 8 N·m, lbf·ft 1.355 818 N·m, to seven digits.
    assert factor_to_si("lbf", Quantity.FORCE, "map") == pytest.approx(4.448222, rel=1e-6)
    assert factor_to_si("lbf·in", Quantity.TORQUE, "map") == pytest.approx(0.1129848, rel=1e-6)
    assert factor_to_si("ft-lbf", Quantity.TORQUE, "map") == pytest.approx(1.355818, rel=1e-6)
    assert sensor_factor("V", 10.0, "mV/lbf", Quantity.FORCE, "map") == pytest.approx(444.8222, rel=1e-6)
    assert response_factor(
        "um/N", ExcitationPoint.FORCE_AT_TABLE, ResponsePoint.DISPLACEMENT_AT_TABLE, "map"
    ) == pytest.approx(1e-6, rel=1e-15)


# ---- clocks --------------------------------------------------------------------------------------------------------


def two_clocks(tmp_path, seconds=2.0):
    """Save a force at 1000 Hz and an acceleration at 1250 Hz, 0.1 s later: sines of 20 and 30 Hz."""
    t1, t2 = np.arange(0.0, seconds, 1e-3), 0.1 + np.arange(0.0, seconds, 8e-4)
    return saved(
        tmp_path, t1=t1, t2=t2, force=np.sin(2 * np.pi * 20 * t1), acc=np.cos(2 * np.pi * 30 * t2)
    )  # fmt: skip


TWO = TIMED.replace('"force", q', '"force", time = "t1", q').replace('"acc", u', '"acc", time = "t2", u')
TWO += '[time]\nunit = "s"\n'
RESAMPLE = '[resample]\nsample_rate_hz = 2000\nmethod = "{}"\n'


def test_two_clocks_are_refused_unless_the_map_says_how(tmp_path):
    sentence = refusal(two_clocks(tmp_path), TWO)
    assert "expected channels of one sample rate; got 1000 Hz, 1250 Hz" in sentence
    assert "[resample] with sample_rate_hz and method" in sentence


@pytest.mark.parametrize(("method", "bound"), [("cubic", 1e-3), ("linear", 2e-2)])
def test_two_clocks_become_one_with_an_error_that_is_an_upper_bound(tmp_path, method, bound):
    made = imported(two_clocks(tmp_path), TWO + RESAMPLE.format(method))
    (window,) = made.session.windows
    t = 0.1 + np.arange(window.n_samples) / 2000.0
    assert window.sample_rate == 2000.0
    assert window.started_at == START + timedelta(seconds=0.1)
    misses = [window.excitation - np.sin(2 * np.pi * 20 * t), window.response - np.cos(2 * np.pi * 30 * t)]
    stated = [float(remark.split("at most ")[1].split(" %")[0]) / 100.0 for remark in made.remarks[:2]]
    for miss, said in zip(misses, stated, strict=True):
        inner = miss[20:-20]
        assert np.sqrt(np.mean(inner**2)) / np.sqrt(0.5) <= said < bound * 2
    assert made.left_out[0].what == "the first 0.1 s of hit.npz"


def test_uneven_sampling_is_never_taken_as_even(tmp_path):
    steps = np.random.default_rng(3).uniform(0.012, 0.021, 800)
    t = np.cumsum(steps)
    path = saved(tmp_path, t=t, force=np.sin(2 * np.pi * t), acc=np.cos(2 * np.pi * t))
    text = TIMED + '[time]\nchannel = "t"\nunit = "s"\n'
    sentence = refusal(path, text)
    assert "expected uniform sampling" in sentence
    assert "[resample]" in sentence
    made = imported(path, text + RESAMPLE.replace("2000", "60").format("cubic"))
    (window,) = made.session.windows
    at = t[0] + np.arange(window.n_samples) / 60.0
    np.testing.assert_allclose(window.response[10:-10], np.cos(2 * np.pi * at)[10:-10], atol=1e-3)


def test_pieces_that_share_a_time_are_found_in_steps_that_grow_with_their_number(monkeypatch):
    """Against all pairs, on two channels that pause at random, each at times of its own."""
    rng, n_steps = np.random.default_rng(9), 0

    def counted(pieces, shared=resampled._shared):
        nonlocal n_steps
        n_steps += 1
        return shared(pieces)

    monkeypatch.setattr(resampled, "_shared", counted)
    times, sizes = [], rng.integers(20, 200, (2, 300))
    for of_channel in sizes:
        begins = np.cumsum(rng.uniform(0.01, 0.1, of_channel.size)) + np.r_[0.0, np.cumsum(of_channel[:-1])] / 1000.0
        times.append(ChannelTime(runs=tuple(map(Run, of_channel.tolist(), begins.tolist(), [1000.0] * 300))))
    signals = [np.zeros(int(of_channel.sum())) for of_channel in sizes]
    made = resampled.resample(("a", "b"), signals, times, Resampling(500.0, ResampleMethod.LINEAR), "x")
    ends = [[(run.start, run.instants[-1]) for run in time.runs] for time in times]
    pairs = [(max(a[0], b[0]), min(a[1], b[1])) for a in ends[0] for b in ends[1]]
    expected = sorted((begin, math.floor((end - begin) * 500.0 * (1.0 + 1e-12)) + 1) for begin, end in pairs)
    assert [(piece.start, piece.signals[0].size) for piece in made] == [pair for pair in expected if pair[1] >= 8]
    assert n_steps <= 2 * 300


@pytest.mark.parametrize(("resampling", "rate"), [("", 1000.0), (RESAMPLE.format("cubic"), 2000.0)])
def test_no_window_crosses_a_gap(tmp_path, resampling, rate):
    t = np.r_[np.arange(0.0, 1.0, 1e-3), np.arange(1.5, 2.5, 1e-3)]
    text = TIMED + '[time]\nchannel = "t"\nunit = "s"\n' + resampling
    made = imported(saved(tmp_path, t=t, force=np.sin(t), acc=np.cos(t)), text)
    assert [window.started_at - START for window in made.session.windows] == [timedelta(0), timedelta(seconds=1.5)]
    for window, start in zip(made.session.windows, (0.0, 1.5), strict=True):
        assert window.sample_rate == rate
        np.testing.assert_allclose(window.excitation, np.sin(start + np.arange(window.n_samples) / rate), atol=1e-6)
    assert any("samples are missing" in remark and "for 0.5" in remark for remark in made.remarks)


def test_a_rate_lower_than_a_channel_s_shows_what_it_loses(tmp_path):
    t = np.arange(0.0, 1.0, 1e-4)
    fast = np.sin(2 * np.pi * 20 * t) + np.sin(2 * np.pi * 1700 * t)  # lies above half of the new rate
    text = TIMED + '[time]\nchannel = "t"\nunit = "s"\n' + RESAMPLE.format("cubic")
    made = imported(saved(tmp_path, t=t, force=fast, acc=np.cos(2 * np.pi * 20 * t)), text)
    assert float(made.remarks[0].split("at most ")[1].split(" %")[0]) > 50.0


def test_times_printed_to_few_digits_are_even_and_said(tmp_path):
    t = np.round(np.arange(2000) / 51_200.0, 6)
    text = TIMED + '[time]\nchannel = "t"\nunit = "s"\n'
    made = imported(saved(tmp_path, t=t, force=noise(n=2000)[0], acc=noise(n=2000)[1]), text)
    assert made.session.windows[0].sample_rate == pytest.approx(51_200.0, rel=1e-4)
    assert "times are printed to 1e-06 s" in made.remarks[0]


def test_texts_of_a_date_and_time_are_clock_and_start(tmp_path):
    rows = [f"01.03.2025;07:00:{k / 1000:06.3f};{k % 7};{k % 5}" for k in range(200)]
    (tmp_path / "log.csv").write_text("Date;Clock;force;acc\n" + "\n".join(rows) + "\n")
    text = TIMED.replace("started_at = 2025-03-01T06:00:00Z\n", "") + (
        '[time]\nchannel = "Clock"\ndate = "Date"\nformat = "%d.%m.%Y %H:%M:%S.%f"\nzone = "+01:00"\n'
        '[text]\nseparator = "semicolon"\nheader_row = 1\n'
    )
    (window,) = imported(tmp_path / "log.csv", text).session.windows
    assert (window.sample_rate, window.started_at) == (1000.0, START)


# ---- several files -------------------------------------------------------------------------------------------------


def several(tmp_path, n=3):
    return [saved(tmp_path, f"p{i}.npz", force=noise(i)[0], acc=noise(i)[1]) for i in range(n)]


def test_files_follow_each_other_at_an_interval(tmp_path):
    paths = several(tmp_path)
    assert "expected file_interval_s, or a start of each file in [[files]]" in refusal(paths, MAP)
    made = imported(paths, MAP + "file_interval_s = 60\n")
    assert [window.started_at - START for window in made.session.windows] == [timedelta(minutes=i) for i in range(3)]
    assert made.session.measurements == ("p0", "p1", "p2")
    assert made.remarks[0] == "files follow each other in the order given: p0.npz, p1.npz, p2.npz"


def test_files_have_facts_of_their_own(tmp_path):
    text = (
        MAP
        + "file_interval_s = 60\n"
        + (
            '[[files]]\nname = "p1.npz"\nposition_mm = 250\npreload_n = 900\ndirection = "+"\n'
            '[[files]]\nname = "p2.npz"\nstarted_at = 2025-03-02T06:00:00Z\nmeasurement = "later"\n'
            '[[files]]\nname = "other.npz"\nposition_mm = 1\n'
        )
    )
    made = imported(several(tmp_path), text)
    first, second, third = made.session.windows
    assert (first.conditions.position, second.conditions.position) == (0.1, 0.25)
    assert (second.conditions.preload, second.direction) == (900.0, Direction.POSITIVE)
    assert (third.measurement, third.started_at) == ("later", START + timedelta(days=1))
    assert "[[files]] of the map names 'other.npz', which is not given" in made.remarks


def test_files_that_overlap_are_refused(tmp_path):
    assert "expected a file that begins after p0.npz ends" in refusal(
        several(tmp_path), MAP + "file_interval_s = 0.1\n"
    )


def test_windows_near_each_other_are_one_numbered_measurement(tmp_path):
    x = np.repeat([100.0, 101.0, 250.0, 100.5], 100)  # [mm]
    force, acc = noise()
    text = MAP.replace("position_mm = 100.0\nposition_span_mm = 0.0\n", "")
    text += 'samples_per_window = 100\nposition_step_mm = 5\nmeasurement = "visit"\n'
    text += '[position]\nchannel = "x"\nunit = "mm"\n'
    made = imported(saved(tmp_path, force=force, acc=acc, x=x), text)
    assert [window.measurement for window in made.session.windows] == ["visit 1", "visit 1", "visit 2", "visit 3"]


# ---- doubts --------------------------------------------------------------------------------------------------------


def test_times_in_ms_that_pass_for_seconds_are_named(tmp_path):
    force, acc = noise()
    text = TIMED + '[time]\nchannel = "t"\nunit = "s"\n'
    sentence = refusal(saved(tmp_path, t=np.arange(400) * 0.1, force=force, acc=acc), text)
    assert "got 10 Hz" in sentence
    assert "unless the times are in ms" in sentence
    slow = imported(saved(tmp_path, t=np.arange(400) / 51.2, force=force, acc=acc), text)
    assert any("are the times in ms?" in remark for remark in slow.remarks)


def test_positions_in_mm_that_pass_for_metres_are_refused(tmp_path):
    force, acc = noise()
    text = MAP.replace("position_mm = 100.0\nposition_span_mm = 0.0\n", "") + '[position]\nchannel = "x"\nunit = "m"\n'
    path = saved(tmp_path, force=force, acc=acc, x=np.linspace(100.0, 400.0, 400))
    assert "the numbers may be in mm or um" in refusal(path, text)
    metres = saved(tmp_path, force=force, acc=acc, x=np.linspace(0.1, 0.4, 400))
    made = imported(metres, text.replace('unit = "m"\n', 'unit = "mm"\n'))
    assert any("are the numbers m where the map says mm?" in remark for remark in made.remarks)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f, a: (np.rint(3000 * f), a), "as a converter counts"),
        (lambda f, a: (f + 500.0, a), "is it an offset to take off?"),
        (lambda f, a: (1e-3 * f, 50.0 * a), "and not volts of a sensor?"),
        (lambda f, a: (1e3 * f, 1e5 * a), "and not mV or counts?"),
    ],
)
def test_numbers_of_another_quantity_are_doubted_by_name(tmp_path, change, words):
    force, acc = change(*noise())
    made = imported(saved(tmp_path, force=force, acc=acc), MAP)
    assert any("in doubt" in remark and words in remark for remark in made.remarks), made.remarks


def test_sound_numbers_are_not_doubted(tmp_path):
    force, acc = noise()
    assert not imported(saved(tmp_path, force=50 * force, acc=3 * acc + 9.81), MAP).remarks


# ---- motion and frequency responses --------------------------------------------------------------------------------

MOTION = """
time = {channel = "t", unit = "s"}
[motion]
position = {channel = "qm", unit = "mm"}
torque = {channel = "current", unit = "A", sensitivity = 0.74, sensitivity_unit = "N.m/A"}
"""


def test_a_motion_of_a_matlab_file_is_written_and_read_back(tmp_path):
    t = np.arange(500) / 250.0
    scipy.io.savemat(tmp_path / "m.mat", {"t": t, "qm": 100 * np.sin(t), "current": np.cos(t)})
    made = import_motion([tmp_path / "m.mat"], parse_channel_map(MOTION, "map.toml"))
    assert (made.record.sample_rate, made.record.quantity) == (250.0, ExcitationQuantity.TORQUE)
    np.testing.assert_allclose(made.record.position, 0.1 * np.sin(t), rtol=1e-15)
    np.testing.assert_allclose(made.record.drive, 0.74 * np.cos(t), rtol=1e-15)
    write_motion_record(tmp_path / "m.csv", made.record)
    np.testing.assert_array_equal(read_motion_record(tmp_path / "m.csv").drive, made.record.drive)


FRF = """
[frf]
input = "force-at-table"
output = "acceleration-at-table"
frequency = {channel = "1", unit = "Hz"}
WAY
resolution_hz = 0.5
[window]
position_mm = 250
payload_kg = 12
[[files]]
name = "b.txt"
position_mm = 300
"""


@pytest.mark.parametrize("polar", [False, True])
def test_columns_of_an_analyser_become_a_set(tmp_path, polar):
    f = np.arange(0.0, 50.0)
    h = (1.0 + f) * np.exp(1j * 0.1 * f)
    for name in ("a.txt", "b.txt"):
        columns = [f, np.abs(h), np.degrees(np.angle(h))] if polar else [f, h.real, h.imag]
        np.savetxt(tmp_path / name, np.column_stack(columns), fmt="%.17g")
    way = (
        'magnitude = {channel = "2", unit = "g/N"}\nphase = {channel = "3", unit = "deg"}\nrelative = 0.02'
        if polar
        else 'real = {channel = "2", unit = "g/N"}\nimaginary = {channel = "3", unit = "g/N"}\nstandard_deviation = 0.1'
    )
    made = import_frf_set([tmp_path / "a.txt", tmp_path / "b.txt"], parse_channel_map(FRF.replace("WAY", way), "m"))
    first, second = made.responses.observations
    np.testing.assert_allclose(first.response, 9.80665 * h[1:], rtol=1e-13)
    deviation = 0.02 * 9.80665 * np.abs(h[1:]) if polar else np.full(49, 0.980665)
    np.testing.assert_allclose(first.standard_deviation, deviation, rtol=1e-13)
    assert (first.conditions.position, second.conditions.position) == (0.25, 0.3)
    assert (first.conditions.payload_mass, first.resolution) == (12.0, 0.5)
    assert [left.what for left in made.left_out] == ["1 of 50 lines of a.txt", "1 of 50 lines of b.txt"]


def test_noise_of_the_lines_is_never_assumed():
    way = 'real = {channel = "2", unit = "m/(N.s2)"}\nimaginary = {channel = "3", unit = "m/(N.s2)"}'
    with pytest.raises(RecordingFormatError, match="expected standard_deviation or relative"):
        parse_channel_map(FRF.replace("WAY", way), "map.toml")


# ---- round trips ---------------------------------------------------------------------------------------------------


def recorded(precision):
    """Return a session of two measurements as an acquisition would have recorded it."""
    rng = np.random.default_rng(5)
    windows = [
        Window(
            excitation=rng.normal(size=600).astype(precision),
            response=rng.normal(size=600).astype(precision),
            sample_rate=1500.0,
            started_at=START + timedelta(seconds=0.4 * number),
            conditions=Conditions(0.1234, 12.5, 21.75, 400.0),
            measurement="morning",
            excitation_quantity=ExcitationQuantity.TORQUE,
            excitation_source=ExcitationSource.DRIVE,
            position_span=0.0005,
        )
        for number in range(3)
    ]
    return Session("mill-3-x", tuple(windows), "moves")


ROUND = """
axis_id = "mill-3-x"
description = "moves"
excitation = {channel = "torque", quantity = "torque", source = "drive", unit = "N.m"}
response = {channel = "acc", unit = "m/s2"}
[window]
sample_rate_hz = 1500
started_at = 2025-03-01T06:00:00Z
samples_per_window = 600
measurement = "morning"
position_mm = 123.4
position_span_mm = 0.5
payload_kg = 12.5
temperature_c = 21.75
preload_n = 400
"""


def written(path, torque, acc):
    if path.suffix == ".npz":
        np.savez(path, torque=torque, acc=acc)
    elif path.suffix == ".mat":
        scipy.io.savemat(path, {"torque": torque, "acc": acc})
    else:
        rows = "\n".join(f"{x!r},{y!r}" for x, y in zip(torque.tolist(), acc.tolist(), strict=True))
        path.write_text("torque,acc\n" + rows + "\n")


@pytest.mark.parametrize(("name", "precision"), [("a.npz", "f4"), ("a.npz", "f8"), ("a.mat", "f4"), ("a.csv", "f8")])
def test_a_session_comes_back_from_raw_files_to_the_last_bit(tmp_path, name, precision):
    session = recorded(precision)
    written(
        tmp_path / name,
        np.concatenate([window.excitation for window in session.windows]),
        np.concatenate([window.response for window in session.windows]),
    )
    made = imported(tmp_path / name, ROUND)
    write_session(tmp_path / "first.session.h5", session)
    write_session(tmp_path / "second.session.h5", made.session)
    assert (tmp_path / "first.session.h5").read_bytes() == (tmp_path / "second.session.h5").read_bytes()
    assert not made.left_out


def test_tolerances_stand_in_the_session(tmp_path):
    text = MAP + "[tolerances]\nposition_tolerance_mm = 0.5\n"
    made = imported(saved(tmp_path, force=noise()[0], acc=noise()[1]), text)
    write_session(tmp_path / "a.session.h5", made.session, tolerances=made.tolerances.attributes)
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.session.h5") as file:
        assert file.attrs["position_tolerance_mm"] == 0.5
    assert read_session(tmp_path / "a.session.h5").axis_id == "mill-3-x"
