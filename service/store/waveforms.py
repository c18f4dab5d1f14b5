"""Store raw waveforms: ``raw/YYYY/MM/DD/<axis>/<id>.windows.zst``; each window is checked by SHA-256 when read.

A file takes the windows of an axis that arrive on one day, request after request: each adds a zstd frame around
MessagePack, so that a file can be read without this program. A frame is on disk before the rows that name it are
committed: a crash in between leaves a frame that no row names, which costs room and nothing else.
"""

import os
import threading
import uuid
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from io import FileIO
from itertools import groupby
from pathlib import Path
from types import TracebackType
from typing import Self

import zstandard

from monitor_core.recording import Window
from service.errors import StorageError, WaveformDamagedError
from service.store.waveform_files import (
    compressed,
    file_sizes,
    give_back_cache,
    make_folder,
    read_frame,
    remove_file,
    storage_errors,
    sync_folder,
    write_all,
)
from service.store.window_format import content_sha256, pack_windows, size_of, unpack_windows

#: All files lie below it; the next levels are the day on which they began (UTC) and the axis.
FOLDER = "raw"
#: Vibration is mostly noise: level 1 gains within a percent of what level 9 gains, at a tenth of the time.
COMPRESSION_LEVEL = 1
#: A file that has grown beyond this is followed by another: what is copied or lost at once stays small.
LARGEST_FILE_BYTES = 64 * 2**20
WRITERS = 4
#: To hand less than this over to a thread takes longer than to pack it.
HANDED_OVER_BYTES = 512 * 1024
#: Windows that were written last are kept in memory: those of an open measurement are wanted again within minutes.
REMEMBERED_BYTES = 64 * 2**20
_OF_A_PURGE = "what is stored stays as it is"


def folder_of_day(moment: datetime) -> str:
    """Return where the files of a day lie: in the order of these names, days are in the order of time."""
    return f"{FOLDER}/{moment.astimezone(UTC):%Y/%m/%d}"


@dataclass(frozen=True, slots=True)
class WaveformPlace:
    """Where a window lies, and what its content must hash to."""

    path: str  # of the file, relative to the store
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
                frame.file.close()
            else:
                self._store.take_back(frame)


