"""Compute spectra, frequency responses and coherence of windows (ISO 13374: DM, data manipulation)."""

from monitor_core.spectral.coherence import (
    band_average as band_average,
    coherence_bias as coherence_bias,
    effective_averages as effective_averages,
    random_error as random_error,
    significance_level as significance_level,
)
from monitor_core.spectral.frf import (
    CrossSpectra as CrossSpectra,
    cross_spectra as cross_spectra,
    estimate_frf as estimate_frf,
    joint_input_output as joint_input_output,
    least_leaking_taper as least_leaking_taper,
    mean_coherence as mean_coherence,
    median_misfit as median_misfit,
    outlying as outlying,
)
from monitor_core.spectral.spectra import (
    TAPERS as TAPERS,
    BandSpectra as BandSpectra,
    Taper as Taper,
    band_spectra as band_spectra,
    line_spread as line_spread,
    motion_spectra as motion_spectra,
)
