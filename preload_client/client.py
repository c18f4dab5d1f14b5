"""Ask one service: windows and recordings in, trends, alarms, jobs and tables out.

A request is repeated where that is safe: always while nobody answers the call or the service is busy (503), for then
nothing was changed; after a broken connection only what may be done twice. Windows may: the service knows them by axis
and time.
"""

import base64
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, Self, TypeAlias, cast

import httpx

from preload_client.errors import JobFailedError, ProblemError, UnreachableError
from preload_client.exchange import Transport, exchange, tls_context
from preload_client.records import (
    Alarm,
    Axis,
    Document,
    Job,
    LostMotionPoint,
    LostMotionReceipt,
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
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        transport = Transport(tls_context(ca_file))
        self._http = httpx.Client(base_url=url, headers=headers, transport=transport, timeout=timeout_s)
        self._retries = retries
        self._timeout_s = timeout_s

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
        self._http.close()

    # axes and what was measured

    def axes(self) -> list[Axis]:
        """Return all axes and how each stands."""
        return list(cast(Iterable[Axis], self.records("/v1/axes", "axes")))

    def axis(self, axis: str) -> Axis:
        """Return one axis and how it stands."""
        return cast(Axis, self.request("GET", f"/v1/axes/{axis}"))

    def register(self, axis: str, name: str, configuration: Document | None = None) -> Axis:
        """Register an axis, or change its name and configuration."""
        body = {"name": name, "configuration": configuration or {}}
        return cast(Axis, self.request("PUT", f"/v1/axes/{axis}", json=body))

    def trend(self, axis: str, start: Moment | None = None, end: Moment | None = None) -> Iterator[TrendPoint]:
        """Yield measurements in time order, refused ones included; ``start`` is inside, ``end`` is not."""
        query = {"from": _written(start), "to": _written(end), "limit": 10_000}
        return cast(Iterator[TrendPoint], self.records(f"/v1/axes/{axis}/trend", "points", query))

    def trend_arrays(
        self, axis: str, start: Moment | None = None, end: Moment | None = None
    ) -> "dict[str, np.ndarray[Any, Any]]":
        """Return the judged measurements as numpy arrays by name; an open end of an interval is infinite."""
        import numpy as np  # noqa: PLC0415  # the only method that needs it

        points = [point for point in self.trend(axis, start, end) if point["preload_n"] is not None]
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
    ) -> Iterator[LostMotionPoint]:
        """Yield what was measured of lost motion in time order; ``start`` is inside, ``end`` is not."""
        query = {"from": _written(start), "to": _written(end), "limit": 10_000}
        return cast(Iterator[LostMotionPoint], self.records(f"/v1/axes/{axis}/lost-motion", "points", query))

    def post_lost_motion(self, axis: str, readings: Sequence[Document]) -> LostMotionReceipt:
        """Send lost motion, as ``preload lost-motion --json`` gives it. Safe to repeat."""
        body = {"readings": list(readings)}
        answer = self.request("POST", f"/v1/axes/{axis}/lost-motion", json=body, repeatable=True)
        return cast(LostMotionReceipt, answer)

    def post_windows(self, axis: str, windows: Sequence[Document], *, complete: bool = False) -> Receipt:
        """Send windows; samples are numbers, bytes of little-endian float32, or numpy arrays. Safe to repeat."""
        body = {"windows": [_window(window) for window in windows], "complete": complete}
        return cast(Receipt, self.request("POST", f"/v1/axes/{axis}/windows", json=body, repeatable=True))

    # recordings and jobs

    def upload(self, axis: str, files: Sequence[Path | str], channel_map: Path | str | None = None) -> Job:
        """Upload a session, or raw files with their channel map; :meth:`wait` for the job that takes the windows."""
        with ExitStack() as stack:
            parts = [("file", (Path(file).name, stack.enter_context(Path(file).open("rb")))) for file in files]
            data = {} if channel_map is None else {"map": Path(channel_map).read_text(encoding="utf-8")}
            # a stream that was read once is not there again: this is not repeated
            answer = self.request("POST", f"/v1/axes/{axis}/recordings", files=parts, data=data, retries=0)
        return cast(Job, answer)

    def replay(self, axis: str, session: str) -> Job:
        """Replay a session of the service's own folder into an axis."""
        return cast(Job, self.request("POST", f"/v1/axes/{axis}/replays", json={"session": session}))

    def jobs(self, axis: str | None = None) -> Iterator[Job]:
        """Yield jobs, newest first."""
        return cast(Iterator[Job], self.records("/v1/jobs", "jobs", {"axis": axis, "limit": 200}))

    def job(self, job: str) -> Job:
        """Return a job as it stands."""
        return cast(Job, self.request("GET", f"/v1/jobs/{job}"))

    def cancel(self, job: str) -> Job:
        """Ask a job to stop; work already done stays done."""
        return cast(Job, self.request("POST", f"/v1/jobs/{job}/cancel", repeatable=True))

    def wait(
        self, job: Job, progress: Callable[[Job], object] | None = None, *, every_s: float = 0.5, most_s: float = 3600.0
    ) -> Job:
        """Wait until a job is done; ``progress`` is told how it stands.

        Raises JobFailedError if it fails or is cancelled, TimeoutError if it is not done after ``most_s``.
        """
        until = time.monotonic() + most_s
        while True:
            job = self.job(job["id"])
            if progress is not None:
                progress(job)
            if job["status"] == "done":
                return job
            if job["status"] in ("failed", "cancelled"):
                raise JobFailedError(job)
            if time.monotonic() > until:
                raise TimeoutError(f"job {job['id']} is {job['status']} after {most_s:g} s")
            time.sleep(every_s)

    # alarms

    def alarms(
        self, axis: str | None = None, status: Literal["active", "acknowledged", "cleared"] | None = None
    ) -> Iterator[Alarm]:
        """Yield alarms, newest first."""
        query = {"axis": axis, "status": status, "limit": 200}
        return cast(Iterator[Alarm], self.records("/v1/alarms", "alarms", query))

    def acknowledge(self, alarm: int, comment: str) -> Alarm:
        """Say that somebody has seen an alarm."""
        return cast(Alarm, self.request("POST", f"/v1/alarms/{alarm}/acknowledge", json={"comment": comment}))

    def clear(self, alarm: int, comment: str) -> Alarm:
        """Close an alarm after inspection: the level is learnt anew."""
        return cast(Alarm, self.request("POST", f"/v1/alarms/{alarm}/clear", json={"comment": comment}))

    # whatever the service has

    def records(self, path: str, member: str, query: Mapping[str, object] | None = None) -> Iterator[Document]:
        """Yield the records of any list, page after page."""
        stated = {name: value for name, value in (query or {}).items() if value is not None}
        while True:
            page = self.request("GET", path, params=stated)
            yield from cast(Iterable[Document], page[member])
            if page.get("next_cursor") is None:
                return
            stated["cursor"] = page["next_cursor"]

    def table(self, path: str, file: Path | str, **query: str | int) -> Path:
        """Write a trend, the alarms or the log of changes into a file; the end of its name, .csv or .parquet, says how.

        Raises ProblemError if the service refuses, ValueError if what is there is no table.
        """
        kind = Path(file).suffix.removeprefix(".")
        with (
            exchange(_TRANSFER_S, _MOST_OF_TABLE),
            self._http.stream("GET", path, params={**query, "format": kind}) as answer,
        ):
            if not answer.is_success:
                answer.read()
                raise _refusal("GET", path, answer)
            if kind not in answer.headers.get("content-type", ""):
                raise ValueError(f"{path} is no table; trend, alarms and audit are, as .csv and .parquet")
            with Path(file).open("wb") as output:
                for part in answer.iter_bytes():
                    output.write(part)
        return Path(file)

    def request(
        self,
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
                with exchange(total_s, _MOST_BYTES), self._http.stream(method, path, **arguments) as answer:
                    answer.read()
            except (httpx.TransportError, httpx.UnsupportedProtocol) as error:
                again = safe or isinstance(error, httpx.ConnectError | httpx.ConnectTimeout)
                if not again or not left or isinstance(error, httpx.UnsupportedProtocol):
                    raise UnreachableError(f"no answer from {self._http.base_url}: {error}") from error
            else:
                if answer.is_success:
                    return cast(Document, answer.json())
                again = answer.status_code in _BUSY or (safe and answer.status_code in _BROKEN)
                if not again or not left:
                    raise _refusal(method, path, answer)
                stated = answer.headers.get("retry-after", "")
                pause = max(pause, float(stated)) if stated.isdecimal() else pause
            left -= 1
            time.sleep(min(pause, _LONGEST_PAUSE_S))
            pause *= 2


def _refusal(method: str, path: str, answer: httpx.Response) -> ProblemError:
    is_problem = answer.headers.get("content-type", "").startswith("application/problem+json")
    document = answer.json() if is_problem else {"detail": answer.text[:200]}
    return ProblemError(method, path, answer.status_code, document)


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
