"""RFC 9457: every error answers ``application/problem+json`` with a stable type."""

from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import ValidationError
from starlette.exceptions import HTTPException

from monitor_core.errors import MonitorCoreError
from service.errors import ServiceError, status_of

MEDIA_TYPE = "application/problem+json"
TYPE_PREFIX = "urn:preload-monitor:problem:"


def problem(status: int, name: str, detail: str, **members: Any) -> JSONResponse:  # noqa: ANN401 - free members of RFC 9457
    """Return one problem document."""
    headers = {"Retry-After": "1"} if status == HTTPStatus.SERVICE_UNAVAILABLE else None
    body = {
        "type": TYPE_PREFIX + name,
        "title": HTTPStatus(status).phrase,
        "status": status,
        "detail": detail,
        **members,
    }
    return JSONResponse(body, status_code=status, media_type=MEDIA_TYPE, headers=headers)


def validation_problem(errors: list[Any]) -> JSONResponse:
    """Return a problem with a JSON pointer to each thing that is wrong."""
    items = [{"pointer": _pointer(item["loc"]), "detail": item["msg"]} for item in errors]
    first = items[0]
    more = f" (and {len(items) - 1} more)" if len(items) > 1 else ""
    return problem(422, "invalid-request", f"{first['pointer'] or '/'}: {first['detail']}{more}", errors=items[:50])


def install_problem_handlers(app: FastAPI) -> None:
    """Make every error of the application a problem document."""

    @app.exception_handler(ServiceError)
    @app.exception_handler(MonitorCoreError)
    def _refused(_request: Request, error: Exception) -> JSONResponse:
        status, name = status_of(error)
        return problem(status, name, str(error))

    @app.exception_handler(RequestValidationError)
    def _invalid_request(_request: Request, error: RequestValidationError) -> JSONResponse:
        return validation_problem(list(error.errors()))

    @app.exception_handler(ValidationError)
    def _invalid_body(_request: Request, error: ValidationError) -> JSONResponse:
        return validation_problem(list(error.errors(include_url=False, include_context=False, include_input=False)))

    @app.exception_handler(HTTPException)
    def _http(_request: Request, error: HTTPException) -> JSONResponse:
        name = HTTPStatus(error.status_code).phrase.lower().replace(" ", "-")
        return problem(error.status_code, name, str(error.detail))

    @app.exception_handler(Exception)
    def _unexpected(_request: Request, _error: Exception) -> JSONResponse:
        # The traceback goes to the log (starlette re-raises to the server); the caller gets no internals.
        return problem(500, "internal-error", "the service failed on this request; its log says why")


def _pointer(location: tuple[Any, ...]) -> str:
    parts = [str(part) for part in location if part not in ("body",)]
    return "".join("/" + part.replace("~", "~0").replace("/", "~1") for part in parts)
