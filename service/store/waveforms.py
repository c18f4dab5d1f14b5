"""Raw waveforms as files: ``raw/YYYY/MM/DD/<axis>/<id>.windows.zst``, checked by SHA-256 when read.

One file holds the windows of one request: zstd around MessagePack, so it can be read without this program.
"""

import hashlib
import os
import uuid
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import zstandard

from monitor_core.recording import Conditions, Direction, ExcitationQuantity, ExcitationSource, Window
from service.errors import WaveformDamagedError

#: Vibration is mostly noise: level 1 gains within a percent of what level 9 gains, at a tenth of the time.
COMPRESSION_LEVEL = 1


@dataclass(frozen=True, slots=True)
class WaveformFile:
    """Where a file lies (relative to the store) and what its bytes must hash to."""

    path: str
    sha256: str


def content_sha256(window: Window) -> str:
    """Hash what a window says: two posts with the same hash are the same window."""
    digest = hashlib.sha256()
    for part in (window.excitation, window.response, window.position_trace):
        digest.update(b"-" if part is None else np.ascontiguousarray(part).data)
    digest.update(repr(_metadata(window)).encode())
    return digest.hexdigest()


class WaveformStore:
    """Writes and reads the files below one folder."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def write(self, axis_id: str, windows: list[Window], received_at: datetime) -> WaveformFile:
        """Write windows to one new file and return when it is on disk."""
        packed = msgpack.packb([_pack(window) for window in windows])
        compressed = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL).compress(packed)
        relative = Path("raw") / received_at.astimezone(UTC).strftime("%Y/%m/%d") / axis_id
        folder = self._root / relative
        _make_folder(folder)
        path = folder / f"{uuid.uuid4().hex}.windows.zst"
        with path.open("xb") as file:
            file.write(compressed)
            file.flush()
            os.fsync(file.fileno())
        _sync_folder(folder)
        return WaveformFile(str(relative / path.name), hashlib.sha256(compressed).hexdigest())

    def read(self, file: WaveformFile) -> list[Window]:
        """Read the windows of one file.

        Raises
        ------
        WaveformDamagedError
            If the file is missing or its bytes are not those that were written.
        """
        try:
            compressed = (self._root / file.path).read_bytes()
        except FileNotFoundError as error:
            raise WaveformDamagedError(f"the waveform file {file.path} is missing") from error
        if hashlib.sha256(compressed).hexdigest() != file.sha256:
            raise WaveformDamagedError(f"the waveform file {file.path} does not have the checksum it was stored with")
        return [_unpack(item) for item in msgpack.unpackb(zstandard.ZstdDecompressor().decompress(compressed))]

    def delete(self, file: WaveformFile) -> None:
        """Remove a file whose rows were never committed."""
        (self._root / file.path).unlink(missing_ok=True)


def _metadata(window: Window) -> dict[str, Any]:
    conditions = window.conditions
    return {
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


def _pack(window: Window) -> dict[str, Any]:
    def samples(values: np.ndarray[Any, Any]) -> dict[str, Any]:
        return {
            "dtype": values.dtype.newbyteorder("<").str,
            "bytes": values.astype(values.dtype.newbyteorder("<")).tobytes(),
        }

    trace = window.position_trace
    return _metadata(window) | {
        "excitation": samples(window.excitation),
        "response": samples(window.response),
        "position_trace_m": None if trace is None else samples(trace),
    }


def _unpack(item: dict[str, Any]) -> Window:
    def samples(packed: dict[str, Any]) -> np.ndarray[Any, Any]:
        return np.frombuffer(packed["bytes"], dtype=packed["dtype"])

    trace = item["position_trace_m"]
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
    )


def _make_folder(folder: Path) -> None:
    if folder.is_dir():
        return
    _make_folder(folder.parent)
    folder.mkdir(exist_ok=True)
    _sync_folder(folder.parent)


def _sync_folder(folder: Path) -> None:
    # A new name is durable only when its folder is.
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
