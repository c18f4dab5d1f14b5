"""Query measurements and their windows."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Connection, Select, bindparam, func, select, text
from sqlalchemy.orm import Session

from service.json_types import JsonObject
from service.store.intake import JUDGED, REFUSED
from service.store.lookup import existing_of
from service.store.retention import require_stored
from service.store.tables import PLACE, AxisRow, MeasurementDocumentRow, MeasurementRow, WindowRow, microseconds_of
from service.store.trend.points import POINTS, Span
from service.store.trend.shown import points_at
from service.store.waveforms import WaveformPlace

#: Built once: to build it takes longer than to run it.
_ACCEPTED = (
    select(*PLACE)
    .where(WindowRow.measurement_id == bindparam("measurement_id"), WindowRow.refusal_reason.is_(None))
    .order_by(WindowRow.started_at)
)
_AT = (
    select(*PLACE, WindowRow.measurement_id)
    .where(WindowRow.axis_id == bindparam("axis_id"), WindowRow.started_at.in_(bindparam("starts", expanding=True)))
    .order_by(WindowRow.started_at)
)


def get_measurement(session: Session, axis_id: str, measurement_id: int) -> MeasurementRow:
    """Return one measurement or say that there is none."""
    return existing_of(axis_id, session.get(MeasurementRow, measurement_id), f"measurement {measurement_id}")


def windows_of(session: Session, measurement_id: int) -> list[WindowRow]:
    """Return the windows of a measurement, in time order."""
    query = select(WindowRow).where(WindowRow.measurement_id == measurement_id)
    return list(session.scalars(query.order_by(WindowRow.started_at)))


def accepted_places(connection: Session | Connection, measurement_id: int) -> list[WaveformPlace]:
    """Tell where the accepted windows of a measurement lie, in time order; raises LetGoError if they were let go."""
    rows = connection.execute(_ACCEPTED, {"measurement_id": measurement_id})
    places = [WaveformPlace(*row) for row in rows]
    if any(not place.path for place in places):
        require_stored(connection, [measurement_id])
    return places


def places_at(connection: Connection, axis_id: str, starts: Collection[datetime]) -> list[WaveformPlace]:
    """Tell where stored windows of an axis lie, in time order; raises LetGoError if they were let go."""
    rows = connection.execute(_AT, {"axis_id": axis_id, "starts": list(starts)}).all()
    if gone := {row[4] for row in rows if not row[0]}:
        require_stored(connection, gone)
    return [WaveformPlace(*row[:4]) for row in rows]


def calibration_measurements(
    session: Session, axis_id: str, start: datetime | None, end: datetime | None
) -> list[MeasurementRow]:
    """Return measurements that were looked at and whose preload was set on purpose, in time order."""
    query = _looked_at(axis_id, start, end).where(MeasurementRow.set_preload_n.is_not(None))
    return list(session.scalars(query.order_by(MeasurementRow.started_at, MeasurementRow.id)))


@dataclass(frozen=True, slots=True)
class SetMeasurement:
    """A measurement whose preload was set on purpose; its frequency is None if the mode was not found, or not yet."""

    id: int
    started_at: datetime
    position_mm: float
    set_preload_n: float
    status: str  # open | judged | refused
    n_accepted: int
    frequency_hz: float | None
    refusal_reason: str | None
    payload_kg: float | None
    temperature_c: float | None


def set_measurements(session: Session, axis: AxisRow, most: int) -> list[SetMeasurement]:
    """Return the newest measurements whose preload was set on purpose, in time order, those under way included."""
    query = (
        select(MeasurementRow)
        .where(MeasurementRow.axis_id == axis.id, MeasurementRow.set_preload_n.is_not(None))
        .order_by(MeasurementRow.started_at.desc(), MeasurementRow.id.desc())
        .limit(most)
    )
    rows = list(session.scalars(query))[::-1]
    points = points_at(session.connection(), axis.number, [microseconds_of(row.started_at) for row in rows])
    judged = {
        point.measurement_id: (point.frequency_hz, point.refusal_reason, point.payload_kg, point.temperature_c)
        for point in points
    }
    return [
        SetMeasurement(
            row.id, row.started_at, row.position_mm, row.set_preload_n, row.status, row.n_accepted,
            *judged.get(row.id, (None,) * 4),
        )
        for row in rows
        if row.set_preload_n is not None
    ]  # fmt: skip


def looked_at(
    session: Session, axis_id: str, start: datetime | None, end: datetime | None, limit: int
) -> list[MeasurementRow]:
    """Return measurements that were judged or refused, in time order, and one more than the limit if there are more."""
    query = _looked_at(axis_id, start, end).order_by(MeasurementRow.started_at, MeasurementRow.id)
    return list(session.scalars(query.limit(limit + 1)))


def newest_monitored(
    session: Session, axis_id: str, start: datetime, end: datetime | None, limit: int
) -> list[MeasurementRow]:
    """Return the newest judged measurements whose preload was not set on purpose, in time order.

    Those whose waveforms were let go are passed over.
    """
    query = _monitored(axis_id, start, end)
    newest_first = query.order_by(MeasurementRow.started_at.desc(), MeasurementRow.id.desc()).limit(limit)
    return list(session.scalars(newest_first))[::-1]


def first_without_payload(
    session: Session, axis_id: str, start: datetime | None, end: datetime | None, limit: int
) -> list[MeasurementRow]:
    """Return the first ones that carry no payload, as :func:`newest_monitored`."""
    number = select(AxisRow.number).where(AxisRow.id == axis_id).scalar_subquery()
    query = (
        _monitored(axis_id, start, end)
        .join(POINTS, POINTS.c.measurement_id == MeasurementRow.id)
        .where(POINTS.c.axis_number == number, func.coalesce(POINTS.c.payload_kg, 0.0) == 0.0)
        .order_by(POINTS.c.at, POINTS.c.measurement_id)
    )
    return list(session.scalars(query.limit(limit)))


def _monitored(axis_id: str, start: datetime | None, end: datetime | None) -> Select[MeasurementRow]:
    let_go = select(WindowRow.id).where(WindowRow.measurement_id == MeasurementRow.id, WindowRow.let_go_by.is_not(None))
    return _looked_at(axis_id, start, end).where(
        MeasurementRow.status == JUDGED, MeasurementRow.set_preload_n.is_(None), ~let_go.exists()
    )


def count_open(session: Session) -> int:
    """Count the measurements that wait for further windows."""
    # as the index has it: a parameter would hide it from the database
    query = select(func.count()).select_from(MeasurementRow).where(text("measurements.status = 'open'"))
    return int(session.scalar(query) or 0)


def newest_window(session: Session) -> WindowRow | None:
    """Return the window that arrived last, of any axis."""
    return session.scalar(select(WindowRow).order_by(WindowRow.id.desc()).limit(1))


def _looked_at(axis_id: str, start: datetime | None = None, end: datetime | None = None) -> Select[MeasurementRow]:
    of_axis = (MeasurementRow.axis_id == axis_id, MeasurementRow.status.in_((JUDGED, REFUSED)))
    return select(MeasurementRow).where(*of_axis, *Span(start, end).bounds(MeasurementRow.started_at))


def responses_of(session: Session, measurement_ids: Sequence[int]) -> dict[int, tuple[JsonObject, JsonObject]]:
    """Return the stored outcomes and frequency responses of measurements; one without a response is left out."""
    row = MeasurementDocumentRow
    stored = session.execute(
        select(row.measurement_id, row.outcome, row.response).where(row.measurement_id.in_(measurement_ids))
    )
    return {number: (outcome, response) for number, outcome, response in stored if response is not None}
