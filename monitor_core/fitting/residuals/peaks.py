r"""Compare measured peaks with those of Tian's drive: Eq. (26) as printed, or weighted by what the peaks are worth.

The paper minimises over positions p and orders q

.. math::

    y = \sqrt{\sum_p \sum_q \left( \frac{f_c - f_t}{f_t} \right)^2 + \left( \frac{A_c - A_t}{A_t} \right)^2}

(c calculated, t tested): one per cent of a frequency weighs as much as one per cent of an amplitude. But a modal test
gives frequencies to 1 % and amplitudes to 20 % at best (the first order of Table 2 scatters by half while its frequency
stands still), so the amplitudes decide and the frequencies pay. Divided by their uncertainties the same residuals make
a χ². The root is monotonic and moves no minimum: both objectives are sums of squares here, and
:func:`paper_objective` is the printed number.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.coordinates import FreeParameters
from monitor_core.fitting.observations import AssignedPeak
from monitor_core.fitting.residuals.peak_search import (
    Band,
    IndexArray,
    PeakGrid,
    Peaks,
    Place,
    find_peaks,
    find_peaks_with_gradient,
    mode_bands,
    peak_grid,
    relative_amplitude_uncertainty,
    relative_frequency_uncertainty,
)
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.receptance import ReceptanceParameters
from monitor_core.models.published.receptance.joint_response import JOINT_NAMES_IN_FILE, joint_values, joints_of

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
class PeakProblem:
    """Relative errors of peak frequencies, then of amplitudes where stated; made by :func:`peak_problem`.

    A peak that the model does not have at some joints counts :data:`MISSING_PEAK`, with derivatives of zero.
    """

    drive: FreeParameters  # of the receptance family
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
        """Names of the free parameters."""
        return self.drive.free

    def predict(self, coordinates: FloatArray) -> Peaks:
        """Return the model's peak for each measured one."""
        n = self.frequency.size
        found, frequency, amplitude = np.zeros(n, dtype=bool), np.zeros(n), np.zeros(n)
        parameters = self.drive.record(coordinates)
        for group in self._groups:
            here = find_peaks(group.grid, joints_of(parameters, group.conditions))
            found[group.members] = here.found
            frequency[group.members] = here.frequency
            amplitude[group.members] = here.amplitude
        return Peaks(found, frequency, amplitude)

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        """Return the weighted relative errors, frequencies first, shape (n_peaks + n_amplitudes,) [-]."""
        return self._residuals(self.predict(coordinates))

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        """Return the derivatives of the residuals, shape (n_peaks + n_amplitudes, n_parameters)."""
        n, rows = self.frequency.size, [JOINT_NAMES_IN_FILE.index(name) for name in self.names]
        parameters = self.drive.record(coordinates)
        by_frequency, by_amplitude = np.zeros((n, len(rows))), np.zeros((n, len(rows)))
        for group in self._groups:
            joints = joints_of(parameters, group.conditions)
            here, slopes = find_peaks_with_gradient(group.grid, joints), math.log(10.0) * joint_values(joints)[rows]
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


