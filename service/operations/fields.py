"""What several wire models and routes share: moments, numbers, texts, identifiers, and constraints between members."""

import re
from datetime import UTC, datetime
from typing import Annotated

from fastapi import Path
from pydantic import (
    AfterValidator,
    AliasChoices,
    AliasGenerator,
    AliasPath,
    AllowInfNan,
    AwareDatetime,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    JsonValue,
    Strict,
)

#: No control characters: PostgreSQL stores no NUL, and a name with a line break is a slip.
Label = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$")]
Text = Annotated[str, Field(min_length=1, max_length=1000, pattern=r"^[^\x00]+$")]

AxisName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
AxisId = Annotated[
    str, Path(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$", description="letters, digits, dot, dash, underscore")
]
RowId = Annotated[int, Path(ge=1, lt=2**63)]
JobId = Annotated[str, Path(pattern=r"^[0-9a-f-]{36}$")]


class RequestModel(BaseModel):
    """Base of everything that a client sends: unknown members are refused, and nothing is changed afterwards."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class AnswerModel(BaseModel):
    """Base of what is answered as it is stored: it is read from the attributes of a row or a record."""

    model_config = ConfigDict(from_attributes=True, populate_by_name=True)  # by name: programs read answers with it


class ViewModel(AnswerModel):
    """Base of what is answered of a view: read from an attribute of its own, or else of its row."""

    model_config = ConfigDict(
        alias_generator=AliasGenerator(validation_alias=lambda name: AliasChoices(name, AliasPath("row", name)))
    )


_RFC3339 = re.compile(r"\d{4}-\d\d-\d\d[Tt ]\d\d:\d\d:\d\d(\.\d+)?([Zz]|[+-]\d\d:\d\d)", re.ASCII)
#: Moments that every database and every conversion of zones can take, and that are no slip of the keyboard.
EARLIEST, LATEST = datetime(1970, 1, 1, tzinfo=UTC), datetime(2200, 1, 1, tzinfo=UTC)


def exactly_one_of(*names: str) -> list[JsonValue]:
    """State in a JSON schema that one of several members is given and the others are not, or are null."""
    return [{"required": [name], "properties": {name: {"not": {"type": "null"}}}} for name in names]


Number = Annotated[float, Strict(), AllowInfNan(False)]

#: What a number of a kind can be, wherever it is sent: searches rest on it. No machine is near either end.
HERTZ = Field(ge=1e-3, le=1e6)  # slower: a window is over before one swing; faster: no accelerometer follows
SCATTER_HZ = Field(ge=1e-9, le=1e6)  # a clock does not tell frequencies nearer to each other than this
NEWTONS = Field(ge=1e-3, le=1e7)  # less than the weight of a screw's grease; more than the screw of a press bears
KILOGRAMS = Field(ge=1e-3, le=1e6)  # a screw of a few grams; the table of the largest portal
MILLIMETRES = Field(ge=-100_000, le=100_000)  # 100 m to either side
LENGTH_MM = Field(ge=1e-3, le=1e5)  # an encoder sees no less
SECONDS = Field(ge=1e-3, le=1e7)  # four months
HOURS = Field(ge=1e-3, le=1e7)  # longer than any machine stands

Frequency = Annotated[Number, HERTZ]
ScatterHz = Annotated[Number, SCATTER_HZ]
JointLimit = Annotated[Number, Field(ge=1e-12, le=1e15)]  # from a damping ratio to a stiffness [SI]
Mass = Annotated[Number, KILOGRAMS]
MassUncertainty = Annotated[Number, Field(ge=1e-6, le=1e6)]  # a scale for tables tells no milligram
Place = Annotated[Number, MILLIMETRES]
#: What is said of a window, however it is sent.
SampleRate = Frequency
Position = Annotated[Place, Field(description="from the fixed bearing")]
PositionSpan = Annotated[Number, Field(ge=0, le=100_000, description="travel during the window")]
Payload = Annotated[Number, Field(ge=0, le=1e6)]
Temperature = Annotated[Number, Field(gt=-273.15, le=1000)]
SetPreload = Annotated[Number, NEWTONS]
Resolution = Annotated[Number, Field(gt=0, le=1.0)]  # of picometres; a metre is a rack with a tooth each
#: A window may hold so many samples: 41 s at 25.6 kHz. What is computed of one takes several times its room.
MOST_SAMPLES = 2**20


def _rfc3339(value: object) -> object:
    if isinstance(value, datetime) or (isinstance(value, str) and _RFC3339.fullmatch(value)):
        return value
    raise ValueError(f"expected date, time and zone as in 2026-03-02T06:00:00Z (RFC 3339); got {str(value)[:50]!r}")


def _within_range(value: datetime) -> datetime:
    if not EARLIEST <= value < LATEST:
        raise ValueError(f"expected a moment from {EARLIEST:%Y} to {LATEST:%Y}; got {value.isoformat()}")
    return value.astimezone(UTC)


#: RFC 3339 with a zone; a bare number is not taken for a Unix time.
Moment = Annotated[AwareDatetime, AfterValidator(_within_range), BeforeValidator(_rfc3339)]


class StatedOfWindow(RequestModel):
    """What is said of a window besides its samples, within the bounds that hold for each one, however it is sent."""

    started_at: Moment
    measurement: Annotated[Label, Field(description="windows that share it are averaged")]
    sample_rate_hz: SampleRate
    position_mm: Position
    position_span_mm: PositionSpan
    payload_kg: Payload | None = None
    temperature_c: Temperature | None = None
    preload_n: SetPreload | None = Field(
        default=None, description="only where it was set on purpose, as in a calibration"
    )
