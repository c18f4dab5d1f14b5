"""Natural frequencies as a case, for a model of any family."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.coordinates import FreeParameters
from monitor_core.fitting.observations import AssignedPeak, ModalObservation
from monitor_core.fitting.priors import with_priors
from monitor_core.fitting.problem import Problem
from monitor_core.fitting.residuals.natural_frequencies import (
    NaturalFrequencyProblem,
    assign_by_frequency,
    natural_frequency_problem,
)
from monitor_core.identification.cases.case import POSITIONS_OF_PEAKS, PlannedMeasurements, PredictionError
from monitor_core.models.protocol import DriveConditions

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
        model, planned = self.drive.model(coordinates), []
        for where in conditions:
            elastic = [found.frequency for found in model.natural_frequencies(where) if found.frequency > 0.0]
            there = [AssignedPeak(ModalObservation(where, elastic[m - 1]), m) for m in modes if m <= len(elastic)]
            if there:
                planned.append((where, NaturalFrequencyProblem(self.drive, tuple(there)).jacobian(coordinates)))
        return tuple(planned)

    def _at(self, positions: Collection[float]) -> tuple[AssignedPeak, ...]:
        return tuple(peak for peak in self.peaks if peak.observation.conditions.position in positions)


def frequency_case(drive: FreeParameters, observations: Sequence[ModalObservation]) -> FrequencyCase:
    """Give measured natural frequencies the modes of the model that they are next to; amplitudes play no part.

    Raises NotIdentifiableError if a frequency is next to no mode, or two under one condition to the same.
    """
    peaks = assign_by_frequency(drive.model(drive.start), observations, largest_shift=LARGEST_SHIFT)
    return FrequencyCase(drive, peaks, drive.priors)
