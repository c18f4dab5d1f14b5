"""Read request bodies in JSON or MessagePack without ever making objects of more than a small part of them.

What is not samples becomes objects of many times its size, so it must be short; samples stay where they are until they
are decoded (:mod:`service.api.http.samples`).
"""

import re
from collections.abc import Iterator
from io import BytesIO

import msgpack
import pydantic_core
from fastapi import Request

from service.api.http.samples import JsonSamples, PackedSamples
from service.errors import BodyTooLargeError, UnreadableBodyError, UnsupportedContentError

JSON_TYPE = "application/json"
MSGPACK_TYPE = "application/msgpack"
MSGPACK_TYPES = (MSGPACK_TYPE, "application/x-msgpack", "application/vnd.msgpack")

#: Members of a window that hold samples.
CHANNELS = ("excitation", "response", "position_trace_m", "reference")
#: So much of a body may be something else. A thousand windows take half of it.
MOST_BESIDE_SAMPLES = 2 * 2**20
MOST_WINDOWS = 1000
#: Lists of very short numbers take more room when they are read than before. So much they may, however short the body.
ROOM_FOR_LISTS = 16 * 2**20
#: Samples shorter than that are read with the rest.
_SHORT = 512

#: Samples in JSON: a list of what numbers are written with, or base64 (some libraries write / as \\/). Possessive (+):
#: nothing is kept to go back to, so that the search takes no memory.
_JSON_SAMPLES = re.compile(
    rb'"(?:%b)"\s*+:\s*+(\[[0-9eE+\-.,\s]*+\]|"(?:[A-Za-z0-9+/=]++|\\/)*+")' % "|".join(CHANNELS).encode()
)


def require_json(request: Request) -> None:
    """Refuse a body that is not declared to be JSON (routes that read nothing else)."""
    if request.headers.get("content-length", "0") != "0" or "transfer-encoding" in request.headers:
        kind = _media_type(request.headers.get("content-type"))
        if kind != JSON_TYPE:
            raise UnsupportedContentError(f"Content-Type must be {JSON_TYPE}; got {kind or 'none'}")


def parse_body(body: bytes, content_type: str | None) -> object:
    """Read a body by its content type; a wire model judges what was sent, and decodes the samples.

    Raises UnsupportedContentError, UnreadableBodyError or BodyTooLargeError.
    """
    kind = _media_type(content_type)
    if kind == JSON_TYPE:
        return _from_json(body)
    if kind in MSGPACK_TYPES:
        return _PackedBody(body).document()
    raise UnsupportedContentError(f"Content-Type must be {JSON_TYPE} or {MSGPACK_TYPE}; got {kind or 'none'}")


def _media_type(content_type: str | None) -> str:
    return (content_type or "").split(";")[0].strip().lower()


def _require_few(n_bytes: int) -> None:
    if n_bytes > MOST_BESIDE_SAMPLES:
        raise BodyTooLargeError(
            f"besides samples a body may hold {MOST_BESIDE_SAMPLES} bytes; got more. Send fewer windows at once"
        )


def _require_room(count: int, n_bytes: int) -> None:
    if 4 * count > max(n_bytes, ROOM_FOR_LISTS):
        raise BodyTooLargeError(
            f"lists may hold {max(n_bytes, ROOM_FOR_LISTS) // 4} numbers in a body of {n_bytes} bytes; got {count}. "
            "Send fewer windows at once, or samples as base64 or bytes"
        )


def _from_json(body: bytes) -> object:
    view, rest, cut_out, begin = memoryview(body), bytearray(), list[JsonSamples](), 0
    for match in _JSON_SAMPLES.finditer(body):
        start, end = match.span(1)
        if end - start < _SHORT:
            continue
        _require_few(len(rest) + start - begin)
        rest += view[begin:start]  # and where samples were cut out, their number after a sign that none is written with
        rest += b'"\\u0000%d"' % len(cut_out)
        count = body.count(b",", start, end) + 1 if body[start] == ord("[") else 0
        cut_out.append(JsonSamples(view[start:end], count))
        begin = end
    _require_few(len(rest) + len(body) - begin)
    rest += view[begin:]
    _require_room(sum(samples.count for samples in cut_out), len(body))
    try:
        document = pydantic_core.from_json(rest, allow_inf_nan=False, cache_strings="keys")
    except ValueError as error:
        raise UnreadableBodyError(f"the body is not JSON: {error}") from error
    marked = {f"\x00{number}": samples for number, samples in enumerate(cut_out)}
    for window in _windows_of(document):
        for name in CHANNELS:
            value = window.get(name)
            if isinstance(value, str):
                window[name] = marked.get(value, value)
    return document


