"""State the form error of a model as a spectrum: by how much it is off even where nothing is missing."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.models.protocol import ResponsePoint


@dataclass(frozen=True, slots=True)
class FormSpectrum:
    r"""Relative standard deviation of a modelled response.

    .. math::

        \sigma_{form}^2 = \sigma^2(f) + \varepsilon^2(f) \left| \frac{d \ln H}{d \ln f} \right|^2

    with σ and ε between knots linear in ln f. A relative error of frequencies and a loss factor that are left out both
    show where amplitude or phase of the response is steep: of an order of ε.
    """

    frequency: tuple[float, ...]  # rising [Hz]
    deviation: tuple[float, ...]  # [-]
    frequency_tolerance: tuple[float, ...]  # ε [-]
    learnt: bool  # on healthy machines: then it is known to be common to all settings, and what is left is noise

    def relative_deviation(self, frequency: FloatArray, response: ComplexArray) -> FloatArray:
        """Return the deviation of the lines of a measured response, shape (n_lines,); constant beyond the knots."""
        logarithms, knots = np.log(frequency), np.log(self.frequency)
        flat, tolerance = (
            np.interp(logarithms, knots, values) for values in (self.deviation, self.frequency_tolerance)
        )
        return np.hypot(flat, tolerance * steepness(frequency, response))


def steepness(frequency: FloatArray, response: ComplexArray) -> FloatArray:
    """Return |d ln H/d ln f| of the lines of one response, shape (n_lines,); 0 for a single one."""
    if frequency.size < 2:
        return np.zeros_like(frequency)
    logarithm = np.log(np.abs(response)) + 1j * np.unwrap(np.angle(response))
    return np.asarray(np.abs(np.gradient(logarithm, np.log(frequency))))


#: Where it was not measured: about two to three times what the models here leave of simulated machines that damp by
#: other laws than theirs and whose responses were estimated by averaging (benchmarks/hidden_effects.py).
DEFAULT_SPECTRUM = FormSpectrum((20.0, 200.0, 600.0, 1500.0), (0.0015, 0.0015, 0.003, 0.012), (1e-4,) * 4, learnt=False)


@dataclass(frozen=True, slots=True)
class ModelFormError:
    """The form error of each kind of response."""

    spectra: Mapping[ResponsePoint, FormSpectrum] = field(default_factory=dict)

    def of(self, point: ResponsePoint) -> FormSpectrum:
        """Return the spectrum of a response point, the default where none was learnt."""
        return self.spectra.get(point, DEFAULT_SPECTRUM)
