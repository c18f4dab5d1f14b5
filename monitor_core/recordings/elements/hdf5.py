"""Open HDF5 files and take their groups, attributes and numbers, each looked at before it is read.

Links that lead out of the file are refused, and so are virtual datasets and external storage: a recording is one file.
Numbers that were announced and never written are refused too, since HDF5 answers zeros for them.
"""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.bounds import FREE_BYTES, require_plausible_expansion
from monitor_core.recordings.elements.fields import Fields
from monitor_core.recordings.elements.files import refusing, require_file, require_plausible_length

if TYPE_CHECKING:
    import h5py

_FLOAT, _DOUBLE = np.dtype("<f4"), np.dtype("<f8")


@contextmanager
def open_hdf5(path: Path) -> Iterator["h5py.File"]:
    """Open an HDF5 file for reading; ``RecordingFormatError`` if it is none, or a damaged one."""
    import h5py  # noqa: PLC0415  # file libraries are imported where they are needed

    with refusing(path.name, "an HDF5 file"):
        file = h5py.File(require_file(path), "r")
    with file:
        _keep_cache_small(file)
        yield file


_REFERENCE = 16  # of a text of any length in a file: how long it is, and where [bytes]
#: Of the metadata of a file in memory [bytes]. By itself the cache grows to 32 MiB, several times that with what hangs
#: on it, for windows that are read once each.
_CACHE = 2**19


def _keep_cache_small(file: "h5py.File") -> None:
    """Bound what HDF5 keeps of the metadata, so that memory stays flat however many windows there are."""
    configuration = file.id.get_mdc_config()
    configuration.set_initial_size = True
    configuration.initial_size = configuration.min_size = configuration.max_size = _CACHE
    file.id.set_mdc_config(configuration)


def attributes(group: "h5py.Group", known: frozenset[str], where: str) -> Fields:
    """Return the known attributes, which are numbers and texts."""
    return attributes_at(group.id, known, where)


def attributes_at(place: "h5py.h5g.GroupID", known: frozenset[str], where: str) -> Fields:
    """Return the known attributes of a group that is open, as :func:`attributes`.

    By the calls of HDF5 itself: what h5py does around each takes longer than they do, and a session of two hours has a
    hundred thousand.
    """
    import h5py  # noqa: PLC0415

    names = list[bytes]()
    h5py.h5a.iterate(place, names.append)  # by name
    stated = _decoded(known)
    found = {stated[name]: h5py.h5a.open(place, name) for name in names if name in stated}
    return Fields({name: _value_of(attribute, where, name) for name, attribute in found.items()}, where)


@lru_cache(maxsize=64)
def _decoded(known: frozenset[str]) -> dict[bytes, str]:
    """Return names by their bytes."""
    return {name.encode(): name for name in known}


def _value_of(stored: "h5py.h5a.AttrID", where: str, name: str) -> object:
    """Read the single value of an attribute that is open; what nearly all of them are goes without detours."""
    import h5py  # noqa: PLC0415

    kind = stored.get_type()
    if isinstance(kind, h5py.h5t.TypeStringID) and kind.is_variable_str():
        size, array, memory = _REFERENCE, np.empty((), dtype=object), _text_in_memory(kind.get_cset())
    elif isinstance(kind, h5py.h5t.TypeFloatID) and kind.equal(h5py.h5t.IEEE_F64LE):
        size, array, memory = 8, np.empty(()), h5py.h5t.NATIVE_DOUBLE
    else:
        return _unusual_value_of(stored, f"{where}, {name}")
    if not _takes(stored, size):  # h5py does not look whether the array has room
        return _unusual_value_of(stored, f"{where}, {name}")
    stored.read(array, memory)
    value: object = array.item()
    return text_of(value) if isinstance(value, bytes) else value


def _takes(stored: "h5py.h5a.AttrID", size: int) -> bool:
    """Tell whether an attribute takes so many bytes: those of one value. HDF5 has counted them when it opened it."""
    try:
        return bool(stored.get_storage_size() == size)
    except RuntimeError:  # no value at all
        return False


def _unusual_value_of(stored: "h5py.h5a.AttrID", place: str) -> object:
    """Read the single value of an attribute, of any type of number or text."""
    import h5py  # noqa: PLC0415

    kind, shape = stored.get_type(), stored.shape
    # MATLAB and LabVIEW write a single value as an array of one
    readable = (h5py.h5t.INTEGER, h5py.h5t.FLOAT, h5py.h5t.STRING)
    if kind.get_class() not in readable or shape not in ((), (1,), (1, 1)):
        raise RecordingFormatError(f"{place}: expected a single number or text; got {stored.dtype} of shape {shape}")
    array = np.zeros(shape, dtype=kind.dtype)
    stored.read(array, type_in_memory(array.dtype.str, h5py.check_string_dtype(array.dtype)))
    value: object = array.reshape(-1)[0]
    of_any_length = array.dtype.hasobject
    return text_of(value) if of_any_length and isinstance(value, bytes) else value