def _windows_of(document: object) -> Iterator[dict[str, object]]:
    """Return the windows of a document, whether it is one or holds a list of them."""
    windows = document.get("windows", [document]) if isinstance(document, dict) else []
    return (window for window in windows if isinstance(window, dict)) if isinstance(windows, list) else iter(())


class _PackedBody:
    """Reads a MessagePack body member by member."""

    def __init__(self, body: bytes) -> None:
        self._body = memoryview(body)
        self._unpacker = msgpack.Unpacker(BytesIO(body), max_buffer_size=max(len(body), 1))
        self._beside_samples = 0
        self._in_lists = 0

    def document(self) -> object:
        """Return what the body holds."""
        try:
            document = self._record(holds_windows=True)
            rest = len(self._body) - self._unpacker.tell()
        except (ValueError, msgpack.exceptions.UnpackException) as error:
            raise UnreadableBodyError(f"the body is not MessagePack: {str(error) or type(error).__name__}") from error
        if rest:
            raise UnreadableBodyError(f"the body is not MessagePack: {rest} bytes follow the document")
        return document

    def _record(self, *, holds_windows: bool = False) -> object:
        """Read a window, or the document, which may hold windows."""
        if self._next() != "map":
            return self._value("")
        record: dict[str, object] = {}
        for _ in range(self._unpacker.read_map_header()):
            name = str(self._value(""))
            if name == "windows" and holds_windows and self._next() == "list":
                record[name] = self._windows()
            else:
                record[name] = self._value(name)
        return record

    def _windows(self) -> list[object]:
        n_windows = self._unpacker.read_array_header()
        if n_windows > MOST_WINDOWS:
            raise BodyTooLargeError(f"a request may hold {MOST_WINDOWS} windows; got {n_windows}")
        return [self._record() for _ in range(n_windows)]

    def _value(self, name: str) -> object:
        """Read the value of a member: samples stay where they are, everything else is short and no list."""
        at = self._unpacker.tell()
        kind = self._kind_at(at)
        if name in CHANNELS and kind in ("list", "bytes"):
            return self._samples_at(at)
        if name not in CHANNELS:
            _require_few(_announced(self._body, at))
        if kind in ("list", "map"):
            self._unpacker.skip()
            value: object = []
        else:
            value = self._unpacker.unpack()
        if name not in CHANNELS:
            self._count(self._unpacker.tell() - at)
        return value

    def _samples_at(self, at: int) -> PackedSamples | memoryview:
        self._unpacker.skip()
        samples = _samples(self._body[at : self._unpacker.tell()])
        if isinstance(samples, PackedSamples):
            self._in_lists += samples.count
            _require_room(self._in_lists, len(self._body))
        return samples

    def _next(self) -> str:
        return self._kind_at(self._unpacker.tell())

    def _kind_at(self, at: int) -> str:
        return _KINDS[self._body[at]] if at < len(self._body) else "nothing"

    def _count(self, n_bytes: int) -> None:
        self._beside_samples += n_bytes
        _require_few(self._beside_samples)


def _kind(first: int) -> str:
    """Return what kind of value begins with a byte (https://github.com/msgpack/msgpack, spec.md)."""
    if first in (0xDE, 0xDF) or first & 0xF0 == 0x80:
        return "map"
    if first in (0xDC, 0xDD) or first & 0xF0 == 0x90:
        return "list"
    return "bytes" if first in (0xC4, 0xC5, 0xC6) else "other"


_KINDS = [_kind(first) for first in range(256)]
#: How many bytes say how long a text or bytes are, by what they begin with.
_LENGTH_BYTES = {0xC4: 1, 0xC5: 2, 0xC6: 4, 0xD9: 1, 0xDA: 2, 0xDB: 4}


def _announced(body: memoryview, at: int) -> int:
    """Return how many bytes a text or bytes say that they are; 0 of anything else."""
    size = _LENGTH_BYTES.get(body[at], 0) if at < len(body) else 0
    return int.from_bytes(body[at + 1 : at + 1 + size]) if size else 0


def _samples(value: memoryview) -> PackedSamples | memoryview:
    """Return a list or bytes of samples without what stands before them: their kind, and how many they are."""
    header = {0xC4: 2, 0xC5: 3, 0xC6: 5, 0xDC: 3, 0xDD: 5}.get(value[0], 1)
    content = value[header:]
    if _KINDS[value[0]] == "bytes":
        return content
    return PackedSamples(content, int.from_bytes(value[1:header]) if header > 1 else value[0] & 0x0F)
