"""Whatever is drawn of clocks, pauses and segments, in each format: the times are used, or the file is refused."""

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from monitor_core.errors import RecordingFormatError
from tests.recordings.test_channel_times import (
    EPOCH,
    LVM_HEAD,
    MAP,
    RESAMPLE,
    START,
    STARTED,
    imported,
    instants,
    tdms,
    two_clocks,
    uff_set,
    wave,
    waveform,
)


@dataclass(frozen=True)
class Drawn:
    """What a file states: rate and start of each channel, and what changes behind its first half."""

    rates: tuple[float, float]
    late: float  # of the second channel [s]
    pause: tuple[float, float]  # of each channel in the middle [s]
    rates_behind: tuple[float, float]

    def halves(self, channel):
        """Return start and rate of both halves of a channel."""
        begin = self.late * channel
        behind = begin + HALF / self.rates[channel] + self.pause[channel]
        return (begin, self.rates[channel]), (behind, self.rates_behind[channel])

    def times(self, channel):
        return np.concatenate([instants(begin, HALF, rate) for begin, rate in self.halves(channel)])


HALF = 160
BOTH = (("F", "N", 0), ("A", "m/s2", 1))


def in_segments(folder, drawn):
    """Write TDMS: each half is a segment."""
    segments = []
    for half in (0, 1):
        of_channels = []
        for name, unit, channel in BOTH:
            begin, rate = drawn.halves(channel)[half]
            stated = waveform(0.0, instants(begin, HALF, rate), unit, step=1.0 / rate, offset=begin)
            of_channels.append((name, *stated))
        segments.append(of_channels)
    return tdms(folder / "a.tdms", *segments), MAP.format("g/F", "g/A")


def in_groups(folder, drawn):
    """Write MDF4: each channel has a group with its times."""
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.header.start_time = START
        for name, unit, channel in BOTH:
            times = drawn.times(channel)
            file.append([Signal(wave(times), times, name=name, unit=unit)])
        file.save(folder / "a.mf4", overwrite=True)
    return folder / "a.mf4", MAP.format("F", "A")


def in_columns(write, zone=None):
    """Write formats of columns: each channel has a column of times."""

    def written(folder, drawn):
        columns = {}
        for name, _, channel in BOTH:
            columns[f"t{name}"], columns[name] = drawn.times(channel), wave(drawn.times(channel))
        path = write(folder, columns)
        return path, two_clocks(MAP.format("F", "A") + ("" if zone else STARTED), "tF", "tA")

    return written


def to_csv(folder, columns):
    rows = "".join(",".join(f"{cell:.9f}" for cell in row) + "\n" for row in zip(*columns.values(), strict=True))
    (folder / "a.csv").write_text(",".join(columns) + "\n" + rows)
    return folder / "a.csv"


def to_npz(folder, columns):
    np.savez(folder / "a.npz", **columns)
    return folder / "a.npz"


def to_mat(folder, columns):
    from scipy.io import savemat

    savemat(folder / "a.mat", columns)
    return folder / "a.mat"


def to_parquet(zone):
    def write(folder, columns):
        import pyarrow as pa
        import pyarrow.parquet as pq

        made = {}
        for name, cells in columns.items():
            at = EPOCH + np.round(1e9 * cells).astype("timedelta64[ns]")
            made[name] = pa.array(at, pa.timestamp("ns", tz=zone)) if name.startswith("t") else pa.array(cells)
        pq.write_table(pa.table(made), folder / "a.parquet")
        return folder / "a.parquet"

    return write


def to_xlsx(folder, columns):
    import openpyxl

    book = openpyxl.Workbook()
    book.active.append(list(columns))
    for number, row in enumerate(zip(*columns.values(), strict=True), start=2):
        days = [45717.25 + cell / 86400.0 if i % 2 == 0 else float(cell) for i, cell in enumerate(row)]
        book.active.append(days)
        for column in (1, 3):
            book.active.cell(number, column).number_format = "yyyy-mm-dd hh:mm:ss.000"
    book.save(folder / "a.xlsx")
    return folder / "a.xlsx"


def by_twincat(folder, drawn):
    ticks = int((START - datetime(1601, 1, 1, tzinfo=UTC)).total_seconds()) * 10_000_000
    text = f"Name\tTest\nFile\tC:\\a.csv\nStarttime of export\t{ticks}\t06:00:00\n\n"
    text += "Name\tF\tName\tA\nSymbolName\tM.F\tSymbolName\tM.A\nUnit\tN\tUnit\tm/s2\n\n"
    times = drawn.times(0), drawn.times(1)
    for t, force, u, acc in zip(times[0], wave(times[0]), times[1], wave(times[1]), strict=True):
        text += f"{1e3 * t:.6f}\t{force:.9f}\t{1e3 * u:.6f}\t{acc:.9f}\n"
    (folder / "a.csv").write_text(text + "EOF\n")
    return folder / "a.csv", MAP.format("F", "A")


def even_only(write):
    """Write formats that state one start and one step for a channel: nothing changes behind the first half."""

    def written(folder, drawn):
        return write(folder, [(name, unit, drawn.late * channel, drawn.rates[channel]) for name, unit, channel in BOTH])

    return written


