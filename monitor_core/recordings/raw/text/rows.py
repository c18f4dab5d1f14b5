"""Read the rows of a text file in blocks, so that a large file never stands in memory as text."""

import codecs
import csv
from collections.abc import Iterator, Sequence
from pathlib import Path

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.elements.files import require_file, utf16_codec

#: Characters read at a time; a row may be as long.
BLOCK = 2**20
_CODECS = {"utf-8": "utf-8-sig", "latin-1": "latin-1", "utf-16": "utf-16"}
_HEAD = 2**16  # of it the order of bytes shows
_MOST_SHOWN = 60
_MOST_LISTED = 12
_ENCODING_NAMES = {"utf-8": "UTF-8", "latin-1": "Latin-1", "utf-16": "UTF-16"}


class Rows:
    """The rows of a text file from the first to the last, counted from 1; line ends may be of any kind."""

    def __init__(self, path: Path, encoding: str = "utf-8") -> None:
        """Begin at the first row; ``encoding`` is one of ``[text]``."""
        self.file_name = path.name
        self._blocks = _blocks(path, encoding)
        self._next: list[str] = []
        self._at = 0
        self._row = 1

    @property
    def row(self) -> int:
        """Number of the row that comes next."""
        return self._row

    def take(self) -> str | None:
        """Return the next row, or ``None`` at the end of the file."""
        if self._at >= len(self._next):
            self._next, self._at = next(self._blocks, []), 0
            if not self._next:
                return None
        line = self._next[self._at]
        self._at += 1
        self._row += 1
        return line

    def ahead(self, most: int) -> list[str]:
        """Return the rows that come next, as many as are at hand, without taking them."""
        while len(self._next) - self._at < most:
            block = next(self._blocks, [])
            if not block:
                break
            self._next, self._at = self._next[self._at :] + block, 0
        return self._next[self._at : self._at + most]

    def skip(self, n_rows: int) -> None:
        """Pass over rows that are at hand."""
        self._at += n_rows
        self._row += n_rows

    def at_hand(self) -> list[str]:
        """Return the rows that have been read but not taken, or the next block of them."""
        if self._at >= len(self._next):
            self._next, self._at = next(self._blocks, []), 0
        return self._next[self._at :]

    def blocks(self) -> Iterator[tuple[int, list[str]]]:
        """Take all rows that are left: number of the first of a block, and the block."""
        while True:
            lines, self._next, self._at = self._next[self._at :], [], 0
            lines = lines or next(self._blocks, [])
            if not lines:
                return
            first, self._row = self._row, self._row + len(lines)
            yield first, lines


def _blocks(path: Path, encoding: str) -> Iterator[list[str]]:
    require_file(path)
    rest = ""
    try:
        with path.open(encoding=_codec(path, encoding)) as stream:
            while block := stream.read(BLOCK):
                lines = (rest + block).split("\n")
                rest = lines.pop()
                if len(rest) > BLOCK:
                    raise RecordingFormatError(
                        f"{path.name}: expected rows of at most {BLOCK} characters; got a longer one"
                    )
                if lines:
                    yield lines
    except UnicodeError:
        raise RecordingFormatError(_not_decodable(path, encoding)) from None
    if rest:
        yield [rest]


def _codec(path: Path, encoding: str) -> str:
    if encoding != "utf-16":
        return _CODECS[encoding]
    with path.open("rb") as stream:
        return utf16_codec(stream.read(_HEAD)) or "utf-16"


def _not_decodable(path: Path, encoding: str) -> str:
    decoder = codecs.getincrementaldecoder(_codec(path, encoding))()
    at, name = 0, _ENCODING_NAMES[encoding]
    with path.open("rb") as stream:
        while True:
            content = stream.read(BLOCK)
            waiting = len(decoder.getstate()[0])
            try:
                decoder.decode(content, final=not content)
            except UnicodeDecodeError as error:
                return (f"{path.name}: expected {name} text; byte {at - waiting + error.start} is "
                        f"{error.object[error.start]:#04x}")  # fmt: skip
            except UnicodeError:
                break
            if not content:
                break
            at += len(content)
    return f"{path.name}: expected {name} text; it has no byte order mark"


def shown(text: str) -> str:
    """Return a text of a file as a message shows it: its beginning, in quotes, without control characters."""
    return repr(text if len(text) <= _MOST_SHOWN else f"{text[: _MOST_SHOWN - 1]}…")


def shown_list(texts: Sequence[str]) -> str:
    """Return the first of some texts of a file as a message shows them."""
    return ", ".join(shown(text) for text in texts[:_MOST_LISTED]) + (", …" if len(texts) > _MOST_LISTED else "")


def split_cells(line: str, separator: str | None, *, quotes: bool = True) -> list[str]:
    """Return the cells of a row without the blanks around them; cells in quotes lose these, and may hold separators."""
    if quotes and '"' in line:
        if separator is None:
            line, separator = " ".join(line.split()), " "
        try:
            cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True), [])
        except csv.Error:
            cells = line.split(separator)
    else:
        cells = line.split(separator)
    return [cell.strip() for cell in cells]
