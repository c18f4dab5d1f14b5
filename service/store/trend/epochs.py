"""Read and write how the charts stood: where their epochs begin, and after some of the measurements since."""

from dataclasses import dataclass
from datetime import UTC, datetime

from sqlalchemy import BigInteger, Column, Connection, Integer, String, Table, delete, func, insert, select

from service.json_types import JsonObject
from service.store.alarms import CLEARED
from service.store.tables import (
    ActivationRow,
    AlarmEventRow,
    AlarmRow,
    AxisRow,
    Base,
    MeasurementRow,
    NullableJson,
    UtcMicroseconds,
)
from service.store.trend.tables import table_of

CALIBRATION, INSPECTION, MAINTENANCE = "calibration", "inspection", "maintenance"
#: By an older version of the program, which did not keep what it was begun by.
UNKNOWN = "unknown"
#: Of an epoch that everything belongs to that was ever measured.
BEGIN_OF_TIME = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class EpochRecord:
    """Where an epoch begins. ``epoch`` counts them in order of time; None: the charts have not come there yet."""

    axis_number: int
    begins_at: datetime
    begun_by: str
    epoch: int | None = None
    calibration_id: int | None = None  # that it is charted under
    state: JsonObject | None = None  # of the charts when it begins

    @property
    def is_hard(self) -> bool:
        """Whether what was measured before it and arrives later moves no chart any more."""
        return self.begun_by != MAINTENANCE


_EPOCHS = table_of(
    "chart_epochs",
    EpochRecord,
    key=("axis_number", "begins_at", "begun_by"),
    types={"begun_by": String(16), "calibration_id": BigInteger(), "state": NullableJson},
)
_COLUMNS = [_EPOCHS.c[name] for name in EpochRecord.__slots__]


def epochs_of(connection: Connection, axis_number: int) -> list[EpochRecord]:
    """Return the epochs of an axis in order of time."""
    query = select(*_COLUMNS).where(_EPOCHS.c.axis_number == axis_number)
    return [EpochRecord(*row) for row in connection.execute(query.order_by(_EPOCHS.c.begins_at, _EPOCHS.c.begun_by))]


def save_epoch(connection: Connection, epoch: EpochRecord) -> None:
    """Store an epoch, in place of one that is begun by the same at the same moment."""
    forget_epoch(connection, epoch)
    connection.execute(insert(_EPOCHS), {name: getattr(epoch, name) for name in EpochRecord.__slots__})


def forget_epoch(connection: Connection, epoch: EpochRecord) -> None:
    """Remove an epoch."""
    connection.execute(
        delete(_EPOCHS).where(
            _EPOCHS.c.axis_number == epoch.axis_number,
            _EPOCHS.c.begins_at == epoch.begins_at,
            _EPOCHS.c.begun_by == epoch.begun_by,
        )
    )


def without_epochs(connection: Connection, axis_id: str | None = None) -> set[str]:
    """Return the axes, or the one, whose charts are in no epoch of the calibration in force: its program kept none."""
    kept = select(_EPOCHS.c.epoch).where(
        _EPOCHS.c.axis_number == AxisRow.number,
        _EPOCHS.c.epoch == AxisRow.epoch,
        _EPOCHS.c.calibration_id == AxisRow.active_calibration_id,
    )
    query = select(AxisRow.id).where(AxisRow.active_calibration_id.is_not(None), ~kept.exists())
    if axis_id is not None:
        query = query.where(AxisRow.id == axis_id)
    return set(connection.scalars(query))


def decided_since_calibration(connection: Connection, axis_id: str) -> list[datetime | None]:
    """Tell after which measurement the calibration in force was activated, then alarms were cleared; None: before all.

    As a program saw it that did not keep epochs, and charted measurements as they arrived.
    """
    activated = select(func.max(ActivationRow.activated_at)).where(ActivationRow.axis_id == axis_id)
    since = connection.scalar(activated)
    cleared = select(AlarmEventRow.at).join(AlarmRow, AlarmRow.id == AlarmEventRow.alarm_id)
    cleared = cleared.where(AlarmRow.axis_id == axis_id, AlarmEventRow.new_status == CLEARED, AlarmEventRow.at > since)
    last = select(func.max(MeasurementRow.started_at)).where(MeasurementRow.axis_id == axis_id)
    return [
        connection.scalar(last.where(MeasurementRow.judged_at <= moment))
        for moment in (since, *connection.scalars(cleared.order_by(AlarmEventRow.at)))
    ]


#: The charts of an axis as they stood after a measurement: what arrives late is put in from there.
_CHECKPOINTS = Table(
    "chart_checkpoints",
    Base.metadata,
    Column("axis_number", Integer, primary_key=True),
    Column("epoch", Integer, primary_key=True),
    Column("at", UtcMicroseconds, primary_key=True),
    Column("state", NullableJson, nullable=False),
    sqlite_with_rowid=False,
)


def checkpoint_before(
    connection: Connection, axis_number: int, epoch: int, at: datetime
) -> tuple[datetime, JsonObject] | None:
    """Return the last checkpoint of an epoch before a moment, and when it was."""
    query = (
        select(_CHECKPOINTS.c.at, _CHECKPOINTS.c.state)
        .where(_CHECKPOINTS.c.axis_number == axis_number, _CHECKPOINTS.c.epoch == epoch, _CHECKPOINTS.c.at < at)
        .order_by(_CHECKPOINTS.c.at.desc())
        .limit(1)
    )
    row = connection.execute(query).first()
    return None if row is None else (row.at, row.state)


def forget_checkpoints(connection: Connection, axis_number: int, epoch: int, after: datetime | None) -> None:
    """Remove the checkpoints of an epoch after a moment, by default all: a late measurement changed what they hold."""
    of_epoch = delete(_CHECKPOINTS).where(_CHECKPOINTS.c.axis_number == axis_number, _CHECKPOINTS.c.epoch == epoch)
    connection.execute(of_epoch if after is None else of_epoch.where(_CHECKPOINTS.c.at > after))


def forget_checkpoints_beyond(connection: Connection, axis_number: int, epoch: int) -> None:
    """Remove the checkpoints of all epochs later than one."""
    later = (_CHECKPOINTS.c.axis_number == axis_number, _CHECKPOINTS.c.epoch > epoch)
    connection.execute(delete(_CHECKPOINTS).where(*later))


def add_checkpoint(
    connection: Connection, axis_number: int, epoch: int, at: datetime, state: JsonObject, *, most: int
) -> datetime | None:
    """Store a checkpoint and forget the oldest beyond so many.

    Returned is when the oldest that is left was, if some were forgotten: before it the charts cannot be folded again.
    """
    connection.execute(insert(_CHECKPOINTS), {"axis_number": axis_number, "epoch": epoch, "at": at, "state": state})
    of_axis = (_CHECKPOINTS.c.axis_number == axis_number, _CHECKPOINTS.c.epoch == epoch)
    oldest = connection.execute(
        select(_CHECKPOINTS.c.at).where(*of_axis).order_by(_CHECKPOINTS.c.at.desc()).limit(1).offset(most - 1)
    ).scalar()
    if oldest is None:
        return None
    forgotten = connection.execute(delete(_CHECKPOINTS).where(*of_axis, _CHECKPOINTS.c.at < oldest)).rowcount
    return oldest if forgotten else None
