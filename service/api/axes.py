"""``/v1/axes``: registration, configuration, how each axis stands, and what was done to it."""

from datetime import datetime
from typing import Annotated

from fastapi import Query, Request, Response
from pydantic import AliasPath, BaseModel, BeforeValidator, ConfigDict, Field, JsonValue

from service.api.access import needs
from service.api.http.body import JSON_TYPE
from service.api.services import ServicesOf, api_router
from service.documents.axis_sentence import standing
from service.documents.consequences import Kind
from service.documents.said import in_english
from service.documents.stored_measurement import StoredMeasurement
from service.json_types import JsonObject
from service.operations.access.scopes import Scope
from service.operations.fields import AnswerModel, AxisId, Label, RequestModel, ViewModel
from service.operations.monitoring import maintenance
from service.operations.monitoring.axes import settings_tag
from service.operations.monitoring.axis_configuration import AxisConfiguration
from service.operations.monitoring.consequences import outlook_of
from service.operations.monitoring.maintenance import MaintenanceIn, Work
from service.operations.monitoring.standing import MOST_TOLD, facts_of
from service.operations.monitoring.trend import machines_of

router = api_router("axes")
maintenance_router = api_router("maintenance")


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
        }
    )

    name: Label
    configuration: AxisConfiguration = AxisConfiguration()


class StaleOut(AnswerModel):
    """What is said is about to be replaced: the job that judges the history anew, and by which calibration."""

    job: str
    calibration: int


class PreloadLeftOut(AnswerModel):
    """The share of the commissioned preload that is left; an open end of its interval is null."""

    share: float
    interval_95: tuple[float | None, float | None]


class LostMotionNowOut(AnswerModel):
    """The newest lost motion of an axis, and how its chart stands."""

    measured_at: datetime
    reversal_value_um: float
    reversal_value_interval_95_um: tuple[float, float]
    state: str
    valid_until: Annotated[
        datetime | None,
        Field(description="without a further reading the state is unknown from then on; null: it is, or an alarm"),
    ]


def _document(measured: StoredMeasurement | JsonObject | None) -> JsonObject | None:
    return measured.document() if isinstance(measured, StoredMeasurement) else measured


class AxisOut(ViewModel):
    """An axis and how it stands."""

    id: str
    name: str
    created_at: datetime
    configuration: AxisConfiguration
    active_calibration: Annotated[int | None, Field(validation_alias=AliasPath("row", "active_calibration_id"))]
    state: str
    state_since: Annotated[datetime | None, Field(validation_alias="since")]
    last_measurement: Annotated[JsonObject | None, BeforeValidator(_document)]
    refused_windows: dict[str, int]
    uncharted: dict[str, int]
    open_alarms: int
    preload_left: Annotated[
        PreloadLeftOut | None, Field(description="of the commissioned preload; null if it or the preload is not known")
    ]
    lost_motion: Annotated[LostMotionNowOut | None, Field(description="null: never measured")]
    stale: Annotated[StaleOut | None, Field(description="while the history is judged anew: by which job")]
    archived_at: datetime | None


class DamagedAxisOut(AnswerModel):
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


class ChangeOut(AnswerModel):
    """A setting that would be changed."""

    setting: str
    before: JsonValue
    after: JsonValue


class ConsequenceOut(AnswerModel):
    """What a setting would change, and what its numbers rest on."""

    setting: str
    kind: Kind
    sentence: Annotated[str, BeforeValidator(in_english), Field(validation_alias="said")]


class ConsequencesOut(BaseModel):
    """What a name and configuration would change; nothing is stored."""

    axis: str
    changes: list[ChangeOut]
    consequences: list[ConsequenceOut]


class PutQuery(RequestModel):
    """How it is put."""

    dry_run: bool = Field(default=False, description="only say what it would change; nothing is stored")


@router.put(
    "/axes/{axis}",
    responses={201: {"model": AxisOut, "description": "registered"}},
    dependencies=[needs(Scope.CALIBRATIONS_WRITE)],
)
def put_axis(
    axis: AxisId,
    body: AxisIn,
    query: Annotated[PutQuery, Query()],
    request: Request,
    response: Response,
    services: ServicesOf,
) -> AxisOut | ConsequencesOut:
    """Register an axis, or change its name and configuration; `If-Match` guards against a change in between.

    With `dry_run` nothing is stored: the answer says what would change of a registered axis, false alarms against
    delay, silences, averages and band.
    """
    if query.dry_run:
        outlook = outlook_of(services.database, axis, body.name, body.configuration)
        return ConsequencesOut(axis=axis, changes=outlook.changes, consequences=outlook.consequences)
    _, created = services.axes.register(axis, body.name, body.configuration, if_match=request.headers.get("if-match"))
    response.status_code = 201 if created else 200
    return _tagged(AxisOut.model_validate(services.trend.status(axis)), response)


