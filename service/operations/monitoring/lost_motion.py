"""Take lost motion and torque of axes, and carry a chart of its own over each quantity.

It is the same chart that watches the preload, over numbers that rise as things get worse, or fall. Readings are few:
what arrives late folds the chart again from the first one, so that any order of arrival gives one history.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Annotated, Final, Literal

from pydantic import ConfigDict, Field, model_validator
from pydantic.config import JsonDict
from sqlalchemy import Connection
from sqlalchemy.orm import Session

from monitor_core.axis_state import AxisState
from monitor_core.trend import DetectorState, Observation, TrendStatus, reset, state_at, step
from service.clock import now, text_of
from service.documents.change import NotExamined, not_examined
from service.documents.lost_motion import LostMotionNow, ReadingStanding, lost_motion_evidence
from service.errors import ConflictError, InvalidRequestError
from service.json_types import JsonObject
from service.operations.fields import Label, Moment, Number, Position, RequestModel, Temperature
from service.operations.monitoring.alarm_changes import add_alarm, change_alarm, in_order, raise_again
from service.operations.monitoring.axis_configuration import load_configuration
from service.operations.monitoring.intake.admission import MOST_AHEAD
from service.operations.monitoring.intake.chart_state import dump_state, is_outdated_state, load_design, load_state
from service.store import alarms, intake
from service.store.axes import get_axis, list_axes, lubrications_of, renewals_of, was_lubricated
from service.store.database import Database
from service.store.intake import AxisRecord
from service.store.tables import AlarmRow, AxisRow
from service.store.trend.lost_motion import (
    LOST_MOTION,
    SIGNS,
    ChartedReading,
    ReadingChart,
    charts_of,
    moments_in_order,
    newest_reading,
    newest_readings,
    read_chart,
    readings_at,
    readings_of,
    save_chart,
    save_readings,
)
from service.store.trend.points import Span

#: Readings of one request.
MOST_AT_ONCE: Final = 1000
#: A reversal value depends on the place: what was measured further from that of the first is not compared with it [mm].
SAME_PLACE_MM: Final = 5.0
#: Lost motion is measured now and then: after a longer silence nothing is known of it, nor sooner than of the preload.
SILENT_AFTER: Final = timedelta(days=31)
#: Why a reading moves no chart.
OTHER_PLACE: Final = "other-place"
OTHER_SPEED: Final = "other-speed"
#: Friction depends on the speed: what was measured at another one than the first is not compared, relative.
SAME_SPEED: Final = 0.1
_NEXT: Final = timedelta(microseconds=1)
#: What changes alarms that were raised already.
_LATE, _WORKED = "a reading that arrived late", "what was done to the axis"

Micrometres = Annotated[Number, Field(ge=-1e6, le=1e6)]
Ends = tuple[Micrometres, Micrometres]
Amount = Annotated[Number, Field(ge=-1e6, le=1e6)]
TorqueQuantity = Literal["drag-torque", "screw-order", "ball-pass-order"]


EXAMPLE: JsonDict = {
    "at": "2026-03-02T06:00:00Z", "measurement": "slow", "position_mm": 563.8,
    "reversal_value_um": 7.54, "reversal_value_standard_uncertainty_um": 0.02,
    "reversal_value_interval_95_um": [7.49, 7.59], "play_interval_95_um": [4.6, 5.4], "n_reversals": 9,
}  # fmt: skip


class LostMotionIn(RequestModel):
    """Lost motion at the reversals of one log, as `preload lost-motion --json` gives it."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLE]})

    at: Annotated[Moment, Field(description="when the log began; with the axis it tells one reading from another")]
    measurement: Label
    position_mm: Position
    reversal_value_um: Annotated[Micrometres, Field(description="mean over both senses, ISO 230-2")]
    reversal_value_standard_uncertainty_um: Annotated[Number, Field(ge=0, le=1e6, description="of repeatability")]
    reversal_value_interval_95_um: Ends
    play_interval_95_um: Annotated[Ends | None, Field(description="of that part of it that is play")] = None
    n_reversals: Annotated[int, Field(ge=4, le=1_000_000)]
    temperature_c: Temperature | None = None

    def reading(self, axis_number: int) -> ChartedReading:
        """Return it as it is stored."""
        (lower, upper), play = self.reversal_value_interval_95_um, self.play_interval_95_um
        play_lower, play_upper = (None, None) if play is None else play
        return ChartedReading(
            axis_number, LOST_MOTION, self.at, self.measurement, self.position_mm, self.reversal_value_um,
            self.reversal_value_standard_uncertainty_um, lower, upper, "µm", play_lower, play_upper,
            self.n_reversals, self.temperature_c,
        )  # fmt: skip

    @model_validator(mode="after")
    def _require_order(self) -> "LostMotionIn":
        lower, upper = self.reversal_value_interval_95_um
        if not lower <= self.reversal_value_um <= upper:
            raise ValueError(
                f"reversal_value_interval_95_um: expected an interval around {self.reversal_value_um:g} µm; got "
                f"{lower:g} to {upper:g} µm"
            )
        if self.play_interval_95_um is not None and self.play_interval_95_um[0] > self.play_interval_95_um[1]:
            low, high = self.play_interval_95_um
            raise ValueError(f"play_interval_95_um: expected the lower end first; got {low:g} to {high:g} µm")
        return self


