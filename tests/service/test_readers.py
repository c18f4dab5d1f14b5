"""Readers are answered in a few places of their own: they wait, leave or are sent away, and windows pass by them."""

import asyncio

import pytest
from starlette.types import Message, Receive, Scope, Send

from service.api.http import readers
from service.api.http.limits import RequestLimits

GET, PUT, WINDOWS = ("GET", "/v1/axes"), ("PUT", "/v1/axes/a"), ("POST", "/v1/axes/a/windows")


class Client:
    """A client, what it is answered, and whether the application was reached for it."""

    def __init__(self, method: str, path: str, address: str = "10.0.0.1", size: int = 2) -> None:
        self.scope: Scope = {"type": "http", "method": method, "path": path, "headers": [], "client": (address, 1)}
        self.leaves, self.sent, self.is_served = asyncio.Event(), list[Message](), False
        halves = [b"{" + b" " * (size - 2), b"}"]
        self._body: list[Message] = [
            {"type": "http.request", "body": half, "more_body": half is halves[0]} for half in reversed(halves)
        ]

    async def receive(self) -> Message:
        if self._body:
            await asyncio.sleep(0)
            return self._body.pop()
        await self.leaves.wait()
        return {"type": "http.disconnect"}

    async def send(self, message: Message) -> None:
        self.sent.append(message)

    @property
    def status(self) -> int | None:
        return self.sent[0]["status"] if self.sent else None


class Service:
    """An application that computes until it is let go on."""

    def __init__(self, most_waiting: int = 1000) -> None:
        self.goes_on = asyncio.Event()
        self.limits = RequestLimits(self._answer, largest_body=100, most_waiting=most_waiting)
        self._clients: dict[int, Client] = {}
        self.requests: list[asyncio.Task[None]] = []

    async def _answer(self, scope: Scope, _: Receive, send: Send) -> None:
        client = self._clients[id(scope)]
        client.is_served = True
        if (scope["method"], scope["path"]) != WINDOWS:
            await self.goes_on.wait()
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def ask(self, *clients: Client) -> None:
        """Send requests, and let each come as far as it can."""
        for client in clients:
            self._clients[id(client.scope)] = client
            self.requests.append(asyncio.create_task(self.limits(client.scope, client.receive, client.send)))
        await asyncio.sleep(0.01)


@pytest.mark.parametrize("asked", [GET, PUT])
def test_few_readers_are_at_work_and_windows_pass_by_those_that_wait(asked: tuple[str, str]) -> None:
    async def story() -> None:
        service, windows = Service(), Client(*WINDOWS)
        waiting = [Client(*asked) for _ in range(3 * readers.AT_WORK)]
        await service.ask(*waiting, windows, health := Client("GET", "/healthz"))
        assert [client.is_served for client in waiting] == [i < readers.AT_WORK for i in range(len(waiting))]
        assert windows.status == 200
        assert health.is_served
        service.goes_on.set()
        await asyncio.gather(*service.requests)
        assert {client.status for client in waiting} == {200}

    asyncio.run(story())


def test_documents_that_wait_take_neither_place_nor_memory_of_windows() -> None:
    async def story() -> None:
        service, windows = Service(most_waiting=8), Client(*WINDOWS)
        documents = [Client(*PUT, address=f"10.0.0.{n}", size=100) for n in range(12)]
        await service.ask(*documents, login := Client("POST", "/login"), windows)
        assert [client.status for client in documents] == [None] * 8 + [503] * 4
        assert windows.status == 200
        assert login.is_served
        service.goes_on.set()
        await asyncio.gather(*service.requests)

    asyncio.run(story())


@pytest.mark.parametrize("asked", [GET, PUT])
def test_who_leaves_while_it_waits_is_never_computed_for(asked: tuple[str, str]) -> None:
    async def story() -> None:
        service = Service()
        at_work, left = [Client(*GET) for _ in range(readers.AT_WORK)], [Client(*asked) for _ in range(40)]
        await service.ask(*at_work, *left, last := Client(*GET))
        for client in left:
            client.leaves.set()
        await asyncio.sleep(0.01)
        assert sum(request.done() for request in service.requests) == len(left)
        service.goes_on.set()
        await asyncio.gather(*service.requests)
        assert not any(client.is_served for client in left)
        assert last.status == 200  # a place is found again

    asyncio.run(story())


def test_of_too_many_that_wait_the_next_is_asked_to_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(readers, "MOST_WAITING", 8)

    async def story() -> None:
        service = Service()
        of_one = [Client(*GET) for _ in range(readers.AT_WORK + 8)]
        await service.ask(*of_one, other := Client(*GET, address="10.0.0.2"))
        refused = [client for client in of_one if client.status is not None]
        assert len(refused) == 2  # of eight, three quarters
        assert {client.status for client in refused} == {503}
        assert (b"retry-after", b"1") in refused[0].sent[0]["headers"]
        assert other.status is None  # there is room for others
        service.goes_on.set()
        await asyncio.gather(*service.requests)
        assert other.status == 200

    asyncio.run(story())


def test_who_has_waited_for_long_is_asked_to_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(readers, "PATIENCE_S", 0.005)

    async def story() -> None:
        service = Service()
        await service.ask(*(Client(*GET) for _ in range(readers.AT_WORK)), late := Client(*GET))
        await asyncio.sleep(0.05)
        assert late.status == 503
        service.goes_on.set()
        await asyncio.gather(*service.requests)

    asyncio.run(story())
