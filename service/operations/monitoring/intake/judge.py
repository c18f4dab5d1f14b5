"""A complete measurement is judged: the core's outcome, and the rows that it leads to."""

import logging
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

from sqlalchemy import Connection

from monitor_core.axis_state import inverse_square
from monitor_core.modal import ModalMeasurement
from monitor_core.pipeline import MeasurementOutcome, judge_measurement
from monitor_core.preload import Calibration, PreloadEstimate, place_reading
from monitor_core.recording import Rejection, RejectionReason, Window
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.trend import TrendStatus
from service.clock import now
from service.documents.measurement import finite_or_null, measurement_document, response_document
from service.documents.stored_measurement import StoredMeasurement
from service.json_types import JsonObject
from service.operations.monitoring.alarm_changes import settle_alarms
from service.operations.monitoring.axis_configuration import AxisConfiguration, core_settings
from service.operations.monitoring.intake.charts import Uncharted, counted, put_in, reasons_of
from service.store import intake
from service.store.intake import JUDGED, REFUSED, AxisRecord, MeasurementRecord
from service.store.trend.points import TrendPoint, point_of
from service.store.trend.rollups import sum_up

_ROUNDING = 1e-6  # of positions [m]

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Judged:
    """What came of a measurement that is complete."""

    measurement: MeasurementRecord
    outcome: MeasurementOutcome
    was: Sequence[tuple[datetime, int]] = ()  # starts and numbers of what was judged before and this replaces
    first: Window | None = None  # of its accepted windows
    n_accepted: int = 0


@dataclass(frozen=True, slots=True)
class Settled:
    """What is said about measurements, and under which names it is counted."""

    measurements: dict[int, StoredMeasurement]  # by number
    outcomes: tuple[str, ...]
    uncharted: tuple[str, ...]
    new_alarms: tuple[str, ...]  # their kinds
    alarmed: bool  # whether an alarm of the axis stands in the charts


def judge(
    windows: list[Window] | Rejection, configuration: AxisConfiguration, calibration: Calibration | None
) -> MeasurementOutcome:
    """Return the core's outcome for the accepted windows of a measurement, or for the reason why they cannot be had."""
    settings = core_settings(configuration)
    if isinstance(windows, Rejection):
        return _refused(windows)
    if not windows:
        return _refused(
            Rejection(
                RejectionReason.TOO_FEW_AVERAGES,
                f"at least {settings.mode.minimum_averages} accepted windows are needed; got none",
            )
        )
    try:
        return judge_measurement(windows, settings, calibration)
    except Exception as error:  # one measurement that breaks the core must not block all that follow on its axis
        log.exception("judging '%s' failed", windows[0].measurement)
        return _refused(Rejection(RejectionReason.FIT_FAILED, f"the computation failed: {error}"))


def settle(
    connection: Connection,
    axis: AxisRecord,
    judged: Sequence[Judged],
    calibration: Calibration | None,
    *,
    refused_windows: Counter[str],
) -> Settled | None:
    """Write what was judged, the charts that follow from it, their alarms, and the counts of the axis.

    None: nothing of this changes, as with most windows, and nothing of it is read.
    """
    if not judged and not any(refused_windows.values()):
        return None
    before = intake.read_charts(connection, axis)
    documents: dict[int, JsonObject] = {}
    new: list[TrendPoint] = []
    replaced: list[TrendPoint] = []
    for item in judged:
        row = item.measurement
        old = [point_of(connection, axis.number, *point) for point in item.was]
        replaced += [point for point in old if point is not None]
        _save(connection, axis, item)
        point = judged_point(axis.number, row, item.outcome, before.epoch, calibration)
        documents[point.measurement_id] = document = measurement_document(row, item.outcome)
        intake.save_document(connection, point.measurement_id, document, response_document(item.outcome))
        new.append(point)
    folded = put_in(connection, axis, before, new, replaced=replaced, calibration=calibration)
    sum_up(connection, axis.number, {point.at for point in (*new, *replaced)})
    new_alarms: tuple[str, ...] = ()
    if folded.raised or folded.again:
        new_alarms = settle_alarms(connection, axis, folded)
    after = replace(
        folded.charts,
        refused_windows=counted(before.refused_windows, refused_windows),
        uncharted=counted(folded.charts.uncharted, reasons_of(folded.points.values()), reasons_of(replaced)),
    )
    if judged or after != before:
        intake.save_charts(connection, axis, before, after)
    return Settled(
        {number: StoredMeasurement.of(documents[number], point) for number, point in folded.points.items()},
        tuple(point.refusal_reason or JUDGED for point in folded.points.values()),
        tuple(reasons_of(folded.points.values()).elements()),
        new_alarms,
        folded.alarmed,
    )


