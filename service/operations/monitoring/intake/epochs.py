"""Begin epochs of the charts where a person says so: another calibration, an inspection, a new nut or screw."""

import logging
from contextlib import suppress
from dataclasses import replace
from datetime import datetime, timedelta

from sqlalchemy import Connection
from sqlalchemy.orm import Session

from monitor_core.pipeline import AxisState
from monitor_core.trend import DetectorState, Prior, TrendStatus, prior_from
from service.errors import DocumentDamagedError
from service.operations.monitoring.alarm_changes import LATE, settle_alarms
from service.operations.monitoring.axis_configuration import (
    detector_design,
    detector_settings,
    load_configuration,
    sisters_of,
)
from service.operations.monitoring.intake.chart_state import dump_design, dump_state, is_outdated, load_state
from service.operations.monitoring.intake.charts import Folded, enter_epoch, fold_from
from service.store import intake
from service.store.axes import get_axis, list_axes
from service.store.calibrations import CalibrationsInForce
from service.store.database import Database, writing
from service.store.intake import AxisRecord, ChartsRecord
from service.store.tables import AxisRow
from service.store.trend.epochs import (
    BEGIN_OF_TIME,
    CALIBRATION,
    INSPECTION,
    EpochRecord,
    epochs_of,
    forget_checkpoints,
    forget_epoch,
    save_epoch,
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
    """Return what the healthy axes of the same stated type teach now; None without any."""
    learnt = []
    for sister in sisters_of(session, axis):
        if sister.state != TrendStatus.NORMAL:
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
    before = intake.read_charts(connection, axis)
    folded = fold_from(connection, axis, before, epoch.begins_at, CalibrationsInForce().of(connection, axis))
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


log = logging.getLogger(__name__)


def renew_charts(database: Database) -> None:
    """Bring the charts of every axis to this version, before a window is taken.

    An axis whose configuration cannot be read is left as it is, and refused by name when something comes for it.
    """
    with database.read() as session:
        outdated = [axis.id for axis in list_axes(session) if is_outdated(axis)]
    for axis_id in outdated:
        with (
            database.connect() as connection,
            database.at_axes(connection, [axis_id], wait=True),
            writing(connection),
            suppress(DocumentDamagedError),
        ):
            _renew(connection, axis_id)


def _renew(connection: Connection, axis_id: str) -> None:
    axis = intake.read_axis(connection, axis_id)
    before = intake.read_charts(connection, axis)
    if not is_outdated(before):
        return  # another service, which started at the same time, has done it
    design = detector_design(detector_settings(load_configuration(axis.configuration)))
    beginning = dump_state(AxisState())
    for epoch in epochs_of(connection, axis.number):
        if epoch.epoch is not None:  # an inspection that is told later may go back to any of them
            forget_checkpoints(connection, axis.number, epoch.epoch, None)
            save_epoch(connection, replace(epoch, state=beginning))
    charts = replace(
        before,
        detector_design=dump_design(design),
        monitor_state=beginning,
        epoch_after=None if before.epoch_from is None else before.epoch_from - timedelta(microseconds=1),
        since_checkpoint=0,
    )
    if charts.epoch_from is None:
        intake.save_charts(connection, axis, before, charts)
    else:
        calibration = CalibrationsInForce().of(connection, axis)
        folded = fold_from(connection, axis, charts, charts.epoch_from, calibration)
        keep(connection, axis, before, folded, LATE)
    log.info("the charts of axis '%s' are of this version now", axis_id)
