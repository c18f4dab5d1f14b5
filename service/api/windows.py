"""``POST /v1/axes/{axis}/windows``: windows in, outcomes out."""

from asyncio import wrap_future
from collections import Counter
from collections.abc import Mapping
from datetime import datetime
from functools import partial
from typing import Annotated, Literal, Self, TypeVar

from fastapi import Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError, model_validator
from pydantic.config import JsonDict

from monitor_core.recording import (
    Conditions,
    Direction,
    ExcitationQuantity,
    ExcitationSource,
    ResponseQuantity,
    Window,
)
from monitor_core.recordings.elements.units import metres
from monitor_core.recordings.session_hdf5 import EXCITATION_UNIT, RESPONSE_UNIT
from service.api.access import needs
from service.api.http.body import JSON_TYPE, MOST_WINDOWS, MSGPACK_TYPE, parse_body
from service.api.http.samples import Samples
from service.api.services import Services, api_router, services_of
from service.json_types import JsonObject
from service.operations.access.scopes import Scope
from service.operations.fields import AnswerModel, AxisId, RequestModel, Resolution, StatedOfWindow
from service.operations.monitoring.intake.batch import IngestReceipt, WindowStatus

router = api_router("windows", reads_bodies=True)

#: To hand a shorter body over to a thread, and take the windows back, costs more than to read it.
READ_AT_ONCE = 256 * 1024

Quantity = TypeVar("Quantity", ExcitationQuantity, ResponseQuantity)


def _unit_of_quantity(channel: str, units: Mapping[Quantity, str], usual: Quantity) -> JsonDict:
    """State in a JSON schema which unit goes with each quantity of a channel; ``usual``: where none is stated."""
    name = f"{channel}_quantity"
    schema: JsonDict = {"properties": {f"{channel}_unit": {"const": units[usual]}}}
    for quantity, unit in units.items():
        if quantity != usual:
            schema = {
                "if": {"properties": {name: {"const": str(quantity)}}, "required": [name]},
                "then": {"properties": {f"{channel}_unit": {"const": unit}}},
                "else": schema,
            }
    return schema


class WindowIn(StatedOfWindow):
    """One window, as an acquisition system sends it. Names and units are those of the session file."""

    model_config = ConfigDict(
        json_schema_extra={
            "allOf": [
                _unit_of_quantity("excitation", EXCITATION_UNIT, ExcitationQuantity.TORQUE),
                _unit_of_quantity("response", RESPONSE_UNIT, ResponseQuantity.ACCELERATION),
            ]
        }
    )

    excitation: Samples
    response: Samples
    excitation_quantity: Literal["torque", "force", "current", "acceleration"] = "torque"
    excitation_unit: Literal["N.m", "N", "A", "m/s2"]
    excitation_source: Literal["sensor", "drive", "commanded"]
    response_quantity: Literal[
        "acceleration", "velocity", "displacement", "motor-angle", "motor-speed", "relative-displacement"
    ] = "acceleration"
    response_unit: Literal["m/s2", "m/s", "m", "rad/s", "rad"]
    response_resolution: Resolution | None = Field(
        default=None, description="step that the response is quantised in, in its unit"
    )
    position_trace_m: Samples | None = None
    reference: Samples | None = Field(
        default=None,
        description="what the control was told from outside of its loop, such as the set-point of the position; "
        "any unit; of source drive only",
    )
    direction: Literal["+", "-", "both"] = "both"

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        for channel, quantity, unit, expected in (
            ("excitation", self.excitation_quantity, self.excitation_unit,
             EXCITATION_UNIT[ExcitationQuantity(self.excitation_quantity)]),
            ("response", self.response_quantity, self.response_unit,
             RESPONSE_UNIT[ResponseQuantity(self.response_quantity)]),
        ):  # fmt: skip
            if unit != expected:
                raise ValueError(f"{channel}_unit of a {quantity} must be {expected}; got {unit}")
        if not self.excitation.size:
            raise ValueError("excitation must hold at least one sample; got none")
        for name in ("response", "position_trace_m", "reference"):
            samples = getattr(self, name)
            if samples is not None and samples.size != self.excitation.size:
                raise ValueError(
                    f"{name} must have as many samples as excitation ({self.excitation.size}); got {samples.size}"
                )
        return self

    def to_core(self) -> Window:
        """Return the core's record, in SI units."""
        return Window(
            excitation=self.excitation,
            response=self.response,
            sample_rate=self.sample_rate_hz,
            started_at=self.started_at,
            conditions=Conditions(metres(self.position_mm), self.payload_kg, self.temperature_c, self.preload_n),
            measurement=self.measurement,
            excitation_quantity=ExcitationQuantity(self.excitation_quantity),
            excitation_source=ExcitationSource(self.excitation_source),
            direction=Direction(self.direction),
            position_span=metres(self.position_span_mm),
            position_trace=self.position_trace_m,
            reference=self.reference,
            response_quantity=ResponseQuantity(self.response_quantity),
            response_resolution=self.response_resolution,
        )


