"""Take the numbers of HDF5 files, each dataset looked at before it is unpacked.

Virtual datasets and external storage are refused: a recording is one file. Numbers that were announced and never
written are refused too, since HDF5 answers zeros for them.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.bounds import FREE_BYTES, require_plausible_expansion, unpacked_size
from monitor_core.recordings.elements.files import require_plausible_length
from monitor_core.recordings.elements.hdf5 import member, text_of, type_in_memory

if TYPE_CHECKING:
    import h5py

#: Filters of HDF5 that are known to stay within their chunk, or are looked at before.
_DEFLATE, _SHUFFLE, _CHECKSUM, _LZF = 1, 2, 3, 32000
_FILTERS = frozenset((_DEFLATE, _SHUFFLE, _CHECKSUM, _LZF))
_LARGEST_LZF_CHUNK = 2**22  # unpacked by the library without a look at its size, which is at most ninety times that
_FLOAT, _DOUBLE = np.dtype("<f4"), np.dtype("<f8")


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """A one-dimensional dataset that was looked at; its numbers are not read yet."""

    size: int
    dtype: "np.dtype[np.generic]"
    start: int | None  # its first byte in the file, where its numbers lie there as they are, one after the other
    stored: "h5py.h5d.DatasetID"

    def values(self) -> npt.NDArray[np.number]:
        """Read the numbers, as :func:`values_of`."""
        return _values(self.stored, self.stored.get_create_plist(), (self.size,), self.dtype)


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
        _require_readable(stored, stored.get_create_plist(), shape, dtype, place)
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
    _require_readable(dataset.id, dataset.id.get_create_plist(), dataset.shape, dataset.dtype, place)


def _require_readable(
    stored: "h5py.h5d.DatasetID",
    settings: "h5py.h5p.PropDCID",
    shape: tuple[int, ...],
    dtype: "np.dtype[np.generic]",
    place: str,
) -> None:
    import h5py  # noqa: PLC0415

    layout, size = settings.get_layout(), math.prod(shape)
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
    """Read a dataset, in the byte order of this machine; the array cannot be written to.

    ``RecordingFormatError`` if a packed chunk becomes more than it says: the library would unpack it all the same.
    """
    return _values(dataset.id, dataset.id.get_create_plist(), dataset.shape, dataset.dtype)


def _values(
    stored: "h5py.h5d.DatasetID", settings: "h5py.h5p.PropDCID", shape: tuple[int, ...], dtype: "np.dtype[np.generic]"
) -> npt.NDArray[np.number]:
    import h5py  # noqa: PLC0415

    values: npt.NDArray[np.number] = np.zeros(shape, dtype.newbyteorder("="))
    if values.size:
        if settings.get_layout() == h5py.h5d.CHUNKED:
            _require_sound_chunks(stored, settings, values)
        stored.read(h5py.h5s.ALL, h5py.h5s.ALL, values, type_in_memory(values.dtype.str, None))
    values.setflags(write=False)  # ours alone: a record need not copy it
    return values


def _require_sound_chunks(
    stored: "h5py.h5d.DatasetID", settings: "h5py.h5p.PropDCID", values: npt.NDArray[np.number]
) -> None:
    """Look at the chunks before they are unpacked into an array."""
    import h5py  # noqa: PLC0415

    file = text_of(h5py.h5i.get_file_id(stored).name)
    place = f"{Path(file).name} {text_of(h5py.h5i.get_name(stored) or b'')}"
    size = math.prod(settings.get_chunk()) * values.itemsize
    if size > max(FREE_BYTES, values.nbytes):
        raise RecordingFormatError(f"{place}: expected chunks of at most {FREE_BYTES} bytes; got {size}")
    filters = [settings.get_filter(i)[0] for i in range(settings.get_nfilters())]
    if not _FILTERS.issuperset(filters) or len(set(filters)) < len(filters):
        raise RecordingFormatError(
            f"{place}: expected samples packed by gzip or lzf, or not packed; got HDF5 filters {filters}"
        )
    if _LZF in filters and size > _LARGEST_LZF_CHUNK:
        raise RecordingFormatError(
            f"{place}: expected lzf chunks of at most {_LARGEST_LZF_CHUNK} bytes; got {size}: pack it by gzip"
        )
    least = 5 if _CHECKSUM in filters else 1  # of fewer bytes the library takes the checksum off all the same
    for chunk in _stored_chunks(stored) if filters else ():
        if chunk.size < least:
            raise RecordingFormatError(f"{place}: expected packed chunks of samples; got one of {chunk.size} bytes")
        if _DEFLATE in filters:
            _require_sound_chunk(stored, chunk, filters, size, place)


def _stored_chunks(dataset: "h5py.h5d.DatasetID") -> list["h5py.h5d.StoreInfo"]:
    chunks: list[h5py.h5d.StoreInfo] = []
    dataset.chunk_iter(chunks.append)
    return chunks


def _require_sound_chunk(
    dataset: "h5py.h5d.DatasetID", stored: "h5py.h5d.StoreInfo", filters: list[int], size: int, place: str
) -> None:
    """Unpack a chunk piece by piece, and refuse it if it becomes more than it says. ``size``: of a chunk [bytes]."""
    position = filters.index(_DEFLATE)
    if stored.filter_mask >> position & 1:  # was left as it is
        return
    # gzip never adds more than this; a checksum takes four bytes
    if stored.size > size + size // 1000 + 64:
        raise RecordingFormatError(f"{place}: expected a chunk of {size} bytes to be packed; it takes {stored.size}")
    _, packed = dataset.read_direct_chunk(stored.chunk_offset)
    checksum = _CHECKSUM in filters
    most = size + (4 if checksum and filters.index(_CHECKSUM) < position else 0)
    if unpacked_size(packed, most) > most:
        raise RecordingFormatError(f"{place}: expected a chunk of {size} bytes; its packed samples become more")
