"""``/v1/retention``: how long waveforms are kept, and the purge of the rest; pins of measurements and spans."""

from datetime import datetime
from typing import Annotated, Literal, Self

from fastapi import Query, Response
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from service.api.access import CallerOf, needs
from service.api.jobs import JobOut, started
from service.api.services import ServicesOf, api_router
from service.operations import retention
from service.operations.access.scopes import Scope
from service.operations.fields import AnswerModel, AxisId, Moment, RequestModel, RowId, Text, exactly_one_of
from service.operations.retention import Reason, Rule, Survey, Why
from service.store.trend.points import Span

router = api_router("retention")


class RuleOut(BaseModel):
    """How long raw waveforms are kept; what was found in them is kept for ever."""

    keep_raw_days: Annotated[int | None, Field(description="null: for ever")]
    keep_before_alarm_days: float
    keep_after_alarm_days: float
    lets_go_before: Annotated[datetime | None, Field(description="what arrived before is let go, unless it is kept")]
    sentence: str


class ShareOut(AnswerModel):
    """So many windows, and the bytes that they take on the disk."""

    windows: Annotated[int, Field(validation_alias="n_windows")]
    bytes: Annotated[int, Field(validation_alias="n_bytes")]


class KeptOut(ShareOut):
    """What is kept for one reason; a window that has several counts under the first, in the order of this list."""

    why: Why


class PurgeOut(AnswerModel):
    """A purge and what came of it; `ended_at` is null while it is at work, and if it was broken off."""

    id: int
    begun_at: datetime
    ended_at: datetime | None
    keep_raw_days: int
    windows: Annotated[int, Field(validation_alias="n_windows")]
    freed_bytes: int


class PaceOut(AnswerModel):
    """What an axis stores: counted over so many days, and what a year brings at this pace (1 GB = 1e9 bytes).

    Within its first day nothing is said of a year.
    """

    axis: Annotated[str, Field(validation_alias="axis_id")]
    days: float
    bytes: Annotated[int, Field(validation_alias="n_bytes")]
    gb_per_year: float | None


class RetentionOut(BaseModel):
    """What is stored in all, what of it is kept and why, what a purge would let go, and what a year brings."""

    at: datetime
    rule: RuleOut
    files: int
    bytes: int
    kept: list[KeptOut]
    to_let_go: ShareOut
    unnamed_bytes: Annotated[int, Field(description="of old files that no window names, as a crash may leave them")]
    let_go_windows: Annotated[int, Field(description="whose waveforms purges have let go; their values stay")]
    purges: Annotated[list[PurgeOut], Field(description="the newest ones, newest first")]
    gb_per_year: Annotated[float, Field(description="of all axes together")]
    axes: list[PaceOut]


def retention_out(survey: Survey) -> RetentionOut:
    """Return a survey on the wire."""
    rule = survey.rule
    return RetentionOut(
        at=survey.at,
        rule=RuleOut(
            keep_raw_days=rule.keep_raw_days,
            keep_before_alarm_days=rule.before_alarm.days,
            keep_after_alarm_days=rule.after_alarm.days,
            lets_go_before=survey.lets_go_before,
            sentence=_sentence(rule),
        ),
        files=survey.n_files,
        bytes=survey.n_bytes,
        kept=[KeptOut(why=why, windows=share.n_windows, bytes=share.n_bytes) for why, share in survey.kept.items()],
        to_let_go=survey.to_let_go,
        unnamed_bytes=survey.unnamed_bytes,
        let_go_windows=survey.n_let_go,
        purges=survey.purges,
        gb_per_year=sum(pace.gb_per_year or 0.0 for pace in survey.paces),
        axes=survey.paces,
    )


def _sentence(rule: Rule) -> str:
    if rule.keep_raw_days is None:
        return "every waveform is kept for ever (PRELOAD_KEEP_RAW_DAYS is not set)"
    return (
        f"waveforms are let go {rule.keep_raw_days} days after the day on which they arrived, except those of "
        f"calibrations, pinned ones, and those from {rule.before_alarm.days} days before the onset of an alarm to "
        f"{rule.after_alarm.days} days after it was raised"
    )


