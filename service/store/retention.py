"""Query and change what decides how long waveforms are kept: windows by file, pins, alarms, purges, unsettled files."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Connection, delete, func, insert, literal_column, select, text, update
from sqlalchemy.orm import Session

from service.errors import LetGoError
from service.json_types import JsonObject
from service.store.alarms import WITHDRAWN
from service.store.intake import OPEN
from service.store.lookup import existing
from service.store.tables import (
    PLACE,
    AlarmRow,
    AxisRow,
    MeasurementRow,
    PinRow,
    PurgeRow,
    UnsettledFileRow,
    WindowRow,
)
from service.store.waveforms import WaveformPlace

#: One number for all who change what is kept; any that nothing else in this database takes.
_LOCK = 7102026
#: As the index has it: a bound value would hide from SQLite that the index answers.
_STORED = WindowRow.file_path != literal_column("''")


@dataclass(frozen=True, slots=True)
class StoredWindow:
    """A window whose waveform is stored, with what decides how long."""

    id: int
    place: WaveformPlace
    axis_id: str
    measurement_id: int
    measured_at: datetime  # when its measurement began
    preload_was_set: bool
    is_open: bool  # its measurement may still be judged


@dataclass(frozen=True, slots=True)
class LetGo:
    """When waveforms were let go, and by which rule."""

    at: datetime
    keep_raw_days: int

    def __str__(self) -> str:
        """Return it in words."""
        return f"let go on {self.at:%Y-%m-%d} by the rule of {self.keep_raw_days} days"


@contextmanager
def settled_with(connection: Connection) -> Iterator[None]:
    """Keep others from pinning what is let go in this transaction, and the other way round."""
    if connection.dialect.name == "postgresql":  # on SQLite there is one writer at a time
        connection.execute(text(f"SELECT pg_advisory_xact_lock({_LOCK})"))
    yield


def next_file(connection: Connection, after: str, before: str) -> str | None:
    """Return the first file that holds a window, by name, between two names."""
    named = select(WindowRow.file_path).where(_STORED, WindowRow.file_path > after, WindowRow.file_path < before)
    return connection.execute(named.order_by(WindowRow.file_path).limit(1)).scalar()


def count_files(connection: Connection, before: str) -> int:
    """Count the files that hold a window and whose name is before another."""
    named = select(func.count(func.distinct(WindowRow.file_path)))
    return int(connection.scalar(named.where(_STORED, WindowRow.file_path < before)) or 0)


def windows_in(connection: Connection, path: str) -> list[StoredWindow]:
    """Return the windows that a file holds, in its order."""
    query = (
        select(
            WindowRow.id, *PLACE, WindowRow.axis_id, MeasurementRow.id, MeasurementRow.started_at,
            MeasurementRow.set_preload_n.is_not(None), MeasurementRow.status == OPEN,
        )
        .join(MeasurementRow, MeasurementRow.id == WindowRow.measurement_id)
        .where(_STORED, WindowRow.file_path == path)
        .order_by(WindowRow.offset_in_file, WindowRow.index_in_frame)
    )  # fmt: skip
    return [
        StoredWindow(row[0], WaveformPlace(*row[1:5]), row[5], row[6], row[7], bool(row[8]), bool(row[9]))
        for row in connection.execute(query)
    ]


def move_windows(connection: Connection, places: Mapping[int, WaveformPlace]) -> None:
    """Say of windows, by their number, where they lie now; not of those that were let go meanwhile."""
    for number, place in places.items():
        moved = {"file_path": place.path, "offset_in_file": place.offset, "index_in_frame": place.index}
        connection.execute(update(WindowRow).where(WindowRow.id == number, WindowRow.let_go_by.is_(None)).values(moved))


def let_windows_go(connection: Connection, purge_id: int, path: str) -> int:
    """Say of all windows that a file holds that a purge let them go; return how many these are."""
    gone = {"file_path": "", "offset_in_file": 0, "index_in_frame": 0, "let_go_by": purge_id}
    changed = update(WindowRow).where(_STORED, WindowRow.file_path == path).values(gone)
    return connection.execute(changed).rowcount


def add_to_purge(connection: Connection, purge_id: int, *, n_windows: int, freed_bytes: int) -> None:
    """Count what a purge let go."""
    counts = {"n_windows": PurgeRow.n_windows + n_windows, "freed_bytes": PurgeRow.freed_bytes + freed_bytes}
    connection.execute(update(PurgeRow).where(PurgeRow.id == purge_id).values(counts))


def get_purge(session: Session, purge_id: int) -> PurgeRow:
    """Return one purge or say that there is none."""
    return existing(session.get(PurgeRow, purge_id), f"purge {purge_id}")


def newest_purges(session: Session, limit: int) -> list[PurgeRow]:
    """Return the purges that were begun last, newest first."""
    return list(session.scalars(select(PurgeRow).order_by(PurgeRow.id.desc()).limit(limit)))


def let_go(connection: Session | Connection, measurement_ids: Collection[int]) -> dict[int, LetGo]:
    """Return which of some measurements have lost windows to a purge, and to which, the first of each."""
    query = (
        select(WindowRow.measurement_id, PurgeRow.begun_at, PurgeRow.keep_raw_days)
        .join(PurgeRow, PurgeRow.id == WindowRow.let_go_by)
        .where(WindowRow.measurement_id.in_(measurement_ids))
        .distinct()
        .order_by(PurgeRow.begun_at.desc())
    )
    return {row[0]: LetGo(row[1], row[2]) for row in connection.execute(query)}


def require_stored(connection: Session | Connection, measurement_ids: Collection[int]) -> None:
    """Raise LetGoError if the waveforms of one of some measurements were let go."""
    for number, gone in sorted(let_go(connection, measurement_ids).items()):
        raise LetGoError(f"the waveforms of measurement {number} were {gone}; what was found in them stays")


def count_windows(connection: Connection) -> tuple[int, int]:
    """Count the windows whose waveforms are stored, and those whose were let go."""
    n_stored = connection.scalar(select(func.count()).where(_STORED))
    n_all = connection.scalar(select(func.count()).select_from(WindowRow))
    return int(n_stored or 0), int(n_all or 0) - int(n_stored or 0)


def changes(connection: Connection) -> tuple[object, ...]:
    """Return what differs when a purge or a pin has changed what is kept."""
    purges = select(func.count(PurgeRow.id), func.count(PurgeRow.ended_at), func.sum(PurgeRow.n_windows))
    pins = select(func.count(PinRow.id), func.max(PinRow.id))
    return (*connection.execute(purges).one(), *connection.execute(pins).one())


def alarms_of(connection: Connection, axis_id: str) -> list[tuple[datetime, JsonObject]]:
    """Return when the measurements were made that raised alarms of an axis, and the evidence."""
    query = select(AlarmRow.measured_at, AlarmRow.evidence)
    query = query.where(AlarmRow.axis_id == axis_id, AlarmRow.status != WITHDRAWN)
    return [(row[0], row[1]) for row in connection.execute(query)]


def pins_of(connection: Connection, axis_id: str) -> list[tuple[int | None, datetime | None, datetime | None]]:
    """Return measurement, start and end of the pins of an axis."""
    query = select(PinRow.measurement_id, PinRow.start_at, PinRow.end_at).where(PinRow.axis_id == axis_id)
    return [(row[0], row[1], row[2]) for row in connection.execute(query)]


def pin_of_measurement(session: Session, measurement_id: int) -> PinRow | None:
    """Return the pin of a measurement, if it has one."""
    return session.scalars(select(PinRow).where(PinRow.measurement_id == measurement_id)).one_or_none()


def list_pins(session: Session, axis_id: str, before_id: int | None, limit: int) -> list[PinRow]:
    """Return pins of an axis, newest first."""
    query = select(PinRow).where(PinRow.axis_id == axis_id)
    if before_id is not None:
        query = query.where(PinRow.id < before_id)
    return list(session.scalars(query.order_by(PinRow.id.desc()).limit(limit)))


def begun_of_axes(connection: Connection) -> dict[str, datetime]:
    """Return since when each axis is registered."""
    return {row[0]: row[1] for row in connection.execute(select(AxisRow.id, AxisRow.created_at))}


def unsettle(connection: Connection, paths: Iterable[str]) -> None:
    """Note files before they are written or removed: what a crash leaves of them is known by that."""
    for path in paths:
        connection.execute(insert(UnsettledFileRow), {"path": path})


def unsettled(connection: Connection) -> dict[str, bool]:
    """Return the files that were noted, and whether a window names each."""
    named = select(func.count()).where(_STORED, WindowRow.file_path == UnsettledFileRow.path).scalar_subquery()
    return {row[0]: row[1] > 0 for row in connection.execute(select(UnsettledFileRow.path, named))}


def settle(connection: Connection, paths: Collection[str]) -> None:
    """Forget files that were noted: those that no window names are gone."""
    connection.execute(delete(UnsettledFileRow).where(UnsettledFileRow.path.in_(paths)))
