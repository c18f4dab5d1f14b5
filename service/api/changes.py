"""``/v1/changes``: whether anything changed since a page was read."""

from typing import Annotated

from fastapi import APIRouter, Depends, Query, Response
from pydantic import BaseModel, Field

from service.api.access import needs
from service.api.services import Services, services
from service.operations.access.scopes import Scope
from service.operations.fields import RequestModel

router = APIRouter(prefix="/v1", tags=["operations"])


class ChangesQuery(RequestModel):
    """Since when."""

    since: Annotated[str, Field(max_length=200)] | None = Field(default=None, description="mark of an earlier answer")


class ChangesOut(BaseModel):
    """The mark of what is stored now; it says nothing but that it is another one."""

    mark: str


@router.get(
    "/changes",
    response_model=ChangesOut,
    responses={304: {"description": "nothing changed since"}},
    dependencies=[needs(Scope.TRENDS_READ)],
)
def get_changes(query: Annotated[ChangesQuery, Query()], on: Annotated[Services, Depends(services)]) -> Response:
    """Ask whether anything changed: 304 if not, else the new mark. Made to be asked every second."""
    mark = on.changes.mark()
    if query.since == mark:
        return Response(status_code=304)
    return Response(ChangesOut(mark=mark).model_dump_json(), media_type="application/json")
