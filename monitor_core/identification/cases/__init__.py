"""What was measured for an identification, as cases: peaks, natural frequencies or whole responses at positions."""

from monitor_core.identification.cases.any_family import FrequencyCase, ResponseCase, frequency_case
from monitor_core.identification.cases.case import Case, PredictionError, positions_of, require_positions
from monitor_core.identification.cases.peaks import PeakCase, peak_case

__all__ = [
    "Case",
    "FrequencyCase",
    "PeakCase",
    "PredictionError",
    "ResponseCase",
    "frequency_case",
    "peak_case",
    "positions_of",
    "require_positions",
]
