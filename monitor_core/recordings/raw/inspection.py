"""Look at the channels of a raw file: what the file states of each, and what its values show."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import pairwise
from pathlib import Path

import numpy as np

from monitor_core.arrays import FloatArray, SampleArray
from monitor_core.errors import RecordingFormatError
from monitor_core.quality import is_clipped, is_stuck, longest_run
from monitor_core.recordings.elements.units import FACTOR_TO_SI, Quantity, canonical_unit, is_raw
from monitor_core.recordings.raw.binary import xlsx
from monitor_core.recordings.raw.channel_kind import (
    DRIVES,
    STANDING,
    kind_in_unit,
    kind_of,
    kind_of_name,
    kind_of_unit,
    unit_in_name,
)
from monitor_core.recordings.raw.channel_time import (
    ChannelTime,
    Run,
    RunningClock,
    missing_samples,
    numbers_samples,
    place_of_break,
    printed_digit,
    time_of_samples,
)
from monitor_core.recordings.raw.channels import HEAD, Channel, Channels, FrequencyResponse
from monitor_core.recordings.raw.formats import READERS, READERS_WITH_LAYOUT, read_channels
from monitor_core.recordings.raw.sample_figures import SampleFigures
from monitor_core.recordings.raw.text import columns
from monitor_core.recordings.raw.text.layout import TextLayout
from monitor_core.recordings.recognition import raw_ending

#: How many values of a channel are shown, and how many breaks.
N_FIRST = 5
#: A channel that holds one value off its rest level for such a share of the record is stuck (as in the quality gate).
STUCK_SHARE = 0.1
SHORTEST_RUN = 4
#: Runs of one length so often are a slower record whose values were repeated.
_HELD_SHARE = 0.9
#: No drive is sampled more slowly to show a mode, none faster: times outside are doubted.
_SECONDS_PER_DAY = 86400.0
#: Days since 1900 from 2009 to 2064, and since the year 0 from 1971 to 2080.
_DAYS = ((40_000.0, 60_000.0, "Excel"), (720_000.0, 760_000.0, "MATLAB"))
_PLAUSIBLE_RATE = (20.0, 5e6)  # [Hz]
_LONGEST_AXIS = 20.0  # [m]
_GRAVITY = 9.80665  # 3rd CGPM, 1901 [m/s²]


@dataclass(frozen=True, slots=True)
class ChannelSummary:
    """A channel as the file states it, figures of its values, and what is remarkable of them."""

    name: str
    shape: tuple[int, ...]
    unit: str | None = None  # as spelled in the file
    sample_rate: float | None = None  # [Hz]; None where the file does not say it
    started_at: datetime | None = None
    clock: str | None = None  # channel of its sampling times
    kind: Quantity | None = None  # what it looks like: to be confirmed
    first_values: tuple[float, ...] = ()
    minimum: float | None = None  # of the finite values; None if none is
    maximum: float | None = None
    n_not_finite: int = 0
    is_constant: bool = False
    is_stuck: bool = False  # off its rest level for a tenth of the record
    is_clipped: bool = False
    remarks: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()  # that the numbers are of the quantity that name or unit says


@dataclass(frozen=True, slots=True, eq=False)
class AsProposed:
    """What a raw file holds, and how it seems to be written where that is not plain."""

    channels: Channels
    layout: TextLayout | None
    figures: Sequence[SampleFigures] | None = None  # of the channels, where they were gathered while it was read


class _Watch:
    """Gathers the figures of a table while it is read."""

    def __init__(self) -> None:
        self.figures: list[SampleFigures] = []

    def begin(self, n_columns: int) -> None:
        self.figures = [SampleFigures(n_columns) for _ in range(n_columns)]

    def add(self, number: int, piece: FloatArray) -> None:
        self.figures[number].add(piece)


def read_as_proposed(path: Path, name: str) -> AsProposed:
    """Read a raw file of a format, a text or a workbook in the layout that is proposed for it.

    ``RecordingFormatError`` if the file cannot be read; ``MissingReaderError`` if that needs a library that is not
    installed.
    """
    if name == "csv" and raw_ending(path, READERS) in READERS_WITH_LAYOUT:
        watch = _Watch()
        channels, layout = columns.read_as_proposed(path, watch)
        # figures of a reading that failed are of fewer samples
        sizes = [math.prod(channel.shape) for channel in channels.channels]
        return AsProposed(channels, layout, watch.figures if [of.size for of in watch.figures] == sizes else None)
    try:
        return AsProposed(read_channels(path), None)
    except RecordingFormatError:
        layout = xlsx.propose_layout(path) if name == "xlsx" else None
        if layout is None:
            raise
        return AsProposed(read_channels(path, layout), layout)


def summaries_of(channels: Channels, figures: Sequence[SampleFigures] | None = None) -> tuple[ChannelSummary, ...]:
    """Look at each channel of a file, and for channels that hold the same values.

    The file is gone through once, unless ``figures`` of its channels were gathered before.
    """
    if figures is None:
        figures = [SampleFigures(len(channels.channels)) for _ in channels.channels]
        for number, piece in channels.pieces():
            figures[number].add(piece)
    summaries, seen = [], dict[bytes, str]()
    for channel, of_channel in zip(channels.channels, figures, strict=True):
        summary = replace(_summary(channel, of_channel), started_at=channels.started_at(channel))
        is_telling = not summary.is_constant and of_channel.size > 1
        if is_telling and (earlier := seen.setdefault(of_channel.digest(), channel.name)) != channel.name:
            summary = replace(summary, remarks=(*summary.remarks, f"holds the values of {earlier!r}"))
        summaries.append(summary)
    return tuple(summaries)


def summary_of(channel: Channel) -> ChannelSummary:
    """Look at one channel."""
    figures = SampleFigures()
    for piece in channel.pieces():
        figures.add(piece)
    return replace(_summary(channel, figures), started_at=channel.time.started_at)


@np.errstate(over="ignore", invalid="ignore")
def _summary(channel: Channel, figures: SampleFigures) -> ChannelSummary:
    summary = ChannelSummary(
        name=channel.name,
        shape=channel.shape,
        unit=channel.unit,
        sample_rate=channel.time.sample_rate,
        clock=channel.time.clock,
        kind=kind_of(channel.name, channel.unit, channel.head),
        first_values=tuple(float(value) for value in channel.head.reshape(-1)[:N_FIRST]),
        minimum=figures.minimum,
        maximum=figures.maximum,
        n_not_finite=figures.n_not_finite,
    )
    judged = _judged(summary, figures, channel.gaps)
    if len(channel.shape) != 1:
        return judged
    is_clock = summary.kind is Quantity.TIME and figures.size > 1
    said = _said_of_clock(channel, figures.clock) if is_clock else _breaks(channel.time)
    return replace(judged, remarks=(*judged.remarks, *said))


def _said_of_clock(channel: Channel, clock: RunningClock | None) -> tuple[str, ...]:
    unit = canonical_unit(channel.unit) or unit_in_name(channel.name)
    factor = FACTOR_TO_SI[Quantity.TIME].get(unit or "", 1.0)
    if unit is None and numbers_samples(channel.head):
        where, counted = channel.name, "samples"
    else:
        where, counted = channel.name if unit in FACTOR_TO_SI[Quantity.TIME] else f"{channel.name}, taken as s", "s"
    if clock is not None and len(channel.time.runs) < 2:  # told without the memory that all times at once take
        even = clock.even(printed_digit(clock.last), where, counted, factor)
        if even is not None:
            return (even.said,) if even.said else ()
    times = channel.samples.astype(np.float64, copy=False)
    times = times if factor == 1.0 else times * factor
    return said_of_times(times, printed_digit(channel.samples) * factor, where, channel.time.runs, unit=counted)


def said_of_times(
    times: FloatArray,
    printed: float,
    where: str,
    parted: Sequence[Run] = (),
    texts: Sequence[str] = (),
    *,
    unit: str = "s",
) -> tuple[str, ...]:
    """Say what an import will say of sampling times; the arguments are those of :func:`time_of_samples`."""
    try:
        found, said = time_of_samples(times, printed, where, parted, texts, unit=unit)
    except RecordingFormatError as error:
        return (str(error),)
    return (found.unevenness,) if found.unevenness else (*said, *_breaks(found, unit))


def is_of_time(kind: Quantity | None) -> bool:
    """Tell whether values rise by their nature, so that none of them is stuck or clipped."""
    return kind in (Quantity.TIME, Quantity.FREQUENCY)


@np.errstate(over="ignore", invalid="ignore")
def step_of(samples: SampleArray) -> float | None:
    """Return the middle step of sampling times; None if they do not rise."""
    steps = np.diff(samples.reshape(-1)[:HEAD].astype(np.float64))
    middle = float(np.median(steps)) if steps.size else 0.0
    return middle if np.isfinite(middle) and middle > 0.0 else None


def response_remark(response: FrequencyResponse) -> str:
    """Say in a few words what a frequency response of a file spans."""
    lines, of, per = response.frequency, response.response_unit, response.reference_unit
    unit = f"{of or 'no unit'} per {per or 'no unit'}" if of or per else "no unit"
    return f"{lines.size} lines, {lines[0]:g} to {lines[-1]:g} Hz, {unit}" if lines.size else "no lines"


def _judged(summary: ChannelSummary, figures: SampleFigures, gaps: str) -> ChannelSummary:
    kept = figures.kept()
    constant = figures.n_finite > 1 and summary.minimum == summary.maximum
    stuck = clipped = False
    remarks = []
    if summary.n_not_finite:
        reason = f": {gaps}" if gaps else ""
        remarks.append(f"{summary.n_not_finite} of {figures.size} values are not finite{reason}")
    if constant:
        remarks.append(f"constant: {summary.minimum:g} throughout")
    elif kept.size > 2 and not is_of_time(summary.kind):
        held = _held(kept)
        start, run = longest_run(kept)
        is_drive = summary.kind in DRIVES
        stuck = run > max(STUCK_SHARE * kept.size, SHORTEST_RUN) and is_stuck(kept, start, run, is_excitation=is_drive)
        at_rest = summary.kind in STANDING  # an encoder that stands says so
        stuck, clipped = stuck and not at_rest, not at_rest and _is_clipped(figures, held)
        if stuck:
            n_held = f"{run}" if kept.size == figures.n_finite else f"about {run / kept.size * figures.n_finite:.2g}"
            remarks.append(f"stuck: holds {kept[start]:g} for {n_held} values that follow each other")
        if clipped:
            remarks.append(f"clipped: piles up at the end of its range ({figures.n_at_ends} values)")
        if held > 1 and not at_rest:
            remarks.append(f"repeated: each value stands {held} times, so it was recorded at a lower rate")
    return replace(
        summary, is_constant=constant, is_stuck=stuck, is_clipped=clipped,
        remarks=tuple(remarks), doubts=tuple(_doubts(summary, kept)),
    )  # fmt: skip


def _breaks(time: ChannelTime, unit: str = "s") -> list[str]:
    """Say where the samples of a channel have a break, and how long it is; of many, the first."""
    behind, breaks = 0, list[str]()
    for run, later in pairwise(time.runs):
        behind += run.n_samples
        seconds = None
        if run.start is not None and later.start is not None and run.sample_rate is not None:
            seconds = later.start - run.start - run.n_samples / run.sample_rate
            if seconds < 0.5 / run.sample_rate:
                continue  # another rate without a pause
        if later.n_lost != 0:
            breaks.append(missing_samples(place_of_break(behind, later.mark), seconds, later.n_lost, unit))
    if len(breaks) > N_FIRST:
        breaks[N_FIRST:] = [f"and {len(breaks) - N_FIRST} breaks more"]
    return breaks


def _is_clipped(figures: SampleFigures, held: int) -> bool:
    at_top, at_bottom = figures.ends()
    return is_clipped(at_top[::held]) or is_clipped(-at_bottom[::held])


def _held(samples: SampleArray) -> int:
    """Return how often each value stands, where nearly all stand equally often; 1 otherwise."""
    changes = np.flatnonzero(np.diff(samples))
    if changes.size < 8 or changes.size > 0.6 * samples.size:
        return 1
    lengths = np.diff(changes)
    usual = int(np.median(lengths))
    return usual if np.mean(lengths == usual) >= _HELD_SHARE else 1


def _doubts(summary: ChannelSummary, finite: SampleArray) -> list[str]:
    named, by_name, of_name = unit_in_name(summary.name), kind_of_name(summary.name), canonical_unit(summary.unit)
    unit = of_name or named
    doubts = []
    if named is not None and of_name is not None and named != of_name:
        doubts.append(f"its name says {named}, its unit is {summary.unit}")
    by_name, by_unit = kind_in_unit(by_name, unit), kind_of_unit(unit)
    if by_name is not None and unit is not None and by_unit is not by_name:
        what = f"named like {_with_article(by_name)}, but its numbers are in {unit}"
        doubts.append(f"{what}, a raw unit: the map needs its sensitivity" if is_raw(unit) else what)
    kind = by_name or by_unit
    if kind is Quantity.TIME:
        doubts += _doubts_of_times(unit, finite)
    elif finite.size and kind is not None and unit is not None:
        doubts += _doubts_of_size(kind, unit, finite)
    return doubts


def _doubts_of_times(unit: str | None, times: SampleArray) -> list[str]:
    step, factors = step_of(times), FACTOR_TO_SI[Quantity.TIME]
    if (days := days_of(step, times)) is not None and unit in (None, "s"):
        return [days]
    if step is None or unit not in factors or times.size < 3:
        return []
    rate = 1.0 / (step * factors[unit])
    low, high = _PLAUSIBLE_RATE
    if low <= rate <= high:
        return []
    others = [other for other, factor in factors.items() if low <= 1.0 / (step * factor) <= high]
    instead = f"; in {others[0]} it would be {1.0 / (step * factors[others[0]]):g} Hz" if others else ""
    return [f"steps of {step:g} {unit} are a sampling rate of {rate:g} Hz{instead}"]


def days_of(step: float | None, times: SampleArray) -> str | None:
    """Say that times are days since a date, as a spreadsheet or MATLAB counts them; ``None`` where they are not."""
    if step is None or times.size < 3 or not 0.0 < step < 1.0 / (_PLAUSIBLE_RATE[0] * _SECONDS_PER_DAY):
        return None
    low, high = float(times.min()), float(times.max())
    for first, last, what in _DAYS:
        if first <= low and high <= last:
            rate = 1.0 / (step * _SECONDS_PER_DAY)
            return (
                f"values around {low:.0f} in steps of {step:.3g} are days, as {what} counts them (of about {rate:.4g} "
                'Hz): unit = "d" in [time] says so'
            )
    return None


def _doubts_of_size(kind: Quantity, unit: str, finite: SampleArray) -> list[str]:
    mean = abs(float(finite.mean(dtype=np.float64)))
    if kind is Quantity.ACCELERATION:
        for other, gravity in (("m/s2", _GRAVITY), ("g", 1.0)):
            if unit in ("m/s2", "g") and unit != other and abs(mean - gravity) < 0.02 * gravity:
                return [f"its mean of {mean:.3g} {unit} is that of gravity in {other}"]
    if kind is Quantity.POSITION and unit in FACTOR_TO_SI[Quantity.POSITION]:
        travel = float(np.ptp(finite)) * FACTOR_TO_SI[Quantity.POSITION][unit]
        if travel > _LONGEST_AXIS:
            return [f"a travel of {travel:g} m is longer than an axis: are these numbers in another unit than {unit}?"]
    return []


def _with_article(kind: Quantity) -> str:
    return f"{'an' if kind is Quantity.ACCELERATION else 'a'} {str(kind).replace('-', ' ')}"


def layout_remark(layout: TextLayout) -> str:
    """Say in a few words how a text file seems to be written, entry by entry as in the map's [text]."""
    return ", ".join(f"{name} {value}" for name, value in layout.entries().items())
