"""What an identification or an explanation is asked to look at, as it is sent and as its job keeps it."""

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from monitor_core.fitting.observations import ModalObservation
from monitor_core.models import DriveConditions
from monitor_core.recordings.elements.units import metres
from service.operations.fields import Moment, Number


class MeasurementRange(BaseModel):
    """Stored measurements whose preload was set on purpose, by time."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    start: Moment | None = Field(default=None, alias="from", description="inclusive")
    end: Moment | None = Field(default=None, alias="to", description="exclusive")


class PeakIn(BaseModel):
    """One measured peak of the table's receptance."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    position_mm: Annotated[Number, Field(ge=-100_000, le=100_000)]
    frequency_hz: Annotated[Number, Field(gt=0, le=1e6)]
    frequency_standard_uncertainty_hz: Annotated[Number, Field(gt=0, le=1e6)] | None = None
    amplitude_m_per_n: Annotated[Number, Field(gt=0, le=1)] | None = None
    preload_n: Annotated[Number, Field(gt=0, le=1e7)] | None = None
    payload_kg: Annotated[Number, Field(ge=0, le=1e6)] | None = None

    def to_core(self) -> ModalObservation:
        """Return the core's record, in SI units."""
        return ModalObservation(
            DriveConditions(metres(self.position_mm), self.preload_n, self.payload_kg or 0.0),
            self.frequency_hz,
            self.frequency_standard_uncertainty_hz,
            amplitude=self.amplitude_m_per_n,
        )


AccelerometerPlace = Annotated[
    Literal["table", "nut"],
    Field(description="where it sat on the measurements; without it where the model explains them better"),
]


class AnalysisArguments(BaseModel):
    """What was measured: stored measurements, or peaks."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    measurements: MeasurementRange | None = None
    peaks: Annotated[list[PeakIn] | None, Field(min_length=1, max_length=1000)] = None
    hold_out_mm: Annotated[list[Number], Field(max_length=100)] = []
    accelerometer: AccelerometerPlace | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.measurements is None) == (self.peaks is None):
            raise ValueError("exactly one of measurements and peaks is expected; got both or none")
        if self.accelerometer is not None and self.measurements is None:
            raise ValueError("accelerometer goes with measurements; peaks are of the table")
        return self

    @property
    def hold_out(self) -> tuple[float, ...]:
        """Positions to be held out. [m]."""
        return tuple(metres(position) for position in self.hold_out_mm)
