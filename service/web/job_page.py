"""``/jobs/{job}``: how far long work is and what came of it; it is found again after the page was closed."""

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Form, Response
from pydantic import BaseModel

from service.api.access import needs
from service.api.jobs import JobOut
from service.api.services import ServicesOf
from service.operations.access.scopes import Scope
from service.operations.discrepancy_job import DiscrepancyIn, FoundDiscrepancy
from service.operations.fields import JobId
from service.operations.monitoring.rejudged_history import Column
from service.web.site import PageOf, done

router = APIRouter(include_in_schema=False)


class Compared(BaseModel):
    """What a history says as it stands, and as it would."""

    dry_run: bool
    same_alarms: bool
    waveforms_gone: int
    old: Column
    new: Column


class Joint(BaseModel):
    """A joint that was identified."""

    value: float
    standard_uncertainty: float | None
    unit: str
    interval_95: tuple[float | None, float | None] | None
    interval_kind: str
    verdict: str


class Joints(BaseModel):
    """All of them."""

    parameters: dict[str, Joint]
    not_identifiable: list[str]
    taken_as: list[str]
    model: str


class Rejudged(BaseModel):
    """By which calibration which part was judged again."""

    calibration: int
    start: datetime | None = None
    end: datetime | None = None


class CancelForm(BaseModel):
    """Whether the list of the system was looked at."""

    back: str = ""


@router.get("/jobs/{job}", dependencies=[needs(Scope.TRENDS_READ)])
def job_page(job: JobId, page: PageOf, on: ServicesOf) -> Response:
    """Show a job, its progress or its result."""
    out = JobOut.model_validate(on.jobs.get(job))
    return page.show(
        "job.html",
        job=out,
        compared=_found(out, "rejudgement", Compared),
        asked=Rejudged.model_validate(_aliased(out)) if out.kind == "rejudgement" else None,
        in_force=None if out.kind != "rejudgement" or out.axis is None else on.calibrations.overview(out.axis).active,
        joints=_found(out, "identification", Joints),
        discrepancy=_found(out, DiscrepancyIn.kind, FoundDiscrepancy),
    )


def _aliased(job: JobOut) -> dict[str, object]:
    asked = job.arguments
    return {"calibration": asked["calibration"], "start": asked.get("from"), "end": asked.get("to")}


Result = type[Compared] | type[Joints] | type[FoundDiscrepancy]


def _found(job: JobOut, kind: str, result: Result) -> BaseModel | None:
    return result.model_validate(job.result) if job.kind == kind and job.status == "done" else None


@router.post("/jobs/{job}/cancel", dependencies=[needs(Scope.REPLAYS_RUN)])
def cancel(job: JobId, form: Annotated[CancelForm, Form()], on: ServicesOf) -> Response:
    """Ask a job to stop."""
    on.jobs.cancel(job)
    return done("/system" if form.back == "system" else f"/jobs/{job}", "cancelled")
