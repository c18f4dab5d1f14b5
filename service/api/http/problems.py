"""Answer every error as ``application/problem+json`` (RFC 9457) with a stable type."""

from http import HTTPStatus

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails
from starlette.exceptions import HTTPException
from starlette.routing import compile_path
from starlette.types import Receive, Scope, Send

from monitor_core.errors import MonitorCoreError
from service.errors import (
    BodyTooSlowError,
    InvalidRequestError,
    ServiceError,
    TooManyTriesError,
    UnauthenticatedError,
    first_refusal,
    sentence_of,
    status_of,
)
from service.json_types import Json, JsonObject

MEDIA_TYPE = "application/problem+json"
TYPE_PREFIX = "urn:preload-monitor:problem:"
RETRY_AFTER_S = 1
_MOST_IN_LOG = 500
#: Errors that the framework finds before a route is reached.
_NAME_OF_STATUS = {404: "unknown-resource", 405: "method-not-allowed", 413: "body-too-large"}


class ProblemItem(BaseModel):
    """One thing that is wrong with a request."""

    pointer: str = Field(description="JSON pointer into the request")
    detail: str


class Problem(BaseModel):
    """An RFC 9457 problem document."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "type": TYPE_PREFIX + "conflict",
                    "title": "Conflict",
                    "status": 409,
                    "detail": "alarm 7 is cleared already",
                }
            ]
        }
    )

    type: str = Field(description="stable: a program may rely on it")
    title: str
    status: int
    detail: str = Field(description="one sentence: what was expected, what was got, in which unit")
    errors: list[ProblemItem] | None = Field(default=None, description="of an invalid request")


#: For the description of the API: every route may answer so.
PROBLEM_RESPONSES: dict[int | str, JsonObject] = {
    status: {"description": description, "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}}
    for status, description in (("4XX", "refused; nothing was changed"), ("5XX", "failed; it may be sent again"))
}


class ProblemAnswer(JSONResponse):
    """A problem document; the log of requests gets its reason with it."""

    media_type = MEDIA_TYPE
    reason = ""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it."""
        scope.setdefault("state", {})["reason"] = self.reason[:_MOST_IN_LOG]
        await super().__call__(scope, receive, send)


def problem(
    status: int, name: str, detail: str, headers: dict[str, str] | None = None, **members: Json
) -> ProblemAnswer:
    """Return one problem document."""
    headers = dict(headers or {})
    if status == HTTPStatus.SERVICE_UNAVAILABLE:
        headers["Retry-After"] = str(RETRY_AFTER_S)
    body = {
        "type": TYPE_PREFIX + name,
        "title": HTTPStatus(status).phrase,
        "status": status,
        "detail": detail,
        **members,
    }
    answer = ProblemAnswer(body, status_code=status, headers=headers)
    answer.reason = detail
    return answer


def problem_of(error: Exception) -> ProblemAnswer:
    """Return the problem document of an error that was raised on purpose."""
    status, name = status_of(error)
    headers = {}
    if isinstance(error, BodyTooSlowError):
        headers["Connection"] = "close"
    elif isinstance(error, UnauthenticatedError):
        headers["WWW-Authenticate"] = "Bearer"
    elif isinstance(error, TooManyTriesError):
        headers["Retry-After"] = error.retry_after
    return problem(status, name, str(error), headers)


def install_problem_handlers(app: FastAPI) -> None:
    """Make every error of the application a problem document; it takes no worker thread, all may be taken."""

    @app.exception_handler(ServiceError)
    @app.exception_handler(MonitorCoreError)
    async def _refused(_request: Request, error: Exception) -> JSONResponse:
        return problem_of(error)

    @app.exception_handler(ValidationError)
    async def _typed(request: Request, error: ValidationError) -> JSONResponse:
        """Refuse what was typed into a form of a page; elsewhere what is stored cannot be read, which is a fault."""
        if request.method != "POST" or request.url.path.startswith("/v1/"):
            raise error
        return problem_of(InvalidRequestError(first_refusal(error)))

    @app.exception_handler(RequestValidationError)
    async def _invalid_request(_request: Request, error: RequestValidationError) -> JSONResponse:
        items = [{"pointer": _pointer(item["loc"]), "detail": _detail(item)} for item in error.errors()]
        refused, more = items[0], f" (and {len(items) - 1} more)" if len(items) > 1 else ""
        answer = problem(
            422, "invalid-request", f"{refused['pointer'] or 'body'}: {refused['detail']}{more}", errors=items[:50]
        )
        # the log gets nothing of what was sent, which may be a password
        answer.reason = f"{refused['pointer'] or 'body'}: {error.errors()[0]['type']}{more}"
        return answer

    @app.exception_handler(HTTPException)
    async def _http(request: Request, error: HTTPException) -> JSONResponse:
        headers = dict(error.headers or {})
        detail = str(error.detail)
        if error.status_code == HTTPStatus.NOT_FOUND:
            detail = f"there is no resource {request.url.path}; GET /docs lists what there is"
        elif error.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
            allowed = _allowed_methods(request.app, request.url.path) or headers.get("Allow", "GET")
            headers["Allow"] = allowed
            detail = f"{request.url.path} takes {allowed}; got {request.method}"
        name = _NAME_OF_STATUS.get(error.status_code, "unreadable-body" if error.status_code == 400 else "refused")
        return problem(error.status_code, name, detail, headers)


def _allowed_methods(app: FastAPI, path: str) -> str:
    """Return every method that a path takes; the framework names only those of the first route that fits."""
    items = [item for template, item in app.openapi()["paths"].items() if compile_path(template)[0].match(path)]
    return ", ".join(sorted({method.upper() for item in items for method in item}))


def _pointer(location: tuple[int | str, ...]) -> str:
    parts = [str(part) for part in location if part != "body"]
    return "".join("/" + part.replace("~", "~0").replace("/", "~1") for part in parts)


def _detail(item: ErrorDetails) -> str:
    if item["type"] == "json_invalid":
        return f"the body is not JSON: {item.get('ctx', {}).get('error', item['msg'])}"
    return sentence_of(item)
