"""What was measured as cases: peaks or whole responses at positions, of which any can be left out and predicted."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.joint_coordinates import JointCoordinates
from monitor_core.fitting.observations import (
    AssignedPeak,
    FrequencyResponseObservation,
    ModalObservation,
    conditions_in_order,
)
from monitor_core.fitting.priors import with_priors
from monitor_core.fitting.problem import Problem
from monitor_core.fitting.residuals.peak_search import Band
from monitor_core.fitting.residuals.peaks import (
    ModalProblem,
    Weighting,
    modal_problem,
    mode_bands,
    paper_objective,
    relative_amplitude_uncertainty,
    relative_frequency_uncertainty,
)
from monitor_core.fitting.residuals.receptance_lines import ResidualForm, response_problem
from monitor_core.identification.assignment import ModeAssignment, assign_modes
from monitor_core.identification.mode_tracks import track_modes
from monitor_core.identification.planning import planned_peaks
from monitor_core.models.protocol import DriveConditions

#: Positions that peaks are needed at: one position fits its own peaks with joints that fail elsewhere.
POSITIONS_OF_PEAKS = 2
#: Relative uncertainty of an amplitude that nobody reads: so large that it says nothing.
_NOT_READ = 1e9


@dataclass(frozen=True, slots=True)
class PredictionError:
    """How far a prediction is off at a position that played no part in the fit.

    Of a peak, the frequency; of a whole response, the root mean square of ln|H| and phase over its lines, which is
    relative too.
    """

    conditions: DriveConditions
    relative_error: float  # of a peak: predicted/measured − 1 [-]
    mode: int | None = None  # of a peak, from 1
    measured: float | None = None  # frequency of the peak [Hz]
    predicted: float | None = None  # the same of the model; None: it has no peak there [Hz]


class Case(Protocol):
    """Measurements at positions, and the problems that can be made of them."""

    @property
    def conditions(self) -> tuple[DriveConditions, ...]:
        """Of each datum."""
        ...

    @property
    def priors(self) -> FloatArray | None:
        """What is known of the coordinates beforehand, from :func:`relative_priors`."""
        ...

    def with_priors(self, priors: FloatArray) -> "Case":
        """Return the case with other priors."""
        ...

    def problem(self, positions: Collection[float]) -> Problem:
        """Return the problem whose minimum is the answer, of the data at these positions [m]."""
        ...

    def search_problem(self, positions: Collection[float]) -> Problem:
        """Return the problem to look for that minimum with, from afar."""
        ...

    def prediction_errors(self, coordinates: FloatArray, positions: Collection[float]) -> tuple[PredictionError, ...]:
        """Return how far the model with these coordinates is off at the positions [m]."""
        ...

    def planned(
        self, coordinates: FloatArray, conditions: Sequence[DriveConditions]
    ) -> tuple[tuple[DriveConditions, FloatArray], ...]:
        """Return the Jacobian of what more measurements of the same kind would say, for each of the conditions."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PeakCase:
    """Peaks of the table's receptance, assigned to modes; made by :func:`peak_case`."""

    joints: JointCoordinates
    assignment: ModeAssignment
    bands: Mapping[int, Band]
    weighting: Weighting = Weighting.UNCERTAINTY
    priors: FloatArray | None = None  # of the coordinates, from :func:`relative_priors`

    @property
    def conditions(self) -> tuple[DriveConditions, ...]:
        """Of each peak."""
        return tuple(one.observation.conditions for one in self.assignment.peaks)

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
                one.observation.conditions,
                float(frequency / one.observation.frequency - 1.0) if found else -1.0,
                one.mode,
                one.observation.frequency,
                float(frequency) if found else None,
            )
            for one, found, frequency in zip(problem.peaks, here.found, here.frequency, strict=True)
        )

    def planned(
        self, coordinates: FloatArray, conditions: Sequence[DriveConditions]
    ) -> tuple[tuple[DriveConditions, FloatArray], ...]:
        """Return the Jacobian of the peaks that would be read, as certain as those measured are in the median."""
        of_frequency, of_amplitude = self._uncertainties()
        return planned_peaks(
            self.joints,
            coordinates,
            conditions,
            self.bands,
            relative_frequency_uncertainty=of_frequency,
            relative_amplitude_uncertainty=of_amplitude,
        )

    def paper_objective(self, coordinates: FloatArray, positions: Collection[float]) -> float:
        """Return y of Eq. (26) as printed, for comparison [-]."""
        return paper_objective(self._problem(positions, Weighting.UNIT, 1, minimum_data=1), coordinates)

    def _uncertainties(self) -> tuple[float, float]:
        """Return what errors of a frequency and of an amplitude are divided by, in the median [-]."""
        peaks = [one.observation for one in self.assignment.peaks]
        with_amplitude = [one for one in peaks if one.amplitude is not None]
        if self.weighting is Weighting.UNIT:
            return 1.0, 1.0 if with_amplitude else _NOT_READ
        of_amplitude = [relative_amplitude_uncertainty(one) for one in with_amplitude] or [_NOT_READ]
        return float(np.median([relative_frequency_uncertainty(one) for one in peaks])), float(np.median(of_amplitude))

    def _problem(
        self,
        positions: Collection[float],
        weighting: Weighting,
        minimum_positions: int,
        minimum_data: int | None = None,
    ) -> ModalProblem:
        peaks = [one for one in self.assignment.peaks if one.observation.conditions.position in positions]
        return modal_problem(
            self.joints,
            peaks,
            bands=self.bands,
            weighting=weighting,
            minimum_positions=minimum_positions,
            minimum_data=minimum_data,
        )


