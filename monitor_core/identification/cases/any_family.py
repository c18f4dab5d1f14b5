"""Pose measurements as the problems of a fit, for a model of any family: natural frequencies or whole responses.

Every case answers alike: the problems that can be made of its measurements, and how far a prediction is off.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.coordinates import FreeParameters
from monitor_core.fitting.observations import AssignedPeak, FrequencyResponseObservation, ModalObservation
from monitor_core.fitting.problem import Problem, with_priors
from monitor_core.fitting.residuals.lines import ResidualForm, ResponseProblem, response_problem
from monitor_core.fitting.residuals.natural_frequencies import (
    NaturalFrequencyProblem,
    assign_by_frequency,
    natural_frequency_problem,
)
from monitor_core.fitting.residuals.response_factors import KNOWN_TO_5_PERCENT, FactorTolerance
from monitor_core.models.extended import elastic_frequencies
from monitor_core.models.protocol import DriveConditions

#: Positions that peaks are needed at: one position fits its own peaks with joints that fail elsewhere.
POSITIONS_OF_PEAKS = 2

#: The Jacobian of what a further measurement of the same kind would say, under each of some conditions.
PlannedMeasurements = tuple[tuple[DriveConditions, FloatArray], ...]


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
    def drive(self) -> FreeParameters:
        """The drive with its free parameters."""
        ...

    @property
    def conditions(self) -> tuple[DriveConditions, ...]:
        """Of each datum."""
        ...

    @property
    def priors(self) -> FloatArray | None:
        """Estimates and standard uncertainties of the coordinates beforehand, shape (2, n_parameters)."""
        ...

    def with_priors(self, priors: FloatArray) -> "Case":
        """Return the case with other priors."""
        ...

    def problem(self, positions: Collection[float], minimum_positions: int = POSITIONS_OF_PEAKS) -> Problem:
        """Return the problem whose minimum is the answer, of the data at these positions [m], peaks at a minimum."""
        ...

    def search_problem(self, positions: Collection[float]) -> Problem:
        """Return the problem to look for that minimum with, from afar."""
        ...

    def prediction_errors(self, coordinates: FloatArray, positions: Collection[float]) -> tuple[PredictionError, ...]:
        """Return how far the model with these coordinates is off at the positions [m]."""
        ...

    def planned(self, coordinates: FloatArray, conditions: Sequence[DriveConditions]) -> PlannedMeasurements:
        """Return the Jacobian of what more measurements of the same kind would say, for each of the conditions."""
        ...


def positions_of(case: Case) -> tuple[float, ...]:
    """Return the measured positions in rising order [m]."""
    return tuple(sorted({conditions.position for conditions in case.conditions}))


def require_positions(case: Case, wanted: Collection[float]) -> None:
    """Refuse a position at which nothing was measured."""
    measured = positions_of(case)
    for position in wanted:
        if position not in measured:
            listed = ", ".join(f"{1e3 * x:g}" for x in measured)
            raise NotIdentifiableError(
                f"a position to hold out must be a measured one, {listed} mm; got {1e3 * position:g} mm"
            )


#: By how much a natural frequency may lie off the model as stated: one joint ten times too soft takes a third off it.
LARGEST_SHIFT = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyCase:
    """Natural frequencies assigned to the modes of a model; made by :func:`frequency_case`."""

    drive: FreeParameters
    peaks: tuple[AssignedPeak, ...]
    priors: FloatArray | None = None  # of the coordinates, shape (2, n_parameters)

    @property
    def conditions(self) -> tuple[DriveConditions, ...]:
        """Of each frequency."""
        return tuple(peak.observation.conditions for peak in self.peaks)

    def with_priors(self, priors: FloatArray) -> "FrequencyCase":
        """Return the case with other priors."""
        return replace(self, priors=priors)

    def problem(self, positions: Collection[float], minimum_positions: int = POSITIONS_OF_PEAKS) -> Problem:
        """Return logarithmic errors of the frequencies at these positions, over their uncertainties."""
        if len(positions) < minimum_positions:
            raise NotIdentifiableError(
                f"joints must be identified from frequencies at {minimum_positions} positions at least; got "
                f"{len(positions)}"
            )
        return with_priors(natural_frequency_problem(self.drive, self._at(positions)), self.priors)

    def search_problem(self, positions: Collection[float]) -> Problem:
        """Return the same: errors of frequencies can be followed from afar."""
        return self.problem(positions)

    def prediction_errors(self, coordinates: FloatArray, positions: Collection[float]) -> tuple[PredictionError, ...]:
        """Return the relative error of each frequency."""
        peaks = self._at(positions)
        predicted = NaturalFrequencyProblem(self.drive, peaks).predict(coordinates).tolist()
        return tuple(
            PredictionError(
                peak.observation.conditions,
                frequency / peak.observation.frequency - 1.0,
                peak.mode,
                peak.observation.frequency,
                frequency,
            )
            for peak, frequency in zip(peaks, predicted, strict=True)
        )

    def planned(self, coordinates: FloatArray, conditions: Sequence[DriveConditions]) -> PlannedMeasurements:
        """Return the Jacobian of the frequencies of the measured modes."""
        modes = sorted({peak.mode for peak in self.peaks})
        planned = []
        for stated, elastic in zip(
            conditions, elastic_frequencies(self.drive.model(coordinates), conditions), strict=True
        ):
            peaks = [AssignedPeak(ModalObservation(stated, elastic[m - 1]), m) for m in modes if m <= elastic.size]
            if peaks:
                planned.append((stated, NaturalFrequencyProblem(self.drive, tuple(peaks)).jacobian(coordinates)))
        return tuple(planned)

    def _at(self, positions: Collection[float]) -> tuple[AssignedPeak, ...]:
        return tuple(peak for peak in self.peaks if peak.observation.conditions.position in positions)


def frequency_case(
    drive: FreeParameters, observations: Sequence[ModalObservation], near: FreeParameters | None = None
) -> FrequencyCase:
    """Give measured natural frequencies the modes of the model that they are next to; amplitudes play no part.

    The model is the drive as stated, or the one that is ``near``. Raises NotIdentifiableError if a frequency is next to
    no mode, or two under one condition to the same.
    """
    return FrequencyCase(drive, assigned_frequencies(near or drive, observations), drive.priors)


def assigned_frequencies(drive: FreeParameters, observations: Sequence[ModalObservation]) -> tuple[AssignedPeak, ...]:
    """Return natural frequencies with the modes of a drive as stated; raises as :func:`frequency_case`."""
    return assign_by_frequency(drive.model(drive.start), observations, largest_shift=LARGEST_SHIFT)


@dataclass(frozen=True, slots=True, eq=False)
class ResponseCase:
    """Whole frequency responses with the noise of their lines, each known up to a factor."""

    drive: FreeParameters
    observations: tuple[FrequencyResponseObservation, ...]
    priors: FloatArray | None = None  # of the coordinates, shape (2, n_parameters)
    factors: FactorTolerance = KNOWN_TO_5_PERCENT

    @property
    def conditions(self) -> tuple[DriveConditions, ...]:
        """Of each response."""
        return tuple(observation.conditions for observation in self.observations)

    def with_priors(self, priors: FloatArray) -> "ResponseCase":
        """Return the case with other priors."""
        return replace(self, priors=priors)

    def problem(self, positions: Collection[float], minimum_positions: int = 1) -> Problem:
        """Return complex differences over the noise."""
        return self._problem(positions, ResidualForm.COMPLEX)

    def search_problem(self, positions: Collection[float]) -> Problem:
        """Return log magnitude and phase: a resonance that stands beside its own still tells which way to go."""
        return self._problem(positions, ResidualForm.LOGARITHMIC)

    def prediction_errors(self, coordinates: FloatArray, positions: Collection[float]) -> tuple[PredictionError, ...]:
        """Return the root mean square of ln(H/H measured) of each response."""
        observations = self._at(positions)
        predicted = ResponseProblem(self.drive, observations).predict(coordinates)
        return tuple(
            PredictionError(
                measured.conditions, float(np.sqrt(np.mean(np.abs(np.log(model / measured.response)) ** 2)))
            )
            for measured, model in zip(observations, predicted, strict=True)
        )

    def planned(self, coordinates: FloatArray, conditions: Sequence[DriveConditions]) -> PlannedMeasurements:
        """Return the Jacobian of responses like the first one, with the median of the relative noise of all."""
        first, planned = self.observations[0], []
        noise = float(
            np.median([np.median(lines.standard_deviation / np.abs(lines.response)) for lines in self.observations])
        )
        for where in conditions:
            there = replace(first, conditions=where, spread=None)
            (response,) = ResponseProblem(self.drive, (there,)).predict(coordinates)
            expected = replace(there, response=response, standard_deviation=noise * np.abs(response))
            planned.append(
                (where, ResponseProblem(self.drive, (expected,), factors=self.factors).jacobian(coordinates))
            )
        return tuple(planned)

    def _problem(self, positions: Collection[float], form: ResidualForm) -> Problem:
        problem = response_problem(self.drive, self._at(positions), form=form, factors=self.factors)
        return with_priors(problem, self.priors)

    def _at(self, positions: Collection[float]) -> tuple[FrequencyResponseObservation, ...]:
        return tuple(lines for lines in self.observations if lines.conditions.position in positions)
