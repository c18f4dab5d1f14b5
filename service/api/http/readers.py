"""Answer readers in a few places of their own, so that nothing they ask for keeps windows waiting.

A place is held while an answer is computed, not while its client takes it: an answer in parts, as a table, waits for a
place again before each. Who waits for one and leaves is forgotten; where too many wait, or one has waited for long, the
client is asked to come back. What has begun to compute cannot be ended from outside: it is bounded in its steps.
"""

from collections import Counter
from weakref import WeakValueDictionary

import anyio
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.http.problems import problem

#: Readers that are answered at one time: more would share the processors with each other, and with windows.
AT_WORK = 3
#: A sender takes so many of these places at most.
OF_SENDER = AT_WORK - 1
#: So many wait for a place, each so long at most [s]: pages, gateways and Prometheus leave after 10 s.
MOST_WAITING = 200
PATIENCE_S = 4.0
#: A sender may wait with so many times the requests that could wait besides.
SHARE = 3
#: Whoever watches over the service is answered whatever it does, and files are read from the disk as they are.
_AT_ONCE = ("/healthz", "/readyz", "/static/")


class ReaderPlaces:
    """Lets few requests at a time into an application."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._places = anyio.CapacityLimiter(AT_WORK)
        self._of_senders = WeakValueDictionary[str, anyio.CapacityLimiter]()  # of those that are here
        self._waiting: Counter[str] = Counter()  # by sender

    async def serve(self, scope: Scope, receive: Receive, send: Send, hear: Receive) -> None:
        """Serve one request in a place; ``hear`` tells, after its body, that its client has left."""
        if scope["path"].startswith(_AT_ONCE):
            await self._app(scope, receive, send)
            return
        sender = (scope.get("client") or ("",))[0]
        place = _Place(self._of_senders.setdefault(sender, anyio.CapacityLimiter(OF_SENDER)), self._places)
        try:
            if await self._wait_for(place, sender, hear):
                await self._app(scope, receive, place.given_back_while(send))
            elif not place.is_left:
                detail = f"{self._waiting.total()} requests are waiting for an answer; come back later"
                await problem(503, "busy", detail)(scope, receive, place.given_back_while(send))
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
                await place.take_unless_left(hear)
        finally:
            self._waiting[sender] -= 1
            self._waiting += Counter()  # forget who does not wait
        return place.is_held


class _Place:
    """The place of one request: one of those of its sender, then one of all."""

    def __init__(self, *limiters: anyio.CapacityLimiter) -> None:
        self._limiters = limiters
        self._taken: list[anyio.CapacityLimiter] = []
        self.is_left = False

    @property
    def is_held(self) -> bool:
        return len(self._taken) == len(self._limiters)

    def take_at_once(self) -> bool:
        try:
            for limiter in self._limiters:
                limiter.acquire_on_behalf_of_nowait(self)
                self._taken.append(limiter)
        except anyio.WouldBlock:
            return False
        return True

    async def take(self) -> None:
        for limiter in self._limiters[len(self._taken) :]:
            await limiter.acquire_on_behalf_of(self)
            self._taken.append(limiter)

    async def take_unless_left(self, hear: Receive) -> None:
        """Wait for it until the client leaves."""
        async with anyio.create_task_group() as waiting:
            waiting.start_soon(self._leave_with_client, hear, waiting.cancel_scope)
            await self.take()
            waiting.cancel_scope.cancel()

    async def _leave_with_client(self, hear: Receive, waiting: anyio.CancelScope) -> None:
        while (await hear())["type"] != "http.disconnect":
            pass
        self.is_left = True
        waiting.cancel()

    def give_back(self) -> None:
        while self._taken:
            self._taken.pop().release_on_behalf_of(self)

    def given_back_while(self, send: Send) -> Send:
        """Return what sends on, without the place, and takes it again where another part is to be computed."""
        is_computed = False

        async def send_on(message: Message) -> None:
            nonlocal is_computed
            if message["type"] == "http.response.start":
                is_computed = b"content-length" not in dict(message["headers"])  # else it is there, or a file
            self.give_back()
            await send(message)
            if is_computed and message.get("more_body"):
                await self.take()

        return send_on
