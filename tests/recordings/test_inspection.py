"""What ``check`` lists of a file: channels with figures of their values, faults that are seen, quantities in doubt."""

import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import h5py
import numpy as np
import pytest
import scipy.io

from monitor_core.recording import Conditions, Session, Window
from monitor_core.recordings import check_file, write_session
from monitor_core.recordings.elements.units import Quantity, factor_to_si
from monitor_core.recordings.raw.channel_kind import kind_of_name, unit_in_name
from monitor_core.recordings.raw.channel_time import ChannelTime, Run, time_of_samples
from monitor_core.recordings.raw.channels import Channel, Channels
from monitor_core.recordings.raw.inspection import read_as_proposed, summaries_of, summary_of
from monitor_core.recordings.raw.text import columns
from tests.conftest import PROJECT_ROOT

RATE = 10_000.0
TIME = np.arange(5000) / RATE
MOVE = np.sin(2 * np.pi * 35.0 * TIME) * np.exp(-10.0 * TIME)


def noise(seed=0):
    return np.random.default_rng(seed).normal(size=TIME.size)


# ---- figures and faults -------------------------------------------------------------------------------------------


def test_a_channel_is_listed_with_shape_first_values_and_extremes(tmp_path):
    np.savez(tmp_path / "a.npz", torque=np.array([1.0, -2.5, 4.0]), acc=np.arange(12.0).reshape(3, 4))
    torque, acc = summaries_of(read_as_proposed(tmp_path / "a.npz", "npz").channels)
    assert (torque.name, torque.shape, torque.unit, torque.sample_rate) == ("torque", (3,), None, None)
    assert (torque.first_values, torque.minimum, torque.maximum) == ((1.0, -2.5, 4.0), -2.5, 4.0)
    assert (acc.shape, acc.first_values) == ((3, 4), (0.0, 1.0, 2.0, 3.0, 4.0))