@lru_cache(maxsize=4)
def _text_in_memory(characters: int) -> "h5py.h5t.TypeID":
    """Return HDF5's own description of a text of any length, in ASCII or UTF-8."""
    import h5py  # noqa: PLC0415

    encoding = "utf-8" if characters == h5py.h5t.CSET_UTF8 else "ascii"
    return h5py.h5t.py_create(h5py.string_dtype(encoding))


@lru_cache(maxsize=256)
def type_in_memory(code: str, text: "h5py.h5t.string_info | None") -> "h5py.h5t.TypeID":
    """Return HDF5's own description of a NumPy type: making it takes longer than reading a value."""
    import h5py  # noqa: PLC0415

    return h5py.h5t.py_create(np.dtype(code) if text is None else h5py.string_dtype(*text))


def member(group: "h5py.Group", name: str, kind: str, place: str) -> "h5py.Group":
    """Return a "Group" or "Dataset" that really lies in this file: a link could name any file of the machine."""
    import h5py  # noqa: PLC0415

    links, encoded = group.id.links, name.encode("utf-8", "surrogateescape")
    if not links.exists(encoded) or links.get_info(encoded).type != h5py.h5l.TYPE_HARD:
        got = " inside the file; got a link" if links.exists(encoded) else "; it is missing"
        raise RecordingFormatError(f"{place}: expected a {kind.lower()}{got}")
    found = group[name]
    if not isinstance(found, getattr(h5py, kind)):
        raise RecordingFormatError(f"{place}: expected a {kind.lower()}; got a {type(found).__name__.lower()}")
    return found


@dataclass(frozen=True, slots=True, eq=False)
class NumberedGroups:
    """A folder whose groups are named by numbers, in order."""

    folder: "h5py.Group"
    names: tuple[str, ...]
    _kinds: Mapping[str, int]  # of links
    _where: str

    def stated(self, known: frozenset[str]) -> dict[str, Fields]:
        """Return two or three known attributes of each group. ``RecordingFormatError`` if something is no group."""
        return {name: self._frame_of(name, known) for name in self.names}

    def _frame_of(self, name: str, known: frozenset[str]) -> Fields:
        place = f"{self._where}/{name}"
        return _frame_of(_group_in(self.folder, name, self._kinds[name], place), known, place)


def numbered_groups(file: "h5py.File", folder: str, digits: int, where: str) -> NumberedGroups:
    """Return a folder whose groups are named by numbers.

    ``folder``: name of the folder in the file; ``digits``: fewest digits of a name; ``where``: name of the file, for
    messages. ``RecordingFormatError`` if the folder is missing, or something in it is not named by a number.
    """
    found = member(file, folder, "Group", f"{where} /{folder}")
    kinds = dict[str, int]()
    found.id.links.iterate(lambda name, link: kinds.update({text_of(name): link.type}), info=True)
    names = sorted(kinds, key=lambda name: (len(name), name))
    for name in names:
        if len(name) < digits or not (name.isascii() and name.isdigit()):
            raise RecordingFormatError(
                f"{where} /{folder}/{name}: expected a group named by at least {digits} digits; got {name!r}"
            )
    return NumberedGroups(found, tuple(names), kinds, f"{where} /{folder}")


def text_of(name: bytes) -> str:
    """Return a name or a text of the file."""
    return name.decode("utf-8", "surrogateescape")


def _frame_of(group: "h5py.h5g.GroupID", known: frozenset[str], place: str) -> Fields:
    """Return two or three known attributes of a group; the others are not even listed."""
    import h5py  # noqa: PLC0415

    values = dict[str, object]()
    for encoded, name in _decoded(known).items():
        if h5py.h5a.exists(group, encoded):
            values[name] = _value_of(h5py.h5a.open(group, encoded), place, name)
    return Fields(values, place)


def _group_in(folder: "h5py.Group", name: str, kind: int, place: str) -> "h5py.h5g.GroupID":
    """Return a group that really lies in this folder, as :func:`member` does, in a tenth of its time."""
    import h5py  # noqa: PLC0415

    if kind == h5py.h5l.TYPE_HARD:
        opened = h5py.h5o.open(folder.id, name.encode())
        if isinstance(opened, h5py.h5g.GroupID):
            return opened
    return member(folder, name, "Group", place).id  # or the sentence that says what it is


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """A one-dimensional dataset that was looked at; its numbers are not read yet."""

    size: int
    dtype: "np.dtype[np.generic]"
    start: int | None  # its first byte in the file, where its numbers lie there as they are, one after the other
    stored: "h5py.h5d.DatasetID"

    def values(self) -> npt.NDArray[np.number]:
        """Read the numbers, as :func:`values_of`."""
        return _values(self.stored, (self.size,), self.dtype)


