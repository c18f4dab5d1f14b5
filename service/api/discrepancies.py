"""``POST /v1/axes/{axis}/discrepancies``: what the model of an axis lacks, as a job with progress and a report."""

from typing import Annotated

from fastapi import APIRouter, Depends, Response
from fastapi.responses import HTMLResponse
from pydantic import ConfigDict, Field

from service.api.fields import AxisId, JobId
from service.api.identifications import MeasuredIn
from service.api.jobs import JobOut, job_out
from service.api.services import Services, services
from service.operations.discrepancy.discrepancies import KIND
from service.operations.monitoring.axis_configuration import Number

router = APIRouter(prefix="/v1", tags=["discrepancies"])


class DiscrepancyIn(MeasuredIn):
    """What the axis is said to be, and what was measured of it: stored measurements, or peaks."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {"baseline": 'family = "lumped"\n[parameters]\n…', "measurements": {}, "hold_out_mm": [300.0, 600.0]}
            ]
        },
    )

    baseline: Annotated[str, Field(max_length=20_000, description="drive model as TOML")]
    hold_out_mm: Annotated[list[Number], Field(max_length=100)] = Field(
        default=[],
        description="positions that the fit does not see and is judged by; without any, two inner ones of five or "
        "more, else each of four preloads or more in turn",
    )


@router.post("/axes/{axis}/discrepancies", response_model=JobOut, status_code=202)
def start_discrepancy(
    axis: AxisId, body: DiscrepancyIn, response: Response, on: Annotated[Services, Depends(services)]
) -> JobOut:
    """Explain in the background where measurements and model part; the result is the JSON of `preload explain`."""
    arguments = body.model_dump(mode="json", by_alias=True)
    on.discrepancies.require(axis, arguments)
    row = on.jobs.submit(KIND, axis, arguments)
    response.headers["Location"] = f"/v1/jobs/{row.id}"
    return job_out(row)


@router.get("/axes/{axis}/discrepancies/{job}/report", response_class=HTMLResponse)
def get_discrepancy_report(axis: AxisId, job: JobId, on: Annotated[Services, Depends(services)]) -> HTMLResponse:
    """Return the report of a finished job: one page that holds all it shows, to be kept or sent on."""
    return HTMLResponse(on.discrepancies.report(axis, job))
