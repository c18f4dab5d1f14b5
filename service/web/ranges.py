"""Which part of the trend a page shows: a day, a month, a year, all of it, or any span that was zoomed to."""

from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Annotated, Final, Literal
from urllib.parse import urlencode

from pydantic import Field

from service.documents.said import N_
from service.operations.fields import Moment, RequestModel
from service.store.trend.points import Span
from service.web.forms import MomentText, moment_of

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
