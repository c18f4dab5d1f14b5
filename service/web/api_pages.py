"""``/docs``: the description of the API as a page, with nothing from outside and no script in it."""

from fastapi import APIRouter, Response

from service.api.access import needs
from service.operations.access.scopes import Scope
from service.web.site import PageOf

router = APIRouter(include_in_schema=False)

#: The program that draws it writes styles as it goes.
_OF_API_PAGE = {
    "Content-Security-Policy": (
        "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
        "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
}


@router.get("/docs", dependencies=[needs(Scope.TRENDS_READ)])
def try_api(page: PageOf) -> Response:
    """Show the API as a page to try it with (Swagger UI)."""
    return page.show("swagger.html", headers=_OF_API_PAGE)
