"""Read NumPy archives, ``*.npz``, and single arrays, ``*.npy``; nothing is unpickled.

Every array of real numbers in an archive is a channel of its name; a single array is the channel ``array``.
"""

import zipfile
from pathlib import Path
from typing import IO

import numpy as np

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.files import refusing, require_file, require_plausible_length
from monitor_core.recordings.raw.channels import Channel, Channels, native_samples


def read_channels(path: Path) -> Channels:
    """Read the arrays of a file of ``numpy.savez``; it states neither units nor a time base.

    There is one channel per array. Arrays of other than one or two dimensions, and of other than real numbers, are no
    channels and are left out. ``RecordingFormatError`` if the archive or an array in it is damaged, or if a header
    promises what the file does not hold.
    """
    if path.suffix.lower() == ".npy":
        return _read_array(path)
    channels = []
    with refusing(path.name, "a NumPy archive (.npz)"), zipfile.ZipFile(require_file(path)) as archive:
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            with archive.open(member) as stream:
                shape, dtype = _header(stream)
            if dtype.kind not in "fiu" or len(shape) not in (1, 2):
                continue
            n_values = int(np.prod(shape, dtype=object))
            require_plausible_length(n_values, f"{path.name}, {name}")
            if member.file_size < n_values * dtype.itemsize:
                raise RecordingFormatError(
                    f"{path.name}, {name}: expected {n_values} values as its header says; "
                    f"got {member.file_size} bytes in all"
                )
            with archive.open(member) as stream:
                values = np.lib.format.read_array(stream, allow_pickle=False)
            channels.append(Channel(name, native_samples(values)))
    return Channels(path.name, tuple(channels))


def _read_array(path: Path) -> Channels:
    n_bytes = require_file(path).stat().st_size
    with refusing(path.name, "a NumPy array (.npy)"), path.open("rb") as stream:
        shape, dtype = _header(stream)
        if dtype.kind not in "fiu" or len(shape) not in (1, 2):
            raise RecordingFormatError(
                f"{path.name}: expected real numbers in one or two dimensions; got {dtype} of shape {shape}"
            )
        n_values = int(np.prod(shape, dtype=object))
        require_plausible_length(n_values, path.name)
        if n_bytes < n_values * dtype.itemsize:
            raise RecordingFormatError(
                f"{path.name}: expected {n_values} values as its header says; got {n_bytes} bytes in all"
            )
        stream.seek(0)
        values = np.lib.format.read_array(stream, allow_pickle=False)
    return Channels(path.name, (Channel("array", native_samples(values)),))


def _header(stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[np.generic]]:
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(stream)
    return shape, dtype
