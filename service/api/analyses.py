"""Start an analysis of an axis: ``POST /v1/axes/{axis}/identifications`` and ``…/discrepancies``.

Either is a job with progress; what a discrepancy found is also a page.
"""

from typing import Annotated

from fastapi import APIRouter, Depends, Response
from fastapi.responses import HTMLResponse

from service.api.access import needs
from service.api.jobs import JobOut, job_out
from service.api.services import Services, services
from service.operations.access.scopes import Scope
from service.operations.discrepancy_job import DiscrepancyIn
from service.operations.fields import AxisId, JobId
from service.operations.identification_job import IdentificationIn

#: A report is a file of its own, with its style in it and no script.
_OF_REPORT = {
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; frame-ancestors 'none'"
}

router = APIRouter(prefix="/v1")


@router.post(
    "/axes/{axis}/identifications", tags=["identifications"], status_code=202, dependencies=[needs(Scope.REPLAYS_RUN)]
)
def start_identification(
    axis: AxisId, body: IdentificationIn, response: Response, on: Annotated[Services, Depends(services)]
) -> JobOut:
    """Identify the joints of an axis in the background; the result is the JSON of `preload identify`."""
    row = on.identifications.start(axis, body)
    response.headers["Location"] = f"/v1/jobs/{row.id}"
    return job_out(row)


@router.post(
    "/axes/{axis}/discrepancies", tags=["discrepancies"], status_code=202, dependencies=[needs(Scope.REPLAYS_RUN)]
)
def start_discrepancy(
    axis: AxisId, body: DiscrepancyIn, response: Response, on: Annotated[Services, Depends(services)]
) -> JobOut:
    """Explain in the background where measurements and model part; the result is the JSON of `preload explain`."""
    row = on.discrepancies.start(axis, body)
    response.headers["Location"] = f"/v1/jobs/{row.id}"
    return job_out(row)


@router.get(
    "/axes/{axis}/discrepancies/{job}/report",
    tags=["discrepancies"],
    response_class=HTMLResponse,
    dependencies=[needs(Scope.TRENDS_READ)],
)
def get_discrepancy_report(axis: AxisId, job: JobId, on: Annotated[Services, Depends(services)]) -> HTMLResponse:
    """Return the report of a finished job: one page that holds all it shows, to be kept or sent on."""
    return HTMLResponse(on.discrepancies.report(axis, job), headers=_OF_REPORT)
