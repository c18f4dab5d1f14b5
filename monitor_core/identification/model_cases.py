"""What was measured as cases for a model of any family; of the receptance family ``cases`` knows more."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.coordinates import ModelCoordinates
from monitor_core.fitting.observations import AssignedPeak, FrequencyResponseObservation, ModalObservation
from monitor_core.fitting.priors import with_priors
from monitor_core.fitting.problem import Problem
from monitor_core.fitting.residuals.lines import ModelResponseProblem, model_response_problem
from monitor_core.fitting.residuals.natural_frequencies import (
    NaturalFrequencyProblem,
    assign_by_frequency,
    natural_frequency_problem,
)
from monitor_core.fitting.residuals.receptance_lines import ResidualForm
from monitor_core.identification.cases import (
    POSITIONS_OF_PEAKS,
    PredictionError,
    median_relative_noise,
    response_errors,
)
from monitor_core.models.protocol import DriveConditions

#: By how much a natural frequency may lie off the model as stated: one joint ten times too soft takes a third off it.
LARGEST_SHIFT = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyCase:
    """Natural frequencies assigned to the modes of a model; made by :func:`frequency_case`."""

    drive: ModelCoordinates
    peaks: tuple[AssignedPeak, ...]
    priors: FloatArray | None = None  # of the coordinates, from :func:`relative_priors`

    @property
    def conditions(self) -> tuple[DriveConditions, ...]:
        """Of each frequency."""
        return tuple(one.observation.conditions for one in self.peaks)

    def with_priors(self, priors: FloatArray) -> "FrequencyCase":
        """Return the case with other priors."""
        return replace(self, priors=priors)

    def problem(self, positions: Collection[float]) -> Problem:
        """Return logarithmic errors of the frequencies at these positions, over their uncertainties."""
        if len(positions) < POSITIONS_OF_PEAKS:
            raise NotIdentifiableError(
                f"joints must be identified from frequencies at {POSITIONS_OF_PEAKS} positions at least; got "
                f"{len(positions)}"
            )
        return with_priors(natural_frequency_problem(self.drive, self._at(positions)), self.priors)

    def search_problem(self, positions: Collection[float]) -> Problem:
        """Return the same: errors of frequencies can be followed from afar."""
        return self.problem(positions)

    def prediction_errors(self, coordinates: FloatArray, positions: Collection[float]) -> tuple[PredictionError, ...]:
        """Return the relative error of each frequency."""
        peaks = self._at(positions)
        predicted = NaturalFrequencyProblem(self.drive, peaks).predict(coordinates)
        return tuple(
            PredictionError(
                one.observation.conditions,
                float(frequency / one.observation.frequency - 1.0),
                one.mode,
                one.observation.frequency,
                float(frequency),
            )
            for one, frequency in zip(peaks, predicted, strict=True)
        )

    def planned(
        self, coordinates: FloatArray, conditions: Sequence[DriveConditions]
    ) -> tuple[tuple[DriveConditions, FloatArray], ...]:
        """Return the Jacobian of the frequencies of the measured modes."""
        modes = sorted({one.mode for one in self.peaks})
        model, planned = self.drive.build(coordinates), []
        for one in conditions:
            elastic = [f.frequency for f in model.natural_frequencies(one) if f.frequency > 0.0]
            there = [AssignedPeak(ModalObservation(one, elastic[m - 1]), m) for m in modes if m <= len(elastic)]
            if there:
                planned.append((one, NaturalFrequencyProblem(self.drive, tuple(there)).jacobian(coordinates)))
        return tuple(planned)

    def _at(self, positions: Collection[float]) -> tuple[AssignedPeak, ...]:
        return tuple(one for one in self.peaks if one.observation.conditions.position in positions)


@dataclass(frozen=True, slots=True, eq=False)
class ModelResponseCase:
    """Whole frequency responses with the noise of their lines."""

    drive: ModelCoordinates
    observations: tuple[FrequencyResponseObservation, ...]
    priors: FloatArray | None = None  # of the coordinates, from :func:`relative_priors`

    @property
    def conditions(self) -> tuple[DriveConditions, ...]:
        """Of each response."""
        return tuple(one.conditions for one in self.observations)

    def with_priors(self, priors: FloatArray) -> "ModelResponseCase":
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
        predicted = ModelResponseProblem(self.drive, observations).predict(coordinates)
        return response_errors(observations, predicted)

    def planned(
        self, coordinates: FloatArray, conditions: Sequence[DriveConditions]
    ) -> tuple[tuple[DriveConditions, FloatArray], ...]:
        """Return the Jacobian of responses over the lines, and with the relative noise, of those measured."""
        first, model, planned = self.observations[0], self.drive.build(coordinates), []
        noise = median_relative_noise(self.observations)
        for one in conditions:
            response = model.frequency_response(
                first.frequency, one, excitation=first.excitation, response=first.response_point
            ).response
            expected = FrequencyResponseObservation(
                one, first.frequency, response, noise * np.abs(response), first.excitation, first.response_point
            )
            planned.append((one, ModelResponseProblem(self.drive, (expected,)).jacobian(coordinates)))
        return tuple(planned)

    def _problem(self, positions: Collection[float], form: ResidualForm) -> Problem:
        return with_priors(model_response_problem(self.drive, self._at(positions), form=form), self.priors)

    def _at(self, positions: Collection[float]) -> tuple[FrequencyResponseObservation, ...]:
        return tuple(one for one in self.observations if one.conditions.position in positions)


def frequency_case(drive: ModelCoordinates, observations: Sequence[ModalObservation]) -> FrequencyCase:
    """Give measured natural frequencies the modes of the model that they are next to.

    Parameters
    ----------
    drive : ModelCoordinates
    observations : sequence of ModalObservation
        Amplitudes play no part.

    Raises
    ------
    NotIdentifiableError
        If a frequency is next to no mode, or two under one condition to the same.
    """
    peaks = assign_by_frequency(drive.build(drive.start), observations, largest_shift=LARGEST_SHIFT)
    return FrequencyCase(drive, peaks, drive.priors)