def _save(connection: Connection, axis: AxisRecord, item: Judged) -> None:
    stand(item, axis.active_calibration_id)
    intake.save_measurement(connection, item.measurement, judged_at=now())


def stand(item: Judged, calibration_id: int | None) -> None:
    """Let a measurement stand as judged: it began with its first accepted window, where and as that was measured."""
    row = item.measurement
    row.status = JUDGED if item.outcome.refusal is None else REFUSED
    row.calibration_id = calibration_id
    row.n_accepted, row.closes_at = item.n_accepted, None
    if item.first is not None:
        row.started_at = item.first.started_at
        position, modal = item.first.conditions.position, item.outcome.modal
        # where its traces say, should a tag contradict them; a mean of equal tags is one but for rounding
        if isinstance(modal, ModalMeasurement) and abs(modal.conditions.position - position) > _ROUNDING:
            position = modal.conditions.position
        row.position_mm = to_millimetres(position)
        row.set_preload_n = item.first.conditions.preload


def judged_point(
    axis_number: int,
    row: MeasurementRecord,
    outcome: MeasurementOutcome,
    epoch: int,
    calibration: Calibration | None,
) -> TrendPoint:
    """Return a measurement as a point of the trend, whose state the charts have still to say."""
    modal = outcome.modal if isinstance(outcome.modal, ModalMeasurement) else None
    estimate = outcome.preload if isinstance(outcome.preload, PreloadEstimate) else None
    friction = None if isinstance(outcome.friction, Rejection) else outcome.friction
    drag = None if friction is None or isinstance(friction.drag, Rejection) else friction.drag.drag
    refusal = outcome.refusal
    doubts = outcome.doubts if outcome.preload is None else () if estimate is None else estimate.doubts
    return TrendPoint(
        axis_number=axis_number,
        at=row.started_at,
        measurement_id=_number(row),
        name=row.name,
        position_mm=row.position_mm,
        set_preload_n=row.set_preload_n,
        payload_kg=None if modal is None else modal.conditions.payload_mass,
        temperature_c=None if modal is None else modal.conditions.temperature,
        refusal_reason=None if refusal is None else str(refusal.reason),
        calibration_id=row.calibration_id,
        frequency_hz=None if modal is None else finite_or_null(modal.mode.frequency.value),
        frequency_uncertainty_hz=None if modal is None else finite_or_null(modal.mode.frequency.standard_uncertainty),
        preload_n=None if estimate is None else finite_or_null(estimate.preload),
        interval_lower_n=None if estimate is None else finite_or_null(estimate.interval.lower),
        interval_upper_n=None if estimate is None else finite_or_null(estimate.interval.upper),
        drag_torque_nm=None if drag is None else finite_or_null(drag.value),
        friction_torque_nm=None if friction is None else finite_or_null(friction.torque.value),
        feature_s2=None if estimate is None else estimate.feature.value,
        feature_uncertainty_s2=_own_uncertainty(outcome),
        epoch=epoch,
        uncharted=str(Uncharted.PRELOAD_SET) if refusal is None and row.set_preload_n is not None else None,
        state=str(TrendStatus.UNKNOWN),
        baseline_preload_n=None,
        doubt=str(doubts[0].reason) if doubts else None,
        shown_scatter_s2=None if estimate is None else estimate.feature_scatter,
        damping_ratio=None if modal is None else finite_or_null(modal.mode.damping_ratio.value),
        residue=None if modal is None else finite_or_null(abs(modal.mode.residue)),
        place_uncertainty=_place_uncertainty(modal, estimate, calibration),
    )


def _own_uncertainty(outcome: MeasurementOutcome) -> float | None:
    """Return what is new in each measurement of what the charts watch: the feature, or 1/f² without a calibration."""
    if isinstance(outcome.preload, PreloadEstimate):
        return outcome.preload.feature_own_uncertainty
    if isinstance(outcome.modal, Rejection) or outcome.preload is not None:
        return None
    own = inverse_square(outcome.modal.mode.frequency, outcome.modal.random_uncertainty)
    return finite_or_null(own.standard_uncertainty)


def _place_uncertainty(
    modal: ModalMeasurement | None, estimate: PreloadEstimate | None, calibration: Calibration | None
) -> float | None:
    """Return what the preload of a measurement is compared by with other places of its session, relative [-]."""
    if modal is None or estimate is None or calibration is None:
        return None
    reading = place_reading(modal.conditions, estimate, calibration)
    return finite_or_null(reading.standard_uncertainty)


def _number(row: MeasurementRecord) -> int:
    if row.id is None:
        raise AssertionError(f"measurement '{row.name}' is stored before it is judged")
    return row.id


def _refused(rejection: Rejection) -> MeasurementOutcome:
    return MeasurementOutcome(rejection, rejection, rejection)
