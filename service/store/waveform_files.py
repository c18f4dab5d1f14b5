"""Write, sync and read the files of raw waveforms: what the store needs of the disk."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path

import zstandard

from service.errors import StorageError


def read_frame(path: Path, offset: int) -> bytes:
    """Return the content of the frame that begins at a byte of a file."""
    reader, content = zstandard.ZstdDecompressor().decompressobj(), bytearray()
    with path.open("rb") as file:
        file.seek(offset)
        while not reader.eof and (chunk := file.read(2**16)):
            content += reader.decompress(chunk)
    return bytes(content)


@contextmanager
def storage_errors() -> Iterator[None]:
    """Turn a failure of the disk into an error of the service."""
    try:
        yield
    except OSError as error:
        raise StorageError(
            f"the disk did not take the waveforms ({error.strerror}); nothing of the request is stored"
        ) from error


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
