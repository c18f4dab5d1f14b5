"""Propose when the samples were taken: sampling times, their unit, the rate, and windows to cut a long record into."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC

import numpy as np
import scipy

from monitor_core.arrays import FloatArray, SampleArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.units import FACTOR_TO_SI, Quantity, canonical_unit
from monitor_core.recordings.raw.channel_kind import names_other_unit
from monitor_core.recordings.raw.channel_time import GAP, numbers_samples, printed_digit, time_of_samples
from monitor_core.recordings.raw.channels import HEAD, Channels
from monitor_core.recordings.raw.inspection import days_of, said_of_times, step_of
from monitor_core.recordings.raw.mapping.times import times_of
from monitor_core.recordings.raw.proposal.entries import (
    MapEntry,
    MapTable,
    Mark,
    choice_of_units,
    missing,
    number,
    place_entries,
    plain,
)
from monitor_core.recordings.raw.proposal.parts import Part
from monitor_core.recordings.raw.stated_numbers import StatedRate, period_of_numbers

_ISO = re.compile(r"\d{4}-\d\d-\d\d[Tt ]\d\d:\d\d(:\d\d([.,]\d+)?)?\s*(?P<zone>[Zz]|[+-]\d\d:?\d\d)?", re.ASCII)
_CLOCK = re.compile(r"\d{1,2}:\d\d(?P<seconds>:\d\d)?((?P<sign>[.,])\d+)?(?P<half>\s?[AaPp][Mm])?", re.ASCII)
_DATE = re.compile(r"(\d{1,4})([-./])(\d{1,2})\2(\d{1,4})", re.ASCII)
_MOST_LOOKED_AT = 1000
_PLAUSIBLE_STEPS = (("s", 0.05), ("ms", 50.0), ("us", 5e4))  # longest step of a recording that is to show a mode
_PERIOD = "windows of a period, so that nothing leaks"
#: What repeats itself so often, so alike, and with so many lines of this share of the strongest, has a period.
_FEWEST_PERIODS, _SHORTEST_PERIOD, _ALIKE, _FEWEST_LINES, _LEAST_LINE = 3, 64, 0.9, 10, 0.01
#: Records of fewer seconds are left whole.
_FEWEST_WINDOWS = 8


@dataclass(frozen=True, slots=True)
class TextTimes:
    """Columns of texts that seem to be sampling times."""

    channel: str
    date: str | None  # column of dates in front of it
    form: str | None  # "iso" or a pattern of strptime; None where day and month may stand either way
    is_dated: bool
    has_zone: bool


def rate_entry(stated: StatedRate | None) -> MapEntry:
    """Return the entry of the rate that neither channels nor sampling times say."""
    if stated is None:
        return missing("sample_rate_hz", "samples of a channel in a second; the file does not say it")
    return number("sample_rate_hz", f"{stated.sample_rate:.12g}", f"{plain(stated.name)} of the file")


def time_tables(times: Part | TextTimes | None, signals: Sequence[Part], channels: Channels) -> list[MapTable]:
    """Return the table of sampling times, or of the rate that clocks of their own are brought to; none if neither."""
    clocks = {part.channel.time.clock for part in signals}
    if clocks - {None}:
        resample = (
            missing("sample_rate_hz", "rate that all channels are brought to"),
            MapEntry("method", "cubic", "cubic | linear; the error is estimated and said"),
        )
        named = [channels.channel(clock) for clock in clocks if clock is not None]
        if len(named) == len(clocks) and all(np.array_equal(named[0].samples, c.samples) for c in named[1:]):
            return []
        return [MapTable("resample", resample, "the channels have clocks of their own")]
    if times is None or any(part.channel.time.rates for part in signals):
        return []
    entries = _text_time_entries(times) if isinstance(times, TextTimes) else _time_entries(times)
    return [MapTable("time", tuple(entries), "channel of the sampling times")]


def _time_entries(times: Part) -> Iterator[MapEntry]:
    yield from place_entries(times, "rises evenly, or is named so")
    unit, mark, remark = _unit_of_times(times)
    if unit is not None:
        yield MapEntry("unit", unit, remark, mark)
    elif numbers_samples(times.head) and not names_other_unit(times.channel.name):
        yield missing("sample_rate_hz", "of the samples that it numbers; or unit, if these are times")
    else:
        yield missing("unit", choice_of_units(Quantity.TIME))


def _text_time_entries(times: TextTimes) -> Iterator[MapEntry]:
    yield MapEntry("channel", times.channel, f"texts of {'a date and time' if times.is_dated else 'a time'}")
    if times.date is not None:
        yield MapEntry("date", times.date, "the dates that belong to them")
    if times.form is None:
        yield missing("format", '"iso", or a pattern such as "%d/%m/%Y %H:%M:%S": is the day or the month in front?')
    else:
        yield MapEntry("format", times.form, "iso, or a pattern of day, month, hour …")
    if times.is_dated and not times.has_zone:
        yield missing("zone", 'zone of these times, such as "+01:00" or "Z"')


def _unit_of_times(times: Part) -> tuple[str | None, Mark, str]:
    """Return the unit of sampling times, as stated, else the first in which the rate is one of recordings; and why."""
    factors, step = FACTOR_TO_SI[Quantity.TIME], step_of(times.head)
    unit = times.unit if times.unit in factors else None
    if unit is not None and canonical_unit(times.channel.unit) is not None:
        return unit, Mark.STATED, "as the file says"
    if unit is None and (names_other_unit(times.channel.name) or numbers_samples(times.head)):
        return None, Mark.FILL_IN, ""
    if unit is None and days_of(step, times.head) is not None:
        return "d", Mark.CONFIRM, "days since a date, as spreadsheets count"
    if unit is None and step is not None:
        unit = next((name for name, longest in _PLAUSIBLE_STEPS if step <= longest), None)
    if unit is None or step is None:
        return unit, Mark.CONFIRM, "as the name of the channel says"
    return unit, Mark.CONFIRM, f"steps of {step:g} {unit} are {1.0 / (step * factors[unit]):g} Hz"


def rate_of_texts(times: TextTimes, channels: Channels) -> float | None:
    """Return the rate of texts of a date and time [Hz]; None where they say none."""
    try:
        seconds = _seconds_of_texts(times, channels, HEAD)
    except RecordingFormatError:
        return None
    return None if seconds is None else _mean_rate(seconds, printed_digit(seconds))


def said_of_texts(channels: Channels) -> tuple[str, ...]:
    """Say what an import will say of texts that seem to be sampling times."""
    times = text_times(channels.texts)
    if times is None:
        return ()
    try:
        seconds = _seconds_of_texts(times, channels)
    except RecordingFormatError as error:
        return (str(error),)
    if seconds is None:
        return ()
    runs = channels.channels[0].time.runs if channels.channels else ()
    where = f"{channels.file_name}, {times.channel}"
    return said_of_times(seconds, printed_digit(seconds), where, runs, channels.text(times.channel))


def _seconds_of_texts(times: TextTimes, channels: Channels, most: int | None = None) -> FloatArray | None:
    """Return the seconds that the first texts say; None where day and month may stand either way."""
    if times.form is None:
        return None
    dates = None if times.date is None else channels.text(times.date)[:most]
    where = f"{channels.file_name}, {times.channel}"
    zone = None if times.has_zone else UTC
    return times_of(channels.text(times.channel)[:most], times.form, zone, dates, where)[0]


def _mean_rate(seconds: FloatArray, printed: float) -> float | None:
    """Return the rate of sampling times, the plainest that they do not contradict [Hz]; None if they do not rise."""
    try:
        time, _ = time_of_samples(seconds, printed, "")
    except RecordingFormatError:
        step = step_of(seconds)
        return None if step is None else 1.0 / step
    if time.runs[0].sample_rate is not None:
        return time.runs[0].sample_rate
    steps = np.diff(seconds)
    mean = float(seconds[-1] - seconds[0]) / steps.size
    if steps.max() > GAP * mean:
        mean = step_of(seconds) or mean
    return 1.0 / mean if mean > 0.0 else None


def cutting_entry(
    signals: Sequence[Part], times: Part | TextTimes | None, rate_elsewhere: float | None, channels: Channels
) -> MapEntry:
    """Propose windows of a record that has several: of a period that repeats itself, or else of a second."""
    size = max((part.size for part in signals), default=0)
    stated = period_of_numbers(channels)
    if stated is not None and 2 * stated[1] <= size:
        return MapEntry("samples_per_window", stated[0], f"{plain(stated[0])} of the file, now {stated[1]}: {_PERIOD}")
    period = period_of(signals[0].head) if signals and len(signals[0].shape) == 1 else None
    if period is not None:
        return number("samples_per_window", str(period), f"{plain(signals[0].channel.name)} repeats itself: {_PERIOD}")
    rate = next((rate for part in signals for rate in part.channel.time.rates), None)
    if rate is None and isinstance(times, Part):
        unit, *_ = _unit_of_times(times)
        if unit is not None:
            start, factor = times.head.reshape(-1), FACTOR_TO_SI[Quantity.TIME][unit]
            rate = _mean_rate(start.astype(np.float64) * factor, printed_digit(start) * factor)
    rate = rate_elsewhere if rate is None else rate
    if rate is None or not _FEWEST_WINDOWS * rate <= size:
        remark = "cuts a long record: a measurement is an average of several"
        return number("samples_per_window", "20000", remark, Mark.OPTIONAL)
    remark = "windows of a second; a measurement is an average over several"
    return number("samples_per_window", str(round(rate)), remark)


def period_of(samples: SampleArray) -> int | None:
    """Return after how many samples a broadband signal repeats itself; None where it does not, at least three times.

    By the correlation of the record with itself, later: it must have fallen in between, and a period must hold many
    lines, so that neither a slow signal nor a sine has one.
    """
    if samples.size < _SHORTEST_PERIOD * _FEWEST_PERIODS or not np.all(np.isfinite(samples)):
        return None
    values = samples.astype(np.float64) - float(np.mean(samples, dtype=np.float64))
    n, longest = values.size, values.size // _FEWEST_PERIODS
    spectrum = scipy.fft.rfft(values, 2 * n)
    products = scipy.fft.irfft(np.abs(spectrum) ** 2)[: longest + 1]
    energy = np.concatenate([[0.0], np.cumsum(values**2)])
    lags = np.arange(longest + 1)
    powers = np.sqrt(energy[n - lags] * (energy[n] - energy[lags]))
    likeness = products / np.maximum(powers, np.finfo(np.float64).tiny)
    fallen = np.flatnonzero(likeness < 0.5 * _ALIKE)
    if not fallen.size:
        return None
    alike = fallen[0] + np.flatnonzero(likeness[fallen[0] :] > _ALIKE)
    if not alike.size or alike[0] < _SHORTEST_PERIOD:
        return None
    period = int(alike[0] + np.argmax(likeness[alike[0] : alike[0] + _SHORTEST_PERIOD]))
    lines = np.abs(scipy.fft.rfft(values[: n - n % period].reshape(-1, period).mean(axis=0))) ** 2
    return period if int(np.sum(lines > _LEAST_LINE * lines.max())) >= _FEWEST_LINES else None


def text_times(columns: Mapping[str, Sequence[str]]) -> TextTimes | None:
    """Return what columns of texts seem to say; None if none of them is a time."""
    looked_at = {name: [text.strip() for text in texts[:_MOST_LOOKED_AT]] for name, texts in columns.items() if texts}
    for name, texts in looked_at.items():
        if (match := _ISO.fullmatch(texts[0])) is not None:
            return TextTimes(name, None, "iso", is_dated=True, has_zone=match["zone"] is not None)
    dates = next((name for name, texts in looked_at.items() if _DATE.fullmatch(texts[0])), None)
    for name, texts in looked_at.items():
        date, _, clock = _parted(texts[0])
        pattern = _clock_pattern(clock)
        if pattern is None or (date and not _DATE.fullmatch(date)):
            continue
        if date:
            form = _joined([_parted(text)[0] for text in texts], pattern)
            return TextTimes(name, None, form, is_dated=True, has_zone=False)
        if dates is not None:
            return TextTimes(name, dates, _joined(looked_at[dates], pattern), is_dated=True, has_zone=False)
        return TextTimes(name, None, pattern, is_dated=False, has_zone=False)
    return None


def _parted(text: str) -> tuple[str, str, str]:
    """Part the date from the time behind it, which may end in AM or PM."""
    return ("", "", text) if ":" in text.partition(" ")[0] else text.partition(" ")


def _clock_pattern(text: str) -> str | None:
    match = _CLOCK.fullmatch(text)
    if match is None:
        return None
    hour = "%H" if match["half"] is None else "%I"
    half = "" if match["half"] is None else f"{match['half'][:-2]}%p"
    fraction = "" if match["sign"] is None else f"{match['sign']}%f"
    return f"{hour}:%M{'' if match['seconds'] is None else ':%S'}{fraction}{half}"


def _joined(dates: Sequence[str], clock: str) -> str | None:
    date = _date_pattern(dates)
    return None if date is None else f"{date} {clock}"


def _date_pattern(dates: Sequence[str]) -> str | None:
    """Return the pattern of dates; None where a stroke leaves day and month open in all of them."""
    parts = [match.groups() for text in dates if (match := _DATE.fullmatch(text)) is not None]
    first, sign, _, last = parts[0]
    if len(first) == 4:
        return f"%Y{sign}%m{sign}%d"
    year = "%Y" if len(last) == 4 else "%y"
    if sign == "." or any(int(groups[0]) > 12 for groups in parts):
        return f"%d{sign}%m{sign}{year}"
    return f"%m{sign}%d{sign}{year}" if any(int(groups[2]) > 12 for groups in parts) else None
