"""``GET /v1/system``: versions, how far intake is behind, what was refused of all axes."""

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Depends
from pydantic import BaseModel, Field

from service.api.services import Services, services
from service.operations.system import SystemStatus

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


@router.get("/system", response_model=SystemOut)
def get_system(on: Annotated[Services, Depends(services)]) -> SystemOut:
    """Return versions, how far intake is behind, and what was refused of all axes, by reason."""
    return system_out(on.system.status())
