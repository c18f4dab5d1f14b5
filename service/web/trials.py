"""Forms that begin and end a trial, and what pages say of one."""

from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter, Depends, Response

from service.api.access import needs
from service.api.services import Services, services
from service.operations.access.scopes import Scope
from service.operations.monitoring.trend import AxisStatus
from service.operations.trial.story import EVERY, N_MEASUREMENTS, N_WINDOWS
from service.operations.trial.trial import TRIAL_MACHINE
from service.web.site import done

router = APIRouter(include_in_schema=False)


@dataclass(frozen=True, slots=True)
class Trial:
    """What the fleet says of trials: what one is made of, and how far the one is that is being made."""

    n_measurements: int
    n_windows: int
    every_days: int
    axis: str | None = None  # that is being made
    done: int = 0
    total: int | None = None


def trial_of(on: Services) -> Trial:
    """Return what the fleet says of trials."""
    job = on.trials.under_way()
    if job is None:
        return Trial(N_MEASUREMENTS, N_WINDOWS, EVERY.days)
    return Trial(N_MEASUREMENTS, N_WINDOWS, EVERY.days, str(job.arguments["axis"]), job.done, job.total)


def is_trial(status: AxisStatus) -> bool:
    """Tell whether an axis is simulated, to try the service with."""
    return status.configuration.machine == TRIAL_MACHINE


@router.post("/trials", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def begin_trial(on: Annotated[Services, Depends(services)]) -> Response:
    """Begin to make a trial axis."""
    on.trials.start()
    return done("/", "trial-begun")


@router.post("/trials/end", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def end_trial(on: Annotated[Services, Depends(services)]) -> Response:
    """Put the trial away."""
    on.trials.end()
    return done("/", "trial-ended")
