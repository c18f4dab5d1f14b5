"""Read what pages are asked with: moments in the zone of the visitor, numbers as people write them, spans."""

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Annotated, Final, Literal
from urllib.parse import urlencode
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from fastapi import Depends, Form
from pydantic import BaseModel, Field

from service.documents.said import N_
from service.errors import InvalidRequestError
from service.operations.fields import EARLIEST, LATEST, Moment, RequestModel
from service.store.trend.points import Span

MomentText = Annotated[str, Field(max_length=40)]


class SpanForm(BaseModel):
    """From when until when, in a zone; either may be left empty."""

    start: MomentText = Field(default="", alias="from")
    end: MomentText = Field(default="", alias="to")
    zone: Annotated[str, Field(max_length=60)] = "UTC"

    @property
    def span(self) -> Span:
        """The span; raises InvalidRequestError if it is none."""
        start, end = moment_of(self.start, self.zone), moment_of(self.end, self.zone)
        if start is not None and end is not None and start >= end:
            raise InvalidRequestError(f"from must be before to; got {self.start} and {self.end}")
        return Span(start, end)


def moment_of(text: str, zone: str) -> datetime | None:
    """Return the moment that a field of date and time names in a zone, in UTC; None if it was left empty.

    Raises InvalidRequestError if it names no moment.
    """
    if not text:
        return None
    try:
        moment = datetime.fromisoformat(text)
        moment = (moment if moment.tzinfo is not None else moment.replace(tzinfo=ZoneInfo(zone))).astimezone(UTC)
    except (ValueError, OverflowError, OSError, ZoneInfoNotFoundError) as error:
        raise InvalidRequestError(f"expected date and time as in 2026-03-02T06:00; got {text} in {zone}") from error
    if not EARLIEST <= moment < LATEST:
        raise InvalidRequestError(f"expected a moment from {EARLIEST:%Y} to {LATEST:%Y}; got {text}")
    return moment


def _known(known: Annotated[bool, Form()] = False) -> None:
    if not known:
        raise InvalidRequestError(N_("expected a tick that says that it is known to be final; got none"))


#: Of a route whose work cannot be undone: its form has a tick that says so.
FINAL: Final = Depends(_known)


def decimal_point(text: str) -> str:
    """Return a number that was typed with a decimal comma or point as it is read."""
    return text.strip().replace(",", ".")


def number_of(text: str, name: str) -> float | None:
    """Return a number with a decimal point or comma; None if it was left empty.

    Raises InvalidRequestError if it is no number.
    """
    if not text.strip():
        return None
    try:
        return float(decimal_point(text))
    except ValueError as error:
        raise InvalidRequestError(f"{name}: expected a number; got {text[:40]!r}") from error


RangeName = Literal["day", "month", "year", "all"]
_DAY: Final = timedelta(days=1)
_LENGTHS: Final[dict[str, timedelta]] = {"day": _DAY, "month": 31 * _DAY, "year": 366 * _DAY}
NAMES: Final = {"day": N_("day"), "month": N_("month"), "year": N_("year"), "all": N_("all")}
_SHORTEST: Final = timedelta(minutes=2)


class RangeQuery(RequestModel):
    """Which part of the trend, and which measurements are listed: from ``since`` until ``until``, some of them only."""

    range: RangeName | None = None
    start: Moment | None = Field(default=None, alias="from")
    end: Moment | None = Field(default=None, alias="to")
    done: Annotated[str, Field(max_length=40)] = ""
    before: Annotated[str, Field(max_length=200)] | None = None
    only: Literal["", "refused", "in-doubt"] = ""
    since: MomentText = ""
    until: MomentText = ""
    zone: Annotated[str, Field(max_length=60)] = "UTC"

    @property
    def listed(self) -> Span:
        """The span of the measurements that are listed; raises InvalidRequestError if it is none."""
        return Span(moment_of(self.since, self.zone), moment_of(self.until, self.zone))


@dataclass(frozen=True, slots=True)
class ShownRange:
    """The span that is shown, and where its buttons lead."""

    start: datetime
    end: datetime
    name: str | None  # None: it was zoomed to
    buttons: list[tuple[str, str, bool]]  # name, address, whether it is shown now
    moves: list[tuple[str, str, str]]  # mark, name, address: earlier, later, closer, wider


def shown_range(path: str, query: RangeQuery, first: datetime, last: datetime) -> ShownRange:
    """Return the span to show of a trend between its first and last measurement.

    Named ranges end at the last measurement: an axis that was measured years ago shows its last year, not an empty one.
    """
    name: str | None = query.range or "year"
    if query.start is not None and query.end is not None and query.start < query.end:
        name, start, end = None, query.start, query.end
    else:
        end = last
        start = first if name == "all" or name is None else max(first, last - _LENGTHS[name])
    margin = max((end - start) * 0.01, _SHORTEST / 2) if name is not None else timedelta()
    start, end = start - margin, end + margin
    buttons = [(words, f"{path}?range={key}", key == name) for key, words in NAMES.items()]
    return ShownRange(start, end, name, buttons, _moves(path, start, end))


def _moves(path: str, start: datetime, end: datetime) -> list[tuple[str, str, str]]:
    length = end - start
    closer = max(length / 4, _SHORTEST / 2)
    middle = start + length / 2

    def to(begin: datetime, until: datetime) -> str:
        spans = {"from": begin.isoformat(timespec="seconds"), "to": until.isoformat(timespec="seconds")}
        return f"{path}?{urlencode(spans)}"

    return [
        ("‹", N_("earlier"), to(start - length / 2, end - length / 2)),
        ("›", N_("later"), to(start + length / 2, end + length / 2)),
        ("+", N_("closer"), to(middle - closer, middle + closer)),
        ("−", N_("wider"), to(start - length / 2, end + length / 2)),
    ]
