"""When does each channel begin, at which step, in which unit of x, and what changes in mid-file: every reader.

One mode is sampled twice: the acceleration begins 10 ms behind the force, as the file says in the way of its format.
Put together rightly, the acceleration is the force's at the same instant; taken as if both began together it is not.
Files are written by the library of the format, else by hand.
"""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.check import check_file
from monitor_core.recordings.raw.binary import uff58
from monitor_core.recordings.raw.mapping.channel_map import read_channel_map
from monitor_core.recordings.raw.mapping.imported import ImportedSession, import_session

RATE, LATE, N = 1024.0, 0.010, 1536
START = datetime(2025, 3, 1, 6, 0, tzinfo=UTC)
EPOCH = np.datetime64("2025-03-01T06:00:00", "ns")
MAP = """axis_id = "a"
excitation = {{channel = "{0}", quantity = "force", source = "sensor", unit = "N"}}
response = {{channel = "{1}", unit = "m/s2"}}
[window]
position_mm = 100
position_span_mm = 0
"""
RESAMPLE = '[resample]\nsample_rate_hz = 2048\nmethod = "cubic"\n'
STARTED = f"started_at = {START.isoformat()}\n"


def wave(times):
    """Return the signal of both channels: two tones, which no shift and no pause hides."""
    return np.sin(2.0 * np.pi * 87.3 * times) + 0.3 * np.cos(2.0 * np.pi * 31.0 * times)


def instants(start=0.0, n=N, rate=RATE):
    return start + np.arange(n) / rate


def tdms(path, *segments):
    """Write segments: for each channel start, offset, step and samples, and properties of its own."""
    from nptdms import ChannelObject, RootObject, TdmsWriter

    with TdmsWriter(path) as writer:
        for of_channels in segments:
            writer.write_segment(
                [RootObject({})]
                + [ChannelObject("g", name, samples, properties=stated) for name, samples, stated in of_channels]
            )
    return path


def waveform(start, times, unit, step=1.0 / RATE, offset=0.0, **more):
    at = np.datetime64(START.replace(tzinfo=None), "us") + np.timedelta64(round(start * 1e6), "us")
    stated = {"wf_increment": step, "wf_start_time": at, "wf_start_offset": offset, "unit_string": unit}
    return wave(times), stated | more


def by_offset(folder):
    force, of_force = waveform(0.0, instants(), "N")
    acc, of_acc = waveform(0.0, instants(LATE), "m/s2", offset=LATE)
    return tdms(folder / "a.tdms", [("F", force, of_force), ("A", acc, of_acc)]), MAP.format("g/F", "g/A")


def by_start_time(folder):
    force, of_force = waveform(0.0, instants(), "N")
    acc, of_acc = waveform(LATE, instants(LATE), "m/s2")
    return tdms(folder / "a.tdms", [("F", force, of_force), ("A", acc, of_acc)]), MAP.format("g/F", "g/A")


def in_milliseconds(folder):
    force, of_force = waveform(0.0, instants(), "N", step=1e3 / RATE, wf_xunit_string="ms")
    acc, of_acc = waveform(0.0, instants(LATE), "m/s2", step=1e3 / RATE, offset=1e3 * LATE, wf_xunit_string="ms")
    return tdms(folder / "a.tdms", [("F", force, of_force), ("A", acc, of_acc)]), MAP.format("g/F", "g/A")


def mdf4_groups(folder, start=0.0):
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.header.start_time = START
        for name, unit, late in (("F", "N", start), ("A", "m/s2", start + LATE)):
            file.append([Signal(wave(instants(late)), instants(late), name=name, unit=unit)])
        file.save(folder / "a.mf4", overwrite=True)
    return folder / "a.mf4", MAP.format("F", "A")


def mdf4_late(folder):
    return mdf4_groups(folder, start=1.5)


def parquet(folder, zone):
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {}
    for name, late in (("F", 0.0), ("A", LATE)):
        times = EPOCH + np.round(1e9 * instants(late)).astype("timedelta64[ns]")
        columns[f"t{name}"] = pa.array(times, pa.timestamp("ns", tz=zone))
        columns[name] = pa.array(wave(instants(late)))
    pq.write_table(pa.table(columns), folder / "a.parquet")
    started = "" if zone else STARTED
    return folder / "a.parquet", two_clocks(MAP.format("F", "A") + started, "tF", "tA")


