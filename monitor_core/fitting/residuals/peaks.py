r"""Joints from measured peaks: Eq. (26) of Tian et al. as printed, or weighted by what the peaks are worth.

The paper minimises over positions p and orders q

.. math::

    y = \sqrt{\sum_p \sum_q \left( \frac{f_c - f_t}{f_t} \right)^2 + \left( \frac{A_c - A_t}{A_t} \right)^2}

(c calculated, t tested): one per cent of a frequency weighs as much as one per cent of an amplitude. But a modal test
gives frequencies to 1 % and amplitudes to 20 % at best (the first order of Table 2 scatters by half while its frequency
stands still), so the amplitudes decide and the frequencies pay. Divided by their uncertainties the same residuals make
a χ². The root is monotonic and moves no minimum: both objectives are sums of squares here, and
:func:`paper_objective` is the printed number.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.joint_coordinates import JointCoordinates
from monitor_core.fitting.observations import AssignedPeak, ModalObservation
from monitor_core.fitting.residuals.peak_search import (
    Band,
    IndexArray,
    PeakGrid,
    Peaks,
    Place,
    find_peaks,
    find_peaks_with_gradient,
    peak_grid,
)
from monitor_core.models.protocol import DriveConditions, MotorEnd

#: Relative standard uncertainties where an observation states none: a peak read off lines of 1 Hz and more, and the
#: height of a peak as hammer, sensor and a joint's damping repeat it.
FREQUENCY_UNCERTAINTY, AMPLITUDE_UNCERTAINTY = 0.01, 0.20
#: Relative error of frequency and of amplitude where the model has no peak in the band.
MISSING_PEAK = 1.0


class Weighting(StrEnum):
    """What a residual is divided by."""

    UNIT = "unit"  #: nothing: Eq. (26)
    UNCERTAINTY = "uncertainty"  #: the relative standard uncertainty of the datum


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Peaks under one preload, so under one set of joints."""

    conditions: DriveConditions  # whose joints are those of all
    grid: PeakGrid
    members: IndexArray  # place of each among all peaks, shape (n_places,)


