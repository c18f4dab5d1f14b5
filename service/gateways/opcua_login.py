"""Let one name with one password in at the OPC UA server, and slow down who guesses them."""

import hmac
import logging
import time
from contextvars import ContextVar

from asyncua import ua
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.user_managers import UserManager

from service.operations.access.throttle import MOST_ADDRESSES, LoginThrottle, host_of

log = logging.getLogger(__name__)

#: Of the client whose session is being activated: the library asks for a user without saying where it asks from.
_ADDRESS: ContextVar[str] = ContextVar("address")


class OneUser(UserManager):  # type: ignore[misc]  # the library's types are not read
    """Lets one name with one password in; an address that guesses waits as it does at ``/login``."""

    def __init__(self, username: str, password: str) -> None:
        self._name = username
        self._expected = f"{username}\n{password}".encode()
        self._throttle = LoginThrottle()
        self._known = set[str]()  # hosts from which the right password came
        self._told = set[str]()  # hosts that wait, and of which the log says so

    def get_user(
        self,
        iserver: InternalServer,
        username: str | None = None,
        password: str | None = None,
        certificate: object = None,
    ) -> User | None:
        """Return who may read, None where name or password is another, or too many were."""
        del iserver, certificate
        address, name = _ADDRESS.get(), self._name if username == self._name else "another name"
        host = host_of(address)
        is_known = username == self._name and host in self._known
        if self._throttle.begin(address, name, at_s=time.monotonic(), is_known=is_known) > 0.0:
            self._tell_wait(host)
            return None
        self._told.discard(host)
        if hmac.compare_digest(f"{username}\n{password}".encode(), self._expected):
            self._throttle.right(address, name)
            self._known.add(host)
            return User(UserRole.User, username)
        log.warning("OPC UA: a wrong name or password came from %s", host)
        return None

    def _tell_wait(self, host: str) -> None:
        if host in self._told:
            return
        if len(self._told) >= MOST_ADDRESSES:
            self._told.clear()
        self._told.add(host)
        log.warning("OPC UA: %s has to wait after wrong tries; until then the right password is refused, too", host)


class Sessions(InternalServer):  # type: ignore[misc]
    """The library's server, whose sessions say from which address a user is asked for."""

    def create_session(
        self,
        name: tuple[str, int],  # of a session from outside it is the address and port of its client
        user: User = User(role=UserRole.Anonymous),  # noqa: B008 - as the library has it
        external: bool = False,
    ) -> InternalSession:
        """Make a session for a client."""
        return _Session(self, self.aspace, self.subscription_service, name, user=user, external=external)


class _Session(InternalSession):  # type: ignore[misc]
    def activate_session(
        self, params: ua.ActivateSessionParameters, peer_certificate: bytes | None
    ) -> ua.ActivateSessionResult:
        """Ask for the user, from the address of the client."""
        _ADDRESS.set(self.name[0])
        return super().activate_session(params, peer_certificate)
