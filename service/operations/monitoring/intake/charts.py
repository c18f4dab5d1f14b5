"""Carry the charts of an axis over its measurements in the order of their time, in whatever order they arrive.

The charts are a fold. What is newer than all before goes on from where they stand; what arrives late, or replaces what
was there, folds them again from the last checkpoint before it, so that they stand as if it had come in time. On the way
they enter the epochs that a person began: another calibration, an inspection, a new nut or screw.
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from enum import StrEnum

from sqlalchemy import Connection
from sqlalchemy.orm import Session

from monitor_core.axis_state import (
    AxisState,
    ChartedFeature,
    advance_feature,
    charts_see,
    expected_frequency,
    inverse_square,
    scatter_with_history,
)
from monitor_core.preload import Calibration, DriveLaw, PlaceReading, friction_amplification, preload_from_feature
from monitor_core.recording import Conditions
from monitor_core.recordings.elements.units import metres
from monitor_core.trend import ClosedSession, DetectorDesign, closed_session
from monitor_core.uncertainty import Estimate
from service.operations.monitoring.axis_configuration import drive_law, load_configuration
from service.operations.monitoring.intake.chart_state import (
    begun,
    dump_state,
    load_design,
    load_state,
    session_record,
)
from service.store import alarms
from service.store.axes import lubrications_of, was_lubricated
from service.store.calibrations import CalibrationsInForce
from service.store.intake import AxisRecord, ChartsRecord
from service.store.tables import CountsByReason
from service.store.trend.epochs import (
    BEGIN_OF_TIME,
    CALIBRATION,
    UNKNOWN,
    EpochRecord,
    add_checkpoint,
    checkpoint_before,
    epochs_of,
    forget_checkpoints,
    forget_checkpoints_beyond,
    save_epoch,
)
from service.store.trend.points import (
    TOO_LATE,
    Span,
    TrendPoint,
    add_point,
    first_of_epoch,
    newest_point,
    point_before,
    points_after,
    remove_point,
    replace_points,
    say_places,
)
from service.store.trend.sessions import (
    UNCALIBRATED,
    SessionRecord,
    add_sessions,
    forget_sessions,
    forget_sessions_beyond,
)

#: A checkpoint is kept after so many measurements in the charts ...
CHECKPOINT_EVERY = 50
#: ... and so many of them: what is older than all is too late, because nothing tells how the charts stood before.
MOST_CHECKPOINTS = 25
#: What began so long before the newest measurement is too late, too: its clock is more likely wrong than its way slow.
LATEST = timedelta(days=366)
_NEXT = timedelta(microseconds=1)


class Uncharted(StrEnum):
    """Why an accepted measurement moves no chart."""

    PRELOAD_SET = "preload-set"  #: its preload was set on purpose: it tells nothing about wear
    TOO_LATE = TOO_LATE  #: it was made before what the charts can be folded again from
    WAVEFORM_GONE = "waveform-gone"  #: its waveform is not there, so that it stands as another calibration judged it
    NOT_COMPARABLE = "not-comparable"  #: without a calibration nothing tells what its place, payload or temperature do


@dataclass(frozen=True, slots=True)
class Raised:
    """An alarm that the charts raise, the measurement that it is raised by, and the calibration that it rests on.

    Several numbers together often see first what the preload's own chart sees later: that is one alarm, which goes on
    as one of the preload, since people act on one cause once.
    """

    point: TrendPoint
    state: AxisState
    calibration: Calibration | None  # None: on the frequency alone
    kind: str = alarms.PRELOAD_LOSS
    goes_on: bool = False  # of the preload, from one of several numbers that still stands


@dataclass(frozen=True, slots=True)
class Folded:
    """What became of the charts."""

    charts: ChartsRecord
    points: dict[int, TrendPoint]  # those put in, by number of the measurement
    raised: tuple[Raised, ...]  # alarms of what was folded
    again_after: datetime | None  # what began later was folded again; None: nothing was
    again: bool = False
    since_epoch: int = 0  # the first that was folded
    alarmed: bool = False  # whether an alarm of either chart stands
    watched: frozenset[int] = frozenset()  # epochs with a calibration, or frequencies: only these can raise alarms
    entered: tuple[tuple[datetime, int], ...] = ()  # when later ones begin, and their numbers, in order of time


def too_late(charts: ChartsRecord, at: datetime) -> bool:
    """Tell whether a measurement that began at this moment can no longer be put into the charts."""
    newest = charts.last_charted_at
    return (charts.epoch_after is not None and at <= charts.epoch_after) or (
        newest is not None and newest - at > LATEST
    )


def remember_law(axis: AxisRecord, charts: ChartsRecord, since: datetime) -> None:
    """Compute what a drive model says of the law, before a write: charts that are folded from here may learn theirs."""
    folded_again = charts.last_measured_at is not None and since <= charts.last_measured_at
    if folded_again or load_state(charts.monitor_state).learns_law:
        _law_of(axis)


def _law_of(axis: AxisRecord) -> DriveLaw | None:
    configuration = load_configuration(axis.configuration)
    return drive_law(configuration.drive_model, configuration.excitation_source)


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
    fold = _Fold(connection, axis, charts, calibration)
    again = bool(replaced) or (charts.last_measured_at is not None and min(touched) <= charts.last_measured_at)
    of_before = charts.epoch_begins_at is not None and min(touched) < charts.epoch_begins_at
    if again or of_before:
        fold.go_back(min(touched), since=None if of_before else charts.epoch_from or min(touched))
    folded = fold.over(put)
    return replace(folded, points=aside | folded.points)


def fold_from(
    connection: Connection, axis: AxisRecord, charts: ChartsRecord, first: datetime, calibration: Calibration | None,
    *, keep_points: bool = False,
) -> Folded:  # fmt: skip
    """Fold the charts over everything that was measured since a moment, through the epochs that begin since then.

    ``keep_points``: the points of the trend go on saying what they said when they were measured.
    """
    fold = _Fold(connection, axis, charts, calibration)
    fold.go_back(first)
    return fold.over([], keep_points=keep_points)


def enter_epoch(
    connection: Connection, axis: AxisRecord, charts: ChartsRecord, epoch: EpochRecord, calibration: Calibration | None
) -> Folded:
    """Store an epoch, and fold the charts from where it begins."""
    save_epoch(connection, epoch)
    newest = charts.last_charted_at if epoch.is_hard else charts.last_measured_at
    later = [moment for moment in (charts.epoch_begins_at, newest) if moment is not None and moment >= epoch.begins_at]
    if later:
        return fold_from(connection, axis, charts, epoch.begins_at, calibration)
    fold = _Fold(connection, axis, charts, calibration)
    fold.enter(epoch)
    return fold.over([])


class _Fold:
    """Charts on their way over measurements."""

    def __init__(
        self, connection: Connection, axis: AxisRecord, charts: ChartsRecord, calibration: Calibration | None
    ) -> None:
        self._connection, self._axis, self._calibration = connection, axis, calibration
        self._calibration_id = axis.active_calibration_id
        self._charts = charts
        self._since_epoch = charts.epoch
        self._state = load_state(charts.monitor_state)
        self._design: DetectorDesign = load_design(charts.detector_design)
        self._old: list[TrendPoint] = []  # that are folded again
        self._again = False
        self._begun_after: datetime | None = None
        self._ahead: list[EpochRecord] = []  # epochs that are still to be entered, in order of time
        self._entered: list[tuple[datetime, int]] = []
        self._watched: set[int] = set()
        self._raised: list[Raised] = []
        self._sessions: list[SessionRecord] = []
        self._session_of: dict[int, datetime | None] = {}  # when it began, by measurement; None: it moved no chart
        self._places: dict[datetime, str | None] = {}  # how those of a session contradict each other, in words
        self._lubricated = lubrications_of(connection, axis.id)

    def go_back(self, first: datetime, *, since: datetime | None = None) -> None:
        """Return to the charts as they stood before a moment: what was measured since is to be folded again.

        Where it lies before the first epoch that is known, they return to where that begins. ``since``: the epoch holds
        nothing older, so that no more of the history is read.
        """
        connection, number = self._connection, self._axis.number
        epochs = epochs_of(connection, number)
        known = [i for i, epoch in enumerate(epochs) if epoch.epoch is not None]
        is_first_known = not known or epochs[known[0]].epoch == 1
        before = [i for i in known if epochs[i].begins_at <= first]
        current = before[-1] if before else None if is_first_known else known[0]
        self._ahead = epochs if current is None else epochs[current + 1 :]
        newest, limit = self._charts.epoch, self._charts.epoch_after
        epoch = None if current is None else epochs[current]
        self._return_to(epoch, first)
        together = self._state.joint.alarm
        # as far as there are checkpoints to before it was raised: it may be what is left of one that the preload has
        if together is not None and (limit is None or together.onset > limit) and self._has_gone_on():
            self._return_to(epoch, together.onset)
        self._forget_since(self._begun_after, newest)
        self._old = points_after(connection, number, self._charts.epoch, self._begun_after, since)
        self._again = True

    def enter(self, epoch: EpochRecord) -> None:
        """Begin an epoch: what was learnt before it holds no more, or its level does not."""
        before = self._state.detector
        self._state = begun(epoch, self._state)
        over = closed_session(before, self._state.detector)
        if epoch.begun_by in (CALIBRATION, UNKNOWN):
            self._take_calibration(epoch.calibration_id)
        else:
            self._end_session(over)
        number = self._charts.epoch + 1
        save_epoch(
            self._connection,
            replace(epoch, epoch=number, state=dump_state(self._state), calibration_id=self._calibration_id),
        )
        self._entered.append((epoch.begins_at, number))
        self._charts = replace(
            self._charts, epoch=number, epoch_from=None, since_checkpoint=0, epoch_begins_at=epoch.begins_at,
            epoch_after=self._limit(epoch, self._charts.epoch_after),
        )  # fmt: skip
        self._note_calibration()

    def over(self, put: Sequence[TrendPoint], *, keep_points: bool = False) -> Folded:
        """Carry the charts over new points, and over those to be folded again; store what became of them."""
        folded_before = {point.measurement_id: point for point in self._old}
        self._places = _said_of(self._state)
        going_on = dict(self._places)
        stepped = [self._step(point) for point in sorted([*self._old, *put], key=_in_time)]
        for epoch in self._ahead:
            self.enter(epoch)
        if keep_points:
            points = [replace(folded_before[point.measurement_id], epoch=point.epoch) for point in stepped]
        else:
            points = self._with_places(stepped, going_on)
        replace_points(self._connection, [p for p in points if folded_before.get(p.measurement_id, p) != p])
        for point in points:
            if point.measurement_id not in folded_before:
                add_point(self._connection, point)
        add_sessions(self._connection, self._sessions)
        added = {point.measurement_id for point in put}
        after = {point.measurement_id: point for point in points if point.measurement_id in added}
        again = [point for point in points if point.measurement_id in folded_before]
        charts = self._charts_now()
        charts = replace(charts, uncharted=counted(charts.uncharted, reasons_of(again), reasons_of(self._old)))
        return Folded(
            charts, after, tuple(self._raised), self._begun_after, self._again, self._since_epoch,
            alarmed=self._state.detector.alarm is not None or self._state.joint.alarm is not None,
            watched=frozenset(self._watched), entered=tuple(self._entered),
        )  # fmt: skip

    def _return_to(self, epoch: EpochRecord | None, first: datetime) -> None:
        """Stand in an epoch as the charts did at its last checkpoint before a moment, or where it begins."""
        connection, number = self._connection, self._axis.number
        counted = 0 if epoch is None or epoch.epoch is None else epoch.epoch
        checkpoint = checkpoint_before(connection, number, counted, first)
        if checkpoint is not None:
            self._begun_after, self._state = checkpoint[0], load_state(checkpoint[1])
        else:
            self._begun_after = None if epoch is None else epoch.begins_at - _NEXT
            self._state = load_state(None if epoch is None else epoch.state)
        limit, begun_at = self._charts.epoch_after, None if epoch is None else epoch.begins_at
        if limit is not None and first <= limit:  # it was reached later, or somebody said what was done before it
            limit = None if epoch is None else self._limit(epoch, None)
        epoch_from = self._charts.epoch_from
        if counted != self._charts.epoch:
            epoch_from = None if begun_at is None else first_of_epoch(connection, number, counted, begun_at)
        self._take_calibration(None if epoch is None else epoch.calibration_id)
        self._since_epoch = counted
        self._charts = replace(
            self._charts, epoch=counted, epoch_begins_at=begun_at, since_checkpoint=0, epoch_after=limit,
            epoch_from=epoch_from,
        )  # fmt: skip
        self._note_calibration()

    def _has_gone_on(self) -> bool:
        """Tell whether later in the epoch the preload's own chart went on with the alarm of several numbers."""
        if self._state.detector.alarm is not None:
            return False
        with Session(self._connection) as session:
            later = alarms.raised_after(session, self._axis.id, self._charts.epoch, self._begun_after)
            return any(row.kind == alarms.PRELOAD_LOSS and row.epoch == self._charts.epoch for row in later)

    def _forget_since(self, at: datetime | None, newest_epoch: int) -> None:
        """Forget the checkpoints after a moment, and the sessions from the one on that goes on there."""
        connection, number, epoch = self._connection, self._axis.number, self._charts.epoch
        going_on = self._state.detector.session
        since = at if going_on is None else going_on.started_at
        forget_sessions(connection, number, self._calibration_id or UNCALIBRATED, epoch, since)
        forget_checkpoints(connection, number, epoch, at)
        if newest_epoch > epoch:
            forget_sessions_beyond(connection, number, epoch)
            forget_checkpoints_beyond(connection, number, epoch)

    def _take_calibration(self, calibration_id: int | None) -> None:
        if calibration_id != self._calibration_id:
            calibration = CalibrationsInForce().numbered(self._connection, self._axis.id, calibration_id)
            self._calibration_id, self._calibration = calibration_id, calibration

    def _note_calibration(self) -> None:
        if self._calibration is not None:
            self._watched.add(self._charts.epoch)

    @staticmethod
    def _limit(epoch: EpochRecord, before: datetime | None) -> datetime | None:
        """Return until when what was measured moves no chart any more, once an epoch is entered."""
        if not epoch.is_hard:
            return before
        return epoch.begins_at - _NEXT if epoch.begins_at > BEGIN_OF_TIME else None

    def _step(self, point: TrendPoint) -> TrendPoint:
        """Carry the charts over the next measurement; a refused one, or one with its preload set, changes nothing."""
        while self._ahead and self._ahead[0].begins_at <= point.at:
            self.enter(self._ahead.pop(0))
        before, calibration = self._state, self._calibration
        self._session_of[point.measurement_id] = None
        point = _comparable(before, point, calibration)
        charted = point.uncharted is None and _feature_of(point, calibration) is not None
        if charted:
            lubricated = was_lubricated(self._lubricated, before.detector.last_at, point.at)
            if calibration is None and before.learns_law:
                before = replace(before, drive=_law_of(self._axis))
            self._state = _advanced(before, point, calibration, self._design, lubricated=lubricated)
            self._session_of[point.measurement_id] = self._state.places_since
            self._watched.add(self._charts.epoch)
            self._places |= _said_of(self._state)
        detector, healthy, learnt = self._state.detector, before.detector.baseline, None
        if calibration is not None and point.shown_scatter_s2 is not None:
            learnt = _learnt_scatter(before, point, point.shown_scatter_s2, calibration)
        elif healthy is not None and _feature_of(point, calibration) is not None:
            learnt = healthy.scatter
        baseline, expected = None, None
        if detector.baseline is not None and calibration is not None:
            baseline = preload_from_feature(detector.baseline.mean, calibration.coefficients)
        elif charted or point.uncharted == Uncharted.NOT_COMPARABLE:
            expected = expected_frequency(before, _conditions(point))
        point = replace(
            point,
            epoch=self._charts.epoch,
            state=str(detector.status),
            baseline_preload_n=baseline,
            expected_frequency_hz=None if expected is None else expected.value,
            expected_frequency_uncertainty_hz=None if expected is None else expected.standard_uncertainty,
            # what was learnt before: a measurement does not judge itself
            learnt_scatter_s2=learnt,
        )
        if detector.alarm is not None and before.detector.alarm is None:
            self._raise(Raised(point, self._state, calibration, goes_on=before.joint.alarm is not None))
        elif self._state.joint.alarm is not None and before.joint.alarm is None and detector.alarm is None:
            self._raise(Raised(point, self._state, calibration, alarms.SEVERAL_NUMBERS))
        self._keep_session(before)
        self._charts = replace(
            self._charts, last_measurement_id=point.measurement_id, last_measured_at=point.at,
            since_checkpoint=self._charts.since_checkpoint + charted,
            epoch_from=point.at if self._charts.epoch_from is None else min(self._charts.epoch_from, point.at),
        )  # fmt: skip
        if self._charts.since_checkpoint >= CHECKPOINT_EVERY:
            self._keep_checkpoint(point.at)
        return point

    def _raise(self, alarm: Raised) -> None:
        last = self._raised[-1] if self._raised and self._raised[-1].point.epoch == alarm.point.epoch else None
        if alarm.goes_on and last is not None:
            if last.kind == alarms.SEVERAL_NUMBERS:
                self._raised.pop()
            alarm = replace(alarm, goes_on=False)
        self._raised.append(alarm)

    def _with_places(self, points: Sequence[TrendPoint], begun: Mapping[datetime, str | None]) -> list[TrendPoint]:
        """Say of each point how the places of its session disagree, and of those that it had when the fold began."""
        for since, words in begun.items():
            if points and (self._again or words != self._places[since]):
                span = Span(since, min(point.at for point in points))
                say_places(self._connection, self._axis.number, self._since_epoch, span, self._places[since])
        return [
            replace(point, places_disagree=None if since is None else self._places[since])
            for point in points
            for since in (self._session_of[point.measurement_id],)
        ]

    def _keep_session(self, before: AxisState) -> None:
        self._end_session(closed_session(before.detector, self._state.detector))

    def _end_session(self, over: ClosedSession | None) -> None:
        if over is not None:
            self._sessions.append(session_record(self._axis.number, self._calibration_id, self._charts.epoch, over))

    def _keep_checkpoint(self, at: datetime) -> None:
        state = dump_state(self._state)
        oldest = add_checkpoint(
            self._connection, self._axis.number, self._charts.epoch, at, state, most=MOST_CHECKPOINTS
        )
        self._charts = replace(self._charts, since_checkpoint=0, epoch_after=oldest or self._charts.epoch_after)

    def _charts_now(self) -> ChartsRecord:
        """Return the charts after the last measurement, of all that the axis has."""
        detector = self._state.detector
        charts = replace(
            self._charts, monitor_state=dump_state(self._state), last_charted_at=detector.last_at,
            state=str(detector.status), state_since=detector.since,
        )  # fmt: skip
        newest = newest_point(self._connection, self._axis.number) if self._again else None
        if newest is None:
            return charts
        return replace(charts, last_measurement_id=newest.measurement_id, last_measured_at=newest.at)


