"""Rows of measurements and their windows."""

from collections.abc import Iterable
from datetime import datetime

from sqlalchemy import and_, func, or_, select
from sqlalchemy.orm import Session

from service.errors import UnknownResourceError
from service.store.tables import MeasurementRow, WindowRow

#: Life of a measurement: windows arrive → no more are awaited → looked at.
OPEN, COMPLETE, JUDGED, REFUSED = "open", "complete", "judged", "refused"


def windows_at(session: Session, axis_id: str, moments: Iterable[datetime]) -> dict[datetime, WindowRow]:
    """Return the stored windows of an axis that started at these moments."""
    rows = session.scalars(
        select(WindowRow).where(WindowRow.axis_id == axis_id, WindowRow.started_at.in_(list(moments)))
    )
    return {row.started_at: row for row in rows}


def measurements_named(session: Session, axis_id: str, names: Iterable[str]) -> dict[str, MeasurementRow]:
    """Return the measurements of an axis with these names."""
    rows = session.scalars(
        select(MeasurementRow).where(MeasurementRow.axis_id == axis_id, MeasurementRow.name.in_(list(names)))
    )
    return {row.name: row for row in rows}


def get_measurement(session: Session, axis_id: str, measurement_id: int) -> MeasurementRow:
    """Return one measurement or say that there is none."""
    row = session.get(MeasurementRow, measurement_id)
    if row is None or row.axis_id != axis_id:
        raise UnknownResourceError(f"axis '{axis_id}' has no measurement {measurement_id}")
    return row


def measurements_with_status(session: Session, axis_id: str, status: str) -> list[MeasurementRow]:
    """Return the measurements of an axis in one status, in time order."""
    return list(
        session.scalars(
            select(MeasurementRow)
            .where(MeasurementRow.axis_id == axis_id, MeasurementRow.status == status)
            .order_by(MeasurementRow.started_at, MeasurementRow.id)
        )
    )


def axes_with_complete_measurements(session: Session) -> list[str]:
    """Return the axes where work was left when the service last stopped."""
    return list(session.scalars(select(MeasurementRow.axis_id).where(MeasurementRow.status == COMPLETE).distinct()))


def windows_of(session: Session, measurement_id: int, *, accepted_only: bool = False) -> list[WindowRow]:
    """Return the windows of a measurement, in time order."""
    query = select(WindowRow).where(WindowRow.measurement_id == measurement_id)
    if accepted_only:
        query = query.where(WindowRow.refusal_reason.is_(None))
    return list(session.scalars(query.order_by(WindowRow.started_at)))


def accepted_windows(session: Session, measurement_id: int) -> int:
    """Count the accepted windows of a measurement."""
    query = select(func.count()).where(WindowRow.measurement_id == measurement_id, WindowRow.refusal_reason.is_(None))
    return int(session.scalar(query) or 0)


def refused_windows(session: Session, axis_id: str) -> dict[str, int]:
    """Count the refused windows of an axis by reason."""
    query = (
        select(WindowRow.refusal_reason, func.count())
        .where(WindowRow.axis_id == axis_id, WindowRow.refusal_reason.is_not(None))
        .group_by(WindowRow.refusal_reason)
    )
    return {reason: count for reason, count in session.execute(query) if reason is not None}


def last_looked_at(session: Session, axis_id: str) -> MeasurementRow | None:
    """Return the newest measurement that was judged or refused."""
    query = (
        select(MeasurementRow)
        .where(MeasurementRow.axis_id == axis_id, MeasurementRow.status.in_((JUDGED, REFUSED)))
        .order_by(MeasurementRow.started_at.desc(), MeasurementRow.id.desc())
        .limit(1)
    )
    return session.scalars(query).first()


def trend_page(
    session: Session,
    axis_id: str,
    *,
    start: datetime | None,
    end: datetime | None,
    after: tuple[datetime, int] | None,
    limit: int,
) -> list[MeasurementRow]:
    """Return measurements that were looked at, in time order, after a cursor."""
    query = select(MeasurementRow).where(
        MeasurementRow.axis_id == axis_id, MeasurementRow.status.in_((JUDGED, REFUSED))
    )
    if start is not None:
        query = query.where(MeasurementRow.started_at >= start)
    if end is not None:
        query = query.where(MeasurementRow.started_at < end)
    if after is not None:
        moment, identity = after
        query = query.where(
            or_(
                MeasurementRow.started_at > moment,
                and_(MeasurementRow.started_at == moment, MeasurementRow.id > identity),
            )
        )
    return list(session.scalars(query.order_by(MeasurementRow.started_at, MeasurementRow.id).limit(limit)))
