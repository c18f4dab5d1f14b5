"""Read MATLAB files of version 7.3, which are HDF5: every array of real numbers is a channel of its name.

MATLAB numbers the elements column by column and HDF5 row by row, so a matrix stands in the file transposed: channels
have the shape that MATLAB shows. A structure is a group; its numeric fields are channels ``structure.field``. The
fields of an array of structures are references to other places of the file and are left out.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.bounds import (
    MAX_CHANNELS,
    require_plausible_channels,
    require_plausible_expansion,
)
from monitor_core.recordings.elements.files import refusing
from monitor_core.recordings.elements.hdf5 import attributes, open_hdf5
from monitor_core.recordings.elements.hdf5_numbers import require_readable, values_of
from monitor_core.recordings.raw.channels import MOST_LEFT_OUT, Channel, Channels, native_samples, single_numbers

if TYPE_CHECKING:
    import h5py

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_CLASSES = frozenset((
    "double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "logical", "",
))  # fmt: skip
_STATED = frozenset(("MATLAB_class", "MATLAB_empty"))
_DEEPEST = 8  # structures inside structures


def is_version_7_3(head: bytes) -> bool:
    """Tell whether a file that begins so is HDF5; MATLAB writes 512 bytes of text in front."""
    return _SIGNATURE in (head[:8], head[512:520]) or head.startswith(b"MATLAB 7.3")


def read_channels(path: Path) -> Channels:
    """Read the numeric arrays of a MATLAB file of version 7.3; it states neither units nor a time base.

    Raises and leaves out as :func:`monitor_core.recordings.raw.binary.mat.read_channels`.
    """
    with open_hdf5(path) as file, refusing(path.name, "a MATLAB file of version 7.3"):
        left_out = list[str]()
        read = dict(_datasets(file, "", path.name, 0, left_out))
        found = {name: dataset for name, dataset in read.items() if dataset.size > 1}
        # in chunks, a single number might be a bomb; MATLAB writes none so
        single = {name: dataset for name, dataset in read.items() if dataset.size == 1 and dataset.chunks is None}
        require_plausible_channels([(name, dataset.size) for name, dataset in found.items()], path.name)
        n_bytes = sum(dataset.size * dataset.dtype.itemsize for dataset in found.values())
        require_plausible_expansion(n_bytes, path.stat().st_size, path.name)
        for name, dataset in (found | single).items():
            require_readable(dataset, f"{path.name}, {name}")
        channels = tuple(_channel(name, dataset) for name, dataset in found.items())
        numbers = single_numbers((name, float(values_of(dataset).real.item())) for name, dataset in single.items())
        return Channels(path.name, channels, numbers=numbers, left_out=tuple(left_out))


def _datasets(
    group: "h5py.Group", prefix: str, where: str, depth: int, left_out: list[str]
) -> Iterator[tuple[str, "h5py.Dataset"]]:
    import h5py  # noqa: PLC0415

    if len(group) > MAX_CHANNELS:
        raise RecordingFormatError(f"{where}: expected at most {MAX_CHANNELS} arrays; got {len(group)}")
    for name in group:
        # a link could name any file of the machine; MATLAB keeps cells and objects under names that begin with '#'
        if name.startswith("#") or not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        found, label = group[name], f"{prefix}{name}"
        why = None
        if isinstance(found, h5py.Group) and "MATLAB_sparse" in found.attrs:
            why = "sparse"
        elif isinstance(found, h5py.Group) and depth < _DEEPEST:
            yield from _datasets(found, f"{label}.", where, depth + 1, left_out)
        elif isinstance(found, h5py.Dataset) and _holds_numbers(found, f"{where}, {label}"):
            yield label, found
        elif isinstance(found, h5py.Dataset):
            why = _why_not(found)
        if why is not None and len(left_out) <= MOST_LEFT_OUT:
            left_out.append(f"{label} ({why})")


def _why_not(dataset: "h5py.Dataset") -> str | None:
    """Say what an array is that is no channel; ``None`` for texts and empty ones."""
    import h5py  # noqa: PLC0415

    kind = dataset.id.get_type().get_class()
    if kind == h5py.h5t.COMPOUND:
        return "complex"
    if kind == h5py.h5t.REFERENCE:
        return "cell"
    return f"{dataset.ndim} dimensions" if dataset.ndim > 2 else None


def _holds_numbers(dataset: "h5py.Dataset", where: str) -> bool:
    import h5py  # noqa: PLC0415

    if dataset.id.get_type().get_class() not in (h5py.h5t.INTEGER, h5py.h5t.FLOAT) or dataset.ndim not in (1, 2):
        return False
    stated = attributes(dataset, _STATED, where).values
    return str(_text(stated.get("MATLAB_class", ""))) in _CLASSES and "MATLAB_empty" not in stated and dataset.size > 0


def _text(value: object) -> object:
    return value.decode("ascii", "replace") if isinstance(value, bytes) else value


def _channel(name: str, dataset: "h5py.Dataset") -> Channel:
    values = values_of(dataset).T
    return Channel(name, native_samples(values.reshape(-1) if 1 in values.shape else values))
