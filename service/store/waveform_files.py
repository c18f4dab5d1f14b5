"""Append frames of raw waveforms to files, read, list and delete them: what the store needs of a disk, or of its like.

:class:`FolderFiles` keeps them in a folder. :mod:`service.store.waveform_objects` keeps them elsewhere.
"""

import mmap
import os
import threading
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import BinaryIO, Protocol, TypeAlias

import zstandard

from service.errors import StorageError
from service.store.frame_writer import MOST_BYTES, FrameWriter, HandedOver

#: Returns what a frame is to hold, in parts, as often as it is asked.
Content: TypeAlias = Callable[[], Iterable[bytes | memoryview]]
#: Vibration is mostly noise: level 1 gains within a percent of what level 9 gains, at a tenth of the time.
COMPRESSION_LEVEL = 1

#: A request becomes one frame. Numbers take twice the room of their text at most, and a body is at most 1 GiB.
LARGEST_CONTENT_BYTES = 2 * 2**30
#: Few large steps: after each the interpreter is waited for, which other threads hold.
_COMPRESSED_AT_ONCE = 2 * 2**20
_AT_ONCE = 2**16
#: A file that has grown beyond this is followed by another: what is copied or lost at once stays small.
LARGEST_FILE_BYTES = 64 * 2**20
SUFFIX = ".windows.zst"
#: All files lie below it; the next levels are the day on which they began (UTC) and the axis.
FOLDER = "raw"


class OpenFrame(Protocol):
    """A frame that is being written. Each method raises OSError where it fails."""

    path: str
    offset: int

    def write(self, part: bytes) -> None:
        """Write the next part."""

    def end(self) -> None:
        """Say that no part follows; nobody will read the frame soon."""

    def sync(self) -> None:
        """Wait until the frame is durable."""

    def close(self) -> None:
        """Let the frame be: rows name it."""

    def take_back(self) -> None:
        """Remove the frame: no row names it. What cannot be removed costs room, and nothing else."""


class WaveformFiles(Protocol):
    """Where frames lie: each in a file, at an offset. Each method raises OSError where it fails.

    No two of several that share a place ever begin a file of one name. An axis is written by one thread at a time.
    """

    #: To write so many bytes takes longer than to hand them over to a thread.
    handed_over_bytes: int

    def append(self, axis_id: str, folder: str, content: Content, size: int) -> OpenFrame:
        """Write a frame of an axis, of about so many bytes, in a file of this folder; nobody will read it soon.

        Where it fails nothing of it is left.
        """
        ...

    def read(self, path: str, offset: int) -> bytes:
        """Return the content of a frame; raises as :func:`read_frame`, too."""
        ...

    def create(self, path: str) -> OpenFrame:
        """Begin a file of this name, in a folder that there is; frames follow each other in it."""
        ...

    def size(self, path: str) -> int:
        """Return the size of a file [bytes]; 0 if there is none."""
        ...

    def delete(self, path: str) -> None:
        """Delete a file, durably; one that is gone already is no error."""
        ...

    def sizes(self) -> Iterator[tuple[str, int]]:
        """Yield the files that there are, in no order, with their size [bytes]."""
        ...

    def close(self) -> None:
        """Write nothing more."""


class _Compressor(threading.local):
    """That of a thread: to make the tables of one takes as long as to compress a window."""

    def __init__(self) -> None:
        self.own = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL)


_COMPRESSOR = _Compressor()


def compressed_at_once(content: bytes | memoryview) -> bytes:
    """Compress content into one zstd frame, which states its size first: who reads it knows before."""
    return _COMPRESSOR.own.compress(content)


def compressed(content: Content, size: int) -> Iterator[bytes]:
    """Compress content into one zstd frame as above, but so much of it at a time: a large one is never held as a whole.

    What is said to be small is asked for once and compressed in one step; a large content is asked for twice.
    """
    if size <= _COMPRESSED_AT_ONCE:
        yield compressed_at_once(b"".join(content()))
        return
    frame = _COMPRESSOR.own.compressobj(size=sum(len(part) for part in content()))
    waiting, size = list[bytes | memoryview](), 0
    for part in content():
        waiting.append(part)
        size += len(part)
        if size >= _COMPRESSED_AT_ONCE:
            yield frame.compress(b"".join(waiting))
            waiting, size = [], 0
    yield frame.compress(b"".join(waiting)) + frame.flush()


