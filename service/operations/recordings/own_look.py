"""Look into an uploaded recording in a process of its own.

The libraries behind the formats are not ours. A file that makes one of them end its process, run for ever or ask for
all the memory there is ends that process, and nothing else.
"""

import resource
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

from monitor_core.errors import RecordingFormatError
from service.operations.own_process import ProcessEndedError, Progress, Report, in_own_process
from service.operations.recordings.look import Look

#: Bounds of the readers keep what is read below 1 GiB of samples, which are held up to three times on the way.
MOST_MEMORY_BYTES = 2**32
#: A table of a GiB, the largest there is to read, takes four minutes.
LONGEST_S = 900.0


@dataclass(frozen=True, slots=True)
class LookLimits:
    """What looking into one recording may take."""

    memory_bytes: int = MOST_MEMORY_BYTES
    seconds: float = LONGEST_S


def look_in_own_process(work: Callable[[], Look], name: str, limits: LookLimits) -> Look:
    """Look into a recording, and raise what that raises.

    ``work`` can be pickled; ``name``: of the recording, for messages. ``RecordingFormatError`` if the process ends
    before it answers, or takes more than it may.
    """
    until = time.monotonic() + limits.seconds

    def within_time(_: Progress) -> None:
        if time.monotonic() > until:
            raise RecordingFormatError(
                f"{name}: expected a recording that is read within {limits.seconds / 60.0:g} minutes; this one was "
                "not: cut it into several"
            )

    try:
        return in_own_process(partial(_within_memory, work, limits.memory_bytes), within_time, Progress(0))
    except ProcessEndedError as error:
        raise RecordingFormatError(
            f"{name}: expected a recording that can be read; reading it ended the process that did, "
            f"{_ending(error.exit_code)}: it is damaged, or too large for this machine"
        ) from error
    except MemoryError as error:
        raise RecordingFormatError(
            f"{name}: expected a recording that is read in {limits.memory_bytes >> 20} MiB of memory; this one takes "
            "more: cut it into several"
        ) from error


def _within_memory(work: Callable[[], Look], most_bytes: int, _: Report) -> Look:
    allowed = resource.getrlimit(resource.RLIMIT_DATA)[1]
    if allowed == resource.RLIM_INFINITY or most_bytes < allowed:
        resource.setrlimit(resource.RLIMIT_DATA, (most_bytes, allowed))
    return work()


def _ending(exit_code: int | None) -> str:
    """Say how a process ended."""
    with suppress(ValueError):  # a number that no signal has
        if exit_code is not None and exit_code < 0:
            return f"by signal {signal.Signals(-exit_code).name}"
    return f"with exit code {exit_code}"
