"""Query the maintenance log: what was done to an axis."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from service.store.tables import MaintenanceRow


def log_of(session: Session, axis_id: str) -> list[MaintenanceRow]:
    """Return all entries of an axis by when the work was done, corrected ones included."""
    query = select(MaintenanceRow).where(MaintenanceRow.axis_id == axis_id)
    return list(session.scalars(query.order_by(MaintenanceRow.at, MaintenanceRow.id)))


def standing(log: list[MaintenanceRow]) -> list[MaintenanceRow]:
    """Return the entries of a log that no other one corrects."""
    corrected = {row.corrects for row in log}
    return [row for row in log if row.id not in corrected]
