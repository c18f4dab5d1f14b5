"""Readers are answered in a few places of their own: they wait, leave or are sent away, and windows pass by them."""

import asyncio
import gc
from pathlib import Path

import pytest
from starlette.types import Message, Receive, Scope, Send

from service.api.http import readers
from service.api.http.limits import RequestLimits
from service.gateways.opcua_reading import READ_WITHIN_S

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


def several(n: int, asked: tuple[str, str]) -> list[Client]:
    """Return clients of as many senders."""
    return [Client(*asked, address=f"10.0.1.{i}") for i in range(n)]


class Service:
    """An application that computes until it is let go on."""

    def __init__(self, most_waiting: int = 1000) -> None:
        self.goes_on, self.next_part, self.n_parts = asyncio.Event(), asyncio.Semaphore(0), 0
        self.limits = RequestLimits(self._answer, largest_body=100, most_waiting=most_waiting)
        self._clients: dict[int, Client] = {}
        self.requests: list[asyncio.Task[None]] = []

    async def _answer(self, scope: Scope, _: Receive, send: Send) -> None:
        client = self._clients[id(scope)]
        client.is_served = True
        if (scope["method"], scope["path"]) != WINDOWS:
            await self.goes_on.wait()
        await send({"type": "http.response.start", "status": 200, "headers": []})
        for part in range(self.n_parts):
            await self.next_part.acquire()
            await send({"type": "http.response.body", "body": b"part", "more_body": part + 1 < self.n_parts})

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
        waiting = several(3 * readers.AT_WORK, asked)
        await service.ask(*waiting, windows, health := Client("GET", "/healthz"), metrics := Client("GET", "/metrics"))
        assert [client.is_served for client in waiting] == [i < readers.AT_WORK for i in range(len(waiting))]
        assert windows.status == 200
        assert health.is_served
        assert metrics.is_served
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
        at_work, left = several(readers.AT_WORK, GET), [Client(*asked) for _ in range(40)]
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
        of_one = [Client(*GET) for _ in range(readers.OF_SENDER + 8)]
        await service.ask(*several(1, GET), *of_one, other := Client(*GET, address="10.0.0.2"))
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
        await service.ask(*several(readers.AT_WORK, GET), late := Client(*GET))
        await asyncio.sleep(0.05)
        assert late.status == 503
        service.goes_on.set()
        await asyncio.gather(*service.requests)

    asyncio.run(story())


def test_no_sender_takes_every_place() -> None:
    async def story() -> None:
        service, of_one = Service(), [Client(*GET) for _ in range(40)]
        await service.ask(*of_one, *(others := several(2, GET)))
        assert sum(client.is_served for client in of_one) == readers.OF_SENDER
        assert [client.is_served for client in others] == [True, False]
        service.goes_on.set()
        await asyncio.gather(*service.requests)
        assert {client.status for client in (*of_one, *others)} == {200}
        gc.collect()
        assert not service.limits._readers._of_senders  # nobody is kept in mind

    asyncio.run(story())


def test_each_part_of_an_answer_is_computed_in_a_place() -> None:
    async def story() -> None:
        service = Service()
        service.goes_on.set()
        service.n_parts = 2
        await service.ask(table := Client(*GET))
        service.next_part.release()
        await asyncio.sleep(0.01)
        assert len(table.sent) == 2
        service.goes_on.clear()
        await service.ask(*(others := several(readers.AT_WORK, GET)))
        assert [client.is_served for client in others] == [True] * (readers.AT_WORK - 1) + [False]
        service.goes_on.set()
        for _ in range(2 * readers.AT_WORK + 1):
            service.next_part.release()
        await asyncio.gather(*service.requests)
        assert {len(client.sent) for client in (table, *others)} == {3}

    asyncio.run(story())


def test_who_waits_is_answered_before_it_gives_up() -> None:
    """Half of the time is left to compute the answer. Prometheus waits 10 s unless another time is stated."""
    script = Path(readers.__file__).parents[2] / "web/static/live.js"
    answer_ms = float(script.read_text(encoding="utf-8").partition("ANSWER_MS = ")[2].partition(";")[0])
    assert min(READ_WITHIN_S, answer_ms / 1000, 10.0) / 2 >= readers.PATIENCE_S
