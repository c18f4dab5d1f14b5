"""By how much a model of an axis is off even where nothing is missing: its own reductions, as a spectrum."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.models.protocol import ResponsePoint


@dataclass(frozen=True, slots=True)
class FormSpectrum:
    r"""Relative standard deviation of a modelled response.

    .. math::

        \sigma_{form}^2 = \sigma^2(f) + \left( \varepsilon \frac{d \ln |H|}{d \ln f} \right)^2

    with σ between knots linear in ln f, and a relative tolerance ε of frequencies, which shows where the response is
    steep.
    """

    frequency: tuple[float, ...]  # rising [Hz]
    deviation: tuple[float, ...]  # [-]
    frequency_tolerance: float  # ε [-]
    learnt: bool  # on healthy machines: then it is known to be common to all settings, and what is left is noise

    def relative_deviation(self, frequency: FloatArray, log_amplitude: FloatArray) -> FloatArray:
        """Return the deviation of the lines of one response, beyond the knots that of the nearest one.

        Parameters
        ----------
        frequency : ndarray, shape (n_lines,)
            Rising. [Hz]
        log_amplitude : ndarray, shape (n_lines,)
            ln of the measured amplitude.
        """
        log_frequency = np.log(frequency)
        flat = np.interp(log_frequency, np.log(self.frequency), self.deviation)
        steepness = np.gradient(log_amplitude, log_frequency) if frequency.size > 1 else np.zeros_like(flat)
        return np.hypot(flat, self.frequency_tolerance * steepness)


#: Where nobody has measured it: about two to three times what the models here leave of simulated machines that damp by
#: other laws than theirs and whose responses were estimated by averaging (benchmarks/hidden_effects.py).
DEFAULT_SPECTRUM = FormSpectrum((20.0, 200.0, 600.0, 1500.0), (0.0015, 0.0015, 0.003, 0.012), 1e-4, learnt=False)


@dataclass(frozen=True, slots=True)
class ModelFormError:
    """The form error of each kind of response."""

    spectra: Mapping[ResponsePoint, FormSpectrum] = field(default_factory=dict)

    def of(self, point: ResponsePoint) -> FormSpectrum:
        """Return the spectrum of a response point, the default where none was learnt."""
        return self.spectra.get(point, DEFAULT_SPECTRUM)
