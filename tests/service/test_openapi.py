"""The description of the API is valid, complete and has examples; its pages load nothing from outside."""

import re
from collections.abc import Iterator
from typing import Any

import pytest
from openapi_spec_validator import validate
from pydantic import TypeAdapter

from service.api.windows import WindowIn, WindowsIn
from tests.service.conftest import Api


@pytest.fixture(scope="module")
def document(shared_api: Api) -> dict[str, Any]:
    return shared_api.http.get("/openapi.json").json()


def references(node: Any) -> Iterator[str]:
    if isinstance(node, dict):
        yield from (value for key, value in node.items() if key == "$ref")
        node = list(node.values())
    if isinstance(node, list):
        for item in node:
            yield from references(item)


def test_document_is_valid_and_refers_only_to_what_is_there(document: dict[str, Any]) -> None:
    validate(document)
    schemas = document["components"]["schemas"]
    assert {reference.removeprefix("#/components/schemas/") for reference in references(document)} <= set(schemas)
    assert "HTTPValidationError" not in schemas  # refusals are problem documents


def test_every_operation_says_what_it_does_and_how_it_refuses(document: dict[str, Any]) -> None:
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            assert operation["summary"], (method, path)
            assert operation["description"], (method, path)
            assert "application/problem+json" in operation["responses"]["4XX"]["content"], (method, path)


def test_every_body_has_an_example_that_fits(document: dict[str, Any]) -> None:
    bodies = [
        operation["requestBody"]["content"]["application/json"]
        for operations in document["paths"].values()
        for operation in operations.values()
        if "requestBody" in operation and "multipart/form-data" not in operation["requestBody"]["content"]
    ]
    assert len(bodies) == 18
    schemas = document["components"]["schemas"]
    for body in bodies:
        schema = body["schema"]
        examples = body.get("examples") or schemas[schema["$ref"].rpartition("/")[2]]["examples"]
        assert examples
    windows = document["paths"]["/v1/axes/{axis}/windows"]["post"]["requestBody"]["content"]
    assert set(windows) == {"application/json", "application/msgpack"}
    examples = windows["application/json"]["examples"]
    TypeAdapter(WindowIn).validate_python(examples["one window"]["value"])
    TypeAdapter(WindowsIn).validate_python(examples["a whole measurement"]["value"])


def test_an_upload_is_described_as_the_form_that_it_is(document: dict[str, Any]) -> None:
    operations = document["paths"]["/v1/axes/{axis}/recordings"]
    (kind,) = operations["post"]["requestBody"]["content"]
    assert kind == "multipart/form-data"
    schema = operations["post"]["requestBody"]["content"][kind]["schema"]
    assert (set(schema["properties"]), schema["required"]) == ({"file", "map"}, ["file"])
    assert set(operations["post"]["responses"]) == {"202", "4XX", "5XX"}
    files = {
        "/v1/axes/{axis}/recordings/{recording}/file": {"application/octet-stream"},
        "/v1/axes/{axis}/recordings/{recording}/session": {"application/x-hdf5"},
        "/v1/axes/{axis}/measurements/{measurement}/windows": {"application/x-hdf5", "text/csv"},
    }
    for path, kinds in files.items():
        assert set(document["paths"][path]["get"]["responses"]["200"]["content"]) == kinds


@pytest.mark.parametrize("path", ["/docs", "/"])
def test_pages_load_nothing_from_outside(shared_api: Api, path: str) -> None:
    page = shared_api.http.get(path)
    assert not re.search(r"(https?:)?//[\w.-]+\.\w+", page.text)
    assert "default-src 'self'" in page.headers["content-security-policy"]  # nor does a script of theirs
    for asset in re.findall(r'(?:src|href)="(/[^"]+)"', page.text):
        assert shared_api.http.get(asset).status_code == 200, asset


def test_swagger_does_not_ask_a_site_outside_to_judge_the_description(shared_api: Api) -> None:
    assert "validatorUrl: null" in shared_api.http.get("/static/swagger.js").text
