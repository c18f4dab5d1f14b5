"""Read MATLAB files, ``*.mat``: every array of real numbers is a channel of its name.

Numbers inside a structure are channels too, named as MATLAB calls them: ``record.force``, ``record.Y(2).Data``.
Versions 4 to 7.2 are read by scipy. Version 7.3 is HDF5: a structure is a group, and since MATLAB numbers the elements
column by column and HDF5 row by row, a matrix stands in the file transposed; channels have the shape that MATLAB shows.
There the fields of an array of structures are references to other places of the file and are left out.
"""

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.bounds import (
    MAX_CHANNELS,
    require_plausible_channels,
    require_plausible_expansion,
)
from monitor_core.recordings.elements.files import refusing, require_file
from monitor_core.recordings.elements.hdf5 import attributes, open_hdf5, require_readable, values_of
from monitor_core.recordings.raw.channels import Channel, Channels, native_samples, single_numbers

if TYPE_CHECKING:
    import h5py

_DEEPEST = 8  # structures inside structures
_SIGNATURE_OF_HDF5 = b"\x89HDF\r\n\x1a\n"
_CLASSES = frozenset((
    "double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "logical", "",
))  # fmt: skip
_STATED = frozenset(("MATLAB_class", "MATLAB_empty"))
_TABLES = ("timetable", "table", "timeseries")
_SAVE_ARRAYS = "in MATLAB, save their columns as arrays (t = seconds(T.Time - T.Time(1)), x = T.Torque)"


def read_channels(path: Path) -> Channels:
    """Read the numeric arrays of a MATLAB file; it states neither units nor a time base.

    There is one channel per array, also for those in the fields of a structure; MATLAB's rows and columns of one become
    one-dimensional. Single numbers are kept by name, texts are left out; cells, complex numbers, sparse arrays, arrays
    of more than two dimensions and objects (``timetable``) are named as not read. ``RecordingFormatError`` if the file
    is damaged.
    """
    with require_file(path).open("rb") as stream:
        head = stream.read(1024)
    # MATLAB writes 512 bytes of text in front of HDF5
    if _SIGNATURE_OF_HDF5 in (head[:8], head[512:520]) or head.startswith(b"MATLAB 7.3"):
        return _read_version_7_3(path)
    return _read_version_4_to_7_2(path)


def _channel(name: str, array: npt.NDArray[np.generic]) -> Channel:
    return Channel(name, native_samples(array.reshape(-1) if 1 in array.shape else array))


def _read_version_4_to_7_2(path: Path) -> Channels:
    from scipy.io.matlab import MatlabOpaque  # noqa: PLC0415  # file libraries are imported where they are needed
    from scipy.io.matlab._mio import mat_reader_factory  # noqa: PLC0415

    objects = list[MatlabOpaque]()  # all of one name, of which scipy would keep the last
    left_out = list[str]()
    with refusing(path.name, "a MATLAB file"), path.open("rb") as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.filterwarnings("error", "Unreadable variable")
        reader, _ = mat_reader_factory(stream)
        read_variable = reader.read_var_array

        def keep(*of: object) -> object:
            value = read_variable(*of)
            objects.extend([value] if isinstance(value, MatlabOpaque) else [])
            return value

        reader.read_var_array = keep
        read = [
            named
            for name, value in reader.get_variables().items()
            if not name.startswith("__") and not isinstance(value, MatlabOpaque)  # MATLAB's names begin with a letter
            for named in _arrays_in(value, name, 0, left_out)
        ]
        left_out += [f"{_text_in(value['s0'])} ({_object(_text_in(value['s2']))})" for value in objects]
        arrays = [(name, array) for name, array in read if array.size > 1]
        if not arrays and objects:
            raise RecordingFormatError(
                f"{path.name}: expected arrays of numbers; got objects (timetable, timeseries or the like), which are "
                f"not read: {_SAVE_ARRAYS}"
            )
        require_plausible_channels([(name, array.size) for name, array in arrays], path.name)
        numbers = single_numbers((name, array.item()) for name, array in read if array.size == 1)
        channels = tuple(_channel(name, array) for name, array in arrays)
        return Channels(path.name, channels, numbers=numbers, left_out=tuple(left_out))


def _text_in(field: npt.NDArray[np.object_]) -> str:
    return str(field.reshape(-1)[0].decode("latin-1"))


