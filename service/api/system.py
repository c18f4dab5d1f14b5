"""``GET /v1/system``: versions, how far intake is behind, what was refused; ``/v1/audit``: who changed what."""

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Query
from pydantic import BaseModel, ConfigDict, Field

from service.api.access import needs
from service.api.services import Services, services
from service.operations.access.scopes import Scope
from service.operations.fields import AxisName, RequestModel
from service.operations.system import SystemStatus, system_status

router = APIRouter(prefix="/v1", tags=["operations"])


class VersionsOut(BaseModel):
    """What runs: the program, the schema and kind of the database, Python."""

    program: str
    schema_: Annotated[str, Field(serialization_alias="schema")]
    database: str
    python: str


class LagOut(BaseModel):
    """How far intake is behind."""

    waiting_requests: Annotated[int, Field(description="that wait for their turn in this process")]
    open_measurements: Annotated[int, Field(description="that wait for further windows")]
    last_received_at: Annotated[datetime | None, Field(description="when the newest window arrived")]
    last_started_at: Annotated[datetime | None, Field(description="when that window was measured")]
    mean_judging_s: Annotated[
        float | None, Field(description="time to judge a measurement, since this process began; null: none yet")
    ]


class SystemOut(BaseModel):
    """How the service stands; counts are of all axes since they were registered."""

    versions: VersionsOut
    lag: LagOut
    axes: int
    archived_axes: int
    refused_windows: dict[str, int]
    uncharted: dict[str, int]


def system_out(status: SystemStatus) -> SystemOut:
    """Return on the wire how the service stands."""
    versions, lag = status.versions, status.lag
    return SystemOut(
        versions=VersionsOut(
            program=versions.program, schema_=versions.schema, database=versions.database, python=versions.python
        ),
        lag=LagOut(
            waiting_requests=lag.n_waiting,
            open_measurements=lag.n_open,
            last_received_at=lag.received_at,
            last_started_at=lag.started_at,
            mean_judging_s=lag.judging_s,
        ),
        axes=status.n_axes,
        archived_axes=status.n_archived,
        refused_windows=status.refused_windows,
        uncharted=status.uncharted,
    )


@router.get("/system", dependencies=[needs(Scope.TRENDS_READ)])
def get_system(on: Annotated[Services, Depends(services)]) -> SystemOut:
    """Return versions, how far intake is behind, and what was refused of all axes, by reason."""
    return system_out(system_status(on.database, on.metrics, on.ingest))


class AuditEntryOut(BaseModel):
    """One attempt to change something; `status` is that of the answer, null if the service ended before it gave any."""

    model_config = ConfigDict(from_attributes=True)

    id: int
    at: datetime
    who: str
    action: str
    target: str
    axis: Annotated[str | None, Field(validation_alias="axis_id")]
    status: int | None
    request_id: str | None


class AuditOut(BaseModel):
    """Entries of the log, newest first; `next_cursor` fetches older ones."""

    entries: list[AuditEntryOut]
    next_cursor: int | None


class AuditQuery(RequestModel):
    """Which entries."""

    axis: AxisName | None = None
    cursor: Annotated[int, Field(ge=1, lt=2**63)] | None = Field(default=None, description="next_cursor of a page")
    limit: Annotated[int, Field(ge=1, le=1000)] = 100


@router.get("/audit")
def list_audit(query: Annotated[AuditQuery, Query()], on: Annotated[Services, Depends(services)]) -> AuditOut:
    """List who changed what, newest first."""
    rows = on.access.log(query.axis, query.cursor, query.limit)
    entries = [AuditEntryOut.model_validate(row) for row in rows]
    return AuditOut(entries=entries, next_cursor=rows[-1].id if len(rows) == query.limit else None)
