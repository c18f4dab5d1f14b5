"""What was measured for an identification, as cases: peaks, natural frequencies or whole responses at positions."""

from monitor_core.identification.cases.any_family import (
    Case as Case,
    FrequencyCase as FrequencyCase,
    PredictionError as PredictionError,
    ResponseCase as ResponseCase,
    assigned_frequencies as assigned_frequencies,
    frequency_case as frequency_case,
    positions_of as positions_of,
    require_positions as require_positions,
)
from monitor_core.identification.cases.numbered import nearer as nearer
from monitor_core.identification.cases.peaks import (
    DroppedPeak as DroppedPeak,
    PeakCase as PeakCase,
    assigned_peaks as assigned_peaks,
    peak_case as peak_case,
)
