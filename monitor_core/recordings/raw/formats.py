"""Find the reader of a raw file by what it holds."""

from collections.abc import Callable
from pathlib import Path

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.raw.binary import hdf5, mat, mdf4, npz, parquet, tdms, uff58, wav, xlsx
from monitor_core.recordings.raw.channels import Channels
from monitor_core.recordings.raw.text import columns, lvm
from monitor_core.recordings.raw.text.layout import TextLayout
from monitor_core.recordings.recognition import raw_ending

#: Ending of the file name → reader of its channels.
READERS: dict[str, Callable[..., Channels]] = {
    ".tdms": tdms.read_channels,
    ".uff": uff58.read_channels,
    ".unv": uff58.read_channels,
    ".mat": mat.read_channels,
    ".h5": hdf5.read_channels,
    ".hdf5": hdf5.read_channels,
    ".npz": npz.read_channels,
    ".npy": npz.read_channels,
    ".wav": wav.read_channels,
    ".mf4": mdf4.read_channels,
    ".mdf": mdf4.read_channels,
    ".parquet": parquet.read_channels,
    ".pq": parquet.read_channels,
    ".xlsx": xlsx.read_channels,
    ".xlsm": xlsx.read_channels,
    ".csv": columns.read_channels,
    ".tsv": columns.read_channels,
    ".txt": columns.read_channels,
    ".lvm": lvm.read_channels,
}
#: Readers that take a layout, ``[text]`` of a channel map.
READERS_WITH_LAYOUT: dict[str, Callable[[Path, TextLayout | None], Channels]] = {
    ".csv": columns.read_channels,
    ".tsv": columns.read_channels,
    ".txt": columns.read_channels,
    ".lvm": lvm.read_channels,
    ".xlsx": xlsx.read_channels,
    ".xlsm": xlsx.read_channels,
}


def read_channels(path: Path, layout: TextLayout | None = None) -> Channels:
    """Read the channels of a raw file by what it holds; only texts are told from each other by the ending of the name.

    ``layout`` is how a text file is written, where it is not plain.
    ``RecordingFormatError`` if the file is no raw file, or damaged; the sentence says what it is and the next step.
    """
    ending = raw_ending(path, READERS)
    if layout is None:
        return READERS[ending](path)
    if ending not in READERS_WITH_LAYOUT:
        raise RecordingFormatError(
            f"{path.name}: expected no table [text] in the map of a file that says how it is written"
        )
    return READERS_WITH_LAYOUT[ending](path, layout)
