"""Cells that are no numbers, columns that are not read, and what names propose: said by their place, never lost."""

from datetime import datetime, timedelta
from decimal import Decimal

import numpy as np
import pytest

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings import import_session, read_channel_map
from monitor_core.recordings.check import check_file
from monitor_core.recordings.raw.channels import Channel, Channels
from monitor_core.recordings.raw.formats import read_channels
from monitor_core.recordings.raw.proposal.map_proposal import proposed_map
from monitor_core.recordings.raw.proposal.parts import Made, made_of
from monitor_core.recordings.raw.text.layout import TextLayout

TIMES = np.arange(64) / 1000.0
WAVE = np.round(3000.0 * np.cos(60.0 * TIMES), 2)


def said_of(path, layout=None):
    with pytest.raises(RecordingFormatError) as caught:
        read_channels(path, layout)
    return str(caught.value)


# ---- sheets and columns -------------------------------------------------------------------------------------------


def test_a_cell_of_another_kind_is_named_by_row_and_column_in_each_tabular_format(tmp_path, subtests):
    openpyxl = pytest.importorskip("openpyxl")
    date = datetime(2025, 3, 1, 6)  # noqa: DTZ001  # a sheet knows no zone
    cells = {
        "a date": (date, "expected numbers as above; got a date or a time"),
        "a duration": (timedelta(hours=1), "a date"), "an error": ("#DIV/0!", "'#DIV/0!'"),
        "a text": ("overload", "'overload'"), "a number as text": ("1.5", "'1.5'"), "a truth value": (True, "'True'"),
    }  # fmt: skip
    for case, (cell, sentence) in cells.items():
        for row in (2, 7, 60):
            book = openpyxl.Workbook()
            book.active.append(("t", "force"))
            for i, time in enumerate(TIMES, start=2):
                book.active.append((time, cell if i == row else i / 3.0))
            book.save(tmp_path / "a.xlsx")
            with subtests.test(format="xlsx", case=case, row=row):
                said = said_of(tmp_path / "a.xlsx")
                at = row if row > 2 or "date" not in sentence else 3  # a date comes first: the number is what differs
                assert f"row {at}, column 'force'" in said
                assert sentence in said or at == 3
            lines = [f"{time:g},{cell if i == row else i / 3.0}" for i, time in enumerate(TIMES, start=2)]
            (tmp_path / "a.csv").write_text("t,force\n" + "\n".join(lines) + "\n", encoding="utf-8")
            with subtests.test(format="csv", case=case, row=row):
                if case == "a number as text":
                    assert read_channels(tmp_path / "a.csv").names == ("t", "force")
                else:
                    assert f"row {row}, column 'force'" in said_of(tmp_path / "a.csv")


