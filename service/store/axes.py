"""Query axes."""

from sqlalchemy import bindparam, select
from sqlalchemy.orm import Session

from service.errors import UnknownResourceError
from service.store.tables import AxisRow

_AXIS = select(AxisRow).where(AxisRow.id == bindparam("axis_id"))


def get_axis(session: Session, axis_id: str) -> AxisRow:
    """Return an axis or say that there is none of that name."""
    row = session.scalars(_AXIS, {"axis_id": axis_id}).one_or_none()
    if row is None:
        raise UnknownResourceError(f"no axis '{axis_id}' is registered; register it with PUT /v1/axes/{axis_id}")
    return row


def list_axes(session: Session) -> list[AxisRow]:
    """Return all axes in order of name."""
    return list(session.scalars(select(AxisRow).order_by(AxisRow.id)))
