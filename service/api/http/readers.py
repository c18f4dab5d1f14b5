"""Answer readers in a few places of their own, so that nothing they ask for keeps windows waiting.

A place is held until the answer begins: what is computed for it is computed by then. Who waits for one and leaves is
forgotten; where too many wait, or one has waited for long, the client is asked to come back. What has begun to compute
cannot be ended from outside: it is bounded in its steps.
"""

from collections import Counter

import anyio
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.http.problems import problem

#: Readers that are answered at one time: more would share the processors with each other, and with windows.
AT_WORK = 3
#: So many wait for a place, each so long at most [s].
MOST_WAITING = 200
PATIENCE_S = 20.0
#: A sender may wait with so many times the requests that could wait besides.
SHARE = 3
#: Whoever watches over the service is answered whatever it does, and files are read from the disk as they are.
_AT_ONCE = ("/healthz", "/readyz", "/static/")


class ReaderPlaces:
    """Lets few requests at a time into an application."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._places = anyio.CapacityLimiter(AT_WORK)
        self._waiting: Counter[str] = Counter()  # by sender

    async def serve(self, scope: Scope, receive: Receive, send: Send, hear: Receive) -> None:
        """Serve one request in a place; ``hear`` tells, after its body, that its client has left."""
        if scope["path"].startswith(_AT_ONCE):
            await self._app(scope, receive, send)
            return
        place = _Place(self._places)
        try:
            if await self._wait_for(place, (scope.get("client") or ("",))[0], hear):
                await self._app(scope, receive, place.given_back_before(send))
            elif not place.is_left:
                detail = f"{self._waiting.total()} requests are waiting for an answer; come back later"
                await problem(503, "busy", detail)(scope, receive, send)
        finally:
            place.give_back()

    async def _wait_for(self, place: "_Place", sender: str, hear: Receive) -> bool:
        """Wait for a place; return whether it was given."""
        if place.take_at_once():
            return True
        if self._waiting[sender] >= SHARE * (MOST_WAITING - self._waiting.total()):
            return False
        self._waiting[sender] += 1
        try:
            with anyio.move_on_after(PATIENCE_S):
                await place.take(hear)
        finally:
            self._waiting[sender] -= 1
            self._waiting += Counter()  # forget who does not wait
        return place.is_held


class _Place:
    """The place of one request."""

    def __init__(self, places: anyio.CapacityLimiter) -> None:
        self._places = places
        self.is_held = self.is_left = False

    def take_at_once(self) -> bool:
        try:
            self._places.acquire_on_behalf_of_nowait(self)
        except anyio.WouldBlock:
            return False
        self.is_held = True
        return True

    async def take(self, hear: Receive) -> None:
        """Wait for it until the client leaves."""
        async with anyio.create_task_group() as waiting:
            waiting.start_soon(self._leave_with_client, hear, waiting.cancel_scope)
            await self._places.acquire_on_behalf_of(self)
            self.is_held = True
            waiting.cancel_scope.cancel()

    async def _leave_with_client(self, hear: Receive, waiting: anyio.CancelScope) -> None:
        while (await hear())["type"] != "http.disconnect":
            pass
        self.is_left = True
        waiting.cancel()

    def give_back(self) -> None:
        if self.is_held:
            self.is_held = False
            self._places.release_on_behalf_of(self)

    def given_back_before(self, send: Send) -> Send:
        """Return what sends on, and gives the place back before."""

        async def send_on(message: Message) -> None:
            self.give_back()
            await send(message)

        return send_on