class TorqueIn(RequestModel):
    """Drag torque, or the amplitude of an order of the screw, as `preload torque --json` gives it."""

    at: Annotated[Moment, Field(description="when its log began; with axis and quantity it tells one from another")]
    measurement: Label
    position_mm: Annotated[Position, Field(description="middle of the strokes")]
    speed_mm_per_s: Annotated[Number, Field(gt=0, le=1e5, description="of the strokes")]
    quantity: TorqueQuantity
    value: Amount
    unit: Literal["N·m", "N", "A"]
    standard_uncertainty: Annotated[Amount, Field(ge=0)]
    interval_95: tuple[Amount, Amount]
    n_repeats: Annotated[int, Field(ge=1, le=1_000_000, description="travels each way, or stretches")]
    temperature_c: Temperature | None = None

    def reading(self, axis_number: int) -> ChartedReading:
        """Return it as it is stored."""
        return ChartedReading(
            axis_number, self.quantity, self.at, self.measurement, self.position_mm, self.value,
            self.standard_uncertainty, *self.interval_95, self.unit, None, None, self.n_repeats, self.temperature_c,
            speed_mm_per_s=self.speed_mm_per_s,
        )  # fmt: skip

    @model_validator(mode="after")
    def _require_order(self) -> "TorqueIn":
        lower, upper = self.interval_95
        if not lower <= self.value <= upper:
            raise ValueError(f"interval_95: expected an interval around {self.value:g}; got {lower:g} to {upper:g}")
        return self


@dataclass(frozen=True, slots=True)
class Taken:
    """How many readings were new, and how many there already."""

    accepted: int
    already_there: int


