"""Every number that the API takes, drawn from its own description, with values that it may be sent."""

import copy
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

#: Magnitudes from the smallest to the largest that a number in JSON can have, and both signs of each.
_MAGNITUDES = (1e-300, 1e-30, 1e-12, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e12, 1e30, 1e300)
SWEPT = (0.0, *(sign * size for size in _MAGNITUDES for sign in (1.0, -1.0)))
#: What is tried where every field has to be tried soon.
FEW = (1e-300, 1e-9, 1e300)

Pointer = tuple[str | int, ...]
Schema = dict[str, Any]


@dataclass(frozen=True)
class NumberField:
    """A number of a request."""

    method: str
    path: str
    place: str  # path, query or body
    pointer: Pointer
    bounds: Schema
    document: Any  # of the body: one that fits

    @property
    def name(self) -> str:
        return f"{self.method} {self.path} {self.place} {'.'.join(map(str, self.pointer))}"

    def edges(self) -> Iterator[float]:
        """Yield the stated bounds, and what is just beyond them."""
        for name in ("minimum", "exclusiveMinimum", "maximum", "exclusiveMaximum"):
            if (bound := self.bounds.get(name)) is not None:
                whole = self.bounds["type"] == "integer"
                yield from (bound - 1, bound, bound + 1) if whole else (
                    math.nextafter(bound, -math.inf), float(bound), math.nextafter(bound, math.inf)
                )  # fmt: skip

    def with_value(self, value: float) -> Any:
        """Return the body with this number in its place."""
        document = copy.deepcopy(self.document)
        inner = document
        for step in self.pointer[:-1]:
            inner = inner[step]
        inner[self.pointer[-1]] = value
        return document


class Description:
    """The OpenAPI document of a service, and for some paths a document that is taken there."""

    def __init__(self, document: Schema, taken: dict[str, Any]) -> None:
        self._taken = taken
        self._paths: Schema = document["paths"]
        self._schemas: Schema = document["components"]["schemas"]

    def fields(self) -> Iterator[NumberField]:
        """Yield every number of every request."""
        for path, operations in self._paths.items():
            for method, operation in operations.items():
                yield from self._of(method.upper(), path, operation)

    def _of(self, method: str, path: str, operation: Schema) -> Iterator[NumberField]:
        for parameter in operation.get("parameters", ()):
            for _, bounds, _ in self._numbers(parameter["schema"], None):
                yield NumberField(method, path, parameter["in"], (parameter["name"],), bounds, None)
        content = operation.get("requestBody", {}).get("content", {}).get("application/json", {})
        for schema in self._choices(content.get("schema", {})):
            taken = self._taken.get(path, {})
            start = taken if taken and set(taken) <= set(schema["properties"]) else self._minimal(schema)
            for pointer, bounds, document in self._numbers(schema, start):
                yield NumberField(method, path, "body", pointer, bounds, document)

    def _resolved(self, schema: Schema) -> Schema:
        name = schema.get("$ref")
        return schema if name is None else self._resolved(self._schemas[name.rpartition("/")[2]])

    def _choices(self, schema: Schema) -> list[Schema]:
        """Return what a schema may be, without null."""
        schema = self._resolved(schema)
        choices = schema.get("anyOf") or schema.get("oneOf")
        if "properties" in schema or not choices:
            return [schema] if schema and schema.get("type") != "null" else []
        return [each for choice in choices for each in self._choices(choice)]

    def _minimal(self, schema: Schema) -> Any:
        """Return a document that fits: the example of the schema, or one of what is required."""
        (schema, *_) = self._choices(schema) or [{}]
        stated = [each for each in (*schema.get("examples", ()), schema.get("default")) if each is not None]
        stated += schema.get("enum", [])[:1] + ([schema["const"]] if "const" in schema else [])
        return copy.deepcopy(stated[0]) if stated else self._made(schema)

    def _made(self, schema: Schema) -> Any:
        kind, least = schema.get("type"), schema.get("minimum", 1)
        if kind == "object":
            inner = schema.get("properties", {})
            made = {name: self._minimal(inner[name]) for name in schema.get("required", ())}
            more = schema.get("additionalProperties")
            return made | ({"any": self._minimal(more)} if isinstance(more, dict) else {})
        if kind == "array":
            items = schema.get("prefixItems") or [schema["items"]] * max(1, schema.get("minItems", 1))
            return [self._minimal(item) for item in items]
        of_kind = {"number": least, "integer": least, "boolean": False}
        return of_kind.get(str(kind), "2026-03-02T06:00:00Z" if schema.get("format") == "date-time" else "a")

    def _numbers(self, schema: Schema, document: Any) -> Iterator[tuple[Pointer, Schema, Any]]:
        """Yield each number below a schema: where, its bounds, and the document with its place made."""
        for choice in self._choices(schema):
            if choice.get("type") in ("number", "integer"):
                yield (), choice, document
                continue
            members: dict[str | int, Schema] = dict(choice.get("properties", {}))
            if choice.get("type") == "array":
                members |= dict(enumerate(choice.get("prefixItems") or [choice["items"]]))
            elif isinstance(choice.get("additionalProperties"), dict):
                members["any"] = choice["additionalProperties"]
            made = document if isinstance(document, dict | list) and document else self._made(choice)
            for name, member in members.items():
                is_there = name in made if isinstance(made, dict) else isinstance(name, int) and name < len(made)
                inner = made[name] if is_there else self._minimal(member)
                for pointer, bounds, below in self._numbers(member, inner):
                    outer = copy.copy(made)
                    outer[name] = below
                    yield (name, *pointer), bounds, outer


def numbers_in(node: Any, pointer: Pointer = ()) -> Iterator[tuple[Pointer, Any]]:
    """Yield where the numbers of a document are, and what holds each."""
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for name, value in items:
        if isinstance(value, float | int) and not isinstance(value, bool):
            yield (*pointer, name), node
        yield from numbers_in(value, (*pointer, name))
