"""Rows of axes."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from service.errors import UnknownResourceError
from service.store.tables import AxisRow


def get_axis(session: Session, axis_id: str) -> AxisRow:
    """Return an axis or say that there is none of that name."""
    row = session.get(AxisRow, axis_id)
    if row is None:
        raise UnknownResourceError(f"no axis '{axis_id}' is registered; register it with PUT /v1/axes/{axis_id}")
    return row


def list_axes(session: Session) -> list[AxisRow]:
    """Return all axes in order of name."""
    return list(session.scalars(select(AxisRow).order_by(AxisRow.id)))
