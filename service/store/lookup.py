"""Return a row that is asked for by its number or name, or refuse a name that nothing has."""

from typing import TypeVar

from service.errors import UnknownResourceError
from service.store.tables import CalibrationRow, MeasurementRow, PinRow, RecordingRow

Row = TypeVar("Row")
RowOfAxis = TypeVar("RowOfAxis", CalibrationRow, MeasurementRow, PinRow, RecordingRow)


def existing(row: Row | None, name: str) -> Row:
    """Return a row; raises UnknownResourceError where there is none of this name, such as "alarm 7"."""
    if row is None:
        raise UnknownResourceError(f"there is no {name}")
    return row


def existing_of(axis_id: str, row: RowOfAxis | None, name: str) -> RowOfAxis:
    """Return a row of an axis; raises UnknownResourceError where the axis has none of this name."""
    if row is None or row.axis_id != axis_id:
        raise UnknownResourceError(f"axis '{axis_id}' has no {name}")
    return row
