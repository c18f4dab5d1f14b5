"""Carry the charts of an axis over its measurements in the order of their time, in whatever order they arrive.

The charts are a fold. What is newer than all before goes on from where they stand; what arrives late, or replaces what
was there, folds them again from the last checkpoint before it, so that they stand as if it had come in time.

The state of an axis as it is kept between measurements: the core's records, as JSON.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from enum import StrEnum

from pydantic import TypeAdapter
from sqlalchemy import Connection

from monitor_core.pipeline import AxisState, advance_feature
from monitor_core.preload import Calibration, preload_from_feature
from monitor_core.recording import Conditions
from monitor_core.recordings.elements.units import metres
from monitor_core.trend import DetectorDesign, DetectorState, TrendStatus, reset, state_at
from monitor_core.uncertainty import Estimate
from service.documents.stored import StoredRecord
from service.json_types import JsonObject
from service.store.intake import AxisRecord, ChartsRecord
from service.store.tables import AxisRow
from service.store.trend.points import (
    TrendPoint,
    add_checkpoint,
    add_point,
    checkpoint_before,
    forget_checkpoints,
    newest_point,
    point_before,
    points_after,
    remove_point,
    replace_points,
)

_STATE = StoredRecord(
    "state of the charts",
    TypeAdapter(AxisState),
    version=1,
    remedy="restore the backup, or activate another calibration, which begins a new baseline",
)
_DESIGN = StoredRecord(
    "limits of the charts",
    TypeAdapter(DetectorDesign),
    version=1,
    remedy="restore the backup, or send the configuration of the axis again, which solves new ones",
)


def load_state(document: JsonObject | None) -> AxisState:
    """Return the stored state, or that of an axis nothing is known about.

    Raises DocumentDamagedError, here and below, if what is stored cannot be read.
    """
    return AxisState() if document is None else _STATE.load(document)


def dump_state(state: AxisState) -> JsonObject:
    """Return the state as a JSON document."""
    return _STATE.dump(state)


def load_design(document: JsonObject) -> DetectorDesign:
    """Return the stored limits of the charts."""
    return _DESIGN.load(document)


def dump_design(design: DetectorDesign) -> JsonObject:
    """Return the limits of the charts as a JSON document."""
    return _DESIGN.dump(design)


def begin_epoch(axis: AxisRow) -> None:
    """Begin a new baseline: the charts watch another number now, or somebody inspected the axis and found it in order.

    A person decides that, never the detector. What was measured until now moves no chart any more.
    """
    state = AxisState(reset(DetectorState(last_at=axis.last_charted_at)))
    axis.epoch += 1
    axis.epoch_after, axis.epoch_from = axis.last_charted_at, None
    axis.since_checkpoint = 0
    axis.monitor_state = dump_state(state)
    axis.state, axis.state_since = str(state.detector.status), None


def state_now(axis: AxisRow, at: datetime, silent_after_hours: float) -> tuple[str, datetime | None]:
    """Tell how an axis stands now, and since when; silence is ``unknown``."""
    status, silence = TrendStatus(axis.state), timedelta(hours=silent_after_hours)
    state = state_at(DetectorState(status=status, last_at=axis.last_charted_at), at, silence)
    if state is not status and axis.last_charted_at is not None:
        return str(state), axis.last_charted_at + silence
    return str(state), axis.state_since if state is not TrendStatus.UNKNOWN else axis.last_charted_at


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
