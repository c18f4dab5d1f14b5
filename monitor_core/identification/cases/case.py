"""What every case answers: the problems that can be made of its measurements, and how far a prediction is off."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Protocol

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.coordinates import FreeParameters
from monitor_core.fitting.problem import Problem
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

    def problem(self, positions: Collection[float]) -> Problem:
        """Return the problem whose minimum is the answer, of the data at these positions [m]."""
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
            listed = ", ".join(f"{1e3 * known:g}" for known in measured)
            raise NotIdentifiableError(
                f"a position to hold out must be a measured one, {listed} mm; got {1e3 * position:g} mm"
            )
