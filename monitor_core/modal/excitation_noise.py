r"""Tell what noise on the excitation may have done to a natural frequency.

The fit takes all noise for the response's. Noise on the torque makes H1 too small where the torque is weak, which is at
the mode, and moves its peak. How much of it there is can be read at rest, between two moves. With :math:`S_{nn}` of it,
white, the response without it is

.. math:: H_1' = \frac{S_{xy}}{S_{xx} - S_{nn}}

(J. S. Bendat, A. G. Piersol, Random Data, 4th ed., Wiley, 2010, section 9.1.4: noise on the input that is known).
"""

from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import ComplexArray, FloatArray, SampleArray
from monitor_core.modal.selection import rational_poles
from monitor_core.spectral import BandSpectra, CrossSpectra, Taper, cross_spectra

#: Third differences leave of a motion that is slow against the sampling next to nothing, of white noise this power.
_ORDER, _OF_WHITE = 3, 20.0
#: Samples that are looked at together, and the share of them taken for those at rest.
_STRETCH, _AT_REST = 32, 0.05
#: Of the power of the excitation around the mode, noise below this share moves nothing.
_NEGLIGIBLE = 1e-3
#: The least that is left of the excitation without its noise, as a share of it.
_LEAST_LEFT = 0.2
#: Neighbouring lines that are averaged before the lowest is taken.
_BLOCK = 8
#: Power of white noise under a periodic Hann window times two, over that without a window.
_WIDENED = {"hann": 1.5, "rectangular": 1.0}


def excitation_noise(excitation: SampleArray) -> float:
    """Return the power per un-windowed line of the white noise on an excitation, |X|² of a window.

    The excitation has the shape (n_windows, n_samples) [N·m or N]. The quietest twentieth of its stretches of 32
    samples are taken to be at rest; the quantile is that of the variance of so many samples, of third differences,
    which are half as independent.
    """
    n_samples = excitation.shape[1]
    rough = np.diff(excitation.astype(np.float64), _ORDER, axis=1)
    n_stretches = rough.shape[1] // _STRETCH
    if n_stretches == 0:
        return 0.0
    variance = rough[:, : n_stretches * _STRETCH].reshape(-1, _STRETCH).var(axis=1) / _OF_WHITE
    dof = 0.5 * _STRETCH
    at_rest = np.quantile(variance, _AT_REST) / (scipy.special.chdtri(dof, 1.0 - _AT_REST) / dof)
    return float(at_rest * n_samples)


@dataclass(frozen=True, slots=True)
class Contamination:
    """What noise on the excitation does to the measurement of a mode."""

    noise: float  # power per un-windowed line, |X|² of a window; 0: negligible
    shift: float  # by how much the mode lies higher without it [Hz]


def contamination(spectra: BandSpectra, frequency: float, noise: float, taper: Taper) -> Contamination:
    """Tell what noise on the excitation does to a mode.

    Of the un-windowed lines around a mode at a frequency [Hz]; the noise is that of :func:`excitation_noise`, or what
    the response does not answer, where that is less. Local rational fits to the responses with it and without it are
    compared, which have in common what else they neglect.
    """
    cross = cross_spectra(spectra, taper=taper)
    power, of_line = cross.excitation_power, _WIDENED[taper] * spectra.n_windows
    floor = min(of_line * noise, _incoherent_power(cross))
    if floor < _NEGLIGIBLE * float(power.mean()):
        return Contamination(0.0, 0.0)
    without = np.maximum(power - floor, _LEAST_LEFT * power)
    with_noise, without_noise = (
        _nearest_pole(cross.frequency, cross.cross_power / of, power, frequency) for of in (power, without)
    )
    shift = 0.0 if with_noise is None or without_noise is None else without_noise - with_noise
    return Contamination(floor / of_line, shift)


def _incoherent_power(cross: CrossSpectra) -> float:
    """Return the most that noise on the excitation can be: what of its power the response does not answer.

    A servo that trembles at rest makes torque, too, but one that the axis answers.
    """
    coherent = np.abs(cross.cross_power) ** 2 / np.maximum(cross.response_power, np.finfo(np.float64).tiny)
    left = (cross.excitation_power - coherent) * cross.n_windows / max(cross.n_windows - 1, 1)
    blocks = left[: max(left.size // _BLOCK * _BLOCK, 1)].reshape(-1, min(_BLOCK, left.size)).mean(axis=1)
    return float(blocks.min())


def _nearest_pole(lines: FloatArray, response: ComplexArray, weight: FloatArray, frequency: float) -> float | None:
    found = rational_poles(lines, response, weight, 1)[:, 0]
    return None if found.size == 0 else float(found[np.argmin(np.abs(found - frequency))])
