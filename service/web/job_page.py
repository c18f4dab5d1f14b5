"""``/jobs/{job}``: how far long work is and what came of it; it is found again after the page was closed."""

from typing import Annotated, Any

from fastapi import APIRouter, Form, Response
from pydantic import BaseModel, TypeAdapter

from service.api.access import needs
from service.api.jobs import JobOut
from service.api.services import ServicesOf
from service.documents.history import COMPARISON
from service.operations.access.scopes import Scope
from service.operations.discrepancy_job import DiscrepancyIn, FoundDiscrepancy
from service.operations.fields import JobId
from service.operations.identification_job import IdentificationIn
from service.operations.monitoring.rejudgements import RejudgementIn
from service.store.rejudged import KIND as REJUDGEMENT
from service.web.site import PageOf, done

router = APIRouter(include_in_schema=False)


class Joint(BaseModel):
    """A joint that was identified."""

    value: float
    standard_uncertainty: float | None
    unit: str
    interval_95: tuple[float | None, float | None] | None
    interval_kind: str
    verdict: str


class DroppedPeak(BaseModel):
    """A peak that was left out."""

    reason: str


class Joints(BaseModel):
    """All of them."""

    parameters: dict[str, Joint]
    not_identifiable: list[str]
    missing_modes: list[str]
    dropped_peaks: list[DroppedPeak] = []  # earlier versions had none
    taken_as: list[str]
    model: str


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
        compared=_found(out, REJUDGEMENT, COMPARISON),
        asked=RejudgementIn.model_validate(out.arguments) if out.kind == REJUDGEMENT else None,
        in_force=None if out.kind != REJUDGEMENT or out.axis is None else on.calibrations.overview(out.axis).active,
        joints=_found(out, IdentificationIn.kind, TypeAdapter(Joints)),
        discrepancy=_found(out, DiscrepancyIn.kind, TypeAdapter(FoundDiscrepancy)),
    )


def _found(job: JobOut, kind: str, result: TypeAdapter[Any]) -> object:
    return result.validate_python(job.result) if job.kind == kind and job.status == "done" else None


@router.post("/jobs/{job}/cancel", dependencies=[needs(Scope.REPLAYS_RUN)])
def cancel(job: JobId, form: Annotated[CancelForm, Form()], on: ServicesOf) -> Response:
    """Ask a job to stop."""
    on.jobs.cancel(job)
    return done("/system" if form.back == "system" else f"/jobs/{job}", "cancelled")