def as_uff(folder, channels):
    import pyuff

    (folder / "a.uff").unlink(missing_ok=True)
    file = pyuff.UFF(str(folder / "a.uff"))
    for name, unit, begin, rate in channels:
        file.write_sets(uff_set(name, unit, instants(begin, 2 * HALF, rate), begin, 1.0 / rate), "add")
    return folder / "a.uff", MAP.format("F", "A") + STARTED


def as_lvm(folder, channels):
    keys = {"Samples": [str(2 * HALF)] * 2, "Date": ["2025/03/01"] * 2, "Time": ["06:00:00"] * 2}
    keys |= {"Y_Unit_Label": ["N", "m/s2"], "X_Dimension": ["Time"] * 2}
    keys |= {"X0": [f"{begin:.16E}" for *_, begin, _ in channels]}
    keys |= {"Delta_X": [f"{1.0 / rate:.6E}" for *_, rate in channels]}
    text = LVM_HEAD.format(x="No") + "Channels\t2\t\t\n"
    text += "".join(f"{key}\t{cells[0]}\t{cells[1]}\t\n" for key, cells in keys.items())
    text += "***End_of_Header***\t\t\nX_Value\tF\tA\tComment\n"
    values = [wave(instants(begin, 2 * HALF, rate)) for *_, begin, rate in channels]
    text += "".join(f"\t{force:.9f}\t{acc:.9f}\n" for force, acc in zip(*values, strict=True))
    (folder / "a.lvm").write_text(text)
    return folder / "a.lvm", MAP.format("F", "A") + STARTED


def as_hdf5(folder, channels):
    import h5py

    with h5py.File(folder / "a.h5", "w") as file:
        for name, unit, begin, rate in channels:
            file[name] = wave(instants(begin, 2 * HALF, rate))
            file[name].attrs.update({"units": unit, "sampling_rate": rate, "start_time": begin})
    return folder / "a.h5", MAP.format("F", "A") + STARTED


FORMATS = {
    "TDMS": in_segments,
    "MDF4": in_groups,
    "Parquet": in_columns(to_parquet(None)),
    "Parquet with a zone": in_columns(to_parquet("UTC"), "UTC"),
    "XLSX": in_columns(to_xlsx),
    "CSV": in_columns(to_csv),
    "NPZ": in_columns(to_npz),
    "MAT": in_columns(to_mat),
    "TwinCAT": by_twincat,
    "UFF58": even_only(as_uff),
    "LVM": even_only(as_lvm),
    "HDF5": even_only(as_hdf5),
}
RATES = st.sampled_from((500.0, 1000.0, 1024.0, 2048.0, 1.0 / 3e-4))
PAUSES = st.sampled_from((0.0, 0.002, 0.02, 9.25, 200_000.0))


@st.composite
def drawn_times(draw):
    """Draw what two channels share, and then change one or the other."""
    rate, pause = draw(RATES), draw(PAUSES)
    behind = draw(st.sampled_from((rate, rate, rate, 2.0 * rate)))
    is_other = draw(st.sampled_from(("nothing", "rate", "pause", "rate behind")))
    return Drawn(
        (rate, draw(RATES) if is_other == "rate" else rate),
        draw(st.sampled_from((0.0, 1e-4, 0.004, 0.01, 0.3))),
        (pause, draw(PAUSES) if is_other == "pause" else pause),
        (behind, draw(RATES) if is_other == "rate behind" else behind),
    )


def used_or_refused(folder, name, drawn):
    """Import a file with and without resampling: each window is the signal at the instants that it says, or none is.

    Return how many were made.
    """
    n_windows = 0
    path, text = FORMATS[name](folder, drawn)
    for how in ("", RESAMPLE):
        try:
            made = imported(path, text + how)
        except RecordingFormatError:
            continue
        for window in made.session.windows:
            begin = (window.started_at - START).total_seconds()
            truth = wave(begin + np.arange(window.n_samples) / window.sample_rate)
            bound = 0.05 if how else 1e-3
            # channels of one rate may begin half a step apart
            apart = min(drawn.late, 0.6 / window.sample_rate)
            inner = slice(20, -20) if how else slice(None)
            assert np.max(np.abs(window.excitation - truth)[inner], initial=0.0) < bound
            assert np.max(np.abs(window.response - truth)[inner], initial=0.0) < bound + SLOPE * apart
        n_windows += len(made.session.windows)
    return n_windows


SLOPE = 2.0 * np.pi * 87.3 + 0.3 * 2.0 * np.pi * 31.0


def of_any_draw(folder, name, n_draws):
    made = list[int]()

    @settings(max_examples=n_draws, deadline=None, suppress_health_check=list(HealthCheck))
    @given(drawn_times())
    def check(drawn):
        made.append(used_or_refused(folder, name, drawn))

    check()
    assert max(made) > 0  # not all are refused


def test_whatever_is_changed_is_used_or_refused(tmp_path, subtests):
    for name in FORMATS:
        with subtests.test(format=name):
            of_any_draw(tmp_path, name, 5)


@pytest.mark.release
@pytest.mark.parametrize("name", FORMATS)
def test_whatever_is_changed_in_500_files_is_used_or_refused(tmp_path, name):
    of_any_draw(tmp_path, name, 500)
