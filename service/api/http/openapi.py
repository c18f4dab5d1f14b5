"""Describe the API: FastAPI's own schema, with the models of bodies that a route reads by itself."""

from fastapi import FastAPI
from pydantic.json_schema import models_json_schema

from service.api.http.problems import Problem
from service.api.windows import WindowIn, WindowsIn
from service.json_types import JsonObject

_COMPONENT = "#/components/schemas/{model}"


def describe(app: FastAPI) -> JsonObject:
    """Return the OpenAPI document, made once."""
    if app.openapi_schema is None:
        document = FastAPI.openapi(app)
        models = [(WindowIn, "validation"), (WindowsIn, "validation"), (Problem, "validation")]
        document["components"]["schemas"] |= models_json_schema(models, ref_template=_COMPONENT)[1]["$defs"]  # type: ignore[arg-type]
        app.openapi_schema = document
    return app.openapi_schema
