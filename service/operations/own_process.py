"""Long work in a process of its own: it would keep the interpreter from everything that comes in meanwhile.

The process can be stopped at any moment, so that cancelled work does not hold up the next.
"""

import multiprocessing
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import TypeVar, cast

from service.blas_threads import compute_in_one_thread

Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True)
class Progress:
    """How far work has come."""

    done: int
    total: int | None = None  # None: not known
    sentence: str | None = None  # what is being done, in a few words


#: Reports how far work has come.
Report = Callable[[Progress], None]

#: Where the work comes from. Processes are forked from one that has read this already: to read it takes two seconds, to
#: fork next to nothing. That one computes nothing and has one thread: there is nothing in it that a fork could break.
READ_BEFORE = [
    "monitor_core.change",
    "service.operations.alarm_cause",
    "service.operations.discrepancy_job",
    "service.operations.identification_job",
    "service.operations.recordings.file_check",
    "service.operations.recordings.look",
]
#: How often whoever waits hears that it still goes on, and may stop it.
REPORTED_EVERY_S = 0.5


class ProcessEndedError(RuntimeError):
    """A process of its own has ended without an answer."""

    def __init__(self, exit_code: int | None) -> None:
        super().__init__(f"the process of the search ended by itself, exit code {exit_code}")
        self.exit_code = exit_code  # below zero: minus the signal that ended it


def in_own_process(work: Callable[[Report], Answer], report: Report, first: Progress) -> Answer:
    """Do work beside this process, and raise what it raises; ProcessEndedError if the process ends without an answer.

    The work can be pickled, as can what it returns, which is no progress; it is handed what it may report its progress
    to. ``report`` is called twice a second with how far the work has come, with ``first`` until it reports its own;
    what it raises stops the process.
    """
    compute_in_one_thread()  # the process inherits it
    forks = multiprocessing.get_context("forkserver")
    forks.set_forkserver_preload(READ_BEFORE)
    receiver, sender = forks.Pipe(duplex=False)
    process = forks.Process(target=_do, args=(sender, work), daemon=True)
    process.start()
    sender.close()  # so that the end of the process is the end of what can be received
    try:
        return cast(Answer, _answer(receiver, report, first))
    except EOFError as error:
        process.join()
        raise ProcessEndedError(process.exitcode) from error
    finally:
        process.terminate()
        process.join()
        receiver.close()


def _answer(receiver: Connection, report: Report, first: Progress) -> object:
    """Pass on how far the work has come until the answer comes, or the refusal."""
    latest, due = first, 0.0
    while True:
        if time.monotonic() >= due:  # progress comes by the hundred: two a second are enough
            report(latest)
            due = time.monotonic() + REPORTED_EVERY_S
        if not receiver.poll(REPORTED_EVERY_S):
            continue
        match receiver.recv():
            case Progress() as progress:
                if progress.sentence != latest.sentence:
                    due = 0.0
                latest = progress
            case Exception() as error:
                raise error
            case answer:
                report(latest)
                return answer


def _do(sender: Connection, work: Callable[[Report], object]) -> None:
    """Work in the process, and report progress, last the answer."""
    answer: object
    try:
        answer = work(sender.send)
    except Exception as error:  # noqa: BLE001 the edge of this process: who started it learns whatever broke
        error.add_note(traceback.format_exc())
        answer = error
    sender.send(answer)
