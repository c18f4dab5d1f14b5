r"""Compare whole frequency responses with a drive: every line is a datum, no peak is picked and no mode assigned.

With the same standard deviation σ of real and imaginary part the likelihood of a line is that of two independent
Gaussian residuals

.. math::

    r = \frac{1}{\sigma} \left[ \mathrm{Re}(H_c - H_t),\ \mathrm{Im}(H_c - H_t) \right]

(c calculated, t tested), so their sum of squares is the χ² whose minimum is the estimate and whose curvature is its
covariance. That is where a fit must end. It is a bad place to begin: far from the truth the calculated peaks stand
where the measured ones do not, and χ² hardly changes with where they stand. The logarithm

.. math::

    r = \frac{|H_t|}{\sigma} \left[ \ln\frac{|H_c|}{|H_t|},\ \arg\frac{H_c}{H_t} \right]

(log magnitude and phase, each with the standard deviation σ/|H_t| of first order) is the same residual near the truth
and sees from afar in which direction a resonance lies. Its weights know the measured |H_t| only, noise included, which
biases it in the second order of σ/|H_t|; it is for the search, the first one is for the answer.

Lines that a logarithm cannot hold are left out, and phases are kept within half a turn.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property

import numpy as np

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.coordinates import FreeParameters
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.fitting.problem import central_differences
from monitor_core.fitting.residuals.model_form import FormSpectrum
from monitor_core.fitting.residuals.resolution import spread_under_random_excitation
from monitor_core.fitting.residuals.response_factors import EXACT, FactorTolerance, best_factor, without_factor
from monitor_core.models.extended import ResponseCase
from monitor_core.models.protocol import DriveConditions, HasJointGradient, MotorEnd, PreparedResponse, motor_end_of
from monitor_core.response import LineSpread


def clear_lines(observation: FrequencyResponseObservation, least_signal_to_noise: float) -> BoolArray:
    """Return which lines stand so many times above their noise, shape (n_lines,)."""
    return np.asarray(np.abs(observation.response) >= least_signal_to_noise * observation.standard_deviation)


def case_of(
    observation: FrequencyResponseObservation, chosen: BoolArray, otherwise_held: MotorEnd = MotorEnd.FREE
) -> ResponseCase:
    """Return the case that a model computes for the chosen lines; a force at the table leaves the motor end held."""
    motor_end = motor_end_of(observation.excitation, otherwise_held)
    return ResponseCase(
        observation.frequency[chosen],
        observation.conditions,
        observation.excitation,
        observation.response_point,
        motor_end,
    )


def with_phase_within_half_a_turn(log_ratio: ComplexArray) -> ComplexArray:
    """Return logarithms with their imaginary parts within ±π."""
    return np.asarray(log_ratio - 2j * np.pi * np.round(log_ratio.imag / (2.0 * np.pi)))


@dataclass(frozen=True, eq=False)
class ClearResponse:
    """The clear lines of a measured response, and which setting and which gain of that it has."""

    setting: int
    gain: int
    observation: FrequencyResponseObservation
    clear: BoolArray  # of its lines
    number: int  # of the observation among those given, from 0

    @cached_property
    def response(self) -> ComplexArray:
        """Return the measured response on the clear lines, shape (n_clear,)."""
        return self.observation.response[self.clear]

    @property
    def noise(self) -> FloatArray:
        """Return the standard deviation of the logarithm by noise alone, shape (n_clear,)."""
        return (self.observation.standard_deviation / np.abs(self.observation.response))[self.clear]

    def form_deviation(self, spectrum: FormSpectrum) -> FloatArray:
        """Return the standard deviation of the logarithm by the form of the model, shape (n_clear,)."""
        return spectrum.relative_deviation(self.observation.frequency[self.clear], self.response)

    def spread(self) -> LineSpread | None:
        """Return how the windows of the estimate spread a response over lines; None if that is not stated."""
        if self.observation.spread is not None:
            return self.observation.spread.of_lines(self.clear)
        if self.observation.resolution:
            return spread_under_random_excitation(self.observation.resolution, self.response.size)
        return None


def clear_responses(
    observations: Sequence[FrequencyResponseObservation], least_signal_to_noise: float
) -> list[ClearResponse]:
    """Return the responses that have clear lines, by setting in order of appearance, then by gain.

    Equal conditions are one setting until a point repeats: a second response of the same point was taken another time.
    """
    numbers: dict[tuple[DriveConditions, int], int] = {}
    seen: dict[tuple[DriveConditions, str, str], int] = {}
    gains: dict[int, int] = {}
    clear = []
    for place, observation in enumerate(observations):
        point = (observation.conditions, str(observation.excitation), str(observation.response_point))
        repeat = seen.get(point, 0)
        seen[point] = repeat + 1
        number = numbers.setdefault((observation.conditions, repeat), len(numbers))
        gain = gains.get(number, 0)
        gains[number] = gain + 1
        clear.append(ClearResponse(number, gain, observation, clear_lines(observation, least_signal_to_noise), place))
    ordered = sorted(clear, key=lambda response: (response.setting, response.gain))
    return [response for response in ordered if np.any(response.clear)]


#: Of a coordinate, in decades, for differences of four points. Slopes of ln H are off by 2e-9 of the largest over the
#: four families, whose modes have damping ratios of 0.005 and more; truncation grows with their inverse fourth power.
_STEP = 1e-4


class ResidualForm(StrEnum):
    """How a calculated line is compared with a measured one."""

    COMPLEX = "complex"  #: real and imaginary part over σ: the likelihood
    LOGARITHMIC = "logarithmic"  #: log magnitude and phase over σ/|H|: the same nearby, and a wider way to it


@dataclass(frozen=True, slots=True, eq=False)
class ResponseProblem:
    """Weighted residuals of all lines of all responses; made by :func:`response_problem`.

    ``dataclasses.replace(problem, form=...)`` is the same problem with the other residuals. The factor of each response
    is taken out of them as far as it is not known.
    """

    drive: FreeParameters
    observations: tuple[FrequencyResponseObservation, ...]
    form: ResidualForm = ResidualForm.COMPLEX
    factors: FactorTolerance = EXACT
    _weights: FloatArray = field(init=False)  # of the residuals of the form, shape (n_lines,)
    _prepared: tuple[PreparedResponse, ...] = field(init=False)  # where the model answers for its joints alone

    def __post_init__(self) -> None:
        weights = [line_weight(observation, self.form) for observation in self.observations]
        object.__setattr__(self, "_weights", np.concatenate(weights) if weights else np.zeros(0))
        object.__setattr__(self, "_prepared", _prepared(self.drive, self.observations))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return self.drive.free

    def predict(self, coordinates: FloatArray) -> tuple[ComplexArray, ...]:
        """Return the model's response for each observation, in the unit of its two points.

        Raises OutsideValidityError if the model has no such parameters, or does not answer at these points or
        frequencies.
        """
        if self._prepared:
            parameters = self.drive.record(coordinates)
            return tuple(prepared.at(parameters) for prepared in self._prepared)
        model = self.drive.model(coordinates)
        return tuple(
            model.frequency_response(
                observation.frequency,
                observation.conditions,
                excitation=observation.excitation,
                response=observation.response_point,
            ).response
            for observation in self.observations
        )

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        """Return real, then imaginary parts of all lines, shape (2 n_lines,) [-]."""
        calculated = self._lines(coordinates)
        error = self._errors(calculated)
        parts = zip(self._split(error), self._split(self._along(calculated)), strict=True)
        return _real_and_imaginary(np.concatenate([without_factor(*each, self.factors) for each in parts]))

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        """Return the derivatives of the residuals, shape (2 n_lines, n_parameters).

        In closed form where the model has one, else by differences of four points. Of factors that are not known they
        are those with each factor where it is best: with the residuals they give the slope of χ² exactly, and their
        squares the information on the coordinates with the factors left open.
        """
        slopes = self._closed_slopes(coordinates)
        if slopes is None:  # differences of H, not of its phase, which may jump by 2π
            slopes = central_differences(self._lines, coordinates, _STEP)
        calculated = self._lines(coordinates)
        if self.form is ResidualForm.LOGARITHMIC:
            slopes = slopes / calculated
        parts = zip(
            self._split(slopes * self._weights),
            self._split(self._errors(calculated)),
            self._split(self._along(calculated)),
            strict=True,
        )
        return _real_and_imaginary(np.concatenate([self._without_factor(*each) for each in parts], axis=-1)).T

    def _lines(self, coordinates: FloatArray) -> ComplexArray:
        return np.concatenate(self.predict(coordinates))

    def _errors(self, calculated: ComplexArray) -> ComplexArray:
        """Return calculated less measured lines over their deviations, shape (n_lines,)."""
        tested = np.concatenate([observation.response for observation in self.observations])
        error = calculated - tested if self.form is ResidualForm.COMPLEX else np.log(calculated / tested)
        return np.asarray(error * self._weights)

    def _along(self, calculated: ComplexArray) -> ComplexArray:
        """Return how the errors move with the factor of their response, shape (n_lines,)."""
        return self._weights * (calculated if self.form is ResidualForm.COMPLEX else np.ones_like(calculated))

    def _without_factor(self, slopes: ComplexArray, errors: ComplexArray, along: ComplexArray) -> ComplexArray:
        """Return the slopes of one response with its factor left open, shape (n_parameters, n_lines)."""
        factor = best_factor(errors, along, self.factors) if self.form is ResidualForm.COMPLEX else 1.0
        return without_factor(factor * slopes, along, self.factors)

    def _split(self, lines: ComplexArray) -> list[ComplexArray]:
        """Return the lines of each response, of an array of shape (..., n_lines)."""
        ends = np.cumsum([observation.frequency.size for observation in self.observations])[:-1]
        return np.split(lines, ends, axis=-1)

    def _closed_slopes(self, coordinates: FloatArray) -> ComplexArray | None:
        """Return d H/d coordinate of all lines, shape (n_parameters, n_lines); None where a line has no closed form."""
        if not self._prepared:
            return None
        parameters, parts = self.drive.record(coordinates), []
        for prepared in self._prepared:
            gradient = prepared.gradient(parameters)
            if gradient is None:
                return None
            rows = [prepared.joint_names.index(name) for name in self.drive.free]
            parts.append(math.log(10.0) * gradient[rows])
        return np.concatenate(parts, axis=1)


def response_problem(
    drive: FreeParameters,
    observations: Sequence[FrequencyResponseObservation],
    *,
    form: ResidualForm = ResidualForm.COMPLEX,
    factors: FactorTolerance = EXACT,
    minimum_positions: int = 1,
) -> ResponseProblem:
    """Make the problem of finding the free parameters from frequency responses at so many positions or more.

    Their ``factors`` count as exact unless it is said how well they are known.

    Priors are not in it: :func:`monitor_core.fitting.problem.with_priors` adds ``drive.priors``.

    Raises NotIdentifiableError if there are too few positions, fewer data than free parameters (a line is two), or one
    of these moves no line and has no prior; OutsideValidityError if a response is zero at a line and its logarithm is
    asked for, or the model as stated does not answer.
    """
    n_positions = len({observation.conditions.position for observation in observations})
    if n_positions < minimum_positions and minimum_positions > 1:
        raise NotIdentifiableError(
            f"joints must be identified from responses at {minimum_positions} positions at least; got {n_positions}"
        )
    n_lines = sum(observation.frequency.size for observation in observations)
    drive.require_enough(2 * n_lines, "real and imaginary parts of lines")
    problem = ResponseProblem(drive, tuple(observations), form, factors)
    drive.require_seen(problem.jacobian(drive.start))
    return problem


def line_weight(observation: FrequencyResponseObservation, form: ResidualForm) -> FloatArray:
    """Return what the residual of each line is multiplied with, shape (n_frequencies,)."""
    if form is ResidualForm.COMPLEX:
        return 1.0 / observation.standard_deviation
    magnitude = np.abs(observation.response)
    if not np.all(magnitude > 0.0):
        zero = observation.frequency[magnitude.argmin()]
        raise OutsideValidityError(f"a response must not be zero where its logarithm is compared; got 0 at {zero:g} Hz")
    return np.asarray(magnitude / observation.standard_deviation)


def _prepared(
    drive: FreeParameters, observations: Sequence[FrequencyResponseObservation]
) -> tuple[PreparedResponse, ...]:
    """Return the responses as functions of the joints alone; none where more than joints, or no such model, is free."""
    model = drive.model(drive.start)
    if not isinstance(model, HasJointGradient):
        return ()
    prepared = tuple(
        model.joint_response(
            observation.frequency, observation.conditions, observation.excitation, observation.response_point
        )
        for observation in observations
    )
    return prepared if all(set(drive.free) <= set(lines.joint_names) for lines in prepared) else ()


def _real_and_imaginary(values: ComplexArray) -> FloatArray:
    """Put the imaginary parts behind the real ones, along the last axis."""
    parts: FloatArray = np.concatenate([values.real, values.imag], axis=-1)
    return parts