@dataclass(frozen=True, slots=True, eq=False)
class ModalProblem:
    """Relative errors of peak frequencies, then of amplitudes where stated; made by :func:`modal_problem`.

    A peak that the model does not have at some joints counts :data:`MISSING_PEAK`, with derivatives of zero.
    """

    joints: JointCoordinates
    peaks: tuple[AssignedPeak, ...]
    bands: Mapping[int, Band]
    frequency: FloatArray  # measured, shape (n_peaks,) [Hz]
    frequency_weight: FloatArray  # of the relative error, shape (n_peaks,) [-]
    amplitude: FloatArray  # measured, shape (n_amplitudes,) [m/N]
    amplitude_weight: FloatArray  # of the relative error, shape (n_amplitudes,) [-]
    with_amplitude: IndexArray  # which peaks have one, shape (n_amplitudes,)
    _groups: tuple[_Group, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free joints."""
        return self.joints.free

    def predict(self, coordinates: FloatArray) -> Peaks:
        """Return the model's peak for each measured one.

        Parameters
        ----------
        coordinates : ndarray, shape (n_parameters,)
        """
        n = self.frequency.size
        found, frequency, amplitude = np.zeros(n, dtype=bool), np.zeros(n), np.zeros(n)
        for group in self._groups:
            here = find_peaks(group.grid, self.joints.joints(coordinates, group.conditions))
            found[group.members] = here.found
            frequency[group.members] = here.frequency
            amplitude[group.members] = here.amplitude
        return Peaks(found, frequency, amplitude)

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        """Return the weighted relative errors, frequencies first, shape (n_peaks + n_amplitudes,) [-].

        Parameters
        ----------
        coordinates : ndarray, shape (n_parameters,)
        """
        return self._residuals(self.predict(coordinates))

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        """Return the derivatives of the residuals, shape (n_peaks + n_amplitudes, n_parameters).

        Parameters
        ----------
        coordinates : ndarray, shape (n_parameters,)
        """
        n, rows = self.frequency.size, self.joints.rows
        by_frequency, by_amplitude = np.zeros((n, len(rows))), np.zeros((n, len(rows)))
        for group in self._groups:
            joints = self.joints.joints(coordinates, group.conditions)
            here, slopes = find_peaks_with_gradient(group.grid, joints), self.joints.slopes(joints)
            by_frequency[group.members] = (here.log_frequency[rows] * here.peaks.frequency).T * slopes
            by_amplitude[group.members] = (here.log_amplitude[rows] * here.peaks.amplitude).T * slopes
        return np.concatenate(
            [
                by_frequency * (self.frequency_weight / self.frequency)[:, None],
                by_amplitude[self.with_amplitude] * (self.amplitude_weight / self.amplitude)[:, None],
            ]
        )

    def _residuals(self, predicted: Peaks) -> FloatArray:
        chosen = self.with_amplitude
        of_frequency = np.where(predicted.found, predicted.frequency / self.frequency - 1.0, MISSING_PEAK)
        of_amplitude = np.where(
            predicted.found[chosen], predicted.amplitude[chosen] / self.amplitude - 1.0, MISSING_PEAK
        )
        return np.concatenate([of_frequency * self.frequency_weight, of_amplitude * self.amplitude_weight])


def modal_problem(
    joints: JointCoordinates,
    peaks: Sequence[AssignedPeak],
    *,
    bands: Mapping[int, Band] | None = None,
    weighting: Weighting = Weighting.UNCERTAINTY,
    minimum_positions: int = 2,
    minimum_data: int | None = None,
    motor_end: MotorEnd = MotorEnd.FREE,
) -> ModalProblem:
    """Make the problem of finding the joints from peaks.

    Parameters
    ----------
    joints : JointCoordinates
    peaks : sequence of AssignedPeak
        Measured peaks with their modes, from :func:`monitor_core.identification.assignment.assign_modes`.
    bands : mapping of int to Band, optional
        Where the peak of each mode is looked for; by default :func:`mode_bands`.
    weighting : Weighting
    minimum_positions : int
        Fewer are refused. One position fits its own peaks with joints that fail elsewhere, which is the paper's point.
    minimum_data : int, optional
        Frequencies and amplitudes; by default one per free joint.
    motor_end : MotorEnd

    Raises
    ------
    NotIdentifiableError
        If there are too few positions, or fewer data than free joints.
    OutsideValidityError
        If a mode has no band, or a measured peak lies outside it.
    """
    _require_enough(peaks, minimum_positions, len(joints.free) if minimum_data is None else minimum_data)
    bands = dict(bands) if bands is not None else mode_bands(peaks)
    for one in peaks:
        band = bands.get(one.mode)
        if band is None:
            raise OutsideValidityError(f"every mode needs a band; mode {one.mode} has none")
        if not band.lower < one.observation.frequency < band.upper:
            raise OutsideValidityError(
                f"{one.observation.name} must lie in the band of mode {one.mode}, {band.lower:g} to {band.upper:g} Hz"
            )
    observations = [one.observation for one in peaks]
    with_amplitude = np.array([k for k, one in enumerate(observations) if one.amplitude is not None], dtype=np.int_)
    weigh = weighting is Weighting.UNCERTAINTY
    return ModalProblem(
        joints,
        tuple(peaks),
        bands,
        np.array([one.frequency for one in observations]),
        np.array([1.0 / relative_frequency_uncertainty(one) if weigh else 1.0 for one in observations]),
        np.array([one.amplitude for one in observations if one.amplitude is not None]),
        np.array(
            [
                1.0 / relative_amplitude_uncertainty(one) if weigh else 1.0
                for one in observations
                if one.amplitude is not None
            ]
        ),
        with_amplitude,
        _grouped(joints, peaks, bands, motor_end),
    )


def paper_objective(problem: ModalProblem, coordinates: FloatArray) -> float:
    """Return y of Eq. (26) [-]: the root of the sum of squared residuals, as printed where the weights are units.

    Parameters
    ----------
    problem : ModalProblem
    coordinates : ndarray, shape (n_parameters,)
    """
    return float(np.linalg.norm(problem.residuals(coordinates)))


def mode_bands(peaks: Sequence[AssignedPeak], *, margin: float = 0.35) -> dict[int, Band]:
    """Return a band for each mode: around its measured frequencies, up to half way (geometrically) to the next mode.

    Parameters
    ----------
    peaks : sequence of AssignedPeak
    margin : float
        By which a band reaches beyond the measured frequencies, relative. [-]

    Raises
    ------
    OutsideValidityError
        If two modes change places along the screw, so that no band holds one of them alone.
    """
    extent: dict[int, tuple[float, float]] = {}
    for one in peaks:
        low, high = extent.get(one.mode, (math.inf, 0.0))
        extent[one.mode] = (min(low, one.observation.frequency), max(high, one.observation.frequency))
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
    """Return the standard uncertainty of the frequency over the frequency [-], the default where none is stated.

    Parameters
    ----------
    observation : ModalObservation
    """
    stated = observation.frequency_uncertainty
    return FREQUENCY_UNCERTAINTY if stated is None else stated / observation.frequency


def relative_amplitude_uncertainty(observation: ModalObservation) -> float:
    """Return the standard uncertainty of the amplitude over the amplitude [-], the default where none is stated.

    Parameters
    ----------
    observation : ModalObservation
        With an amplitude.
    """
    if observation.amplitude is None or observation.amplitude_uncertainty is None:
        return AMPLITUDE_UNCERTAINTY
    return observation.amplitude_uncertainty / observation.amplitude


def _require_enough(peaks: Sequence[AssignedPeak], minimum_positions: int, minimum_data: int) -> None:
    n_positions = len({one.observation.conditions.position for one in peaks})
    if n_positions < minimum_positions:
        raise NotIdentifiableError(
            f"joints must be identified from peaks at {minimum_positions} positions at least; got {n_positions}"
        )
    n_data = len(peaks) + sum(one.observation.amplitude is not None for one in peaks)
    if n_data < minimum_data:
        raise NotIdentifiableError(
            f"the free joints need {minimum_data} frequencies and amplitudes at least; got {n_data}; measure at more "
            "positions or free fewer joints"
        )


def _grouped(
    joints: JointCoordinates, peaks: Sequence[AssignedPeak], bands: Mapping[int, Band], motor_end: MotorEnd
) -> tuple[_Group, ...]:
    """Put peaks under one preload together: they have one set of joints, and one call serves them all."""
    by_preload: dict[float | None, list[int]] = {}
    for k, one in enumerate(peaks):
        by_preload.setdefault(one.observation.conditions.preload, []).append(k)
    groups = []
    for members in by_preload.values():
        places = [Place(peaks[k].observation.conditions, bands[peaks[k].mode]) for k in members]
        grid = peak_grid(joints.axis, places, motor_end)
        groups.append(_Group(places[0].conditions, grid, np.array(members, dtype=np.int_)))
    return tuple(groups)
