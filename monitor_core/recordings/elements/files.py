"""Check a file before it is read, and turn errors of file libraries into one sentence."""

import codecs
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from monitor_core.arrays import SampleArray
from monitor_core.errors import MonitorCoreError, RecordingFormatError

#: Longest channel that is read: over an hour at 16 kHz. A header that promises more is refused before memory is given.
MAX_SAMPLES = 2**26
#: At least one letter of so many bytes of a table in UTF-16 has a zero half: digits, signs and separators have.
_LETTERS_WITHOUT = 3


def require_file(path: Path) -> Path:
    """Return the path if it is a regular file that is not empty.

    ``RecordingFormatError`` if nothing is there, if it is a folder, a pipe or a device, or if it is empty.
    """
    if not path.exists():
        raise RecordingFormatError(f"{path.name}: expected a file; nothing is at this path")
    if path.is_dir():
        name = path.resolve().name or str(path)  # "." and ".." have no name of their own
        raise RecordingFormatError(f"{name}: expected a file; got a folder: name one of the files in it")
    if not path.is_file():
        raise RecordingFormatError(f"{path.name}: expected a regular file; got a pipe or device")
    if path.stat().st_size == 0:
        raise RecordingFormatError(f"{path.name}: expected a recording; the file is empty (0 bytes)")
    return path


def stem_of(name: str) -> str:
    """Return a file name without its ending, by which files that are made of it are called.

    Examples
    --------
    >>> stem_of("run.2025-03-01.csv"), stem_of("mill.session.h5")
    ('run.2025-03-01', 'mill')

    """
    stem = name.rpartition(".")[0] or name
    for ending in (".session", ".frf", ".calibration", ".motion"):
        stem = stem.removesuffix(ending)
    return stem


def read_text(path: Path) -> str:
    """Return the file as UTF-8 text without its byte order mark."""
    try:
        return require_file(path).read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordingFormatError(
            f"{path.name}: expected UTF-8 text; byte {error.start} is {error.object[error.start]:#04x}"
        ) from error


def utf16_codec(head: bytes) -> str | None:
    """Return by which codec the beginning of a text in UTF-16 is read; None for anything else.

    Without a byte order mark it shows in the zero bytes: those of one half of the letters, and none of the other.
    """
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    halves = head[: len(head) // 2 * 2]
    first, second = halves[0::2].count(0), halves[1::2].count(0)
    if not halves or max(first, second) * _LETTERS_WITHOUT < len(halves) or min(first, second) > 0:
        return None
    return "utf-16-le" if second else "utf-16-be"


def parse_toml(text: str, where: str, expected: str) -> dict[str, object]:
    """Return a TOML document; ``RecordingFormatError`` names what was expected if it is none, or nested too deeply."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise RecordingFormatError(f"{where}: expected {expected} in TOML; {error}") from error
    except RecursionError:
        raise RecordingFormatError(f"{where}: expected {expected} in TOML; got tables nested too deeply") from None


def require_plausible_length(n_samples: int, where: str) -> None:
    """Refuse a length that no window has, before anything is allocated for it."""
    if n_samples > MAX_SAMPLES:
        raise RecordingFormatError(f"{where}: expected at most {MAX_SAMPLES} samples; the header promises {n_samples}")


def listed(words: Sequence[str], conjunction: str = "or") -> str:
    """Return words as a sentence lists them."""
    *others, last = words
    return f"{', '.join(others)} {conjunction} {last}" if others else last


@contextmanager
def naming(where: str) -> Iterator[None]:
    """Say which file and place hold the values that a record of the core refuses."""
    try:
        yield
    except RecordingFormatError:
        raise
    except MonitorCoreError as error:
        raise RecordingFormatError(f"{where}: {error}") from error


@contextmanager
def refusing(where: str, expected: str) -> Iterator[None]:
    """Turn whatever a file library raises on a damaged file into one sentence of ours.

    The libraries behind the readers (HDF5, npTDMS, pyuff, scipy.io, zipfile) raise nearly every built-in class and
    bare ``Exception`` when bytes are not what they expect: this is the one place where all of it is caught.
    """
    try:
        yield
    except MonitorCoreError:
        raise
    except Exception as error:  # see above: pyuff raises bare Exception, h5py half a dozen classes
        raise RecordingFormatError(f"{where}: expected {expected}; {_reason(error)}") from error


def _reason(error: Exception) -> str:
    """Say what keeps a file from being read: what a library calls it says nothing to whoever has the file."""
    if isinstance(error, OSError) and error.errno is not None:
        return f"it cannot be read: {error.strerror}"
    if isinstance(error, MemoryError):
        return "it takes more memory than there is for it"
    return "it is damaged or cut off: export it anew, or copy it again"


def samples_at(file: BinaryIO, start: int, size: int, dtype: "np.dtype[np.generic]", where: str) -> SampleArray:
    """Read so many samples from a byte on, in the byte order of this machine; the array cannot be written to.

    ``where`` names file and place for the message. ``RecordingFormatError`` if the file ends before.
    """
    file.seek(start)
    content = file.read(size * dtype.itemsize)
    if len(content) != size * dtype.itemsize:
        raise RecordingFormatError(f"{where}: expected {size} samples; the file ends before")
    values: SampleArray = np.frombuffer(content, dtype)
    if not dtype.isnative:
        values = values.astype(dtype.newbyteorder("="))
        values.setflags(write=False)
    return values
