"""Whole frequency responses as a case."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.fitting.coordinates import FreeParameters
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.fitting.priors import with_priors
from monitor_core.fitting.problem import Problem
from monitor_core.fitting.residuals.lines import ResidualForm, ResponseProblem, response_problem
from monitor_core.identification.cases.case import PlannedMeasurements, PredictionError
from monitor_core.models.protocol import DriveConditions


@dataclass(frozen=True, slots=True, eq=False)
class ResponseCase:
    """Whole frequency responses with the noise of their lines."""

    drive: FreeParameters
    observations: tuple[FrequencyResponseObservation, ...]
    priors: FloatArray | None = None  # of the coordinates, shape (2, n_parameters)

    @property
    def conditions(self) -> tuple[DriveConditions, ...]:
        """Of each response."""
        return tuple(observation.conditions for observation in self.observations)

    def with_priors(self, priors: FloatArray) -> "ResponseCase":
        """Return the case with other priors."""
        return replace(self, priors=priors)

    def problem(self, positions: Collection[float]) -> Problem:
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
            planned.append((where, ResponseProblem(self.drive, (expected,)).jacobian(coordinates)))
        return tuple(planned)

    def _problem(self, positions: Collection[float], form: ResidualForm) -> Problem:
        return with_priors(response_problem(self.drive, self._at(positions), form=form), self.priors)

    def _at(self, positions: Collection[float]) -> tuple[FrequencyResponseObservation, ...]:
        return tuple(lines for lines in self.observations if lines.conditions.position in positions)
