"""Types of JSON values, as they are written, stored and sent."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    Json: TypeAlias = Mapping[str, "Json"] | Sequence["Json"] | str | int | float | None
else:
    Json = object  # pydantic and SQLAlchemy read annotations as they run, and take a document as it is
JsonObject: TypeAlias = dict[str, Json]
