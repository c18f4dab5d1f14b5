"""``POST /v1/axes/{axis}/identifications``: stiffness and damping of the joints, as a job with progress."""

from typing import Annotated, Literal, Self

from fastapi import APIRouter, Depends, Response
from pydantic import ConfigDict, Field, model_validator

from service.api.calibrations import MeasurementRange
from service.api.fields import AxisId, RequestModel
from service.api.jobs import JobOut, job_out
from service.api.services import Services, services
from service.operations.monitoring.axis_configuration import Number

router = APIRouter(prefix="/v1", tags=["identifications"])


class PeakIn(RequestModel):
    """One measured peak of the table's receptance."""

    position_mm: Annotated[Number, Field(ge=-100_000, le=100_000)]
    frequency_hz: Annotated[Number, Field(gt=0, le=1e6)]
    frequency_standard_uncertainty_hz: Annotated[Number, Field(gt=0, le=1e6)] | None = None
    amplitude_m_per_n: Annotated[Number, Field(gt=0, le=1)] | None = None
    preload_n: Annotated[Number, Field(gt=0, le=1e7)] | None = None
    payload_kg: Annotated[Number, Field(ge=0, le=1e6)] | None = None


AccelerometerPlace = Annotated[
    Literal["table", "nut"],
    Field(description="where it sat on the measurements; without it where the model explains them better"),
]


class PredictionIn(RequestModel):
    """A calibration to be predicted from the joints: of which mode, and at which preload they were measured."""

    mode_hz: Annotated[
        tuple[Annotated[Number, Field(gt=0, le=1e6)], Annotated[Number, Field(gt=0, le=1e6)]],
        Field(description="holds the mode that will be monitored, alone at every position and preload"),
    ]
    preload_n: Annotated[Number, Field(gt=0, le=1e7)]
    preload_standard_uncertainty_n: Annotated[Number, Field(gt=0, le=1e7)]
    scatter_hz: Annotated[Number, Field(gt=0, le=1e6, description="between measurements of one setting")]
    excitation_source: Literal["sensor", "drive"] = "sensor"


class MeasuredIn(RequestModel):
    """What was measured of an axis: stored measurements, or peaks."""

    measurements: MeasurementRange | None = None
    peaks: Annotated[list[PeakIn] | None, Field(min_length=1, max_length=1000)] = None
    accelerometer: AccelerometerPlace | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.measurements is None) == (self.peaks is None):
            raise ValueError("exactly one of measurements and peaks is expected; got both or none")
        if self.accelerometer is not None and self.measurements is None:
            raise ValueError("accelerometer goes with measurements; peaks are of the table")
        return self


class IdentificationIn(MeasuredIn):
    """Whose joints, and from what: stored measurements, or peaks."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {"model": 'family = "receptance"\n[parameters]\n…', "measurements": {}, "hold_out_mm": [500.0]}
            ]
        },
    )

    model: Annotated[str, Field(max_length=20_000, description="drive model as TOML")]
    hold_out_mm: Annotated[list[Number], Field(max_length=100)] = Field(
        default=[], description="positions that the fit does not see and is judged by; without any, each in turn"
    )
    limits: dict[str, tuple[Number, Number]] = Field(
        default={}, max_length=20, description="lower and upper limit of a free joint, by its name in the model"
    )
    objective: Literal["weighted", "eq-26"] = "weighted"
    prediction: PredictionIn | None = Field(default=None, description="also predict k1…k4, to be used as a prior")
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 1


@router.post("/axes/{axis}/identifications", response_model=JobOut, status_code=202)
def start_identification(
    axis: AxisId, body: IdentificationIn, response: Response, on: Annotated[Services, Depends(services)]
) -> JobOut:
    """Identify the joints of an axis in the background; the result is the JSON of `preload identify`."""
    arguments = body.model_dump(mode="json", by_alias=True)
    on.identifications.require(axis, arguments)
    row = on.jobs.submit("identification", axis, arguments)
    response.headers["Location"] = f"/v1/jobs/{row.id}"
    return job_out(row)