def _learnt_scatter(before: AxisState, point: TrendPoint, declared: float, calibration: Calibration) -> float | None:
    conditions, amplification = _conditions(point), 1.0
    if point.feature_s2 is not None and point.friction_torque_nm is not None:
        amplification = friction_amplification(point.feature_s2, conditions, calibration)
    return scatter_with_history(before, point.at, conditions, declared, calibration, amplification=amplification)


def _feature_of(point: TrendPoint, calibration: Calibration | None) -> Estimate | None:
    """Return what the charts watch of a measurement; None if it has not what they need."""
    if calibration is not None:
        feature, own = point.feature_s2, point.feature_uncertainty_s2
        return None if feature is None or own is None else Estimate(feature, own)
    frequency, whole = point.frequency_hz, point.frequency_uncertainty_hz
    if point.refusal_reason is not None or point.preload_n is not None or frequency is None or whole is None:
        return None
    watched, own = inverse_square(Estimate(frequency, whole)), point.feature_uncertainty_s2
    # a measurement that an older program judged holds the whole only
    return watched if own is None else replace(watched, standard_uncertainty=own)


def _comparable(state: AxisState, point: TrendPoint, calibration: Calibration | None) -> TrendPoint:
    """Say of a measurement whether charts without a calibration can see a loss in it, as they stand before it."""
    uncharted = None if point.uncharted == Uncharted.NOT_COMPARABLE else point.uncharted
    if uncharted is None and _feature_of(point, calibration) is not None and calibration is None:
        uncharted = None if charts_see(state, _conditions(point)) else str(Uncharted.NOT_COMPARABLE)
    return replace(point, uncharted=uncharted)


