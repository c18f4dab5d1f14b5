"""Begin epochs of the charts where a person says so: another calibration, an inspection, a new nut or screw."""

from contextlib import suppress
from datetime import datetime, timedelta

from sqlalchemy import Connection
from sqlalchemy.orm import Session

from monitor_core.axis_state import AxisState
from monitor_core.trend import DetectorState, Prior, TrendStatus, prior_from
from service.errors import DocumentDamagedError
from service.operations.monitoring.alarm_changes import settle_alarms
from service.operations.monitoring.axis_configuration import sisters_of
from service.operations.monitoring.intake.chart_state import dump_state, load_state
from service.operations.monitoring.intake.charts import Folded, enter_epoch, fold_from
from service.store import intake
from service.store.axes import get_axis
from service.store.calibrations import CalibrationsInForce
from service.store.intake import AxisRecord, ChartsRecord
from service.store.tables import AxisRow
from service.store.trend.epochs import (
    BEGIN_OF_TIME,
    CALIBRATION,
    INSPECTION,
    EpochRecord,
    forget_epoch,
)


def begin_by_calibration(connection: Connection, axis_id: str) -> None:
    """Begin with nothing learnt but what sisters lend: another calibration was put in force."""
    axis = intake.read_axis(connection, axis_id)
    charts = intake.read_charts(connection, axis)
    _enter(connection, axis, charts, epoch_of_calibration(connection, axis, _after(charts)), "another calibration")


def epoch_of_calibration(connection: Connection, axis: AxisRecord, begins_at: datetime) -> EpochRecord:
    """Return the epoch that the calibration in force begins, with what sisters lend to it."""
    with Session(connection) as session:
        prior = prior_of_sisters(session, get_axis(session, axis.id))
    state = dump_state(AxisState(DetectorState(prior=prior)))
    return EpochRecord(axis.number, begins_at, CALIBRATION, calibration_id=axis.active_calibration_id, state=state)


def prior_of_sisters(session: Session, axis: AxisRow) -> Prior | None:
    """Return what the healthy, calibrated axes of the same stated type teach now; None without any."""
    learnt = []
    for sister in sisters_of(session, axis):
        if sister.state != TrendStatus.NORMAL or sister.active_calibration_id is None:
            continue
        with suppress(DocumentDamagedError):  # it is told of on its own page, and keeps nobody else from learning
            belief = load_state(sister.monitor_state).detector.learnt
            learnt += [] if belief is None else [belief]
    return prior_from(learnt) if learnt else None


def begin_by_inspection(connection: Connection, axis_id: str) -> None:
    """Learn the level anew: somebody looked at the axis and found it in order."""
    axis = intake.read_axis(connection, axis_id)
    charts = intake.read_charts(connection, axis)
    _enter(connection, axis, charts, EpochRecord(axis.number, _after(charts), INSPECTION), "an inspection")


def begin_by_maintenance(connection: Connection, axis: AxisRecord, epoch: EpochRecord) -> None:
    """Begin with nothing learnt where an axis got another nut or screw, however long ago."""
    _enter(connection, axis, intake.read_charts(connection, axis), epoch, MAINTAINED)


def take_back(connection: Connection, axis: AxisRecord, epoch: EpochRecord) -> None:
    """Go on at a moment as if no epoch began there."""
    forget_epoch(connection, epoch)
    go_on_from(connection, axis, epoch.begins_at)


def go_on_from(connection: Connection, axis: AxisRecord, moment: datetime) -> None:
    """Fold the charts again from a moment on, because the log says something else of it now."""
    before = intake.read_charts(connection, axis)
    folded = fold_from(connection, axis, before, moment, CalibrationsInForce().of(connection, axis))
    keep(connection, axis, before, folded, MAINTAINED)


#: Why alarms changed.
MAINTAINED = "what was done to the axis"


def keep(connection: Connection, axis: AxisRecord, before: ChartsRecord, folded: Folded, because_of: str) -> None:
    """Store charts that were folded again, and the alarms that they raise."""
    if folded.again:
        settle_alarms(connection, axis, folded, because_of)
    intake.save_charts(connection, axis, before, folded.charts)


def _enter(connection: Connection, axis: AxisRecord, charts: ChartsRecord, epoch: EpochRecord, because_of: str) -> None:
    calibration = CalibrationsInForce().of(connection, axis)
    keep(connection, axis, charts, enter_epoch(connection, axis, charts, epoch, calibration), because_of)


def _after(charts: ChartsRecord) -> datetime:
    """Return the first moment after everything that the charts have seen."""
    return BEGIN_OF_TIME if charts.last_charted_at is None else charts.last_charted_at + timedelta(microseconds=1)
