"""Serve only those who ask for this service by a name of its own, and let no page of others change anything."""

import ipaddress
from collections.abc import Collection
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from service.api.http.problems import problem

_SAFE = ("GET", "HEAD", "OPTIONS")


class Guard:
    """ASGI middleware: refuses host names of others, and requests that change something from pages of others.

    A page of another site whose name is pointed at this machine (DNS rebinding) asks by that name. An address is no
    name: nobody can point it elsewhere. Programs that are no browsers state no origin, and pass.
    """

    def __init__(self, app: ASGIApp, *, host_names: Collection[str]) -> None:
        self._app = app
        self._host_names = frozenset(name.lower() for name in host_names)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        refusal = self._refusal(scope) if scope["type"] == "http" else None
        await (refusal or self._app)(scope, receive, send)

    def _refusal(self, scope: Scope) -> Response | None:
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if not self._is_ours(host):
            return problem(
                421,
                "unknown-host",
                f"this service is asked by its address, or by a name in PRELOAD_HOST_NAMES; got {host[:100]!r}",
            )
        if scope["method"] not in _SAFE and _is_foreign(headers, host):
            return problem(
                403,
                "foreign-origin",
                f"a page may change something here only if it is of this service; got one of "
                f"{headers.get('origin', 'another site')[:100]}",
            )
        return None

    def _is_ours(self, host: str) -> bool:
        name = name_in(host)
        return name in self._host_names or is_address(name)


def name_in(host: str) -> str:
    """Return the name or address that a ``Host`` states, without its port; nothing where it states none."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def is_address(name: str) -> bool:
    """Tell whether it is an address of IPv4 or IPv6."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _is_foreign(headers: Headers, host: str) -> bool:
    """Tell whether a browser says that a page of another origin asks."""
    site = headers.get("sec-fetch-site")
    if site is not None:
        return site not in ("same-origin", "none")
    origin = headers.get("origin")
    return origin is not None and urlsplit(origin).netloc != host
