"""Fold the charts of axes again that an older version of the program left: what they knew is measured still."""

import logging
from contextlib import suppress
from dataclasses import replace
from datetime import timedelta

from sqlalchemy import Connection

from monitor_core.pipeline import AxisState
from service.errors import DocumentDamagedError
from service.operations.monitoring.alarm_changes import settle_alarms
from service.operations.monitoring.axis_configuration import detector_design, detector_settings, load_configuration
from service.operations.monitoring.intake.chart_state import dump_design, dump_state, is_outdated
from service.operations.monitoring.intake.charts import fold_epoch
from service.store import intake
from service.store.axes import list_axes
from service.store.calibrations import CalibrationsInForce
from service.store.database import Database, writing
from service.store.trend.epochs import epochs_of, save_epoch
from service.store.trend.points import forget_checkpoints

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
    calibration = CalibrationsInForce().of(connection, axis)
    folded = fold_epoch(connection, axis, charts, calibration)
    if calibration is not None and folded.again:
        settle_alarms(connection, axis, folded)
    intake.save_charts(connection, axis, before, folded.charts)
    log.info("the charts of axis '%s' are of this version now", axis_id)
