"""Lines of bands at positions, with all that does not depend on the joints: where peaks are looked for.

Where the peak of each mode lies, and how well a peak is known.
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
from monitor_core.models.published.receptance.closed_form import LinearTerm, PositionTerms, position_terms
from monitor_core.models.published.receptance.parameters import ReceptanceParameters
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