def two_clocks(text, force, acc, unit='unit = "s"\n'):
    text = text.replace('"force", source', f'"force", time = "{force}", source')
    return text.replace('unit = "m/s2"', f'unit = "m/s2", time = "{acc}"') + f"[time]\n{unit}"


def parquet_with_zone(folder):
    return parquet(folder, "UTC")


def parquet_without_zone(folder):
    return parquet(folder, None)


def xlsx_dates(folder):
    import openpyxl

    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(["tF", "F", "tA", "A"])
    day = 45717.25
    for i in range(N):
        times = instants()[i], instants(LATE)[i]
        sheet.append([day + times[0] / 86400.0, wave(times[0]), day + times[1] / 86400.0, wave(times[1])])
        for column in (1, 3):
            sheet.cell(i + 2, column).number_format = "yyyy-mm-dd hh:mm:ss.000"
    book.save(folder / "a.xlsx")
    return folder / "a.xlsx", two_clocks(MAP.format("F", "A") + STARTED, "tF", "tA")


def uff_set(name, unit, times, begin, step):
    import pyuff

    made = pyuff.prepare_58(
        binary=0, func_type=1, rsp_node=1, rsp_dir=1, ref_dir=1, ref_node=1, data=wave(times), x=times, id1=name,
        ordinate_axis_units_lab=unit, abscissa_axis_units_lab="s", ord_data_type=4, abscissa_spacing=1,
        abscissa_min=begin, abscissa_inc=step, num_pts=times.size, return_full_dict=True,
    )  # fmt: skip
    empty = dict.fromkeys((key for key, value in made.items() if value is None), 0)
    return made | empty | {key: "NONE" for key in empty if key.endswith(("_name", "_lab")) or key.startswith("id")}


def uff(folder):
    import pyuff

    file = pyuff.UFF(str(folder / "a.uff"))
    for name, unit, late in (("F", "N", 0.0), ("A", "m/s2", LATE)):
        file.write_sets(uff_set(name, unit, instants(late), late, 1.0 / RATE), "add")
    return folder / "a.uff", MAP.format("F", "A") + STARTED


LVM_HEAD = (
    "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\n"
    "Multi_Headings\tYes\nX_Columns\t{x}\nTime_Pref\tAbsolute\n***End_of_Header***\t\n\t\n"
)


def lvm(folder, x, *, by_time):
    """Write an LVM file whose second channel starts late by ``Time`` or by ``X0``."""
    tab = "\t\t" if x == "Multi" else "\t"
    time = ["06:00:00.000000", "06:00:00.010000" if by_time else "06:00:00.000000"]
    x0 = ["0.0000000000000000E+0", "0.0000000000000000E+0" if by_time else "1.0000000000000000E-2"]
    step = [f"{1.0 / RATE:.9E}"] * 2
    rows = {"Channels": ["2"], "Samples": [str(N)] * 2, "Date": ["2025/03/01"] * 2, "Time": time,
            "Y_Unit_Label": ["N", "m/s2"], "X_Dimension": ["Time"] * 2, "X0": x0, "Delta_X": step}  # fmt: skip
    text = LVM_HEAD.format(x=x) + "".join(f"{key}\t{tab.join(cells)}\t\n" for key, cells in rows.items())
    text += (
        "***End_of_Header***\t\t\n"
        + {"No": "X_Value\tF\tA", "One": "X_Value\tF\tA", "Multi": "X_Value\tF\tX_Value\tA"}[x]
    )
    text += "\tComment\n"
    for i in range(N):
        t, a = instants()[i], instants(0.0 if by_time else LATE)[i]
        force, acc = wave(instants()[i]), wave(instants(LATE)[i])
        cells = {"No": ["", force, acc], "One": [t, force, acc], "Multi": [t, force, a, acc]}[x]
        text += "\t".join(cell if isinstance(cell, str) else f"{cell:.9f}" for cell in cells) + "\n"
    (folder / "a.lvm").write_text(text)
    return folder / "a.lvm", MAP.format("F", "A") + STARTED


def csv_numbers(folder):
    rows = zip(instants(), wave(instants()), instants(LATE), wave(instants(LATE)), strict=True)
    text = "tF,F,tA,A\n" + "".join(",".join(f"{cell:.9f}" for cell in row) + "\n" for row in rows)
    (folder / "a.csv").write_text(text)
    return folder / "a.csv", two_clocks(MAP.format("F", "A") + STARTED, "tF", "tA")


