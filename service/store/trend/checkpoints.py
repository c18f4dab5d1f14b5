"""Keep how the charts of an axis stood after some of its measurements, newest first, and no more than are needed."""

from datetime import datetime

from sqlalchemy import Connection, delete, insert, select

from service.json_types import JsonObject
from service.store.trend.tables import ChartCheckpointRow

_CHECKPOINTS = ChartCheckpointRow.metadata.tables[ChartCheckpointRow.__tablename__]


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
