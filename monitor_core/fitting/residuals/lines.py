r"""Parameters of any drive model from whole frequency responses.

The counterpart of ``response_problem`` for every family and all points of excitation and response; the residuals are
those of its :class:`ResidualForm`, the model answers by the common protocol.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.fitting.coordinates import ModelCoordinates
from monitor_core.fitting.differences import central_differences
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.fitting.residuals.receptance_lines import ResidualForm, line_weight, logarithm, real_and_imaginary
from monitor_core.fitting.sufficiency import require_enough, require_seen

#: Of a coordinate, in decades. Slopes of ln H are off by 2e-9 of the largest over the four families, whose modes have
#: damping ratios of 0.005 and more; truncation grows with their inverse fourth power.
_STEP = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class ModelResponseProblem:
    """Weighted residuals of all lines of all responses; made by :func:`model_response_problem`.

    ``dataclasses.replace(problem, form=...)`` is the same problem with the other residuals.
    """

    drive: ModelCoordinates
    observations: tuple[FrequencyResponseObservation, ...]
    form: ResidualForm = ResidualForm.COMPLEX
    _weights: FloatArray = field(init=False)  # of the residuals of the form, shape (n_lines,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_weights", np.concatenate([line_weight(one, self.form) for one in self.observations]))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return self.drive.free

    def predict(self, coordinates: FloatArray) -> tuple[ComplexArray, ...]:
        """Return the model's response for each observation, in the unit of its two points.

        Parameters
        ----------
        coordinates : ndarray, shape (n_parameters,)

        Raises
        ------
        OutsideValidityError
            If the model has no such parameters, or does not answer at these points or frequencies.
        """
        model = self.drive.build(coordinates)
        return tuple(
            model.frequency_response(
                one.frequency, one.conditions, excitation=one.excitation, response=one.response_point
            ).response
            for one in self.observations
        )

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        """Return real, then imaginary parts of all lines, shape (2 n_lines,) [-].

        Parameters
        ----------
        coordinates : ndarray, shape (n_parameters,)
        """
        calculated, tested = self._lines(coordinates), np.concatenate([one.response for one in self.observations])
        error = calculated - tested if self.form is ResidualForm.COMPLEX else logarithm(calculated / tested)
        return real_and_imaginary(error * self._weights)

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        """Return the derivatives of the residuals, shape (2 n_lines, n_parameters).

        Parameters
        ----------
        coordinates : ndarray, shape (n_parameters,)
        """
        slopes = central_differences(self._lines, coordinates, _STEP)  # of H, not of its phase, which may jump by 2π
        if self.form is ResidualForm.LOGARITHMIC:
            slopes = slopes / self._lines(coordinates)
        return real_and_imaginary(slopes * self._weights).T

    def _lines(self, coordinates: FloatArray) -> ComplexArray:
        return np.concatenate(self.predict(coordinates))


def model_response_problem(
    drive: ModelCoordinates,
    observations: Sequence[FrequencyResponseObservation],
    *,
    form: ResidualForm = ResidualForm.COMPLEX,
) -> ModelResponseProblem:
    """Make the problem of finding the free parameters from frequency responses.

    Priors are not in it: :func:`monitor_core.fitting.priors.with_priors` adds ``drive.priors``.

    Parameters
    ----------
    drive : ModelCoordinates
    observations : sequence of FrequencyResponseObservation
    form : ResidualForm
        ``LOGARITHMIC`` for a search over decades, ``COMPLEX`` for the answer.

    Raises
    ------
    NotIdentifiableError
        If there are fewer data than free parameters (a line is two), or one of these moves no line and has no prior.
    OutsideValidityError
        If a response is zero at a line and its logarithm is asked for, or the model as stated does not answer.
    """
    require_enough(drive, 2 * sum(one.frequency.size for one in observations), "real and imaginary parts of lines")
    problem = ModelResponseProblem(drive, tuple(observations), form)
    require_seen(drive, problem.jacobian(drive.start))
    return problem
