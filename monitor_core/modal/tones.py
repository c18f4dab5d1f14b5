"""Persistent sines in the residual of a fit: found by a significance test."""

import numpy as np
import scipy.stats

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.modal.model import tone_shape
from monitor_core.modal.variable_projection import Solution
from monitor_core.spectral import BandSpectra

#: Probability that a clean band is said to hold a tone.
_FALSE_ALARM_PROBABILITY = 1e-3


def strongest_tone(spectra: BandSpectra, solution: Solution) -> float | None:
    r"""Return the frequency of the strongest sine that the fit leaves, or ``None`` if none is significant.

    A sine of unknown amplitude and phase in each window, of one frequency in all, stands out by

    .. math:: S(f) = \frac{2}{\sigma^2} \sum_s \frac{|\langle D(\cdot - f), R_s \rangle|^2}{\|D(\cdot - f)\|^2}

    which is :math:`\chi^2` with two degrees of freedom per window if there is none. The band is searched at half
    lines, and the level is divided by the number of independent lines. The half-power band of a mode is left out:
    there a sine cannot be told from ringing that the model does not quite meet.

    Parameters
    ----------
    spectra : BandSpectra
        Lines of the fit band.
    solution : Solution
        Fit whose residual is searched.

    Returns
    -------
    float or None
        Frequency in hertz.
    """
    f = spectra.frequency
    tones = np.linspace(f[0], f[-1], 2 * (f.size - 1) + 1)
    tones = tones[_outside_half_power_bands(tones, solution)]
    if tones.size == 0:
        return None
    kernels = tone_shape(f, tones[:, None], spectra.n_samples, spectra.sample_rate)
    kernels /= np.linalg.norm(kernels, axis=1)[:, None]
    powers = np.sum(np.abs(solution.projection.residual @ kernels.conj().T) ** 2, axis=0)
    statistic = 2.0 * powers / solution.noise_variance
    # Each window's share is limited by the residual's own size, so a tone inflates σ² too; the test is conservative.
    level = scipy.stats.chi2.isf(_FALSE_ALARM_PROBABILITY / f.size, 2 * spectra.n_windows)
    best = int(np.argmax(statistic))
    return float(tones[best]) if statistic[best] > level else None


def _outside_half_power_bands(tones: FloatArray, solution: Solution) -> BoolArray:
    outside = np.ones(tones.size, dtype=np.bool_)
    for natural_frequency, damping_ratio in solution.modes:
        outside &= np.abs(tones - natural_frequency) > damping_ratio * natural_frequency
    return outside
