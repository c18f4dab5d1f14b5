"""Compute spectra, frequency responses and coherence of windows (ISO 13374: DM, data manipulation)."""

from monitor_core.spectral.coherence import (
    band_average,
    coherence_bias,
    effective_averages,
    random_error,
    significance_level,
)
from monitor_core.spectral.frf import (
    CrossSpectra,
    cross_spectra,
    estimate_frf,
    least_leaking_taper,
    mean_coherence,
    median_misfit,
)
from monitor_core.spectral.spectra import TAPERS, BandSpectra, Taper, band_spectra, line_spread

__all__ = [
    "TAPERS",
    "BandSpectra",
    "CrossSpectra",
    "Taper",
    "band_average",
    "band_spectra",
    "coherence_bias",
    "cross_spectra",
    "effective_averages",
    "estimate_frf",
    "least_leaking_taper",
    "line_spread",
    "mean_coherence",
    "median_misfit",
    "random_error",
    "significance_level",
]