class WindowsIn(RequestModel):
    """Several windows in one request."""

    windows: Annotated[list[WindowIn], Field(min_length=1, max_length=MOST_WINDOWS)]
    complete: Annotated[bool, Strict()] = Field(
        default=False, description="these windows complete their measurements: judge them now, do not wait for more"
    )


class WindowOut(AnswerModel):
    """What became of one window."""

    started_at: datetime
    measurement: str
    status: Literal["accepted", "refused", "already-there"]
    reason: str | None = None
    detail: str | None = None


class WindowsOut(BaseModel):
    """What became of the windows, and of the measurements that were judged with them."""

    accepted: int
    refused: int
    already_there: int
    windows: list[WindowOut]
    measurements: Annotated[
        list[JsonObject],
        Field(description="outcomes of the measurements judged with these windows, now or when they were first sent"),
    ]


_EXAMPLE = {
    "started_at": "2026-03-02T06:00:00.000000Z",
    "measurement": "2026-03-02-early-shift",
    "sample_rate_hz": 1024.0,
    "position_mm": 500.0,
    "position_span_mm": 2.0,
    "excitation_unit": "N.m",
    "excitation_source": "sensor",
    "response_unit": "m/s2",
    "payload_kg": 0.0,
    "temperature_c": 21.5,
    "excitation": [0.01, 0.42, 0.87],
    "response": [0.2, 3.1, -1.7],
}
_REQUEST = {
    "requestBody": {
        "required": True,
        "content": {
            JSON_TYPE: {
                "schema": {
                    "oneOf": [{"$ref": "#/components/schemas/WindowIn"}, {"$ref": "#/components/schemas/WindowsIn"}]
                },
                "examples": {
                    "one window": {"value": _EXAMPLE},
                    "a whole measurement": {"value": {"windows": [_EXAMPLE], "complete": True}},
                },
            },
            MSGPACK_TYPE: {"schema": {"description": "the same members; samples as bytes of little-endian float32"}},
        },
    }
}


def _posted(document: object) -> WindowsIn:
    try:
        if isinstance(document, dict) and "windows" in document:
            return WindowsIn.model_validate(document)
        return WindowsIn(windows=[WindowIn.model_validate(document)])
    except ValidationError as error:
        raise RequestValidationError(error.errors(include_url=False, include_context=False)) from error


@router.post(
    "/axes/{axis}/windows",
    responses={
        200: {"model": WindowsOut, "description": "everything was there already"},
        201: {"model": WindowsOut, "description": "something new was stored"},
    },
    openapi_extra=_REQUEST,
    dependencies=[needs(Scope.WINDOWS_WRITE)],
)
async def post_windows(axis: AxisId, request: Request) -> Response:
    """Store one window or a whole measurement, judge what is complete, and say what came of it.

    Windows are on disk before this answers. The same window posted again is `already-there`; a different window with
    the same `started_at` is refused with 409, and then nothing of the request is stored.
    """
    services = await services_of(request)
    windows, complete = await _posted_by(request, services)
    answer = _answer(await wrap_future(services.ingest.submit(axis, windows, complete=complete)))
    # A response of our own: FastAPI would validate what is valid, in yet another thread.
    status = 200 if answer.already_there == len(answer.windows) else 201
    return Response(answer.model_dump_json(), status, media_type=JSON_TYPE)


async def _posted_by(request: Request, services: Services) -> tuple[list[Window], bool]:
    """Read what was sent. Nothing of the body is kept after that, as request.body() would."""
    body = b"".join([part async for part in request.stream() if part])
    content_type = request.headers.get("content-type")
    if len(body) <= READ_AT_ONCE:
        return _read(body, content_type)
    # one thread reads bodies and one takes windows, whoever sends them: more would only wait for each other
    return await services.ingest.read_by(partial(_read, body, content_type))


def _read(body: bytes, content_type: str | None) -> tuple[list[Window], bool]:
    posted = _posted(parse_body(body, content_type))
    return [window.to_core() for window in posted.windows], posted.complete


def _answer(receipt: IngestReceipt) -> WindowsOut:
    counts = Counter(item.status for item in receipt.windows)
    return WindowsOut(
        accepted=counts[WindowStatus.ACCEPTED],
        refused=counts[WindowStatus.REFUSED],
        already_there=counts[WindowStatus.ALREADY_THERE],
        windows=receipt.windows,
        measurements=[measured.document() for measured in receipt.measurements],
    )
