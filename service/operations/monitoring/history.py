"""Summarise the history of an axis: what is normal, where the trend goes, how often it alarms falsely."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from sqlalchemy.orm import Session

from monitor_core.axis_state import AxisState
from monitor_core.preload import Calibration, ConditionLaw
from monitor_core.recording import Conditions
from monitor_core.trend import (
    ClosedSession,
    DetectorDesign,
    DetectorState,
    Session as MeasuredSession,
    found_rate,
    healthy_sessions,
    present_trend,
)
from service.documents.history import (
    AlertView,
    BaselineView,
    FalseAlarmsView,
    LineView,
    ProjectedPreload,
    alert_view,
    baseline_view,
    false_alarms_view,
    line_view,
    projected_preload,
)
from service.documents.together import TogetherView, together_view
from service.operations.monitoring.intake.chart_state import load_design, load_state
from service.store import axes
from service.store.calibrations import CalibrationsInForce
from service.store.database import Database
from service.store.lookup import Remembered
from service.store.rejudged import Stale, stale_axes
from service.store.tables import MaintenanceRow
from service.store.trend.sessions import UNCALIBRATED, SessionRecord, stored_sessions

#: The newest sessions are looked at: a year of them, at one a day.
MOST_SESSIONS = 400
#: So many answers are remembered, two of each axis.
_MOST_REMEMBERED = 10_000
#: Where the resampling begins: the same history gives the same answer.
_SEED = 20180301


@dataclass(frozen=True, slots=True)
class HealthyFrequency:
    """What is known of a healthy axis without a calibration, as far as it is learnt."""

    law: ConditionLaw
    level: float  # 1/f² at the reference of the law [s²]

    def at(self, conditions: Conditions) -> float | None:
        """Return the frequency of the healthy axis under some conditions [Hz]; None where the law gives none."""
        feature = self.level + self.law.shift(conditions)
        return feature**-0.5 if feature > 0.0 else None


def _healthy(state: AxisState) -> HealthyFrequency | None:
    learning = [session.value for session in state.detector.learning]
    if state.law is None:
        return None
    if state.detector.baseline is not None:
        return HealthyFrequency(state.law, state.detector.baseline.mean)
    if state.detector.session is not None:
        learning.append(state.detector.session.value)
    return HealthyFrequency(state.law, float(np.mean(learning))) if learning else None


@dataclass(frozen=True, slots=True)
class AxisHistory:
    """What the history of an axis says; None where it says nothing yet."""

    baseline: BaselineView | None
    line: LineView | None
    false_alarms: FalseAlarmsView | None
    alert: AlertView | None = None  # that stands
    events: tuple[MaintenanceRow, ...] = ()  # what was done to it, in order of time
    stale: Stale | None = None  # it is about to be replaced
    together: TogetherView | None = None  # what several numbers show together
    healthy: HealthyFrequency | None = None  # without a calibration: what frequencies are compared with now
    projected: ProjectedPreload | None = None  # where the line goes


class History:
    """Answers what the sessions of an axis say together."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._calibrations = CalibrationsInForce()
        self._remembered = Remembered(_MOST_REMEMBERED)

    def of(self, axis_id: str) -> AxisHistory:
        """Return what is normal for an axis, the line through its trend, and its rate of false alarms."""
        with self._database.read() as session:
            key = axes.key_of(session, axis_id)
            said = self._remembered.of(axis_id, key, partial(self._read, session, axis_id))
            events = tuple(axes.standing_entries(axes.maintenance_log(session, axis_id)))
            return replace(said, events=events, stale=stale_axes(session, axis_id).get(axis_id))

    def _read(self, session: Session, axis_id: str) -> AxisHistory:
        row, connection = axes.get_axis(session, axis_id), session.connection()
        calibration = self._calibrations.numbered(connection, axis_id, row.active_calibration_id)
        if row.monitor_state is None:
            return AxisHistory(None, None, None)
        sessions = stored_sessions(connection, row.number, row.active_calibration_id or UNCALIBRATED, MOST_SESSIONS)
        stored, design = load_state(row.monitor_state), load_design(row.detector_design)
        state = stored.detector
        line, projected, false_alarms = self._remembered.of(
            ("long run", axis_id),
            (hash(tuple(sessions)), row.active_calibration_id, row.epoch, row.detector_design, state.alarm is None),
            lambda: _long_run(list(map(SessionRecord.of, sessions)), calibration, state, design, row.epoch),
        )
        alert = alert_view(state, calibration, design.settings.baseline_size)
        together = together_view(stored.joint, design)
        healthy = _healthy(stored) if calibration is None else None
        return AxisHistory(
            baseline_view(state, calibration), line, false_alarms, alert, together=together, healthy=healthy,
            projected=projected,
        )  # fmt: skip


def _long_run(
    sessions: list[SessionRecord],
    calibration: Calibration | None,
    state: DetectorState,
    design: DetectorDesign,
    epoch: int,
) -> tuple[LineView | None, ProjectedPreload | None, FalseAlarmsView]:
    measured = [_session(record) for record in sessions]
    present = present_trend(measured, state.prior_in_use, alarmed=state.alarm is not None)
    line = projected = None
    if present.line is not None:
        line = line_view(present.line, calibration, present.changed_at)
        projected = None if calibration is None else projected_preload(present.line, calibration, line)
    # an alarm that was cleared was false; of one that stands nobody has said so yet
    healthy = healthy_sessions(
        ClosedSession(_session(record), record.residual, record.reference, record.alarmed)
        for record in sessions
        if not (record.alarmed and record.epoch == epoch)
    )
    rate = found_rate(healthy, state.of(design), np.random.default_rng(_SEED))
    false_alarms = false_alarms_view(design.settings.false_alarms_per_year, rate, len(healthy))
    return line, projected, false_alarms


def _session(record: SessionRecord) -> MeasuredSession:
    return MeasuredSession(
        record.started_at,
        record.last_at,
        record.n_measurements,
        record.feature_s2,
        temperature=record.temperature_c,
        friction_torque=record.friction_torque_nm,
    )
