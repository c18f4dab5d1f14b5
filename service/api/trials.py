"""``/v1/trials``: an axis with a year behind it, simulated, for who has no machine at hand."""

from typing import Annotated

from fastapi import APIRouter, Depends, Response

from service.api.access import needs
from service.api.jobs import JobOut, job_out
from service.api.services import Services, services
from service.operations.access.scopes import Scope

router = APIRouter(prefix="/v1", tags=["jobs"])


@router.post("/trials", status_code=202, dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def start_trial(response: Response, on: Annotated[Services, Depends(services)]) -> JobOut:
    """Make a simulated axis with a year of history, as a job; `arguments.axis` names it, its archive ends the trial."""
    row = on.trials.start()
    response.headers["Location"] = f"/v1/jobs/{row.id}"
    return job_out(row)
