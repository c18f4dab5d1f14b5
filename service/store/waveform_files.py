"""Write, sync and read the files of raw waveforms: what the store needs of the disk."""

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path

import zstandard

from service.errors import StorageError

#: A request becomes one frame. Numbers take twice the room of their text at most, and a body is at most 1 GiB.
LARGEST_CONTENT_BYTES = 2 * 2**30
#: Few large steps: after each the interpreter is waited for, which other threads hold.
_COMPRESSED_AT_ONCE = 2 * 2**20
_AT_ONCE = 2**16


class _Compressors(threading.local):
    """Those of a thread, by level: to make the tables of one takes as long as to compress a window."""

    def __init__(self) -> None:
        self.of_level: dict[int, zstandard.ZstdCompressor] = {}


_COMPRESSORS = _Compressors()


def compressed(content: Callable[[], Iterable[bytes | memoryview]], size: int, level: int) -> Iterator[bytes]:
    """Compress content into one zstd frame, so much of it at a time: a large one is never held as a whole.

    What is said to be small is asked for once and compressed in one step; a large content is asked for twice. The frame
    states its size first, so that who reads it knows before.
    """
    if size <= _COMPRESSED_AT_ONCE:
        yield _compressor(level).compress(b"".join(content()))
        return
    frame = _compressor(level).compressobj(size=sum(len(part) for part in content()))
    waiting, size = list[bytes | memoryview](), 0
    for part in content():
        waiting.append(part)
        size += len(part)
        if size >= _COMPRESSED_AT_ONCE:
            yield frame.compress(b"".join(waiting))
            waiting, size = [], 0
    yield frame.compress(b"".join(waiting)) + frame.flush()


def _compressor(level: int) -> zstandard.ZstdCompressor:
    if level not in _COMPRESSORS.of_level:
        _COMPRESSORS.of_level[level] = zstandard.ZstdCompressor(level=level)
    return _COMPRESSORS.of_level[level]


def read_frame(path: Path, offset: int) -> bytes:
    """Return the content of the frame that begins at a byte of a file.

    Raises ValueError if it does not say how large it is, or that it is larger than any that was ever written;
    zstandard.ZstdError if it is none, or not as large as it says.
    """
    with path.open("rb") as file:
        file.seek(offset)
        first = file.read(_AT_ONCE)
        size = zstandard.get_frame_parameters(first).content_size
        if not 0 < size <= LARGEST_CONTENT_BYTES:
            raise ValueError(f"a frame must say that it holds 1 to {LARGEST_CONTENT_BYTES} bytes; got {size}")
        reader, content = zstandard.ZstdDecompressor().decompressobj(), bytearray()
        content += reader.decompress(first)
        while not reader.eof and (chunk := file.read(_AT_ONCE)):
            content += reader.decompress(chunk)
    return bytes(content)


@contextmanager
def storage_errors(outcome: str = "nothing of the request is stored") -> Iterator[None]:
    """Turn a failure of the disk into an error of the service, which says what came of it."""
    try:
        yield
    except OSError as error:
        raise StorageError(f"the disk did not take the waveforms ({error.strerror}); {outcome}") from error


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
    if hasattr(os, "posix_fadvise"):
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


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
