"""What an axis did: its history and projection, and single measurements with the evidence behind their value."""

import math
from datetime import datetime
from typing import Annotated

from pydantic import AliasGenerator, BaseModel, BeforeValidator, ConfigDict, Field

from monitor_core.recording import Rejection
from monitor_core.response import FrequencyResponse
from service.api.access import needs
from service.api.axes import MaintenanceOut, StaleOut
from service.api.services import ServicesOf, api_router
from service.documents.history import AlertView, BaselineView, FalseAlarmsView, LineView
from service.documents.measurement import numbers
from service.documents.together import TogetherView
from service.json_types import JsonObject
from service.operations.access.scopes import Scope
from service.operations.fields import AnswerModel, AxisId, RowId
from service.operations.monitoring.evidence import OtherJudgement, evidence_of

router = api_router("trend")


class WindowEntry(AnswerModel):
    """A window of a measurement and whether it was accepted."""

    started_at: datetime
    refusal_reason: str | None
    refusal_detail: str | None
    let_go: Annotated[
        bool,
        BeforeValidator(lambda purge: purge is not None),
        Field(validation_alias="let_go_by", description="its waveform is not stored any more"),
    ]


class GateOut(AnswerModel):
    """What a gate read of a measurement; limits are inclusive, null is open."""

    gate: Annotated[str, Field(description="reason by which it refuses")]
    value: float
    unit: str
    lower: float | None
    upper: float | None
    passed: bool


def _without_unit(name: str) -> str:
    return name.rpartition("_")[0]


class LadderOut(AnswerModel):
    """From a frequency to a preload: 1/f² less what each quantity adds to it is the feature, (k3/feature)³ the preload.

    The shares of the variance are `variance_shares` of the outcome.
    """

    model_config = ConfigDict(alias_generator=AliasGenerator(validation_alias=_without_unit))

    frequency_hz: float
    inverse_square_s2: float
    payload_s2: float
    temperature_s2: float
    quadratic_s2: Annotated[float, Field(description="k1·x²")]
    linear_s2: Annotated[float, Field(description="k2·x")]
    constant_s2: Annotated[float, Field(description="k4")]
    friction_s2: Annotated[float, Field(description="of friction other than the usual")]
    feature_s2: float
    preload_n: float


class MeasurementOut(BaseModel):
    """One measurement: the whole outcome, its windows, and the frequency response in the band."""

    measurement_id: int
    measurement: str
    at: datetime
    status: str
    outcome: JsonObject | None
    windows: list[WindowEntry]
    let_go: Annotated[str | None, Field(description="when and by which rule waveforms of it were let go; null: none")]
    response: JsonObject | None
    gates: Annotated[list[GateOut], Field(description="in their order; empty where no mode was found")]
    ladder: Annotated[LadderOut | None, Field(description="null where there is no preload")]


class ResponseOut(BaseModel):
    """A frequency response on all lines that can be used, real and imaginary part in its unit."""

    quantity: str
    frequency_hz: list[float]
    real: list[float | None]
    imaginary: list[float | None]
    coherence: list[float | None] | None
    n_averages: float


class JudgementOut(BaseModel):
    """What a calibration says of the same windows."""

    calibration: int
    preload_n: float | None
    interval_95_n: tuple[float | None, float | None] | None
    refusal_reason: str | None


class EvidenceOut(BaseModel):
    """What the value of a measurement rests on, computed from its waveforms; null or empty where they were let go."""

    band_hz: Annotated[tuple[float, float] | None, Field(description="where the mode is looked for")]
    response: ResponseOut | None
    baseline_response: Annotated[ResponseOut | None, Field(description="mean of the baseline's at the same place")]
    n_baseline: Annotated[int, Field(description="measurements in that mean")]
    judgements: Annotated[list[JudgementOut], Field(description="by the newest calibrations, those not in force too")]


class HistoryOut(BaseModel):
    """What the sessions of an axis say together; what is measured on a day is one session."""

    axis: str
    baseline: Annotated[
        BaselineView | None, Field(description="what is normal, and what was not seen yet; null while it is learnt")
    ]
    trend_line: Annotated[LineView | None, Field(description="line through the newest sessions, with its slope")]
    false_alarms: Annotated[
        FalseAlarmsView | None,
        Field(description="a year: as stated, and as the history of this axis gives by resampling"),
    ]
    alert: Annotated[
        AlertView | None, Field(description="that stands: how far the preload is off, and what to do; null if none")
    ] = None
    together: Annotated[
        TogetherView | None, Field(description="what several numbers of the axis show together; null: nothing is known")
    ] = None
    stale: Annotated[StaleOut | None, Field(description="while it is judged anew: by which job")] = None
    events: Annotated[list[MaintenanceOut], Field(description="what was done to it, in order of time")] = []


