"""Read and write what one posted window needs: plain records, one statement each.

The other repositories work with mapped rows. Here, where every window passes, looking after mapped rows would take
several times as long as the statements themselves. What a single window needs is prepared as well.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Connection, and_, bindparam, func, insert, select, update
from sqlalchemy.orm.exc import StaleDataError

from service.errors import UnknownResourceError
from service.json_types import JsonObject
from service.store.prepared import PreparedChange, PreparedSelect
from service.store.tables import AxisRow, MeasurementRow, WindowRow

#: Life of a measurement: windows arrive → looked at.
OPEN, JUDGED, REFUSED = "open", "judged", "refused"


@dataclass(slots=True)
class AxisRecord:
    """An axis as far as its windows need it."""

    id: str
    configuration: JsonObject
    active_calibration_id: int | None
    revision: int
    newest_window_at: datetime | None  # start of the last of its stored windows


@dataclass(frozen=True, slots=True)
class ChartsRecord:
    """The charts of an axis: their limits, and where they stand. Wanted only where a measurement is judged."""

    detector_design: JsonObject
    monitor_state: JsonObject | None


@dataclass(slots=True)
class MeasurementRecord:
    """A measurement that takes windows, or took them; one that nothing is stored of has no ``id``."""

    axis_id: str
    name: str
    started_at: datetime
    position_mm: float
    set_preload_n: float | None
    status: str = OPEN
    n_accepted: int = 0
    calibration_id: int | None = None
    outcome: JsonObject | None = None
    revision: int = 1
    id: int | None = None


@dataclass(frozen=True, slots=True)
class JudgedRecord:
    """What came of a measurement."""

    status: str
    refusal_reason: str | None
    judged_at: datetime
    calibration_id: int | None
    monitor_state: str
    outcome: JsonObject
    response: JsonObject | None
    frequency_hz: float | None
    preload_n: float | None
    interval_lower_n: float | None
    interval_upper_n: float | None


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


_AXES, _MEASUREMENTS, _WINDOWS = (
    mapped.metadata.tables[mapped.__tablename__] for mapped in (AxisRow, MeasurementRow, WindowRow)
)
# Statements are built once: to build one takes longer than to run it.
_CHARTS = select(*(_AXES.c[name] for name in ChartsRecord.__slots__)).where(_AXES.c.id == bindparam("axis_id"))
_NEWEST = select(func.max(_WINDOWS.c.started_at)).where(_WINDOWS.c.axis_id == _AXES.c.id).scalar_subquery()
_AXIS = (_AXES.c.id, _AXES.c.configuration, _AXES.c.active_calibration_id, _AXES.c.revision, _NEWEST)
_MEASUREMENT = tuple(_MEASUREMENTS.c[name] for name in MeasurementRecord.__slots__)
_AXIS_AND_OPEN_MEASUREMENTS = PreparedSelect(
    select(*_AXIS, *_MEASUREMENT)
    .select_from(_AXES)
    .outerjoin(_MEASUREMENTS, and_(_MEASUREMENTS.c.axis_id == _AXES.c.id, _MEASUREMENTS.c.status == OPEN))
    .where(_AXES.c.id == bindparam("axis_id"))
)
_NAMED_MEASUREMENTS = select(*_MEASUREMENT).where(
    _MEASUREMENTS.c.axis_id == bindparam("axis_id"), _MEASUREMENTS.c.name.in_(bindparam("names", expanding=True))
)
_CONTENTS = select(_WINDOWS.c.started_at, _WINDOWS.c.content_sha256).where(
    _WINDOWS.c.axis_id == bindparam("axis_id"), _WINDOWS.c.started_at.in_(bindparam("starts", expanding=True))
)
_NEW_MEASUREMENT = insert(_MEASUREMENTS).returning(_MEASUREMENTS.c.id)
_NEW_WINDOW = PreparedChange(insert(_WINDOWS), [column.name for column in _WINDOWS.c if column.name != "id"])
_CHANGE_AXIS, _CHANGE_MEASUREMENT = (
    update(table).where(table.c.id == bindparam("_id"), table.c.revision == bindparam("_seen"))
    for table in (_AXES, _MEASUREMENTS)
)
_CHANGE_ADMITTED = PreparedChange(_CHANGE_MEASUREMENT, ["started_at", "n_accepted", "revision"])


def read_axis(
    connection: Connection, axis_id: str, names: Iterable[str]
) -> tuple[AxisRecord, dict[str, MeasurementRecord]]:
    """Return an axis with its open measurements and those of these names in whatever status, by name.

    Raises UnknownResourceError if there is no axis of that name.
    """
    rows = _AXIS_AND_OPEN_MEASUREMENTS.rows(connection, {"axis_id": axis_id})
    if not rows:
        raise UnknownResourceError(f"no axis '{axis_id}' is registered; register it with PUT /v1/axes/{axis_id}")
    n_of_axis = len(_AXIS)
    found = [MeasurementRecord(*row[n_of_axis:]) for row in rows]
    measurements = {row.name: row for row in found if row.id is not None}
    others = [name for name in names if name not in measurements]
    if others:  # new ones, and those that are closed: seldom, when windows come one by one
        for row in connection.execute(_NAMED_MEASUREMENTS, {"axis_id": axis_id, "names": others}):
            measurements[row.name] = MeasurementRecord(*row)
    return AxisRecord(*rows[0][:n_of_axis]), measurements


def read_charts(connection: Connection, axis: AxisRecord) -> ChartsRecord:
    """Return the charts of an axis."""
    return ChartsRecord(*connection.execute(_CHARTS, {"axis_id": axis.id}).one())


def contents_at(connection: Connection, axis: AxisRecord, starts: Collection[datetime]) -> dict[datetime, str]:
    """Return the hashes of the stored windows of an axis that started at these moments, by their start."""
    if axis.newest_window_at is None or min(starts) > axis.newest_window_at:
        return {}  # as it should be: windows arrive in order
    rows = connection.execute(_CONTENTS, {"axis_id": axis.id, "starts": list(starts)})
    return {row.started_at: row.content_sha256 for row in rows}


def add_windows(connection: Connection, windows: Iterable[WindowRecord]) -> None:
    """Store windows."""
    for window in windows:
        _NEW_WINDOW.run(connection, _columns(window))


def save_admitted(connection: Connection, measurement: MeasurementRecord) -> None:
    """Store a new measurement, which gets its ``id``, or what new windows change of an open one.

    Here and below StaleDataError is raised if the row was changed since it was read: what is to be written is out of
    date.
    """
    if measurement.id is None:
        columns = _columns(measurement)
        del columns["id"]
        measurement.id = connection.execute(_NEW_MEASUREMENT, columns).scalar_one()
    else:
        changed = _next_revision(measurement, started_at=measurement.started_at, n_accepted=measurement.n_accepted)
        _expect_one(measurement, _CHANGE_ADMITTED.run(connection, changed))


def save_judged(connection: Connection, measurement: MeasurementRecord, judged: JudgedRecord) -> None:
    """Store what came of a measurement."""
    changed = connection.execute(_CHANGE_MEASUREMENT, _next_revision(measurement, **_columns(judged)))
    _expect_one(measurement, changed.rowcount)


def save_state(connection: Connection, axis: AxisRecord, monitor_state: JsonObject) -> None:
    """Store where the charts of an axis stand."""
    changed = connection.execute(_CHANGE_AXIS, _next_revision(axis, monitor_state=monitor_state))
    _expect_one(axis, changed.rowcount)


def _columns(record: MeasurementRecord | JudgedRecord | WindowRecord) -> dict[str, object]:
    return {name: getattr(record, name) for name in record.__slots__}


def _next_revision(record: AxisRecord | MeasurementRecord, **columns: object) -> dict[str, object]:
    return columns | {"_id": record.id, "_seen": record.revision, "revision": record.revision + 1}


def _expect_one(record: AxisRecord | MeasurementRecord, n_rows: int) -> None:
    if n_rows != 1:
        raise StaleDataError(f"row {record.id} is no longer at revision {record.revision}")
    record.revision += 1
