"""Send what can be asked of one service: each call waited for, or of an event loop."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import asynccontextmanager
from functools import wraps
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

import httpx

from preload_client.exchange import SLOWEST_BYTES_PER_S, Transport, exchange, tls_context
from preload_client.routes import Routes

P = ParamSpec("P")
R = TypeVar("R")


class AsyncClient(Routes):
    """One service at an address, asked by coroutines of asyncio; otherwise as :class:`Client`."""

    def __init__(
        self,
        url: str,
        key: str | None = None,
        *,
        retries: int = 5,
        timeout_s: float = 120.0,
        ca_file: str | None = None,
    ) -> None:
        super().__init__(url, retries, timeout_s)
        self._http = httpx.AsyncClient(
            base_url=url, headers=_headers(key), verify=tls_context(ca_file), trust_env=False, timeout=timeout_s
        )

    async def __aenter__(self) -> Self:
        """Return itself."""
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the connections."""
        await self.close()

    async def close(self) -> None:
        """Close the connections."""
        await self._http.aclose()

    @asynccontextmanager
    async def _answered(
        self,
        method: str,
        path: str,
        total_s: float,
        most_bytes: int,
        **arguments: Any,  # noqa: ANN401
    ) -> AsyncIterator[tuple[httpx.Response, AsyncIterator[bytes]]]:
        request = self._http.build_request(method, path, **arguments)
        total_s += int(request.headers.get("content-length", 0)) / SLOWEST_BYTES_PER_S
        try:
            async with asyncio.timeout(total_s):
                answer = await self._http.send(request, stream=True)
                try:
                    yield answer, _at_most(most_bytes, answer)
                finally:
                    await answer.aclose()
        except TimeoutError as error:
            raise httpx.ReadTimeout(f"the exchange did not end within {round(total_s, 1):g} s") from error

    async def _pause(self, seconds: float) -> None:
        await asyncio.sleep(seconds)


async def _at_most(most_bytes: int, answer: httpx.Response) -> AsyncIterator[bytes]:
    async for part in answer.aiter_bytes():
        if answer.num_bytes_downloaded > most_bytes:
            raise httpx.ReadError(f"the answer is longer than {most_bytes} bytes")
        yield part


class _Blocking(Routes):
    """Coroutines that never wait for anybody: each sends and reads before it goes on."""

    def __init__(self, url: str, key: str | None, retries: int, timeout_s: float, ca_file: str | None) -> None:
        super().__init__(url, retries, timeout_s)
        transport = Transport(tls_context(ca_file))
        self.http = httpx.Client(base_url=url, headers=_headers(key), transport=transport, timeout=timeout_s)

    @asynccontextmanager
    async def _answered(
        self,
        method: str,
        path: str,
        total_s: float,
        most_bytes: int,
        **arguments: Any,  # noqa: ANN401
    ) -> AsyncIterator[tuple[httpx.Response, AsyncIterator[bytes]]]:
        with exchange(total_s, most_bytes), self.http.stream(method, path, **arguments) as answer:
            yield answer, _as_they_come(answer)

    async def _pause(self, seconds: float) -> None:
        time.sleep(seconds)


async def _as_they_come(answer: httpx.Response) -> AsyncIterator[bytes]:
    for part in answer.iter_bytes():
        yield part


def _ran(coroutine: Coroutine[Any, Any, R]) -> R:
    """Run a coroutine that never waits, with or without an event loop in this thread."""
    try:
        coroutine.send(None)
    except StopIteration as end:
        answer: R = end.value
        return answer
    raise AssertionError("what blocks does not wait for an event loop")


def _at_once(
    method: Callable[Concatenate[Routes, P], Coroutine[Any, Any, R]],
) -> Callable[Concatenate["Client", P], R]:
    @wraps(method)
    def ask(self: "Client", /, *args: P.args, **kwargs: P.kwargs) -> R:
        return _ran(method(self._routes, *args, **kwargs))

    return ask


def _one_by_one(
    method: Callable[Concatenate[Routes, P], AsyncIterator[R]],
) -> Callable[Concatenate["Client", P], Iterator[R]]:
    async def after(records: AsyncIterator[R]) -> R:
        return await anext(records)

    @wraps(method)
    def ask(self: "Client", /, *args: P.args, **kwargs: P.kwargs) -> Iterator[R]:
        records = method(self._routes, *args, **kwargs)
        while True:
            try:
                record = _ran(after(records))
            except StopAsyncIteration:
                return
            yield record

    return ask


class Client:
    """One service at an address; the key, if it is closed, is sent with each request.

    A request ends after ``timeout_s`` in all, one with a file after an hour, and a second later for each 64 KiB that it
    sends. ``ca_file`` says whom TLS believes: the authorities of the system if it is not given.
    """

    def __init__(
        self,
        url: str,
        key: str | None = None,
        *,
        retries: int = 5,
        timeout_s: float = 120.0,
        ca_file: str | None = None,
    ) -> None:
        self._routes = _Blocking(url, key, retries, timeout_s, ca_file)

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the connection."""
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._routes.http.close()

    axes = _at_once(Routes.axes)
    axis = _at_once(Routes.axis)
    register = _at_once(Routes.register)
    trend = _one_by_one(Routes.trend)
    trend_arrays = _at_once(Routes.trend_arrays)
    lost_motion = _one_by_one(Routes.lost_motion)
    post_lost_motion = _at_once(Routes.post_lost_motion)
    post_windows = _at_once(Routes.post_windows)
    measurement = _at_once(Routes.measurement)
    calibrate = _at_once(Routes.calibrate)
    activate = _at_once(Routes.activate)
    maintenance = _at_once(Routes.maintenance)
    post_maintenance = _at_once(Routes.post_maintenance)
    upload = _at_once(Routes.upload)
    replay = _at_once(Routes.replay)
    jobs = _one_by_one(Routes.jobs)
    job = _at_once(Routes.job)
    cancel = _at_once(Routes.cancel)
    wait = _at_once(Routes.wait)
    alarms = _one_by_one(Routes.alarms)
    acknowledge = _at_once(Routes.acknowledge)
    clear = _at_once(Routes.clear)
    records = _one_by_one(Routes.records)
    table = _at_once(Routes.table)
    request = _at_once(Routes.request)


def _headers(key: str | None) -> dict[str, str]:
    return {"Authorization": f"Bearer {key}"} if key else {}
