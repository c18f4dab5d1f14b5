"""Peaks of the table's receptance as a case: of the receptance family, whose modes are followed by their shapes."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.fitting.coordinates import FreeParameters
from monitor_core.fitting.free_parameter import with_priors
from monitor_core.fitting.observations import AssignedPeak, ModalObservation, conditions_in_order
from monitor_core.fitting.problem import Problem
from monitor_core.fitting.residuals.peak_grid import (
    AMPLITUDE_UNCERTAINTY,
    FREQUENCY_UNCERTAINTY,
    Band,
    Place,
    mode_bands,
    peak_grid,
    relative_amplitude_uncertainty,
    relative_frequency_uncertainty,
)
from monitor_core.fitting.residuals.peak_search import find_peaks
from monitor_core.fitting.residuals.peaks import (
    PeakProblem,
    Weighting,
    paper_objective,
    peak_problem,
    receptance_axis,
)
from monitor_core.identification.cases.assignment import ModeAssignment, assign_modes
from monitor_core.identification.cases.case import POSITIONS_OF_PEAKS, PlannedMeasurements, PredictionError
from monitor_core.identification.cases.mode_tracks import track_modes
from monitor_core.models.protocol import DriveConditions
from monitor_core.models.published.receptance.joint_response import joints_of

#: Relative uncertainty of an amplitude that nobody reads: so large that it says nothing.
_NOT_READ = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class PeakCase:
    """Peaks of the table's receptance, assigned to modes; made by :func:`peak_case`."""

    drive: FreeParameters
    assignment: ModeAssignment
    bands: Mapping[int, Band]
    weighting: Weighting = Weighting.UNCERTAINTY
    priors: FloatArray | None = None  # of the coordinates, shape (2, n_parameters)

    @property
    def conditions(self) -> tuple[DriveConditions, ...]:
        """Of each peak."""
        return tuple(peak.observation.conditions for peak in self.assignment.peaks)

    def with_priors(self, priors: FloatArray) -> "PeakCase":
        """Return the case with other priors."""
        return replace(self, priors=priors)

    def problem(self, positions: Collection[float]) -> Problem:
        """Return relative errors of the peaks at these positions, weighted."""
        return with_priors(self._problem(positions, self.weighting, POSITIONS_OF_PEAKS), self.priors)

    def search_problem(self, positions: Collection[float]) -> Problem:
        """Return the same: errors of peaks can be followed from afar."""
        return self.problem(positions)

    def prediction_errors(self, coordinates: FloatArray, positions: Collection[float]) -> tuple[PredictionError, ...]:
        """Return the relative error of each frequency; 100 % where the model has no peak."""
        problem = self._problem(positions, self.weighting, 1, minimum_data=1)
        here = problem.predict(coordinates)
        return tuple(
            PredictionError(
                peak.observation.conditions,
                float(frequency / peak.observation.frequency - 1.0) if found else -1.0,
                peak.mode,
                peak.observation.frequency,
                float(frequency) if found else None,
            )
            for peak, found, frequency in zip(problem.peaks, here.found, here.frequency, strict=True)
        )

    def planned(self, coordinates: FloatArray, conditions: Sequence[DriveConditions]) -> PlannedMeasurements:
        """Return the Jacobian of the peaks that would be read, as certain as those measured are in the median."""
        of_frequency, of_amplitude = self._uncertainties()
        return planned_peaks(
            self.drive, coordinates, conditions, self.bands, of_frequency=of_frequency, of_amplitude=of_amplitude
        )

    def paper_objective(self, coordinates: FloatArray, positions: Collection[float]) -> float:
        """Return y of Eq. (26) as printed, for comparison [-]."""
        return paper_objective(self._problem(positions, Weighting.UNIT, 1, minimum_data=1), coordinates)

    def _uncertainties(self) -> tuple[float, float]:
        """Return what errors of a frequency and of an amplitude are divided by, in the median [-]."""
        peaks = [peak.observation for peak in self.assignment.peaks]
        with_amplitude = [peak for peak in peaks if peak.amplitude is not None]
        if self.weighting is Weighting.UNIT:
            return 1.0, 1.0 if with_amplitude else _NOT_READ
        of_amplitude = [relative_amplitude_uncertainty(peak) for peak in with_amplitude] or [_NOT_READ]
        of_frequency = [relative_frequency_uncertainty(peak) for peak in peaks]
        return float(np.median(of_frequency)), float(np.median(of_amplitude))

    def _problem(
        self,
        positions: Collection[float],
        weighting: Weighting,
        minimum_positions: int,
        minimum_data: int | None = None,
    ) -> PeakProblem:
        return peak_problem(
            self.drive,
            [peak for peak in self.assignment.peaks if peak.observation.conditions.position in positions],
            bands=self.bands,
            weighting=weighting,
            minimum_positions=minimum_positions,
            minimum_data=minimum_data,
        )


