"""``/docs`` and ``/redoc``: the description of the API as pages, with nothing from outside and no script in them."""

from fastapi import APIRouter, Response

from service.web.site import PageOf

router = APIRouter(include_in_schema=False)

#: Both programs that draw these pages write styles as they go, and ReDoc searches in a worker of its own.
_OF_API_PAGES = {
    "Content-Security-Policy": (
        "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; worker-src blob:; "
        "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
}


@router.get("/docs")
def try_api(page: PageOf) -> Response:
    """Show the API as pages to try it with (Swagger UI)."""
    return page.show("swagger.html", headers=_OF_API_PAGES)


@router.get("/redoc")
def read_api(page: PageOf) -> Response:
    """Show the API as pages to read (ReDoc)."""
    return page.show("redoc.html", headers=_OF_API_PAGES)
