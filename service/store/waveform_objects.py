"""Keep frames of raw waveforms in an S3-compatible store, by s3fs: an object for each frame, durable when it is there.

The names below the prefix are those below the data folder, so that a folder can be copied there and goes on being read.
Address, region and keys of the store come from where its own tools take them: ``AWS_ENDPOINT_URL``,
``AWS_ACCESS_KEY_ID``, ``AWS_SECRET_ACCESS_KEY`` and the like.
"""

import errno
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from service.errors import DataFolderError
from service.store.frame_writer import FrameWriter
from service.store.waveform_files import FOLDER, SUFFIX, Content, FolderFiles, WaveformFiles, read_frame, write_whole

#: Fetched at once: a frame of a few windows as a whole.
_BLOCK_BYTES = 2**20
#: A store that does not answer is given up after some seconds, and whoever sends is asked to send again. One that drips
#: has a byte in time for each wait: a request takes no longer than so in all.
_CONNECT_S, _READ_S, TOTAL_S = 5, 20, 60.0
_PATIENCE = {"connect_timeout": _CONNECT_S, "read_timeout": _READ_S, "retries": {"max_attempts": 2}}


class ObjectFiles:
    """Objects below ``s3://bucket/prefix``."""

    handed_over_bytes = 0  # a store is far away: every frame is written while the caller goes on

    def __init__(self, url: str) -> None:
        try:
            from s3fs import S3FileSystem  # noqa: PLC0415  # an extra
        except ImportError as error:
            raise DataFolderError(f"waveforms in {url} need s3fs; pip install s3fs") from error
        self._root = url.removeprefix("s3://").rstrip("/")
        # Others write there, too: nothing of it is remembered.
        patience = _PATIENCE | {"http_session_cls": _bounded_session()}
        self._store: Any = S3FileSystem(use_listings_cache=False, skip_instance_cache=True, config_kwargs=patience)

    def append(self, axis_id: str, folder: str, content: Content, size: int) -> "_ObjectFrame":
        """Write an object."""
        frame = self.create(f"{folder}/{uuid.uuid4().hex}{SUFFIX}")
        write_whole(frame, content, size)
        return frame

    def read(self, path: str, offset: int) -> bytes:
        """Return the content of a frame."""
        with _as_of_a_disk(), self._store.open(f"{self._root}/{path}", "rb", block_size=_BLOCK_BYTES) as file:
            return read_frame(file, offset)

    def create(self, path: str) -> "_ObjectFrame":
        """Begin an object of this name."""
        with _as_of_a_disk():
            return _ObjectFrame(self, path, self._store.open(f"{self._root}/{path}", "wb"))

    def size(self, path: str) -> int:
        """Return the size of an object [bytes]; 0 if there is none."""
        try:
            with _as_of_a_disk():
                return int(self._store.size(f"{self._root}/{path}"))
        except FileNotFoundError:
            return 0

    def delete(self, path: str) -> None:
        """Delete an object."""
        with _as_of_a_disk(), suppress(FileNotFoundError):
            self._store.rm_file(f"{self._root}/{path}")

    def sizes(self) -> Iterator[tuple[str, int]]:
        """Yield the objects that there are, with their size [bytes]."""
        with _as_of_a_disk():
            objects = self._store.find(f"{self._root}/{FOLDER}", detail=True)
        return ((path.removeprefix(f"{self._root}/"), int(entry["size"])) for path, entry in objects.items())

    def close(self) -> None:
        """Do nothing: there is nothing to end."""


class _ObjectFrame:
    """An object that is sent when it has come to its end; large ones begin before, and are not there until then."""

    offset = 0

    def __init__(self, files: ObjectFiles, path: str, file: Any) -> None:  # noqa: ANN401 - of s3fs, which has no types
        self.path = path
        self._files = files
        self._file = file

    def write(self, part: bytes) -> None:
        with _as_of_a_disk():
            self._file.write(part)

    def end(self) -> None:
        with _as_of_a_disk():
            self._file.close()  # the store answers when it has it durably

    def sync(self) -> None:
        """Do nothing: it is durable since :meth:`end`."""

    def close(self) -> None:
        """Do nothing: it is closed since :meth:`end`."""

    def take_back(self) -> None:
        with suppress(OSError):
            if self._file.closed:
                self._files.delete(self.path)
            else:
                with _as_of_a_disk():
                    self._file.discard()


@contextmanager
def _as_of_a_disk() -> Iterator[None]:
    """Raise what a store or the way to it refuses as OSError."""
    from botocore.exceptions import BotoCoreError, ClientError  # noqa: PLC0415  # comes with s3fs

    try:
        yield
    except (BotoCoreError, ClientError) as error:
        raise OSError(errno.EIO, str(error)) from error


def _bounded_session() -> type:
    """Return the library's own way of HTTP, each request of which ends within a total time, its content included."""
    from aiobotocore.httpsession import AIOHTTPSession  # noqa: PLC0415  # comes with s3fs
    from aiohttp import ClientTimeout  # noqa: PLC0415  # likewise

    class Session(AIOHTTPSession):  # type: ignore[misc]  # the library has no types
        def __init__(self, *arguments: Any, **more: Any) -> None:  # noqa: ANN401 - the library's
            super().__init__(*arguments, **more)
            self._timeout = ClientTimeout(TOTAL_S, sock_connect=_CONNECT_S, sock_read=_READ_S)

    return Session


def files_at(data_dir: Path, url: str | None) -> WaveformFiles:
    """Return the files below a data folder, or those of a store where one is named; raises DataFolderError."""
    return FolderFiles(data_dir, FrameWriter()) if url is None else ObjectFiles(url)