class WaveformStore:
    """Writes and reads the files below one folder.

    Each store begins files of its own, so that several may share a folder. In one store an axis is written by one
    thread at a time.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self._writers = ThreadPoolExecutor(max_workers=WRITERS, thread_name_prefix="waveforms")
        self._growing: dict[str, str] = {}  # by axis: the file that its next frame is added to
        self._recent = _RecentWindows(REMEMBERED_BYTES)

    def begin_write(self, axis_id: str, windows: Sequence[Window], received_at: datetime) -> Writing:
        """Write windows into one new frame; what takes long runs while the caller goes on.

        Raises StorageError, here or later, if the disk does not take it; then nothing of it is left.
        """
        if size_of(windows) > HANDED_OVER_BYTES:
            return Writing(self, self._writers.submit(self._begin, axis_id, windows, received_at))
        begun: Future[_Frame] = Future()
        begun.set_result(self._begin(axis_id, windows, received_at))
        return Writing(self, begun)

    def close(self) -> None:
        """Wait for what is being written."""
        self._writers.shutdown()

    def _begin(self, axis_id: str, windows: Sequence[Window], received_at: datetime) -> "_Frame":
        """Give the windows to the operating system, which begins to write them."""
        with storage_errors():
            path, file = self._open(axis_id, f"{folder_of_day(received_at)}/{axis_id}")
        offset = file.tell()
        places = [WaveformPlace(path, offset, index, content_sha256(window)) for index, window in enumerate(windows)]
        frame = _Frame(axis_id, path, file, offset, places)
        try:
            with self._given_up_where_it_fails(frame):
                for part in compressed(lambda: pack_windows(windows), size_of(windows), COMPRESSION_LEVEL):
                    write_all(file, part)
                give_back_cache(file)
        except StorageError:
            self.take_back(frame)
            raise
        self._recent.add((path, offset), windows)
        return frame

    def _open(self, axis_id: str, folder: str) -> tuple[str, FileIO]:
        """Open the file that takes the next frame of an axis, at its end."""
        path = self._growing.get(axis_id, "")
        if path.startswith(f"{folder}/"):
            with suppress(OSError):  # it may have been moved, or made read-only
                file = FileIO(f"{self.root}/{path}", "r+")
                if file.seek(0, os.SEEK_END) < LARGEST_FILE_BYTES:
                    return path, file
                file.close()
        path = f"{folder}/{uuid.uuid4().hex}.windows.zst"
        make_folder(self.root / folder)
        file = FileIO(f"{self.root}/{path}", "x")
        self._growing[axis_id] = path
        return path, file

    def sync(self, frame: "_Frame") -> None:
        """Wait until a frame is on disk."""
        with self._given_up_where_it_fails(frame):
            os.fsync(frame.file.fileno())
            give_back_cache(frame.file)
            if not frame.offset:
                sync_folder((self.root / frame.path).parent)

    @contextmanager
    def _given_up_where_it_fails(self, frame: "_Frame") -> Iterator[None]:
        try:
            with storage_errors():
                yield
        except StorageError:
            self._growing.pop(frame.axis_id, None)  # from here on the content of the file is unknown
            raise

    def take_back(self, frame: "_Frame") -> None:
        """Remove a frame that no row names. It is the last of its file: an axis is written by one thread at a time."""
        self._recent.forget((frame.path, frame.offset))
        with frame.file, suppress(OSError):  # what cannot be removed costs room
            if frame.offset:
                frame.file.truncate(frame.offset)
            else:
                (self.root / frame.path).unlink(missing_ok=True)

    def read_where_they_lie(self, places: Callable[[], Sequence[WaveformPlace]]) -> list[Window]:
        """Read windows whose places are asked for; asked again if a purge moved them between asking and reading.

        Raises WaveformDamagedError as :meth:`read`, and what the asking raises.
        """
        asked = list(places())
        while True:
            try:
                return self.read(asked)
            except WaveformDamagedError:
                before, asked = asked, list(places())
                if asked == before:
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
        What was written until then stays: whoever calls knows the name.
        """
        moved = []
        with storage_errors(_OF_A_PURGE), FileIO(f"{self.root}/{path}", "x") as file:
            for _, group in groupby(places, key=lambda place: (place.path, place.offset)):
                frame = list(group)
                windows, offset = self.read(frame), file.tell()
                for part in compressed(partial(pack_windows, windows), size_of(windows), COMPRESSION_LEVEL):
                    write_all(file, part)
                moved += [WaveformPlace(path, offset, index, place.content_sha256) for index, place in enumerate(frame)]
            os.fsync(file.fileno())
            sync_folder((self.root / path).parent)
        return moved

    def remove(self, path: str) -> None:
        """Remove a file that no row names; raises StorageError if the disk does not let it."""
        with storage_errors(_OF_A_PURGE):
            remove_file(self.root, path)

    def size_of_file(self, path: str) -> int:
        """Return the size of a file [bytes]; 0 if there is none."""
        try:
            return (self.root / path).stat().st_size
        except FileNotFoundError:
            return 0

    def sizes(self) -> Iterator[tuple[str, int]]:
        """Yield all files with their size [bytes]; raises StorageError."""
        with storage_errors(_OF_A_PURGE):
            yield from file_sizes(self.root, FOLDER)

    def _read_frame(self, path: str, offset: int) -> Sequence[Window]:
        try:
            return unpack_windows(read_frame(self.root / path, offset))
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
    """Windows that the operating system has, and the disk perhaps not yet."""

    axis_id: str
    path: str
    file: FileIO
    offset: int
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
