"""Call the service's own API over HTTP, for ``preload replay`` and ``preload demo``."""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Self, TypeVar, cast

import click
import msgpack
import numpy as np
from pydantic import BaseModel

import preload_client
from monitor_core.recording import Window
from monitor_core.recordings.session_hdf5 import stated_of
from service.api.http.body import MSGPACK_TYPE
from service.cli.options import who_asks
from service.json_types import JsonObject

TIMEOUT_S = 120.0

Wire = TypeVar("Wire", bound=BaseModel)


class Client:
    """Talks to one service, with the key in ``PRELOAD_KEY`` if there is one; a problem becomes one sentence.

    Nothing is repeated: a person reads the sentence.
    """

    def __init__(self, url: str) -> None:
        key, ca_file = who_asks()
        self._service = preload_client.Client(url, key, retries=0, timeout_s=TIMEOUT_S, ca_file=ca_file)

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the connection."""
        self._service.close()

    def get(self, path: str, answer: type[Wire], **query: str | int) -> Wire:
        """Read a resource."""
        return answer.model_validate(self._ask("GET", path, params=query))

    def post(self, path: str, body: JsonObject) -> JsonObject:
        """Create or do something."""
        return self._ask("POST", path, json=body)

    def put(self, path: str, body: JsonObject) -> JsonObject:
        """Set a resource."""
        return self._ask("PUT", path, json=body)

    def wait(self, job: JsonObject, progress: Callable[[preload_client.Job], object]) -> preload_client.Job:
        """Wait until a job is done; ``progress`` is told how it stands."""
        with _in_a_sentence():
            return self._service.wait(cast(preload_client.Job, job), progress, most_s=math.inf)

    def register_if_new(self, axis: str) -> bool:
        """Register an axis with default settings unless it is there; tell whether it was new."""
        known = cast(Sequence[preload_client.Axis], self._ask("GET", "/v1/axes", params={"archived": "true"})["axes"])
        if any(each["id"] == axis for each in known):
            return False
        self.put(f"/v1/axes/{axis}", {"name": axis})
        return True

    def post_measurement(self, axis: str, windows: Sequence[Window]) -> preload_client.Receipt:
        """Post the windows of one measurement as MessagePack, and have it judged."""
        body = msgpack.packb({"windows": [window_document(window) for window in windows], "complete": True})
        headers = {"content-type": MSGPACK_TYPE}
        answer = self._ask("POST", f"/v1/axes/{axis}/windows", content=body, headers=headers)
        return cast(preload_client.Receipt, answer)

    def _ask(self, method: str, path: str, **arguments: Any) -> JsonObject:  # noqa: ANN401 - httpx's own
        with _in_a_sentence():
            return cast(JsonObject, self._service.request(method, path, **arguments))


@contextmanager
def _in_a_sentence() -> Iterator[None]:
    try:
        yield
    except preload_client.PreloadError as error:
        raise click.ClickException(str(error)) from error


def window_document(window: Window) -> dict[str, object]:
    """Return a window as the API takes it, samples as bytes of little-endian float32."""

    def samples(values: np.ndarray[Any, Any]) -> bytes:
        return values.astype("<f4").tobytes()

    def from_first(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:  # at half a metre float32 leaves 30 nm
        return values.astype(np.float64) - float(values[0])

    trace, answer = window.position_trace, window.response
    if window.response_quantity.derivatives > 1:  # counts from anywhere
        answer = from_first(answer)
    return stated_of(window) | {
        "excitation": samples(window.excitation),
        "response": samples(answer),
        "position_trace_m": None if trace is None else samples(trace),
        "reference": None if window.reference is None else samples(from_first(window.reference)),
    }
