"""What was measured for an identification, as cases: peaks, natural frequencies or whole responses at positions."""

from monitor_core.identification.cases.any_family import (
    Case,
    FrequencyCase,
    PredictionError,
    ResponseCase,
    assigned_frequencies,
    frequency_case,
    positions_of,
    require_positions,
)
from monitor_core.identification.cases.numbered import nearer
from monitor_core.identification.cases.peaks import PeakCase, assigned_peaks, peak_case

__all__ = [
    "Case",
    "FrequencyCase",
    "PeakCase",
    "PredictionError",
    "ResponseCase",
    "assigned_frequencies",
    "assigned_peaks",
    "frequency_case",
    "nearer",
    "peak_case",
    "positions_of",
    "require_positions",
]
