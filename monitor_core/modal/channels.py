r"""Find what channels do to a mode: polarity and delay between them, a rigid-body line, noise on the excitation.

**Rigid-body line.** Well below the mode the table follows the screw, and the response is that of all that moves,

.. math:: R_0 = \frac{i}{J + m\,i^2} \quad\text{(torque)}, \qquad R_0 = \frac{1}{m + J/i^2} \quad\text{(force)}

with the transmission i = lead/2π, the moved mass m and the inertia J that turns with the screw. No stiffness is in it:
it tells another mass from another mounting, which the residue of the mode alone cannot. The lines between hold the foot
of the mode, whose poles are known, and a drag that goes with the velocity,

.. math:: H(f) = R_0 + \sum_r c_r \frac{-f^2}{f_r^2 - f^2 + 2 j \zeta_r f_r f} + j\,\frac{d}{f} + j\,e\,f

(modal superposition of an accelerance, ISO 7626-1; e: a delay between the channels). Weighted least squares with the
random error of each line (Bendat & Piersol, Random Data, 4th ed., Eq. (9.90)).

**Noise on the excitation.** The fit takes all noise for the response's. Noise on the torque makes H1 too small where
the torque is weak, which is at the mode, and moves its peak. How much of it there is can be read at rest, between two
moves. With :math:`S_{nn}` of it, white, the response without it is

.. math:: H_1' = \frac{S_{xy}}{S_{xx} - S_{nn}}

(Bendat & Piersol, section 9.1.4: noise on the input that is known).
"""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray, SampleArray
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.modal.selection import rational_poles
from monitor_core.response import FrequencyResponse, ModalParameters
from monitor_core.spectral import BandSpectra, CrossSpectra, Taper, cross_spectra, estimate_frf, random_error
from monitor_core.uncertainty import Estimate


@dataclass(frozen=True, slots=True)
class PhaseReference:
    """How the response channel stands to the excitation channel."""

    polarity: int  # +1, or −1 if one channel is wired or mounted the other way round
    delay: float  # of the response behind the excitation [s]

    def __post_init__(self) -> None:
        if self.polarity not in (1, -1):
            raise OutsideValidityError(f"polarity must be +1 or -1; got {self.polarity}")

    def deviation(self, mode: ModalParameters) -> float:
        """Return the phase of the residue, corrected for polarity and delay, in radians.

        It is 0 for a torque and an acceleration at the two ends of a passive axis moving in phase.
        """
        turned = self.polarity * mode.residue * cmath.exp(2j * math.pi * mode.frequency.value * self.delay)
        return cmath.phase(turned)


def calibrate_phase(modes: Sequence[ModalParameters]) -> PhaseReference:
    r"""Find polarity and delay from modes known to be good.

    .. math:: \arg(\pm R_i) = -2\pi f_i \tau

    by least squares over the modes; of the two polarities the one with the smaller delay is taken, so that the delay
    stays below a quarter of a period. The modes are of the same axis and channels, e.g. of the calibration's
    measurements. ``NotIdentifiableError`` if there is none, or the residues' phases cancel.

    Examples
    --------
    A mode at 100 Hz whose residue lags by a tenth of a turn: 1 ms.

    >>> from monitor_core.uncertainty import Estimate
    >>> lagging = ModalParameters(Estimate(100.0, 0.1), Estimate(0.01, 1e-4), 0.0, cmath.exp(-0.2j * math.pi))
    >>> reference = calibrate_phase([lagging])
    >>> reference.polarity, round(reference.delay, 12)
    (1, 0.001)
    """
    frequencies = np.array([mode.frequency.value for mode in modes])
    directions = np.array([mode.residue / abs(mode.residue) for mode in modes])
    mean = complex(directions.mean()) if directions.size else 0j
    if abs(mean) < 0.5:
        raise NotIdentifiableError(
            f"polarity needs residues of about one phase; got {len(modes)} of mean direction {abs(mean):.2f}"
        )
    polarity = 1 if mean.real >= 0.0 else -1
    # Phases about their mean, so that none of them wraps.
    phases = cmath.phase(polarity * mean) + np.angle(directions / (mean / abs(mean)))
    delay = -float(frequencies @ phases) / (2.0 * math.pi * float(frequencies @ frequencies))
    return PhaseReference(polarity, delay)


