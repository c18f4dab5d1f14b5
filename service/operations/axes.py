"""Registration of axes and what an operator may set on one."""

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from service.clock import now
from service.store import axes
from service.store.database import Database
from service.store.tables import AxisRow

Positive = Annotated[float, Field(gt=0)]


class AxisConfiguration(BaseModel):
    """What an operator states about an axis. It is sent, stored and shown in this one form."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    search_band_hz: tuple[Positive, Positive] | None = Field(
        default=None, description="where the axial mode is looked for as long as no calibration says it better"
    )
    excitation_source: Literal["sensor", "drive"] = "sensor"
    sample_rate_hz: Positive | None = Field(default=None, description="windows at another rate are refused")
    windows_per_measurement: int = Field(
        default=15, ge=2, le=1000, description="a measurement is judged as soon as so many windows were accepted"
    )
    minimum_averages: int = Field(default=8, ge=2, le=1000, description="fewer windows are never judged")
    position_span_limit_mm: Positive = 20.0
    moving_mass_kg: Positive | None = Field(default=None, description="table, nut and what moves with them")
    moving_mass_standard_uncertainty_kg: Annotated[float, Field(ge=0)] = 0.0
    measurements_per_year: Positive = 365.0
    false_alarms_per_year: Positive = 1.0
    baseline_size: int = Field(default=20, ge=5, le=1000, description="measurements that make the baseline")
    silent_after_hours: Positive = Field(
        default=168.0, description="without an accepted measurement for so long the state is unknown"
    )

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.search_band_hz is not None and not self.search_band_hz[0] < self.search_band_hz[1]:
            raise ValueError(f"search_band_hz must be [low, high] with low < high; got {list(self.search_band_hz)}")
        if self.minimum_averages > self.windows_per_measurement:
            raise ValueError(
                f"minimum_averages ({self.minimum_averages}) must not exceed "
                f"windows_per_measurement ({self.windows_per_measurement})"
            )
        return self


class Axes:
    """Register, change and list axes."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def register(self, axis_id: str, name: str, configuration: AxisConfiguration) -> tuple[AxisRow, bool]:
        """Register an axis or change its configuration; tell whether it is new."""
        with self._database.write() as session:
            row = session.get(AxisRow, axis_id)
            created = row is None
            if row is None:
                row = AxisRow(id=axis_id, created_at=now(), active_calibration_id=None, monitor_state=None)
                session.add(row)
            row.name = name
            row.configuration = configuration.model_dump(mode="json")
            return row, created

    def get(self, axis_id: str) -> AxisRow:
        """Return an axis."""
        with self._database.read() as session:
            return axes.get_axis(session, axis_id)

    def list(self) -> list[AxisRow]:
        """Return all axes."""
        with self._database.read() as session:
            return axes.list_axes(session)
