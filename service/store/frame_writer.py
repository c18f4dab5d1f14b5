"""Have small frames compressed, written to their files and synced by a process of its own, while this one computes.

Threads do not help there: after each step a thread waits until another one lets go of the interpreter. To the process
content goes through memory that both share, and the open file through a socket; back comes what the disk said.
"""

import errno
import logging
import mmap
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from io import FileIO
from pathlib import Path
from struct import Struct

log = logging.getLogger(__name__)

#: A larger content takes longer to hash than to compress and write: a thread does all three.
MOST_BYTES = 512 * 1024
#: So many are under way at once, as many as requests are taken at once.
PLACES = 32
#: Where in the shared memory a content begins, and how many bytes it takes; with it comes the file.
REQUEST = Struct("<QQ")
#: Where the content began that was written, and the number of the error, 0 if there was none.
ANSWER = Struct("<QQ")


class FrameWriter:
    """Starts the process with the first frame. Without it, or when it has ended by itself, whoever asks writes."""

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._process: _FrameProcess | None = None
        self._starts = True

    def take(self, file: FileIO, content: Callable[[], Iterable[bytes | memoryview]]) -> "HandedOver | None":
        """Begin to write content, as one compressed frame, where a file stands.

        None: it is left to whoever asks, and nothing was written.
        """
        process = self._at_hand()
        if process is None:
            return None
        parts = list(content())
        return process.take(file, parts) if sum(map(len, parts)) <= MOST_BYTES else None

    def close(self) -> None:
        """Let the process finish what it has, and end; what comes afterwards is left to whoever asks."""
        with self._guard:
            process, self._process, self._starts = self._process, None, False
        if process is not None:
            process.close()

    def _at_hand(self) -> "_FrameProcess | None":
        with self._guard:
            if self._starts:
                self._starts = False
                try:
                    self._process = _FrameProcess()
                except OSError as error:
                    log.error("the process that writes waveforms cannot be started (%s): the service does it", error)
            return None if self._process is None or self._process.has_ended else self._process


class HandedOver:
    """A frame that the process has to write."""

    def __init__(self, process: "_FrameProcess", place: int) -> None:
        self._process = process
        self._place = place
        self._error: int | None = None  # not known before it was waited for

    def wait(self) -> None:
        """Wait until it is on disk. Raises OSError if it is not; nobody writes it any more then."""
        if self._error is None:
            self._error = self._process.error_at(self._place)
        if self._error == _ENDED:
            raise OSError(errno.EIO, "the process that writes them has ended")
        if self._error:
            raise OSError(self._error, os.strerror(self._error))


#: Stands for the number of an error.
_ENDED = -1


class _FrameProcess:
    """The process (:mod:`service.store.frame_process`), and the memory that is shared with it."""

    def __init__(self) -> None:
        self.has_ended = False
        self._free = list(range(0, PLACES * MOST_BYTES, MOST_BYTES))  # the last one is in the cache of the processor
        self._errors: dict[int, int] = {}  # that were answered, by place
        self._answers = threading.Lock()
        with ExitStack() as both, ExitStack() as ours:
            self._socket, theirs = socket.socketpair()
            ours.callback(self._socket.close)
            both.callback(theirs.close)
            shared = os.memfd_create("frames")
            both.callback(os.close, shared)
            # What there is no room for is refused here, and not where it is used.
            os.posix_fallocate(shared, 0, PLACES * MOST_BYTES)
            self._memory = mmap.mmap(shared, 0)
            ours.callback(self._memory.close)
            self._process = _started(theirs.fileno(), shared)
            self._kept = ours.pop_all()

    def take(self, file: FileIO, parts: Iterable[bytes | memoryview]) -> HandedOver | None:
        try:
            place = self._free.pop()
        except IndexError:
            return None
        end = place
        for part in parts:
            self._memory[end : end + len(part)] = part
            end += len(part)
        try:
            socket.send_fds(self._socket, [REQUEST.pack(place, end - place)], [file.fileno()])
        except OSError as error:
            self._free.append(place)
            if isinstance(error, ConnectionError):
                self._note_end()
            return None
        return HandedOver(self, place)

    def error_at(self, place: int) -> int:
        """Wait until what lies in a place is written or never will be; return the number of the error, 0 for none."""
        with self._answers:
            while place not in self._errors:
                if not self._is_answered():
                    self._note_end()
                    return _ENDED
            self._free.append(place)
            return self._errors.pop(place)

    def close(self) -> None:
        with suppress(OSError):  # it may have ended
            self._socket.shutdown(socket.SHUT_WR)  # nothing follows: it answers what it has, and ends
        with self._answers:
            while self._is_answered():
                pass
            self.has_ended = True
            self._kept.close()
        self._process.wait()

    def _is_answered(self) -> bool:
        """Take the next answer; False: none comes any more."""
        try:
            answer = b"" if self.has_ended else self._socket.recv(ANSWER.size, socket.MSG_WAITALL)
        except ConnectionError:  # it had not read all that it was sent
            answer = b""
        if len(answer) == ANSWER.size:
            place, error = ANSWER.unpack(answer)
            self._errors[place] = error
        return bool(answer)

    def _note_end(self) -> None:
        if not self.has_ended:
            self.has_ended = True
            with suppress(subprocess.TimeoutExpired):  # its socket is closed: it ends at this moment
                self._process.wait(1.0)
            log.error(
                "the process that writes waveforms has ended (exit code %s): the service does it now, more slowly",
                self._process.returncode,
            )


def _started(socket_end: int, memory: int) -> "subprocess.Popen[bytes]":
    """Start the process, of the same program as this one, out of the reach of what ends a service gently.

    That is often sent to all processes of a service, and this one is ended by the service when nothing more is to come.
    """
    # -P: nothing is taken from the folder that the service happens to be started in
    command = [sys.executable, "-P", "-m", "service.store.frame_process", str(socket_end), str(memory)]
    places = [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")]
    # What is blocked here, is so there from the first moment on.
    usual_mask = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    try:
        return subprocess.Popen(  # noqa: S603  # our own
            command,
            pass_fds=(socket_end, memory),
            stdin=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, places))},
        )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, usual_mask)