def _advanced(
    state: AxisState, point: TrendPoint, calibration: Calibration | None, design: DetectorDesign, *, lubricated: bool
) -> AxisState:
    feature = _feature_of(point, calibration)
    if feature is None:
        return state
    charted = ChartedFeature(
        point.at,
        feature,
        _conditions(point),
        point.friction_torque_nm,
        in_doubt=point.doubt is not None,
        place=_place_of(point),
        lubricated=lubricated,
        damping_ratio=point.damping_ratio,
        residue=point.residue,
    )
    return advance_feature(state, charted, calibration=calibration, design=design)


def _conditions(point: TrendPoint) -> Conditions:
    return Conditions(metres(point.position_mm), point.payload_kg, point.temperature_c)


def _said_of(state: AxisState) -> dict[datetime, str | None]:
    """Return how the places of the session that is going on contradict each other, in words, by when it began."""
    disagreement = state.places.disagreement
    if state.places_since is None:
        return {}
    return {state.places_since: None if disagreement is None else disagreement.detail}


def _place_of(point: TrendPoint) -> PlaceReading | None:
    if point.preload_n is None or point.place_uncertainty is None:
        return None
    return PlaceReading(metres(point.position_mm), math.log(point.preload_n), point.place_uncertainty)


def _set_aside(connection: Connection, point: TrendPoint) -> TrendPoint:
    """Return a point that moves no chart because it is too late, in the state that its axis was in before it."""
    before = point_before(connection, point.axis_number, point.at)
    uncharted = point.uncharted or (None if point.refusal_reason else str(Uncharted.TOO_LATE))
    if before is None:
        return replace(point, uncharted=uncharted)
    return replace(point, uncharted=uncharted, state=before.state, baseline_preload_n=before.baseline_preload_n)


def reasons_of(points: Iterable[TrendPoint]) -> Counter[str]:
    """Count points that moved no chart, by the reason."""
    return Counter(point.uncharted for point in points if point.uncharted is not None)


def counted(before: CountsByReason, more: Counter[str], less: Counter[str] | None = None) -> CountsByReason:
    """Return counts with some more and some less, by name and without those that are none."""
    counts = Counter(before)
    counts.update(more)
    counts.subtract(less or {})
    return {reason: count for reason, count in sorted(counts.items()) if count}


def _in_time(point: TrendPoint) -> tuple[datetime, int]:
    return point.at, point.measurement_id
