"""``/v1/axes``: registration, configuration, and how each axis stands."""

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Response
from pydantic import BaseModel, ConfigDict

from service.api.http.body import JSON_TYPE
from service.api.services import Services, services
from service.json_types import JsonObject
from service.operations.fields import AxisId, Label, RequestModel
from service.operations.monitoring.axis_configuration import AxisConfiguration
from service.operations.monitoring.trend import AxisStatus

router = APIRouter(prefix="/v1", tags=["axes"])


class AxisIn(RequestModel):
    """An axis as an operator registers it."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "name": "Machining centre 3, X",
                    "configuration": {
                        "search_band_hz": [140, 230],
                        "excitation_source": "sensor",
                        "moving_mass_kg": 21.8,
                        "moving_mass_standard_uncertainty_kg": 0.5,
                    },
                }
            ]
        },
    )

    name: Label
    configuration: AxisConfiguration = AxisConfiguration()


class AxisOut(BaseModel):
    """An axis and how it stands."""

    id: str
    name: str
    created_at: datetime
    configuration: AxisConfiguration
    active_calibration: int | None
    state: str
    state_since: datetime | None
    last_measurement: JsonObject | None
    refused_windows: dict[str, int]
    uncharted: dict[str, int]
    open_alarms: int


class DamagedAxisOut(BaseModel):
    """An axis of which something stored cannot be read, and what to do about it. It takes no windows; others do."""

    id: str
    name: str
    detail: str


class AxesOut(BaseModel):
    """All axes."""

    axes: list[AxisOut]
    damaged: list[DamagedAxisOut]


def axis_out(status: AxisStatus) -> AxisOut:
    """Return an axis on the wire."""
    row = status.row
    return AxisOut(
        id=row.id,
        name=row.name,
        created_at=row.created_at,
        configuration=status.configuration,
        active_calibration=row.active_calibration_id,
        state=status.state,
        state_since=status.since,
        last_measurement=status.last_measurement,
        refused_windows=row.refused_windows,
        uncharted=row.uncharted,
        open_alarms=status.open_alarms,
    )


def axes_out(on: Services) -> AxesOut:
    """Return all axes on the wire; what is wrong with the documents of one keeps no other from being shown."""
    fleet = on.trend.fleet()
    damaged = [DamagedAxisOut(id=axis.id, name=axis.name, detail=axis.detail) for axis in fleet.damaged]
    return AxesOut(axes=[axis_out(status) for status in fleet.axes], damaged=damaged)


@router.put("/axes/{axis}", responses={201: {"model": AxisOut, "description": "registered"}})
def put_axis(axis: AxisId, body: AxisIn, response: Response, on: Annotated[Services, Depends(services)]) -> AxisOut:
    """Register an axis, or change its name and configuration."""
    _, created = on.axes.register(axis, body.name, body.configuration)
    response.status_code = 201 if created else 200
    return axis_out(on.trend.status(axis))


@router.get("/axes", response_model=AxesOut)
def list_axes(on: Annotated[Services, Depends(services)]) -> Response:
    """List the axes and how each stands."""
    # A response of our own: FastAPI would validate what is valid, and a fleet is large.
    return Response(axes_out(on).model_dump_json(), media_type=JSON_TYPE)


@router.get("/axes/{axis}", response_model=AxisOut)
def get_axis(axis: AxisId, on: Annotated[Services, Depends(services)]) -> AxisOut:
    """Return one axis and how it stands."""
    return axis_out(on.trend.status(axis))
