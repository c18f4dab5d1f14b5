"""Find the reader of a raw file by what it holds."""

from collections.abc import Callable
from pathlib import Path

from monitor_core.recordings.raw import csv_samples, mat, npz, tdms, uff58
from monitor_core.recordings.raw.channels import Channels
from monitor_core.recordings.recognition import raw_ending

#: Ending of the file name → reader of its channels.
READERS: dict[str, Callable[..., Channels]] = {
    ".tdms": tdms.read_channels,
    ".uff": uff58.read_channels,
    ".unv": uff58.read_channels,
    ".mat": mat.read_channels,
    ".npz": npz.read_channels,
    ".csv": csv_samples.read_channels,
    ".tsv": csv_samples.read_channels,
    ".txt": csv_samples.read_channels,
}


def read_channels(path: Path, layout: object | None = None) -> Channels:
    """Read the channels of a raw file by what it holds; only texts are told from each other by the ending of the name.

    ``layout`` is how a text file is written, where it is not plain.
    ``RecordingFormatError`` if the file is no raw file, or damaged; the sentence says what it is and the next step.
    """
    reader = READERS[raw_ending(path, READERS)]
    return reader(path) if layout is None else reader(path, layout)
