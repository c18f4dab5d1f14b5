"""``/v1/jobs``: long work with its progress, and ``/v1/axes/{axis}/replays`` that starts one kind of it."""

from datetime import datetime
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Query, Response
from pydantic import BaseModel, Field

from service.api.access import needs
from service.api.services import Services, services
from service.json_types import JsonObject
from service.operations.access.scopes import Scope
from service.operations.fields import AxisId, AxisName, JobId, RequestModel
from service.operations.monitoring.replay import ReplayIn
from service.store.tables import JobRow

router = APIRouter(prefix="/v1", tags=["jobs"])


class JobOut(BaseModel):
    """A job as it stands."""

    id: str
    kind: str
    axis: Annotated[str | None, Field(description="null: it is about all axes")]
    arguments: JsonObject
    status: Literal["queued", "running", "done", "failed", "cancelled"]
    done: int
    total: int | None
    result: JsonObject | None
    error: str | None
    created_at: datetime
    updated_at: datetime


class JobsOut(BaseModel):
    """Jobs, newest first; `next_cursor` fetches older ones."""

    jobs: list[JobOut]
    next_cursor: str | None


class JobsQuery(RequestModel):
    """Which jobs."""

    axis: AxisName | None = None
    cursor: Annotated[str, Field(pattern=r"^[0-9a-f-]{36}$")] | None = Field(
        default=None, description="next_cursor of a page"
    )
    limit: Annotated[int, Field(ge=1, le=200)] = 50


class SessionsOut(BaseModel):
    """Recorded sessions that can be replayed."""

    sessions: list[str]


def job_out(row: JobRow) -> JobOut:
    """Return a job on the wire."""
    return JobOut(
        id=row.id, kind=row.kind, axis=row.axis_id, arguments=row.arguments, status=row.status, done=row.done,
        total=row.total, result=row.result, error=row.error, created_at=row.created_at, updated_at=row.updated_at,
    )  # fmt: skip


@router.get("/sessions", dependencies=[needs(Scope.TRENDS_READ)])
def list_sessions(on: Annotated[Services, Depends(services)]) -> SessionsOut:
    """List the recorded sessions in the replay folder."""
    return SessionsOut(sessions=on.replays.sessions())


@router.post("/axes/{axis}/replays", status_code=202, dependencies=[needs(Scope.REPLAYS_RUN)])
def start_replay(
    axis: AxisId, body: ReplayIn, response: Response, on: Annotated[Services, Depends(services)]
) -> JobOut:
    """Replay a recorded session into an axis, as a job with progress; the same code as for live windows."""
    row = on.replays.start(axis, body)
    response.headers["Location"] = f"/v1/jobs/{row.id}"
    return job_out(row)


@router.get("/jobs", dependencies=[needs(Scope.TRENDS_READ)])
def list_jobs(query: Annotated[JobsQuery, Query()], on: Annotated[Services, Depends(services)]) -> JobsOut:
    """List jobs, newest first."""
    rows = on.jobs.list(query.axis, query.limit, query.cursor)
    return JobsOut(jobs=[job_out(row) for row in rows], next_cursor=rows[-1].id if len(rows) == query.limit else None)


@router.get("/jobs/{job}", dependencies=[needs(Scope.TRENDS_READ)])
def get_job(job: JobId, on: Annotated[Services, Depends(services)]) -> JobOut:
    """Return a job with its progress."""
    return job_out(on.jobs.get(job))


@router.post("/jobs/{job}/cancel", dependencies=[needs(Scope.REPLAYS_RUN)])
def cancel_job(job: JobId, on: Annotated[Services, Depends(services)]) -> JobOut:
    """Ask a job to stop; work already done stays done."""
    return job_out(on.jobs.cancel(job))
