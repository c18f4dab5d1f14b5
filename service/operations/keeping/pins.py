"""Pins: waveforms that are kept whatever their age, because somebody says so and why."""

from dataclasses import dataclass
from datetime import datetime

from service.clock import now
from service.errors import UnknownResourceError
from service.store import measurements, retention
from service.store.axes import get_axis
from service.store.database import Database
from service.store.retention import settled_with
from service.store.tables import PinRow


@dataclass(frozen=True, slots=True)
class Reason:
    """Why something is pinned, and by whom."""

    reason: str
    who: str


class Pins:
    """Makes, lists and removes pins."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def pin_measurement(self, axis_id: str, measurement_id: int, why: Reason) -> PinRow:
        """Keep the waveforms of a measurement; if it is pinned already, for this reason from now on.

        Raises LetGoError if they were let go.
        """
        with self._database.write() as session, settled_with(session.connection()):
            measurements.get_measurement(session, axis_id, measurement_id)
            retention.require_stored(session.connection(), [measurement_id])
            row = retention.pin_of_measurement(session, measurement_id)
            if row is None:
                row = PinRow(
                    axis_id=axis_id, measurement_id=measurement_id, start_at=None, end_at=None,
                    reason=why.reason, who=why.who, at=now(),
                )  # fmt: skip
                session.add(row)
            row.reason, row.who, row.at = why.reason, why.who, now()
            return row

    def unpin_measurement(self, axis_id: str, measurement_id: int) -> PinRow:
        """Let the rule decide about a measurement again; return the pin that it had."""
        with self._database.write() as session, settled_with(session.connection()):
            measurements.get_measurement(session, axis_id, measurement_id)
            row = retention.pin_of_measurement(session, measurement_id)
            if row is None:
                raise UnknownResourceError(f"measurement {measurement_id} is not pinned")
            session.delete(row)
            return row

    def pin_span(self, axis_id: str, span: tuple[datetime, datetime], why: Reason) -> PinRow:
        """Keep what is still stored of the measurements of an axis that began in a span, and what is yet to come."""
        with self._database.write() as session, settled_with(session.connection()):
            get_axis(session, axis_id)
            start, end = span
            row = PinRow(
                axis_id=axis_id, measurement_id=None, start_at=start, end_at=end,
                reason=why.reason, who=why.who, at=now(),
            )  # fmt: skip
            session.add(row)
            return row

    def remove(self, axis_id: str, pin_id: int) -> PinRow:
        """Let the rule decide again about what a pin kept; return it as it was."""
        with self._database.write() as session, settled_with(session.connection()):
            row = session.get(PinRow, pin_id)
            if row is None or row.axis_id != axis_id:
                raise UnknownResourceError(f"axis '{axis_id}' has no pin {pin_id}")
            session.delete(row)
            return row

    def list(self, axis_id: str, before_id: int | None, limit: int) -> list[PinRow]:
        """Return pins of an axis, newest first."""
        with self._database.read() as session:
            get_axis(session, axis_id)
            return retention.list_pins(session, axis_id, before_id, limit)
