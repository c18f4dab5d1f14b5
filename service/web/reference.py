"""``/docs`` and ``/redoc``: the description of the API as pages, with nothing from outside and no script in them."""

from fastapi import APIRouter, Request, Response

from service.web.pages import templates

router = APIRouter(include_in_schema=False)

#: Both programs that draw these pages write styles as they go, and ReDoc searches in a worker of its own.
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; worker-src blob:; "
        "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
}


@router.get("/docs")
def try_api(request: Request) -> Response:
    """Show the API as pages to try it with (Swagger UI)."""
    return templates.TemplateResponse(request, "swagger.html", headers=_HEADERS)


@router.get("/redoc")
def read_api(request: Request) -> Response:
    """Show the API as pages to read (ReDoc)."""
    return templates.TemplateResponse(request, "redoc.html", headers=_HEADERS)