def peak_problem(
    drive: FreeParameters,
    peaks: Sequence[AssignedPeak],
    *,
    bands: Mapping[int, Band] | None = None,
    weighting: Weighting = Weighting.UNCERTAINTY,
    minimum_positions: int = 2,
    minimum_data: int | None = None,
    motor_end: MotorEnd = MotorEnd.FREE,
) -> PeakProblem:
    """Make the problem of finding the joints from peaks.

    The drive is of the receptance family, with joints alone free; the peaks come with their modes from
    :func:`monitor_core.identification.cases.peaks.assign_modes`. The bands say where the peak of each mode is
    looked for, by default :func:`mode_bands`. The minimum of data counts frequencies and amplitudes, by default one per
    free joint. One position fits its own peaks with joints that fail elsewhere, which is the paper's point.

    ``NotIdentifiableError`` if there are too few positions, or fewer data than the minimum; ``OutsideValidityError`` if
    a mode has no band, or a measured peak lies outside it.
    """
    _require_enough(peaks, minimum_positions, len(drive.free) if minimum_data is None else minimum_data)
    bands = dict(bands) if bands is not None else mode_bands(peaks)
    for peak in peaks:
        band = bands.get(peak.mode)
        if band is None:
            raise OutsideValidityError(f"every mode needs a band; mode {peak.mode} has none")
        if not band.lower < peak.observation.frequency < band.upper:
            raise OutsideValidityError(
                f"{peak.observation.name} must lie in the band of mode {peak.mode}, {band.lower:g} to {band.upper:g} Hz"
            )
    observations = [peak.observation for peak in peaks]
    read = [observation.amplitude is not None for observation in observations]
    with_amplitude = np.array(np.flatnonzero(read), dtype=np.int_)
    weigh = weighting is Weighting.UNCERTAINTY
    return PeakProblem(
        drive,
        tuple(peaks),
        bands,
        np.array([observation.frequency for observation in observations]),
        np.array([1.0 / relative_frequency_uncertainty(observation) if weigh else 1.0 for observation in observations]),
        np.array([observation.amplitude for observation in observations if observation.amplitude is not None]),
        np.array(
            [
                1.0 / relative_amplitude_uncertainty(observation) if weigh else 1.0
                for observation in observations
                if observation.amplitude is not None
            ]
        ),
        with_amplitude,
        _grouped(drive, peaks, bands, motor_end),
    )


def paper_objective(problem: PeakProblem, coordinates: FloatArray) -> float:
    """Return y of Eq. (26) [-]: the root of the sum of squared residuals, as printed where the weights are units."""
    return float(np.linalg.norm(problem.residuals(coordinates)))


def _require_enough(peaks: Sequence[AssignedPeak], minimum_positions: int, minimum_data: int) -> None:
    n_positions = len({peak.observation.conditions.position for peak in peaks})
    if n_positions < minimum_positions:
        raise NotIdentifiableError(
            f"joints must be identified from peaks at {minimum_positions} positions at least; got {n_positions}"
        )
    n_data = len(peaks) + sum(peak.observation.amplitude is not None for peak in peaks)
    if n_data < minimum_data:
        raise NotIdentifiableError(
            f"the free joints need {minimum_data} frequencies and amplitudes at least; got {n_data}; measure at more "
            "positions or free fewer joints"
        )


def _grouped(
    drive: FreeParameters, peaks: Sequence[AssignedPeak], bands: Mapping[int, Band], motor_end: MotorEnd
) -> tuple[_Group, ...]:
    """Put peaks under one preload together: they have one set of joints, and one call serves them all."""
    by_preload: dict[float | None, list[int]] = {}
    for k, peak in enumerate(peaks):
        by_preload.setdefault(peak.observation.conditions.preload, []).append(k)
    groups = []
    for members in by_preload.values():
        places = [Place(peaks[k].observation.conditions, bands[peaks[k].mode]) for k in members]
        grid = peak_grid(receptance_axis(drive), places, motor_end)
        groups.append(_Group(places[0].conditions, grid, np.array(members, dtype=np.int_)))
    return tuple(groups)


def receptance_axis(drive: FreeParameters) -> ReceptanceParameters:
    """Return the axis as stated; raises OutsideValidityError unless it is a receptance model with only joints free."""
    if not isinstance(drive.stated, ReceptanceParameters):
        raise OutsideValidityError(f"peaks are compared with a receptance model; got a {drive.family} model")
    foreign = [name for name in drive.free if name not in JOINT_NAMES_IN_FILE]
    if foreign:
        raise OutsideValidityError(
            f"peaks are compared by their joints, {', '.join(JOINT_NAMES_IN_FILE)}; got {foreign[0]}"
        )
    return drive.stated