class PinIn(RequestModel):
    """What is kept of an axis, and why: one measurement, or all that began in a span."""

    model_config = ConfigDict(
        json_schema_extra={
            "oneOf": exactly_one_of("measurement", "from"),
            "examples": [
                {"measurement": 17, "reason": "reference after the new nut"},
                {"from": "2026-03-01T00:00:00Z", "to": "2026-04-01T00:00:00Z", "reason": "acceptance test"},
            ],
        }
    )

    measurement: Annotated[int, Field(ge=1, lt=2**63)] | None = Field(default=None, description="its number")
    start: Moment | None = Field(default=None, alias="from", description="inclusive; with `to`")
    end: Moment | None = Field(default=None, alias="to", description="exclusive")
    reason: Text

    @model_validator(mode="after")
    def _one_or_a_span(self) -> Self:
        members = {"measurement": self.measurement, "from": self.start, "to": self.end}
        given = [name for name, value in members.items() if value is not None]
        if given not in (["measurement"], ["from", "to"]):
            raise ValueError(f"either measurement or both from and to are expected; got {', '.join(given) or 'none'}")
        if self.start is not None and self.end is not None and self.start >= self.end:
            raise ValueError(f"from must be before to; got {self.start.isoformat()} and {self.end.isoformat()}")
        return self


class PinOut(AnswerModel):
    """A pin: of a measurement, or of the measurements of an axis that began in a span."""

    id: int
    axis: Annotated[str, Field(validation_alias="axis_id")]
    kind: Annotated[
        Literal["measurement", "span"],
        BeforeValidator(lambda number: "span" if number is None else "measurement"),
        Field(validation_alias="measurement_id"),
    ]
    measurement_id: int | None
    start: datetime | None = Field(validation_alias="start_at", serialization_alias="from")
    end: datetime | None = Field(validation_alias="end_at", serialization_alias="to")
    reason: str
    who: str
    at: datetime


class PinsOut(BaseModel):
    """Pins, newest first; `next_cursor` fetches older ones."""

    pins: list[PinOut]
    next_cursor: int | None


class PinsQuery(RequestModel):
    """Which pins of an axis."""

    cursor: Annotated[int, Field(ge=1, lt=2**63)] | None = Field(default=None, description="next_cursor of a page")
    limit: Annotated[int, Field(ge=1, le=1000)] = 100


@router.get("/retention", dependencies=[needs(Scope.TRENDS_READ)])
def get_retention(services: ServicesOf) -> RetentionOut:
    """Return the rule, what is kept and why, what a purge would free, and what a year brings.

    All that is stored is counted; the answer may be a minute old, as its `at` says.
    """
    return retention_out(services.surveys.newest())


@router.post("/retention/purges", status_code=202, dependencies=[needs(Scope.ADMIN)])
def start_purge(who: CallerOf, response: Response, services: ServicesOf) -> JobOut:
    """Let go now what the rule does not keep, as a job; one that is not done yet is answered with again."""
    return started(services.purges.begin(who.name), response)


@router.get("/axes/{axis}/pins", dependencies=[needs(Scope.TRENDS_READ)])
def list_pins(axis: AxisId, query: Annotated[PinsQuery, Query()], services: ServicesOf) -> PinsOut:
    """List what is pinned of an axis, newest first."""
    rows = retention.list_pins(services.database, axis, query.cursor, query.limit)
    return PinsOut(pins=rows, next_cursor=rows[-1].id if len(rows) == query.limit else None)


@router.post("/axes/{axis}/pins", status_code=201, dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def pin(axis: AxisId, body: PinIn, who: CallerOf, services: ServicesOf) -> PinOut:
    """Keep waveforms whatever their age: of a measurement, or of all that began in a span, those to come included.

    A measurement that is pinned already is kept for the new reason.
    """
    what = Span(body.start, body.end) if body.measurement is None else body.measurement
    why = Reason(body.reason, who.name)
    return PinOut.model_validate(retention.pin(services.database, axis, what, why))


@router.delete("/axes/{axis}/pins/{pin}", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def remove_pin(axis: AxisId, pin: RowId, services: ServicesOf) -> PinOut:
    """Let the rule decide again about what a pin kept."""
    return PinOut.model_validate(retention.remove_pin(services.database, axis, pin))
