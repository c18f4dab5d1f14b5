"""Work in a process of its own: it keeps nothing else waiting, and what it does to its process stays there.

The process can be stopped at any moment, so that cancelled work does not hold up the next.
"""

import ctypes
import logging
import multiprocessing
import os
import pickle
import resource
import signal
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import ForkContext, ForkServerContext
from pathlib import Path
from time import monotonic
from types import TracebackType
from typing import Self, TypeVar, cast

from service.blas_threads import compute_in_one_thread

log = logging.getLogger(__name__)

Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True)
class Progress:
    """How far work has come."""

    done: int
    total: int | None = None  # None: not known
    sentence: str | None = None  # what is being done, in a few words


#: Reports how far work has come.
Report = Callable[[Progress], None]


@dataclass(frozen=True, slots=True)
class Bounds:
    """What a process may take."""

    memory_bytes: int  # beyond what it has when it begins
    seconds: float  # without any progress


#: Where the work of a service comes from. Its processes are forked from one that has read this already: to read it
#: takes two seconds, to fork next to nothing. That one computes nothing and has one thread: there is nothing in it that
#: a fork could break.
READ_BEFORE = [
    "h5py",  # which they load where they need it
    "monitor_core.change",
    "service.operations.alarm_cause",
    "service.operations.calibrating.fit_job",
    "service.operations.discrepancy_job",
    "service.operations.identification_job",
    "service.operations.recordings.file_check",
    "service.operations.recordings.look",
]
_ENDS_WITH_PARENT = 1  # PR_SET_PDEATHSIG of prctl(2)
#: How often whoever waits hears that it still goes on, and may stop it.
REPORTED_EVERY_S = 0.5


class ProcessEndedError(RuntimeError):
    """A process of its own has ended without an answer."""

    def __init__(self, exit_code: int | None, *, has_begun: bool = True) -> None:
        self.ending = _ending(exit_code)
        super().__init__(f"the process of this work has ended, {self.ending}")
        self.has_begun = has_begun  # with its work


def _ending(exit_code: int | None) -> str:
    """Say how a process ended; its exit code is below zero where a signal did it."""
    with suppress(ValueError):  # a number that no signal has
        if exit_code is not None and exit_code < 0:
            return f"by signal {signal.Signals(-exit_code).name}"
    return "by itself" if exit_code is None else f"with exit code {exit_code}"


class EndedAgainError(RuntimeError):
    """Work that was begun anew ended its process once more."""


class ProcessStalledError(RuntimeError):
    """A process of its own has made no progress for as long as it may."""


