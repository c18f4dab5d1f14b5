"""Return a row that is asked for by its number or name, or refuse a name that nothing has; remember what rows say."""

from collections.abc import Callable
from typing import TypeVar, cast

from service.errors import UnknownResourceError
from service.store.tables import CalibrationRow, MeasurementRow, PinRow, RecordingRow

Row = TypeVar("Row")
Said = TypeVar("Said")
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


class Remembered:
    """What was said of many things, each by its name, until what it rests on is another: told by a key.

    That of an axis is the revision of its row, which changes with everything that the charts, or a page of the trend,
    rest on; or the very values.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._said: dict[object, tuple[object, object]] = {}

    def of(self, name: object, key: object, say: Callable[[], Said]) -> Said:
        """Return what was said, or say it anew if the key is another one; one name stands for one kind of answer."""
        known = self._said.get(name)
        if known is None or known[0] != key:
            if len(self._said) >= self._most:
                self._said.clear()
            known = self._said[name] = key, say()
        return cast(Said, known[1])
