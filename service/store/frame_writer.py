"""Have small frames compressed, appended to their files and synced by a process of its own, while this one computes.

Threads do not help there: after each step a thread waits until another one lets go of the interpreter. To the process
content goes through memory that both share, and the open file through a socket; back comes what the disk said.
"""

import errno
import logging
import mmap
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterable
from contextlib import ExitStack
from io import FileIO
from struct import Struct

log = logging.getLogger(__name__)

#: A larger content takes longer to hash than to compress and write: a thread does all three.
MOST_BYTES = 512 * 1024
#: So many are under way at once, as many as requests are taken at once.
PLACES = 32
#: Which place of the memory holds a content, and how many bytes; with it comes the file.
REQUEST = Struct("<II")
#: Which place was written, and the number of the error, 0 if there was none.
ANSWER = Struct("<II")


class FrameWriter:
    """Starts the process with the first frame. Without it, or when it has ended by itself, whoever asks writes."""

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._process: _FrameProcess | None = None
        self._starts = True

    def take(self, file: FileIO, content: Iterable[bytes | memoryview]) -> "HandedOver | None":
        """Begin to append content, as one compressed frame, to a file that stands at its end.

        None: it is left to whoever asks, and nothing was written.
        """
        process, parts = self._at_hand(), list(content)
        if process is None or sum(map(len, parts)) > MOST_BYTES:
            return None
        return process.take(file, parts)

    def close(self) -> None:
        """Let the process finish what it has, and end."""
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
        self._place: int | None = place  # None: it was waited for

    def wait(self) -> None:
        """Wait until it is on disk. Raises OSError, the first time, if it is not; nobody writes there any more then."""
        place, self._place = self._place, None
        if place is not None:
            self._process.wait(place)


class _FrameProcess:
    """The process (:mod:`service.store.frame_process`), and the memory that is shared with it."""

    def __init__(self) -> None:
        self.has_ended = False
        self._free = list(range(PLACES))  # the last that became free is in the cache of the processor
        self._errors: dict[int, int] = {}  # that were answered, by place
        self._answers = threading.Lock()
        with ExitStack() as both, ExitStack() as ours:
            self._socket, theirs = socket.socketpair()
            ours.callback(self._socket.close)
            both.callback(theirs.close)
            shared = os.memfd_create("frames")
            both.callback(os.close, shared)
            os.ftruncate(shared, PLACES * MOST_BYTES)
            self._memory = mmap.mmap(shared, PLACES * MOST_BYTES)
            ours.callback(self._memory.close)
            # -P: nothing is taken from the folder that the service happens to be started in. In a session of its own:
            # who interrupts the service at a terminal lets it finish.
            command = [sys.executable, "-P", "-m", "service.store.frame_process", str(theirs.fileno()), str(shared)]
            self._process = subprocess.Popen(  # noqa: S603  # our own
                command, pass_fds=(theirs.fileno(), shared), stdin=subprocess.DEVNULL, start_new_session=True
            )
            self._kept = ours.pop_all()

    def take(self, file: FileIO, parts: Iterable[bytes | memoryview]) -> HandedOver | None:
        try:
            place = self._free.pop()
        except IndexError:
            return None
        begin = at = place * MOST_BYTES
        for part in parts:
            self._memory[at : at + len(part)] = part
            at += len(part)
        try:
            socket.send_fds(self._socket, [REQUEST.pack(place, at - begin)], [file.fileno()])
        except OSError:
            self._note_end()
            return None
        return HandedOver(self, place)

    def wait(self, place: int) -> None:
        with self._answers:
            while place not in self._errors:
                try:
                    answer = self._socket.recv(ANSWER.size, socket.MSG_WAITALL)
                except ConnectionError:  # it had not read all that it was sent
                    answer = b""
                if len(answer) < ANSWER.size:
                    self._note_end()
                    raise OSError(errno.EIO, "the process that writes them has ended")
                answered, error = ANSWER.unpack(answer)
                self._errors[answered] = error
            error = self._errors.pop(place)
        self._free.append(place)
        if error:
            raise OSError(error, os.strerror(error))

    def close(self) -> None:
        self._kept.close()  # with the socket, which is the end of what it waits for
        self._process.wait()

    def _note_end(self) -> None:
        if not self.has_ended:
            log.error("the process that writes waveforms has ended: from now on the service does it, more slowly")
        self.has_ended = True
