"""Request bodies in JSON or MessagePack, and samples in three encodings."""

import base64
import binascii
from typing import Annotated, Any, TypeVar

import msgpack
import numpy as np
from fastapi import Request
from pydantic import BeforeValidator, PlainSerializer, TypeAdapter, WithJsonSchema

from monitor_core.arrays import SampleArray
from service.errors import BodyTooLargeError, UnreadableBodyError, UnsupportedContentError

JSON_TYPE = "application/json"
MSGPACK_TYPE = "application/msgpack"
T = TypeVar("T")


async def raw_body(request: Request) -> bytes:
    """Read the body, never more than the limit. The only asynchronous step; the rest runs in a worker thread."""
    limit = request.app.state.settings.max_body_mib * 2**20
    chunks, size = [], 0
    async for chunk in request.stream():
        size += len(chunk)
        if size > limit:
            raise BodyTooLargeError(f"a request body may hold {limit} bytes; more arrived. Send fewer windows at once")
        chunks.append(chunk)
    return b"".join(chunks)


def parse_body(adapter: TypeAdapter[T], body: bytes, content_type: str | None) -> T:
    """Validate a body against a wire model, by its content type."""
    kind = (content_type or JSON_TYPE).split(";")[0].strip().lower()
    if kind == JSON_TYPE:
        return adapter.validate_json(body)
    if kind in (MSGPACK_TYPE, "application/x-msgpack", "application/vnd.msgpack"):
        return adapter.validate_python(_unpack(body))
    raise UnsupportedContentError(f"Content-Type must be {JSON_TYPE} or {MSGPACK_TYPE}; got {kind}")


def _unpack(body: bytes) -> Any:  # noqa: ANN401 - whatever the sender packed; the wire model judges it
    try:
        return msgpack.unpackb(body)
    except (ValueError, msgpack.exceptions.UnpackException) as error:
        raise UnreadableBodyError(f"the body is not MessagePack: {str(error) or type(error).__name__}") from error


def decode_samples(value: object) -> SampleArray:
    """Turn a list of numbers, base64 text or raw bytes (both little-endian float32) into samples."""
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, str):
        try:
            value = base64.b64decode(value, validate=True)
        except binascii.Error as error:
            raise ValueError(f"expected base64 of little-endian float32; {error}") from error
    if isinstance(value, bytes):
        if len(value) % 4:
            raise ValueError(f"expected little-endian float32, a multiple of 4 bytes; got {len(value)} bytes")
        return np.frombuffer(value, dtype="<f4")
    if not isinstance(value, list):
        raise ValueError(f"expected a list of numbers, base64 text or bytes; got {type(value).__name__}")
    try:
        samples = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError("expected a list of numbers; got something else among them") from error
    if samples.ndim != 1:
        raise ValueError(f"expected a flat list of numbers; got {samples.ndim} dimensions")
    return samples


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
