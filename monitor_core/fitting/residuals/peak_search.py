r"""Find peaks of the table's receptance in bands: frequency and height as a modal test reads them off |H|.

A peak is the highest interior local maximum of a band; a rise towards an edge of the band does not count. Its top lies
between lines. Across a sharp peak |H| changes a hundredfold from one line to the next, but numerator and denominator of

.. math::

    H = \frac{N}{\Delta}, \qquad G = \frac{1}{H} = \frac{\Delta}{N}

are functions without poles that change over hundreds of hertz. Each is therefore followed by a parabola through the
three lines of the maximum, and the top is where |G|² has its minimum. A parabola through log|H|, the usual way, is off
where the peak is as narrow as a line.
"""

from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray
from monitor_core.fitting.residuals.peak_grid import IndexArray, PeakGrid, lines_taken
from monitor_core.models.published.receptance.closed_form import (
    EntireResponses,
    entire_responses,
    table_receptance,
    table_receptance_gradient,
)
from monitor_core.models.published.receptance.parameters import JointParameters

#: Newton steps for the top: |G|² is nearly a parabola.
_NEWTON_STEPS = 5
#: Where between its neighbours a top is sought first: a mode near its node has a zero of H beside its pole.
_STARTS = np.linspace(-1.0, 1.0, 9)[:, None]
_START_SPACING = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Peaks:
    """The peak of each place; frequency and amplitude are 0 where there is none."""

    found: BoolArray  # shape (n_places,)
    frequency: FloatArray  # shape (n_places,) [Hz]
    amplitude: FloatArray  # shape (n_places,) [m/N]


@dataclass(frozen=True, slots=True, eq=False)
class PeakGradient:
    """Peaks with their derivatives with respect to the joints, in the order of ``JOINT_NAMES``; 0 without a peak."""

    peaks: Peaks
    log_frequency: FloatArray  # d ln f/d joint, shape (8, n_places) [1/unit of the joint]
    log_amplitude: FloatArray  # d ln |H|/d joint, shape (8, n_places) [1/unit of the joint]


@dataclass(frozen=True, slots=True, eq=False)
class _Summit:
    """G = Δ/N and its derivatives with respect to the place t at the top of each peak, shape (n_found,) each."""

    offset: FloatArray  # t, in spacings from the line of the maximum
    g: ComplexArray
    slope: ComplexArray
    bend: ComplexArray
    numerator: ComplexArray
    numerator_slope: ComplexArray


def find_peaks(grid: PeakGrid, joints: JointParameters) -> Peaks:
    """Find the peak of each place."""
    found, top = _tops(grid, table_receptance(grid.terms, joints))
    lines = _around(top[found])
    summit = _climb(entire_responses(lines_taken(grid.terms, lines.ravel()), joints), lines.shape)
    return _peaks(grid, found, top, summit)


def find_peaks_with_gradient(grid: PeakGrid, joints: JointParameters) -> PeakGradient:
    r"""Find the peaks and their derivatives with respect to the eight joint parameters.

    With :math:`\mathrm{Re}(\bar G\,G') = 0` at the top, the implicit function theorem gives

    .. math::

        \frac{\partial t}{\partial p} = - \frac{\mathrm{Re}(\bar G_p G' + \bar G G'_p)}{|G'|^2 + \mathrm{Re}(\bar G
        G'')}, \qquad \frac{\partial \ln |H|}{\partial p} = - \frac{\mathrm{Re}(\bar G G_p)}{|G|^2}

    the latter because |G| does not change with t there. :math:`E_p = \Delta^2\,\partial H/\partial p` has no poles
    either and gives :math:`G_p = -E_p/N^2`.
    """
    found, top = _tops(grid, table_receptance(grid.terms, joints))
    lines = _around(top[found])
    terms = lines_taken(grid.terms, lines.ravel())
    responses = entire_responses(terms, joints)
    summit = _climb(responses, lines.shape)
    _, gradient = table_receptance_gradient(terms, joints)
    entire = (gradient * responses.denominator**2).reshape(8, *lines.shape)
    e_p, e_slope, _ = _along(_parabola(np.moveaxis(entire, 1, 0)), summit.offset)

    g, slope, numerator = summit.g, summit.slope, summit.numerator
    g_p = -e_p / numerator**2
    slope_p = -(e_slope - 2.0 * e_p * summit.numerator_slope / numerator) / numerator**2
    curvature = np.abs(slope) ** 2 + (np.conj(g) * summit.bend).real
    per_line = -(np.conj(g_p) * slope + np.conj(g) * slope_p).real / curvature

    peaks = _peaks(grid, found, top, summit)
    log_frequency, log_amplitude = np.zeros((8, found.size)), np.zeros((8, found.size))
    log_frequency[:, found] = per_line * grid.spacing[found] / peaks.frequency[found]
    log_amplitude[:, found] = -(np.conj(g) * g_p).real / np.abs(g) ** 2
    return PeakGradient(peaks, log_frequency, log_amplitude)


