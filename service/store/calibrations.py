"""Query calibrations, and which was in force when."""

from datetime import datetime

from sqlalchemy import Connection, bindparam, select, update
from sqlalchemy.orm import Session

from monitor_core.errors import RecordingFormatError
from monitor_core.preload import Calibration
from monitor_core.recordings.calibration_file import calibration_from_document
from service.errors import DocumentDamagedError, PreconditionError
from service.store.intake import AxisRecord
from service.store.lookup import Remembered, existing_of
from service.store.tables import ActivationRow, AxisRow, CalibrationRow

MOST_KNOWN = 1000
# Statements are built once: to build one takes longer than to run it.
_CALIBRATIONS = (
    select(CalibrationRow).where(CalibrationRow.axis_id == bindparam("axis_id")).order_by(CalibrationRow.id.desc())
)
_ACTIVATIONS = (
    select(ActivationRow).where(ActivationRow.axis_id == bindparam("axis_id")).order_by(ActivationRow.id.desc())
)


def get_calibration(session: Session, axis_id: str, calibration_id: int) -> CalibrationRow:
    """Return one calibration of an axis or say that there is none."""
    return existing_of(axis_id, session.get(CalibrationRow, calibration_id), f"calibration {calibration_id}")


def require_in_force(axis: AxisRow, expected: str | None) -> None:
    """Raise PreconditionError if another calibration than the expected one is in force; None expects nothing."""
    in_force = "none" if axis.active_calibration_id is None else str(axis.active_calibration_id)
    if expected is not None and expected.strip().strip('"') != in_force:
        raise PreconditionError(f'If-Match must name the calibration in force, "{in_force}"; got {expected}')


def active_calibration(session: Session, axis: AxisRow) -> Calibration | None:
    """Return the calibration in force, as the core's record."""
    if axis.active_calibration_id is None:
        return None
    return _read(session, axis.id, axis.active_calibration_id)


def _read(session: Session, axis_id: str, number: int) -> Calibration:
    document = get_calibration(session, axis_id, number).document
    try:
        return calibration_from_document(document)
    except RecordingFormatError as error:
        raise DocumentDamagedError(
            f"calibration {number} of this axis, as it is stored, cannot be read: {error}; restore the backup, or "
            "activate another calibration"
        ) from error


class CalibrationsInForce:
    """Calibrations as the core's records. A stored one never changes, so that each is read and checked once."""

    def __init__(self) -> None:
        self._known = Remembered(MOST_KNOWN)

    def of(self, connection: Connection, axis: AxisRecord) -> Calibration | None:
        """Return the calibration in force on an axis."""
        return self.numbered(connection, axis.id, axis.active_calibration_id)

    def numbered(self, connection: Connection, axis_id: str, number: int | None) -> Calibration | None:
        """Return the calibration of an axis that has a number; None for none."""
        if number is None:
            return None

        def read() -> Calibration:
            with Session(connection) as session:
                return _read(session, axis_id, number)

        return self._known.of((axis_id, number), None, read)


def list_calibrations(session: Session, axis_id: str) -> list[CalibrationRow]:
    """Return the calibrations of an axis, newest first."""
    return list(session.scalars(_CALIBRATIONS, {"axis_id": axis_id}))


def list_activations(session: Session, axis_id: str) -> list[ActivationRow]:
    """Return the history of activations of an axis, newest first."""
    return list(session.scalars(_ACTIVATIONS, {"axis_id": axis_id}))


def date_back(session: Session, axis_id: str, at: datetime) -> None:
    """Let the calibrations of an axis have been fitted and activated at a moment."""
    session.execute(update(CalibrationRow).where(CalibrationRow.axis_id == axis_id).values(created_at=at))
    session.execute(update(ActivationRow).where(ActivationRow.axis_id == axis_id).values(activated_at=at))
