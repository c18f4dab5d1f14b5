"""Bound what a raw file may become in memory, from what its headers announce, before any of it is read.

A recording is samples: packed, it seldom shrinks below a tenth. A file that announces far more than it holds is
damaged, or made to exhaust the machine, and is refused by these numbers alone.
"""

from collections.abc import Sequence

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.files import require_plausible_length

#: Most channels of a file.
MAX_CHANNELS = 4096
#: Most samples of all channels of a file: 1 GiB in double precision.
MAX_SAMPLES_IN_ALL = 2**27
#: Bytes that any file may unpack to, however small it is: a constant channel packs to nearly nothing.
FREE_BYTES = 2**26
#: Beyond that, a file unpacks to this many times its own size at most.
MOST_EXPANSION = 16


def require_plausible_channels(announced: Sequence[tuple[str, int]], where: str) -> None:
    """Refuse a file whose headers announce too many channels, too long ones, or too much in all.

    ``announced``: name and number of samples of each channel; ``where``: name of the file, for messages.
    """
    if len(announced) > MAX_CHANNELS:
        raise RecordingFormatError(f"{where}: expected at most {MAX_CHANNELS} channels; got {len(announced)}")
    for name, n_samples in announced:
        require_plausible_length(n_samples, f"{where}, {name}")
    in_all = sum(n_samples for _, n_samples in announced)
    if in_all > MAX_SAMPLES_IN_ALL:
        raise RecordingFormatError(
            f"{where}: expected at most {MAX_SAMPLES_IN_ALL} samples in all channels; its headers announce {in_all}: "
            "cut the recording into several files"
        )


def require_plausible_expansion(n_bytes: int, packed: int, where: str) -> None:
    """Refuse a packed file that would unpack to far more than recordings do.

    ``n_bytes``: what it would unpack to, as its headers announce or as counted so far; ``packed``: size of the file.
    """
    most = max(FREE_BYTES, MOST_EXPANSION * packed)
    if n_bytes > most:
        raise RecordingFormatError(
            f"{where}: expected at most {most} bytes from a file of {packed} bytes; it announces {n_bytes}: "
            "save it without compression"
        )
