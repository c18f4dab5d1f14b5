"""Judge stored measurements under another calibration, and replace a history by what came of it; compare the two."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from statistics import median

from pydantic import TypeAdapter
from sqlalchemy import Connection
from sqlalchemy.orm import Session

from monitor_core.pipeline import check_window
from monitor_core.preload import Calibration
from monitor_core.recording import Rejection, RejectionReason, Window
from service.clock import now, text_of
from service.documents.history import Comparison, HistoryColumn
from service.documents.measurement import interval_of, measurement_document, response_document
from service.errors import WaveformDamagedError
from service.json_types import JsonObject
from service.operations.monitoring.alarm_changes import settle_alarms
from service.operations.monitoring.axis_configuration import AxisConfiguration, core_settings
from service.operations.monitoring.intake.charts import Uncharted, counted, fold_from
from service.operations.monitoring.intake.epochs import epoch_of_calibration
from service.operations.monitoring.intake.judge import Judged, judge, judged_point, stand
from service.store import alarms, intake, rejudged
from service.store.intake import LONGEST_DETAIL, OPEN, AxisRecord, MeasurementRecord
from service.store.rejudged import StagedRecord, StoredWindow
from service.store.tables import ActivationRow
from service.store.trend.epochs import (
    BEGIN_OF_TIME,
    INSPECTION,
    MAINTENANCE,
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
from service.store.waveforms import WaveformStore

#: Of an axis that alarms more often the first ones are named; how many there are is said anyway.
MOST_NAMED = 50


def column_of(
    connection: Connection, axis: AxisRecord, span: Span, points: Sequence[TrendPoint], state: str
) -> HistoryColumn:
    """Return what the points of a span say, with the alarms that were raised in it."""
    raised = _raised(connection, axis.id, span)
    judged = [
        point
        for point in points
        if point.preload_n is not None and point.set_preload_n is None and point.uncharted != Uncharted.WAVEFORM_GONE
    ]
    intervals = [interval_of(point) for point in judged]
    return HistoryColumn(
        calibration=axis.active_calibration_id,
        state=state,
        n_measurements=len(points),
        n_refused=sum(point.refusal_reason is not None for point in points),
        states=dict(sorted(Counter(point.state for point in points).items())),
        n_alarms=len(raised),
        first_alarm_at=raised[0] if raised else None,
        alarms_at=tuple(raised[:MOST_NAMED]),
        median_preload_n=_median([point.preload_n for point in judged]),
        median_interval_95_n=(
            _median([lower for lower, _ in intervals]),
            _median([upper for _, upper in intervals]),
        ),
    )


def _raised(connection: Connection, axis_id: str, span: Span) -> list[datetime]:
    with Session(connection) as session:
        rows = alarms.raised_after(session, axis_id, 0, None)
    return [row.measured_at for row in rows if span.holds(row.measured_at)]


def _median(values: Sequence[float | None]) -> float | None:
    """Return the median, open ends counted as the largest; None where there is none, or it is open."""
    if not values:
        return None
    middle = median(float("inf") if value is None else value for value in values)
    return middle if middle < float("inf") else None


MEASUREMENT, POINT = TypeAdapter(MeasurementRecord), TypeAdapter(TrendPoint)
#: By the start of a window: for which reason it was refused before, for which now, and the detail of that.
_REFUSALS = TypeAdapter(dict[datetime, tuple[str | None, str | None, str | None]])
#: A window that says it began after it arrived says nothing of when it began, whatever the calibration; one that an
#: older program saw elsewhere stood there.
_KEPT = (str(RejectionReason.CLOCK_AHEAD), str(RejectionReason.POSITION_MISMATCH))


@dataclass(frozen=True, slots=True)
class Anew:
    """What a history is judged by."""

    job_id: str
    axis_number: int
    configuration: AxisConfiguration
    calibration_id: int
    calibration: Calibration


def judged_anew(
    anew: Anew, row: MeasurementRecord, stored: Sequence[StoredWindow], waveforms: WaveformStore
) -> StagedRecord:
    """Return a measurement as it is judged now. Of one that is open only its windows are looked at."""
    if row.id is None:
        raise AssertionError(f"measurement '{row.name}' is stored")
    staged = StagedRecord(anew.job_id, row.id, row.revision)
    windows = _read(waveforms, stored)
    if windows is None:
        return staged
    settings = core_settings(anew.configuration)
    refusals = {window.started_at: check_window(window, settings, anew.calibration) for window in windows}
    accepted = [window for window in windows if refusals[window.started_at] is None]
    judged = replace(row)
    if row.status == OPEN:
        judged.n_accepted = len(accepted)
        return replace(staged, measurement=_dumped(judged), refusals=_changed(stored, refusals))
    outcome = judge(accepted, anew.configuration, anew.calibration)
    stand(Judged(judged, outcome, (), accepted[0] if accepted else None, len(accepted)), anew.calibration_id)
    point = judged_point(anew.axis_number, judged, outcome, 0, anew.calibration)
    return replace(
        staged,
        measurement=_dumped(judged),
        point=POINT.dump_python(point, mode="json"),
        outcome=measurement_document(judged, outcome),
        response=response_document(outcome),
        refusals=_changed(stored, refusals),
    )


def refusals_of(staged: StagedRecord) -> dict[datetime, tuple[str | None, Rejection | None]]:
    """Return the windows that are refused otherwise now, by their start: for which reason before, and why now."""
    return {
        start: (reason_before, None if reason is None else Rejection(RejectionReason(reason), detail or ""))
        for start, (reason_before, reason, detail) in _REFUSALS.validate_python(staged.refusals or {}).items()
    }


def _read(waveforms: WaveformStore, stored: Sequence[StoredWindow]) -> list[Window] | None:
    """Return the windows that can be looked at, in time order; None if one is gone that the value rests on."""
    wanted = [window for window in stored if window.refusal_reason not in _KEPT]
    try:
        return waveforms.read([window.place for window in wanted])
    except WaveformDamagedError:
        windows: list[Window] = []
    for window in wanted:
        try:
            windows += waveforms.read([window.place])
        except WaveformDamagedError:
            if window.refusal_reason is None:
                return None
    return windows


def _dumped(row: MeasurementRecord) -> JsonObject:
    document: JsonObject = MEASUREMENT.dump_python(row, mode="json")
    return document


def _changed(stored: Sequence[StoredWindow], refusals: dict[datetime, Rejection | None]) -> JsonObject:
    changed: JsonObject = {}
    for window in stored:
        if window.started_at not in refusals:
            continue
        refusal = refusals[window.started_at]
        reason, detail = (None, None) if refusal is None else (str(refusal.reason), refusal.detail[:LONGEST_DETAIL])
        if (reason, detail) != (window.refusal_reason, window.refusal_detail):
            changed[text_of(window.started_at)] = [window.refusal_reason, reason, detail]
    return changed


def swap(connection: Connection, anew: Anew, axis: AxisRecord, span: Span, reason: str, *, dry_run: bool) -> Comparison:
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
    new = column_of(connection, axis, span, new_points, charts.state)
    same_alarms = (old.n_alarms, old.alarms_at) == (new.n_alarms, new.alarms_at)
    return Comparison(dry_run, same_alarms, n_gone, old, new)


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
    save_epoch(connection, epoch_of_calibration(connection, axis, begin))


def _note_activation(connection: Connection, axis_id: str, calibration_id: int, reason: str) -> None:
    with Session(connection) as session:
        session.add(ActivationRow(axis_id=axis_id, calibration_id=calibration_id, activated_at=now(), reason=reason))
        session.commit()  # hands it to the connection
