"""Find the routes that answer lists in the description of the API, and say there that each is a table as well."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NotRequired, TypedDict, cast

from service.api.http.tables.columns import Column, lists_of
from service.api.http.tables.writers import CSV_TYPE, PARQUET_TYPE, WRITERS
from service.json_types import JsonObject


class Content(TypedDict):
    """What an answer holds."""

    schema: JsonObject


class Answer(TypedDict):
    """One answer of an operation, by media type."""

    content: NotRequired[dict[str, Content]]


class Operation(TypedDict):
    """What is read and changed of an operation."""

    parameters: NotRequired[list[JsonObject]]
    responses: dict[str, Answer]


class Components(TypedDict):
    """The records that others refer to."""

    schemas: JsonObject


class Document(TypedDict):
    """What is read and changed of an OpenAPI document."""

    paths: dict[str, dict[str, Operation]]
    components: Components


@dataclass(frozen=True, slots=True)
class ListRoute:
    """A route that answers lists: their columns by name, and how many records a page may have (None: all)."""

    lists: Mapping[str, tuple[Column, ...]]
    most: int | None


def list_routes(document: Document) -> dict[str, ListRoute]:
    """Return the routes that answer lists: those of collections, not of one of their members."""
    found = {}
    for path, item in document["paths"].items():
        operation = item.get("get")
        if operation is None or path.endswith("}"):
            continue
        content = operation["responses"]["200"].get("content", {}).get("application/json")
        lists = {} if content is None else lists_of(content["schema"], document["components"]["schemas"])
        if lists:
            found[path] = ListRoute(lists, _largest_page(operation))
    return found


def offer_tables(document: Document) -> None:
    """Say in the description of the API that every list is there as a table."""
    text: JsonObject = {"type": "string"}
    binary: JsonObject = {"type": "string", "contentMediaType": PARQUET_TYPE}
    for path, route in list_routes(document).items():
        operation = document["paths"][path]["get"]
        parameters = operation.setdefault("parameters", [])
        parameters.append(
            _parameter("format", WRITERS, "the whole list as a table; with limit or cursor, that page of it")
        )
        if len(route.lists) > 1:
            parameters.append(_parameter("list", route.lists, "with format: which list; otherwise the first"))
        content = operation["responses"]["200"]["content"]
        content |= {CSV_TYPE.partition(";")[0]: {"schema": text}, PARQUET_TYPE: {"schema": binary}}


def _largest_page(operation: Operation) -> int | None:
    for parameter in operation.get("parameters", ()):
        if parameter["name"] == "limit":
            return cast(int, cast(JsonObject, parameter["schema"])["maximum"])
    return None


def _parameter(name: str, choices: Mapping[str, object], description: str) -> JsonObject:
    schema: JsonObject = {"type": "string", "enum": list(choices)}
    return {"name": name, "in": "query", "required": False, "schema": schema, "description": description}
