r"""Find peaks of the table's receptance in bands: frequency and height as a modal test reads them off |H|.

A peak is the highest interior local maximum of a band; a rise towards an edge of the band does not count. Its top lies
between lines. Across a sharp peak |H| changes a hundredfold from one line to the next, but numerator and denominator of

.. math::

    H = \frac{N}{\Delta}, \qquad G = \frac{1}{H} = \frac{\Delta}{N}

are functions without poles that change over hundreds of hertz. Each is therefore followed by a parabola through the
three lines of the maximum, and the top is where |G|² has its minimum. A parabola through log|H|, the usual way, is off
where the peak is as narrow as a line. What does not depend on the joints is computed once for the lines of all bands.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.observations import AssignedPeak, ModalObservation
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.receptance.closed_form import (
    LinearTerm,
    PositionTerms,
    position_terms,
    table_fraction,
    table_receptance_gradient,
)
from monitor_core.models.published.receptance.parameters import JointParameters, ReceptanceParameters
from monitor_core.models.rod import RodWaves

IndexArray = npt.NDArray[np.int_]


@dataclass(frozen=True, slots=True)
class Band:
    """Where a peak is looked for."""

    lower: float  # [Hz]
    upper: float  # [Hz]
    n_lines: int = 170

    def __post_init__(self) -> None:
        if not (0.0 < self.lower < self.upper and self.n_lines >= 5):
            raise OutsideValidityError(
                "a band must have 0 < lower < upper and at least 5 lines; got "
                f"[{self.lower}, {self.upper}] Hz with {self.n_lines}"
            )


@dataclass(frozen=True, slots=True)
class Place:
    """One band at one position."""

    conditions: DriveConditions
    band: Band


@dataclass(frozen=True, slots=True, eq=False)
class PeakGrid:
    """Lines of some places one after the other, with all that does not depend on the joints; made once."""

    frequency: FloatArray  # shape (n_lines,), all bands one after the other [Hz]
    spacing: FloatArray  # of the lines of each place, shape (n_places,) [Hz]
    starts: tuple[int, ...]  # first line of each place
    interior: BoolArray  # no edge of a band, shape (n_lines,)
    terms: PositionTerms


def peak_grid(
    parameters: ReceptanceParameters, places: Sequence[Place], motor_end: MotorEnd = MotorEnd.FREE
) -> PeakGrid:
    """Precompute the trigonometry of all places; it does not depend on the joints.

    Raises OutsideValidityError if there is no place or a position is not on the screw.
    """
    if not places:
        raise OutsideValidityError("peaks must be looked for in at least one band; got none")
    grids = [np.linspace(place.band.lower, place.band.upper, place.band.n_lines) for place in places]
    terms = [
        position_terms(parameters, 2.0 * np.pi * grid, place.conditions, motor_end)
        for place, grid in zip(places, grids, strict=True)
    ]
    interior = np.concatenate([np.r_[False, np.ones(grid.size - 2, dtype=bool), False] for grid in grids])
    starts = np.cumsum([0, *(grid.size for grid in grids[:-1])])
    return PeakGrid(
        np.concatenate(grids),
        np.array([grid[1] - grid[0] for grid in grids]),
        tuple(int(start) for start in starts),
        interior,
        _joined(terms),
    )


def _joined(terms: Sequence[PositionTerms]) -> PositionTerms:
    """Put the lines of several grids of one axis one after the other."""
    return _combined(terms, np.concatenate)


def lines_taken(terms: PositionTerms, lines: IndexArray) -> PositionTerms:
    """Take some lines of a grid."""
    return _combined([terms], lambda arrays: arrays[0][lines])


def _combined(terms: Sequence[PositionTerms], combine: Callable[[list[ComplexArray]], ComplexArray]) -> PositionTerms:
    """Make one record of several, array by array."""

    def rod(rods: list[RodWaves[ComplexArray]]) -> RodWaves[ComplexArray]:
        return RodWaves(
            combine([waves.cosine for waves in rods]),
            combine([waves.sine_over_z for waves in rods]),
            combine([waves.z_sine for waves in rods]),
        )

    def linear(parts: list[LinearTerm]) -> LinearTerm:
        return LinearTerm(combine([part.constant for part in parts]), combine([part.slope for part in parts]))

    return PositionTerms(
        j_omega=combine([position.j_omega for position in terms]),
        near=rod([position.near for position in terms]),
        far=rod([position.far for position in terms]),
        far_loaded_cosine=combine([position.far_loaded_cosine for position in terms]),
        far_loaded_z_sine=combine([position.far_loaded_z_sine for position in terms]),
        table_stiffness=combine([position.table_stiffness for position in terms]),
        torsion=linear([position.torsion for position in terms]),
        turning=linear([position.turning for position in terms]),
        coupling_lever=combine([position.coupling_lever for position in terms]),
        torque_lever=linear([position.torque_lever for position in terms]),
        held_torsion=linear([position.held_torsion for position in terms]),
        held_turning=linear([position.held_turning for position in terms]),
        transmission_ratio=terms[0].transmission_ratio,
        nut_mass=terms[0].nut_mass,
    )


#: Relative standard uncertainties where an observation states none: a peak read off lines of 1 Hz and more, and the
#: height of a peak as hammer, sensor and a joint's damping repeat it.
FREQUENCY_UNCERTAINTY, AMPLITUDE_UNCERTAINTY = 0.01, 0.20


def mode_bands(peaks: Sequence[AssignedPeak], *, margin: float = 0.35) -> dict[int, Band]:
    """Return a band for each mode: around its measured frequencies, up to half way (geometrically) to the next mode.

    It reaches beyond the measured frequencies by ``margin``, relative. Raises OutsideValidityError if two modes change
    places along the screw, so that no band holds one of them alone.
    """
    extent: dict[int, tuple[float, float]] = {}
    for peak in peaks:
        low, high = extent.get(peak.mode, (math.inf, 0.0))
        extent[peak.mode] = (min(low, peak.observation.frequency), max(high, peak.observation.frequency))
    bands = {}
    for mode, (low, high) in extent.items():
        below = [other for _, other in extent.values() if other < low]
        above = [other for other, _ in extent.values() if other > high]
        lower = max([low / (1.0 + margin), *(math.sqrt(low * other) for other in below)])
        upper = min([high * (1.0 + margin), *(math.sqrt(high * other) for other in above)])
        bands[mode] = Band(lower, upper)
    by_frequency = sorted(bands, key=lambda mode: bands[mode].lower)
    for lower_mode, upper_mode in itertools.pairwise(by_frequency):
        if bands[lower_mode].upper > bands[upper_mode].lower * (1.0 + 1e-9):
            raise OutsideValidityError(
                f"the measured frequencies of modes {lower_mode} and {upper_mode} must not overlap for a band of each; "
                "they cross along the screw, so state bands"
            )
    return bands


def relative_frequency_uncertainty(observation: ModalObservation) -> float:
    """Return the standard uncertainty of the frequency over the frequency [-], the default where none is stated."""
    stated = observation.frequency_uncertainty
    return FREQUENCY_UNCERTAINTY if stated is None else stated / observation.frequency


def relative_amplitude_uncertainty(observation: ModalObservation) -> float:
    """Return the standard uncertainty of the amplitude over the amplitude [-], the default where none is stated."""
    if observation.amplitude is None or observation.amplitude_uncertainty is None:
        return AMPLITUDE_UNCERTAINTY
    return observation.amplitude_uncertainty / observation.amplitude


#: Newton steps for the top, of which none is left after one this short, in spacings: |G|² is nearly a parabola.
_NEWTON_STEPS, _SETTLED = 5, 1e-9
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
    numerator, denominator = table_fraction(grid.terms, joints)
    found, top = _tops(grid, numerator / denominator)
    lines = _around(top[found])
    return _peaks(grid, found, top, _climb(numerator[lines], denominator[lines]))


def find_peaks_with_gradient(grid: PeakGrid, joints: JointParameters) -> PeakGradient:
    r"""Find the peaks and their derivatives with respect to the eight joint parameters.

    With :math:`\mathrm{Re}(\bar G\,G') = 0` at the top, the implicit function theorem gives

    .. math::

        \frac{\partial t}{\partial p} = - \frac{\mathrm{Re}(\bar G_p G' + \bar G G'_p)}{|G'|^2 + \mathrm{Re}(\bar G
        G'')}, \qquad \frac{\partial \ln |H|}{\partial p} = - \frac{\mathrm{Re}(\bar G G_p)}{|G|^2}

    the latter because |G| does not change with t there. :math:`E_p = \Delta^2\,\partial H/\partial p` has no poles
    either and gives :math:`G_p = -E_p/N^2`.
    """
    numerators, denominator = table_fraction(grid.terms, joints)
    found, top = _tops(grid, numerators / denominator)
    lines = _around(top[found])
    summit = _climb(numerators[lines], denominator[lines])
    _, gradient = table_receptance_gradient(lines_taken(grid.terms, lines.ravel()), joints)
    entire = gradient.reshape(8, *lines.shape) * denominator[lines] ** 2
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
    below, top, above = values
    return np.stack([top, 0.5 * (above - below), 0.5 * (above + below) - top])


def _along(curve: ComplexArray, t: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return value, slope and bend of a parabola at t spacings from its middle."""
    return curve[0] + t * (curve[1] + t * curve[2]), curve[1] + 2.0 * t * curve[2], 2.0 * curve[2]


