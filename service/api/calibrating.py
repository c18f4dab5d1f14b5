"""On the way to a calibration: a drive model from catalogue data, a plan of what to measure, the fit as a job."""

from typing import Annotated, Literal

from fastapi import Query, Response
from pydantic import AliasPath, BaseModel, BeforeValidator, Field

from monitor_core.recordings.elements.units import to_millimetres
from service.api.access import needs
from service.api.jobs import JobOut, started
from service.api.services import ServicesOf, api_router
from service.operations.access.scopes import Scope
from service.operations.calibrating.catalogue import CatalogueIn, axis_proposal
from service.operations.calibrating.fit_job import CalibrationJobIn
from service.operations.calibrating.plan import PlanIn, calibration_plan
from service.operations.fields import AnswerModel, AxisId

router = api_router("calibrations")


class ExpectedFrequencyOut(BaseModel):
    """The first axial natural frequency at a position: as expected, and the band that it can be in."""

    position_mm: float
    frequency_hz: float
    lower_hz: float
    upper_hz: float


class DriveModelOut(BaseModel):
    """A drive model of catalogue data, to be sent with `PUT /v1/axes/{axis}`, and what it lets expect."""

    drive_model: Annotated[str, Field(description="TOML")]
    search_band_hz: tuple[float, float]
    usual_preload_n: Annotated[float, Field(description="that makers set in such a nut")]
    expected: list[ExpectedFrequencyOut]


class SettingOut(AnswerModel):
    """Where the table stands and which preload is set."""

    position_mm: Annotated[float, BeforeValidator(to_millimetres), Field(validation_alias="position")]
    preload_n: Annotated[float, Field(validation_alias="preload")]


class PreloadToSetOut(AnswerModel):
    """A preload of the plan as makers and mechanics know it."""

    preload_n: Annotated[float, Field(validation_alias="preload")]
    share_of_rating: Annotated[
        float | None, Field(validation_alias="share", description="of the dynamic load rating; null: not stated")
    ]
    level: Annotated[
        Literal["slight", "normal", "tight"] | None, Field(description="2.5, 5 or 7.5 % of the rating, the nearest")
    ]
    bolt_torque_nm: Annotated[
        float | None,
        Field(validation_alias="bolt_torque", description="at each bolt, thread dry; null: `bolt_mm` not stated"),
    ]


class SetMeasurementOut(AnswerModel):
    """A measurement whose preload was set on purpose."""

    measurement: Annotated[int, Field(validation_alias="id")]
    position_mm: float
    preload_n: Annotated[float, Field(validation_alias="set_preload_n")]
    status: Literal["open", "judged", "refused"]
    windows_accepted: Annotated[int, Field(validation_alias="n_accepted")]
    frequency_hz: Annotated[float | None, Field(description="null: the mode was not found, or windows are awaited")]
    refusal_reason: str | None


class CalibrationPlanOut(AnswerModel):
    """What to measure next for a calibration."""

    positions_mm: list[float]
    preloads_n: list[float]
    preloads: list[PreloadToSetOut] = Field(validation_alias="to_set")
    measured: list[SetMeasurementOut]
    holes: list[SettingOut] = Field(
        validation_alias=AliasPath("plan", "holes"), description="settings of the grid that were not measured"
    )
    next: SettingOut = Field(
        validation_alias=AliasPath("plan", "proposed"), description="after which the smallest loss is seen"
    )
    wished_loss_n: float
    smallest_loss_n: float | None = Field(
        validation_alias=AliasPath("plan", "smallest_loss"), description="predicted; null: not enough for a fit"
    )
    smallest_loss_then_n: float | None = Field(
        validation_alias=AliasPath("plan", "smallest_loss_then"), description="with the next setting, too"
    )
    measurements_left: int | None = Field(
        validation_alias=AliasPath("plan", "n_left"),
        description="until the wished loss is seen; null: the scatter of readings does not let it",
    )
    scatter_from: Literal["measured", "calibration", "model", "none"] = Field(
        validation_alias="source", description="how the scatter of a reading is known: none counts the holes alone"
    )


@router.get("/drive-model", dependencies=[needs(Scope.TRENDS_READ)])
def get_drive_model(query: Annotated[CatalogueIn, Query()]) -> DriveModelOut:
    """Return the drive model of what a catalogue states, and the band of its first axial natural frequency."""
    proposal = axis_proposal(query)
    mode = proposal.mode
    columns = zip(mode.position, mode.frequency, mode.lower, mode.upper, strict=True)
    return DriveModelOut(
        drive_model=proposal.drive_model,
        search_band_hz=proposal.search_band_hz,
        usual_preload_n=proposal.usual_preload,
        expected=[
            ExpectedFrequencyOut(position_mm=to_millimetres(x), frequency_hz=f, lower_hz=low, upper_hz=high)
            for x, f, low, high in columns
        ],
    )


@router.get("/axes/{axis}/calibration-plan", dependencies=[needs(Scope.TRENDS_READ)])
def get_calibration_plan(axis: AxisId, query: Annotated[PlanIn, Query()], services: ServicesOf) -> CalibrationPlanOut:
    """Say where to move and which preload to set next, how many are left, and which loss the calibration will see."""
    return CalibrationPlanOut.model_validate(calibration_plan(services.database, axis, query))


@router.post("/axes/{axis}/calibration-jobs", status_code=202, dependencies=[needs(Scope.CALIBRATIONS_WRITE)])
def start_calibration(axis: AxisId, body: CalibrationJobIn, response: Response, services: ServicesOf) -> JobOut:
    """Fit a calibration to stored measurements in the background; its number and its readings are in the result.

    As `POST …/calibrations` with `measurements`, which answers when it is done. Nothing is in force before it is
    activated.
    """
    return started(services.calibration_jobs.start(axis, body), response)