class Readings:
    """Takes readings of lost motion and torque, and says how a quantity stands."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def take(self, axis_id: str, sent: Sequence[LostMotionIn | TorqueIn]) -> Taken:
        """Store readings and judge them by the chart of the axis; whatever is raised, nothing of them is stored.

        The same reading sent once more is the one that is there. Raises InvalidRequestError for one of the future;
        ConflictError where another one is stored (or sent) of the same moment, or the axis is archived.
        """
        received_at = now()
        with self._database.write(axis_id) as session:
            connection = session.connection()
            axis = intake.read_axis(connection, axis_id)
            if axis.archived_at is not None:
                raise ConflictError(
                    f"axis '{axis_id}' is archived since {text_of(axis.archived_at)}; take it back first"
                )
            received: dict[str, dict[datetime, ChartedReading]] = {}
            for each in sent:
                reading = each.reading(axis.number)
                if each.at > received_at + MOST_AHEAD:
                    raise InvalidRequestError(
                        f"{_called(reading)} was measured until now ({text_of(received_at)}); got {text_of(each.at)}"
                    )
                _put(received.setdefault(reading.quantity, {}), reading, axis_id)
            n_new = 0
            for quantity, new in received.items():
                for stored in readings_at(connection, axis.number, quantity, new.keys()):
                    _require_same(stored, new.pop(stored.at), axis_id)
                if new:
                    _chart(connection, axis, quantity, sorted(new.values(), key=_in_time))
                n_new += len(new)
        return Taken(n_new, len(sent) - n_new)

    def find_in_order(self, axis_id: str, quantity: TorqueQuantity) -> None:
        """Learn the level of a quantity anew: somebody looked at the axis, as where an alarm is cleared.

        Raises ConflictError if the quantity was never measured.
        """
        with self._database.write(axis_id) as session:
            axis = intake.read_axis(session.connection(), axis_id)
            newest = newest_reading(session.connection(), axis.number, quantity)
            if newest is None:
                raise ConflictError(f"{quantity} of axis '{axis_id}' was never measured: nothing is learnt anew")
            _begin_after(session.connection(), axis, newest)

    def page(
        self, axis_id: str, span: Span, *, after: datetime | None, limit: int, quantity: str = LOST_MOTION
    ) -> list[ChartedReading]:
        """Return readings in time order."""
        with self._database.read() as session:
            number = get_axis(session, axis_id).number
            return readings_of(session.connection(), number, quantity, span, after=after, limit=limit)

    def readings(self, axis_id: str, quantity: str = LOST_MOTION) -> list[ChartedReading]:
        """Return all readings in time order."""
        with self._database.read() as session:
            return readings_of(session.connection(), get_axis(session, axis_id).number, quantity, Span())

    def standing(self, axis_id: str, quantity: str = LOST_MOTION) -> ReadingStanding:
        """Return how a quantity of an axis stands now."""
        with self._database.read() as session:
            row, connection = get_axis(session, axis_id), session.connection()
            chart = read_chart(connection, row.number, quantity)
            newest = newest_readings(connection, row.number, quantity).get(row.number)
            compared = None if newest is None else newest[0]
            if newest is not None and newest[0].uncharted is not None and newest[1] is not None:
                (compared,) = readings_at(connection, row.number, quantity, [newest[1]])
            beginnings = _Beginnings.of(connection, row, quantity)
        settings, configured = load_design(row.detector_design).settings, load_configuration(row.configuration)
        shown = lost_motion_now(newest, max(beginnings.moments, default=None), configured.silent_after_hours)
        detector = DetectorState()
        if chart is not None and newest is not None:
            detector, _ = beginnings.begun(load_state(chart.state).detector, newest[0].at, None)
        state, baseline = str(TrendStatus.UNKNOWN) if shown is None else shown.state, detector.baseline
        interval, sign = None if baseline is None else baseline.prediction_interval(), SIGNS[quantity]
        ends = None if interval is None else sorted((sign * interval.lower, sign * interval.upper))
        return ReadingStanding(
            quantity=quantity,
            state=state,
            since=detector.since if state == detector.status else detector.last_at,
            newest=compared,
            baseline=None if baseline is None else sign * baseline.mean,
            baseline_interval_95=None if ends is None else (ends[0], ends[1]),
            n_sessions=len(detector.learning) + (detector.session is not None) if baseline is None else baseline.size,
            baseline_size=settings.baseline_size,
            false_alarms_per_year=settings.false_alarms_per_year,
            place_mm=None if chart is None else chart.place_mm,
            speed_mm_per_s=None if chart is None else chart.speed_mm_per_s,
            alarm=detector.alarm,
            alert=detector.alert,
        )


def lost_motion_now(
    newest: tuple[ChartedReading, datetime | None] | None, renewed_at: datetime | None, silent_after_hours: float
) -> LostMotionNow | None:
    """Return the newest lost motion of an axis with the state that its chart has now, without reading the chart.

    ``newest``: the last reading, and when the last was taken that moved the chart. ``renewed_at``: when the chart began
    anew for the last time, as with another nut or screw. None: it was never measured.
    """
    if newest is None:
        return None
    reading, charted_at = newest
    begins_anew = reading.found_in_order or (renewed_at is not None and reading.at < renewed_at <= now())
    state = TrendStatus.UNKNOWN if begins_anew else TrendStatus(reading.state)
    silent_after = max(timedelta(hours=silent_after_hours), SILENT_AFTER)
    state = state_at(DetectorState(status=state, last_at=charted_at), now(), silent_after)
    ends = charted_at is not None and state not in (TrendStatus.UNKNOWN, TrendStatus.ALARM)
    return LostMotionNow(
        reading.at, reading.value, reading.interval_95, str(state),
        charted_at + silent_after if charted_at is not None and ends else None,
    )  # fmt: skip


def learn_anew(connection: Connection, axis_id: str, epoch: int) -> None:
    """Learn the level anew: somebody cleared an alarm of this epoch; one of an older one began a new level already."""
    axis = intake.read_axis(connection, axis_id)
    newest = newest_reading(connection, axis.number, LOST_MOTION)
    if newest is None or epoch != bisect_right(_Beginnings.of(connection, axis, LOST_MOTION).moments, newest.at):
        return
    _begin_after(connection, axis, newest)


def _begin_after(connection: Connection, axis: AxisRecord, newest: ChartedReading) -> None:
    save_readings(connection, axis.number, [replace(newest, found_in_order=True)])
    _chart(connection, axis, newest.quantity, None)


def chart_again(connection: Connection, axis_id: str) -> None:
    """Fold the charts again, because the log says something else of the axis now."""
    axis = intake.read_axis(connection, axis_id)
    for quantity in SIGNS:
        if read_chart(connection, axis.number, quantity) is not None:
            _chart(connection, axis, quantity, None)


def renew_readings(database: Database) -> None:
    """Fold charts anew that an older version of the program folded; alarms stand as they did: nothing was measured."""
    with database.read() as session:
        outdated = [chart for chart in charts_of(session.connection()) if is_outdated_state(chart.state)]
        names = {axis.number: axis.id for axis in list_axes(session)} if outdated else {}
    for chart in outdated:
        axis_id = names[chart.axis_number]
        with database.write(axis_id) as session:
            axis = intake.read_axis(session.connection(), axis_id)
            _chart(session.connection(), axis, chart.quantity, None, settles=False)


def _put(new: dict[datetime, ChartedReading], reading: ChartedReading, axis_id: str) -> None:
    if reading.at in new:
        _require_same(new[reading.at], reading, axis_id)
    new[reading.at] = reading


def _require_same(stored: ChartedReading, sent: ChartedReading, axis_id: str) -> None:
    """Raise ConflictError if two readings of one moment differ in what was sent."""
    sent = replace(sent, uncharted=stored.uncharted, state=stored.state, found_in_order=stored.found_in_order)
    if stored != sent:
        raise ConflictError(f"another {_called(sent)} of axis '{axis_id}' at {text_of(sent.at)} is there already")


def _require_one_unit(before: ChartedReading, reading: ChartedReading) -> None:
    """Raise InvalidRequestError if two readings between which nut and screw are the same differ in unit."""
    if before.unit != reading.unit:
        units = " and ".join(sorted((before.unit, reading.unit)))
        raise InvalidRequestError(f"{reading.quantity} of an axis is charted in one unit; got {units}")


def _uncharted(chart: ReadingChart, reading: ChartedReading) -> str | None:
    """Return why a reading is not compared with what a chart watches."""
    if chart.place_mm is not None and abs(reading.position_mm - chart.place_mm) > SAME_PLACE_MM:
        return OTHER_PLACE
    speed, watched = reading.speed_mm_per_s, chart.speed_mm_per_s
    if speed is not None and watched is not None and abs(speed - watched) > SAME_SPEED * watched:
        return OTHER_SPEED
    return None


def _called(reading: ChartedReading) -> str:
    return reading.quantity.replace("-", " ")


def _in_time(reading: ChartedReading) -> datetime:
    return reading.at


# --- the chart


@dataclass(frozen=True, slots=True)
class _Beginnings:
    """Where the chart begins anew: with another nut or screw, or after a reading that somebody found in order.

    Torque begins anew with fresh grease, too: it is friction, or what friction passes on.
    """

    renewals: frozenset[datetime]
    moments: tuple[datetime, ...]  # of all, in order of time
    lubricated: tuple[datetime, ...]

    @classmethod
    def of(cls, connection: Connection, axis: AxisRecord | AxisRow, quantity: str) -> "_Beginnings":
        renewals = frozenset(renewals_of(connection, axis.id))
        inspected = {at + _NEXT for at in moments_in_order(connection, axis.number, quantity)}
        lubricated = lubrications_of(connection, axis.id)
        if quantity == LOST_MOTION:
            return cls(renewals, tuple(sorted(renewals | inspected)), tuple(lubricated))
        return cls(renewals, tuple(sorted(renewals | inspected | {*lubricated})), ())

    def begun(self, state: DetectorState, after: datetime, until: datetime | None) -> tuple[DetectorState, bool]:
        """Return the chart as it begins after a reading, until the next one, and whether it watches another axis."""
        end = len(self.moments) if until is None else bisect_right(self.moments, until)
        passed = self.moments[bisect_right(self.moments, after) : end]
        if not passed:
            return state, False
        if self.renewals.intersection(passed):
            return DetectorState(last_at=state.last_at), True
        return reset(state), False


@dataclass(frozen=True, slots=True)
class _Raised:
    reading: ChartedReading
    evidence: JsonObject
    epoch: int


def _chart(
    connection: Connection, axis: AxisRecord, quantity: str, new: Sequence[ChartedReading] | None, *,
    settles: bool = True,
) -> None:  # fmt: skip
    """Carry a chart on over new readings in time order, or over all again, and settle what that of lost motion raises.

    The others say how they stand, and raise no alarms beside those of the preload that they go with.
    """
    beginnings, because_of = _Beginnings.of(connection, axis, quantity), _WORKED if new is None else _LATE
    settles = settles and quantity == LOST_MOTION
    design = load_design(intake.read_charts(connection, axis).detector_design)
    chart = read_chart(connection, axis.number, quantity)
    newest = newest_reading(connection, axis.number, quantity)
    again = new is None or chart is None or newest is None or is_outdated_state(chart.state) or new[0].at <= newest.at
    stored, new = list[ChartedReading](), new or ()
    if again or chart is None:
        stored = readings_of(connection, axis.number, quantity, Span())
        chart = ReadingChart(axis.number, quantity, {}, None)
        state, before, new = DetectorState(), None, sorted((*stored, *new), key=_in_time)
    else:
        state, before = load_state(chart.state).detector, newest
    judged, raised = list[ChartedReading](), list[_Raised]()
    for reading in new:
        if before is not None:
            state, is_another = beginnings.begun(state, before.at, reading.at)
            if is_another:
                chart = replace(chart, place_mm=None, speed_mm_per_s=None)
            else:
                _require_one_unit(before, reading)
        was, uncharted = state, _uncharted(chart, reading)
        if uncharted is None:
            if chart.place_mm is None:
                chart = replace(chart, place_mm=reading.position_mm, speed_mm_per_s=reading.speed_mm_per_s)
            lubricated = was_lubricated(beginnings.lubricated, None if before is None else before.at, reading.at)
            state = step(state, _observation(reading, lubricated=lubricated), design)
        before = replace(reading, state=str(state.status), uncharted=uncharted)
        judged.append(before)
        if settles and state.alarm is not None and was.alarm is None:
            epoch = bisect_right(beginnings.moments, reading.at)
            raised.append(_Raised(before, lost_motion_evidence(before, state), epoch))
    save_readings(connection, axis.number, {*judged}.difference(stored))
    save_chart(connection, replace(chart, state=dump_state(AxisState(detector=state))))
    intake.say_changed(connection, axis)
    if settles and (raised or again):
        _settle(connection, axis, raised, beginnings, again=again, because_of=because_of)


def _observation(reading: ChartedReading, *, lubricated: bool) -> Observation:
    return Observation(
        reading.at, SIGNS[reading.quantity] * reading.value, reading.standard_uncertainty,
        temperature=reading.temperature_c, lubricated=lubricated,
    )  # fmt: skip


def _settle(
    connection: Connection, axis: AxisRecord, raised: Sequence[_Raised], beginnings: _Beginnings, *,
    again: bool, because_of: str,
) -> None:  # fmt: skip
    """Store the alarms that the chart raises; of a chart that was folded again they are the same ones in order."""
    with Session(connection) as session:
        earlier = alarms.of_lost_motion(session, axis.id) if again else ()
        stood = [(bisect_right(beginnings.moments, row.measured_at), row) for row in earlier]
        for epoch, row, alarm in in_order(stood, [(alarm.epoch, alarm) for alarm in raised]):
            if row is None and alarm is not None:
                add_alarm(session, _row(axis, alarm), "raised by lost motion")
            elif row is not None and alarm is not None:
                row.epoch = epoch
                raise_again(
                    session, row, (None, alarm.reading.at), alarm.evidence, f"{because_of} changed the evidence"
                )
            elif row is not None:
                change_alarm(session, row, alarms.WITHDRAWN, f"with {because_of} the chart raises none")
        session.commit()  # hands it to the connection


def _row(axis: AxisRecord, alarm: _Raised) -> AlarmRow:
    return AlarmRow(
        axis_id=axis.id, measurement_id=None, kind=alarms.LOST_MOTION, epoch=alarm.epoch,
        measured_at=alarm.reading.at, evidence=alarm.evidence, explanation=not_examined(NotExamined.LOST_MOTION),
    )  # fmt: skip
