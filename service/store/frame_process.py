"""The process that writes small frames, for the service that starts it (:mod:`service.store.frame_writer`).

It ends when the other end of its socket is closed, as the system does when the service ends, however that comes.
"""

import errno
import mmap
import os
import signal
import socket
import sys
from io import FileIO

from service.store.frame_writer import ANSWER, MOST_BYTES, PLACES, REQUEST
from service.store.waveform_files import compressed_at_once, give_back_cache, write_all


def main() -> None:
    """Write one frame after another, in the order in which they are handed over."""
    # What ends a service is often sent to all its processes: the service ends this one, when nothing more is to come.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    service = socket.socket(fileno=int(sys.argv[1]))
    contents = memoryview(mmap.mmap(int(sys.argv[2]), PLACES * MOST_BYTES))
    while True:
        request, files, _, _ = socket.recv_fds(service, REQUEST.size, 1)
        if not request:
            return
        place, size = REQUEST.unpack(request)
        content = contents[place * MOST_BYTES :][:size]
        service.sendall(ANSWER.pack(place, _append(files[0], content)))


def _append(descriptor: int, content: memoryview) -> int:
    """Append a frame to an open file and close it here; return the number of the error, 0 if there is none."""
    try:
        with FileIO(descriptor, "a") as file:
            write_all(file, compressed_at_once(content))
            give_back_cache(file)
            os.fsync(descriptor)
            give_back_cache(file)
    except OSError as error:
        return error.errno or errno.EIO
    return 0


if __name__ == "__main__":
    main()
