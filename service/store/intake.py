"""Read and write what one posted window needs: plain records, one statement each.

The other repositories work with mapped rows. Here, where every window passes, looking after mapped rows would take
several times as long as the statements themselves.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Connection, bindparam, delete, func, insert, select, update
from sqlalchemy.orm.exc import StaleDataError

from monitor_core.recording import Placed, Rejection, RejectionReason
from monitor_core.recordings.elements.units import metres
from service.json_types import JsonObject
from service.store.axes import no_axis
from service.store.tables import (
    AlarmRow,
    AxisRow,
    CountsByReason,
    MeasurementDocumentRow,
    MeasurementRow,
    PinRow,
    RejudgedRow,
    WindowRow,
)

#: Life of a measurement: windows arrive → looked at.
OPEN, JUDGED, REFUSED = "open", "judged", "refused"
#: Of a refusal, as it fits into a row.
LONGEST_DETAIL = 500
#: Of a pin.
LONGEST_REASON = 1000


@dataclass(slots=True)
class AxisRecord:
    """An axis as far as its windows need it."""

    id: str
    number: int
    configuration: JsonObject
    active_calibration_id: int | None
    revision: int
    archived_at: datetime | None
    newest_window_at: datetime | None  # start of the last of its stored windows


@dataclass(frozen=True, slots=True)
class ChartsRecord:
    """Where the charts of an axis stand, and what is counted of it. Wanted only where something of it changes."""

    detector_design: JsonObject
    monitor_state: JsonObject | None
    epoch: int
    epoch_after: datetime | None
    epoch_from: datetime | None
    epoch_begins_at: datetime | None
    last_charted_at: datetime | None
    since_checkpoint: int
    state: str
    state_since: datetime | None
    last_measurement_id: int | None
    last_measured_at: datetime | None
    refused_windows: CountsByReason
    uncharted: CountsByReason


@dataclass(slots=True)
class MeasurementRecord:
    """A measurement that takes windows, or took them; one that nothing is stored of has no ``id``."""

    axis_id: str
    name: str
    started_at: datetime
    ended_at: datetime
    position_mm: float
    set_preload_n: float | None
    closes_at: datetime | None
    status: str = OPEN
    n_accepted: int = 0
    calibration_id: int | None = None
    revision: int = 1
    id: int | None = None


@dataclass(frozen=True, slots=True)
class WindowRecord:
    """A new window: where its waveform lies and whether it was accepted."""

    axis_id: str
    measurement_id: int | None
    started_at: datetime
    received_at: datetime
    content_sha256: str
    file_path: str
    offset_in_file: int
    index_in_frame: int
    refusal_reason: str | None
    refusal_detail: str | None
    ended_at: datetime
    position_mm: float
    set_preload_n: float | None


@dataclass(frozen=True, slots=True)
class StoredMember:
    """A stored window of a measurement, and whether it is averaged there."""

    placed: Placed
    accepted: bool


_AXES, _MEASUREMENTS, _WINDOWS, _DOCUMENTS, _PINS = (
    mapped.metadata.tables[mapped.__tablename__]
    for mapped in (AxisRow, MeasurementRow, WindowRow, MeasurementDocumentRow, PinRow)
)
# Statements are built once: to build one takes longer than to run it.
_CHARTS = select(*(_AXES.c[name] for name in ChartsRecord.__slots__)).where(_AXES.c.id == bindparam("axis_id"))
_NEWEST = select(func.max(_WINDOWS.c.started_at)).where(_WINDOWS.c.axis_id == _AXES.c.id).scalar_subquery()
_AXIS = (
    select(
        _AXES.c.id, _AXES.c.number, _AXES.c.configuration, _AXES.c.active_calibration_id, _AXES.c.revision,
        _AXES.c.archived_at, _NEWEST,
    ).where(_AXES.c.id == bindparam("axis_id"))
)  # fmt: skip
_MEASUREMENT = [_MEASUREMENTS.c[name] for name in MeasurementRecord.__slots__]
#: In no order: asked for one, SQLite goes by the index that has it, through all measurements of the axis.
_NAMED_MEASUREMENTS = select(*_MEASUREMENT).where(
    _MEASUREMENTS.c.axis_id == bindparam("axis_id"),
    _MEASUREMENTS.c.name == bindparam("name"),
    _MEASUREMENTS.c.ended_at >= bindparam("since", type_=_MEASUREMENTS.c.ended_at.type),
    _MEASUREMENTS.c.started_at <= bindparam("until", type_=_MEASUREMENTS.c.started_at.type),
)
_NUMBERED_MEASUREMENTS = select(*_MEASUREMENT).where(
    _MEASUREMENTS.c.axis_id == bindparam("axis_id"), _MEASUREMENTS.c.id.in_(bindparam("numbers", expanding=True))
)
#: Of these nothing tells the measurement that they are of: what their clock says is wrong, or it was not to be changed,
#: or an older program saw them elsewhere.
_APART = (RejectionReason.CLOCK_AHEAD, RejectionReason.TOO_LATE, RejectionReason.POSITION_MISMATCH)
_MEMBERS = (
    select(
        _WINDOWS.c.started_at,
        func.coalesce(_WINDOWS.c.ended_at, _WINDOWS.c.started_at),
        _WINDOWS.c.position_mm,
        _WINDOWS.c.set_preload_n,
        _WINDOWS.c.refusal_reason.is_(None),
    )
    .where(
        _WINDOWS.c.measurement_id == bindparam("measurement_id"),
        func.coalesce(_WINDOWS.c.refusal_reason, "").not_in([str(reason) for reason in _APART]),
    )
    .order_by(_WINDOWS.c.started_at)
)
_OVERDUE = select(_MEASUREMENTS.c.axis_id, _MEASUREMENTS.c.id).where(
    _MEASUREMENTS.c.status == OPEN, _MEASUREMENTS.c.closes_at <= bindparam("at", type_=_MEASUREMENTS.c.closes_at.type)
)
_CONTENTS = select(_WINDOWS.c.started_at, _WINDOWS.c.content_sha256, _WINDOWS.c.measurement_id).where(
    _WINDOWS.c.axis_id == bindparam("axis_id"), _WINDOWS.c.started_at.in_(bindparam("starts", expanding=True))
)
_OUTCOMES = select(_DOCUMENTS.c.measurement_id, _DOCUMENTS.c.outcome).where(
    _DOCUMENTS.c.measurement_id.in_(bindparam("measurements", expanding=True))
)
_NEW_MEASUREMENT = insert(_MEASUREMENTS).returning(_MEASUREMENTS.c.id)
_NEW_WINDOW = insert(_WINDOWS)
_CHANGE_AXIS, _CHANGE_MEASUREMENT = (
    update(table).where(table.c.id == bindparam("_id"), table.c.revision == bindparam("_seen"))
    for table in (_AXES, _MEASUREMENTS)
)
_CHANGED = (
    "started_at", "ended_at", "position_mm", "set_preload_n", "closes_at", "status", "n_accepted", "calibration_id",
)  # fmt: skip
#: What a window that is taken into a measurement changes of it: an index is written for each column that is set.
_ADMITTED = ("started_at", "ended_at", "position_mm", "set_preload_n", "closes_at", "n_accepted")
_FORGET_DOCUMENT = delete(_DOCUMENTS).where(_DOCUMENTS.c.measurement_id == bindparam("_id"))
_NEW_DOCUMENT = insert(_DOCUMENTS)


def read_axis(connection: Connection, axis_id: str) -> AxisRecord:
    """Return an axis; raises UnknownResourceError if there is none of that name."""
    row = connection.execute(_AXIS, {"axis_id": axis_id}).one_or_none()
    if row is None:
        raise no_axis(axis_id)
    return AxisRecord(*row)


def measurements_called(
    connection: Connection, axis_id: str, name: str, since: datetime, until: datetime
) -> list[MeasurementRecord]:
    """Return the measurements of one name that lie between two moments, or reach there, in time order."""
    span = {"axis_id": axis_id, "name": name, "since": since, "until": until}
    named = (MeasurementRecord(*row) for row in connection.execute(_NAMED_MEASUREMENTS, span))
    return sorted(named, key=lambda row: (row.started_at, row.id or 0))


def measurements_numbered(connection: Connection, axis_id: str, numbers: Collection[int]) -> list[MeasurementRecord]:
    """Return those of some measurements that the axis has."""
    if not numbers:
        return []
    rows = connection.execute(_NUMBERED_MEASUREMENTS, {"axis_id": axis_id, "numbers": list(numbers)})
    return [MeasurementRecord(*row) for row in rows]


def members_of(connection: Connection, measurement: MeasurementRecord) -> list[StoredMember]:
    """Return the windows that tell what a measurement is made of, in time order."""
    members = []
    for start, end, position_mm, set_preload_n, accepted in connection.execute(
        _MEMBERS, {"measurement_id": measurement.id}
    ):
        of_measurement = measurement.position_mm, measurement.set_preload_n
        where, preload = of_measurement if position_mm is None else (position_mm, set_preload_n)
        placed = Placed(measurement.name, start, end, metres(where), preload)
        members.append(StoredMember(placed, bool(accepted)))
    return members


def overdue(connection: Connection, at: datetime) -> list[tuple[str, int]]:
    """Return axis and number of the open measurements that no window came for until they were to close."""
    return [(axis_id, number) for axis_id, number in connection.execute(_OVERDUE, {"at": at})]


def read_charts(connection: Connection, axis: AxisRecord) -> ChartsRecord:
    """Return the charts of an axis."""
    (row,) = connection.execute(_CHARTS, {"axis_id": axis.id})
    return ChartsRecord(*row)


def contents_at(
    connection: Connection, axis: AxisRecord, starts: Collection[datetime]
) -> dict[datetime, tuple[str, int]]:
    """Return hash and measurement of the stored windows of an axis that started at these moments, by their start."""
    if axis.newest_window_at is None or not starts or min(starts) > axis.newest_window_at:
        return {}  # as it should be: windows arrive in order
    rows = connection.execute(_CONTENTS, {"axis_id": axis.id, "starts": list(starts)})
    return {row.started_at: (row.content_sha256, row.measurement_id) for row in rows}


def outcomes_of(connection: Connection, measurement_ids: Collection[int]) -> dict[int, JsonObject]:
    """Return what was said about measurements, by their number."""
    rows = connection.execute(_OUTCOMES, {"measurements": list(measurement_ids)})
    return {row.measurement_id: row.outcome for row in rows}


def add_windows(connection: Connection, windows: Iterable[WindowRecord]) -> None:
    """Store windows."""
    if rows := [_columns(window) for window in windows]:  # no rows would be one of nothing but defaults
        connection.execute(_NEW_WINDOW, rows)


def refuse_windows(connection: Connection, measurement_id: int, refusals: Mapping[datetime, Rejection | None]) -> None:
    """Store why windows of a measurement are refused, by their start; None: they are accepted."""
    for started_at, refusal in refusals.items():
        reason, detail = (None, None) if refusal is None else (str(refusal.reason), refusal.detail[:LONGEST_DETAIL])
        connection.execute(
            update(_WINDOWS)
            .where(_WINDOWS.c.measurement_id == measurement_id, _WINDOWS.c.started_at == started_at)
            .values(refusal_reason=reason, refusal_detail=detail)
        )


def move_window(connection: Connection, axis_id: str, started_at: datetime, measurement_id: int) -> None:
    """Let a window be of another measurement."""
    moved = update(_WINDOWS).where(_WINDOWS.c.axis_id == axis_id, _WINDOWS.c.started_at == started_at)
    connection.execute(moved.values(measurement_id=measurement_id))


def keep_pinned(connection: Connection, before: int, after: int) -> None:
    """Pin a measurement as that is pinned, if so, which windows of it were of; where both are, for both reasons."""
    pinned = connection.execute(select(_PINS).where(_PINS.c.measurement_id.in_([before, after]))).mappings()
    pins = {pin["measurement_id"]: pin for pin in pinned}
    if before not in pins:
        return
    reason = pins[before]["reason"]
    if after not in pins:
        own = {name: value for name, value in pins[before].items() if name != "id"}
        connection.execute(insert(_PINS), own | {"measurement_id": after})
    elif reason not in pins[after]["reason"]:
        both = f"{pins[after]['reason']}; {reason}"
        if len(both) <= LONGEST_REASON:  # else that of the earlier measurement stays
            connection.execute(update(_PINS).where(_PINS.c.measurement_id == after).values(reason=both))


def join_measurement(connection: Connection, gone: MeasurementRecord, into: int) -> None:
    """Remove a measurement whose windows are of another one now; what is left of it goes there."""
    connection.execute(delete(_DOCUMENTS).where(_DOCUMENTS.c.measurement_id == gone.id))
    connection.execute(delete(RejudgedRow).where(RejudgedRow.measurement_id == gone.id))
    connection.execute(delete(PinRow).where(PinRow.measurement_id == gone.id))  # kept by keep_pinned
    for row in (WindowRow, AlarmRow):
        connection.execute(update(row).where(row.measurement_id == gone.id).values(measurement_id=into))
    removed = delete(_MEASUREMENTS).where(_MEASUREMENTS.c.id == gone.id, _MEASUREMENTS.c.revision == gone.revision)
    _expect_one(gone, connection.execute(removed).rowcount)


def save_measurement(connection: Connection, measurement: MeasurementRecord, judged_at: datetime | None = None) -> None:
    """Store a new measurement, which gets its ``id``, or what changed of one.

    Here and below StaleDataError is raised if the row was changed since it was read: what is to be written is out of
    date.
    """
    admitted = measurement.id is not None and judged_at is None
    columns = {name: getattr(measurement, name) for name in (_ADMITTED if admitted else _CHANGED)}
    if measurement.id is None:
        new = columns | {"axis_id": measurement.axis_id, "name": measurement.name, "revision": measurement.revision}
        measurement.id = connection.execute(_NEW_MEASUREMENT, new).scalar_one()
    else:
        columns |= {} if admitted else {"judged_at": judged_at}
        changed = connection.execute(_CHANGE_MEASUREMENT, _next_revision(measurement, **columns))
        _expect_one(measurement, changed.rowcount)


def save_document(
    connection: Connection, measurement_id: int, outcome: JsonObject, response: JsonObject | None
) -> None:
    """Store what is said about a measurement, in place of what was said before."""
    connection.execute(_FORGET_DOCUMENT, {"_id": measurement_id})
    connection.execute(_NEW_DOCUMENT, {"measurement_id": measurement_id, "outcome": outcome, "response": response})


def save_charts(connection: Connection, axis: AxisRecord, stored: ChartsRecord, charts: ChartsRecord) -> None:
    """Store what changed of where the charts of an axis stand and of what is counted."""
    names = [name for name in ChartsRecord.__slots__ if getattr(stored, name) != getattr(charts, name)]
    columns = {name: getattr(charts, name) for name in names}
    _expect_one(axis, connection.execute(_CHANGE_AXIS, _next_revision(axis, **columns)).rowcount)


def say_changed(connection: Connection, axis: AxisRecord) -> None:
    """Count the revision of an axis on: what is shown of it beside its charts has changed."""
    _expect_one(axis, connection.execute(_CHANGE_AXIS, _next_revision(axis)).rowcount)


def _columns(record: WindowRecord) -> dict[str, object]:
    return {name: getattr(record, name) for name in record.__slots__}


def _next_revision(record: AxisRecord | MeasurementRecord, **columns: object) -> dict[str, object]:
    return columns | {"_id": record.id, "_seen": record.revision, "revision": record.revision + 1}


def _expect_one(record: AxisRecord | MeasurementRecord, n_rows: int) -> None:
    if n_rows != 1:
        raise StaleDataError(f"row {record.id} is no longer at revision {record.revision}")
    record.revision += 1
