r"""Measure the line that a rigid body would have: acceleration per excitation well below the mode.

There the table follows the screw, and the response is that of all that moves,

.. math:: R_0 = \frac{i}{J + m\,i^2} \quad\text{(torque)}, \qquad R_0 = \frac{1}{m + J/i^2} \quad\text{(force)}

with the transmission i = lead/2π, the moved mass m and the inertia J that turns with the screw. No stiffness is in it:
it tells another mass from another mounting, which the residue of the mode alone cannot. The lines between hold the foot
of the mode, whose poles are known, and a drag that goes with the velocity,

.. math:: H(f) = R_0 + \sum_r c_r \frac{-f^2}{f_r^2 - f^2 + 2 j \zeta_r f_r f} + j\,\frac{d}{f} + j\,e\,f

(modal superposition of an accelerance, ISO 7626-1; e: a delay between the channels). Weighted least squares with the
random error of each line (Bendat & Piersol, Random Data, 4th ed., Eq. (9.90)).
"""

import math
from collections.abc import Sequence

import numpy as np

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray
from monitor_core.response import FrequencyResponse, ModalParameters
from monitor_core.spectral import BandSpectra, Taper, cross_spectra, estimate_frf, random_error
from monitor_core.uncertainty import Estimate

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
    found = inverse @ (rows.T @ values)
    left = values - rows @ found
    dof = values.size - found.size
    # a random error of a magnitude is that of each of its two parts
    variance = shared * max(float(left @ left) / dof, 1.0) * float(inverse[0, 0])
    if not 0.0 <= variance <= (LARGEST_UNCERTAINTY * float(found[0])) ** 2:
        return None
    line = abs(float(found[0])) / float(scale[0])
    return Estimate(line, math.sqrt(variance) / float(scale[0]), dof)


def _design(frequency: FloatArray, modes: Sequence[ModalParameters]) -> ComplexArray:
    """Lay out the line, the foot of each mode, drag and delay in columns."""
    f = frequency
    feet = [-(f**2) / (m.frequency.value**2 - f**2 + 2j * m.damping_ratio.value * m.frequency.value * f) for m in modes]
    reference = modes[0].frequency.value
    return np.column_stack([np.ones_like(f), *feet, 1j * reference / f, 1j * f / reference])
