"""The process that writes small frames, for the service that starts it (:mod:`service.store.frame_writer`).

It ends when the other end of its socket is closed, as the system does when the service ends, however that comes.
"""

import errno
import mmap
import socket
import sys
from contextlib import suppress
from io import FileIO

from service.store.frame_writer import ANSWER, REQUEST
from service.store.waveform_files import compressed_at_once, give_back_cache, sync_file, write_all


def main() -> None:
    """Write one frame after another, in the order in which they are handed over."""
    service = socket.socket(fileno=int(sys.argv[1]))
    contents = memoryview(mmap.mmap(int(sys.argv[2]), 0))
    with suppress(ConnectionError):  # nobody is left to be told
        while True:
            request, files, _, _ = socket.recv_fds(service, REQUEST.size, 1)
            if not request:
                return
            begin, size = REQUEST.unpack(request)
            service.sendall(ANSWER.pack(begin, _write(files[0], contents[begin : begin + size])))


def _write(descriptor: int, content: memoryview) -> int:
    """Write a frame where an open file stands, and close it here; return the number of the error, 0 for none."""
    try:
        with FileIO(descriptor, "r+") as file:  # the service opened it, and tells where the frame begins
            write_all(file, compressed_at_once(content))
            give_back_cache(file)
            sync_file(file)
    except OSError as error:
        return error.errno or errno.EIO
    return 0


if __name__ == "__main__":
    main()