def test_unit_rate_and_start_of_the_file_are_listed(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    properties = {
        "unit_string": "g", "wf_increment": 1e-4, "wf_start_time": np.datetime64("2025-03-01T06:00:00"),
    }  # fmt: skip
    with nptdms.TdmsWriter(str(tmp_path / "a.tdms")) as writer:
        writer.write_segment([nptdms.ChannelObject("Nut", "Acc", noise(), properties=properties)])
    (channel,) = summaries_of(read_as_proposed(tmp_path / "a.tdms", "tdms").channels)
    assert (channel.name, channel.shape, channel.unit) == ("Nut/Acc", (5000,), "g")
    assert channel.sample_rate == pytest.approx(RATE)
    assert channel.started_at == datetime(2025, 3, 1, 6, tzinfo=UTC)


def test_values_that_are_not_finite_are_counted_and_do_not_hide_the_extremes():
    samples = MOVE.copy()
    samples[[3, 7]], samples[11] = np.nan, np.inf
    summary = summary_of(Channel("torque", samples))
    assert summary.n_not_finite == 3
    assert summary.maximum == pytest.approx(MOVE.max())
    assert "3 of 5000 values are not finite" in summary.remarks
    nothing = summary_of(Channel("torque", np.full(4, np.nan)))
    assert (nothing.n_not_finite, nothing.minimum, nothing.maximum) == (4, None, None)


STUCK = np.where((TIME > 0.2) & (TIME < 0.3), 0.7, MOVE + 0.01 * noise())
FAULTS = {
    "constant": (np.full(5000, 2.5), "is_constant", "constant: 2.5 throughout"),
    "stuck": (STUCK, "is_stuck", "stuck: holds 0.7 for 999 values"),
    "clipped above": (np.minimum(noise(), 0.8), "is_clipped", "clipped: piles up at the end of its range"),
    "clipped below": (np.maximum(noise(), -0.8), "is_clipped", "clipped"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_channel_is_seen(fault):
    samples, flag, words = FAULTS[fault]
    summary = summary_of(Channel("acceleration", samples, "m/s2"))
    flags = {name: getattr(summary, name) for name in ("is_constant", "is_stuck", "is_clipped")}
    assert flags == {**dict.fromkeys(flags, False), flag: True}
    assert words in summary.remarks[0]


@pytest.mark.parametrize("samples", [noise(), MOVE, np.concatenate([np.zeros(3000), noise()[:2000]]), TIME])
def test_a_sound_channel_has_no_remark(samples):
    assert summary_of(Channel("acceleration", samples, "m/s2")).remarks == ()


def test_values_that_were_held_are_said_to_be_slower():
    summary = summary_of(Channel("torque", np.repeat(noise()[:1250], 4)))
    assert summary.remarks == ("repeated: each value stands 4 times, so it was recorded at a lower rate",)


def test_one_signal_on_two_channels_is_said():
    first, copy = Channel("a", noise()), Channel("b", noise())
    _, second, third = summaries_of(Channels("x", (first, copy, Channel("c", noise(1)))))
    assert second.remarks == ("holds the values of 'a'",)
    assert third.remarks == ()


def test_figures_of_a_reading_that_failed_are_not_shown(tmp_path):
    fast = np.where(np.arange(120_000) == 119_999, 1005.0, 6.0)
    rows = [f"{k / 1000},{value:g},{f'{k / 500},{k % 5}' if k < 60_000 else ','}" for k, value in enumerate(fast)]
    (tmp_path / "a.csv").write_text("Time1,Torque,Time2,Acc\n" + "\n".join(rows) + "\n", encoding="utf-8")
    found = read_as_proposed(tmp_path / "a.csv", "csv")
    of_torque = summaries_of(found.channels, found.figures)[1]
    assert (of_torque.name, of_torque.minimum, of_torque.maximum) == ("Torque", 6.0, 1005.0)


def test_what_an_import_says_of_times_is_said():
    back, printed = np.concatenate([TIME[:100], TIME[:100]]), np.round(np.arange(1000) / 2300.0, 4)
    pause = np.concatenate([TIME[:100], TIME[:100] + 5.0])
    said = (
        (np.cumsum(np.tile([0.012, 0.021], 50)), "expected uniform sampling every 0.0165455 s; got a step of 0.012 s"),
        (back, f"expected rising sampling times; they run back by {TIME[99]:.6g} s behind sample 99"),
        (printed, "times are printed to 0.0001 s, 23 % of a step; taken as even, as they agree"),  # a share of a digit
        (pause, f"samples are missing behind sample 99: for {5.0 - TIME[100]:.6g} s"),
        (np.where(TIME[7] == TIME, np.nan, TIME), "expected sampling times; number 7 is nan"),
    )
    found = [summary_of(Channel("time", times, "s")).remarks[-1] for times, _ in said]
    assert [(words, told) for (_, words), told in zip(said, found, strict=True) if words not in told] == []
    assert summary_of(Channel("time", 1e3 * TIME, "ms")).remarks == ()


def test_a_look_at_a_clock_says_what_an_import_says(tmp_path, monkeypatch):
    # a drift that no stretch of 2^20 shows: by 0.2 digits over all of it, by 0.09 over two thirds
    share = np.linspace(0.0, 1.0, 3 * 2**19)
    times = np.round(np.arange(share.size) / 51_200 + 8e-7 * share**2, 6)
    assert summary_of(Channel("time", times, "s")).remarks == (time_of_samples(times, 1e-6, "time")[0].unevenness,)
    read, n_read, found = columns.read_table, [], []
    monkeypatch.setattr(columns, "read_table", lambda *of: [n_read.append(1), read(*of)][1])
    for pause in (0.0, 5.0):
        times = np.arange(40_000) / 51_200 + pause * (np.arange(40_000) > 35_000)
        (tmp_path / "a.csv").write_text("time_s\n" + "\n".join(f"{t:.6f}" for t in times.tolist()))
        n_read.clear()
        look = read_as_proposed(tmp_path / "a.csv", "csv")
        printed, *breaks = summaries_of(look.channels, look.figures)[0].remarks
        assert (printed,) == time_of_samples(np.round(times, 6), 1e-6, "time_s")[1]
        found.append((len(n_read), breaks))
    assert found == [(1, []), (2, ["samples are missing behind sample 35000: for 5 s; no window crosses it"])]


def test_a_count_of_samples_is_no_time():
    count = np.concatenate([np.arange(100.0), np.arange(150.0, 250.0)])
    assert summary_of(Channel("n", count)).remarks == (
        "samples are missing behind sample 99: for 50 samples; no window crosses it",
    )
    assert "time: expected rising sampling times; they run back by 99 samples" in summary_of(
        Channel("time", np.tile(np.arange(100.0), 20))
    ).remarks[0]  # fmt: skip


def test_columns_of_one_value_are_read_once_more_for_all_of_them(tmp_path, monkeypatch):
    rows = "".join(f"{k},1,2,3,{k % 7}\n" for k in range(150_000))
    (tmp_path / "a.csv").write_text("t,a,b,c,d\n" + rows)
    read, n_read = columns.read_table, []
    monkeypatch.setattr(columns, "read_table", lambda *of: [n_read.append(1), read(*of)][1])
    channels = read_as_proposed(tmp_path / "a.csv", "csv").channels
    assert [channel.varies for channel in channels.channels] == [True, False, False, False, True]
    assert len(n_read) == 2


def test_breaks_of_a_channel_are_said():
    def remarks(*runs):
        samples = noise()[: 256 * len(runs)]
        return summary_of(Channel("acc", samples, "g", ChannelTime(runs=runs))).remarks

    missing, end = "samples are missing behind sample 255", "; no window crosses it"
    first, counted = Run(256, 0.0, 1024.0), replace(Run(256), mark="row 257 'overrun'", n_lost=50)
    assert remarks(first, Run(256, 10.0, 1024.0)) == (f"{missing}: for 9.75 s{end}",)  # 256 samples at 1024 Hz: 0.25 s
    assert remarks(first, Run(256)) == (f"{missing}: how many, the file does not say{end}",)
    assert remarks(Run(256), counted) == (f"{missing}, where row 257 'overrun' stands: 50 of them{end}",)
    assert remarks(first, Run(256, 0.25, 2048.0)) == remarks(Run(256), replace(counted, n_lost=0)) == ()
    many = remarks(*(Run(256, 10.0 * number, 1024.0) for number in range(10)))
    assert (len(many), many[-1]) == (6, "and 4 breaks more")


# ---- what it looks like -------------------------------------------------------------------------------------------

NAMES = {
    "Drive/Current": (Quantity.CURRENT, None),
    "Nut/Acceleration": (Quantity.ACCELERATION, None),
    "fActTorque": (Quantity.TORQUE, None),
    "MAIN.Axis1.ActPos": (Quantity.POSITION, None),
    "CurrentPosition": (Quantity.POSITION, None),
    "Zeit": (Quantity.TIME, None),
    "time_ms": (Quantity.TIME, "ms"),
    "t [s]": (Quantity.TIME, "s"),
    "Kraft (N)": (Quantity.FORCE, "N"),
    "Hammer": (Quantity.FORCE, None),
    "MotorTorque_Nm": (Quantity.TORQUE, "N.m"),
    "acc_m_s2": (Quantity.ACCELERATION, "m/s2"),
    "Beschleunigung": (Quantity.ACCELERATION, None),
    "Velocity [mm/s]": (Quantity.VELOCITY, "mm/s"),
    "actual/velocity_mm_s": (Quantity.VELOCITY, "mm/s"),
    "speed_rpm": (Quantity.SPEED, "rev/min"),
    "Drehzahl [1/min]": (Quantity.SPEED, "rev/min"),
    "theta_m": (Quantity.ANGLE, None),
    "phi_deg": (Quantity.ANGLE, "deg"),
    "iq_ad": (Quantity.CURRENT, None),
    "Linear scale [nm]": (Quantity.POSITION, "nm"),
    "axis_a": (None, None),
    "torque_a": (Quantity.TORQUE, None),  # of the axis A
    "force_v": (Quantity.FORCE, None),
    "motor_current_a": (Quantity.CURRENT, "A"),
    "torque_mv": (Quantity.TORQUE, "mV"),
    "temperature_c": (None, None),
    "a / (m/s²)": (None, "m/s2"),
    "Kraft in kN": (Quantity.FORCE, "kN"),
    "Torque [% of rated]": (Quantity.TORQUE, "%"),
    "torque_pct": (Quantity.TORQUE, "%"),
    "Torque %": (Quantity.TORQUE, "%"),
    "position_nm": (Quantity.POSITION, "nm"),
    "Torque [NM]": (Quantity.TORQUE, "N.m"),
    "G/A": (Quantity.ACCELERATION, None),
    "Drive/Torque": (Quantity.TORQUE, None),
    "acc_min": (Quantity.ACCELERATION, None),
    "frequency_hz": (Quantity.FREQUENCY, "Hz"),
    "AI0": (None, None),
}


def test_names_say_what_a_channel_measures(subtests):
    for name, case in NAMES.items():
        with subtests.test(name=name):
            assert (kind_of_name(name), unit_in_name(name)) == case


def test_a_unit_says_of_a_name_what_turns_and_what_is_a_current(subtests):
    still = np.sin(60.0 * TIME)
    for name, unit, kind in (
        ("Motor position", "deg", Quantity.ANGLE),
        ("Motor position", "mm", Quantity.POSITION),
        ("nact", "1/min", Quantity.SPEED),
        ("omega", "rad/s", Quantity.SPEED),
        ("Velocity", "rpm", Quantity.SPEED),
        ("Velocity", "m/min", Quantity.VELOCITY),
        ("Torque", "A", Quantity.CURRENT),
        ("Current", "N.m", Quantity.TORQUE),
        ("Torque", "%", Quantity.TORQUE),
    ):
        with subtests.test(name=name, unit=unit):
            summary = summary_of(Channel(name, still, unit))
            assert (summary.kind, [doubt for doubt in summary.doubts if unit != "%"]) == (kind, [])


def test_a_column_without_a_name_that_rises_evenly_looks_like_a_time():
    kinds = [summary_of(Channel(str(number), values)).kind for number, values in enumerate((TIME, MOVE), start=1)]
    assert kinds == [Quantity.TIME, None]


# ---- numbers of another quantity ----------------------------------------------------------------------------------

DOUBTED = {
    "milliseconds as seconds": (Channel("time_s", 0.1 * np.arange(200)), "rate of 10 Hz; in ms it would be 10000 Hz"),
    "unit of the file": (Channel("time", 0.2 * np.arange(200), "s"), "steps of 0.2 s are a sampling rate of 5 Hz"),
    "force in volts": (Channel("Force", MOVE, "V"), "named like a force, but its numbers are in V, a raw unit"),
    "force in N.m": (Channel("Hammer force", MOVE, "Nm"), "named like a force, but its numbers are in N.m"),
    "torque in N": (Channel("torque_n", MOVE, "N"), "named like a torque, but its numbers are in N"),
    "two units": (Channel("acc_g", MOVE, "m/s^2"), "its name says g, its unit is m/s^2"),
    "gravity in g": (Channel("acc", MOVE + 9.81, "g"), "is that of gravity in m/s2"),
    "gravity in m/s2": (Channel("acc", MOVE + 1.0, "m/s2"), "is that of gravity in g"),
    "millimetres as metres": (Channel("position_m", 100 * np.abs(MOVE)), "longer than an axis"),
}


def test_numbers_of_another_quantity_are_doubted_by_name(subtests):
    for case, (channel, words) in DOUBTED.items():
        with subtests.test(case=case):
            assert any(words in doubt for doubt in summary_of(channel).doubts), summary_of(channel).doubts


SOUND = {
    "time_s": (TIME, None), "time_ms": (1e3 * TIME, None), "Force": (MOVE, "N"), "acc_g": (MOVE, "g"),
    "Torque": (MOVE, "Nm"), "Current": (MOVE, "A"), "pos_mm": (300 * np.abs(MOVE), "mm"), "u": (MOVE, "V"),
}  # fmt: skip


@pytest.mark.parametrize("name", SOUND)
def test_numbers_that_fit_are_not_doubted(name):
    assert summary_of(Channel(name, *SOUND[name])).doubts == ()


# ---- reports ------------------------------------------------------------------------------------------------------


def test_a_motion_record_in_milliseconds_is_valid_and_in_doubt(tmp_path):
    rows = [f"{k},{k / 1000},{np.sin(k)}" for k in range(200)]
    (tmp_path / "m.csv").write_text("\n".join(["time_s,position_m,force_n", *rows]))
    report = check_file(tmp_path / "m.csv")
    assert (report.format, report.valid, report.usable_by) == ("motion-record", True, ("explain",))
    assert "time_s: steps of 1 s are a sampling rate of 1 Hz; in ms it would be 1000 Hz" in report.doubts
    assert [channel.name for channel in report.channels] == ["time_s", "position_m", "force_n"]


def test_a_modal_table_in_metres_is_in_doubt(tmp_path):
    (tmp_path / "t.csv").write_text("position_mm,frequency_hz\n0.25,189\n0.75,172\n")
    report = check_file(tmp_path / "t.csv")
    assert report.doubts == ("position_mm: positions of at most 0.75 mm: are these numbers in metres?",)


def session_of(path, settings, *, n_windows=2):
    start, windows = datetime(2025, 3, 1, tzinfo=UTC), []
    for number, (position, preload) in enumerate(settings):
        for window in range(n_windows):
            at = start + timedelta(minutes=number, seconds=window)
            conditions = Conditions(position, None, None, preload)
            windows.append(Window(noise(window), noise(7), RATE, at, conditions, f"m{number}"))
    write_session(path, Session("mill-3-x", tuple(windows)))


GRID = [(position, preload) for position in (0.25, 0.5, 0.75) for preload in (100.0, 200.0)]


def test_a_session_says_windows_measurements_positions_and_who_takes_it(tmp_path):
    session_of(tmp_path / "a.session.h5", GRID)
    report = check_file(tmp_path / "a.session.h5")
    contents = dict(report.contents)
    assert (contents["axis_id"], contents["windows"], contents["measurements"]) == ("mill-3-x", 12, 6)
    assert (contents["positions_mm"], contents["preloads_n"]) == ((250.0, 500.0, 750.0), (100.0, 200.0))
    assert [(channel.name, channel.shape, channel.unit) for channel in report.channels] == [
        ("excitation", (12, 5000), "N.m"), ("response", (12, 5000), "m/s2"),
    ]  # fmt: skip
    assert set(report.usable_by) == {"frf", "estimate", "calibrate", "identify", "explain", "replay"}
    assert "preload calibrate" in report.next_step


@pytest.mark.parametrize(
    ("settings", "lacks"),
    [
        ([(0.25, None)], "5 measurements with preload_n; it has 0"),
        ([*GRID[:2] * 3], "3 positions; it has 1"),
        ([(position, 100.0) for position, _ in GRID], "2 preloads; it has 1"),
    ],
)
def test_a_session_that_is_no_calibration_says_what_that_would_need(tmp_path, settings, lacks):
    session_of(tmp_path / "a.session.h5", settings)
    report = check_file(tmp_path / "a.session.h5")
    assert "calibrate" not in report.usable_by
    assert lacks in report.next_step
    assert report.next_step.startswith("preload frf ")


def test_bad_windows_of_a_session_are_counted_by_channel(tmp_path):
    path = tmp_path / "a.session.h5"
    session_of(path, GRID)
    with h5py.File(path, "r+") as file:
        file["windows/000001/response"][5] = np.nan
        file["windows/000002/excitation"][:] = 3.0
    excitation, response = check_file(path).channels
    assert (excitation.remarks, response.remarks) == (
        ("constant in 1 of 12 windows",),
        ("not finite in 1 of 12 windows",),
    )
    assert response.n_not_finite == 1


def test_valid_is_never_the_whole_answer(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"x": noise()})
    (tmp_path / "own.py").write_text("EFFECTS = ()\n")
    session_of(tmp_path / "a.session.h5", GRID[:1])
    replay_data = PROJECT_ROOT / "replay_data"
    files = [
        *tmp_path.iterdir(), replay_data / "published" / "nguyen_table2.csv", *(replay_data / "models").iterdir(),
    ]  # fmt: skip
    for path in files:
        report = check_file(path)
        assert report.valid, report.problems
        assert report.usable_by
        assert report.next_step


def test_a_program_is_not_run_to_be_looked_at(tmp_path):
    (tmp_path / "own.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\nEFFECTS = ()\n")
    assert check_file(tmp_path / "own.py").format == "effect-file"
    assert not (tmp_path / "ran").exists()


def test_a_model_that_cannot_be_built_is_not_valid(tmp_path):
    text = (PROJECT_ROOT / "replay_data" / "models" / "lumped.toml").read_text(encoding="utf-8")
    (tmp_path / "bad.toml").write_text(f"{text}\n[effects.no-such-effect]\nx = 1.0\n")
    report = check_file(tmp_path / "bad.toml")
    assert (report.format, report.valid, report.usable_by) == ("preload-model", False, ())


def test_a_motion_model_goes_with_a_motion_record(tmp_path):
    (tmp_path / "m.toml").write_text('family = "motion"\n[parameters]\nmoving_mass_kg = 95.0\n')
    report = check_file(tmp_path / "m.toml")
    assert (report.valid, report.usable_by) == (True, ("explain",))
    assert "preload explain MOTION.csv --baseline" in report.next_step


@pytest.mark.parametrize("page", ["reference/recordings.md", "how-to/explain.md"])
def test_the_motion_model_of_the_documentation_is_one(tmp_path, page):
    text = (PROJECT_ROOT / "docs" / page).read_text(encoding="utf-8")
    (example,) = re.findall(r'```toml\n(family = "motion".*?)```', text, flags=re.DOTALL)
    (tmp_path / "rigid-axis.toml").write_text(example)
    report = check_file(tmp_path / "rigid-axis.toml")
    assert (report.format, report.problems, dict(report.contents)["family"]) == ("preload-model", (), "motion")


def test_the_next_step_names_what_an_import_makes(tmp_path):
    columns = {"t": TIME, "Position_m": MOVE, "Force_n": MOVE}
    np.savez(tmp_path / "axis.npz", **columns)
    np.savez(tmp_path / "lines.npz", frequency=TIME[1:], real=MOVE[1:], imag=MOVE[1:])
    np.savez(tmp_path / "hits.npz", force=MOVE, acc=MOVE)
    made = {path.stem: check_file(path).uses[0].line.rpartition(" ")[2] for path in tmp_path.iterdir()}
    assert made == {"axis": "axis.motion.csv", "lines": "lines.frf.h5", "hits": "hits.session.h5"}


@pytest.mark.parametrize(("start", "what"), [(45_000.25, "Excel"), (739_000.25, "MATLAB")])
def test_times_in_days_are_said_to_be_days(start, what):
    days = start + np.arange(4000) / 1000.0 / 86400.0
    (doubt,) = summary_of(Channel("time", days)).doubts
    assert f"are days, as {what} counts them" in doubt
    assert 'unit = "d" in [time]' in doubt
    assert not summary_of(Channel("time_s", 45_000.0 + np.arange(4000) / 1000.0)).doubts


@pytest.mark.parametrize(
    ("unit", "quantity", "factor"),
    [
        ("daN", Quantity.FORCE, 10.0), ("kgf", Quantity.FORCE, 9.80665), ("N·mm", Quantity.TORQUE, 1e-3),
        ("in", Quantity.POSITION, 0.0254), ("in/s2", Quantity.ACCELERATION, 0.0254),
    ],
)  # fmt: skip
def test_units_of_older_sheets_are_exact(unit, quantity, factor):
    assert factor_to_si(unit, quantity, "a.csv") == factor


def test_in_at_the_end_of_a_name_is_a_unit_of_travel_alone():
    assert unit_in_name("travel_in") == "in"
    assert unit_in_name("signal_in") is None
