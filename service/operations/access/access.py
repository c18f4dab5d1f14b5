"""Authenticate and authorise requests, pages and commands; keep the log of changes."""

import threading
import time
from collections import OrderedDict
from dataclasses import dataclass
from datetime import datetime, timedelta

from service.clock import now
from service.errors import ForbiddenError, TooManyTriesError, UnauthenticatedError
from service.operations.access.passwords import fingerprint, is_password, new_token, of_nobody
from service.operations.access.scopes import ANYONE, ROLES, Caller, Scope
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
#: So many may be wrong without a wait, as people are; then 1, 2, 4 … seconds, not more than this.
FREE_TRIES = 5
LONGEST_WAIT_S = 300.0
#: After so long without a wrong try it is forgotten.
_FORGOTTEN_AFTER_S = 3600.0
_MOST_NAMES = 10_000


@dataclass(slots=True)
class _Tries:
    n_wrong: int
    last_s: float


class LoginThrottle:
    """Delays logins after wrong tries, by user name and by address. Times are of one clock."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._tries: OrderedDict[str, _Tries] = OrderedDict()

    def wait_s(self, *names: str, at_s: float) -> float:
        """Return how long to wait before the next try of any of the names; 0: try now."""
        with self._lock:
            return max((self._wait(name, at_s) for name in names), default=0.0)

    def wrong(self, *names: str, at_s: float) -> None:
        """Count a wrong try."""
        with self._lock:
            for name in names:
                tries = self._tries.pop(name, None)
                n_before = 0 if tries is None or at_s - tries.last_s > _FORGOTTEN_AFTER_S else tries.n_wrong
                self._tries[name] = _Tries(n_before + 1, at_s)
            while len(self._tries) > _MOST_NAMES:
                self._tries.popitem(last=False)

    def right(self, *names: str) -> None:
        """Reset the count after a correct login."""
        with self._lock:
            for name in names:
                self._tries.pop(name, None)

    def _wait(self, name: str, at_s: float) -> float:
        tries = self._tries.get(name)
        if tries is None or tries.n_wrong < FREE_TRIES or at_s - tries.last_s > _FORGOTTEN_AFTER_S:
            return 0.0
        return max(0.0, tries.last_s + min(2.0 ** (tries.n_wrong - FREE_TRIES), LONGEST_WAIT_S) - at_s)


@dataclass(frozen=True, slots=True)
class _Known:
    """Keys, logged-in users, and whether anybody has to say who it is, as they were at one moment."""

    at_s: float
    is_closed: bool
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
        self.throttle = LoginThrottle()

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
        at_s, tried = time.monotonic(), (f"user {name}", f"address {address}")
        self._require_no_wait(*tried, at_s=at_s)
        with self._database.read() as session:
            users = {row.name: row for row in access.list_users(session) if row.disabled_at is None}
        user = users.get(name)
        if not is_password(password, of_nobody() if user is None else user.password_hash) or user is None:
            self.throttle.wrong(*tried, at_s=at_s)
            self.note(f"user {name}"[:120], "log in", "/login", 401)
            raise UnauthenticatedError("there is no such user with this password")
        self.throttle.right(*tried)
        token, at = new_token(), now()
        with self._database.write() as session:
            access.drop_expired_sessions(session, at)
            session.add(
                BrowserSessionRow(
                    token_sha256=fingerprint(token), user_name=name, created_at=at, expires_at=at + SESSION_LASTS
                )
            )
        self.note(f"user {name}", "log in", "/login", 200)
        self.forget()
        return token, at + SESSION_LASTS

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

    def note(self, who: str, action: str, target: str, status: int) -> None:
        """Write a complete entry of the log."""
        with self._database.write() as session:
            session.add(AuditRow(at=now(), who=who, action=action, target=target, status=status))

    def log(self, axis: str | None, before_id: int | None, limit: int) -> list[AuditRow]:
        """Return entries of the log, newest first."""
        with self._database.read() as session:
            return access.list_audit(session, axis_id=axis, before_id=before_id, limit=limit)

    def forget(self) -> None:
        """Drop the cached keys and sessions, so that the next request reads them anew."""
        self._known = None

    def _of_key(self, callers: _Known, key: str, address: str) -> Caller:
        at_s, tried = time.monotonic(), f"key from {address}"
        stored = callers.keys.get(fingerprint(key))
        if stored is None or (stored[2] is not None and stored[2] <= now()):
            self._require_no_wait(tried, at_s=at_s)
            self.throttle.wrong(tried, at_s=at_s)
            raise UnauthenticatedError(
                "the key is unknown, revoked or expired; `preload key list` shows those there are"
            )
        number, caller, _ = stored
        self._used[number] = now()
        return caller

    def _require_no_wait(self, *tried: str, at_s: float) -> None:
        wait_s = self.throttle.wait_s(*tried, at_s=at_s)
        if wait_s > 0.0:
            raise TooManyTriesError(f"too many wrong tries; try again in {wait_s:.0f} s or later", wait_s)

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
