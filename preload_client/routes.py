"""Say once what can be asked of a service, however it is sent: windows and recordings in, trends, alarms, tables out.

A request is repeated where that is safe: always while nobody answers the call or the service is busy (503), for then
nothing was changed; after a broken connection only what may be done twice. Windows may: the service knows them by axis
and time.
"""

import base64
import json
import time
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, ExitStack, suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, cast

import httpx

from preload_client.errors import JobFailedError, ProblemError, UnreachableError
from preload_client.records import (
    Alarm,
    Axis,
    Calibration,
    Calibrations,
    Document,
    Job,
    LostMotionPoint,
    LostMotionReceipt,
    MaintenanceEntry,
    Measurement,
    Receipt,
    TrendPoint,
)

if TYPE_CHECKING:
    import numpy as np

#: RFC 3339 with a zone, or a moment with one.
Moment: TypeAlias = str | datetime
_CHANNELS = ("excitation", "response", "position_trace_m", "reference")
_COUNTED_FROM_ANYWHERE = ("displacement", "motor-angle", "relative-displacement")
_SAFE = ("GET", "PUT", "DELETE")
_LONGEST_PAUSE_S = 30.0
#: An answer has at most so many bytes, a table that goes into a file so many; and a file may take so long.
_MOST_BYTES, _MOST_OF_TABLE, _TRANSFER_S = 2**26, 2**36, 3600.0
#: The service, or a proxy before it, says: not now. Nothing was changed.
_BUSY = (429, 503)
#: A proxy says that it got no answer: like a broken connection.
_BROKEN = (502, 504)
#: No answer came that can be read, or nothing could be asked at that address.
_NO_ANSWER = (httpx.RequestError, httpx.InvalidURL)