def _object(of_matlab: str) -> str:
    """Say what an object of a class is, and what to do with it."""
    return f"{of_matlab}: {_SAVE_ARRAYS}" if of_matlab in _TABLES else f"object of the class {of_matlab}"


def _arrays_in(
    value: object, name: str, depth: int, left_out: list[str]
) -> Iterator[tuple[str, npt.NDArray[np.generic]]]:
    """Yield the arrays of real numbers that a variable is, or has in its fields."""
    if (why := _why_not_read(value)) is not None:
        left_out.append(f"{name} ({why})")
    elif not isinstance(value, np.ndarray) or value.ndim != 2:
        return
    elif value.dtype.names is not None:
        fields = value.dtype.names
        if depth == _DEEPEST or value.size * len(fields) > MAX_CHANNELS:  # a table kept as structures of numbers
            return
        for number, record in enumerate(value.reshape(-1, order="F"), start=1):
            label = name if value.size == 1 else f"{name}({number})"
            for field in fields:
                yield from _arrays_in(record[field], f"{label}.{field}", depth + 1, left_out)
    elif value.dtype.kind in "fiub":
        yield name, value


def _why_not_read(value: object) -> str | None:
    """Say what a variable is that is no channel; ``None`` for texts as for numbers and structures."""
    from scipy.io.matlab import MatlabFunction, MatlabObject, MatlabOpaque  # noqa: PLC0415
    from scipy.sparse import issparse  # noqa: PLC0415

    if issparse(value):
        return "sparse"
    if isinstance(value, (MatlabObject, MatlabFunction, MatlabOpaque)):
        return "function" if isinstance(value, MatlabFunction) else "object"
    if not isinstance(value, np.ndarray) or value.dtype.names is not None:
        return None
    if value.dtype.kind in "fiub":
        return f"{value.ndim} dimensions" if value.ndim != 2 else None
    return {"O": "cell", "c": "complex"}.get(value.dtype.kind)


def _read_version_7_3(path: Path) -> Channels:
    with open_hdf5(path) as file, refusing(path.name, "a MATLAB file of version 7.3"):
        left_out = list[str]()
        read = dict(_datasets(file, "", path.name, 0, left_out))
        arrays = {name: dataset for name, dataset in read.items() if dataset.size > 1}
        single = {name: dataset for name, dataset in read.items() if dataset.size == 1}
        require_plausible_channels([(name, dataset.size) for name, dataset in arrays.items()], path.name)
        n_bytes = sum(dataset.size * dataset.dtype.itemsize for dataset in arrays.values())
        require_plausible_expansion(n_bytes, path.stat().st_size, path.name)
        for name, dataset in (arrays | single).items():
            require_readable(dataset, f"{path.name}, {name}")
        channels = tuple(_channel(name, values_of(dataset).T) for name, dataset in arrays.items())
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
        inside, label = group[name], f"{prefix}{name}"
        why: str | None = None
        if isinstance(inside, h5py.Group) and "MATLAB_sparse" in inside.attrs:
            why = "sparse"
        elif isinstance(inside, h5py.Group) and depth < _DEEPEST:
            yield from _datasets(inside, f"{label}.", where, depth + 1, left_out)
        elif isinstance(inside, h5py.Dataset) and _holds_numbers(inside, f"{where}, {label}"):
            yield label, inside
        elif isinstance(inside, h5py.Dataset):
            why = _why_no_channel(inside, f"{where}, {label}")
        if why is not None:
            left_out.append(f"{label} ({why})")


def _why_no_channel(dataset: "h5py.Dataset", where: str) -> str | None:
    """Say what an array is that is no channel; ``None`` for texts and empty ones."""
    import h5py  # noqa: PLC0415

    kind = dataset.id.get_type().get_class()
    stated = attributes(dataset, _STATED, where).values
    if (of_matlab := _class_of(stated)) not in _CLASSES and of_matlab != "char" and "MATLAB_empty" not in stated:
        return of_matlab if of_matlab in ("cell", "function_handle") else _object(of_matlab)
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
    return _class_of(stated) in _CLASSES and "MATLAB_empty" not in stated and dataset.size > 0


def _class_of(stated: Mapping[str, object]) -> str:
    """Return the class of MATLAB that an array is of; empty where another program wrote it."""
    kind = stated.get("MATLAB_class", "")
    return kind.decode("ascii", "replace") if isinstance(kind, bytes) else str(kind)
