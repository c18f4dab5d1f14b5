"""From what an operator states about an axis to the records of the core."""

from functools import cache

from monitor_core.modal import ModeGate
from monitor_core.pipeline import AxisSettings
from monitor_core.quality import QualityGate
from monitor_core.trend import DetectorDesign, DetectorSettings, LossDirection, design_detector
from monitor_core.uncertainty import Estimate
from service.operations.axes import AxisConfiguration


def core_settings(configuration: AxisConfiguration) -> AxisSettings:
    """Return the core's settings, in SI units."""
    mass = configuration.moving_mass_kg
    return AxisSettings(
        search_band=configuration.search_band_hz,
        quality=QualityGate(
            sample_rate=configuration.sample_rate_hz, position_span_limit=configuration.position_span_limit_mm * 1e-3
        ),
        mode=ModeGate(minimum_averages=configuration.minimum_averages),
        moving_mass=None if mass is None else Estimate(mass, configuration.moving_mass_standard_uncertainty_kg),
    )


def detector_design(configuration: AxisConfiguration) -> DetectorDesign:
    """Return the limits of the charts; solving them takes a moment, so equal settings share one solution."""
    return _solved(
        DetectorSettings(
            false_alarms_per_year=configuration.false_alarms_per_year,
            measurements_per_year=configuration.measurements_per_year,
            baseline_size=configuration.baseline_size,
            loss=LossDirection.RISE,  # the preload feature rises as preload is lost
        )
    )


@cache
def _solved(settings: DetectorSettings) -> DetectorDesign:
    return design_detector(settings)