#: Lines between these shares of the lowest natural frequency are used: below, friction that has not begun to slide
#: holds the table; above, the foot of the mode is larger than the line.
LOWEST, HIGHEST = 0.15, 0.6
#: Of fewer lines nothing is said.
FEWEST_LINES = 15
#: A line known less well, relative, is none: the motor holds the screw, or no torque comes through to the table [-].
LARGEST_UNCERTAINTY = 0.02
#: By how much the variance grows because tapered lines next to each other share their noise: the sum over all steps of
#: the squared correlation, which is −2/3 and 1/6 at one and two lines' distance under a Hann window (Harris, Proc. IEEE
#: 66 (1978) 51–83).
_SHARED_NOISE: dict[Taper, float] = {"hann": 1.0 + 2.0 * (4.0 / 9.0 + 1.0 / 36.0), "rectangular": 1.0}
#: A random error below this is not believed of a line: it would be the only one that counts [-].
_LEAST_ERROR = 1e-3


def rigid_line(
    spectra: BandSpectra, kept: BoolArray, modes: Sequence[ModalParameters], taper: Taper
) -> Estimate | None:
    """Return the magnitude of the rigid-body line, or ``None`` where the lines below the mode do not show one.

    Of the windows those that are kept count, shape (n_windows,). The spectra reach down to :data:`LOWEST` of the lowest
    mode, or the lines that they have are used. The standard uncertainty grows by what the lines scatter beyond their
    random error [m/(N·m·s²) or m/(N·s²)].
    """
    lowest = min(mode.frequency.value for mode in modes)
    lines = spectra.within(LOWEST * lowest, HIGHEST * lowest).of_windows(kept)
    if lines.n_windows < 2 or lines.frequency.size < FEWEST_LINES + 2:
        return None
    cross = cross_spectra(lines, taper=taper)
    if not (np.all(cross.excitation_power > 0.0) and np.all(np.abs(cross.cross_power) > 0.0)):
        return None
    return _fitted(estimate_frf(cross, quantity=""), modes, _SHARED_NOISE[taper])


def _fitted(frf: FrequencyResponse, modes: Sequence[ModalParameters], shared: float) -> Estimate | None:
    coherence = frf.coherence
    if coherence is None:
        return None
    error = np.maximum(random_error(coherence, frf.n_averages), _LEAST_ERROR)
    weight = 1.0 / (error * np.abs(frf.response))
    design = _design(frf.frequency, modes) * weight[:, None]
    observed = frf.response * weight
    rows = np.vstack([design.real, design.imag])
    values = np.concatenate([observed.real, observed.imag])
    scale = np.sqrt(np.einsum("ij,ij->j", rows, rows))
    rows /= scale
    try:
        inverse = np.linalg.inv(rows.T @ rows)
    except np.linalg.LinAlgError:
        return None
    coefficients = inverse @ (rows.T @ values)
    left = values - rows @ coefficients
    dof = values.size - coefficients.size
    # a random error of a magnitude is that of each of its two parts
    variance = shared * max(float(left @ left) / dof, 1.0) * float(inverse[0, 0])
    if not 0.0 <= variance <= (LARGEST_UNCERTAINTY * float(coefficients[0])) ** 2:
        return None
    line = abs(float(coefficients[0])) / float(scale[0])
    return Estimate(line, math.sqrt(variance) / float(scale[0]), dof)


def _design(frequency: FloatArray, modes: Sequence[ModalParameters]) -> ComplexArray:
    """Lay out the line, the foot of each mode, drag and delay in columns."""
    f = frequency
    feet = [-(f**2) / (m.frequency.value**2 - f**2 + 2j * m.damping_ratio.value * m.frequency.value * f) for m in modes]
    reference = modes[0].frequency.value
    return np.column_stack([np.ones_like(f), *feet, 1j * reference / f, 1j * f / reference])


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
    poles = rational_poles(lines, response, weight, 1)[:, 0]
    return None if poles.size == 0 else float(poles[np.argmin(np.abs(poles - frequency))])
