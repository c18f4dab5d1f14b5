"""``POST /v1/axes/{axis}/identifications``: stiffness and damping of the joints, as a job with progress."""

from typing import Annotated

from fastapi import APIRouter, Depends, Response

from service.api.fields import AxisId
from service.api.jobs import JobOut, job_out
from service.api.services import Services, services
from service.operations.identification.identification_job import IdentificationIn

router = APIRouter(prefix="/v1", tags=["identifications"])


@router.post("/axes/{axis}/identifications", response_model=JobOut, status_code=202)
def start_identification(
    axis: AxisId, body: IdentificationIn, response: Response, on: Annotated[Services, Depends(services)]
) -> JobOut:
    """Identify the joints of an axis in the background; the result is the JSON of `preload identify`."""
    on.identifications.require(axis, body)
    row = on.jobs.submit(on.identifications.kind, axis, body.model_dump(mode="json", by_alias=True))
    response.headers["Location"] = f"/v1/jobs/{row.id}"
    return job_out(row)