def column(group: "h5py.Group | h5py.h5g.GroupID", name: str, where: str, types: tuple[str, ...]) -> Column:
    """Look at a one-dimensional dataset of one of these NumPy types, in either byte order; nothing is read yet."""
    import h5py  # noqa: PLC0415

    place = f"{where}/{name}"
    stored = _dataset_in(group if isinstance(group, h5py.h5g.GroupID) else group.id, name, place)
    dtype, shape = _dtype_of(stored), stored.shape
    if dtype.newbyteorder("=") not in types:
        raise RecordingFormatError(f"{place}: expected {' or '.join(types)}; got {dtype}")
    if shape is None or len(shape) != 1:
        raise RecordingFormatError(f"{place}: expected one dimension; got shape {shape}")
    start = stored.get_offset()
    if start is not None and stored.get_storage_size() == shape[0] * dtype.itemsize:
        require_plausible_length(shape[0], place)
    else:
        start = None
        _require_readable(stored, shape, dtype, place)
    return Column(shape[0], dtype, start, stored)


def _dtype_of(stored: "h5py.h5d.DatasetID") -> "np.dtype[np.generic]":
    """Return the type of a dataset; h5py makes it anew each time, which takes longer than to compare it."""
    import h5py  # noqa: PLC0415

    kind = stored.get_type()
    if kind.equal(h5py.h5t.IEEE_F32LE):
        return _FLOAT
    return _DOUBLE if kind.equal(h5py.h5t.IEEE_F64LE) else stored.dtype


def _dataset_in(group: "h5py.h5g.GroupID", name: str, place: str) -> "h5py.h5d.DatasetID":
    """Return a dataset that really lies in this group, as :func:`member` does, in a tenth of its time."""
    import h5py  # noqa: PLC0415

    encoded, links = name.encode(), group.links
    if links.exists(encoded) and links.get_info(encoded).type == h5py.h5l.TYPE_HARD:
        opened = h5py.h5o.open(group, encoded)
        if isinstance(opened, h5py.h5d.DatasetID):
            return opened
    return member(h5py.Group(group), name, "Dataset", place).id  # or the sentence that says what it is


def require_readable(dataset: "h5py.Dataset", place: str) -> None:
    """Refuse numbers that are elsewhere, too many, or were announced and never written; nothing is unpacked yet."""
    _require_readable(dataset.id, dataset.shape, dataset.dtype, place)


def _require_readable(
    stored: "h5py.h5d.DatasetID", shape: tuple[int, ...], dtype: "np.dtype[np.generic]", place: str
) -> None:
    import h5py  # noqa: PLC0415

    settings, size = stored.get_create_plist(), math.prod(shape)
    layout = settings.get_layout()
    if layout == h5py.h5d.VIRTUAL or settings.get_external_count():
        raise RecordingFormatError(f"{place}: expected numbers inside the file; they are stored in another one")
    require_plausible_length(size, place)
    n_bytes = size * dtype.itemsize
    if n_bytes > FREE_BYTES:
        require_plausible_expansion(n_bytes, h5py.h5i.get_file_id(stored).get_filesize(), place)
    if layout == h5py.h5d.CHUNKED:
        per_axis = (-(-length // part) for length, part in zip(shape, settings.get_chunk(), strict=True))
        unwritten = stored.get_num_chunks() < math.prod(per_axis)
    else:
        unwritten = stored.get_storage_size() < n_bytes
    if unwritten:  # HDF5 answers fill values for them
        raise RecordingFormatError(f"{place}: expected {size} numbers; they were announced but never written")


def values_of(dataset: "h5py.Dataset") -> npt.NDArray[np.number]:
    """Read a dataset, in the byte order of this machine; the array cannot be written to."""
    return _values(dataset.id, dataset.shape, dataset.dtype)


def _values(
    stored: "h5py.h5d.DatasetID", shape: tuple[int, ...], dtype: "np.dtype[np.generic]"
) -> npt.NDArray[np.number]:
    import h5py  # noqa: PLC0415

    values: npt.NDArray[np.number] = np.zeros(shape, dtype.newbyteorder("="))
    if values.size:
        stored.read(h5py.h5s.ALL, h5py.h5s.ALL, values, type_in_memory(values.dtype.str, None))
    values.setflags(write=False)  # ours alone: a record need not copy it
    return values


def write_attributes(group: "h5py.Group", stated: Mapping[str, object]) -> None:
    """Write attributes; None means: not stated."""
    group.attrs.update({name: value for name, value in stated.items() if value is not None})
