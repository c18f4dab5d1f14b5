"""Query who may do what: people, keys, browser sessions, and the log of what was changed."""

from collections.abc import Sequence
from datetime import datetime

from sqlalchemy import delete, func, literal_column, select
from sqlalchemy.orm import Session

from service.store.lookup import existing
from service.store.tables import AuditRow, BrowserSessionRow, KeyRow, UserRow

#: Whoever has this role may do everything; the first one of it closes the service to others.
ADMINISTRATOR = "administrator"
#: What the log calls that somebody may try to log in again.
UNLOCK = "user unlock"
_LOG_IN = "log in"
#: Answers that refuse who asks: without a right key or password, without the right to it, after too many wrong ones.
REFUSING_STATUS = (401, 403, 429)


def get_user(session: Session, name: str) -> UserRow:
    """Return one user or say that there is none."""
    return existing(session.get(UserRow, name), f"user '{name}'")


def list_users(session: Session) -> list[UserRow]:
    """Return all users by name."""
    return list(session.scalars(select(UserRow).order_by(UserRow.name)))


def get_key(session: Session, key_id: int) -> KeyRow:
    """Return one key or say that there is none."""
    return existing(session.get(KeyRow, key_id), f"key {key_id}")


def list_keys(session: Session) -> list[KeyRow]:
    """Return all keys, oldest first."""
    return list(session.scalars(select(KeyRow).order_by(KeyRow.id)))


def live_sessions(session: Session, at: datetime) -> Sequence[tuple[BrowserSessionRow, UserRow]]:
    """Return the browser sessions that have not expired, each with its user."""
    query = select(BrowserSessionRow, UserRow).join(UserRow, UserRow.name == BrowserSessionRow.user_name)
    return [(row, user) for row, user in session.execute(query.where(BrowserSessionRow.expires_at > at))]


def end_sessions(session: Session, *, token_sha256: str | None = None, user: str | None = None) -> None:
    """Forget the browser session of a token, or all of a user."""
    query = delete(BrowserSessionRow)
    if token_sha256 is not None:
        query = query.where(BrowserSessionRow.token_sha256 == token_sha256)
    if user is not None:
        query = query.where(BrowserSessionRow.user_name == user)
    session.execute(query)


def drop_expired_sessions(session: Session, at: datetime) -> None:
    """Forget the browser sessions that have expired."""
    session.execute(delete(BrowserSessionRow).where(BrowserSessionRow.expires_at <= at))


def list_audit(session: Session, *, axis_id: str | None, before_id: int | None, limit: int) -> list[AuditRow]:
    """Return entries of the log, newest first."""
    query = select(AuditRow)
    if axis_id is not None:
        query = query.where(AuditRow.axis_id == axis_id)
    if before_id is not None:
        query = query.where(AuditRow.id < before_id)
    return list(session.scalars(query.order_by(AuditRow.id.desc()).limit(limit)))


def note_login(session: Session, name: str, host: str, at: datetime) -> None:
    """Write into the log that a user logged in."""
    session.add(AuditRow(at=at, who=f"user {name}", action=_LOG_IN, target=_from(host), status=200))


def logged_in_since(session: Session, name: str, host: str, at: datetime) -> bool:
    """Return whether a user has logged in from a host after a moment, as the log says."""
    is_login = literal_column(f"'{_LOG_IN}'") == AuditRow.action  # as the condition of their index says it
    logins = select(AuditRow.id).where(is_login, AuditRow.target == _from(host))
    return session.scalar(logins.where(AuditRow.who == f"user {name}", AuditRow.at > at).limit(1)) is not None


def _from(host: str) -> str:
    return f"/login from {host}"


def newest_entry(session: Session) -> int:
    """Return the number of the newest entry of the log; 0 if it has no entry."""
    return session.scalar(select(func.max(AuditRow.id))) or 0


def unlocked_names(session: Session, after: int, until: int) -> list[str]:
    """Return who was unlocked by the entries of the log after one, until another one."""
    query = select(AuditRow.target).where(AuditRow.id > after, AuditRow.id <= until, AuditRow.action == UNLOCK)
    return list(session.scalars(query))


def drop_refusals(session: Session, *, keep: int) -> None:
    """Forget refused attempts but for the newest."""
    newest_dropped = session.scalar(
        select(AuditRow.id)
        .where(AuditRow.status.in_(REFUSING_STATUS))
        .order_by(AuditRow.id.desc())
        .offset(keep)
        .limit(1)
    )
    if newest_dropped is not None:
        session.execute(delete(AuditRow).where(AuditRow.status.in_(REFUSING_STATUS), AuditRow.id <= newest_dropped))
