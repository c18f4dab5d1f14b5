"""Read the samples of a channel, in whatever encoding they come.

Python's own numbers take eight times the room of their text, so lists are read a part at a time, and in most cases no
encoding takes more than its own bytes again.
"""

import binascii
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import msgpack
import numpy as np
import pydantic_core
from pydantic import BeforeValidator, PlainSerializer, WithJsonSchema

from monitor_core.arrays import FloatArray, SampleArray
from service.operations.fields import MOST_SAMPLES

#: So many bytes of a list are read at once.
_AT_ONCE = 2**16


@dataclass(frozen=True, slots=True)
class JsonSamples:
    """Samples as they stand in a JSON body: a list of numbers, or a string of base64."""

    text: memoryview
    count: int  # of the numbers in a list; 0 of base64

    def decoded(self) -> SampleArray:
        """Return the samples; raises ValueError if these are none."""
        if not self.count:
            return _from_base64(self._unescaped())
        return _gathered(self._parts, self.count, len(self.text))

    def _unescaped(self) -> bytes | memoryview:
        inside = self.text[1:-1]
        if any(b"\\" in bytes(part) for part in _cut(inside)):
            return bytes(inside).replace(b"\\/", b"/")
        return inside

    def _parts(self) -> Iterator[list[Any]]:
        rest = self.text[1:-1]
        while len(rest) > _AT_ONCE and (comma := bytes(rest[:_AT_ONCE]).rfind(b",")) > 0:
            yield _listed(rest[:comma])
            rest = rest[comma + 1 :]
        yield _listed(rest)


@dataclass(frozen=True, slots=True)
class PackedSamples:
    """Samples as they stand in a MessagePack body: the elements of a list of numbers."""

    elements: memoryview
    count: int

    def decoded(self) -> SampleArray:
        """Return the samples; raises ValueError if these are none."""
        return _gathered(self._parts, self.count, len(self.elements))

    def _parts(self) -> Iterator[list[Any]]:
        unpacker = msgpack.Unpacker()
        for part in _cut(self.elements):
            unpacker.feed(part)
            yield list(unpacker)


def _cut(content: memoryview) -> Iterator[memoryview]:
    return (content[at : at + _AT_ONCE] for at in range(0, len(content), _AT_ONCE))


def _listed(text: memoryview) -> list[Any]:
    try:
        numbers: list[Any] = pydantic_core.from_json(b"[%b]" % bytes(text), allow_inf_nan=False)
    except ValueError as error:
        raise ValueError(f"expected a list of numbers; {error}") from error
    if not numbers:
        raise ValueError("expected a number between two commas; got none")
    return numbers


def decode_samples(value: object) -> SampleArray:
    """Turn a list of numbers, base64 text or raw bytes (both little-endian float32) into samples."""
    if isinstance(value, JsonSamples | PackedSamples):
        return value.decoded()
    if isinstance(value, str):
        return _from_base64(value)
    if isinstance(value, bytes | memoryview):
        return _from_bytes(value)
    if not isinstance(value, list):
        raise ValueError(f"expected a list of numbers, base64 text or bytes; got {type(value).__name__}")
    return _gathered(lambda: [value], len(value), None)


def _from_base64(text: str | bytes | memoryview) -> SampleArray:
    try:
        content = binascii.a2b_base64(text, strict_mode=True)
    except ValueError as error:
        raise ValueError(f"expected base64 of little-endian float32; {error}") from error
    return _from_bytes(content)


def _from_bytes(content: bytes | memoryview) -> SampleArray:
    if len(content) % 4:
        raise ValueError(f"expected little-endian float32, a multiple of 4 bytes; got {len(content)} bytes")
    _require_few(len(content) // 4)
    return np.frombuffer(content, dtype="<f4")


def _gathered(parts: Callable[[], Iterable[list[Any]]], count: int, room: int | None) -> SampleArray:
    """Return all numbers in one array: float32 where that loses nothing, or where float64 takes more bytes than `room`.

    Then a window is the same in every encoding; and numbers that are written in less room than float64 takes have at
    most the seven digits of float32.
    """
    _require_few(count)
    small, single = room is not None and 8 * count > room, True
    arrays: list[SampleArray] = []
    for part in parts():
        values = _checked(part)
        with np.errstate(over="ignore"):
            narrowed = values.astype(np.float32)
        single = small or (single and np.array_equal(narrowed, values))
        arrays.append(narrowed if small else values)
    together = np.concatenate(arrays)
    samples: SampleArray = (
        together.astype(np.float32, copy=False) if single else together.astype(np.float64, copy=False)
    )
    samples.setflags(write=False)  # so that the window needs no copy
    return samples


def _require_few(count: int) -> None:
    if count > MOST_SAMPLES:
        raise ValueError(f"expected at most {MOST_SAMPLES} samples; got {count}")


def _checked(numbers: list[Any]) -> FloatArray:
    foreign = set(map(type, numbers)) - {float, int}
    if foreign:
        raise ValueError(f"expected a flat list of numbers; got {', '.join(sorted(t.__name__ for t in foreign))} in it")
    try:
        values = np.array(numbers, dtype=np.float64)
    except OverflowError as error:
        raise ValueError("expected numbers within the range of float64; got a larger one") from error
    if not np.isfinite(values).all():
        raise ValueError(f"expected finite numbers; got {values[~np.isfinite(values)][0]}")
    return values


#: Samples of one channel on the wire.
Samples = Annotated[
    Any,
    BeforeValidator(decode_samples),
    PlainSerializer(lambda samples: samples.tolist(), return_type=list[float]),
    WithJsonSchema(
        {
            "oneOf": [
                {"type": "array", "items": {"type": "number"}},
                {"type": "string", "contentEncoding": "base64", "description": "little-endian float32"},
            ],
            "description": "samples: a list, base64 of little-endian float32, or (MessagePack) those bytes as they are",
        }
    ),
]
