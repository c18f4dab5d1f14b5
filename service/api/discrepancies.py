"""``POST /v1/axes/{axis}/discrepancies``: what the model of an axis lacks, as a job with progress and a report."""

from typing import Annotated

from fastapi import APIRouter, Depends, Response
from fastapi.responses import HTMLResponse

from service.api.fields import AxisId, JobId
from service.api.jobs import JobOut, job_out
from service.api.services import Services, services
from service.operations.discrepancy.discrepancy_job import DiscrepancyIn

#: A report is a file of its own, with its style in it and no script.
_OF_REPORT = {
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; frame-ancestors 'none'"
}

router = APIRouter(prefix="/v1", tags=["discrepancies"])


@router.post("/axes/{axis}/discrepancies", response_model=JobOut, status_code=202)
def start_discrepancy(
    axis: AxisId, body: DiscrepancyIn, response: Response, on: Annotated[Services, Depends(services)]
) -> JobOut:
    """Explain in the background where measurements and model part; the result is the JSON of `preload explain`."""
    on.discrepancies.require(axis, body)
    row = on.jobs.submit(on.discrepancies.kind, axis, body.model_dump(mode="json", by_alias=True))
    response.headers["Location"] = f"/v1/jobs/{row.id}"
    return job_out(row)


@router.get("/axes/{axis}/discrepancies/{job}/report", response_class=HTMLResponse)
def get_discrepancy_report(axis: AxisId, job: JobId, on: Annotated[Services, Depends(services)]) -> HTMLResponse:
    """Return the report of a finished job: one page that holds all it shows, to be kept or sent on."""
    return HTMLResponse(on.discrepancies.report(axis, job), headers=_OF_REPORT)
