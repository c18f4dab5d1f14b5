"""``/v1/axes/{axis}/maintenance``: what was done to an axis; a new nut or screw begins its charts anew."""

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Response
from pydantic import BaseModel, Field

from service.api.access import needs
from service.api.services import Services, services
from service.operations.access.scopes import Scope
from service.operations.fields import AxisId
from service.operations.monitoring import maintenance
from service.operations.monitoring.maintenance import MaintenanceIn, Work
from service.store.tables import MaintenanceRow

router = APIRouter(prefix="/v1", tags=["maintenance"])


class MaintenanceOut(BaseModel):
    """An entry of the maintenance log."""

    id: int
    at: datetime
    entered_at: datetime
    who: str
    kind: Work
    note: str
    set_preload_n: float | None
    corrects: Annotated[int | None, Field(description="the entry that it takes the place of")]


class MaintenanceLogOut(BaseModel):
    """All entries by when the work was done; one that another one `corrects` does not hold any more."""

    axis: str
    entries: list[MaintenanceOut]


def maintenance_out(row: MaintenanceRow) -> MaintenanceOut:
    """Return an entry on the wire."""
    return MaintenanceOut(
        id=row.id, at=row.at, entered_at=row.entered_at, who=row.who, kind=Work(row.kind), note=row.note,
        set_preload_n=row.set_preload_n, corrects=row.corrects,
    )  # fmt: skip


@router.post(
    "/axes/{axis}/maintenance",
    status_code=201,
    responses={200: {"model": MaintenanceOut, "description": "this entry was there already"}},
    dependencies=[needs(Scope.ALARMS_ACK)],
)
def post_maintenance(
    axis: AxisId, body: MaintenanceIn, response: Response, on: Annotated[Services, Depends(services)]
) -> MaintenanceOut:
    """Say what was done to an axis. A new nut or screw begins the baseline anew from then, however long ago."""
    row, is_new = maintenance.enter(on.database, axis, body)
    response.status_code = 201 if is_new else 200
    return maintenance_out(row)


@router.get("/axes/{axis}/maintenance", dependencies=[needs(Scope.TRENDS_READ)])
def get_maintenance(axis: AxisId, on: Annotated[Services, Depends(services)]) -> MaintenanceLogOut:
    """Return the maintenance log of an axis."""
    return MaintenanceLogOut(axis=axis, entries=[maintenance_out(row) for row in maintenance.log_of(on.database, axis)])