def _tagged(axis: AxisOut, response: Response) -> AxisOut:
    """Name the settings that an answer holds, for `If-Match`."""
    response.headers["ETag"] = f'"{settings_tag(axis.name, axis.configuration)}"'
    return axis


@router.get("/axes", response_model=AxesOut, dependencies=[needs(Scope.TRENDS_READ)])
def list_axes(query: Annotated[AxesQuery, Query()], services: ServicesOf) -> Response:
    """List the axes and how each stands."""
    # A response of our own: FastAPI would validate what is valid, and a fleet is large.
    fleet = services.trend.fleet(query.machine, archived=query.archived)
    out = AxesOut(axes=fleet.axes, damaged=fleet.damaged)
    return Response(out.model_dump_json(), media_type=JSON_TYPE)


@router.get("/machines", dependencies=[needs(Scope.TRENDS_READ)])
def list_machines(services: ServicesOf) -> MachinesOut:
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
            for machine in machines_of(services.trend.fleet().axes)
        ]
    )


@router.post("/axes/{axis}/archive", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def archive_axis(axis: AxisId, services: ServicesOf) -> AxisOut:
    """Hide an axis from lists; it takes no windows any more. Nothing is deleted, and it can be taken back."""
    services.axes.archive(axis, archived=True)
    return AxisOut.model_validate(services.trend.status(axis))


@router.delete("/axes/{axis}/archive", dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def take_axis_back(axis: AxisId, services: ServicesOf) -> AxisOut:
    """Take an axis back that was archived."""
    services.axes.archive(axis, archived=False)
    return AxisOut.model_validate(services.trend.status(axis))


@router.get("/axes/{axis}", dependencies=[needs(Scope.TRENDS_READ)])
def get_axis(axis: AxisId, response: Response, services: ServicesOf) -> AxisOut:
    """Return one axis and how it stands; `ETag` names its settings."""
    return _tagged(AxisOut.model_validate(services.trend.status(axis)), response)


class StandingOut(BaseModel):
    """How an axis stands and what to do next, in the sentences of its page."""

    axis: str
    state: str
    sentence: str
    next_step: str


@router.get("/axes/{axis}/standing", dependencies=[needs(Scope.TRENDS_READ)])
def get_standing(axis: AxisId, services: ServicesOf) -> StandingOut:
    """Say how an axis stands, and what to do next."""
    with services.database.at_one_moment():
        status, overview, history = (
            services.trend.status(axis),
            services.calibrations.overview(axis),
            services.history.of(axis),
        )
        alarms, lost_motion = services.alarms.list(axis, None, None, MOST_TOLD), services.readings.standing(axis)
    stands = standing(facts_of(status, overview, alarms, history, lost_motion))
    sentence, next_step = in_english(stands.sentence), in_english(stands.next_step)
    return StandingOut(axis=axis, state=status.state, sentence=sentence, next_step=next_step)


class MaintenanceOut(AnswerModel):
    """An entry of the maintenance log."""

    id: int
    at: datetime
    entered_at: datetime
    who: str
    kind: Work
    note: str
    set_preload_n: float | None
    corrects: Annotated[int | None, Field(description="the entry that it takes the place of")]


class MaintenanceLogOut(BaseModel):
    """All entries by when the work was done; one that another one `corrects` does not hold any more."""

    axis: str
    entries: list[MaintenanceOut]


@maintenance_router.post(
    "/axes/{axis}/maintenance",
    status_code=201,
    responses={200: {"model": MaintenanceOut, "description": "this entry was there already"}},
    dependencies=[needs(Scope.ALARMS_ACK)],
)
def post_maintenance(axis: AxisId, body: MaintenanceIn, response: Response, services: ServicesOf) -> MaintenanceOut:
    """Say what was done to an axis. A new nut or screw begins the baseline anew from then, however long ago."""
    row, is_new = maintenance.enter(services.database, axis, body)
    response.status_code = 201 if is_new else 200
    return MaintenanceOut.model_validate(row)


@maintenance_router.get("/axes/{axis}/maintenance", dependencies=[needs(Scope.TRENDS_READ)])
def get_maintenance(axis: AxisId, services: ServicesOf) -> MaintenanceLogOut:
    """Return the maintenance log of an axis."""
    return MaintenanceLogOut(axis=axis, entries=maintenance.log_of(services.database, axis))
