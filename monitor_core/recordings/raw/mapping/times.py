"""Turn texts of a date and time, as loggers write them, into seconds and a start."""

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta, timezone, tzinfo

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import FloatArray
from monitor_core.errors import RecordingFormatError

_ISO = re.compile(
    r"(?:(\d{4})-?(\d\d)-?(\d\d)[Tt ]\s*)?(\d\d):?(\d\d)(?::?(\d\d)(?:[.,](\d{1,18}))?)?\s*"
    r"([Zz]|[+-]\d\d:?\d\d)?",
    re.ASCII,
)
_ZONE = re.compile(r"([+-])(\d\d):?(\d\d)", re.ASCII)
#: Directives of strptime that are numbers; what else a pattern holds goes to strptime itself, which is slower.
_DIRECTIVES = {"Y": r"(\d{4})", "m": r"(\d{1,2})", "d": r"(\d{1,2})", "H": r"(\d{1,2})", "M": r"(\d{1,2})",
               "S": r"(\d{1,2})", "f": r"(\d{1,18})", "y": r"(\d\d)"}  # fmt: skip
_PARTS = ("Y", "m", "d", "H", "M", "S", "f")
_LEAST = {"Y": 1, "m": 1, "d": 1}
_MOST = {"Y": 9999, "m": 12, "d": 31, "H": 23, "M": 59, "S": 59}
_DIRECTIVE = re.compile(r"%(.)")
_NANOSECONDS = 10**9
Nanoseconds = npt.NDArray[np.int64]
#: Beyond these years nanoseconds since 1970 do not fit 64 bits.
_YEARS = (1678, 2261)


def times_of(
    texts: Sequence[str],
    format: str,  # noqa: A002  # as the entry of the map is called
    zone: tzinfo | None,
    dates: Sequence[str] | None,
    where: str,
) -> tuple[FloatArray, datetime | None]:
    """Return the seconds since the first text, and when that was.

    Parameters
    ----------
    texts : sequence of str
        A date and time each; with ``dates``, or where no date is written, a time of day.
    format : str
        "iso" (ISO 8601 to the second or finer, with point or comma) or a pattern of ``strptime``.
    zone : tzinfo or None
        Zone of texts that carry none, see :func:`zone_of`.
    dates : sequence of str or None
        Dates that stand in a column of their own; texts and pattern are then of "date time", with one blank between.
    where : str
        File and channel, for messages.

    Returns
    -------
    ndarray, shape (n_texts,)
        Seconds since the first text, to the nanosecond. [s]
    datetime or None
        The first text with its zone, to the microsecond; ``None`` where no date or no zone is known.

    Raises
    ------
    RecordingFormatError
        If a text does not fit the format, if the calendar has no such day, if a zone is stated twice or differs from
        row to row, or if times of day without a date go back, as they do at midnight.

    Examples
    --------
    >>> seconds, start = times_of(["2025-03-01T06:00:00.25", "2025-03-01T06:00:01.5"], "iso", UTC, None, "example")
    >>> seconds.tolist(), start.isoformat()
    ([0.0, 1.25], '2025-03-01T06:00:00.250000+00:00')

    """
    if not texts:
        raise RecordingFormatError(f"{where}: expected dates and times; the column is blank")
    if dates is not None:
        if len(dates) != len(texts):
            raise RecordingFormatError(f"{where}: expected a date for each time; got {len(dates)} and {len(texts)}")
        texts = [f"{date} {text}" for date, text in zip(dates, texts, strict=True)]
    if format == "iso":
        moments, dated, carried = _iso(texts, where)
    else:
        moments, dated, carried = _patterned(texts, format, where)
    if carried is not None and zone is not None:
        raise RecordingFormatError(f"{where}: expected the zone stated once; got {texts[0]!r} and zone in the map")
    seconds = (moments - moments[0]) / _NANOSECONDS
    if not dated and np.any(np.diff(moments) < 0):
        fall = int(np.argmax(np.diff(moments) < 0))
        raise RecordingFormatError(
            f"{where}: expected times of day that rise; got {texts[fall + 1][:40]!r} behind {texts[fall][:40]!r}: over "
            "midnight a date is needed"
        )
    of_texts = carried if carried is not None else zone
    if not dated or of_texts is None:
        return seconds, None
    local = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=int(moments[0]) // 1000)
    if carried is not None:  # moments of texts with a zone are those of UTC
        return seconds, local.astimezone(of_texts)
    return seconds, local.replace(tzinfo=of_texts)


def zone_of(text: str, where: str) -> tzinfo:
    """Return the zone of a text such as "+01:00" or "Z"; ``RecordingFormatError`` if it is none."""
    if text.upper() == "Z":
        return UTC
    match = _ZONE.fullmatch(text)
    if match is None or int(match[2]) > 23 or int(match[3]) > 59:
        raise RecordingFormatError(f"{where}, zone: expected an offset such as '+01:00' or 'Z'; got {text!r}")
    offset = timedelta(hours=int(match[2]), minutes=int(match[3]))
    return timezone(-offset if match[1] == "-" else offset)


