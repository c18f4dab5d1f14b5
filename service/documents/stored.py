"""Records that are stored as JSON and read again by a later program: each document states its version.

What cannot be read is refused with a sentence, for the axis that it belongs to; nothing is filled in, since a blank
state would look like an axis about which nothing is known yet.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from pydantic import TypeAdapter, ValidationError

from service.errors import DocumentDamagedError
from service.json_types import JsonObject

Record = TypeVar("Record")

VERSION = "version"
#: Documents that state no version were written when there was no other.
FIRST_VERSION = 1


@dataclass(frozen=True)
class StoredRecord(Generic[Record]):
    """How one kind of record is stored."""

    name: str  # as the sentences call it
    adapter: TypeAdapter[Record]
    version: int  # of the members that are written now
    remedy: str  # what to do about one that cannot be read
    added: frozenset[str] = frozenset()  # members, at any depth, that documents of this version may still lack
    # in place of the adapter, for what JSON does not know
    packed: Callable[[Record], JsonObject] | None = None
    unpacked: Callable[[JsonObject], Record] | None = None

    def dump(self, record: Record) -> JsonObject:
        """Return a record as a document."""
        return {VERSION: self.version, **self._written(record)}

    def is_older(self, document: object) -> bool:
        """Tell whether a document was written by an older version of the program."""
        version = document.get(VERSION, FIRST_VERSION) if isinstance(document, dict) else None
        return isinstance(version, int) and version < self.version

    def load(self, document: object) -> Record:
        """Return the record of a document.

        Raises DocumentDamagedError if it is of another version, or is not what :meth:`dump` writes, to the last member.
        """
        if not isinstance(document, dict):
            raise self._refusal(f"expected a JSON object; got {type(document).__name__}")
        version = document.get(VERSION, FIRST_VERSION)
        if version != self.version:
            raise self._refusal(f"expected version {self.version}; got {version}")
        members = {name: value for name, value in document.items() if name != VERSION}
        try:
            record = self.unpacked(members) if self.unpacked else self.adapter.validate_python(members)
        except ValidationError as error:
            problem = error.errors(include_url=False)[0]
            raise self._refusal(f"at {'/'.join(map(str, problem['loc'])) or 'its root'}: {problem['msg']}") from error
        written = _as_of_before(self._written(record), members, self.added)
        if written != members and _members(written) != _members(members):  # alike, as a rule
            raise self._refusal(f"it has other members than version {self.version} has")
        return record

    def _written(self, record: Record) -> JsonObject:
        if self.packed is not None:
            return self.packed(record)
        document: JsonObject = self.adapter.dump_python(record, mode="json")
        return document

    def _refusal(self, reason: str) -> DocumentDamagedError:
        return DocumentDamagedError(f"the stored {self.name} of this axis cannot be read: {reason}; {self.remedy}")


def _as_of_before(written: object, members: object, added: frozenset[str]) -> object:
    """Return what is written without the members that were added since the stored one was, at every depth."""
    if isinstance(written, dict) and isinstance(members, dict):
        return {
            name: _as_of_before(value, members.get(name), added)
            for name, value in written.items()
            if name in members or name not in added
        }
    return written


def _members(document: object) -> object:
    """Return the names of a document's members, at every depth, without their values."""
    if isinstance(document, dict):
        return {name: _members(value) for name, value in document.items()}
    return [_members(value) for value in document] if isinstance(document, list) else None
