"""Read request bodies in JSON or MessagePack, and samples in three encodings."""

import base64
from typing import Annotated, Any

import msgpack
import numpy as np
import pydantic_core
from fastapi import Request
from pydantic import BeforeValidator, PlainSerializer, WithJsonSchema

from monitor_core.arrays import SampleArray
from service.errors import UnreadableBodyError, UnsupportedContentError

JSON_TYPE = "application/json"
MSGPACK_TYPE = "application/msgpack"
MSGPACK_TYPES = (MSGPACK_TYPE, "application/x-msgpack", "application/vnd.msgpack")


def require_json(request: Request) -> None:
    """Refuse a body that is not declared to be JSON (routes that read nothing else)."""
    if request.headers.get("content-length", "0") != "0" or "transfer-encoding" in request.headers:
        kind = _media_type(request.headers.get("content-type"))
        if kind != JSON_TYPE:
            raise UnsupportedContentError(f"Content-Type must be {JSON_TYPE}; got {kind or 'none'}")


def parse_body(body: bytes, content_type: str | None) -> object:
    """Read a body by its content type, JSON where none is stated; a wire model judges what was sent."""
    kind = _media_type(content_type) or JSON_TYPE
    if kind == JSON_TYPE:
        return _from_json(body)
    if kind in MSGPACK_TYPES:
        return _from_msgpack(body)
    raise UnsupportedContentError(f"Content-Type must be {JSON_TYPE} or {MSGPACK_TYPE}; got {kind}")


def _media_type(content_type: str | None) -> str:
    return (content_type or "").split(";")[0].strip().lower()


def _from_json(body: bytes) -> object:
    try:
        return pydantic_core.from_json(body, allow_inf_nan=False, cache_strings="keys")
    except ValueError as error:
        raise UnreadableBodyError(f"the body is not JSON: {error}") from error


def _from_msgpack(body: bytes) -> object:
    try:
        return msgpack.unpackb(body)
    except (ValueError, msgpack.exceptions.UnpackException) as error:
        raise UnreadableBodyError(f"the body is not MessagePack: {str(error) or type(error).__name__}") from error


def decode_samples(value: object) -> SampleArray:
    """Turn a list of numbers, base64 text or raw bytes (both little-endian float32) into samples."""
    if isinstance(value, str):
        try:
            value = base64.b64decode(value, validate=True)
        except ValueError as error:
            raise ValueError(f"expected base64 of little-endian float32; {error}") from error
    if isinstance(value, bytes):
        if len(value) % 4:
            raise ValueError(f"expected little-endian float32, a multiple of 4 bytes; got {len(value)} bytes")
        return np.frombuffer(value, dtype="<f4")
    if not isinstance(value, list):
        raise ValueError(f"expected a list of numbers, base64 text or bytes; got {type(value).__name__}")
    return _from_list(value)


def _from_list(values: list[Any]) -> SampleArray:
    foreign = set(map(type, values)) - {float, int}
    if foreign:
        raise ValueError(f"expected a flat list of numbers; got {', '.join(sorted(t.__name__ for t in foreign))} in it")
    try:
        samples = np.array(values, dtype=np.float64)
    except OverflowError as error:
        raise ValueError("expected numbers within the range of float64; got a larger one") from error
    if not np.isfinite(samples).all():
        raise ValueError(f"expected finite numbers; got {samples[~np.isfinite(samples)][0]}")
    with np.errstate(over="ignore"):
        single = samples.astype(np.float32)
    # float32 where it loses nothing: then a window is the same in every encoding
    return single if np.array_equal(single, samples) else samples


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
