"""Find starting values for the poles by quick approximate fits."""

import math
from itertools import product

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.modal.fit_lines import FitLines, ModelOrder
from monitor_core.modal.model import cost_at
from monitor_core.spectral import BandSpectra, cross_spectra, least_leaking_taper

_DAMPING_FACTORS = (1 / 3, 1.0, 3.0)
_PLACES = 16
_DAMPING_LIMITS = (1e-5, 0.5)
_RATIONAL_ITERATIONS = 8


def start_one_mode(lines: FitLines, frequency: float, damping_ratio: float) -> FloatArray:
    """Return the likeliest of a few dampings at a frequency, as parameters of the fit."""
    starts = [np.array([frequency, math.log(damping_ratio * factor)]) for factor in _DAMPING_FACTORS]
    return min(starts, key=lambda start: cost_at(lines, start, ModelOrder(1)))


def start_two_modes(lines: FitLines, one_mode: FloatArray) -> list[FloatArray]:
    """Return the two likeliest starts of two modes, the likelier first: a rational fit, or a second near the first."""
    order = ModelOrder(2)
    places = np.linspace(lines.frequency[0], lines.frequency[-1], _PLACES)
    # Two modes that were fitted with one gave it too much damping.
    starts = [
        np.array([one_mode[0], one_mode[1] - narrower, place, one_mode[1] - narrower])
        for place, narrower in product(places, (0.0, 1.0))
    ]
    poles = rational_poles(*_measured_response(lines), order.n_modes)
    if poles.shape[0] == order.n_modes:
        starts.append(np.column_stack([poles[:, 0], np.log(poles[:, 1])]).ravel())
    return sorted(starts, key=lambda start: cost_at(lines, start, order))[:2]


def rational_poles(frequency: FloatArray, response: ComplexArray, weight: FloatArray, n_modes: int) -> FloatArray:
    r"""Return the poles of a local rational fit to a frequency response.

    .. math:: \min \sum_k w_k \left| \frac{A(g_k) H_k - B(g_k)}{A_\mathrm{previous}(g_k)} \right|^2

    with ``A`` of degree ``n_modes`` and ``B`` one higher in the normalised frequency: the poles at negative frequency
    are far away (Sanathanan and Koerner [1]_).

    H is weighted by its inverse variance, up to a factor. Returned are natural frequency [Hz] and damping ratio [-] of
    the stable poles, by rising frequency, shape (n_stable, 2).

    References
    ----------
    .. [1] C. K. Sanathanan, J. Koerner, Transfer function synthesis as a ratio of two complex polynomials, IEEE Trans.
       Autom. Control 8 (1963) 56-58.
    """
    centre, half_width = 0.5 * (frequency[0] + frequency[-1]), 0.5 * (frequency[-1] - frequency[0])
    g = (frequency - centre) / half_width
    powers = g[:, None] ** np.arange(n_modes + 2)
    columns = np.hstack([response[:, None] * powers[:, :n_modes], -powers])
    root_weight = np.sqrt(weight)
    roots: ComplexArray = np.empty(0, dtype=np.complex128)
    for _ in range(_RATIONAL_ITERATIONS):
        a = np.linalg.lstsq(root_weight[:, None] * columns, -root_weight * response * g**n_modes)[0][:n_modes]
        roots = np.roots([1.0, *a[::-1]]).astype(np.complex128)
        root_weight = np.sqrt(weight) / np.abs(np.prod(g[:, None] - roots, axis=1))
    poles = centre + half_width * roots
    natural = np.abs(poles)
    damping = poles.imag / natural
    stable = (damping > _DAMPING_LIMITS[0]) & (damping < _DAMPING_LIMITS[1])
    kept = np.column_stack([natural[stable], damping[stable]])
    return kept[np.argsort(kept[:, 0])]


def _measured_response(lines: FitLines) -> tuple[FloatArray, ComplexArray, FloatArray]:
    """Return frequency, H1 and excitation power, to which the inverse variance of H1 is proportional."""
    x, y = lines.excitation / lines.weight, lines.response / lines.weight
    spectra = BandSpectra(lines.frequency, x, y, lines.n_samples, lines.sample_rate)
    cross = cross_spectra(spectra, taper=least_leaking_taper(spectra))
    power = np.maximum(cross.excitation_power, np.finfo(np.float64).tiny)
    return cross.frequency, cross.cross_power / power, power
