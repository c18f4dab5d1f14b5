"""Read what single numbers of a file say of its sampling, by their names, and compare it with what is used.

Such numbers are variables of MATLAB and NumPy ("Fs"), columns of one value, and rows above a table of text:
"Sample Rate: 51.2 kHz", "Record Length,10000".
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.units import unit_of
from monitor_core.recordings.raw.channel_kind import letters_of, rate_of_number
from monitor_core.recordings.raw.channels import Channels

#: How those are named that state the number of samples; of the names, letters alone.
_NAMES_OF_LENGTH = frozenset((
    "recordlength", "samples", "numberofsamples", "nsamples", "numsamples", "npts", "points", "numberofpoints", "rows",
    "anzahlwerte",
))  # fmt: skip
#: How those are named that state the samples of a period of an excitation that repeats itself.
_NAMES_OF_PERIOD = frozenset((
    "nrofs", "samplesperperiod", "nsamplesperperiod", "pointsperperiod", "periodlength", "samplesinperiod", "nperiod",
    "periodsamples",
))  # fmt: skip
_ROW = re.compile(
    r"[\W_]*(?P<name>[^\W\d_][^:=,;\t\"]{0,60})\"?\s*[:=,;\t][\s:=,;\t\"]*(?P<number>[-+]?\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?)"
    r"\"?[\s,;\t\"]*(?P<unit>[^\W\d_]{0,3})[\W_]*"
)
#: By which a rate may differ from that of numbers that are printed to a few digits.
_SAME = 1e-3


@dataclass(frozen=True, slots=True)
class StatedRate:
    """A rate that a single number of the file seems to state."""

    sample_rate: float  # [Hz]
    name: str  # of the number


def numbers_above(rows: Sequence[str]) -> Iterator[tuple[str, float]]:
    """Yield what rows above a table state, such as ``Sample Rate: 51.2 kHz``: name with its unit, and number."""
    for row in rows:
        match = _ROW.fullmatch(row)
        if match is not None:
            unit = f" [{match['unit']}]" if unit_of(match["unit"]) is not None else ""
            yield f"{match['name'].strip()}{unit}", float(match["number"].replace(",", "."))


def rate_of_numbers(channels: Channels) -> StatedRate | None:
    """Return the rate that single numbers of the file seem to state; None where none does, or they contradict."""
    named = ((name, rate_of_number(name, value)) for name, value in _stated(channels, _may_be_rate))
    stated = [StatedRate(rate, name) for name, rate in named if rate is not None]
    return stated[0] if len({f"{each.sample_rate:.6g}" for each in stated}) == 1 else None


def period_of_numbers(channels: Channels) -> tuple[str, int] | None:
    """Return name and value of the number that seems to state the samples of a period; None where none does."""
    stated = [(name, value) for name, value in _stated(channels, _is_period) if value >= 1.0 and value.is_integer()]
    return (stated[0][0], int(stated[0][1])) if len({value for _, value in stated}) == 1 else None


def number_named(channels: Channels, name: str, entry: str) -> float:
    """Return a single number of the file, or of a column of one value, for an entry of the map that names it.

    ``RecordingFormatError`` if the file has none of that name, or one that is not positive.
    """
    numbers = dict(_stated(channels, name.__eq__))
    if not numbers.get(name, 0.0) > 0.0:
        got = f"{numbers[name]:g}" if numbers else f"none of that name; single numbers: {', '.join(channels.numbers)}"
        raise RecordingFormatError(
            f"{channels.file_name}: expected a positive number {name!r}, which {entry} of the map names; got {got}"
        )
    return numbers[name]


def doubts_of_sampling(channels: Channels, sample_rate: float, n_samples: int) -> Iterator[str]:
    """Say where the file states another rate [Hz], or another number of samples, than is used."""
    stated = rate_of_numbers(channels)
    if stated is not None and abs(sample_rate / stated.sample_rate - 1.0) > _SAME:
        yield (
            f"{channels.file_name}: in doubt: {stated.name!r} in the file says {stated.sample_rate:.6g} Hz; "
            f"{sample_rate:.6g} Hz is used, as its times or the map say"
        )
    for name, value in _stated(channels, _is_length):
        if value != n_samples:
            yield (
                f"{channels.file_name}: in doubt: {name!r} in the file says {value:g}; it holds {n_samples} samples, "
                "which are used: rows may have been left out when it was written"
            )


def _may_be_rate(name: str) -> bool:
    return any(rate_of_number(name, value) is not None for value in (1000.0, 1e-3))


def _is_period(name: str) -> bool:
    return letters_of(name) in _NAMES_OF_PERIOD


def _is_length(name: str) -> bool:
    return letters_of(name) in _NAMES_OF_LENGTH


def _stated(channels: Channels, is_wanted: Callable[[str], bool]) -> Iterator[tuple[str, float]]:
    """Yield the numbers of some names, columns of one value included."""
    yield from ((name, value) for name, value in channels.numbers.items() if is_wanted(name))
    for channel in channels.channels:
        if is_wanted(channel.name) and channel.head.size and not channel.varies:
            yield channel.name, float(channel.head.flat[0])