def peak_case(
    drive: FreeParameters,
    observations: Sequence[ModalObservation],
    *,
    near: FreeParameters | None = None,
    bands: Mapping[int, Band] | None = None,
    weighting: Weighting = Weighting.UNCERTAINTY,
) -> PeakCase:
    """Give measured peaks their modes, by where a receptance model has them: as stated, or the one that is ``near``.

    ``bands`` are where the peak of each mode is looked for; by default around the measured ones, between the other
    modes. Raises NotIdentifiableError if a peak belongs to no mode, or two at one position to the same;
    OutsideValidityError if modes change places along the screw, so that no band holds one of them alone.
    """
    assignment = assign_modes(receptance_axis(near or drive), observations)
    if bands is None:
        bands = _bands_between_modes(near or drive, assignment.peaks)
    return PeakCase(drive, assignment, bands, weighting, drive.priors)


def assigned_peaks(drive: FreeParameters, observations: Sequence[ModalObservation]) -> tuple[AssignedPeak, ...]:
    """Return measured peaks with the modes of a receptance drive as stated; raises as :func:`peak_case`."""
    return assign_modes(receptance_axis(drive), observations).peaks


def planned_peaks(
    drive: FreeParameters,
    coordinates: FloatArray,
    conditions: Sequence[DriveConditions],
    bands: Mapping[int, Band],
    *,
    of_frequency: float = FREQUENCY_UNCERTAINTY,
    of_amplitude: float = AMPLITUDE_UNCERTAINTY,
) -> PlannedMeasurements:
    """Return for each position the Jacobian of the peaks that would be read there, unless there is none.

    ``of_frequency`` and ``of_amplitude`` are relative standard uncertainties of what would be read [-].
    """
    parameters, planned = drive.record(coordinates), []
    for where in conditions:
        grid = peak_grid(receptance_axis(drive), [Place(where, band) for band in bands.values()])
        tops = find_peaks(grid, joints_of(parameters, where))
        read = zip(bands, tops.found, tops.frequency.tolist(), tops.amplitude.tolist(), strict=True)
        expected = [
            AssignedPeak(
                ModalObservation(where, frequency, of_frequency * frequency, amplitude, of_amplitude * amplitude), mode
            )
            for mode, found, frequency, amplitude in read
            if found
        ]
        if expected:
            problem = peak_problem(drive, expected, bands=bands, minimum_positions=0, minimum_data=1)
            planned.append((where, problem.jacobian(coordinates)))
    return tuple(planned)


def _bands_between_modes(drive: FreeParameters, peaks: Sequence[AssignedPeak]) -> dict[int, Band]:
    """Return a band for each measured mode, up to half way to modes of the model that nobody measured too."""
    conditions = conditions_in_order(peak.observation for peak in peaks)
    measured = {peak.mode for peak in peaks}
    columns = enumerate(track_modes(receptance_axis(drive), conditions).frequency.T.tolist(), start=1)
    others = [frequency for mode, column in columns if mode not in measured for frequency in column]
    bands = {}
    for mode, band in mode_bands(peaks).items():
        own = [peak.observation.frequency for peak in peaks if peak.mode == mode]
        lower = max([band.lower, *(math.sqrt(min(own) * other) for other in others if other < min(own))])
        upper = min([band.upper, *(math.sqrt(max(own) * other) for other in others if other > max(own))])
        bands[mode] = Band(lower, upper)
    return bands