def _tops(grid: PeakGrid, receptance: ComplexArray) -> tuple[BoolArray, IndexArray]:
    """Return whether each place has an interior local maximum, and the line of the highest."""
    level = receptance.real**2 + receptance.imag**2
    rises = level[1:] > level[:-1]
    maxima = grid.interior.copy()
    maxima[1:-1] &= rises[:-1] & ~rises[1:]
    height = np.where(maxima, level, 0.0)
    ends = (*grid.starts[1:], level.size)
    top = np.array(
        [start + int(height[start:end].argmax()) for start, end in zip(grid.starts, ends, strict=True)], dtype=np.int_
    )
    return height[top] > 0.0, top


def _around(top: IndexArray) -> IndexArray:
    """Return the lines below, at and above each maximum, shape (3, n_found)."""
    return np.stack([top - 1, top, top + 1])


def _parabola(values: ComplexArray) -> ComplexArray:
    """Return constant, slope and half the bend of the parabola through three lines, shape (3, …) as the values."""
    below, at, above = values
    return np.stack([at, 0.5 * (above - below), 0.5 * (above + below) - at])


def _along(curve: ComplexArray, t: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return value, slope and bend of a parabola at t spacings from its middle."""
    return curve[0] + t * (curve[1] + t * curve[2]), curve[1] + 2.0 * t * curve[2], 2.0 * curve[2]


def _climb(responses: EntireResponses, shape: tuple[int, ...]) -> _Summit:
    """Find the smallest |G|² between the lines, shape (3, n_found), by Newton's method."""
    above = _parabola(responses.table_per_force.reshape(shape))
    below = _parabola(responses.denominator.reshape(shape))
    tried = np.abs(_along(below, _STARTS)[0] / _along(above, _STARTS)[0])
    start = _STARTS[tried.argmin(axis=0), 0]
    t = start
    for step in range(_NEWTON_STEPS + 1):
        n, n_slope, n_bend = _along(above, t)
        d, d_slope, d_bend = _along(below, t)
        g = d / n
        slope = (d_slope - g * n_slope) / n
        bend = (d_bend - 2.0 * slope * n_slope - g * n_bend) / n
        if step == _NEWTON_STEPS:
            break
        gradient = (np.conj(g) * slope).real
        curvature = np.abs(slope) ** 2 + (np.conj(g) * bend).real
        move = np.divide(gradient, curvature, out=np.zeros_like(t), where=curvature > 0.0)
        t = np.clip(t - move, start - _START_SPACING, start + _START_SPACING)
    return _Summit(t, g, slope, bend, n, n_slope)


def _peaks(grid: PeakGrid, found: BoolArray, top: IndexArray, summit: _Summit) -> Peaks:
    frequency, amplitude = np.zeros(found.size), np.zeros(found.size)
    frequency[found] = grid.frequency[top[found]] + summit.offset * grid.spacing[found]
    amplitude[found] = 1.0 / np.abs(summit.g)
    return Peaks(found, frequency, amplitude)