def write_whole(frame: OpenFrame, content: Content, size: int) -> None:
    """Write all that a file is to get now; raises OSError, and then nothing of it is left."""
    try:
        for part in compressed(content, size):
            frame.write(part)
        frame.end()
    except OSError:
        frame.take_back()
        raise


def read_frame(file: BinaryIO | FileIO, offset: int) -> bytes:
    """Return the content of the frame that begins at a byte of a file.

    Raises ValueError if it does not say how large it is, or that it is larger than any that was ever written;
    zstandard.ZstdError if it is none, or not as large as it says.
    """
    file.seek(offset)
    head = file.read(_AT_ONCE)
    size = zstandard.get_frame_parameters(head).content_size
    if not 0 < size <= LARGEST_CONTENT_BYTES:
        raise ValueError(f"a frame must say that it holds 1 to {LARGEST_CONTENT_BYTES} bytes; got {size}")
    reader, content = zstandard.ZstdDecompressor().decompressobj(), bytearray()
    content += reader.decompress(head)
    while not reader.eof and (chunk := file.read(_AT_ONCE)):
        content += reader.decompress(chunk)
    return bytes(content)


class FolderFiles:
    """Files below a folder; one takes the frames of an axis that arrive on one day, one after another."""

    #: Less goes to the process that writes frames, where there is one: a thread would wait for the interpreter.
    handed_over_bytes = MOST_BYTES

    def __init__(self, root: Path, writer: FrameWriter | None = None) -> None:
        self.root = root
        self._writer = writer
        self._growing: dict[str, str] = {}  # by axis: the file that its next frame is added to

    def append(self, axis_id: str, folder: str, content: Content, size: int) -> "_FolderFrame":
        """Write a frame of an axis at the end of the file that it grows."""
        frame = self._next_frame(axis_id, folder)
        is_small = size <= self.handed_over_bytes
        if not (is_small and self._writer is not None and frame.is_taken_by(self._writer, content)):
            write_whole(frame, content, size)
        return frame

    def _next_frame(self, axis_id: str, folder: str) -> "_FolderFrame":
        path = self._growing.get(axis_id, "")
        if path.startswith(f"{folder}/"):
            with suppress(OSError):  # it may have been moved, or made read-only
                file = FileIO(f"{self.root}/{path}", "r+")
                if file.seek(0, os.SEEK_END) < LARGEST_FILE_BYTES:
                    return _FolderFrame(self, axis_id, path, file)
                file.close()
        path = f"{folder}/{uuid.uuid4().hex}{SUFFIX}"
        make_folder(self.root / folder)
        file = FileIO(f"{self.root}/{path}", "x")
        self._growing[axis_id] = path
        return _FolderFrame(self, axis_id, path, file)

    def read(self, path: str, offset: int) -> bytes:
        """Return the content of a frame."""
        with (self.root / path).open("rb") as file:
            return read_frame(file, offset)

    def create(self, path: str) -> "_FolderFrame":
        """Begin a file of this name."""
        return _FolderFrame(self, "", path, FileIO(f"{self.root}/{path}", "x"))

    def size(self, path: str) -> int:
        """Return the size of a file [bytes]; 0 if there is none."""
        try:
            return (self.root / path).stat().st_size
        except FileNotFoundError:
            return 0

    def delete(self, path: str) -> None:
        """Delete a file, and the folders that are empty without it."""
        remove_file(self.root, path)

    def sizes(self) -> Iterator[tuple[str, int]]:
        """Yield the files that there are, with their size [bytes]."""
        return file_sizes(self.root, FOLDER)

    def close(self) -> None:
        """Write nothing more."""
        if self._writer is not None:
            self._writer.close()

    def give_up(self, axis_id: str) -> None:
        """Begin another file with the next frame: from here on the content of this one is unknown."""
        self._growing.pop(axis_id, None)


