"""Propose when the samples were taken: sampling times, their unit, the rate, and windows to cut a long record into."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.units import FACTOR_TO_SI, Quantity, canonical_unit
from monitor_core.recordings.raw.channel_kind import MOST_STEPS, ChannelKind, names_other_unit
from monitor_core.recordings.raw.channels import Channels
from monitor_core.recordings.raw.inspection import step_of
from monitor_core.recordings.raw.mapping.clocks import clock_of_times, printed_digit
from monitor_core.recordings.raw.proposal.entries import CONFIRM, blank, choice_of_units, entry, plain, printed
from monitor_core.recordings.raw.proposal.parts import Part
from monitor_core.recordings.raw.text.text_times import TextTimes
from monitor_core.recordings.raw.text.times import times_of

_PLAUSIBLE_STEPS = (("s", 0.05), ("ms", 50.0), ("us", 5e4))  # longest step of a recording that is to show a mode
#: Records of fewer seconds are left whole.
_FEWEST_WINDOWS = 8
_GAP = 4.5  # steps: a longer one is a gap
#: How single numbers are named that state the rate [Hz], or the step [s]; without blanks, hyphens and underscores.
_NAMES_OF_RATE = frozenset((
    "fs", "fshz", "fsamp", "fsample", "fsampling", "samplerate", "samplingrate", "samplefrequency", "samplingfrequency",
    "sampleratehz", "samplingratehz", "samplingfrequencyhz",
))  # fmt: skip
_NAMES_OF_STEP = frozenset(("dt", "ts", "tsample", "sampletime", "samplingtime", "sampleinterval", "samplinginterval"))


@dataclass(frozen=True, slots=True)
class StatedRate:
    """A rate that a single number of the file seems to state."""

    sample_rate: float  # [Hz]
    name: str  # of the number


def rate_of_numbers(channels: Channels) -> StatedRate | None:
    """Return the rate that single numbers of the file seem to state; None where none does, or they contradict."""
    found = list[StatedRate]()
    for name, value in channels.numbers.items():
        last = re.sub(r"[-_\s]", "", name.rpartition(".")[2].lower())
        if last in _NAMES_OF_RATE and value > 0.0:
            found.append(StatedRate(value, name))
        elif last in _NAMES_OF_STEP and 0.0 < value < 1.0:
            found.append(StatedRate(1.0 / value, name))
    agree = len({f"{stated.sample_rate:.6g}" for stated in found}) == 1
    return found[0] if agree else None


def rate_line(stated: StatedRate | None) -> str:
    """Return the entry of the rate that neither channels nor sampling times say."""
    if stated is None:
        return blank("sample_rate_hz", "samples of a channel in a second; the file does not say it")
    return entry("sample_rate_hz", f"{stated.sample_rate:.12g}", f"{CONFIRM} {plain(stated.name)} of the file")


def time_lines(times: Part | TextTimes | None, signals: Sequence[Part]) -> Iterator[str]:
    """Yield the entries of sampling times, or of the rate that clocks of their own are brought to."""
    clocks = {part.channel.clock for part in signals}
    stated = any(part.channel.sample_rate is not None for part in signals)
    if clocks - {None}:
        if len(clocks) > 1:
            yield from ("", "[resample]                             # the channels have clocks of their own")
            yield blank("sample_rate_hz", "rate that all channels are brought to")
            yield entry("method", printed("cubic"), f"{CONFIRM} cubic | linear; the error is estimated and said")
        return
    if stated or times is None:
        return
    yield ""
    yield "[time]                                 # channel of the sampling times"
    if isinstance(times, TextTimes):
        yield from _text_time_lines(times)
        return
    unit, remark = _unit_of_times(times)
    yield entry("channel", printed(times.channel.name), f"{CONFIRM} rises evenly, or is named so")
    if times.entry is not None:
        yield entry(times.entry, str(times.number), f"{CONFIRM} {times.entry} of the array, counted from 1")
    if unit is None:
        yield blank("unit", choice_of_units(ChannelKind.TIME))
    else:
        yield entry("unit", printed(unit), remark)


def _text_time_lines(times: TextTimes) -> Iterator[str]:
    yield entry(
        "channel", printed(times.channel), f"{CONFIRM} texts of {'a date and time' if times.is_dated else 'a time'}"
    )
    if times.date is not None:
        yield entry("date", printed(times.date), f"{CONFIRM} the dates that belong to them")
    if times.form is None:
        yield blank("format", '"iso", or a pattern such as "%d/%m/%Y %H:%M:%S": is the day or the month in front?')
    else:
        yield entry("format", printed(times.form), f"{CONFIRM} iso, or a pattern of day, month, hour …")
    if times.is_dated and not times.has_zone:
        yield blank("zone", 'zone of these times, such as "+01:00" or "Z"')


def _counts(times: Part) -> bool:
    """Tell whether values are 0, 1, 2, …: the number of a sample, of which the rate is not known."""
    first = times.samples[:1000]
    return first.size > 1 and bool((np.diff(first) == 1.0).all()) and float(first[0]) in (0.0, 1.0)


def _unit_of_times(times: Part) -> tuple[str | None, str]:
    """Return the unit of sampling times: as stated, else the first in which the rate is one of recordings."""
    factors, step = FACTOR_TO_SI[Quantity.TIME], step_of(times.samples)
    unit = times.unit if times.unit in factors else None
    if unit is not None and canonical_unit(times.channel.unit) is not None:
        return unit, "as the file says"
    if unit is None and (names_other_unit(times.channel.name) or _counts(times)):
        return None, ""
    if unit is None and step is not None:
        unit = next((name for name, longest in _PLAUSIBLE_STEPS if step <= longest), None)
    if unit is None or step is None:
        return unit, f"{CONFIRM} as the name of the channel says"
    return unit, f"{CONFIRM} steps of {step:g} {unit} are {1.0 / (step * factors[unit]):g} Hz"


def rate_of_texts(times: TextTimes, channels: Channels) -> float | None:
    """Return the rate of texts of a date and time [Hz]; None where they say none."""
    if times.form is None:
        return None
    texts = channels.text(times.channel)[:MOST_STEPS]
    dates = None if times.date is None else channels.text(times.date)[:MOST_STEPS]
    try:
        seconds, _ = times_of(texts, times.form, None if times.has_zone else "Z", dates, channels.file_name)
    except RecordingFormatError:
        return None
    return _mean_rate(seconds, printed_digit(seconds))


def _mean_rate(seconds: FloatArray, printed: float) -> float | None:
    """Return the rate of sampling times, the plainest that they do not contradict [Hz]; None if they do not rise."""
    try:
        clock, _ = clock_of_times(seconds, printed, "")
    except RecordingFormatError:
        return None
    if clock.sample_rate is not None:
        return clock.sample_rate
    steps = np.diff(seconds)
    mean = float(seconds[-1] - seconds[0]) / steps.size
    if steps.min() < 0.0 or steps.max() > _GAP * mean:
        mean = step_of(seconds) or mean
    return 1.0 / mean


def cutting_line(signals: Sequence[Part], times: Part | TextTimes | None, rate_elsewhere: float | None) -> str:
    """Propose windows of a second of a record that has several: a measurement is an average over windows."""
    rate = next((part.channel.sample_rate for part in signals if part.channel.sample_rate is not None), None)
    if rate is None and isinstance(times, Part):
        unit, _ = _unit_of_times(times)
        if unit is not None:
            first, factor = times.samples.reshape(-1)[:MOST_STEPS], FACTOR_TO_SI[Quantity.TIME][unit]
            rate = _mean_rate(first.astype(np.float64) * factor, printed_digit(first) * factor)
    rate = rate_elsewhere if rate is None else rate
    size = max((part.samples.size for part in signals), default=0)
    if rate is None or not _FEWEST_WINDOWS * rate <= size:
        return "# samples_per_window = 20000           # cuts a long record: a measurement is an average of several"
    said = f"{CONFIRM} windows of a second; a measurement is an average over several"
    return entry("samples_per_window", str(round(rate)), said)
