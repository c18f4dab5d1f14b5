"""``/v1/axes/{axis}/calibrations``: fit or bring one, review it, activate it, see what was in force when."""

from datetime import datetime
from typing import Annotated, Literal, Self

from fastapi import Request, Response
from pydantic import BaseModel, ConfigDict, Field, model_validator

from monitor_core.preload import ModalReading
from monitor_core.recording import Conditions
from monitor_core.recordings.elements.units import metres
from service.api.access import needs
from service.api.jobs import JobOut, started
from service.api.services import ServicesOf, api_router
from service.json_types import JsonObject
from service.operations.access.scopes import Scope
from service.operations.analysis_job import MeasurementRange
from service.operations.fields import (
    AnswerModel,
    AxisId,
    Frequency,
    Payload,
    Place,
    RequestModel,
    RowId,
    ScatterHz,
    SetPreload,
    Temperature,
    Text,
    exactly_one_of,
)
from service.operations.monitoring.calibrations import CalibrationOverview
from service.operations.monitoring.rejudgements import RejudgementIn
from service.store.tables import CalibrationRow

router = api_router("calibrations")


class ReadingIn(RequestModel):
    """One row of a modal table."""

    position_mm: Place
    preload_n: SetPreload
    frequency_hz: Frequency
    frequency_std_hz: ScatterHz | None = None
    n_readings: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    payload_kg: Payload | None = None
    temperature_c: Temperature | None = None

    def to_core(self) -> ModalReading:
        """Return the core's record, in SI units."""
        return ModalReading(
            frequency=self.frequency_hz,
            conditions=Conditions(metres(self.position_mm), self.payload_kg, self.temperature_c, self.preload_n),
            frequency_std=self.frequency_std_hz,
            n_readings=self.n_readings,
        )


class CalibrationIn(RequestModel):
    """Where a calibration comes from: stored measurements, a modal table, or the file of `preload calibrate`."""

    model_config = ConfigDict(
        json_schema_extra={
            "oneOf": exactly_one_of("measurements", "readings", "document"),
            "examples": [{"measurements": {}, "comment": "new nut, guided calibration"}],
        }
    )

    measurements: MeasurementRange | None = None
    readings: Annotated[list[ReadingIn] | None, Field(min_length=1, max_length=10_000)] = None
    document: JsonObject | None = Field(default=None, description="the JSON that `preload calibrate` wrote")
    prior: JsonObject | None = Field(
        default=None, description="a calibration document whose k1…k4 were known before: fewer measurements will do"
    )
    weighting: Literal["std", "none"] | None = Field(
        default=None, description="std where every reading states its scatter, else none"
    )
    comment: Annotated[str, Field(max_length=1000, pattern=r"^[^\x00]*$")] = ""

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        given = [name for name in ("measurements", "readings", "document") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(
                f"exactly one of measurements, readings and document is expected; got {', '.join(given) or 'none'}"
            )
        return self


class CalibrationOut(BaseModel):
    """A stored calibration; `document` is the file format of `preload calibrate`."""

    id: int
    axis: str
    created_at: datetime
    comment: str
    active: bool
    document: JsonObject


class ActivationOut(AnswerModel):
    """Which calibration came into force when, and why."""

    calibration: Annotated[int, Field(validation_alias="calibration_id")]
    activated_at: datetime
    reason: str


class CalibrationsOut(BaseModel):
    """The calibrations of an axis and the history of their activation, newest first."""

    calibrations: list[CalibrationOut]
    history: list[ActivationOut]


class ActivationIn(RequestModel):
    """Why the calibration is put in force."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"reason": "reviewed"}]})

    reason: Text


def calibration_out(row: CalibrationRow, active: int | None) -> CalibrationOut:
    """Return a calibration on the wire."""
    return CalibrationOut(
        id=row.id,
        axis=row.axis_id,
        created_at=row.created_at,
        comment=row.comment,
        active=row.id == active,
        document=row.document,
    )


def calibrations_out(overview: CalibrationOverview) -> CalibrationsOut:
    """Return all calibrations of an axis on the wire."""
    return CalibrationsOut(
        calibrations=[calibration_out(row, overview.active) for row in overview.calibrations],
        history=overview.activations,
    )


@router.post("/axes/{axis}/calibrations", status_code=201, dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def post_calibration(axis: AxisId, body: CalibrationIn, response: Response, services: ServicesOf) -> CalibrationOut:
    """Fit k1…k4 (or take them from a file) and store them for review. Nothing is in force before it is activated."""
    if body.document is not None:
        row = services.calibrations.bring(axis, body.document, body.comment)
    elif body.readings is not None:
        readings = [reading.to_core() for reading in body.readings]
        row = services.calibrations.fit_readings(axis, readings, body.weighting, body.comment, prior=body.prior)
    else:
        span = body.measurements or MeasurementRange()
        fit = services.calibrations.fit_measurements
        row = fit(axis, (span.start, span.end), body.weighting, body.comment, prior=body.prior)
    response.headers["Location"] = f"/v1/axes/{axis}/calibrations/{row.id}"
    return calibration_out(row, None)


@router.get("/axes/{axis}/calibrations", dependencies=[needs(Scope.TRENDS_READ)])
def list_calibrations(axis: AxisId, services: ServicesOf) -> CalibrationsOut:
    """List the calibrations of an axis and which was in force since when."""
    return calibrations_out(services.calibrations.overview(axis))


@router.get("/axes/{axis}/calibrations/{calibration}", dependencies=[needs(Scope.TRENDS_READ)])
def get_calibration(axis: AxisId, calibration: RowId, services: ServicesOf) -> CalibrationOut:
    """Return one calibration."""
    row, active = services.calibrations.get(axis, calibration)
    return calibration_out(row, active)


@router.post("/axes/{axis}/calibrations/{calibration}/activate", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def activate_calibration(
    axis: AxisId, calibration: RowId, body: ActivationIn, request: Request, services: ServicesOf
) -> CalibrationsOut:
    """Put a calibration in force. It starts a new baseline; `If-Match: "<id>"` guards against a change in between.

    Where the axis was watched without a calibration, a job judges that history by it: alarms stay the same ones.
    """
    anew = RejudgementIn(calibration=calibration, reason=body.reason)
    services.calibrations.activate(
        axis,
        calibration,
        body.reason,
        expected_active=request.headers.get("if-match"),
        judge_history=lambda session: services.rejudgements.enter(session, axis, anew),
    )
    services.rejudgements.wake()
    return calibrations_out(services.calibrations.overview(axis))


@router.post("/axes/{axis}/rejudgements", status_code=202, dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def start_rejudgement(
    axis: AxisId, body: RejudgementIn, request: Request, response: Response, services: ServicesOf
) -> JobOut:
    """Judge the history of an axis anew under a calibration, which is in force then; `dry_run` only compares.

    The result of the job holds both histories side by side: states, alarms and their first date, median preload and
    interval. `If-Match: "<id>"` guards against another calibration in force than was thought.
    """
    return started(services.rejudgements.start(axis, body, if_match=request.headers.get("if-match")), response)
