"""Read and write the epochs of the charts: where they begin, by what, and how the charts stood there."""

from dataclasses import dataclass
from datetime import UTC, datetime

from sqlalchemy import Connection, delete, insert, select

from service.json_types import JsonObject
from service.store.trend.tables import ChartEpochRow

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
    calibration_id: int | None = None
    state: JsonObject | None = None

    @property
    def is_hard(self) -> bool:
        """Whether what was measured before it and arrives later moves no chart any more."""
        return self.begun_by != MAINTENANCE


_EPOCHS = ChartEpochRow.metadata.tables[ChartEpochRow.__tablename__]
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
