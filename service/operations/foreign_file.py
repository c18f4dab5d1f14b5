"""Read files that are not ours in a process of their own, from the command line as in the service.

The libraries behind the formats are not ours either. A file that makes one of them end its process, run for ever or ask
for all the memory there is ends that process, and nothing else: it becomes one sentence. Foreign is every raw format,
and HDF5 of ours, too, which anybody may have written or damaged since.
"""

import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast

from monitor_core.errors import MissingReaderError, RecordingFormatError
from monitor_core.recordings.recognition import require_format
from service.errors import BusyError
from service.operations.own_process import (
    Bounds,
    Line,
    OwnProcess,
    ProcessEndedError,
    ProcessStalledError,
)

# most commands read a file, and few of them a session
if TYPE_CHECKING:
    from monitor_core.recording import Window
    from monitor_core.session import RecordedMeasurements

Answer = TypeVar("Answer")

#: Bounds of the readers keep what is read below 1 GiB of samples, which are held up to three times on the way. A table
#: of a GiB, the largest there is to read, takes four minutes.
BOUNDS = Bounds(memory_bytes=2**32, seconds=900.0)


def read_foreign(work: Callable[[], Answer], name: str) -> Answer:
    """Do work that reads a foreign file, and return what it returns; raises as :func:`reading`, and what it raises."""
    with reading(partial(_without_line, work), name) as process:
        return cast(Answer, process.answer())


def _without_line(work: Callable[[], object], _: Line) -> object:
    return work()


@contextmanager
def reading(work: Callable[[Line], object], name: str) -> Iterator[OwnProcess]:
    """Begin work that reads a foreign file; its answer is asked for inside the ``with`` block.

    ``work`` can be pickled; ``name``: of the file, for messages. ``RecordingFormatError`` if the process ends before it
    answers, or takes more than it may; ``BusyError`` if it does not begin.
    """
    bounds = BOUNDS
    try:
        with OwnProcess(partial(_read, work, name, bounds), bounds) as process:
            yield process
    except ProcessEndedError as error:
        if not error.has_begun:
            raise BusyError(
                f"{name}: expected a process to read it in; it ended before it began, {error.ending}: for "
                "want of memory, or because a program that uses this one has no `if __name__ == '__main__':`"
            ) from error
        raise RecordingFormatError(
            f"{name}: expected a recording that can be read; reading it ended the process that did, "
            f"{error.ending}: it is damaged, or too large for this machine"
        ) from error
    except ProcessStalledError as error:
        raise RecordingFormatError(
            f"{name}: expected a recording that is read within {bounds.seconds / 60.0:g} minutes; this one was not: it "
            "is damaged, or too large: cut it into several"
        ) from error


def foreign_format(path: Path, *expected: str) -> str:
    """Return the format of a file if it is one of those expected; raises as ``require_format``."""
    return read_foreign(partial(require_format, path, *expected), path.name)


@contextmanager
def foreign_session(path: Path) -> Iterator["RecordedMeasurements"]:
    """Open a session whose windows are read in a process of its own, a measurement at a time; raises as it is read."""
    with reading(partial(_give_windows, path), path.name) as process:
        yield _Session(process, cast(tuple[str, ...], process.answer()))


@dataclass(frozen=True, slots=True)
class _Session:
    """A session that is read elsewhere."""

    process: OwnProcess
    measurements: tuple[str, ...]

    def windows_of(self, measurement: str) -> "tuple[Window, ...]":
        self.process.send(measurement)
        return cast("tuple[Window, ...]", self.process.answer())


def _give_windows(path: Path, line: Line) -> None:
    from monitor_core.recordings.session_hdf5 import open_session  # noqa: PLC0415

    with open_session(path) as session, suppress(EOFError):  # nobody asks any more
        line.send(session.measurements)
        while True:
            line.send(session.windows_of(cast(str, line.receive())))


def _read(work: Callable[[Line], object], name: str, bounds: Bounds, line: Line) -> object:
    try:
        return work(line)
    except MemoryError as error:
        limits = [limit for limit in resource.getrlimit(resource.RLIMIT_DATA) if limit != resource.RLIM_INFINITY]
        most = min([bounds.memory_bytes, *limits])  # a shell may allow less
        raise RecordingFormatError(
            f"{name}: expected a recording that is read in {most >> 20} MiB of memory; this one takes more: it is "
            "damaged, or too large: cut it into several"
        ) from error
    except ImportError as error:
        raise MissingReaderError(f"{name}: expected the library that reads it; it cannot be loaded: {error}") from error
