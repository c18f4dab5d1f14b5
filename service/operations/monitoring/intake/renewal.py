"""Bring the charts of axes to this version of the program at a start, where an older one folded them.

Charts of another version cannot be gone on with, so they are folded again over what was measured. What was said before
stands: points of the trend keep their states, and alarms stand as they did, since nothing was measured anew.
"""

import logging
from contextlib import suppress
from dataclasses import replace
from datetime import timedelta

from sqlalchemy import Connection

from monitor_core.axis_state import AxisState
from monitor_core.trend import DetectorState
from service.errors import DocumentDamagedError
from service.json_types import JsonObject
from service.operations.monitoring.alarm_changes import let_alarms_stand
from service.operations.monitoring.axis_configuration import detector_design, detector_settings, load_configuration
from service.operations.monitoring.intake.chart_state import dump_design, dump_state, is_outdated, load_state
from service.operations.monitoring.intake.charts import fold_from
from service.store import intake
from service.store.axes import list_axes
from service.store.calibrations import CalibrationsInForce
from service.store.database import Database, writing
from service.store.intake import AxisRecord, ChartsRecord
from service.store.trend.epochs import (
    BEGIN_OF_TIME,
    CALIBRATION,
    INSPECTION,
    UNKNOWN,
    EpochRecord,
    decided_since_calibration,
    epochs_of,
    forget_checkpoints,
    save_epoch,
    without_epochs,
)

log = logging.getLogger(__name__)
_NEXT = timedelta(microseconds=1)


def renew_charts(database: Database) -> None:
    """Bring the charts of every axis to this version, before a window is taken.

    An axis whose configuration cannot be read is left as it is, and refused by name when something comes for it.
    """
    with database.read() as session:
        outdated = {axis.id for axis in list_axes(session) if is_outdated(axis)}
        outdated |= without_epochs(session.connection())
    for axis_id in sorted(outdated):
        with (
            suppress(DocumentDamagedError),  # outside the transaction, which is undone then
            database.connect() as connection,
            database.at_axes(connection, [axis_id], wait=True),
            writing(connection),
        ):
            _renew(connection, axis_id)


def _renew(connection: Connection, axis_id: str) -> None:
    axis = intake.read_axis(connection, axis_id)
    before = intake.read_charts(connection, axis)
    if without_epochs(connection, axis_id):
        _name_epochs(connection, axis, before)
    elif not is_outdated(before):
        return  # another service, which started at the same time, has done it
    epochs = [epoch for epoch in epochs_of(connection, axis.number) if epoch.epoch is not None]
    for epoch in epochs:  # an inspection that is told later may go back to any of them
        forget_checkpoints(connection, axis.number, epoch.epoch or 0, None)
        save_epoch(connection, replace(epoch, state=_beginning(epoch)))
    unlearnt = [epoch.begins_at for epoch in epochs if epoch.begun_by in (CALIBRATION, UNKNOWN)]
    since = unlearnt[-1] if unlearnt else BEGIN_OF_TIME
    design = detector_design(detector_settings(load_configuration(axis.configuration)))
    charts = replace(
        before,
        detector_design=dump_design(design),
        monitor_state=dump_state(AxisState()),
        epoch_after=since,  # of the epochs before it nothing is folded again
    )
    calibration = CalibrationsInForce().of(connection, axis)
    said = before.monitor_state is not None and is_outdated(before)  # charts that know nothing have said nothing
    folded = fold_from(connection, axis, charts, since, calibration, keep_points=said)
    let_alarms_stand(connection, axis, folded)
    intake.save_charts(connection, axis, before, _since_then(folded.charts, before))
    log.info("the charts of axis '%s' are of this version now", axis_id)


def _since_then(charts: ChartsRecord, before: ChartsRecord) -> ChartsRecord:
    """Return charts whose state, where it is the same, has lasted since the moment that was said before."""
    if charts.state != before.state:
        return charts
    state = load_state(charts.monitor_state)
    state = replace(state, detector=replace(state.detector, since=before.state_since))
    return replace(charts, monitor_state=dump_state(state), state_since=before.state_since)


def _beginning(epoch: EpochRecord) -> JsonObject:
    """Return the charts as they begin an epoch, of which an older version knew more in its own way."""
    before = None if epoch.begins_at == BEGIN_OF_TIME else epoch.begins_at - _NEXT
    return dump_state(AxisState(DetectorState(last_at=before)))


def _name_epochs(connection: Connection, axis: AxisRecord, charts: ChartsRecord) -> None:
    """Keep the epochs since the calibration in force was activated, so that the charts are folded under it."""
    activated, *cleared = [
        BEGIN_OF_TIME if last is None else last + _NEXT for last in decided_since_calibration(connection, axis.id)
    ]
    save_epoch(connection, EpochRecord(axis.number, activated, UNKNOWN, charts.epoch, axis.active_calibration_id))
    for begins_at in cleared:
        save_epoch(connection, EpochRecord(axis.number, begins_at, INSPECTION))
