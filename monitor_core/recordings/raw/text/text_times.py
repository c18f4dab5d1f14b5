"""Propose how columns of texts say the sampling times: which column, in which format, with which date in front."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from monitor_core.recordings.raw.channels import Channels

_ISO = re.compile(r"\d{4}-\d\d-\d\d[Tt ]\d\d:\d\d(:\d\d([.,]\d+)?)?\s*(?P<zone>[Zz]|[+-]\d\d:?\d\d)?", re.ASCII)
_CLOCK = re.compile(r"\d{1,2}:\d\d(?P<seconds>:\d\d)?((?P<sign>[.,])\d+)?(?P<half>\s?[AaPp][Mm])?", re.ASCII)
_DATE = re.compile(r"(\d{1,4})([-./])(\d{1,2})\2(\d{1,4})", re.ASCII)
_MOST_LOOKED_AT = 1000


@dataclass(frozen=True, slots=True)
class TextTimes:
    """Columns of texts that seem to be sampling times."""

    channel: str
    date: str | None  # column of dates in front of it
    form: str | None  # "iso" or a pattern of strptime; None where day and month may stand either way
    is_dated: bool
    has_zone: bool


def columns_of_texts(channels: Channels) -> Mapping[str, Sequence[str]]:
    """Return the columns of texts of a file, which only texts in columns have."""
    texts: Mapping[str, Sequence[str]] = getattr(channels, "texts", {})
    return texts


def text_times(columns: Mapping[str, Sequence[str]]) -> TextTimes | None:
    """Return what columns of texts seem to say; None if none of them is a time."""
    known = {name: [text.strip() for text in texts[:_MOST_LOOKED_AT]] for name, texts in columns.items() if texts}
    for name, texts in known.items():
        if (found := _ISO.fullmatch(texts[0])) is not None:
            return TextTimes(name, None, "iso", is_dated=True, has_zone=found["zone"] is not None)
    dates = next((name for name, texts in known.items() if _DATE.fullmatch(texts[0])), None)
    for name, texts in known.items():
        date, _, clock = _parted(texts[0])
        pattern = _clock_pattern(clock)
        if pattern is None or (date and not _DATE.fullmatch(date)):
            continue
        if date:
            form = _joined([_parted(text)[0] for text in texts], pattern)
            return TextTimes(name, None, form, is_dated=True, has_zone=False)
        if dates is not None:
            return TextTimes(name, dates, _joined(known[dates], pattern), is_dated=True, has_zone=False)
        return TextTimes(name, None, pattern, is_dated=False, has_zone=False)
    return None


def _parted(text: str) -> tuple[str, str, str]:
    """Part the date from the time behind it, which may end in AM or PM."""
    return ("", "", text) if ":" in text.partition(" ")[0] else text.partition(" ")


def _clock_pattern(text: str) -> str | None:
    found = _CLOCK.fullmatch(text)
    if found is None:
        return None
    hour = "%H" if found["half"] is None else "%I"
    half = "" if found["half"] is None else f"{found['half'][:-2]}%p"
    fraction = "" if found["sign"] is None else f"{found['sign']}%f"
    return f"{hour}:%M{'' if found['seconds'] is None else ':%S'}{fraction}{half}"


def _joined(dates: Sequence[str], clock: str) -> str | None:
    date = _date_pattern(dates)
    return None if date is None else f"{date} {clock}"


def _date_pattern(dates: Sequence[str]) -> str | None:
    """Return the pattern of dates; None where a stroke leaves day and month open in all of them."""
    parts = [found.groups() for text in dates if (found := _DATE.fullmatch(text)) is not None]
    first, sign, _, last = parts[0]
    if len(first) == 4:
        return f"%Y{sign}%m{sign}%d"
    year = "%Y" if len(last) == 4 else "%y"
    if sign == "." or any(int(groups[0]) > 12 for groups in parts):
        return f"%d{sign}%m{sign}{year}"
    return f"%m{sign}%d{sign}{year}" if any(int(groups[2]) > 12 for groups in parts) else None