def _iso(texts: Sequence[str], where: str) -> tuple[Nanoseconds, bool, tzinfo | None]:
    fields, zones = np.zeros((7, len(texts)), dtype=np.int64), dict[str, int]()
    of_first: tuple[bool, bool] | None = None
    for i, text in enumerate(texts):
        match = _ISO.fullmatch(text.strip())
        if match is None:
            raise RecordingFormatError(
                f"{where}, sample {i}: expected a time of ISO 8601 such as 2025-03-01T06:00:00.5; got {text[:40]!r}"
            )
        written = (match[1] is not None, match[8] is not None)
        of_first = of_first or written
        if written != of_first:
            raise RecordingFormatError(
                f"{where}, sample {i}: expected date and zone as in {texts[0][:40]!r}; got {text[:40]!r}"
            )
        year, month, day, hour, minute, second, fraction, offset = match.groups()
        fields[:, i] = (year or 1970, month or 1, day or 1, hour, minute, second or 0, _nanoseconds(fraction))
        if offset is not None:
            zones.setdefault(offset.upper(), i)
    if len(zones) > 1:
        raise RecordingFormatError(f"{where}: expected one zone; got {' and '.join(list(zones)[:3])}")
    carried = zone_of(next(iter(zones)), where) if zones else None
    moments = _moments(fields, texts, where)
    if carried is not None:
        moments = moments - round((carried.utcoffset(None) or timedelta()).total_seconds()) * _NANOSECONDS
    return moments, of_first is not None and of_first[0], carried


def _patterned(texts: Sequence[str], pattern: str, where: str) -> tuple[Nanoseconds, bool, tzinfo | None]:
    directives = _DIRECTIVE.findall(pattern)
    dated = "d" in directives and bool({"Y", "y"} & set(directives)) and bool({"m", "b", "B"} & set(directives))
    dated = dated or bool({"c", "x"} & set(directives)) or ("j" in directives and bool({"Y", "y"} & set(directives)))
    if not {"H", "I", "c", "X"} & set(directives):
        raise RecordingFormatError(
            f"{where}, format: expected 'iso' or a pattern with hours such as '%d.%m.%Y %H:%M:%S'; got {pattern[:60]!r}"
        )
    if not set(directives) <= _DIRECTIVES.keys() or len(set(directives)) < len(directives):
        return (*_by_strptime(texts, pattern, dated=dated, where=where),)
    pieces = _DIRECTIVE.split(pattern)
    expression = re.compile(
        "".join(_DIRECTIVES[piece] if i % 2 else re.escape(piece) for i, piece in enumerate(pieces)), re.ASCII
    )
    places = {directive: number for number, directive in enumerate(directives, start=1)}
    fields = np.zeros((7, len(texts)), dtype=np.int64)
    fields[0], fields[1], fields[2] = 1970, 1, 1
    for i, text in enumerate(texts):
        match = expression.fullmatch(text.strip())
        if match is None:
            raise RecordingFormatError(f"{where}, sample {i}: expected a time as {pattern!r}; got {text[:40]!r}")
        for directive, place in places.items():
            if directive == "f":
                fields[6, i] = _nanoseconds(match[place])
            elif directive == "y":  # as POSIX: 69 to 99 are of the last century
                year = int(match[place])
                fields[0, i] = year + (1900 if year > 68 else 2000)
            else:
                fields[_PARTS.index(directive), i] = int(match[place])
    return _moments(fields, texts, where), dated, None


def _by_strptime(
    texts: Sequence[str], pattern: str, *, dated: bool, where: str
) -> tuple[Nanoseconds, bool, tzinfo | None]:
    moments, zones = np.zeros(len(texts), dtype=np.int64), dict[timedelta, tzinfo]()
    zero = datetime(1970, 1, 1, tzinfo=UTC)
    for i, text in enumerate(texts):
        try:
            moment = datetime.strptime(text.strip(), pattern)  # noqa: DTZ007  # the zone may be in the map
            offset = moment.utcoffset()
            if offset is not None:
                zones.setdefault(offset, timezone(offset))
            since = (moment if offset is not None else moment.replace(tzinfo=UTC)) - zero
        except (ValueError, OverflowError, re.error):
            raise RecordingFormatError(
                f"{where}, sample {i}: expected a time as {pattern[:60]!r}; got {text[:40]!r}"
            ) from None
        if abs(since) > timedelta(days=365 * 280):
            raise RecordingFormatError(f"{where}, sample {i}: expected a year of a recording; got {text[:40]!r}")
        moments[i] = (since // timedelta(microseconds=1)) * 1000
    if len(zones) > 1:
        raise RecordingFormatError(f"{where}: expected one zone; got {len(zones)} of them")
    return moments, dated, next(iter(zones.values()), None)


def _nanoseconds(fraction: str | None) -> int:
    return int(fraction[:9].ljust(9, "0")) if fraction else 0


def _moments(fields: Nanoseconds, texts: Sequence[str], where: str) -> Nanoseconds:
    """Return nanoseconds since 1970 of years, months, days, hours, minutes, seconds and nanoseconds."""
    wrong = np.zeros(fields.shape[1], dtype=np.bool_)
    for row, part in enumerate(_PARTS[:6]):
        wrong |= (fields[row] < _LEAST.get(part, 0)) | (fields[row] > _MOST[part])
    wrong |= (fields[0] < _YEARS[0]) | (fields[0] > _YEARS[1])
    months = (np.clip(fields[0], *_YEARS) - 1970) * 12 + np.clip(fields[1], 1, 12) - 1
    of_month = months.astype("datetime64[M]")
    days = of_month.astype("datetime64[D]").astype(np.int64)
    length = (of_month + 1).astype("datetime64[D]").astype(np.int64) - days
    wrong |= fields[2] > length
    if wrong.any():
        i = int(np.argmax(wrong))
        raise RecordingFormatError(f"{where}, sample {i}: expected a time of the calendar; got {texts[i][:40]!r}")
    seconds = ((days + fields[2] - 1) * 24 + fields[3]) * 3600 + fields[4] * 60 + fields[5]
    moments: Nanoseconds = seconds * _NANOSECONDS + fields[6]
    return moments