def drive_trace(folder):
    """Write a trace of a drive: columns in pairs of time and value."""
    rows = zip(instants(), wave(instants()), instants(LATE), wave(instants(LATE)), strict=True)
    text = "Time [ms],F,Time [ms],A\n" + "".join(
        f"{1e3 * t:.6f},{force:.9f},{1e3 * u:.6f},{acc:.9f}\n" for t, force, u, acc in rows
    )
    (folder / "a.csv").write_text(text)
    return folder / "a.csv", MAP.format("F", "A") + STARTED


def twincat(folder):
    ticks = int((START - datetime(1601, 1, 1, tzinfo=UTC)).total_seconds()) * 10_000_000
    about = f"Name\tTest\nFile\tC:\\a.csv\nStarttime of export\t{ticks}\t06:00:00\n\n"
    names = "Name\tF\tName\tA\nSymbolName\tM.F\tSymbolName\tM.A\nUnit\tN\tUnit\tm/s2\n\n"
    rows = "".join(
        f"{1e3 * t:.6f}\t{force:.9f}\t{1e3 * u:.6f}\t{acc:.9f}\n"
        for t, force, u, acc in zip(instants(), wave(instants()), instants(LATE), wave(instants(LATE)), strict=True)
    )
    (folder / "a.csv").write_text(about + names + rows + "EOF\n")
    return folder / "a.csv", MAP.format("F", "A")


def npz(folder):
    np.savez(folder / "a.npz", tF=instants(), F=wave(instants()), tA=instants(LATE), A=wave(instants(LATE)))
    return folder / "a.npz", two_clocks(MAP.format("F", "A") + STARTED, "tF", "tA")


def mat(folder):
    from scipy.io import savemat

    savemat(
        folder / "a.mat", {"tF": instants(), "F": wave(instants()), "tA": instants(LATE), "A": wave(instants(LATE))}
    )
    return folder / "a.mat", two_clocks(MAP.format("F", "A") + STARTED, "tF", "tA")


def serial_days(folder):
    times = 45717.25 + instants() / 86400.0, 45717.25 + instants(LATE) / 86400.0
    rows = zip(times[0], wave(instants()), times[1], wave(instants(LATE)), strict=True)
    text = "tF,F,tA,A\n" + "".join(f"{t:.13f},{force:.9f},{u:.13f},{acc:.9f}\n" for t, force, u, acc in rows)
    (folder / "a.csv").write_text(text)
    return folder / "a.csv", two_clocks(MAP.format("F", "A") + STARTED, "tF", "tA", 'unit = "d"\n')


def hdf5(folder, start, late):
    """Write HDF5 as other programs do: rate and start are attributes of the data sets."""
    import h5py

    with h5py.File(folder / "a.h5", "w") as file:
        for name, unit, begins, times in (("F", "N", start, instants()), ("A", "m/s2", late, instants(LATE))):
            file[name] = wave(times)
            file[name].attrs.update({"units": unit, "sampling_rate": RATE, "start_time": begins})
    return folder / "a.h5", MAP.format("F", "A")


def hdf5_seconds(folder):
    path, text = hdf5(folder, 0.0, LATE)
    return path, text + STARTED


def hdf5_with_zone(folder):
    return hdf5(folder, "2025-03-01T06:00:00Z", "2025-03-01T06:00:00.010Z")


def hdf5_without_zone(folder):
    path, text = hdf5(folder, "2025-03-01T06:00:00", "2025-03-01T06:00:00.010")
    return path, text + STARTED


