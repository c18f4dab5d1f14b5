"""``/healthz``, ``/readyz`` and ``/metrics``."""

import asyncio
import logging
import os
import shutil
import tempfile
from pathlib import Path

from fastapi import Request, Response
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from pydantic import BaseModel

from monitor_core.trend import TrendStatus
from service.api.access import needs
from service.api.services import Services, ServicesOf, api_router
from service.errors import BusyError, StorageError
from service.observability import AxisReading, FleetGauges, ReceiverReading
from service.operations.access.scopes import Scope
from service.operations.monitoring.trend import AxisStatus
from service.store.database import Database

log = logging.getLogger(__name__)
router = api_router("operations", prefix="", reads_bodies=True)

#: Below this the next waveforms might not fit; better to say so than to fail at a write.
MINIMUM_FREE_BYTES = 200 * 2**20
#: What of the data folder is written to besides the database.
WRITTEN_FOLDERS = ("raw", "recordings", "reports")


class HealthOut(BaseModel):
    """The process answers."""

    status: str = "ok"


@router.get("/healthz")
async def healthz() -> HealthOut:
    """Tell that the process is alive, also when every worker thread is taken."""
    return HealthOut()


@router.get("/readyz")
async def readyz(request: Request, services: ServicesOf) -> HealthOut:
    """Tell that windows can be stored: the database and the disk take what is written, and there is room."""
    # Not in a worker thread of the requests: all of them may be waiting for the database.
    await asyncio.to_thread(_require_ready, services.database, request.app.state.settings.data_dir)
    return HealthOut()


def _require_ready(database: Database, data_dir: Path) -> None:
    database.check()
    _require_room(data_dir)
    for folder in (data_dir / name for name in WRITTEN_FOLDERS):
        if os.path.lexists(folder):  # it is made when it is needed, and may be a volume of its own
            _require_room(folder)


def _require_room(folder: Path) -> None:
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"ready")
            file.flush()
        free = shutil.disk_usage(folder).free
    except OSError as error:
        raise StorageError(f"the data folder {folder} cannot be written: {error.strerror}") from error
    if free < MINIMUM_FREE_BYTES:
        raise BusyError(
            f"the data folder {folder} has {free // 2**20} MiB left; at least {MINIMUM_FREE_BYTES // 2**20} are needed"
        )


@router.get("/metrics", response_class=Response, dependencies=[needs(Scope.TRENDS_READ)])
def metrics(services: ServicesOf) -> Response:
    """Return the counters, and how axes and jobs stand, in the text format of Prometheus.

    Without the database it is the counters alone: those are needed most when something is wrong.
    """
    counted = generate_latest(services.metrics.registry)
    try:
        counted += _standing(services)
    except (BusyError, StorageError) as error:
        log.warning("the metrics lack how axes, jobs and receivers stand: %s", error)
    return Response(counted, media_type=CONTENT_TYPE_LATEST)


def _standing(services: Services) -> bytes:
    fleet, now = services.trend.fleet(), CollectorRegistry()
    readings = [_reading(axis) for axis in fleet.axes]
    receivers = [
        ReceiverReading(each.row.name, each.failing_since is not None, each.n_waiting)
        for each in services.dispatcher.standings()
    ]
    states = [str(state) for state in TrendStatus]
    now.register(FleetGauges(states, readings, len(fleet.damaged), services.jobs.unfinished(), receivers))
    return generate_latest(now)


def _reading(axis: AxisStatus) -> AxisReading:
    return AxisReading(
        axis.row.id,
        axis.state,
        axis.open_alarms,
        axis.row.last_measured_at,
        axis.last.preload_n,
        axis.last.interval_95_n or (None, None),
    )