def _climb(numerator: ComplexArray, denominator: ComplexArray) -> _Summit:
    """Find the smallest |G|² between the lines, shape (3, n_found), by Newton's method."""
    above, below = _parabola(numerator), _parabola(denominator)
    tried = np.abs(_along(below, _STARTS)[0] / _along(above, _STARTS)[0])
    start = _STARTS[tried.argmin(axis=0), 0]
    t, moved = start, np.ones_like(start)
    for step in range(_NEWTON_STEPS + 1):
        n, n_slope, n_bend = _along(above, t)
        d, d_slope, d_bend = _along(below, t)
        g = d / n
        slope = (d_slope - g * n_slope) / n
        bend = (d_bend - 2.0 * slope * n_slope - g * n_bend) / n
        if step == _NEWTON_STEPS or np.max(np.abs(moved), initial=0.0) < _SETTLED:
            break
        gradient = (np.conj(g) * slope).real
        curvature = np.abs(slope) ** 2 + (np.conj(g) * bend).real
        move = np.divide(gradient, curvature, out=np.zeros_like(t), where=curvature > 0.0)
        before, t = t, np.clip(t - move, start - _START_SPACING, start + _START_SPACING)
        moved = t - before
    return _Summit(t, g, slope, bend, n, n_slope)


def _peaks(grid: PeakGrid, found: BoolArray, top: IndexArray, summit: _Summit) -> Peaks:
    frequency, amplitude = np.zeros(found.size), np.zeros(found.size)
    frequency[found] = grid.frequency[top[found]] + summit.offset * grid.spacing[found]
    amplitude[found] = 1.0 / np.abs(summit.g)
    return Peaks(found, frequency, amplitude)