@router.get("/axes/{axis}/history", response_model_exclude_unset=True, dependencies=[needs(Scope.TRENDS_READ)])
def get_history(axis: AxisId, services: ServicesOf) -> HistoryOut:
    """Return what is normal for an axis, where its trend goes, and how often it alarms falsely."""
    history = services.history.of(axis)
    return HistoryOut(
        axis=axis,
        baseline=history.baseline,
        trend_line=history.line,
        false_alarms=history.false_alarms,
        alert=history.alert,
        together=history.together,
        stale=history.stale,
        events=history.events,
    )


@router.get("/axes/{axis}/measurements/{measurement}", dependencies=[needs(Scope.TRENDS_READ)])
def get_measurement(axis: AxisId, measurement: RowId, services: ServicesOf) -> MeasurementOut:
    """Return one measurement with everything its value rests on."""
    view = services.trend.measurement(axis, measurement)
    row, evidence = view.row, evidence_of(services.database, services.waveforms, axis, view)
    return MeasurementOut(
        measurement_id=row.id,
        measurement=row.name,
        at=row.started_at,
        status=row.status,
        outcome=None if view.outcome is None else view.outcome.document(),
        windows=view.windows,
        let_go=None if view.let_go is None else str(view.let_go),
        response=view.response,
        gates=evidence.gates(),
        ladder=evidence.ladder(),
    )


@router.get("/axes/{axis}/measurements/{measurement}/evidence", dependencies=[needs(Scope.TRENDS_READ)])
def get_evidence(axis: AxisId, measurement: RowId, services: ServicesOf) -> EvidenceOut:
    """Return the whole response of a measurement with the baseline's, and what other calibrations say of it."""
    view = services.trend.measurement(axis, measurement)
    evidence = evidence_of(services.database, services.waveforms, axis, view)
    responses = evidence.responses()
    return EvidenceOut(
        band_hz=responses.band,
        response=_response_out(responses.measured),
        baseline_response=_response_out(responses.baseline),
        n_baseline=responses.n_baseline,
        judgements=[judgement_out(judgement) for judgement in evidence.judgements()],
    )


def judgement_out(judgement: OtherJudgement) -> JudgementOut:
    """Return what a calibration says on the wire."""
    estimate, refusal = judgement.outcome.preload, judgement.outcome.refusal
    if estimate is None:
        raise AssertionError("what a calibration says is a preload, or a refusal")
    if isinstance(estimate, Rejection):
        reason = estimate.reason if refusal is None else refusal.reason
        return JudgementOut(
            calibration=judgement.calibration, preload_n=None, interval_95_n=None, refusal_reason=str(reason)
        )
    upper = estimate.interval.upper
    interval = (estimate.interval.lower, upper if math.isfinite(upper) else None)
    return JudgementOut(
        calibration=judgement.calibration, preload_n=estimate.preload, interval_95_n=interval, refusal_reason=None
    )


def _response_out(response: FrequencyResponse | None) -> ResponseOut | None:
    if response is None:
        return None
    return ResponseOut(
        quantity=response.quantity,
        frequency_hz=response.frequency.tolist(),
        real=numbers(response.response.real),
        imaginary=numbers(response.response.imag),
        coherence=None if response.coherence is None else numbers(response.coherence),
        n_averages=response.n_averages,
    )


class ProjectedPointOut(BaseModel):
    """A session as it would be."""

    at: datetime
    preload_n: float
    interval_95_n: tuple[float, float]


class ProjectionOut(BaseModel):
    """Where the preload would go if it went on as it does now, with the 95 % prediction interval of one session."""

    axis: str
    since: datetime | None
    n_sessions: Annotated[int, Field(description="what is measured on a day is one")]
    slope_n_per_day: float | None
    interval_95_n_per_day: tuple[float, float] | None = None
    points: list[ProjectedPointOut]


@router.get("/axes/{axis}/projection", dependencies=[needs(Scope.TRENDS_READ)])
def get_projection(axis: AxisId, services: ServicesOf) -> ProjectionOut:
    """Project the line through the sessions since the last change of level or slope: empty of too few."""
    projected = services.history.of(axis).projected
    if projected is None or (change := projected.line.change_a_day) is None:
        return ProjectionOut(axis=axis, since=None, n_sessions=0, slope_n_per_day=None, points=[])
    slope, half = change
    points = [
        ProjectedPointOut(at=at, preload_n=preload, interval_95_n=(lower, upper))
        for at, preload, lower, upper in zip(
            projected.at, projected.preload_n, projected.lower_n, projected.upper_n, strict=True
        )
    ]
    return ProjectionOut(
        axis=axis,
        since=projected.line.started_at,
        n_sessions=projected.line.n_sessions,
        slope_n_per_day=slope,
        interval_95_n_per_day=(slope - half, slope + half),
        points=points,
    )
