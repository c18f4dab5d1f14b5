"""What an operator states about an axis, and the records of the core that it becomes."""

from collections.abc import Iterator
from contextlib import suppress
from copy import deepcopy
from datetime import timedelta
from functools import lru_cache, reduce
from operator import getitem
from typing import Annotated, Any, Literal, Self

from pydantic import (
    Field,
    TypeAdapter,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)
from sqlalchemy.orm import Session

from monitor_core.errors import MonitorCoreError
from monitor_core.modal import ModeGate
from monitor_core.pipeline import AxisSettings
from monitor_core.preload import DriveLaw
from monitor_core.quality import QualityGate
from monitor_core.recording import ExcitationSource, Visit
from monitor_core.recordings.elements.units import metres
from monitor_core.trend import (
    LEAST_MEASUREMENTS,
    LEAST_RATE,
    MOST_BASELINE,
    MOST_MEASUREMENTS,
    MOST_RATE,
    DetectorDesign,
    DetectorSettings,
    LossDirection,
    design_detector,
)
from monitor_core.uncertainty import Estimate, Interval
from service.documents.stored import StoredRecord
from service.errors import DocumentDamagedError
from service.json_types import Json, JsonObject
from service.operations.fields import (
    HOURS,
    LENGTH_MM,
    SECONDS,
    Frequency,
    Label,
    Mass,
    MassUncertainty,
    Moment,
    Number,
    RequestModel,
    SampleRate,
    SetPreload,
)
from service.store.axes import list_axes
from service.store.tables import AxisRow


