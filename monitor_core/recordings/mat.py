"""MATLAB files, ``*.mat`` of version 4 to 7.2: every array of real numbers is a channel of its name."""

from pathlib import Path

import numpy as np

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.channels import Channel, Channels, native_samples
from monitor_core.recordings.files import refusing, require_file, require_plausible_length

_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_REAL_CLASSES = frozenset(
    ("double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "logical")
)


def read_channels(path: Path) -> Channels:
    """Read the numeric arrays of a MATLAB file; it states neither units nor a time base.

    Parameters
    ----------
    path : Path
        Version 4, 5, 6 or 7. Single numbers, structures, cells, texts and complex arrays are no channels and are
        left out.

    Returns
    -------
    Channels
        One per array; MATLAB's rows and columns of one become one-dimensional.

    Raises
    ------
    RecordingFormatError
        If the file is damaged, or of version 7.3, which is another format.
    """
    import scipy.io  # noqa: PLC0415

    with require_file(path).open("rb") as stream:
        head = stream.read(520)
    if head[:10] == b"MATLAB 7.3" or _HDF5_SIGNATURE in (head[:8], head[512:520]):
        raise RecordingFormatError(
            f"{path.name}: expected a MATLAB file of version 4 to 7.2; got version 7.3 (HDF5): save it with '-v7'"
        )
    with refusing(path.name, "a MATLAB file of version 4 to 7.2"):
        arrays = []
        for name, shape, kind in scipy.io.whosmat(path):
            n_values = int(np.prod(shape, dtype=object))
            if kind in _REAL_CLASSES and len(shape) == 2 and n_values > 1:
                require_plausible_length(n_values, f"{path.name}, {name}")
                arrays.append(name)
        values = scipy.io.loadmat(path, variable_names=arrays) if arrays else {}
        return Channels(path.name, tuple(_channels(arrays, values)))


def _channels(names: list[str], values: dict[str, object]) -> list[Channel]:
    channels = []
    for name in names:
        array = np.asarray(values[name])
        if array.dtype.kind in "fiub":
            channels.append(Channel(name, native_samples(array.reshape(-1) if 1 in array.shape else array)))
    return channels
