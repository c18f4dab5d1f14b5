"""Write the parts of an upload to the disk as they arrive, each within its bound."""

import hashlib
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import FileIO
from pathlib import Path

from service.errors import BodyTooLargeError, InvalidRequestError
from service.store.recordings import ArrivingFolder, not_taken
from service.store.waveform_files import make_folder, write_all

#: Names of the parts: files of a recording, and the map of their channels.
FILE, MAP = "file", "map"
#: Of the map in the folder of a recording.
MAP_NAME = "map.toml"
MOST_FILES = 500
LARGEST_MAP_BYTES = 2**18
#: How often the room on the disk is looked at.
_LOOKED_AT_EVERY = 16 * 2**20
#: Names end up in messages and in measurements. A leading dot hides a file.
_NAME = re.compile(r"[^\x00-\x1f\x7f./\\][^\x00-\x1f\x7f/\\]*")
_LONGEST_NAME_BYTES = 200


@dataclass(frozen=True, slots=True)
class UploadedFile:
    """A file of a recording as it was sent."""

    name: str
    size_bytes: int
    sha256: str


class ClosedError(Exception):
    """The request of an upload has ended; nobody is left to be told."""


class Upload:
    """What arrives of one recording: files below ``folder``/files, a map in ``folder``/map.toml.

    Unless the folder is kept, closing removes all of it.
    """

    def __init__(self, folder: ArrivingFolder, most_bytes: int, require_room: Callable[[int], None]) -> None:
        self.folder = folder
        self.files: list[UploadedFile] = []
        self.map_text: str | None = None
        self.size_bytes = 0
        self._most_bytes = most_bytes
        self._require_room = require_room
        self._looked_at = 0  # bytes that had arrived when the room was looked at
        self._all = hashlib.sha256()
        self._part: _FilePart | _MapPart | None = None
        self._at_work = threading.Lock()
        self._closed = False

    @property
    def sha256(self) -> str:
        """Hash of the bytes of all files, one after the other."""
        return self._all.hexdigest()

    @property
    def paths(self) -> list[Path]:
        """Return the files, in the order in which they were sent."""
        return [self.folder.path / "files" / file.name for file in self.files]

    @property
    def map_path(self) -> Path:
        """Where the map of the channels is, if one was sent."""
        return self.folder.path / MAP_NAME

    def begin_part(self, name: str, file_name: str | None) -> None:
        """Begin a part of the form. Raises InvalidRequestError if it is not one that belongs here, or has no name."""
        if name == FILE:
            self._part = self._begin_file(file_name or "")
        elif name == MAP:
            if self.map_text is not None:
                raise InvalidRequestError(f"expected one part {MAP!r}; got two")
            self._part = _MapPart()
        else:
            raise InvalidRequestError(f"expected parts {FILE!r} (one or more) and {MAP!r}; got one named {name[:50]!r}")

    def write(self, data: bytes) -> None:
        """Take the next bytes of the part. Raises BodyTooLargeError or StorageError."""
        if self._part is None:
            return
        if isinstance(self._part, _FilePart):
            self.size_bytes += len(data)
            if self.size_bytes > self._most_bytes:
                raise BodyTooLargeError(
                    f"a recording may hold {self._most_bytes >> 20} MiB (PRELOAD_MAX_RECORDING_MIB); got more"
                )
            if self.size_bytes - self._looked_at > _LOOKED_AT_EVERY:
                self._looked_at = self.size_bytes
                self._require_room(_LOOKED_AT_EVERY)
            self._all.update(data)
        self._part.write(data)

    def end_part(self) -> None:
        """End the part. A form without a script sends an empty, nameless one where no file was chosen."""
        part, self._part = self._part, None
        if isinstance(part, _FilePart):
            file = part.end()
            if file.name:
                self.files.append(file)
            elif file.size_bytes:
                raise InvalidRequestError(f"expected the name of a file in each part {FILE!r}; got none")
        elif isinstance(part, _MapPart):
            self.map_text = part.end(self.map_path)

    def require_whole(self) -> None:
        """Refuse an upload without a file. Raises InvalidRequestError."""
        if not self.files:
            raise InvalidRequestError(f"expected a part {FILE!r} with a recording; got none")

    @contextmanager
    def at_work(self) -> Iterator[None]:
        """Work on the files: a request may end meanwhile, and then they are not removed before this is done.

        Raises ClosedError if that has happened.
        """
        with self._at_work:
            if self._closed:
                raise ClosedError
            yield

    def close(self) -> None:
        """Close what is open, and remove what is not kept."""
        with self._at_work:
            self._closed = True
            if isinstance(self._part, _FilePart):
                self._part.close()
            self.folder.close()

    def _begin_file(self, file_name: str) -> "_FilePart":
        name = re.split(r"[/\\]", file_name)[-1]  # some browsers send the whole path
        if name and (not _NAME.fullmatch(name) or len(name.encode(errors="replace")) > _LONGEST_NAME_BYTES):
            raise InvalidRequestError(
                f"expected the name of a file, of at most {_LONGEST_NAME_BYTES} bytes, without control characters and "
                f"without a dot in front; got {name[:50]!r}"
            )
        if name in {file.name for file in self.files}:
            raise InvalidRequestError(f"expected files with distinct names; got two named {name!r}")
        if len(self.files) == MOST_FILES:
            raise InvalidRequestError(f"expected at most {MOST_FILES} files; got more")
        return _FilePart(self.folder.path / "files", name)


class _FilePart:
    """A file that arrives."""

    def __init__(self, folder: Path, name: str) -> None:
        self._name = name
        self._size = 0
        self._sha256 = hashlib.sha256()
        try:
            make_folder(folder)
            self._file = FileIO(folder / (name or ".nameless"), "w")
        except (OSError, ValueError) as error:
            raise not_taken(error) from error

    def write(self, data: bytes) -> None:
        try:
            write_all(self._file, data)
        except OSError as error:
            raise not_taken(error) from error
        self._size += len(data)
        self._sha256.update(data)

    def end(self) -> UploadedFile:
        self.close()
        return UploadedFile(self._name, self._size, self._sha256.hexdigest())

    def close(self) -> None:
        self._file.close()


class _MapPart:
    """A map that arrives, as a file or as the text of a field."""

    def __init__(self) -> None:
        self._content = bytearray()

    def write(self, data: bytes) -> None:
        self._content += data
        if len(self._content) > LARGEST_MAP_BYTES:
            raise BodyTooLargeError(f"a channel map may hold {LARGEST_MAP_BYTES} bytes; got more")

    def end(self, path: Path) -> str | None:
        """Return the text; None where nothing was sent."""
        if not self._content.strip():
            return None
        try:
            text = self._content.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise InvalidRequestError(f"expected a channel map in UTF-8; byte {error.start} is no UTF-8") from error
        if "\x00" in text:  # no TOML, and PostgreSQL stores none
            raise InvalidRequestError("expected a channel map in TOML; got one with a zero byte")
        try:
            path.write_bytes(self._content)
        except OSError as error:
            raise not_taken(error) from error
        return text


def write_map(path: Path, text: str) -> None:
    """Write the map of a recording that is kept. Raises InvalidRequestError, BodyTooLargeError or StorageError."""
    part = _MapPart()
    part.write(text.encode(errors="replace"))
    part.end(path)
