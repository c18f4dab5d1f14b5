"""Manage users and keys from the command line, without a running service."""

from collections.abc import Collection
from datetime import timedelta

from service.clock import now
from service.errors import ConflictError, InvalidRequestError
from service.operations.access.passwords import (
    LONGEST_PASSWORD,
    SHORTEST_PASSWORD,
    fingerprint,
    hashed_password,
    new_key,
)
from service.operations.access.scopes import ROLES, Scope
from service.store import access
from service.store.axes import get_axis
from service.store.database import Database
from service.store.tables import AuditRow, KeyRow, UserRow


class People:
    """Changes users and keys; each change is an entry of the log under the name of who made it."""

    def __init__(self, database: Database, by: str) -> None:
        self._database = database
        self._by = by[:120]

    def users(self) -> list[UserRow]:
        """Return all users by name."""
        with self._database.read() as session:
            return access.list_users(session)

    def add_user(self, name: str, role: str, password: str) -> None:
        """Make a user; ConflictError if there is one of this name."""
        _require_role(role)
        stored = hashed_password(_strong(password))
        with self._database.write() as session:
            if session.get(UserRow, name) is not None:
                raise ConflictError(f"there is a user '{name}' already; `preload user password` changes the password")
            session.add(UserRow(name=name, role=role, password_hash=stored, created_at=now()))
            session.add(self._entry(f"user add {role}", name))

    def set_role(self, name: str, role: str) -> None:
        """Give a user another role; ConflictError if nobody would be an administrator any more."""
        _require_role(role)
        with self._database.write() as session:
            user = access.get_user(session, name)
            if role != access.ADMINISTRATOR:
                _require_another_administrator(access.list_users(session), name)
            user.role = role
            session.add(self._entry(f"user role {role}", name))

    def set_password(self, name: str, password: str) -> None:
        """Give a user another password, and end what was begun with the old one."""
        stored = hashed_password(_strong(password))
        with self._database.write() as session:
            access.get_user(session, name).password_hash = stored
            access.end_sessions(session, user=name)
            session.add(self._entry("user password", name))

    def disable_user(self, name: str) -> None:
        """Disable a user, whose name stays in the log; ConflictError for the last administrator."""
        with self._database.write() as session:
            user = access.get_user(session, name)
            _require_another_administrator(access.list_users(session), name)
            user.disabled_at = user.disabled_at or now()
            access.end_sessions(session, user=name)
            session.add(self._entry("user disable", name))

    def unlock_user(self, name: str) -> None:
        """Let a user log in where too many wrong passwords came from; services take note of the entry of the log."""
        with self._database.write() as session:
            access.get_user(session, name)
            session.add(self._entry(access.UNLOCK, name))

    def keys(self) -> list[KeyRow]:
        """Return all keys, oldest first."""
        with self._database.read() as session:
            return access.list_keys(session)

    def add_key(
        self, name: str, scopes: Collection[Scope], axes: Collection[str] | None, lasts: timedelta | None
    ) -> tuple[int, str]:
        """Make a key, and return its number and what the program has to send: that is shown once and not kept.

        UnknownResourceError if there is no such axis.
        """
        key, at = new_key(), now()
        row = KeyRow(
            name=name, secret_sha256=fingerprint(key), scopes=sorted(scopes), axes=None if not axes else sorted(axes),
            created_at=at, expires_at=None if lasts is None else at + lasts,
        )  # fmt: skip
        with self._database.write() as session:
            for axis in axes or ():
                get_axis(session, axis)
            session.add(row)
            session.flush()
            session.add(self._entry("key add " + " ".join(row.scopes), f"{row.id} ({name})"))
            return row.id, key

    def revoke_key(self, key_id: int) -> None:
        """Revoke a key."""
        with self._database.write() as session:
            row = access.get_key(session, key_id)
            row.revoked_at = row.revoked_at or now()
            session.add(self._entry("key revoke", f"{key_id} ({row.name})"))

    def _entry(self, action: str, target: str) -> AuditRow:
        return AuditRow(at=now(), who=self._by, action=action[:200], target=target, status=0)


def _strong(password: str) -> str:
    if not SHORTEST_PASSWORD <= len(password) <= LONGEST_PASSWORD:
        raise InvalidRequestError(
            f"a password must have {SHORTEST_PASSWORD} to {LONGEST_PASSWORD} characters; got {len(password)}"
        )
    return password


def _require_role(role: str) -> None:
    if role not in ROLES:
        raise InvalidRequestError(f"a role must be one of {', '.join(ROLES)}; got '{role}'")


def _require_another_administrator(users: Collection[UserRow], name: str) -> None:
    left = [user for user in users if user.role == access.ADMINISTRATOR and user.disabled_at is None]
    if [user.name for user in left] == [name]:
        raise ConflictError(f"'{name}' is the last administrator; make another one first")
