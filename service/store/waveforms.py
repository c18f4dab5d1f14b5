"""Raw waveforms as files: ``raw/YYYY/MM/DD/<axis>/<id>.windows.zst``, checked by SHA-256 when read.

One file holds the windows of one request: zstd around MessagePack, so it can be read without this program. A file is
written before the rows that name it are committed: a crash in between leaves a file that no row names, which costs
room and nothing else.
"""

import hashlib
import os
import threading
import uuid
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgpack
import numpy as np
import zstandard

from monitor_core.recording import Conditions, Direction, ExcitationQuantity, ExcitationSource, Window
from service.errors import StorageError, WaveformDamagedError

#: Vibration is mostly noise: level 1 gains within a percent of what level 9 gains, at a tenth of the time.
COMPRESSION_LEVEL = 1
WRITERS = 4
#: To hand less than this over to a thread takes longer than to pack it.
HANDED_OVER_BYTES = 512 * 1024
#: Windows that were written last are kept in memory: those of an open measurement are wanted again within minutes.
REMEMBERED_BYTES = 64 * 2**20


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


@dataclass(frozen=True, slots=True)
class Written:
    """What rows say of a file: where it is, and what each of its windows hashes to."""

    file: WaveformFile
    contents: tuple[str, ...]


class Writing:
    """A file that is being written while the caller does something else; unless it is kept, it is removed."""

    def __init__(self, store: "WaveformStore", written: "Future[Written]", on_disk: "Future[None]") -> None:
        self._store = store
        self._written = written
        self._on_disk = on_disk
        self._kept = False

    def written(self) -> Written:
        """Wait until the operating system has the file.

        Raises
        ------
        StorageError
            Here and below: if the disk does not take it; then there is no file.
        """
        return self._written.result()

    def keep(self) -> None:
        """Wait until the file is on disk; rows may be committed that name it."""
        self._on_disk.result()
        self._kept = True

    def __enter__(self) -> Self:
        """Return this."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Remove the file if nothing names it."""
        if not self._kept and self._on_disk.exception() is None:
            self._store.remove(self._written.result().file)


class WaveformStore:
    """Writes and reads the files below one folder."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._writers = ThreadPoolExecutor(max_workers=WRITERS, thread_name_prefix="waveforms")
        self._recent = _RecentWindows(REMEMBERED_BYTES)

    def begin_write(self, axis_id: str, windows: Sequence[Window], received_at: datetime) -> Writing:
        """Write windows to one new file; what takes long is done in a thread, while the caller does something else.

        Raises
        ------
        StorageError
            Here or later, if the disk does not take it; then there is no file.
        """
        written: Future[Written] = Future()
        if _size(windows) > HANDED_OVER_BYTES:
            return Writing(self, written, self._writers.submit(self._write, axis_id, windows, received_at, written))
        begun = self._begin(axis_id, windows, received_at)
        on_disk = self._writers.submit(self._sync, begun)
        written.set_result(self._describe(begun, windows))
        return Writing(self, written, on_disk)

    def close(self) -> None:
        """Wait for what is being written."""
        self._writers.shutdown()

    def _write(
        self, axis_id: str, windows: Sequence[Window], received_at: datetime, written: "Future[Written]"
    ) -> None:
        try:
            begun = self._begin(axis_id, windows, received_at)
            written.set_result(self._describe(begun, windows))
        except BaseException as error:
            written.set_exception(error)  # whoever waits for it must not wait for ever
            raise
        self._sync(begun)

    def _begin(self, axis_id: str, windows: Sequence[Window], received_at: datetime) -> "_Begun":
        """Give the windows to the operating system."""
        packed = msgpack.packb([_pack(window) for window in windows])
        compressed = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL).compress(packed)
        day = Path("raw") / received_at.astimezone(UTC).strftime("%Y/%m/%d") / axis_id
        relative = day / f"{uuid.uuid4().hex}.windows.zst"
        path = self._root / relative
        with _removed_unless_taken(path):
            _make_folder(path.parent)
            with path.open("xb") as file:
                file.write(compressed)
        return _Begun(str(relative), compressed)

    def _sync(self, begun: "_Begun") -> None:
        """Wait until they are on disk."""
        path = self._root / begun.path
        with _removed_unless_taken(path):
            descriptor = os.open(path, os.O_RDONLY)
            try:
                os.fsync(descriptor)
                _give_back_cache(descriptor)
            finally:
                os.close(descriptor)
            _sync_folder(path.parent)

    def _describe(self, begun: "_Begun", windows: Sequence[Window]) -> Written:
        file = WaveformFile(begun.path, hashlib.sha256(begun.content).hexdigest())
        self._recent.add(file, windows)
        return Written(file, tuple(content_sha256(window) for window in windows))

    def read(self, file: WaveformFile) -> Sequence[Window]:
        """Read the windows of one file, or remember them.

        Raises
        ------
        WaveformDamagedError
            If the file cannot be read or its bytes are not those that were written.
        """
        remembered = self._recent.get(file)
        if remembered is not None:
            return remembered
        try:
            compressed = (self._root / file.path).read_bytes()
        except OSError as error:
            raise WaveformDamagedError(f"the waveform file {file.path} cannot be read: {error.strerror}") from error
        if hashlib.sha256(compressed).hexdigest() != file.sha256:
            raise WaveformDamagedError(f"the waveform file {file.path} does not have the checksum it was stored with")
        return [_unpack(item) for item in msgpack.unpackb(zstandard.ZstdDecompressor().decompress(compressed))]

    def remove(self, file: WaveformFile) -> None:
        """Remove a file that no row names."""
        self._recent.forget(file)
        (self._root / file.path).unlink(missing_ok=True)


@dataclass(frozen=True, slots=True)
class _Begun:
    """A file that the operating system has, and the disk not yet."""

    path: str
    content: bytes


@contextmanager
def _removed_unless_taken(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        path.unlink(missing_ok=True)
        raise StorageError(
            f"the disk did not take the waveforms ({error.strerror}); nothing of the request is stored"
        ) from error


class _RecentWindows:
    """Windows of the files written last, as long as they fit into a number of bytes."""

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._bytes = 0
        self._files: OrderedDict[WaveformFile, Sequence[Window]] = OrderedDict()
        self._guard = threading.Lock()

    def add(self, file: WaveformFile, windows: Sequence[Window]) -> None:
        """Remember windows, and forget the oldest for their sake."""
        with self._guard:
            self._files[file] = windows
            self._bytes += _size(windows)
            while self._bytes > self._most_bytes:
                self._bytes -= _size(self._files.popitem(last=False)[1])

    def get(self, file: WaveformFile) -> Sequence[Window] | None:
        """Return the windows of a file if they are remembered."""
        with self._guard:
            return self._files.get(file)

    def forget(self, file: WaveformFile) -> None:
        """Let the windows of a file go."""
        with self._guard:
            self._bytes -= _size(self._files.pop(file, ()))


def _size(windows: Sequence[Window]) -> int:
    traces = (window.position_trace for window in windows)
    return sum(window.excitation.nbytes + window.response.nbytes for window in windows) + sum(
        trace.nbytes for trace in traces if trace is not None
    )


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


def _give_back_cache(descriptor: int) -> None:
    # Nobody reads a waveform soon after it was written (the store remembers it). The next file takes the same pages of
    # the system's cache, in place of ever new ones: on a virtual machine those cost more than the disk does.
    if hasattr(os, "posix_fadvise"):
        os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)


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
