"""Convert a window to bytes and back: MessagePack, readable without this program, with the hash of its content."""

import hashlib
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Any, NotRequired, TypeAlias, TypedDict

import msgpack
import numpy as np
import numpy.typing as npt

from monitor_core.recording import (
    Conditions,
    Direction,
    ExcitationQuantity,
    ExcitationSource,
    ResponseQuantity,
    Window,
)

#: What MessagePack writes before the length of bytes, in four bytes (bin 32).
_BYTES_FOLLOW = b"\xc6"

_Bytes: TypeAlias = bytes | memoryview


class _Samples(TypedDict):
    dtype: str
    bytes: _Bytes


class _Metadata(TypedDict):
    """What is said of a window besides its samples."""

    started_at: str
    sample_rate_hz: float
    measurement: str
    excitation_quantity: str
    excitation_source: str
    direction: str
    position_span_m: float
    position_m: float
    payload_kg: float | None
    temperature_c: float | None
    preload_n: float | None
    # left out where they are what all windows had before: these are the same windows, by their hashes too
    response_quantity: NotRequired[str]
    response_resolution: NotRequired[float]


class _Packed(_Metadata):
    excitation: _Samples
    response: _Samples
    position_trace_m: _Samples | None
    reference: NotRequired[_Samples]  # left out where there is none, as above


def pack_windows(windows: Sequence[Window]) -> Iterator[_Bytes]:
    """Return windows as MessagePack, in parts; samples keep the precision in which they were recorded."""
    yield msgpack.Packer().pack_array_header(len(windows))
    for window in windows:
        yield from _pack(window)


def unpack_windows(packed: bytes) -> list[Window]:
    """Return the windows that were packed; raises ValueError, KeyError or TypeError if these are no packed windows.

    Whether they are the right ones, their hashes say.
    """
    try:
        return [_unpack(item) for item in msgpack.unpackb(packed)]
    except msgpack.UnpackException as error:
        raise ValueError(str(error) or type(error).__name__) from error


def content_sha256(window: Window) -> str:
    """Hash what a window says: two posts with the same hash are the same window.

    Numbers are compared as float32, the precision of the wire: neither the encoding of the samples nor the last bits
    that a conversion of units costs make another window of it.
    """
    digest = hashlib.sha256()
    others = () if window.reference is None else (window.reference,)
    for samples in (window.excitation, window.response, window.position_trace, *others):
        digest.update(b"-" if samples is None else np.ascontiguousarray(_float32(samples)).data)
    words: dict[str, object] = {**_metadata(window)}
    numbers = {name: value for name, value in words.items() if isinstance(value, int | float)}
    words |= zip(numbers, _float32(list(numbers.values())).tolist(), strict=True)
    digest.update(repr(words).encode())
    return digest.hexdigest()


def _float32(values: npt.ArrayLike) -> npt.NDArray[np.float32]:
    if isinstance(values, np.ndarray) and values.dtype == "<f4":
        return values
    with np.errstate(over="ignore"):  # beyond float32 is infinite: as good as any other name for it
        return np.asarray(values).astype("<f4", copy=False)


def size_of(windows: Sequence[Window]) -> int:
    """Return the bytes that the samples of windows take in memory."""
    channels = ((w.excitation, w.response, w.position_trace, w.reference) for w in windows)
    return sum(samples.nbytes for channel in channels for samples in channel if samples is not None)


def _metadata(window: Window) -> _Metadata:
    conditions = window.conditions
    metadata: _Metadata = {
        "started_at": window.started_at.astimezone(UTC).isoformat(),
        "sample_rate_hz": window.sample_rate,
        "measurement": window.measurement,
        "excitation_quantity": str(window.excitation_quantity),
        "excitation_source": str(window.excitation_source),
        "direction": str(window.direction),
        "position_span_m": window.position_span,
        "position_m": conditions.position,
        "payload_kg": conditions.payload_mass,
        "temperature_c": conditions.temperature,
        "preload_n": conditions.preload,
    }
    if window.response_quantity is not ResponseQuantity.ACCELERATION:
        metadata["response_quantity"] = str(window.response_quantity)
    if window.response_resolution is not None:
        metadata["response_resolution"] = window.response_resolution
    return metadata


def _pack(window: Window) -> Iterator[_Bytes]:
    packer = msgpack.Packer(autoreset=False)
    metadata = _metadata(window)
    channels = {
        "excitation": window.excitation,
        "response": window.response,
        "position_trace_m": window.position_trace,
        **({} if window.reference is None else {"reference": window.reference}),
    }
    packer.pack_map_header(len(metadata) + len(channels))
    for name, value in metadata.items():
        packer.pack(name)
        packer.pack(value)
    for name, samples in channels.items():
        packer.pack(name)
        if samples is None:
            packer.pack(None)
            continue
        kind = samples.dtype.newbyteorder("<")
        content = np.ascontiguousarray(samples, dtype=kind).data.cast("B")
        packer.pack_map_header(2)
        for word in ("dtype", kind.str, "bytes"):
            packer.pack(word)
        yield packer.bytes() + _BYTES_FOLLOW + len(content).to_bytes(4)
        packer.reset()
        yield content
    yield packer.bytes()


def _unpack(item: _Packed) -> Window:
    def samples(packed: _Samples) -> npt.NDArray[Any]:
        return np.frombuffer(packed["bytes"], dtype=packed["dtype"])

    trace, reference = item["position_trace_m"], item.get("reference")
    return Window(
        excitation=samples(item["excitation"]),
        response=samples(item["response"]),
        sample_rate=item["sample_rate_hz"],
        started_at=datetime.fromisoformat(item["started_at"]),
        conditions=Conditions(item["position_m"], item["payload_kg"], item["temperature_c"], item["preload_n"]),
        measurement=item["measurement"],
        excitation_quantity=ExcitationQuantity(item["excitation_quantity"]),
        excitation_source=ExcitationSource(item["excitation_source"]),
        direction=Direction(item["direction"]),
        position_span=item["position_span_m"],
        position_trace=None if trace is None else samples(trace),
        reference=None if reference is None else samples(reference),
        response_quantity=ResponseQuantity(item.get("response_quantity", ResponseQuantity.ACCELERATION)),
        response_resolution=item.get("response_resolution"),
    )
