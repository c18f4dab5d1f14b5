"""Read and write instants: RFC 3339 with a zone, never without."""

import re
from datetime import UTC, datetime, timedelta

from monitor_core.errors import RecordingFormatError

_RFC_3339 = re.compile(r"\d{4}-\d\d-\d\d[Tt ]\d\d:\d\d:\d\d(\.\d+)?([Zz]|[+-]\d\d:\d\d)", re.ASCII)


def parse_instant(text: str, where: str) -> datetime:
    """Read an RFC 3339 instant; digits beyond the microsecond are cut off.

    ``text``: such as ``2025-03-01T06:00:00Z`` or ``2025-03-01T07:00:00.25+01:00``; ``where``: file and place, for
    the message. Returned: with a time zone. ``RecordingFormatError`` if the text is no such instant, if the zone is
    missing, or if the calendar has no such day.

    Examples
    --------
    RFC 3339, section 5.8: 20 minutes and 50.52 seconds after the 23rd hour of April 12th, 1985 in UTC.

    >>> parse_instant("1985-04-12T23:20:50.52Z", "example").isoformat()
    '1985-04-12T23:20:50.520000+00:00'
    """
    expected = f"{where}: expected an RFC 3339 time with zone such as 2025-03-01T06:00:00Z; got {text!r}"
    if not _RFC_3339.fullmatch(text):
        raise RecordingFormatError(expected)
    try:
        return datetime.fromisoformat(text.upper())
    except ValueError as error:
        raise RecordingFormatError(f"{expected} ({error})") from error


def format_instant(instant: datetime) -> str:
    """Write an instant as RFC 3339, keeping its offset; local mean times with seconds in the offset become UTC."""
    offset = instant.utcoffset()
    if offset is None:
        raise RecordingFormatError(f"expected a time with zone; got {instant.isoformat()}")
    return (instant if offset % timedelta(minutes=1) == timedelta(0) else instant.astimezone(UTC)).isoformat()
