"""Store JSON in a third of its size, by zstd with a dictionary of what such documents have in common."""

import threading
from pathlib import Path
from typing import Any, Final

import zstandard
from pydantic_core import to_json
from sqlalchemy import JSON
from sqlalchemy.engine import Dialect
from sqlalchemy.types import TypeDecorator, TypeEngine, UserDefinedType

from service.json_types import Json, JsonObject, document_of

#: Begins what is packed with the dictionary below. A dictionary never changes: another one takes another number.
VERSION: Final = b"\x01"
_DICTIONARY: Final = zstandard.ZstdCompressionDict(
    Path(__file__).with_name("measurement_documents.v1.json").read_bytes(), dict_type=zstandard.DICT_TYPE_RAWCONTENT
)
#: Higher ones take longer and win nothing: what is left are digits.
_LEVEL: Final = 1
_LARGEST: Final = 64 * 2**20


class _Packers(threading.local):
    """What packs and unpacks in one thread: neither may be used by two at once."""

    def __init__(self) -> None:
        self.pack = zstandard.ZstdCompressor(level=_LEVEL, dict_data=_DICTIONARY, write_checksum=True).compress
        self.unpack = zstandard.ZstdDecompressor(dict_data=_DICTIONARY).decompress


_OWN: Final = _Packers()


def packed(document: JsonObject) -> bytes:
    """Return a document as it is stored."""
    return VERSION + _OWN.pack(to_json(document))


def unpacked(stored: bytes) -> Json:
    """Return the document that is stored; a text that says why not where it is none, as :func:`document_of` does."""
    version, content = stored[:1], stored[1:]
    if version != VERSION:
        return f"expected a document packed by version {VERSION.hex()}; got {version.hex()}"
    try:
        if zstandard.frame_content_size(content) > _LARGEST:
            return f"expected a document of at most {_LARGEST} bytes; got a larger one"
        return document_of(_OWN.unpack(content).decode())
    except (zstandard.ZstdError, UnicodeDecodeError) as error:
        return f"the packed document is damaged: {error}"


class _AsItIs(UserDefinedType[object]):
    """A column of SQLite that was declared for JSON, and takes texts and bytes alike."""

    cache_ok = True

    def get_col_spec(self, **_: object) -> str:
        return "JSON"


class PackedDocument(TypeDecorator[Any]):
    """A document that SQLite keeps packed; a server packs long values by itself. A text of before is read as it is."""

    impl = JSON
    cache_ok = True

    def load_dialect_impl(self, dialect: Dialect) -> TypeEngine[object]:
        """Return the type of the column."""
        return dialect.type_descriptor(_AsItIs() if dialect.name == "sqlite" else JSON(none_as_null=True))

    def process_bind_param(self, value: JsonObject | None, dialect: Dialect) -> object:
        """Pack a document."""
        return packed(value) if dialect.name == "sqlite" and value is not None else value

    def process_result_value(self, value: Any, dialect: Dialect) -> Json:  # noqa: ANN401 - bytes, a text, or what a server gives
        """Return the document."""
        if isinstance(value, bytes):
            return unpacked(value)
        return document_of(value) if dialect.name == "sqlite" and isinstance(value, str) else value
