"""Read and write the sessions of an axis: what the line through its trend and its own false-alarm rate rest on."""

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import BigInteger, Connection, delete, insert, select

from service.store.trend.tables import table_of


@dataclass(frozen=True, slots=True)
class SessionRecord:
    """A session that is over: its measurements summed up, and what the charts made of it."""

    axis_number: int
    calibration_id: int
    started_at: datetime
    epoch: int
    last_at: datetime
    n_measurements: int
    feature_s2: float  # mean
    temperature_c: float | None
    friction_torque_nm: float | None
    residual: float | None  # in standard deviations; none while the baseline was learnt
    reference: float | None  # of the CUSUM
    alarmed: bool


_SESSIONS = table_of(
    "sessions",
    SessionRecord,
    key=("axis_number", "calibration_id", "started_at"),
    types={"calibration_id": BigInteger()},
)
_COLUMNS = [_SESSIONS.c[name] for name in SessionRecord.__slots__]
_ADD = insert(_SESSIONS)


def add_sessions(connection: Connection, sessions: Iterable[SessionRecord]) -> None:
    """Store sessions that are over."""
    rows = [{name: getattr(session, name) for name in SessionRecord.__slots__} for session in sessions]
    if rows:  # none would be one of nothing but defaults
        connection.execute(_ADD, rows)


def forget_sessions(
    connection: Connection, axis_number: int, calibration_id: int, epoch: int, since: datetime | None
) -> None:
    """Remove the sessions of an epoch that began at a moment or later, by default all: they are summed up anew."""
    of_calibration = (_SESSIONS.c.axis_number == axis_number, _SESSIONS.c.calibration_id == calibration_id)
    removed = delete(_SESSIONS).where(*of_calibration, _SESSIONS.c.epoch == epoch)
    connection.execute(removed if since is None else removed.where(_SESSIONS.c.started_at >= since))


def forget_sessions_beyond(connection: Connection, axis_number: int, epoch: int) -> None:
    """Remove the sessions of all epochs later than one."""
    connection.execute(delete(_SESSIONS).where(_SESSIONS.c.axis_number == axis_number, _SESSIONS.c.epoch > epoch))


def newest_sessions(connection: Connection, axis_number: int, calibration_id: int, most: int) -> list[SessionRecord]:
    """Return the newest sessions under a calibration, in time order."""
    query = (
        select(*_COLUMNS)
        .where(_SESSIONS.c.axis_number == axis_number, _SESSIONS.c.calibration_id == calibration_id)
        .order_by(_SESSIONS.c.started_at.desc())
        .limit(most)
    )
    return [SessionRecord(*row) for row in connection.execute(query)][::-1]
