"""``/v1/axes``: registration, configuration, and how each axis stands."""

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field, JsonValue

from service.api.access import needs
from service.api.http.body import JSON_TYPE
from service.api.services import Services, services
from service.documents.consequences import Kind
from service.documents.said import in_english
from service.json_types import JsonObject
from service.operations.access.scopes import Scope
from service.operations.fields import AxisId, Label, RequestModel
from service.operations.monitoring.axes import settings_tag
from service.operations.monitoring.axis_configuration import AxisConfiguration
from service.operations.monitoring.consequences import outlook_of
from service.operations.monitoring.trend import AxisStatus, machines_of
from service.store.rejudged import Stale

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


class StaleOut(BaseModel):
    """What is said is about to be replaced: the job that judges the history anew, and by which calibration."""

    job: str
    calibration: int


class PreloadLeftOut(BaseModel):
    """The share of the commissioned preload that is left; an open end of its interval is null."""

    share: float
    interval_95: tuple[float | None, float | None]


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
    preload_left: Annotated[
        PreloadLeftOut | None, Field(description="of the commissioned preload; null if it or the preload is not known")
    ]
    stale: Annotated[StaleOut | None, Field(description="while the history is judged anew: by which job")]
    archived_at: datetime | None


class DamagedAxisOut(BaseModel):
    """An axis of which something stored cannot be read, and what to do about it. It takes no windows; others do."""

    id: str
    name: str
    detail: str


class AxesQuery(RequestModel):
    """Which axes."""

    machine: Label | None = Field(default=None, description="only those of this machine")
    archived: bool = Field(default=False, description="archived ones, too")


class MachineOut(BaseModel):
    """A machine, and how the worst of its axes stands."""

    machine: str
    place: str | None
    state: str
    open_alarms: int
    axes: list[str]


class MachinesOut(BaseModel):
    """All machines that axes are of, in order of name."""

    machines: list[MachineOut]


class AxesOut(BaseModel):
    """All axes."""

    axes: list[AxisOut]
    damaged: list[DamagedAxisOut]


#: What is shown where nothing else is asked for.
_ALL = AxesQuery()


def axis_out(status: AxisStatus) -> AxisOut:
    """Return an axis on the wire."""
    row, left = status.row, status.preload_left
    return AxisOut(
        id=row.id,
        name=row.name,
        created_at=row.created_at,
        configuration=status.configuration,
        active_calibration=row.active_calibration_id,
        state=status.state,
        state_since=status.since,
        last_measurement=None if status.last_measurement is None else status.last_measurement.document(),
        refused_windows=row.refused_windows,
        uncharted=row.uncharted,
        open_alarms=status.open_alarms,
        preload_left=None if left is None else PreloadLeftOut(share=left.share, interval_95=left.interval_95),
        stale=stale_out(status.stale),
        archived_at=row.archived_at,
    )


def stale_out(stale: Stale | None) -> StaleOut | None:
    """Return on the wire what is about to replace what is said."""
    return None if stale is None else StaleOut(job=stale.job, calibration=stale.calibration)


def axes_out(on: Services, query: AxesQuery = _ALL) -> AxesOut:
    """Return the axes on the wire; what is wrong with the documents of one keeps no other from being shown."""
    fleet = on.trend.fleet(query.machine, archived=query.archived)
    damaged = [DamagedAxisOut(id=axis.id, name=axis.name, detail=axis.detail) for axis in fleet.damaged]
    return AxesOut(axes=[axis_out(status) for status in fleet.axes], damaged=damaged)


@router.put(
    "/axes/{axis}",
    responses={201: {"model": AxisOut, "description": "registered"}},
    dependencies=[needs(Scope.CALIBRATIONS_WRITE)],
)
def put_axis(
    axis: AxisId, body: AxisIn, request: Request, response: Response, on: Annotated[Services, Depends(services)]
) -> AxisOut:
    """Register an axis, or change its name and configuration; `If-Match` guards against a change in between."""
    _, created = on.axes.register(axis, body.name, body.configuration, if_match=request.headers.get("if-match"))
    response.status_code = 201 if created else 200
    return _tagged(axis_out(on.trend.status(axis)), response)


def _tagged(axis: AxisOut, response: Response) -> AxisOut:
    """Name the settings that an answer holds, for `If-Match`."""
    response.headers["ETag"] = f'"{settings_tag(axis.name, axis.configuration)}"'
    return axis


class ChangeOut(BaseModel):
    """A setting that would be changed."""

    setting: str
    before: JsonValue
    after: JsonValue


class ConsequenceOut(BaseModel):
    """What a setting would change, and what its numbers rest on."""

    setting: str
    kind: Kind
    sentence: str


class ConsequencesOut(BaseModel):
    """What a name and configuration would change; nothing is stored."""

    axis: str
    changes: list[ChangeOut]
    consequences: list[ConsequenceOut]


@router.post("/axes/{axis}/consequences", dependencies=[needs(Scope.TRENDS_READ)])
def post_consequences(axis: AxisId, body: AxisIn, on: Annotated[Services, Depends(services)]) -> ConsequencesOut:
    """Say what a configuration would change before it is sent: false alarms against delay, silences, averages, band."""
    outlook = outlook_of(on.database, axis, body.name, body.configuration)
    return ConsequencesOut(
        axis=axis,
        changes=[ChangeOut(setting=it.setting, before=it.before, after=it.after) for it in outlook.changes],
        consequences=[
            ConsequenceOut(setting=it.setting, kind=it.kind, sentence=in_english(it.said))
            for it in outlook.consequences
        ],
    )


@router.get("/axes", response_model=AxesOut, dependencies=[needs(Scope.TRENDS_READ)])
def list_axes(query: Annotated[AxesQuery, Query()], on: Annotated[Services, Depends(services)]) -> Response:
    """List the axes and how each stands."""
    # A response of our own: FastAPI would validate what is valid, and a fleet is large.
    return Response(axes_out(on, query).model_dump_json(), media_type=JSON_TYPE)


@router.get("/machines", dependencies=[needs(Scope.TRENDS_READ)])
def list_machines(on: Annotated[Services, Depends(services)]) -> MachinesOut:
    """List the machines with their axes, and how the worst of these stands."""
    return MachinesOut(
        machines=[
            MachineOut(
                machine=machine.name,
                place=machine.place,
                state=machine.state,
                open_alarms=sum(axis.open_alarms for axis in machine.axes),
                axes=[axis.row.id for axis in machine.axes],
            )
            for machine in machines_of(on.trend.fleet().axes)
        ]
    )


@router.post("/axes/{axis}/archive", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def archive_axis(axis: AxisId, on: Annotated[Services, Depends(services)]) -> AxisOut:
    """Hide an axis from lists; it takes no windows any more. Nothing is deleted, and it can be taken back."""
    on.axes.archive(axis, archived=True)
    return axis_out(on.trend.status(axis))


@router.delete("/axes/{axis}/archive", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def take_axis_back(axis: AxisId, on: Annotated[Services, Depends(services)]) -> AxisOut:
    """Take an axis back that was archived."""
    on.axes.archive(axis, archived=False)
    return axis_out(on.trend.status(axis))


@router.get("/axes/{axis}", dependencies=[needs(Scope.TRENDS_READ)])
def get_axis(axis: AxisId, response: Response, on: Annotated[Services, Depends(services)]) -> AxisOut:
    """Return one axis and how it stands; `ETag` names its settings."""
    return _tagged(axis_out(on.trend.status(axis)), response)
