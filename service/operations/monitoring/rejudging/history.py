"""Replace a history by one that was judged anew, all of it in the transaction that is open."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

from sqlalchemy import Connection
from sqlalchemy.orm import Session

from monitor_core.pipeline import AxisState
from monitor_core.trend import DetectorState
from service.clock import now
from service.operations.monitoring.alarm_changes import settle_alarms
from service.operations.monitoring.intake.chart_state import dump_state
from service.operations.monitoring.intake.charts import Uncharted, fold_from
from service.operations.monitoring.intake.judge import counted
from service.operations.monitoring.rejudging.comparison import Column, column_of
from service.operations.monitoring.rejudging.measurement import MEASUREMENT, POINT, Anew, refusals_of
from service.operations.monitoring.sisters import prior_of_sisters
from service.store import intake, rejudged
from service.store.axes import get_axis
from service.store.intake import OPEN, AxisRecord
from service.store.rejudged import StagedRecord
from service.store.tables import ActivationRow
from service.store.trend.epochs import (
    BEGIN_OF_TIME,
    CALIBRATION,
    INSPECTION,
    MAINTENANCE,
    EpochRecord,
    epochs_of,
    forget_epoch,
    save_epoch,
)
from service.store.trend.points import (
    TOO_LATE,
    Span,
    TrendPoint,
    add_point,
    count_uncharted,
    points_within,
    remove_point,
)
from service.store.trend.rollups import sum_up


@dataclass(frozen=True, slots=True)
class Swapped:
    """How an axis stood and stands now, side by side."""

    old: Column
    new: Column
    n_gone: int  # measurements that stand as they were judged before


def swap(connection: Connection, anew: Anew, axis: AxisRecord, span: Span, reason: str) -> Swapped:
    """Let everything that was kept aside stand: values, trend, charts, alarms, counts, and the calibration in force.

    Epochs that an inspection or maintenance began begin where they did; before the span everything stays as it is.
    """
    before = intake.read_charts(connection, axis)
    old_points = points_within(connection, axis.number, span)
    old = column_of(connection, axis, span, old_points, before.state)
    points, less, more, n_gone = _stored(connection, anew, old_points)
    for point in old_points:
        remove_point(connection, point)
    for point in points:
        # not of the epoch it will be in, but of none before that: the fold says which
        add_point(connection, point if point.uncharted == TOO_LATE else replace(point, epoch=before.epoch + 1))
    if axis.active_calibration_id != anew.calibration_id:
        rejudged.put_in_force(connection, axis.id, anew.calibration_id)
        _note_activation(connection, axis.id, anew.calibration_id, reason)
    axis = replace(axis, active_calibration_id=anew.calibration_id)
    begin = span.start or BEGIN_OF_TIME
    _begin_epochs(connection, axis, begin)
    folded = fold_from(connection, axis, before, begin, anew.calibration)
    settle_alarms(connection, axis, folded, f"calibration {anew.calibration_id}, by which the history was judged anew,")
    sum_up(connection, axis.number, {point.at for point in (*old_points, *points)})
    charts = replace(
        folded.charts,
        refused_windows=counted(before.refused_windows, more, less),
        uncharted=counted({}, Counter(count_uncharted(connection, axis.number))),
    )
    intake.save_charts(connection, axis, before, charts)
    new_points = points_within(connection, axis.number, span)
    return Swapped(old, column_of(connection, axis, span, new_points, charts.state), n_gone)


def _stored(
    connection: Connection, anew: Anew, old_points: Sequence[TrendPoint]
) -> tuple[list[TrendPoint], Counter[str], Counter[str], int]:
    """Store measurements as judged anew; return their points, the refusals of windows before and now, and the gone."""
    old = {point.measurement_id: point for point in old_points}
    points, less, more, n_gone = list[TrendPoint](), Counter[str](), Counter[str](), 0
    for staged in rejudged.staged(connection, anew.job_id):
        if staged.measurement is None:
            n_gone += 1
            points += [_as_it_was(old[staged.measurement_id])] if staged.measurement_id in old else []
            continue
        point = _stored_one(connection, staged)
        points += [] if point is None else [point]
        for before, refusal in refusals_of(staged).values():
            less.update([] if before is None else [before])
            more.update([] if refusal is None else [str(refusal.reason)])
    return points, less, more, n_gone


def _stored_one(connection: Connection, staged: StagedRecord) -> TrendPoint | None:
    row = MEASUREMENT.validate_python(staged.measurement)
    intake.save_measurement(connection, row, judged_at=None if row.status == OPEN else now())
    changed = {start: refusal for start, (_, refusal) in refusals_of(staged).items()}
    intake.refuse_windows(connection, staged.measurement_id, changed)
    if staged.point is None or staged.outcome is None:
        return None
    intake.save_document(connection, staged.measurement_id, staged.outcome, staged.response)
    return POINT.validate_python(staged.point)


def _as_it_was(point: TrendPoint) -> TrendPoint:
    """Return a point whose waveform is gone: another calibration's feature is not for these charts."""
    if point.refusal_reason is not None or point.uncharted is not None:
        return point
    return replace(point, uncharted=str(Uncharted.WAVEFORM_GONE))


def _begin_epochs(connection: Connection, axis: AxisRecord, begin: datetime) -> None:
    """Let the calibration begin an epoch, and those of inspections and maintenance after it be entered anew."""
    for epoch in epochs_of(connection, axis.number):
        if epoch.begins_at < begin:
            continue
        forget_epoch(connection, epoch)
        if epoch.begun_by in (INSPECTION, MAINTENANCE):
            save_epoch(connection, replace(epoch, epoch=None, state=None))
    with Session(connection) as session:
        prior = prior_of_sisters(session, get_axis(session, axis.id))
    state = dump_state(AxisState(DetectorState(prior=prior)))
    began = EpochRecord(axis.number, begin, CALIBRATION, calibration_id=axis.active_calibration_id, state=state)
    save_epoch(connection, began)


def _note_activation(connection: Connection, axis_id: str, calibration_id: int, reason: str) -> None:
    with Session(connection) as session:
        session.add(ActivationRow(axis_id=axis_id, calibration_id=calibration_id, activated_at=now(), reason=reason))
        session.commit()  # hands it to the connection
