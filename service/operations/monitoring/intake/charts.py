"""Carry the charts of an axis over its measurements in the order of their time, in whatever order they arrive.

The charts are a fold. What is newer than all before goes on from where they stand; what arrives late, or replaces what
was there, folds them again from the last checkpoint before it, so that they stand as if it had come in time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from enum import StrEnum

from sqlalchemy import Connection

from monitor_core.pipeline import AxisState, advance_feature
from monitor_core.preload import Calibration, preload_from_feature
from monitor_core.recording import Conditions
from monitor_core.recordings.elements.units import metres
from monitor_core.trend import DetectorDesign, DetectorState
from monitor_core.uncertainty import Estimate
from service.operations.monitoring.monitor_state import dump_state, load_design, load_state
from service.store.intake import AxisRecord, ChartsRecord
from service.store.trend.checkpoints import add_checkpoint, checkpoint_before, forget_checkpoints
from service.store.trend.points import (
    TrendPoint,
    add_point,
    newest_point,
    point_before,
    points_after,
    remove_point,
    replace_points,
)

#: A checkpoint is kept after so many measurements in the charts ...
CHECKPOINT_EVERY = 50
#: ... and so many of them: what is older than all is too late, because nothing tells how the charts stood before.
MOST_CHECKPOINTS = 25
#: What began so long before the newest measurement is too late, too: its clock is more likely wrong than its way slow.
LATEST = timedelta(days=366)


class Uncharted(StrEnum):
    """Why an accepted measurement moves no chart."""

    PRELOAD_SET = "preload-set"  #: its preload was set on purpose: it tells nothing about wear
    TOO_LATE = "too-late"  #: it was made before what the charts can be folded again from


@dataclass(frozen=True, slots=True)
class Raised:
    """An alarm that the charts raise, and the measurement that it is raised by."""

    point: TrendPoint
    state: AxisState


@dataclass(frozen=True, slots=True)
class Folded:
    """What became of the charts."""

    charts: ChartsRecord
    points: dict[int, TrendPoint]  # those put in, by number of the measurement
    raised: tuple[Raised, ...]  # alarms of what was folded
    again_after: datetime | None  # what began later was folded again; None: nothing was
    again: bool = False


def too_late(charts: ChartsRecord, at: datetime) -> bool:
    """Tell whether a measurement that began at this moment can no longer be put into the charts."""
    newest = charts.last_charted_at
    return (charts.epoch_after is not None and at <= charts.epoch_after) or (
        newest is not None and newest - at > LATEST
    )


def put_in(
    connection: Connection,
    axis: AxisRecord,
    charts: ChartsRecord,
    new: Sequence[TrendPoint],
    *,
    replaced: Sequence[TrendPoint],
    calibration: Calibration | None,
) -> Folded:
    """Store new points, remove those that they replace, and fold the charts as far as they change."""
    for point in replaced:
        remove_point(connection, point)
    aside = {point.measurement_id: _set_aside(connection, point) for point in new if too_late(charts, point.at)}
    for point in aside.values():
        add_point(connection, point)
    put = sorted((point for point in new if point.measurement_id not in aside), key=_in_time)
    touched = [point.at for point in put] + [point.at for point in replaced if not too_late(charts, point.at)]
    if not touched:
        return Folded(charts, aside, (), None)
    again = bool(replaced) or (charts.last_measured_at is not None and min(touched) <= charts.last_measured_at)
    if again:
        fold, old = _again(connection, axis, charts, min(touched))
    else:
        fold, old = _Fold(charts, load_state(charts.monitor_state), None), []
    fold.begin(min(touched))
    known = {point.measurement_id: point for point in old}
    for point in sorted([*old, *put], key=_in_time):
        fold.over(connection, axis, point, calibration)
    changed = [point for point in fold.points if known.get(point.measurement_id, point) != point]
    replace_points(connection, changed)
    for point in fold.points:
        if point.measurement_id not in known:
            add_point(connection, point)
    added = {point.measurement_id: point for point in put}
    after = {point.measurement_id: point for point in fold.points if point.measurement_id in added}
    charts = fold.charts_now()
    if again and (newest := newest_point(connection, axis.number)) is not None:
        charts = replace(charts, last_measurement_id=newest.measurement_id, last_measured_at=newest.at)
    return Folded(charts, aside | after, tuple(fold.raised), fold.begun_after, again)


class _Fold:
    """Charts on their way over measurements."""

    def __init__(self, charts: ChartsRecord, state: AxisState, begun_after: datetime | None) -> None:
        self.begun_after = begun_after
        self.points: list[TrendPoint] = []
        self.raised: list[Raised] = []
        self._charts = charts
        self._state = state
        self._design: DetectorDesign = load_design(charts.detector_design)

    def begin(self, first: datetime) -> None:
        """Note when the first measurement of the epoch was made, as far as is known now."""
        begun = self._charts.epoch_from
        self._charts = replace(self._charts, epoch_from=first if begun is None else min(begun, first))

    def over(
        self, connection: Connection, axis: AxisRecord, point: TrendPoint, calibration: Calibration | None
    ) -> None:
        """Carry the charts over the next measurement; a refused one, or one with its preload set, changes nothing."""
        before = self._state
        charted = point.uncharted is None and point.feature_s2 is not None and calibration is not None
        if charted and calibration is not None:
            self._state = _advanced(before, point, calibration, self._design)
        detector = self._state.detector
        baseline = None
        if detector.baseline is not None and calibration is not None:
            baseline = preload_from_feature(detector.baseline.mean, calibration.coefficients)
        point = replace(point, state=str(detector.status), baseline_preload_n=baseline)
        self.points.append(point)
        if detector.alarm is not None and before.detector.alarm is None:
            self.raised.append(Raised(point, self._state))
        self._charts = replace(
            self._charts, last_measurement_id=point.measurement_id, last_measured_at=point.at,
            since_checkpoint=self._charts.since_checkpoint + charted,
        )  # fmt: skip
        if self._charts.since_checkpoint >= CHECKPOINT_EVERY:
            oldest = add_checkpoint(
                connection, axis.number, self._charts.epoch, point.at, dump_state(self._state), most=MOST_CHECKPOINTS
            )
            self._charts = replace(self._charts, since_checkpoint=0, epoch_after=oldest or self._charts.epoch_after)

    def charts_now(self) -> ChartsRecord:
        """Return the charts after the last measurement."""
        detector = self._state.detector
        return replace(
            self._charts, monitor_state=dump_state(self._state), last_charted_at=detector.last_at,
            state=str(detector.status), state_since=detector.since,
        )  # fmt: skip


def _again(
    connection: Connection, axis: AxisRecord, charts: ChartsRecord, first: datetime
) -> tuple[_Fold, list[TrendPoint]]:
    """Return the charts as they stood before a moment, and what was measured since."""
    found = checkpoint_before(connection, axis.number, charts.epoch, first)
    at, state = charts.epoch_after, AxisState(DetectorState(last_at=charts.epoch_after))
    if found is not None:
        at, document = found
        state = load_state(document)
    forget_checkpoints(connection, axis.number, charts.epoch, at)
    begun = replace(charts, since_checkpoint=0)
    return _Fold(begun, state, at), points_after(connection, axis.number, charts.epoch, at, charts.epoch_from)


def _advanced(state: AxisState, point: TrendPoint, calibration: Calibration, design: DetectorDesign) -> AxisState:
    if point.feature_s2 is None or point.feature_uncertainty_s2 is None:
        return state
    return advance_feature(
        state,
        Estimate(point.feature_s2, point.feature_uncertainty_s2),
        Conditions(metres(point.position_mm), point.payload_kg, point.temperature_c),
        point.at,
        calibration=calibration,
        design=design,
    )


def _set_aside(connection: Connection, point: TrendPoint) -> TrendPoint:
    """Return a point that moves no chart because it is too late, in the state that its axis was in before it."""
    before = point_before(connection, point.axis_number, point.at)
    uncharted = point.uncharted or (None if point.refusal_reason else str(Uncharted.TOO_LATE))
    if before is None:
        return replace(point, uncharted=uncharted)
    return replace(point, uncharted=uncharted, state=before.state, baseline_preload_n=before.baseline_preload_n)


def _in_time(point: TrendPoint) -> tuple[datetime, int]:
    return point.at, point.measurement_id