class Routes(ABC):
    """What can be asked; who inherits says how a request goes out and how it waits."""

    def __init__(self, url: str, retries: int, timeout_s: float) -> None:
        self._url = url
        self._retries = retries
        self._timeout_s = timeout_s
        try:
            httpx.URL(url)
        except httpx.InvalidURL as error:
            raise self._unreachable(error) from error

    @abstractmethod
    def _answered(
        self,
        method: str,
        path: str,
        total_s: float,
        most_bytes: int,
        **arguments: Any,  # noqa: ANN401
    ) -> AbstractAsyncContextManager[tuple[httpx.Response, AsyncIterator[bytes]]]:
        """Send a request; give the head of its answer and the parts of it, within a time and a size."""

    @abstractmethod
    async def _pause(self, seconds: float) -> None:
        """Wait."""

    # axes and what was measured

    async def axes(self) -> list[Axis]:
        """Return all axes and how each stands."""
        return [cast(Axis, axis) async for axis in self.records("/v1/axes", "axes")]

    async def axis(self, axis: str) -> Axis:
        """Return one axis and how it stands."""
        return cast(Axis, await self.request("GET", f"/v1/axes/{axis}"))

    async def register(self, axis: str, name: str, configuration: Document | None = None) -> Axis:
        """Register an axis, or change its name and configuration."""
        body = {"name": name, "configuration": configuration or {}}
        return cast(Axis, await self.request("PUT", f"/v1/axes/{axis}", json=body))

    def trend(self, axis: str, start: Moment | None = None, end: Moment | None = None) -> AsyncIterator[TrendPoint]:
        """Yield measurements in time order, refused ones included; ``start`` is inside, ``end`` is not."""
        query = {"from": _written(start), "to": _written(end), "limit": 10_000}
        return cast(AsyncIterator[TrendPoint], self.records(f"/v1/axes/{axis}/trend", "points", query))

    async def trend_arrays(
        self, axis: str, start: Moment | None = None, end: Moment | None = None
    ) -> "dict[str, np.ndarray[Any, Any]]":
        """Return the judged measurements as numpy arrays by name; an open end of an interval is infinite."""
        import numpy as np  # noqa: PLC0415  # the only method that needs it

        points = [point async for point in self.trend(axis, start, end) if point["preload_n"] is not None]
        ends = [point["interval_95_n"] or (None, None) for point in points]
        return {
            "at": np.array([point["at"].removesuffix("Z") for point in points], dtype="datetime64[us]"),
            "preload_n": np.array([point["preload_n"] for point in points], dtype=float),
            "lower_n": np.array([-np.inf if lower is None else lower for lower, _ in ends], dtype=float),
            "upper_n": np.array([np.inf if upper is None else upper for _, upper in ends], dtype=float),
            "frequency_hz": np.array([point["frequency_hz"] for point in points], dtype=float),
            "position_mm": np.array([point["position_mm"] for point in points], dtype=float),
        }

    def lost_motion(
        self, axis: str, start: Moment | None = None, end: Moment | None = None
    ) -> AsyncIterator[LostMotionPoint]:
        """Yield what was measured of lost motion in time order; ``start`` is inside, ``end`` is not."""
        query = {"from": _written(start), "to": _written(end), "limit": 10_000}
        return cast(AsyncIterator[LostMotionPoint], self.records(f"/v1/axes/{axis}/lost-motion", "points", query))

    async def post_lost_motion(self, axis: str, readings: Sequence[Document]) -> LostMotionReceipt:
        """Send lost motion, as ``preload lost-motion --json`` gives it. Safe to repeat."""
        body = {"readings": list(readings)}
        answer = await self.request("POST", f"/v1/axes/{axis}/lost-motion", json=body, repeatable=True)
        return cast(LostMotionReceipt, answer)

    async def post_windows(self, axis: str, windows: Sequence[Document], *, complete: bool = False) -> Receipt:
        """Send windows; samples are numbers, bytes of little-endian float32, or numpy arrays. Safe to repeat."""
        body = {"windows": [_window(window) for window in windows], "complete": complete}
        return cast(Receipt, await self.request("POST", f"/v1/axes/{axis}/windows", json=body, repeatable=True))

    async def measurement(self, axis: str, measurement: int) -> Measurement:
        """Return one measurement, by its ``measurement_id``, with all its value rests on."""
        return cast(Measurement, await self.request("GET", f"/v1/axes/{axis}/measurements/{measurement}"))

    # what a value rests on: calibrations, and what was done to an axis

    async def calibrate(
        self,
        axis: str,
        start: Moment | None = None,
        end: Moment | None = None,
        *,
        readings: Sequence[Document] | None = None,
        document: Document | None = None,
        prior: Document | None = None,
        comment: str = "",
    ) -> Calibration:
        """Fit a calibration to the stored measurements whose preload was set, or to readings, or bring a document.

        Nothing is in force before :meth:`activate`. ``prior``: a document whose k1…k4 were known before.
        """
        body: dict[str, object] = {"prior": prior, "comment": comment, "readings": readings, "document": document}
        if readings is None and document is None:
            body["measurements"] = {"from": _written(start), "to": _written(end)}
        return cast(Calibration, await self.request("POST", f"/v1/axes/{axis}/calibrations", json=body))

    async def activate(self, axis: str, calibration: int, reason: str) -> Calibrations:
        """Put a calibration in force; return all of the axis, and which was in force since when."""
        path = f"/v1/axes/{axis}/calibrations/{calibration}/activate"
        return cast(Calibrations, await self.request("POST", path, json={"reason": reason}))

    async def maintenance(self, axis: str) -> list[MaintenanceEntry]:
        """Return what was done to an axis, corrected entries included, by when it was done."""
        path = f"/v1/axes/{axis}/maintenance"
        return [cast(MaintenanceEntry, entry) async for entry in self.records(path, "entries")]

    async def post_maintenance(
        self,
        axis: str,
        at: Moment,
        who: str,
        kind: str,
        *,
        note: str = "",
        set_preload_n: float | None = None,
        corrects: int | None = None,
    ) -> MaintenanceEntry:
        """Say what was done to an axis; a new nut or screw begins its charts anew. Safe to repeat."""
        body: dict[str, object] = {"at": _written(at), "who": who, "kind": kind, "note": note}
        body |= {"set_preload_n": set_preload_n, "corrects": corrects}
        answer = await self.request("POST", f"/v1/axes/{axis}/maintenance", json=body, repeatable=True)
        return cast(MaintenanceEntry, answer)

    # recordings and jobs

    async def upload(self, axis: str, files: Sequence[Path | str], channel_map: Path | str | None = None) -> Job:
        """Upload a session, or raw files with their channel map; :meth:`wait` for the job that takes the windows."""
        with ExitStack() as stack:
            parts = [("file", (Path(file).name, stack.enter_context(Path(file).open("rb")))) for file in files]
            data = {} if channel_map is None else {"map": Path(channel_map).read_text(encoding="utf-8")}
            # a stream that was read once is not there again: this is not repeated
            answer = await self.request("POST", f"/v1/axes/{axis}/recordings", files=parts, data=data, retries=0)
        return cast(Job, answer)

    async def replay(self, axis: str, session: str) -> Job:
        """Replay a session of the service's own folder into an axis."""
        return cast(Job, await self.request("POST", f"/v1/axes/{axis}/replays", json={"session": session}))

    def jobs(self, axis: str | None = None) -> AsyncIterator[Job]:
        """Yield jobs, newest first."""
        return cast(AsyncIterator[Job], self.records("/v1/jobs", "jobs", {"axis": axis, "limit": 200}))

    async def job(self, job: str) -> Job:
        """Return a job as it stands."""
        return cast(Job, await self.request("GET", f"/v1/jobs/{job}"))

    async def cancel(self, job: str) -> Job:
        """Ask a job to stop; work already done stays done."""
        return cast(Job, await self.request("POST", f"/v1/jobs/{job}/cancel", repeatable=True))

    async def wait(
        self, job: Job, progress: Callable[[Job], object] | None = None, *, every_s: float = 0.5, most_s: float = 3600.0
    ) -> Job:
        """Wait until a job is done; ``progress`` is told how it stands.

        Raises JobFailedError if it fails or is cancelled, TimeoutError if it is not done after ``most_s``.
        """
        until = time.monotonic() + most_s
        while True:
            job = await self.job(job["id"])
            if progress is not None:
                progress(job)
            if job["status"] == "done":
                return job
            if job["status"] in ("failed", "cancelled"):
                raise JobFailedError(job)
            if time.monotonic() > until:
                raise TimeoutError(f"job {job['id']} is {job['status']} after {most_s:g} s")
            await self._pause(every_s)

    # alarms

    def alarms(
        self, axis: str | None = None, status: Literal["active", "acknowledged", "cleared"] | None = None
    ) -> AsyncIterator[Alarm]:
        """Yield alarms, newest first."""
        query = {"axis": axis, "status": status, "limit": 200}
        return cast(AsyncIterator[Alarm], self.records("/v1/alarms", "alarms", query))

    async def acknowledge(self, alarm: int, comment: str) -> Alarm:
        """Say that somebody has seen an alarm."""
        return cast(Alarm, await self.request("POST", f"/v1/alarms/{alarm}/acknowledge", json={"comment": comment}))

    async def clear(self, alarm: int, comment: str) -> Alarm:
        """Close an alarm after inspection: the level is learnt anew."""
        return cast(Alarm, await self.request("POST", f"/v1/alarms/{alarm}/clear", json={"comment": comment}))

    # whatever the service has

    async def records(
        self, path: str, member: str, query: Mapping[str, object] | None = None
    ) -> AsyncIterator[Document]:
        """Yield the records of any list, page after page."""
        stated = {name: value for name, value in (query or {}).items() if value is not None}
        while True:
            page = await self.request("GET", path, params=stated)
            if not isinstance(page.get(member), list):
                raise self._no_service()
            for record in cast(Iterable[Document], page[member]):
                yield record
            if page.get("next_cursor") is None:
                return
            stated["cursor"] = page["next_cursor"]

    async def table(self, /, path: str, file: Path | str, **query: str | int) -> Path:
        """Write a trend, the alarms or the log of changes into a file; the end of its name, .csv or .parquet, says how.

        Raises ProblemError if the service refuses, ValueError if what is there is no table.
        """
        kind = Path(file).suffix.removeprefix(".")
        query["format"] = kind
        try:
            async with self._answered("GET", path, _TRANSFER_S, _MOST_OF_TABLE, params=query) as (answer, parts):
                if not answer.is_success:
                    raise _refusal("GET", path, answer, await _joined(parts))
                if kind not in answer.headers.get("content-type", ""):
                    raise ValueError(f"{path} is no table; trend, alarms and audit are, as .csv and .parquet")
                with Path(file).open("wb") as output:
                    async for part in parts:
                        output.write(part)
        except _NO_ANSWER as error:
            raise self._unreachable(error) from error
        return Path(file)

    async def request(
        self,
        /,
        method: str,
        path: str,
        *,
        repeatable: bool = False,
        retries: int | None = None,
        **arguments: Any,  # noqa: ANN401
    ) -> Document:
        """Ask for anything (arguments as of ``httpx.Client.request``) and return the JSON of the answer.

        Raises ProblemError if the service refuses, UnreachableError if nobody answers.
        """
        left = self._retries if retries is None else retries
        safe, pause = repeatable or method in _SAFE, 0.5
        total_s = _TRANSFER_S if "files" in arguments else self._timeout_s
        while True:
            try:
                async with self._answered(method, path, total_s, _MOST_BYTES, **arguments) as (answer, parts):
                    body = await _joined(parts)
            except _NO_ANSWER as error:
                again = isinstance(error, httpx.TransportError if safe else httpx.ConnectError | httpx.ConnectTimeout)
                if not again or not left or isinstance(error, httpx.UnsupportedProtocol):
                    raise self._unreachable(error) from error
            else:
                if answer.is_success:
                    return self._document(body)
                again = answer.status_code in _BUSY or (safe and answer.status_code in _BROKEN)
                if not again or not left:
                    raise _refusal(method, path, answer, body)
                stated = answer.headers.get("retry-after", "")
                pause = max(pause, float(stated)) if stated.isdecimal() else pause
            left -= 1
            await self._pause(min(pause, _LONGEST_PAUSE_S))
            pause *= 2

    def _document(self, body: bytes) -> Document:
        if (document := _parsed(body)) is None:
            raise self._no_service()
        return document

    def _no_service(self) -> UnreachableError:
        return UnreachableError(f"what answers at {self._url} is not the service")

    def _unreachable(self, error: Exception) -> UnreachableError:
        return UnreachableError(f"no answer from {self._url}: {error}")


