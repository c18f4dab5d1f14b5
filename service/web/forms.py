"""Read what forms of pages send: moments in the zone of the visitor, and numbers as people write them."""

from datetime import UTC, datetime
from typing import Annotated
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from pydantic import BaseModel, Field

from service.errors import InvalidRequestError
from service.operations.fields import EARLIEST, LATEST
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


def number_of(text: str, name: str) -> float | None:
    """Return a number with a decimal point or comma; None if it was left empty.

    Raises InvalidRequestError if it is no number.
    """
    if not text.strip():
        return None
    try:
        return float(text.strip().replace(",", "."))
    except ValueError as error:
        raise InvalidRequestError(f"{name}: expected a number; got {text[:40]!r}") from error
