"""Store raw waveforms: ``raw/YYYY/MM/DD/<axis>/<id>.windows.zst``; each window is checked by SHA-256 when read.

A file takes the windows of an axis that arrive on one day, request after request: each adds a zstd frame around
MessagePack, so that a file can be read without this program. A frame is on disk before the rows that name it are
committed: a crash in between leaves a frame that no row names, which costs room and nothing else.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from itertools import groupby
from pathlib import Path
from types import TracebackType
from typing import Self

import zstandard

from monitor_core.recording import Window
from service.errors import WaveformDamagedError
from service.store.waveform_files import FOLDER, FolderFiles, OpenFrame, WaveformFiles, compressed, storage_errors
from service.store.window_format import content_sha256, pack_windows, size_of, unpack_windows

WRITERS = 4
#: Windows that were written last are kept in memory: those of an open measurement are wanted again within minutes.
REMEMBERED_BYTES = 64 * 2**20
_OF_A_PURGE = "what is stored stays as it is"


def folder_of_day(moment: datetime) -> str:
    """Return where the files of a day lie: in the order of these names, days are in the order of time."""
    return f"{FOLDER}/{moment.astimezone(UTC):%Y/%m/%d}"


@dataclass(frozen=True, slots=True)
class WaveformPlace:
    """Where a window lies, and what its content must hash to."""

    path: str  # of the file
    offset: int  # of the frame in the file [bytes]
    index: int  # of the window in the frame
    content_sha256: str


class Writing:
    """A frame that is being written while the caller goes on; unless it is kept, it is removed again."""

    def __init__(self, store: "WaveformStore", begun: "Future[_Frame]") -> None:
        self._store = store
        self._begun = begun
        self._kept = False

    def sync(self) -> list[WaveformPlace]:
        """Wait until the frame is on disk, and tell where each window lies.

        Raises StorageError if the disk does not take it; then nothing of it is left.
        """
        frame = self._begun.result()
        self._store.sync(frame)
        return frame.places

    def keep(self) -> None:
        """Let the frame be: rows are about to be committed that name it."""
        self._kept = True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Take the frame back if nothing names it."""
        if self._begun.exception() is None:
            frame = self._begun.result()
            if self._kept:
                frame.open.close()
            else:
                self._store.take_back(frame)