class _FolderFrame:
    """A frame at the end of a file. The operating system has it soon, the disk when it is synced."""

    def __init__(self, files: FolderFiles, axis_id: str, path: str, file: FileIO) -> None:
        self.path = path
        self.offset = file.tell()
        self._files = files
        self._axis_id = axis_id
        self._file = file
        self._handed_over: HandedOver | None = None

    def is_taken_by(self, writer: FrameWriter, content: Content) -> bool:
        """Hand the frame over as a whole, if the writer takes it."""
        self._handed_over = writer.take(self._file, content)
        return self._handed_over is not None

    def write(self, part: bytes) -> None:
        with self._given_up_where_it_fails():
            write_all(self._file, part)

    def end(self) -> None:
        give_back_cache(self._file)

    def sync(self) -> None:
        with self._given_up_where_it_fails():
            if self._handed_over is not None:
                self._handed_over.wait()
            else:
                sync_file(self._file)
            if not self.offset:
                sync_folder((self._files.root / self.path).parent)

    def close(self) -> None:
        self._file.close()

    def take_back(self) -> None:
        """Remove the frame. It is the last of its file: an axis is written by one thread at a time."""
        with self._file, suppress(OSError):
            if self._handed_over is not None:
                with suppress(OSError), self._given_up_where_it_fails():
                    self._handed_over.wait()
            if self.offset:
                self._file.truncate(self.offset)
            else:
                self._files.delete(self.path)

    @contextmanager
    def _given_up_where_it_fails(self) -> Iterator[None]:
        try:
            yield
        except OSError:
            self._files.give_up(self._axis_id)
            raise


@contextmanager
def storage_errors(outcome: str = "nothing of the request is stored") -> Iterator[None]:
    """Turn a failure of the disk into an error of the service, which says what came of it."""
    try:
        yield
    except OSError as error:
        raise StorageError(f"the disk did not take the waveforms ({error.strerror or error}); {outcome}") from error


def write_all(file: FileIO, content: bytes) -> None:
    """Write all bytes, in as many calls as the system wants."""
    rest = memoryview(content)
    while rest:
        rest = rest[file.write(rest) :]


def give_back_cache(file: FileIO) -> None:
    """Tell the system that nobody will read this file soon."""
    # Nobody reads a waveform soon after it was written (the store remembers it). The system begins to write what it is
    # told will not be wanted, so that there is less to wait for later; and the next file takes the same pages of its
    # cache, in place of ever new ones: on a virtual machine those cost more than the disk does.
    # The page that the next frame begins in stays: it would have to be read back first.
    if hasattr(os, "posix_fadvise"):
        whole_pages = file.tell() // mmap.PAGESIZE * mmap.PAGESIZE
        os.posix_fadvise(file.fileno(), 0, whole_pages, os.POSIX_FADV_DONTNEED)


def sync_file(file: FileIO) -> None:
    """Wait until a file is on disk; nobody will read it soon."""
    os.fsync(file.fileno())
    give_back_cache(file)


def remove_file(root: Path, path: str) -> None:
    """Remove a file, and the folders that are empty without it, durably; one that is gone already is no error."""
    (root / path).unlink(missing_ok=True)
    folder = (root / path).parent
    while folder != root:
        if folder.is_dir():
            sync_folder(folder)
            try:
                folder.rmdir()
            except OSError:  # there is more in it
                return
        folder = folder.parent


def file_sizes(root: Path, folder: str) -> Iterator[tuple[str, int]]:
    """Yield the files below a folder, by their path relative to the root, with their size [bytes]."""
    try:
        entries = sorted(os.scandir(root / folder), key=lambda entry: entry.name)
    except FileNotFoundError:
        return
    for entry in entries:
        path = f"{folder}/{entry.name}"
        if entry.is_dir():
            yield from file_sizes(root, path)
        else:
            with suppress(FileNotFoundError):  # removed meanwhile
                yield path, entry.stat().st_size


def make_folder(folder: Path) -> None:
    """Make a folder and those above it, durably."""
    if folder.is_dir():
        return
    make_folder(folder.parent)
    folder.mkdir(exist_ok=True)
    sync_folder(folder.parent)


def sync_folder(folder: Path) -> None:
    """Wait until the names in a folder are on disk: a new name is durable only when its folder is."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