Way = Callable[[Path], tuple[Path, str]]
BEGINS: dict[str, Way] = {
    "TDMS, wf_start_offset": by_offset,
    "TDMS, wf_start_time": by_start_time,
    "TDMS, x in ms": in_milliseconds,
    "MDF4, two groups": mdf4_groups,
    "MDF4, two groups that begin late": mdf4_late,
    "Parquet, instants with a zone": parquet_with_zone,
    "Parquet, instants without": parquet_without_zone,
    "XLSX, columns of dates": xlsx_dates,
    "UFF58, abscissa_min": uff,
    **{
        f"LVM, {'Time' if by_time else 'X0'}, X_Columns {x}": (
            lambda folder, x=x, by_time=by_time: lvm(folder, x, by_time=by_time)
        )
        for x in ("No", "One", "Multi")
        for by_time in (True, False)
    },
    "CSV, columns of seconds": csv_numbers,
    "CSV, columns of days": serial_days,
    "HDF5, a start in seconds": hdf5_seconds,
    "HDF5, a start with a zone": hdf5_with_zone,
    "HDF5, a start without": hdf5_without_zone,
    "trace of a drive": drive_trace,
    "TwinCAT": twincat,
    "NPZ": npz,
    "MAT": mat,
}


def imported(path: Path, text: str) -> ImportedSession:
    (path.parent / "map.toml").write_text(text)
    return import_session([path], read_channel_map(path.parent / "map.toml"))


@pytest.mark.parametrize("way", BEGINS)
def test_a_channel_begins_when_its_file_says(tmp_path, way):
    path, text = BEGINS[way](tmp_path)
    with pytest.raises(RecordingFormatError, match=r"start 0\.0(1|0999)\d* s apart"):
        imported(path, text)
    made = imported(path, text + RESAMPLE)
    (window,) = made.session.windows
    late = 1.5 if way == "MDF4, two groups that begin late" else 0.0
    assert abs(window.started_at - START - timedelta(seconds=late + LATE)) < timedelta(microseconds=2)
    inner = slice(40, -40)
    misses = window.response[inner] - window.excitation[inner]
    assert np.std(misses) < 0.01 * np.std(window.excitation)  # begun together, they would differ by 1.8 times it
    truth = wave(late + LATE + np.arange(window.n_samples) / 2048.0)
    assert np.std(window.excitation[inner] - truth[inner]) < 0.01 * np.std(truth)


# ---- what changes in mid-file ----------------------------------------------------------------------------------------


def two_segments(folder, *, later=10.0, step=1.0 / RATE, acc_step=None, unit="N"):
    """Write two segments, the second of which begins later, or at another step."""
    n = N // 2
    first = [("F", *waveform(0.0, instants(n=n), "N")), ("A", *waveform(0.0, instants(n=n), "m/s2"))]
    times = {of: later + np.arange(n) * (acc_step or step if of == "A" else step) for of in "FA"}
    second = [
        ("F", *waveform(later, times["F"], unit, step=step)),
        ("A", *waveform(later, times["A"], "m/s2", step=acc_step or step)),
    ]
    return tdms(folder / "a.tdms", first, second), MAP.format("g/F", "g/A")


def appended_tdms(folder):
    return two_segments(folder, later=10.0)


def days_later(folder):
    return two_segments(folder, later=3.0 * 86400.0)


def goes_on(folder):
    return two_segments(folder, later=N / 2 / RATE)


def other_step(folder):
    return two_segments(folder, later=N / 2 / RATE, step=0.5 / RATE)


def step_of_one(folder):
    return two_segments(folder, later=N / 2 / RATE, acc_step=0.5 / RATE)


def overlap(folder):
    return two_segments(folder, later=0.5)


def other_unit(folder):
    return two_segments(folder, unit="kN")


def over_frequency(folder):
    force, of_force = waveform(0.0, instants(), "N")
    acc, of_acc = waveform(0.0, instants(), "m/s2", wf_xunit_string="Hz")
    return tdms(folder / "a.tdms", [("F", force, of_force), ("A", acc, of_acc)]), MAP.format("g/F", "g/A")


