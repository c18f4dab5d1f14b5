"""Raw waveforms as files: ``raw/YYYY/MM/DD/<axis>/<id>.windows.zst``; each window is checked by SHA-256 when read.

One file holds the windows of one request: zstd around MessagePack, so it can be read without this program. A file is
written before the rows that name it are committed: a crash in between leaves a file that no row names, which costs
room and nothing else.
"""

import hashlib
import os
import threading
import uuid
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from io import FileIO
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
class WaveformPlace:
    """Where a window lies (path relative to the store, index in the file), and what its content must hash to."""

    path: str
    index: int
    content_sha256: str


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


class Writing:
    """A file that is being written while the caller does something else; unless it is kept, it is removed."""

    def __init__(self, store: "WaveformStore", begun: "Future[_Begun]") -> None:
        self._store = store
        self._begun = begun
        self._kept = False

    def sync(self) -> list[WaveformPlace]:
        """Wait until the file is on disk, and tell where each window lies.

        Raises
        ------
        StorageError
            If the disk does not take it; then there is no file.
        """
        begun = self._begun.result()
        self._store.sync(begun)
        return begun.places

    def keep(self) -> None:
        """Let the file be: rows are about to be committed that name it."""
        self._kept = True

    def __enter__(self) -> Self:
        """Return this."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Remove the file if nothing names it."""
        if self._begun.exception() is None:
            begun = self._begun.result()
            begun.file.close()
            if not self._kept:
                self._store.remove(begun.path)


class WaveformStore:
    """Writes and reads the files below one folder."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._writers = ThreadPoolExecutor(max_workers=WRITERS, thread_name_prefix="waveforms")
        self._recent = _RecentWindows(REMEMBERED_BYTES)

    def begin_write(self, axis_id: str, windows: Sequence[Window], received_at: datetime) -> Writing:
        """Write windows to one new file; what takes long is done beside what the caller does next.

        Raises
        ------
        StorageError
            Here or later, if the disk does not take it; then there is no file.
        """
        if _size(windows) > HANDED_OVER_BYTES:
            return Writing(self, self._writers.submit(self._begin, axis_id, windows, received_at))
        begun: Future[_Begun] = Future()
        begun.set_result(self._begin(axis_id, windows, received_at))
        return Writing(self, begun)

    def close(self) -> None:
        """Wait for what is being written."""
        self._writers.shutdown()

    def _begin(self, axis_id: str, windows: Sequence[Window], received_at: datetime) -> "_Begun":
        """Give the windows to the operating system, which begins to write them."""
        packed = msgpack.packb([_pack(window) for window in windows])
        compressed = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL).compress(packed)
        day = Path("raw") / received_at.astimezone(UTC).strftime("%Y/%m/%d") / axis_id
        path = str(day / f"{uuid.uuid4().hex}.windows.zst")
        with self._removed_unless_taken(path):
            _make_folder(self._root / day)
            file = (self._root / path).open("xb", buffering=0)
            try:
                _write_all(file, compressed)
                _give_back_cache(file)
            except OSError:
                file.close()
                raise
        self._recent.add(path, windows)
        places = [WaveformPlace(path, index, content_sha256(window)) for index, window in enumerate(windows)]
        return _Begun(path, file, places)

    def sync(self, begun: "_Begun") -> None:
        """Wait until a file is on disk."""
        with self._removed_unless_taken(begun.path):
            os.fsync(begun.file.fileno())
            _give_back_cache(begun.file)
            _sync_folder((self._root / begun.path).parent)

    @contextmanager
    def _removed_unless_taken(self, path: str) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.remove(path)
            raise StorageError(
                f"the disk did not take the waveforms ({error.strerror}); nothing of the request is stored"
            ) from error

    def read(self, places: Iterable[WaveformPlace]) -> list[Window]:
        """Read windows, or remember them; each file is read once.

        Raises
        ------
        WaveformDamagedError
            If a file cannot be read, or a window is not what was stored.
        """
        files: dict[str, Sequence[Window]] = {}
        windows = []
        for place in places:
            remembered = self._recent.get(place.path)
            if remembered is not None:
                windows.append(remembered[place.index])
                continue
            if place.path not in files:
                files[place.path] = self._read_file(place.path)
            windows.append(_checked(files[place.path], place))
        return windows

    def _read_file(self, path: str) -> Sequence[Window]:
        try:
            compressed = (self._root / path).read_bytes()
            return [_unpack(item) for item in msgpack.unpackb(zstandard.ZstdDecompressor().decompress(compressed))]
        except OSError as error:
            raise WaveformDamagedError(f"the waveform file {path} cannot be read: {error.strerror}") from error
        except (zstandard.ZstdError, msgpack.UnpackException, ValueError, KeyError, TypeError) as error:
            raise WaveformDamagedError(f"the waveform file {path} is damaged: {error}") from error

    def remove(self, path: str) -> None:
        """Remove a file that no row names."""
        self._recent.forget(path)
        (self._root / path).unlink(missing_ok=True)


def _checked(windows: Sequence[Window], place: WaveformPlace) -> Window:
    if place.index >= len(windows) or content_sha256(windows[place.index]) != place.content_sha256:
        raise WaveformDamagedError(f"window {place.index} of the waveform file {place.path} is not what was stored")
    return windows[place.index]


@dataclass(frozen=True, slots=True)
class _Begun:
    """A file that the operating system has, and the disk perhaps not yet."""

    path: str
    file: FileIO
    places: list[WaveformPlace]


class _RecentWindows:
    """Windows of the files written last, as long as they fit into a number of bytes."""

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._bytes = 0
        self._files: OrderedDict[str, Sequence[Window]] = OrderedDict()
        self._guard = threading.Lock()

    def add(self, path: str, windows: Sequence[Window]) -> None:
        """Remember windows, and forget the oldest for their sake."""
        with self._guard:
            self._files[path] = windows
            self._bytes += _size(windows)
            while self._bytes > self._most_bytes:
                self._bytes -= _size(self._files.popitem(last=False)[1])

    def get(self, path: str) -> Sequence[Window] | None:
        """Return the windows of a file if they are remembered."""
        with self._guard:
            return self._files.get(path)

    def forget(self, path: str) -> None:
        """Let the windows of a file go."""
        with self._guard:
            self._bytes -= _size(self._files.pop(path, ()))


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
        kind = values.dtype.newbyteorder("<")
        return {"dtype": kind.str, "bytes": np.ascontiguousarray(values, dtype=kind).data.cast("B")}

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


def _write_all(file: FileIO, content: bytes) -> None:
    rest = memoryview(content)
    while rest:
        rest = rest[file.write(rest) :]


def _give_back_cache(file: FileIO) -> None:
    # Nobody reads a waveform soon after it was written (the store remembers it). The system begins to write what it is
    # told will not be wanted, so that there is less to wait for later; and the next file takes the same pages of its
    # cache, in place of ever new ones: on a virtual machine those cost more than the disk does.
    if hasattr(os, "posix_fadvise"):
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


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