class Line:
    """One end of the line between a process and whoever started it.

    What is sent can be pickled. Arrays that cannot be written to arrive so.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def send(self, message: object) -> None:
        """Send a message."""
        self._connection.send_bytes(pickle.dumps(message, protocol=5))  # 4 makes every array one that can be written to

    def receive(self) -> object:
        """Wait for a message; EOFError if the other end is gone."""
        return cast(object, pickle.loads(self._connection.recv_bytes()))  # noqa: S301  # of a process of ours

    def has_message(self, within_s: float) -> bool:
        """Wait for a message, or the end of the line, at most so long."""
        return self._connection.poll(within_s)

    def close(self) -> None:
        """Hang up."""
        self._connection.close()


class OwnProcess:
    """A process that works inside the ``with`` block, and is ended with it.

    ``work`` can be pickled and is handed the other end of the line; what it returns or raises is its last message.
    Where this process has one thread it is forked, which takes milliseconds; a fork would break what other threads are
    at, so where there are some it comes from the process that has read the work of a service.
    """

    def __init__(self, work: Callable[[Line], object], bounds: Bounds | None = None) -> None:
        self._bounds = bounds
        compute_in_one_thread()  # the process inherits it
        context: ForkContext | ForkServerContext
        if threading.active_count() == 1:
            context = multiprocessing.get_context("fork")
        else:
            context = multiprocessing.get_context("forkserver")
            context.set_forkserver_preload(READ_BEFORE)
        ours, its = context.Pipe()
        self._line = Line(ours)
        self._process = context.Process(target=_do, args=(Line(its), self._line, work, bounds), daemon=True)
        try:
            self._process.start()
        except (EOFError, ConnectionError) as error:  # the process that it should come from has ended
            raise ProcessEndedError(None, has_begun=False) from error
        finally:
            its.close()  # so that the end of the process is the end of what can be received
        self._has_begun = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None, /
    ) -> None:
        self._process.terminate()
        self._process.join()
        self._line.close()

    def send(self, message: object) -> None:
        """Send a message to the work; ProcessEndedError if the process has ended."""
        try:
            self._line.send(message)
        except OSError as error:
            raise self._ended() from error

    def answer(self, report: Report | None = None, first: Progress | None = None) -> object:
        """Wait for the next message that is no progress, and return it; raise it if it is an error.

        ``report`` is called twice a second with how far the work has come, with ``first`` until it reports its own;
        what it raises ends the waiting. ProcessEndedError if the process ends before it answers; ProcessStalledError if
        it has made no progress for as long as its bounds allow.
        """
        latest, due, progressed_at = first or Progress(0), 0.0, monotonic()
        while True:
            if report is not None and monotonic() >= due:  # progress comes by the hundred: two a second are enough
                report(latest)
                due = monotonic() + REPORTED_EVERY_S
            if self._bounds is not None and monotonic() > progressed_at + self._bounds.seconds:
                raise ProcessStalledError(f"the process made no progress for {self._bounds.seconds:g} s")
            if not self._line.has_message(REPORTED_EVERY_S):
                continue
            progressed_at = monotonic()
            match self._receive():
                case _Begun():
                    self._has_begun = True
                case Progress() as progress:
                    if progress.sentence != latest.sentence:
                        due = 0.0
                    latest = progress
                case Exception() as error:
                    raise error
                case answer:
                    if report is not None:
                        report(latest)
                    return answer

    def _receive(self) -> object:
        try:
            return self._line.receive()
        except (EOFError, OSError) as error:
            raise self._ended() from error

    def _ended(self) -> ProcessEndedError:
        self._process.join()
        return ProcessEndedError(self._process.exitcode, has_begun=self._has_begun)


def in_own_process(work: Callable[[Report], Answer], report: Report, first: Progress) -> Answer:
    """Do work beside this process, and return what it returns; raises what it raises.

    The work can be pickled, as can what it returns, which is no progress; it is handed what it may report its progress
    to. Where something ends its process it is begun anew; EndedAgainError if that ends, too.
    """

    def answer() -> Answer:
        with OwnProcess(Reporting(work)) as process:
            return cast(Answer, process.answer(report, first))

    try:
        return answer()
    except ProcessEndedError as error:
        log.warning("%s; the work is begun anew", error)
    try:
        return answer()
    except ProcessEndedError as error:
        raise EndedAgainError(
            f"the process of this work was ended twice, the second time {error.ending}: most often the system does so "
            "for lack of memory"
        ) from error


@dataclass(frozen=True, slots=True)
class Reporting:
    """Work that says nothing but how far it has come."""

    work: Callable[[Report], object]

    def __call__(self, line: Line) -> object:
        """Do the work, and return its answer."""
        return self.work(line.send)


class _Begun:
    """The first message of a process: what it does from now on is its work."""


def _do(line: Line, other_end: Line, work: Callable[[Line], object], bounds: Bounds | None) -> None:
    """Work in the process, and send the answer last."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the terminal: whoever started it is told, too, and ends it
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    with suppress(AttributeError):  # only Linux ends it, inside a library too, with the process that it comes from
        ctypes.CDLL(None).prctl(_ENDS_WITH_PARENT, signal.SIGKILL)
    other_end.close()  # so that the end of whoever started it is the end of what can be sent
    line.send(_Begun())
    answer: object
    try:
        if bounds is not None:
            _bound(bounds)
        answer = work(line)
    except Exception as error:  # noqa: BLE001 the edge of this process: who started it learns whatever broke
        error.add_note(traceback.format_exc())
        answer = _portable(error)
    line.send(answer)


def _portable(error: Exception) -> Exception:
    """Return an error as it can be sent: as it is, or by its name and text where its class keeps it from being made."""
    try:
        pickle.loads(pickle.dumps(error))  # noqa: S301  # of our own
    except Exception:  # noqa: BLE001 whatever a class of a library makes of it
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def _bound(bounds: Bounds) -> None:
    """Limit the memory of this process, and keep what libraries print of their own end from the terminal."""
    most, allowed = data_bytes() + bounds.memory_bytes, resource.getrlimit(resource.RLIMIT_DATA)
    if all(limit == resource.RLIM_INFINITY or most < limit for limit in allowed):
        resource.setrlimit(resource.RLIMIT_DATA, (most, allowed[1]))
    with Path(os.devnull).open("wb") as nothing:
        os.dup2(nothing.fileno(), 2)


def data_bytes() -> int:
    """Return how much memory this process has for its data; 0 where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5]) * resource.getpagesize()
    except OSError:
        return 0