def with_pause(begin=0.0):
    return begin + np.r_[instants(n=N // 2), 10.0 + instants(n=N // 2)]


def mdf4_pause(folder):
    from asammdf import MDF, Signal

    times = with_pause()
    with MDF(version="4.10") as file:
        file.header.start_time = START
        file.append([Signal(wave(times), times, name=name, unit=unit) for name, unit in (("F", "N"), ("A", "m/s2"))])
        file.save(folder / "a.mf4", overwrite=True)
    return folder / "a.mf4", MAP.format("F", "A")


def parquet_pause(folder):
    import pyarrow as pa
    import pyarrow.parquet as pq

    times = EPOCH + np.round(1e9 * with_pause()).astype("timedelta64[ns]")
    columns = {"t": pa.array(times, pa.timestamp("ns", tz="UTC")), "F": wave(with_pause()), "A": wave(with_pause())}
    pq.write_table(pa.table(columns), folder / "a.parquet")
    return folder / "a.parquet", MAP.format("F", "A") + '[time]\nchannel = "t"\nunit = "s"\n'


def rows_of(times, digits=9):
    columns = (times, wave(times), wave(times))
    return [",".join(f"{cell:.{digits}f}" for cell in row) for row in zip(*columns, strict=True)]


def csv(folder, rows, *, timed=True, unit="s"):
    (folder / "a.csv").write_text("t,F,A\n" + "\n".join(rows) + "\n")
    text = MAP.format("F", "A") + STARTED
    return folder / "a.csv", text + (
        f'[time]\nchannel = "t"\nunit = "{unit}"\n' if timed else f"sample_rate_hz = {RATE}\n"
    )


def csv_pause(folder):
    return csv(folder, rows_of(with_pause()))


def csv_marker(folder):
    rows = rows_of(instants())
    return csv(folder, [*rows[: N // 2], "overrun", *rows[N // 2 :]], timed=False)


def csv_marker_and_counter(folder):
    rows = [f"{i},{row.partition(',')[2]}" for i, row in enumerate(rows_of(with_pause()))]
    late = [f"{i + 9472},{row.partition(',')[2]}" for i, row in enumerate(rows[N // 2 :], start=N // 2)]
    return csv(folder, [*rows[: N // 2], "overrun", *late], timed=False)


def csv_begun_anew(folder):
    rows = rows_of(instants(n=N // 2))
    return csv(folder, [*rows, "t,F,A", *rows])


def csv_marker_without_loss(folder):
    rows = rows_of(instants())
    return csv(folder, [*rows[: N // 2], "trigger", *rows[N // 2 :]])


def csv_other_step(folder):
    times = np.r_[instants(n=N // 2), N / 2 / RATE + instants(n=N // 2) / 2.0]
    return csv(folder, rows_of(times))


def csv_wrapped(folder):
    counts = (np.round(1e6 * instants()) + 2.0**32 - 5e5) % 2.0**32
    rows = [f"{count:.0f},{row.partition(',')[2]}" for count, row in zip(counts, rows_of(instants()), strict=True)]
    return csv(folder, rows, unit="us")


def csv_clock_change(folder):
    at = datetime(2025, 10, 26, 2, 59, 59, 500_000)  # noqa: DTZ001  # as loggers write it
    times = [at + timedelta(seconds=s, hours=-1 if s >= 0.5 else 0) for s in instants()]
    rows = [f"{t.isoformat()},{row.partition(',')[2]}" for t, row in zip(times, rows_of(instants()), strict=True)]
    path, text = csv(folder, rows)
    text = text.replace(STARTED, "").replace('unit = "s"', 'format = "iso"\nzone = "+01:00"')
    return path, text + "[text]\nheader_row = 1\n"


def lvm_other_step(folder):
    path, text = lvm(folder, "One", by_time=True)
    path.write_text(path.read_text().replace(f"{1.0 / RATE:.9E}", f"{2.0 / RATE:.9E}").replace("010000", "000000"))
    return path, text


def lvm_segments(folder):
    path, text = lvm(folder, "No", by_time=False)
    content = path.read_text().replace("1.0000000000000000E-2", "0.0000000000000000E+0")
    head, _, segment = content.partition("\t\n\t\n")
    later = segment.replace("06:00:00", "06:00:10")
    path.write_text(f"{head}\t\n\t\n{segment}\n{later}")
    return path, text + 'windows_in = "rows"\n'


def lvm_segments_as_the_map_does_not_say(folder):
    path, text = lvm_segments(folder)
    return path, text + "window_interval_s = 60\n"


#: What changes, and where windows then begin [s] with a word of the remark; or what the refusal says.
CHANGES: dict[str, tuple[Way, list[float] | None, str]] = {
    "TDMS, ten seconds later": (appended_tdms, [0.0, 10.0], "behind sample 767: for 9.25 s"),
    "TDMS, days later": (days_later, [0.0, 259200.0], "behind sample 767"),
    "TDMS, goes on": (goes_on, [0.0], ""),
    "TDMS, another step": (other_step, [0.0, 0.75], "sampled at 2048 Hz behind sample 767"),
    "TDMS, another step of one channel": (step_of_one, None, "expected channels with the same breaks"),
    "TDMS, segments that overlap": (overlap, None, "from sample 768 on: expected a segment that begins after"),
    "TDMS, another unit": (other_unit, None, "its unit_string is 'kN' there, and was 'N'"),
    "TDMS, over frequency": (over_frequency, None, "expected a channel 'g/A'"),
    "MDF4, a pause": (mdf4_pause, [0.0, 10.0], "for 9.25 s"),
    "Parquet, a pause": (parquet_pause, [0.0, 10.0], "for 9.25 s"),
    "CSV, a pause": (csv_pause, [0.0, 10.0], "for 9.25 s"),
    "CSV, a row of words": (csv_marker, [0.0, 0.75], "row 770 'overrun'"),
    "CSV, a row of words, and a counter": (csv_marker_and_counter, [0.0, 10.0], "row 770 'overrun' stands: for 9.25 s"),
    "CSV, a header again and times from 0 on": (csv_begun_anew, [0.0, 0.75], "how many, the file does not say"),
    "CSV, a row of words, no sample lost": (csv_marker_without_loss, [0.0], ""),
    "CSV, another step": (csv_other_step, None, "expected uniform sampling"),
    "CSV, a counter of 32 bits": (csv_wrapped, None, "behind sample 511: a counter that wrapped"),
    "CSV, the end of summer time": (csv_clock_change, None, "clocks were put back at 03:00"),
    "LVM, x against Delta_X": (lvm_other_step, None, "expected x in steps of 0.00195312 s as Delta_X says"),
    "LVM, segments": (lvm_segments, [0.0, 10.0], ""),
    "LVM, segments, against the map": (lvm_segments_as_the_map_does_not_say, None, "60.0 s apart as window_interval_s"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_in_mid_file_is_used_or_refused(tmp_path, change):
    way, begins, words = CHANGES[change]
    path, text = way(tmp_path)
    if begins is None:
        with pytest.raises(RecordingFormatError) as caught:
            imported(path, text)
        assert words in str(caught.value)
        return
    made = imported(path, text)
    found = [(window.started_at - START).total_seconds() for window in made.session.windows]
    assert found == pytest.approx(begins, abs=2e-6)
    assert any(words in remark for remark in made.remarks) if words else made.remarks == ()
    for window, begin in zip(made.session.windows, begins, strict=True):
        # two files hold the same samples twice; the second channel of the LVM file is later than its X0 there says
        first = 0.0 if change.startswith(("CSV, a header again", "LVM, segments")) else begin
        late = LATE if change.startswith("LVM, segments") else 0.0
        times = first + np.arange(window.n_samples) / window.sample_rate
        assert np.std(window.excitation - wave(times)) < 1e-6
        assert np.std(window.response - wave(times + late)) < 1e-6
    lengths = {(window.measurement, window.sample_rate, window.n_samples) for window in made.session.windows}
    assert len(lengths) == len({window.measurement for window in made.session.windows})  # what is averaged is alike


def test_a_look_says_of_clocks_what_the_import_says(tmp_path):
    unsaid = []
    # of a counter, the rate stands in the map alone
    words_of = {change: CHANGES[change][2] for change in CHANGES if change.startswith(("CSV", "Parquet", "MDF4"))}
    words_of |= {"CSV, a row of words, and a counter": "row 770 'overrun' stands: 9472 of them"}
    for change, words in words_of.items():
        if words:
            report = check_file(CHANGES[change][0](tmp_path)[0])
            said = "; ".join([*report.doubts, *(remark for channel in report.channels for remark in channel.remarks)])
            unsaid += [] if words in said else [(change, words, said)]
    assert unsaid == []


@pytest.mark.parametrize(("step", "rate"), [(1.95313e-05, 51_200.0), (9.76563e-04, 1024.0), (3e-4, 3333.33)])
def test_a_step_of_six_digits_is_the_plainest_rate_that_they_allow(tmp_path, step, rate):
    path, _ = uff(tmp_path)
    path.write_text(path.read_text().replace(" 9.76562e-04", f"{step:12.5e}"))
    found = uff58.read_channels(path).channel("F").time
    assert found.rates == (rate,)
    assert (found.open_by > 0.0) == (abs(rate * step - 1.0) > 1e-9)
