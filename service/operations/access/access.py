"""Authenticate and authorise requests, pages and commands; keep the log of changes."""

import math
import threading
import time
from dataclasses import dataclass
from datetime import datetime, timedelta

from service.clock import now
from service.errors import ForbiddenError, ServiceError, TooManyTriesError, UnauthenticatedError
from service.operations.access.passwords import fingerprint, is_password, new_token, of_nobody
from service.operations.access.refusals import Refusals
from service.operations.access.scopes import ANYONE, ROLES, Caller, Scope
from service.operations.access.throttle import LoginThrottle, host_of
from service.store import access
from service.store.database import Database
from service.store.tables import AuditRow, BrowserSessionRow

#: What other processes change, such as a key that is revoked on the command line, holds here after so long.
FRESH_S = 2.0
#: A cookie that nobody knows may be of somebody who logged in at another service just now: it is asked for so often.
_ASKED_AGAIN_S = 0.2
#: The moment of last use of a key is written so often.
_NOTED_EVERY_S = 60.0
SESSION_LASTS = timedelta(hours=12)
#: So long those who guess elsewhere keep nobody out who logged in from an address.
KNOWN_FOR = timedelta(days=90)


@dataclass(frozen=True, slots=True)
class _Known:
    """Keys, logged-in users, and whether anybody has to say who it is, as they were at one moment."""

    at_s: float
    is_closed: bool
    users: frozenset[str]  # names
    keys: dict[str, tuple[int, Caller, datetime | None]]  # by fingerprint: id, caller, expiry
    sessions: dict[str, tuple[Caller, datetime]]  # by fingerprint: caller, expiry


