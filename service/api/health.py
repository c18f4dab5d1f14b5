"""``/healthz``, ``/readyz`` and ``/metrics``."""

import shutil
from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from pydantic import BaseModel

from service.api.services import Services, services
from service.errors import BusyError

router = APIRouter(tags=["operations"])

#: Below this the next waveforms might not fit; better to say so than to fail at a write.
MINIMUM_FREE_BYTES = 200 * 2**20


class HealthOut(BaseModel):
    """The process answers."""

    status: str = "ok"


@router.get("/healthz", response_model=HealthOut)
async def healthz() -> HealthOut:
    """Tell that the process is alive, also when every worker thread is taken."""
    return HealthOut()


@router.get("/readyz", response_model=HealthOut)
def readyz(request: Request, on: Annotated[Services, Depends(services)]) -> HealthOut:
    """Tell that requests can be served: the database answers and the disk has room."""
    on.database.check()
    free = shutil.disk_usage(request.app.state.settings.data_dir).free
    if free < MINIMUM_FREE_BYTES:
        raise BusyError(
            f"the data folder has {free // 2**20} MiB left; at least {MINIMUM_FREE_BYTES // 2**20} are needed"
        )
    return HealthOut()


@router.get("/metrics", response_class=Response)
def metrics(on: Annotated[Services, Depends(services)]) -> Response:
    """Return the counters in the text format of Prometheus."""
    return Response(generate_latest(on.metrics.registry), media_type=CONTENT_TYPE_LATEST)
