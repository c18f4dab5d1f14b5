"""Raw waveforms as files: ``raw/YYYY/MM/DD/<axis>/<id>.windows.zst``, checked by SHA-256 when read.

One file holds the windows of one request: zstd around MessagePack, so it can be read without this program. A file is
written before the rows that name it are committed: a crash in between leaves a file that no row names, which costs
room and nothing else.
"""

import hashlib
import os
import uuid
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import zstandard

from monitor_core.recording import Conditions, Direction, ExcitationQuantity, ExcitationSource, Window
from service.errors import StorageError, WaveformDamagedError

#: Vibration is mostly noise: level 1 gains within a percent of what level 9 gains, at a tenth of the time.
COMPRESSION_LEVEL = 1
WRITERS = 4


@dataclass(frozen=True, slots=True)
class WaveformFile:
    """Where a file lies (relative to the store) and what its bytes must hash to."""

    path: str
    sha256: str


def content_sha256(window: Window) -> str:
    """Hash what a window says: two posts with the same hash are the same window.

    Numbers are compared as float32, the precision of the wire: neither the encoding of the samples nor the last bits
    that a conversion of units costs make another window of it.
    """
    digest = hashlib.sha256()
    for samples in (window.excitation, window.response, window.position_trace):
        digest.update(b"-" if samples is None else np.ascontiguousarray(_float32(samples)).data)
    words = {
        name: float(_float32(value)) if isinstance(value, int | float) else value
        for name, value in _metadata(window).items()
    }
    digest.update(repr(words).encode())
    return digest.hexdigest()


def _float32(values: Any) -> np.ndarray[Any, Any]:  # noqa: ANN401 - a number or an array of them
    with np.errstate(over="ignore"):  # beyond float32 is infinite: as good as any other name for it
        return np.asarray(values).astype("<f4", copy=False)


class WaveformStore:
    """Writes and reads the files below one folder."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._writers = ThreadPoolExecutor(max_workers=WRITERS, thread_name_prefix="waveforms")

    def begin_write(self, axis_id: str, windows: list[Window], received_at: datetime) -> Future[WaveformFile]:
        """Write as :meth:`write` does, while the caller does something else."""
        return self._writers.submit(self.write, axis_id, windows, received_at)

    def close(self) -> None:
        """Wait for what is being written."""
        self._writers.shutdown()

    def write(self, axis_id: str, windows: list[Window], received_at: datetime) -> WaveformFile:
        """Write windows to one new file and return when it is on disk.

        Raises
        ------
        StorageError
            If the disk does not take it; then there is no file.
        """
        packed = msgpack.packb([_pack(window) for window in windows])
        compressed = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL).compress(packed)
        relative = Path("raw") / received_at.astimezone(UTC).strftime("%Y/%m/%d") / axis_id
        try:
            path = self._write_durably(self._root / relative, compressed)
        except OSError as error:
            raise StorageError(
                f"the disk did not take the waveforms ({error.strerror}); nothing of the request is stored"
            ) from error
        return WaveformFile(str(relative / path.name), hashlib.sha256(compressed).hexdigest())

    def _write_durably(self, folder: Path, content: bytes) -> Path:
        _make_folder(folder)
        path = folder / f"{uuid.uuid4().hex}.windows.zst"
        try:
            with path.open("xb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            _sync_folder(folder)
        except OSError:
            path.unlink(missing_ok=True)
            raise
        return path

    def read(self, file: WaveformFile) -> list[Window]:
        """Read the windows of one file.

        Raises
        ------
        WaveformDamagedError
            If the file cannot be read or its bytes are not those that were written.
        """
        try:
            compressed = (self._root / file.path).read_bytes()
        except OSError as error:
            raise WaveformDamagedError(f"the waveform file {file.path} cannot be read: {error.strerror}") from error
        if hashlib.sha256(compressed).hexdigest() != file.sha256:
            raise WaveformDamagedError(f"the waveform file {file.path} does not have the checksum it was stored with")
        return [_unpack(item) for item in msgpack.unpackb(zstandard.ZstdDecompressor().decompress(compressed))]

    def discard(self, writing: Future[WaveformFile]) -> None:
        """Remove the file of a :meth:`begin_write` whose rows were never committed."""
        if writing.exception() is None:
            (self._root / writing.result().path).unlink(missing_ok=True)


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
