"""``/v1/jobs``: long work with its progress, and the routes that only start some.

Replays, identifications, discrepancies (whose report is also a page) and the simulated axis of a trial.
"""

from datetime import datetime
from typing import Annotated, Literal

from fastapi import Query, Response
from fastapi.responses import HTMLResponse
from pydantic import BaseModel, Field

from service.api.access import needs
from service.api.services import ServicesOf, api_router
from service.json_types import JsonObject
from service.operations.access.scopes import Scope
from service.operations.discrepancy_job import DiscrepancyIn
from service.operations.fields import AnswerModel, AxisId, AxisName, JobId, RequestModel
from service.operations.identification_job import IdentificationIn
from service.operations.monitoring.replay import ReplayIn
from service.store.tables import JobRow

router = api_router()

#: A report is a file of its own, with its style in it and no script.
_OF_REPORT = {
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; frame-ancestors 'none'"
}


class JobOut(AnswerModel):
    """A job as it stands."""

    id: str
    kind: str
    axis: Annotated[str | None, Field(validation_alias="axis_id", description="null: it is about all axes")]
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


def started(row: JobRow, response: Response) -> JobOut:
    """Answer with a job that was started, and where its progress is."""
    response.headers["Location"] = f"/v1/jobs/{row.id}"
    return JobOut.model_validate(row)


@router.get("/sessions", tags=["jobs"], dependencies=[needs(Scope.TRENDS_READ)])
def list_sessions(services: ServicesOf) -> SessionsOut:
    """List the recorded sessions in the replay folder."""
    return SessionsOut(sessions=services.replays.sessions())


@router.post("/axes/{axis}/replays", tags=["jobs"], status_code=202, dependencies=[needs(Scope.REPLAYS_RUN)])
def start_replay(axis: AxisId, body: ReplayIn, response: Response, services: ServicesOf) -> JobOut:
    """Replay a recorded session into an axis, as a job with progress; the same code as for live windows."""
    return started(services.replays.start(axis, body), response)


@router.get("/jobs", tags=["jobs"], dependencies=[needs(Scope.TRENDS_READ)])
def list_jobs(query: Annotated[JobsQuery, Query()], services: ServicesOf) -> JobsOut:
    """List jobs, newest first."""
    rows = services.jobs.list(query.axis, query.limit, query.cursor)
    return JobsOut(jobs=rows, next_cursor=rows[-1].id if len(rows) == query.limit else None)


@router.get("/jobs/{job}", tags=["jobs"], dependencies=[needs(Scope.TRENDS_READ)])
def get_job(job: JobId, services: ServicesOf) -> JobOut:
    """Return a job with its progress."""
    return JobOut.model_validate(services.jobs.get(job))


@router.post("/jobs/{job}/cancel", tags=["jobs"], dependencies=[needs(Scope.REPLAYS_RUN)])
def cancel_job(job: JobId, services: ServicesOf) -> JobOut:
    """Ask a job to stop; work already done stays done."""
    return JobOut.model_validate(services.jobs.cancel(job))


@router.post(
    "/axes/{axis}/identifications", tags=["identifications"], status_code=202, dependencies=[needs(Scope.REPLAYS_RUN)]
)
def start_identification(axis: AxisId, body: IdentificationIn, response: Response, services: ServicesOf) -> JobOut:
    """Identify the joints of an axis in the background; the result is the JSON of `preload identify`."""
    return started(services.identifications.start(axis, body), response)


@router.post(
    "/axes/{axis}/discrepancies", tags=["discrepancies"], status_code=202, dependencies=[needs(Scope.REPLAYS_RUN)]
)
def start_discrepancy(axis: AxisId, body: DiscrepancyIn, response: Response, services: ServicesOf) -> JobOut:
    """Explain in the background where measurements and model part; the result is the JSON of `preload explain`."""
    return started(services.discrepancies.start(axis, body), response)


@router.get(
    "/axes/{axis}/discrepancies/{job}/report",
    tags=["discrepancies"],
    response_class=HTMLResponse,
    dependencies=[needs(Scope.TRENDS_READ)],
)
def get_discrepancy_report(axis: AxisId, job: JobId, services: ServicesOf) -> HTMLResponse:
    """Return the report of a finished job: one page that holds all it shows, to be kept or sent on."""
    return HTMLResponse(services.discrepancies.report(axis, job), headers=_OF_REPORT)


@router.post("/trials", tags=["jobs"], status_code=202, dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def start_trial(response: Response, services: ServicesOf) -> JobOut:
    """Make a simulated axis with a year of history, as a job; `arguments.axis` names it, its archive ends the trial."""
    return started(services.trials.start(), response)