class WaveformStore:
    """Writes and reads frames of windows, below one folder or in other files.

    Each store begins files of its own, so that several may share a place. In one store an axis is written by one
    thread at a time. A store is closed by whoever made it, with the files that it was given.
    """

    def __init__(self, files: Path | WaveformFiles) -> None:
        self.files: WaveformFiles = FolderFiles(files) if isinstance(files, Path) else files
        self._writers = ThreadPoolExecutor(max_workers=WRITERS, thread_name_prefix="waveforms")
        self._recent = _RecentWindows(REMEMBERED_BYTES)

    def begin_write(self, axis_id: str, windows: Sequence[Window], received_at: datetime) -> Writing:
        """Write windows into one new frame; what takes long runs while the caller goes on.

        Raises StorageError, here or later, if the disk does not take it; then nothing of it is left.
        """
        if size_of(windows) > self.files.handed_over_bytes:
            return Writing(self, self._writers.submit(self._begin, axis_id, windows, received_at))
        begun: Future[_Frame] = Future()
        begun.set_result(self._begin(axis_id, windows, received_at))
        return Writing(self, begun)

    def close(self) -> None:
        """Wait for what is being written, and write nothing more."""
        self._writers.shutdown()
        self.files.close()

    def _begin(self, axis_id: str, windows: Sequence[Window], received_at: datetime) -> "_Frame":
        """Give the windows to the operating system or whoever keeps them, which begins to write them."""
        folder, content = f"{folder_of_day(received_at)}/{axis_id}", partial(pack_windows, windows)
        with storage_errors():
            opened = self.files.append(axis_id, folder, content, size_of(windows))
        path, offset = opened.path, opened.offset
        try:
            places = [WaveformPlace(path, offset, i, content_sha256(window)) for i, window in enumerate(windows)]
        except BaseException:  # it may still be being written, and nobody else would wait for it
            opened.take_back()
            raise
        self._recent.add((path, offset), windows)
        return _Frame(opened, places)

    def sync(self, frame: "_Frame") -> None:
        """Wait until a frame is durable."""
        with storage_errors():
            frame.open.sync()

    def take_back(self, frame: "_Frame") -> None:
        """Remove a frame that no row names."""
        self._recent.forget((frame.open.path, frame.open.offset))
        frame.open.take_back()

    def read_where_they_lie(self, places: Callable[[], Sequence[WaveformPlace]]) -> list[Window]:
        """Read windows whose places are asked for; asked again if a purge moved them between asking and reading.

        Raises WaveformDamagedError as :meth:`read`, and what the asking raises.
        """
        asked = list(places())
        while True:
            try:
                return self.read(asked)
            except WaveformDamagedError:
                previous, asked = asked, list(places())
                if asked == previous:
                    raise

    def read(self, places: Iterable[WaveformPlace]) -> list[Window]:
        """Read windows, or remember them; each frame is read once.

        Raises WaveformDamagedError if a file cannot be read, or a window is not what was stored.
        """
        frames: dict[tuple[str, int], Sequence[Window]] = {}
        windows = []
        for place in places:
            key = (place.path, place.offset)
            remembered = self._recent.get(key)
            if remembered is not None:
                windows.append(remembered[place.index])
                continue
            if key not in frames:
                frames[key] = self._read_frame(*key)
            windows.append(_checked(frames[key], place))
        return windows

    def write_beside(self, path: str, places: Sequence[WaveformPlace]) -> list[WaveformPlace]:
        """Write stored windows once more into a new file, frame by frame, durably; tell where each lies in it.

        Raises WaveformDamagedError if one of them is not what was stored, StorageError if the disk does not take them.
        Then nothing of it is left, unless the process ends: whoever calls knows the name.
        """
        moved = list[WaveformPlace]()
        with storage_errors(_OF_A_PURGE):
            file, offset = self.files.create(path), 0
            try:
                for _, group in groupby(places, key=lambda place: (place.path, place.offset)):
                    frame = list(group)
                    moved += [WaveformPlace(path, offset, i, place.content_sha256) for i, place in enumerate(frame)]
                    windows = self.read(frame)
                    for part in compressed(partial(pack_windows, windows), size_of(windows)):
                        file.write(part)
                        offset += len(part)
                file.end()
                file.sync()
            except BaseException:
                file.take_back()
                raise
            file.close()
        return moved

    def remove(self, path: str) -> None:
        """Remove a file that no row names; raises StorageError if the disk does not let it."""
        with storage_errors(_OF_A_PURGE):
            self.files.delete(path)

    def size_of_file(self, path: str) -> int:
        """Return the size of a file [bytes]; 0 if there is none."""
        with storage_errors(_OF_A_PURGE):
            return self.files.size(path)

    def sizes(self) -> Iterator[tuple[str, int]]:
        """Yield all files with their size [bytes]; raises StorageError."""
        with storage_errors(_OF_A_PURGE):
            yield from self.files.sizes()

    def _read_frame(self, path: str, offset: int) -> Sequence[Window]:
        try:
            return unpack_windows(self.files.read(path, offset))
        except OSError as error:
            raise WaveformDamagedError(f"the waveform file {path} cannot be read: {error.strerror}") from error
        except (zstandard.ZstdError, ValueError, KeyError, TypeError) as error:
            raise WaveformDamagedError(f"the waveform file {path} is damaged: {error}") from error


def _checked(windows: Sequence[Window], place: WaveformPlace) -> Window:
    if place.index >= len(windows) or content_sha256(windows[place.index]) != place.content_sha256:
        raise WaveformDamagedError(
            f"window {place.index} at byte {place.offset} of the waveform file {place.path} is not what was stored"
        )
    return windows[place.index]


@dataclass(frozen=True, slots=True)
class _Frame:
    """Windows that whoever keeps them has, if perhaps not durably yet."""

    open: OpenFrame
    places: list[WaveformPlace]


class _RecentWindows:
    """Windows of the frames written last, as long as they fit into a number of bytes."""

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._bytes = 0
        self._frames: OrderedDict[tuple[str, int], Sequence[Window]] = OrderedDict()
        self._guard = threading.Lock()

    def add(self, frame: tuple[str, int], windows: Sequence[Window]) -> None:
        """Remember windows, and forget the oldest for their sake."""
        with self._guard:
            self._frames[frame] = windows
            self._bytes += size_of(windows)
            while self._bytes > self._most_bytes:
                self._bytes -= size_of(self._frames.popitem(last=False)[1])

    def get(self, frame: tuple[str, int]) -> Sequence[Window] | None:
        """Return the windows of a frame if they are remembered."""
        with self._guard:
            return self._frames.get(frame)

    def forget(self, frame: tuple[str, int]) -> None:
        """Let the windows of a frame go."""
        with self._guard:
            self._bytes -= size_of(self._frames.pop(frame, ()))
