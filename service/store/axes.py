"""Query axes, and the log of what was done to them."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import NamedTuple

from sqlalchemy import Connection, Text, bindparam, cast, func, select
from sqlalchemy.orm import Session, defer

from monitor_core.trend import TrendStatus
from service.errors import UnknownResourceError
from service.json_types import JsonObject
from service.store.tables import AxisRow, CountsByReason, MaintenanceRow

_KEY = select(AxisRow.number, AxisRow.revision, AxisRow.active_calibration_id).where(AxisRow.id == bindparam("axis_id"))
_AXIS = select(AxisRow).where(AxisRow.id == bindparam("axis_id"))
#: What is stored of an axis as documents: its configuration, the state and the limits of its charts.
_DOCUMENTS = (AxisRow.configuration, AxisRow.monitor_state, AxisRow.detector_design)
_AS_TEXTS = select(AxisRow, *(cast(document, Text) for document in _DOCUMENTS)).options(
    *(defer(document, raiseload=True) for document in _DOCUMENTS)
)
_AXIS_AS_TEXTS = _AS_TEXTS.where(AxisRow.id == bindparam("axis_id"))
_LOG = (
    select(MaintenanceRow)
    .where(MaintenanceRow.axis_id == bindparam("axis_id"))
    .order_by(MaintenanceRow.at, MaintenanceRow.id)
)
_CORRECTED = select(MaintenanceRow.corrects).where(
    MaintenanceRow.axis_id == bindparam("axis_id"), MaintenanceRow.corrects.is_not(None)
)
_ENTRIES = (
    select(MaintenanceRow.at)
    .where(
        MaintenanceRow.axis_id == bindparam("axis_id"),
        MaintenanceRow.kind.in_(bindparam("kinds", expanding=True)),
        MaintenanceRow.id.not_in(_CORRECTED),
    )
    .order_by(MaintenanceRow.at)
)
#: Entries of the log.
LUBRICATED, NUT_REPLACED, SCREW_REPLACED = "lubricated", "nut-replaced", "screw-replaced"
#: With another nut or screw it is another axis that the charts watch.
RENEWALS = (NUT_REPLACED, SCREW_REPLACED)
Documents = tuple[str | None, ...]


def get_axis(session: Session, axis_id: str) -> AxisRow:
    """Return an axis or say that there is none of that name."""
    row = session.scalars(_AXIS, {"axis_id": axis_id}).one_or_none()
    if row is None:
        raise no_axis(axis_id)
    return row


def no_axis(axis_id: str) -> UnknownResourceError:
    """Return the refusal of an identifier that no axis has."""
    return UnknownResourceError(f"no axis '{axis_id}' is registered; register it with PUT /v1/axes/{axis_id}")


def new_axis(session: Session, axis_id: str, at: datetime) -> AxisRow:
    """Return the row of an axis that nothing is known of: name and configuration are still to be set."""
    number = session.scalar(select(func.coalesce(func.max(AxisRow.number), 0) + 1))
    return AxisRow(
        id=axis_id, number=number, created_at=at, active_calibration_id=None, monitor_state=None, epoch=0,
        epoch_after=None, epoch_from=None, epoch_begins_at=None, archived_at=None, since_checkpoint=0,
        state=str(TrendStatus.UNKNOWN), state_since=None,
        last_charted_at=None, last_measurement_id=None, last_measured_at=None, refused_windows={}, uncharted={},
    )  # fmt: skip


def list_axes(session: Session) -> list[AxisRow]:
    """Return all axes in order of name."""
    return list(session.scalars(select(AxisRow).order_by(AxisRow.id)))


def axis_with_documents(session: Session, axis_id: str) -> tuple[AxisRow, Documents]:
    """Return an axis without its documents, and their texts; say so if there is none of that name."""
    row_and_texts = session.execute(_AXIS_AS_TEXTS, {"axis_id": axis_id}).one_or_none()
    if row_and_texts is None:
        raise no_axis(axis_id)
    row, *texts = row_and_texts
    return row, tuple(texts)


def axes_with_documents(session: Session) -> list[tuple[AxisRow, Documents]]:
    """Return all axes in order of name without their documents, and the texts of these: most are known already."""
    return [(row, tuple(texts)) for row, *texts in session.execute(_AS_TEXTS.order_by(AxisRow.id))]


@dataclass(frozen=True, slots=True)
class CountedAxis:
    """What is counted of an axis."""

    archived_at: datetime | None
    refused_windows: CountsByReason
    uncharted: CountsByReason


def counted(session: Session) -> list[CountedAxis]:
    """Return what is counted of each axis."""
    query = select(AxisRow.archived_at, AxisRow.refused_windows, AxisRow.uncharted)
    return [CountedAxis(*row) for row in session.execute(query)]


def configurations(session: Session) -> dict[str, JsonObject]:
    """Return the configuration of each axis, as it is stored."""
    return {row.id: row.configuration for row in session.execute(select(AxisRow.id, AxisRow.configuration))}


def silences(session: Session) -> list[tuple[datetime, float]]:
    """Return when each axis was last heard, and after how many hours without a word it counts as silent."""
    hours = AxisRow.configuration["silent_after_hours"].as_float()
    heard = select(AxisRow.last_charted_at, hours).where(AxisRow.last_charted_at.is_not(None))
    return [(last_at, hours) for last_at, hours in session.execute(heard) if hours is not None]


class AxisKey(NamedTuple):
    """What the trend of an axis is found by, and told apart from what it was before."""

    number: int
    revision: int  # how often its row was changed: with every measurement that was judged, for one
    calibration_id: int | None  # in force


def key_of(connection: Session | Connection, axis_id: str) -> AxisKey:
    """Return the key of an axis or say that there is none of that name."""
    row = connection.execute(_KEY, {"axis_id": axis_id}).one_or_none()
    if row is None:
        raise no_axis(axis_id)
    return AxisKey._make(row)


def names(session: Session) -> dict[str, str]:
    """Return what each axis is called."""
    return {row.id: row.name for row in session.execute(select(AxisRow.id, AxisRow.name))}


def revisions(session: Session) -> dict[str, int]:
    """Return how often the row of each axis was changed."""
    return {row.id: row.revision for row in session.execute(select(AxisRow.id, AxisRow.revision))}


def maintenance_log(session: Session, axis_id: str) -> list[MaintenanceRow]:
    """Return all entries of an axis by when the work was done, corrected ones included."""
    return list(session.scalars(_LOG, {"axis_id": axis_id}))


def standing_entries(log: list[MaintenanceRow]) -> list[MaintenanceRow]:
    """Return the entries of a log that no other one corrects."""
    corrected = {row.corrects for row in log}
    return [row for row in log if row.id not in corrected]


def lubrications_of(connection: Connection, axis_id: str) -> list[datetime]:
    """Return when an axis was lubricated, by the entries of its log that no other one corrects, in order of time."""
    return list(connection.scalars(_ENTRIES, {"axis_id": axis_id, "kinds": [LUBRICATED]}))


def was_lubricated(lubrications: Sequence[datetime], after: datetime | None, until: datetime) -> bool:
    """Tell whether an axis was lubricated between two moments, of which the earlier one may be none."""
    return after is not None and bisect_right(lubrications, until) > bisect_right(lubrications, after)


def newest_renewals(connection: Connection) -> dict[str, datetime]:
    """Return when each axis got its newest nut or screw, of those that got one."""
    corrected = select(MaintenanceRow.corrects).where(MaintenanceRow.corrects.is_not(None))
    query = select(MaintenanceRow.axis_id, func.max(MaintenanceRow.at).label("at")).where(
        MaintenanceRow.kind.in_(RENEWALS), MaintenanceRow.id.not_in(corrected)
    )
    return {row.axis_id: row.at for row in connection.execute(query.group_by(MaintenanceRow.axis_id))}


def renewals_of(connection: Connection, axis_id: str) -> list[datetime]:
    """Return when an axis got another nut or screw, as :func:`lubrications_of` does."""
    return list(connection.scalars(_ENTRIES, {"axis_id": axis_id, "kinds": RENEWALS}))