class Access:
    """Identifies callers by key or cookie, and keeps the log of what they changed.

    It is open to anyone where the service listens on loopback and no administrator was ever made; else it is closed.
    """

    def __init__(self, database: Database, *, on_loopback: bool) -> None:
        self._database = database
        self._on_loopback = on_loopback
        self._lock = threading.Lock()
        self._known: _Known | None = None
        self._used: dict[int, datetime] = {}
        self._noted_at_s = time.monotonic()
        self.wrong_logins, self.wrong_keys = LoginThrottle(), LoginThrottle()
        self.refusals = Refusals(database)
        with database.read() as session:
            self._unlocked_until = access.newest_entry(session)  # entry of the log up to which unlocks were noted
        self._asked_for_unlocks_s = time.monotonic()

    def is_known(self, cookie: str | None) -> bool:
        """Return whether :meth:`caller` answers without the database."""
        return self._known is not None and self._holds(self._known, cookie)

    def caller(self, *, key: str | None, cookie: str | None, address: str) -> Caller:
        """Return who asks with a key, a cookie or neither, from an address.

        Raises UnauthenticatedError if nobody is known by it; TooManyTriesError if the address has guessed too often.
        """
        callers = self._fresh(cookie)
        if not callers.is_closed:
            return ANYONE
        if key is not None:
            return self._of_key(callers, key, address)
        if cookie is not None and (logged_in := callers.sessions.get(fingerprint(cookie))) is not None:
            caller, expires_at = logged_in
            if expires_at > now():
                return caller
        raise UnauthenticatedError("say who asks: a key in `Authorization: Bearer …`, or log in at /login")

    def log_in(self, name: str, password: str, address: str) -> tuple[str, datetime]:
        """Return the value of a cookie for a user with this password, and until when it holds.

        Raises UnauthenticatedError if there is no such user with this password; TooManyTriesError after too many tries.
        """
        self._begin_try(address, name)
        try:
            is_right = self._is_right(name, password)
        except ServiceError:
            self.wrong_logins.withdraw(address, name)
            raise
        if not is_right:
            raise UnauthenticatedError("there is no such user with this password")
        self.wrong_logins.right(address, name)
        token, at = new_token(), now()
        with self._database.write() as session:
            access.drop_expired_sessions(session, at)
            session.add(
                BrowserSessionRow(
                    token_sha256=fingerprint(token), user_name=name, created_at=at, expires_at=at + SESSION_LASTS
                )
            )
            access.note_login(session, name, host_of(address), at)
        self.forget()
        return token, at + SESSION_LASTS

    def name_of(self, name: str) -> str:
        """Return who a login says that it is; a name that no user has is not told: it may be a password."""
        return f"user {name}" if name in self._fresh(None).users else "an unknown user"

    def log_out(self, cookie: str) -> None:
        """End a browser session."""
        with self._database.write() as session:
            access.end_sessions(session, token_sha256=fingerprint(cookie))
        self.forget()

    def begin_entry(self, caller: Caller, action: str, target: str, axis: str | None, request_id: str | None) -> int:
        """Write an entry of the log before something is tried, and return its number."""
        with self._database.write() as session:
            row = AuditRow(
                at=now(), who=caller.name, action=action, target=target[:400], axis_id=axis and axis[:64],
                request_id=request_id,
            )  # fmt: skip
            session.add(row)
            session.flush()
            return row.id

    def end_entry(self, entry: int, status: int) -> None:
        """Complete an entry of the log with the answer that was given."""
        with self._database.write() as session:
            row = session.get(AuditRow, entry)
            if row is not None:
                row.status = status

    def log(self, axis: str | None, before_id: int | None, limit: int) -> list[AuditRow]:
        """Return entries of the log, newest first."""
        self.refusals.write()
        with self._database.read() as session:
            return access.list_audit(session, axis_id=axis, before_id=before_id, limit=limit)

    def forget(self) -> None:
        """Drop the cached keys and sessions, so that the next request reads them anew."""
        self._known = None

    def _of_key(self, callers: _Known, key: str, address: str) -> Caller:
        stored = callers.keys.get(fingerprint(key))
        if stored is None or (stored[2] is not None and stored[2] <= now()):
            wait_s = self.wrong_keys.begin(address, None, at_s=time.monotonic())
            if wait_s > 0.0:
                raise TooManyTriesError(f"too many wrong keys from this address; {_later(wait_s)}", wait_s)
            raise UnauthenticatedError(
                "the key is unknown, revoked or expired; `preload key list` shows those there are"
            )
        number, caller, _ = stored
        self._used[number] = now()
        return caller

    def _begin_try(self, address: str, name: str) -> None:
        """Count a login as a wrong one until it is known to be right."""
        is_known = self.wrong_logins.is_crowded(name, at_s=time.monotonic()) and self._knows(name, address)
        wait_s = self.wrong_logins.begin(address, name, at_s=time.monotonic(), is_known=is_known)
        if wait_s > 0.0 and self._note_unlocks():
            wait_s = self.wrong_logins.begin(address, name, at_s=time.monotonic(), is_known=is_known)
        if wait_s > 0.0:
            raise TooManyTriesError(
                "too many wrong passwords from this address, or for this name from addresses where it did not log in "
                f"before; {_later(wait_s)}, or ask an administrator for `preload user unlock`",
                wait_s,
            )

    def _knows(self, name: str, address: str) -> bool:
        """Return whether somebody logged in by this name from this address, not long ago."""
        with self._database.read() as session:
            return access.logged_in_since(session, name, host_of(address), now() - KNOWN_FOR)

    def _is_right(self, name: str, password: str) -> bool:
        with self._database.read() as session:
            users = {row.name: row for row in access.list_users(session) if row.disabled_at is None}
        user = users.get(name)
        # of nobody, too: who is no user is told so after the same time
        return is_password(password, of_nobody() if user is None else user.password_hash) and user is not None

    def _note_unlocks(self) -> bool:
        """Let those try again whom a command has unlocked, and return whether there was one."""
        with self._lock:
            if time.monotonic() - self._asked_for_unlocks_s < FRESH_S:
                return False
            with self._database.read() as session:
                newest = access.newest_entry(session)
                names = access.unlocked_names(session, self._unlocked_until, newest)
            self._asked_for_unlocks_s, self._unlocked_until = time.monotonic(), newest
        for name in names:
            self.wrong_logins.unlock(name)
        return bool(names)

    def _fresh(self, cookie: str | None) -> _Known:
        callers = self._known
        if callers is not None and self._holds(callers, cookie):
            return callers
        with self._lock:
            self._note_use()
            self._known = callers = self._read()
        return callers

    @staticmethod
    def _holds(callers: _Known, cookie: str | None) -> bool:
        heard_of = cookie is None or not callers.is_closed or fingerprint(cookie) in callers.sessions
        return time.monotonic() - callers.at_s < (FRESH_S if heard_of else _ASKED_AGAIN_S)

    def _read(self) -> _Known:
        at_s, at = time.monotonic(), now()
        with self._database.read() as session:
            users, keys = access.list_users(session), access.list_keys(session)
            sessions = access.live_sessions(session, at)
        has_administrator = any(user.role == access.ADMINISTRATOR for user in users)
        return _Known(
            at_s,
            is_closed=has_administrator or not self._on_loopback,
            users=frozenset(user.name for user in users),
            keys={
                row.secret_sha256: (
                    row.id,
                    Caller(
                        f"key {row.id} ({row.name})",
                        frozenset(map(Scope, row.scopes)),
                        None if row.axes is None else frozenset(row.axes),
                    ),
                    row.expires_at,
                )
                for row in keys
                if row.revoked_at is None
            },
            sessions={
                row.token_sha256: (Caller(f"user {user.name}", ROLES[user.role], user=user.name), row.expires_at)
                for row, user in sessions
                if user.disabled_at is None
            },
        )

    def _note_use(self) -> None:
        """Store when keys were last used, at most once a minute."""
        if not self._used or time.monotonic() - self._noted_at_s < _NOTED_EVERY_S:
            return
        used, self._used, self._noted_at_s = self._used, {}, time.monotonic()
        with self._database.write() as session:
            for number, at in used.items():
                access.get_key(session, number).last_used_at = at


def _later(wait_s: float) -> str:
    return f"try again in {math.ceil(wait_s)} s"


def require(caller: Caller, scope: Scope, axis: str | None) -> None:
    """Raise ForbiddenError unless a caller may do something, to an axis or to what belongs to none."""
    if scope not in caller.scopes:
        allowed = ", ".join(sorted(caller.scopes)) or "nothing"
        raise ForbiddenError(f"{caller.name} needs the scope {scope} for this; it has {allowed}")
    if caller.axes is not None and axis not in caller.axes:
        allowed = ", ".join(sorted(caller.axes))
        raise ForbiddenError(
            f"{caller.name} is for {allowed} only; this is "
            + ("of no axis or of all of them" if axis is None else f"of {axis[:64]}")
        )
