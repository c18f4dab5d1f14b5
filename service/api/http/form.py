"""Parse a multipart form as it arrives: the parts of its files go to the disk, and nothing of them is kept."""

from typing import Protocol

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, MultipartState, parse_options_header

from service.errors import UnreadableBodyError, UnsupportedContentError

FORM_TYPE = "multipart/form-data"
#: More parts than files may be sent end here; the headers of a part are bounded by the parser.
MOST_PARTS = 1000


class Parts(Protocol):
    """Takes the parts of a form, one after the other."""

    def begin_part(self, name: str, file_name: str | None) -> None:
        """Begin a part: the name of its field, and that of its file if it is one."""

    def write(self, data: bytes) -> None:
        """Take the next bytes of the part."""

    def end_part(self) -> None:
        """End the part."""


def boundary_of(content_type: str | None) -> bytes:
    """Return what stands between the parts of a form; raises UnsupportedContentError if the body is no form."""
    try:
        kind, options = parse_options_header(content_type)
    except ValueError:  # a name beyond Latin-1
        kind, options = b"", {}
    boundary = options.get(b"boundary", b"")
    if kind != FORM_TYPE.encode() or not 0 < len(boundary) <= 70:  # RFC 2046, 5.1.1
        got = (content_type or "none").partition(";")[0].strip()[:100]
        raise UnsupportedContentError(
            f"Content-Type must be {FORM_TYPE} with a boundary of 1 to 70 characters; got {got or 'none'}"
        )
    return boundary


class FormReader:
    """Parses a form, and hands its parts over."""

    def __init__(self, boundary: bytes, parts: Parts) -> None:
        self._parts = parts
        self._n_parts = 0
        self._name, self._value = bytearray(), bytearray()  # of the header that is being read
        self._disposition: bytes | None = None
        self._parser = MultipartParser(
            boundary,
            {
                "on_part_begin": self._begin,
                "on_header_field": lambda data, start, end: self._name.extend(data[start:end]),
                "on_header_value": lambda data, start, end: self._value.extend(data[start:end]),
                "on_header_end": self._end_header,
                "on_headers_finished": self._end_headers,
                "on_part_data": lambda data, start, end: parts.write(data[start:end]),
                "on_part_end": parts.end_part,
            },
        )

    def feed(self, data: bytes) -> None:
        """Parse the next bytes.

        Raises UnreadableBodyError if these are no form, and what the parts raise.
        """
        try:
            self._parser.write(data)
        except FormParserError as error:
            raise UnreadableBodyError(f"the body is no {FORM_TYPE}: {error}") from error

    def end(self) -> None:
        """Say that nothing more comes; raises UnreadableBodyError if the form is not complete."""
        if self._parser.state != MultipartState.END:
            raise UnreadableBodyError(f"the body is no whole {FORM_TYPE}: it ends before its last boundary")

    def _begin(self) -> None:
        self._n_parts += 1
        if self._n_parts > MOST_PARTS:
            raise UnreadableBodyError(f"a form may have {MOST_PARTS} parts; got more")
        self._disposition = None

    def _end_header(self) -> None:
        if bytes(self._name).lower() == b"content-disposition":
            self._disposition = bytes(self._value)
        self._name.clear()
        self._value.clear()

    def _end_headers(self) -> None:
        _, options = parse_options_header(self._disposition)
        if b"name" not in options:
            raise UnreadableBodyError("expected a Content-Disposition with a name in each part of the form; got none")
        file_name = options.get(b"filename")
        try:
            self._parts.begin_part(options[b"name"].decode(), None if file_name is None else file_name.decode())
        except UnicodeDecodeError as error:
            raise UnreadableBodyError("expected names in UTF-8 in the form; got others") from error