@dataclass(frozen=True, slots=True, eq=False)
class ResponseCase:
    """Whole frequency responses with the noise of their lines."""

    joints: JointCoordinates
    observations: tuple[FrequencyResponseObservation, ...]
    priors: FloatArray | None = None  # of the coordinates, from :func:`relative_priors`

    @property
    def conditions(self) -> tuple[DriveConditions, ...]:
        """Of each response."""
        return tuple(one.conditions for one in self.observations)

    def with_priors(self, priors: FloatArray) -> "ResponseCase":
        """Return the case with other priors."""
        return replace(self, priors=priors)

    def problem(self, positions: Collection[float]) -> Problem:
        """Return complex differences over the noise."""
        return with_priors(response_problem(self.joints, self._at(positions)), self.priors)

    def search_problem(self, positions: Collection[float]) -> Problem:
        """Return log magnitude and phase: a resonance that stands beside its own still tells which way to go."""
        logarithmic = response_problem(self.joints, self._at(positions), form=ResidualForm.LOGARITHMIC)
        return with_priors(logarithmic, self.priors)

    def prediction_errors(self, coordinates: FloatArray, positions: Collection[float]) -> tuple[PredictionError, ...]:
        """Return the root mean square of ln(H/H measured) of each response."""
        observations = self._at(positions)
        predicted = response_problem(self.joints, observations).predict(coordinates)
        return response_errors(observations, predicted)

    def planned(
        self, coordinates: FloatArray, conditions: Sequence[DriveConditions]
    ) -> tuple[tuple[DriveConditions, FloatArray], ...]:
        """Return the Jacobian of responses like the first one, with the median of the relative noise of all."""
        first = self.observations[0]
        noise = median_relative_noise(self.observations)
        planned = []
        for one in conditions:
            there = replace(first, conditions=one)
            (response,) = response_problem(self.joints, [there]).predict(coordinates)
            expected = replace(there, response=response, standard_deviation=noise * np.abs(response))
            planned.append((one, response_problem(self.joints, [expected]).jacobian(coordinates)))
        return tuple(planned)

    def _at(self, positions: Collection[float]) -> tuple[FrequencyResponseObservation, ...]:
        return tuple(one for one in self.observations if one.conditions.position in positions)


def response_errors(
    observations: Sequence[FrequencyResponseObservation], predicted: Sequence[ComplexArray]
) -> tuple[PredictionError, ...]:
    """Return the root mean square of ln(H/H measured) of each response; predictions in the order of the measured."""
    return tuple(
        PredictionError(one.conditions, float(np.sqrt(np.mean(np.abs(np.log(model / one.response)) ** 2))))
        for one, model in zip(observations, predicted, strict=True)
    )


def median_relative_noise(observations: Sequence[FrequencyResponseObservation]) -> float:
    """Return the standard deviation of a line over |H|, in the median of the lines and then of the responses [-]."""
    return float(np.median([np.median(one.standard_deviation / np.abs(one.response)) for one in observations]))


def peak_case(
    joints: JointCoordinates,
    observations: Sequence[ModalObservation],
    *,
    bands: Mapping[int, Band] | None = None,
    weighting: Weighting = Weighting.UNCERTAINTY,
    priors: FloatArray | None = None,
) -> PeakCase:
    """Give measured peaks their modes.

    Parameters
    ----------
    joints : JointCoordinates
        Its axis says where the modes lie, as far as the joints are known.
    observations : sequence of ModalObservation
    bands : mapping of int to Band, optional
        Where the peak of each mode is looked for; by default around the measured ones, between the other modes.
    weighting : Weighting
    priors : ndarray, shape (2, n_parameters), optional
        Of the coordinates, from :func:`relative_priors`.

    Raises
    ------
    NotIdentifiableError
        If a peak belongs to no mode, or two at one position to the same.
    OutsideValidityError
        If modes change places along the screw, so that no band holds one of them alone.
    """
    assignment = assign_modes(joints.axis, observations)
    if bands is None:
        bands = _bands_between_modes(joints, assignment.peaks)
    return PeakCase(joints, assignment, bands, weighting, priors)


def _bands_between_modes(joints: JointCoordinates, peaks: Sequence[AssignedPeak]) -> dict[int, Band]:
    """Return a band for each measured mode, up to half way to modes of the model that nobody measured too."""
    conditions = conditions_in_order(one.observation for one in peaks)
    measured = {one.mode for one in peaks}
    columns = enumerate(track_modes(joints.axis, conditions).frequency.T.tolist(), start=1)
    others = [frequency for mode, column in columns if mode not in measured for frequency in column]
    bands = {}
    for mode, band in mode_bands(peaks).items():
        own = [one.observation.frequency for one in peaks if one.mode == mode]
        lower = max([band.lower, *(math.sqrt(min(own) * other) for other in others if other < min(own))])
        upper = min([band.upper, *(math.sqrt(max(own) * other) for other in others if other > max(own))])
        bands[mode] = Band(lower, upper)
    return bands


def positions_of(case: Case) -> tuple[float, ...]:
    """Return the measured positions in rising order [m]."""
    return tuple(sorted({one.position for one in case.conditions}))


def require_positions(case: Case, wanted: Collection[float]) -> None:
    """Refuse a position at which nothing was measured."""
    measured = positions_of(case)
    for position in wanted:
        if position not in measured:
            listed = ", ".join(f"{1e3 * one:g}" for one in measured)
            raise NotIdentifiableError(
                f"a position to hold out must be a measured one, {listed} mm; got {1e3 * position:g} mm"
            )