def test_a_date_in_a_column_of_dates_is_no_fault(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(("when", "force", "gain", "remark"))
    for i in range(9):
        book.active.append((datetime(2025, 3, 1, 6, 0, i), 0.5 * i, f"{i}.5", "ok"))  # noqa: DTZ001
    book.save(tmp_path / "a.xlsx")
    channels = read_channels(tmp_path / "a.xlsx")
    assert channels.names == ("when", "force")
    assert channels.left_out == (
        "gain (numbers stored as text, from row 2 on: turn them into numbers in Excel)", "remark (texts)",
    )  # fmt: skip
    assert ("not_read", channels.left_out) in check_file(tmp_path / "a.xlsx").contents


def test_durations_times_of_day_and_decimals_of_parquet_are_numbers_and_the_rest_is_named(tmp_path):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    milliseconds = [0, 5, None, 15]
    columns = {
        "since": pa.array(milliseconds, pa.duration("ms")), "clock": pa.array(milliseconds, pa.time32("ms")),
        "clock_us": pa.array([0, 250, 500, 750], pa.time64("us")),
        "force": pa.array([Decimal("1.25"), None, Decimal("-2.50"), Decimal("100.01")], pa.decimal128(9, 2)),
        "day": pa.array([1, 2, 3, 4], pa.date32()), "state": ["a", "b", "c", "d"], "on": [True, False, True, True],
    }  # fmt: skip
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    channels = read_channels(tmp_path / "a.parquet")
    for name in ("since", "clock"):
        np.testing.assert_array_equal(channels.channel(name).samples, [0.0, 0.005, np.nan, 0.015])
    np.testing.assert_array_equal(channels.channel("clock_us").samples, [0.0, 250e-6, 500e-6, 750e-6])
    assert {channels.channel(name).unit for name in ("since", "clock", "clock_us")} == {"s"}
    np.testing.assert_array_equal(channels.channel("force").samples, [1.25, np.nan, -2.5, 100.01])
    assert channels.left_out == ("day (date32[day])", "state (string)", "on (bool)")


def test_numbers_of_mdf_that_stand_for_texts_are_nan_with_the_reason_and_channels_of_texts_are_named(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    raw = np.arange(-32, 32, dtype="i2") * 100
    raw[[5, 9]] = 32767
    scale = {"a": 0.05, "b": 1.0}
    ranges = {"lower_0": 32000, "upper_0": 32767, "text_0": b"SNA"}
    conversions = {
        "as it stands": {"val_0": 32767, "text_0": b"SNA"},
        "by its default": {"val_0": 32767, "text_0": b"SNA", "default_addr": scale},
        "in a range": ranges | {"default_addr": scale},
        "states": {f"val_{i}": value for i, value in enumerate(raw)} | {f"text_{i}": b"on" for i in range(64)},
    }
    with asammdf.MDF(version="4.10") as file:
        signals = [asammdf.Signal(raw, TIMES, name=name, conversion=how) for name, how in conversions.items()]
        remark = asammdf.Signal(np.array([b"ok"] * 64), TIMES, name="remark", encoding="utf-8")
        file.append([*signals, remark])
        file.save(tmp_path / "a.mf4", overwrite=True)
    channels = read_channels(tmp_path / "a.mf4")
    expected = {"as it stands": raw.astype(float), "by its default": 0.05 * raw + 1.0, "in a range": 0.05 * raw + 1.0}
    assert channels.names == ("time", *expected)
    for name, truth in expected.items():
        truth[[5, 9]] = np.nan
        np.testing.assert_allclose(channels.channel(name).samples, truth, rtol=1e-15)
        assert channels.channel(name).gaps == "2 stand for 'SNA'"
    assert set(channels.left_out) == {"states (texts)", "remark (texts)"}
    remarks = [remark for channel in check_file(tmp_path / "a.mf4").channels for remark in channel.remarks]
    assert remarks.count("2 of 64 values are not finite: 2 stand for 'SNA'") == 3


def test_what_tdms_and_universal_files_hold_besides_is_named(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as file:
        file.write_segment([
            nptdms.ChannelObject("g", "force", WAVE), nptdms.ChannelObject("g", "note", ["a", "b"]),
            nptdms.ChannelObject("g", "when", np.array(["2025-03-01T06:00:00"], "datetime64[us]")),
        ])  # fmt: skip
    assert read_channels(tmp_path / "a.tdms").left_out == ("g/note (texts)", "g/when (times)")


# ---- texts --------------------------------------------------------------------------------------------------------


def german(value):
    return f"{value:,.2f}".translate(str.maketrans(",.", ".,"))


def test_signs_between_thousands_are_named_in_the_column_where_they_stand(tmp_path, subtests):
    cases = {
        ";": ([f"{t:.4f}".replace(".", ",") for t in TIMES], [german(value) for value in WAVE], "4"),
        "\t": ([f"{t:.4f}".replace(".", ",") for t in TIMES], [german(value)[:-3] for value in WAVE], "whole"),
        ",": ([f"{t:.4f}" for t in TIMES], [f'"{value:,.2f}"' for value in WAVE], "quotes"),
        "; ": ([f"{t:.4f}" for t in TIMES], [f"{value:,.2f}".replace(",", "'") for value in WAVE], "Swiss"),
    }
    for separator, (times, values, case) in cases.items():
        with subtests.test(case=case):
            rows = [separator.join(cells) for cells in zip(times, values, values, strict=True)]
            names = separator.join(("Zeit [s]", "Moment [N.m]", "Beschl [mm/s²]"))
            (tmp_path / "a.csv").write_text("\n".join([names, *rows]) + "\n", encoding="utf-8")
            said = said_of(tmp_path / "a.csv")
            assert "row 2, column 'Moment [N.m]'" in said
            assert said.endswith("export without thousands separators")


@pytest.mark.parametrize("sign", ["#", "%", "//"])
def test_rows_of_comments_among_numbers_are_left_out_as_the_layout_says(tmp_path, sign):
    rows = [f"{t:.4f},{value}" for t, value in zip(TIMES, WAVE, strict=True)]
    rows[30:30] = [f"{sign} operator: door opened", f"{sign} and closed"]
    (tmp_path / "a.csv").write_text("\n".join(["time_s,force_n", *rows]) + "\n", encoding="utf-8")
    report = check_file(tmp_path / "a.csv")
    assert dict(report.contents)["text"] == f"separator comma, header_row 1, comment {sign}"
    np.testing.assert_array_equal(report.read.channels.channel("force_n").samples, WAVE)


LVM = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
X_Columns\t{x}
***End_of_Header***\t
\t
Channels\t3
Samples\t{samples}\t{samples}\t{slow}
Y_Unit_Label\tN.m\tm/s2\tDeg C
X_Dimension\tTime\tTime\tTime
Delta_X\t0.001\t0.001\t0.01
***End_of_Header***\t
X_Value\tTorque\tAcc\tTemp\tComment
"""


def lvm(path, x="One", samples=64, slow=7, step=1):
    taken = range(0, 64, step)
    rows = [f"{TIMES[i] if x == 'One' else ''}\t{i}\t{WAVE[i]}\t{20 + i if i < slow else ''}" for i in taken]
    path.write_text(LVM.format(x=x, samples=samples, slow=slow) + "\n".join(rows) + "\n", encoding="utf-8")
    return path


def test_a_slow_channel_beside_fast_ones_is_a_record_of_its_own(tmp_path):
    for x in ("One", "No"):
        channels = read_channels(lvm(tmp_path / "a.lvm", x))
        np.testing.assert_array_equal(channels.channel("Acc").samples, WAVE)
        temperature = channels.channel("Temp")
        assert (temperature.samples.size, temperature.time.clock) == (7, None)
        assert temperature.time.rates == pytest.approx([100.0], rel=1e-12)
    cut = tmp_path / "a.lvm"
    cut.write_text(cut.read_text().replace("Samples\t64\t64\t7", "Samples\t64\t64\t64"), encoding="utf-8")
    assert "expected 64 samples as its header says; got 7: the file is cut off" in said_of(cut)


def test_a_header_that_counts_more_than_a_thinned_file_holds_is_said_and_its_rows_are_believed_where_the_map_says(
    tmp_path,
):
    path = lvm(tmp_path / "a.lvm", slow=64, step=2)
    said = said_of(path)
    assert "expected 64 samples as its header says; got 32 every 0.002 s where it says 0.001 s" in said
    assert 'believe = "rows" in [text]' in said
    taken = read_channels(path, TextLayout(believe="rows"))
    np.testing.assert_array_equal(taken.channel("Acc").samples, WAVE[::2])
    np.testing.assert_array_equal(taken.channel("X_Value").samples, TIMES[::2])
    (tmp_path / "cut.lvm").write_text("\n".join(lvm(path).read_text().splitlines()[:40]) + "\n", encoding="utf-8")
    assert said_of(tmp_path / "cut.lvm").endswith("the file is cut off")


# ---- proposals ----------------------------------------------------------------------------------------------------


def channels_of(**samples):
    return Channels("a.mat", tuple(Channel(name, values) for name, values in samples.items()))


def test_a_matrix_of_accelerations_is_no_excitation_and_a_constant_rate_is_no_signal():
    matrix = np.stack([WAVE, 0.5 * WAVE, 2.0 * WAVE], axis=1)
    text = proposed_map(channels_of(acceleration=matrix, Voltage=WAVE + 1.0, Fs=np.full(64, 51200.0))).toml()
    assert text.index('channel = "Voltage"') < text.index("[response]") < text.index('channel = "acceleration"')
    assert "sample_rate_hz = 51200 " in text


def test_a_motion_with_its_velocity_is_proposed_as_a_motion_and_a_motor_speed_is_no_spectrum():
    velocity = {"Velocity [mm/s]": np.sin(TIMES), "Temp": 20.0 + TIMES, "Speed [rad/s]": np.sin(3 * TIMES)}
    force = {"Position [mm]": WAVE, "Force [N]": -WAVE, **velocity}
    assert made_of(channels_of(**force)) is Made.MOTION
    assert made_of(channels_of(**force, **{"Torque [Nm]": -WAVE})) is Made.SESSION  # of a motor: it has modes
    assert made_of(channels_of(**{"Acc [g]": WAVE, "Torque [Nm]": -WAVE, **velocity})) is Made.SESSION
    lines = {"w [rad/s]": 1.0 + TIMES, "Gain [dB]": WAVE, "Phase [deg]": WAVE}
    assert made_of(channels_of(**lines)) is Made.FRF_SET
    text = proposed_map(channels_of(**lines)).toml()
    assert 'unit = "rad/s"' in text
    assert 'unit = "deg"' in text
    assert 'such as "dB re 1 m/(N.s2)"' in text


def test_files_of_one_day_each_get_names_of_their_own(tmp_path):
    steps = set()
    for day in ("01", "02"):
        path = tmp_path / f"run.2025-03-{day}.csv"
        path.write_text("time_s,force_n\n" + "\n".join(f"{t},{v}" for t, v in zip(TIMES, WAVE, strict=True)) + "\n")
        steps.add(check_file(path).next_step.partition("--write-map ")[2].split()[0])
    assert steps == {"run.2025-03-01.toml", "run.2025-03-02.toml"}


# ---- single numbers -----------------------------------------------------------------------------------------------

DRIVEN = """
axis_id = "a"
excitation = {channel = "force_n", quantity = "force", source = "sensor"}
response = {channel = "acc_g"}
window = {position_mm = 0, position_span_mm = 0, started_at = 2025-03-01T06:00:00Z%s}
"""


def remarks_of(path, text):
    (path.parent / "map.toml").write_text(text, encoding="utf-8")
    return import_session([path], read_channel_map(path.parent / "map.toml")).remarks


def test_a_rate_and_a_count_that_a_file_states_stand_beside_what_is_used(tmp_path, subtests):
    layout = "text = {separator = 'comma', header_row = 4}\ntime = {channel = 'time_s'}\n"
    rows = "\n".join(f"{t!r},{v!r},{v!r}" for t, v in zip(TIMES.tolist(), WAVE.tolist(), strict=True))
    cases = {
        ("Sample Rate: 1 kHz", "Record Length,64"): (),
        ("# Fs = 1000", "Points;64"): (),
        ("Sample Interval,0.5 ms", "Samples,128"): ("says 2000 Hz; 1000 Hz is used", "says 128; it holds 64 samples"),
        ("Sampling Frequency [kHz]: 51.2", "made by Meyer"): ("says 51200 Hz; 1000 Hz is used",),
        ("Abtastrate;2000", "dt: 0.0005"): ("says 2000 Hz",),
        ("Range: 10 V", "Channels,2"): (),
    }
    for above, sentences in cases.items():
        with subtests.test(above=above):
            text = "\n".join([*above, "", "time_s,force_n,acc_g", rows]) + "\n"
            (tmp_path / "a.csv").write_text(text, encoding="utf-8")
            said = [
                remark
                for remark in remarks_of(tmp_path / "a.csv", DRIVEN % "" + layout)
                if "in the file says" in remark
            ]
            assert len(said) == len(sentences)
            assert all(sentence in remark for sentence, remark in zip(sentences, said, strict=True))
    np.savez(tmp_path / "a.npz", force_n=WAVE, acc_g=WAVE, Fs=51200.0)
    (remark,) = [each for each in remarks_of(tmp_path / "a.npz", DRIVEN % ", sample_rate_hz = 5120") if "Fs" in each]
    assert "'Fs' in the file says 51200 Hz; 5120 Hz is used" in remark