async def _joined(parts: AsyncIterator[bytes]) -> bytes:
    return b"".join([part async for part in parts])


def _refusal(method: str, path: str, answer: httpx.Response, body: bytes) -> ProblemError:
    is_problem = answer.headers.get("content-type", "").startswith("application/problem+json")
    document = _parsed(body) if is_problem else None
    return ProblemError(method, path, answer.status_code, document or {"detail": body.decode(errors="replace")[:200]})


def _parsed(body: bytes) -> Document | None:
    with suppress(ValueError, RecursionError):
        document = json.loads(body)
        if isinstance(document, dict):
            return document
    return None


def _written(moment: Moment | None) -> str | None:
    return moment.isoformat() if isinstance(moment, datetime) else moment


def _window(window: Document) -> dict[str, object]:
    started_at = cast(Moment, window["started_at"])
    channels: dict[str, Any] = {name: window[name] for name in _CHANNELS if window.get(name) is not None}
    from_anywhere = ["reference"]
    if window.get("response_quantity") in _COUNTED_FROM_ANYWHERE:
        from_anywhere.append("response")
    for name in from_anywhere:
        if hasattr(channels.get(name), "astype"):
            exact = channels[name].astype("f8")
            channels[name] = exact - exact[:1]  # what single precision leaves of half a metre is coarse
    encoded = {name: _samples(samples) for name, samples in channels.items()}
    return {**window, "started_at": _written(started_at), **encoded}


def _samples(values: Any) -> object:  # noqa: ANN401 - numbers, bytes, or an array
    if hasattr(values, "astype"):
        values = values.astype("<f4").tobytes()
    if isinstance(values, bytes | bytearray | memoryview):
        return base64.b64encode(values).decode()
    return list(values)
