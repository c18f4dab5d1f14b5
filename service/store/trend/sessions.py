"""Read and write the sessions of an axis: what the line through its trend and its own false-alarm rate rest on."""

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import BigInteger, Connection, bindparam, delete, insert, select

from service.store.tables import moment_of
from service.store.trend.tables import stored_rows, table_of

#: In the place of the number of a calibration: the sessions that were charted without one.
UNCALIBRATED = 0
#: A session as it is stored: enough to tell whether another one stands in its place.
StoredSession = tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class SessionRecord:
    """A session that is over: its measurements summed up, and what the charts made of it."""

    axis_number: int
    calibration_id: int  # or :data:`UNCALIBRATED`
    started_at: datetime
    epoch: int
    last_at: datetime
    n_measurements: int
    feature_s2: float  # mean; without a calibration 1/f² at the mean conditions of the baseline
    temperature_c: float | None
    friction_torque_nm: float | None
    residual: float | None  # in standard deviations; none while the baseline was learnt
    reference: float | None  # of the CUSUM
    alarmed: bool

    @classmethod
    def of(cls, stored: StoredSession) -> "SessionRecord":
        """Return the session of a row."""
        values = dict(zip(cls.__slots__, stored, strict=True))
        moments = {name: moment_of(values[name]) for name in ("started_at", "last_at")}
        return cls(**values | moments | {"alarmed": bool(values["alarmed"])})


_SESSIONS = table_of(
    "sessions",
    SessionRecord,
    key=("axis_number", "calibration_id", "started_at"),
    types={"calibration_id": BigInteger()},
)
_COLUMNS = [_SESSIONS.c[name] for name in SessionRecord.__slots__]
_ADD = insert(_SESSIONS)
_NEWEST = (
    select(*_COLUMNS)
    .where(_SESSIONS.c.axis_number == bindparam("axis"), _SESSIONS.c.calibration_id == bindparam("calibration"))
    .order_by(_SESSIONS.c.started_at.desc())
    .limit(bindparam("most"))
)


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


def stored_sessions(connection: Connection, axis_number: int, calibration_id: int, most: int) -> list[StoredSession]:
    """Return the newest sessions under a calibration as they are stored, in time order."""
    values = {"axis": axis_number, "calibration": calibration_id, "most": most}
    return stored_rows(connection, _NEWEST, values)[::-1]


def newest_sessions(connection: Connection, axis_number: int, calibration_id: int, most: int) -> list[SessionRecord]:
    """Return the newest sessions under a calibration, in time order."""
    return list(map(SessionRecord.of, stored_sessions(connection, axis_number, calibration_id, most)))