class AxisConfiguration(RequestModel):
    """What an operator states about an axis. It is sent, stored and shown in this one form."""

    search_band_hz: tuple[Frequency, Frequency] | None = Field(
        default=None, description="where the axial mode is looked for as long as no calibration says it better"
    )
    excitation_source: Literal["sensor", "drive", "drive-by-reference"] = "sensor"
    sample_rate_hz: SampleRate | None = Field(default=None, description="windows at another rate are refused")
    windows_per_measurement: int = Field(
        default=15, ge=2, le=1000, description="a measurement is judged as soon as so many windows were accepted"
    )
    measurement_timeout_s: Annotated[Number, SECONDS] = Field(
        default=600.0, description="a measurement that no window came to for so long is judged with what it has"
    )
    measurement_pause_s: Annotated[Number, SECONDS] | None = Field(
        default=None,
        description="a window that began so long after the one before of its name had ended begins another "
        "measurement; unset: as measurement_timeout_s, at least 600",
    )
    minimum_averages: int = Field(
        default=2, ge=2, le=1000, description="fewer windows are never judged; more may be needed, by their coherence"
    )
    position_span_limit_mm: Annotated[Number, LENGTH_MM] = 20.0
    moving_mass_kg: Mass | None = Field(default=None, description="table, nut and what moves with them")
    moving_mass_standard_uncertainty_kg: MassUncertainty | None = Field(
        default=None, description="goes with moving_mass_kg"
    )
    measurements_per_year: Number = Field(default=365.0, ge=LEAST_MEASUREMENTS, le=MOST_MEASUREMENTS)
    false_alarms_per_year: Number = Field(default=1.0, ge=LEAST_RATE, le=MOST_RATE)
    baseline_size: int = Field(
        default=20, ge=5, le=MOST_BASELINE, description="sessions that make the baseline; those of a day are one"
    )
    baseline_days: Number = Field(default=14.0, ge=1e-3, le=1000, description="time that the baseline spans at least")
    axis_type: Annotated[str, Field(min_length=1, max_length=200)] | None = Field(
        default=None, description="axes of one type lend a young one what it cannot know yet"
    )
    machine: Label | None = Field(default=None, description="name of the machine that the axis is of")
    machine_place: Label | None = Field(default=None, description="where the machine stands; goes with machine")
    commissioned_preload_n: SetPreload | None = Field(
        default=None, description="preload that the axis was put into service with: what is left of it is said"
    )
    commissioned_at: Moment | None = Field(default=None, description="goes with commissioned_preload_n")
    silent_after_hours: Annotated[Number, HOURS] = Field(
        default=168.0, description="without an accepted measurement for so long the state is unknown"
    )

    drive_model: Annotated[str, Field(max_length=20_000)] | None = Field(
        default=None, description="drive model as TOML: with it an alarm says which change of the axis explains it"
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
        if (self.moving_mass_kg is None) != (self.moving_mass_standard_uncertainty_kg is None):
            raise ValueError("moving_mass_kg and moving_mass_standard_uncertainty_kg are stated together or not at all")
        if (self.commissioned_preload_n is None) != (self.commissioned_at is None):
            raise ValueError("commissioned_preload_n and commissioned_at are stated together or not at all")
        if self.machine is None and self.machine_place is not None:
            raise ValueError("machine_place is of a machine: expected its name in machine; got none")
        return self


_BOUNDS = {"greater_than_equal": "ge", "less_than_equal": "le"}


def _within_bounds(document: Any, judge: ValidatorFunctionWrapHandler) -> AxisConfiguration:  # noqa: ANN401 - JSON
    """Take each quantity at the nearest of its bounds: older programs took any that was positive."""
    configuration: AxisConfiguration
    try:
        configuration = judge(document)
    except ValidationError as error:
        bounded = deepcopy(document)
        for refusal in error.errors(include_url=False):
            value = refusal["input"]
            if refusal["type"] not in _BOUNDS or not isinstance(value, float) or value <= 0.0:
                raise
            *path, member = refusal["loc"]
            reduce(getitem, path, bounded)[member] = refusal["ctx"][_BOUNDS[refusal["type"]]]
        configuration = judge(bounded)
    return configuration


_STORED = StoredRecord(
    "configuration",
    TypeAdapter(Annotated[AxisConfiguration, WrapValidator(_within_bounds)]),
    version=1,
    remedy="send it again with PUT /v1/axes, or restore the backup",
    added=frozenset(
        {
            "measurement_timeout_s",
            "measurement_pause_s",
            "baseline_days",
            "axis_type",
            "machine",
            "machine_place",
            "commissioned_preload_n",
            "commissioned_at",
        }
    ),
)


def load_configuration(document: Json) -> AxisConfiguration:
    """Return the stored configuration of an axis; raises DocumentDamagedError if it cannot be read."""
    return _STORED.load(document)


def dump_configuration(configuration: AxisConfiguration) -> JsonObject:
    """Return a configuration as it is stored."""
    return _STORED.dump(configuration)


@lru_cache(maxsize=1024)  # wanted with every window
def core_settings(configuration: AxisConfiguration) -> AxisSettings:
    """Return the core's settings, in SI units."""
    mass, uncertainty = configuration.moving_mass_kg, configuration.moving_mass_standard_uncertainty_kg
    return AxisSettings(
        search_band=configuration.search_band_hz,
        quality=QualityGate(
            sample_rate=configuration.sample_rate_hz, position_span_limit=metres(configuration.position_span_limit_mm)
        ),
        mode=ModeGate(minimum_averages=configuration.minimum_averages),
        moving_mass=None if mass is None or uncertainty is None else Estimate(mass, uncertainty),
    )


@lru_cache(maxsize=1024)
def visit_of(configuration: AxisConfiguration) -> Visit:
    """Return how far the windows of one measurement may be apart."""
    span = metres(configuration.position_span_limit_mm)
    if configuration.measurement_pause_s is not None:
        return Visit(timedelta(seconds=configuration.measurement_pause_s), span)
    # a short timeout alone, which says when to judge, does not divide what is measured
    return Visit(max(timedelta(seconds=configuration.measurement_timeout_s), Visit().pause), span)


def detector_settings(configuration: AxisConfiguration) -> DetectorSettings:
    """Return what the charts are to achieve."""
    return DetectorSettings(
        false_alarms_per_year=configuration.false_alarms_per_year,
        measurements_per_year=configuration.measurements_per_year,
        baseline_size=configuration.baseline_size,
        baseline_span=timedelta(days=configuration.baseline_days),
        loss=LossDirection.RISE,  # the preload feature rises as preload is lost
    )


@lru_cache(maxsize=32)
def detector_design(settings: DetectorSettings) -> DetectorDesign:
    """Return the limits of the charts. Solving them takes seconds, so axes of equal settings share one solution."""
    return design_detector(settings)


def sisters_of(session: Session, axis: AxisRow) -> Iterator[AxisRow]:
    """Yield the other axes of the same stated type, in order of name; none if the axis states no type."""
    axis_type = load_configuration(axis.configuration).axis_type
    for sister in list_axes(session) if axis_type is not None else ():
        with suppress(DocumentDamagedError):  # its own page says so
            if sister.id != axis.id and load_configuration(sister.configuration).axis_type == axis_type:
                yield sister


@lru_cache(maxsize=1024)  # of one model the modes are computed once
def preload_share(drive_model: str | None) -> Interval | None:
    """Return the interval of that share [-]; None without a drive model, or where its nut follows no preload."""
    if drive_model is None:
        return None
    from monitor_core.models.preload_share import share_of_preload  # noqa: PLC0415  # many axes have no model
    from monitor_core.recordings.model_file import parse_model  # noqa: PLC0415

    try:
        return share_of_preload(parse_model(drive_model, "drive_model").build())
    except MonitorCoreError:
        return None


@lru_cache(maxsize=1024)
def drive_law(drive_model: str | None, excitation_source: str) -> DriveLaw | None:
    """Return how 1/f² follows the position by a drive model; None without one, or where it does not say enough."""
    if drive_model is None:
        return None
    from monitor_core.identification import law_of_drive  # noqa: PLC0415  # many axes have no model
    from monitor_core.recordings.model_file import parse_model  # noqa: PLC0415

    try:
        return law_of_drive(parse_model(drive_model, "drive_model"), ExcitationSource(excitation_source))
    except MonitorCoreError:
        return None
