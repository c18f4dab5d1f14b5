r"""Joints from whole frequency responses: every line is a datum, no peak is picked and no mode assigned.

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
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.differences import central_differences
from monitor_core.fitting.joint_coordinates import JointCoordinates
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.models.protocol import ExcitationPoint, MotorEnd, ResponsePoint, motor_end_of
from monitor_core.models.published.receptance.closed_form import (
    PositionTerms,
    position_terms,
    receptance_between,
    table_receptance,
    table_receptance_gradient,
)
from monitor_core.models.published.receptance.parameters import JointParameters

#: Step of a coordinate for differences of four points, in decades: slopes are off by 2e-9 of the largest.
_STEP = 1e-4


class ResidualForm(StrEnum):
    """How a calculated line is compared with a measured one."""

    COMPLEX = "complex"  #: real and imaginary part over σ: the likelihood
    LOGARITHMIC = "logarithmic"  #: log magnitude and phase over σ/|H|: the same nearby, and a wider way to it


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """One observation with what does not depend on the joints."""

    observation: FrequencyResponseObservation
    terms: PositionTerms
    scale: ComplexArray  # from displacement to the response: 1 or −ω²
    weight: FloatArray  # of the residual of the form, shape (n_frequencies,)


@dataclass(frozen=True, slots=True, eq=False)
class ResponseProblem:
    """Weighted residuals of all lines of all responses; made by :func:`response_problem`."""

    joints: JointCoordinates
    form: ResidualForm
    _measured: tuple[_Measured, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free joints."""
        return self.joints.free

    @property
    def observations(self) -> tuple[FrequencyResponseObservation, ...]:
        """What was measured."""
        return tuple(one.observation for one in self._measured)

    def predict(self, coordinates: FloatArray) -> tuple[ComplexArray, ...]:
        """Return the model's response for each observation.

        Parameters
        ----------
        coordinates : ndarray, shape (n_parameters,)
        """
        return tuple(
            one.scale * _displacement(one, self.joints.joints(coordinates, one.observation.conditions))
            for one in self._measured
        )

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        """Return the residuals, real and imaginary parts of each observation in turn, shape (2 n_lines,) [-].

        Parameters
        ----------
        coordinates : ndarray, shape (n_parameters,)
        """
        parts: list[ComplexArray] = []
        for one, response in zip(self._measured, self.predict(coordinates), strict=True):
            tested = one.observation.response
            if self.form is ResidualForm.COMPLEX:
                parts.append((response - tested) * one.weight)
            else:
                parts.append(logarithm(response / tested) * one.weight)
        return real_and_imaginary(np.concatenate(parts))

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        """Return the derivatives of the residuals, shape (2 n_lines, n_parameters).

        Analytic for force and displacement or acceleration at the table; central differences for the other points.

        Parameters
        ----------
        coordinates : ndarray, shape (n_parameters,)
        """
        parts: list[ComplexArray] = []
        for one in self._measured:
            response, slopes = self._with_slopes(one, coordinates)
            if self.form is ResidualForm.COMPLEX:
                parts.append(slopes * (one.scale * one.weight))
            else:
                parts.append(slopes * (one.weight / response))
        return real_and_imaginary(np.concatenate(parts, axis=1)).T

    def _with_slopes(self, one: _Measured, coordinates: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return displacement or angle, and its derivatives with respect to the coordinates, (n_parameters, n)."""
        joints = self.joints.joints(coordinates, one.observation.conditions)
        if _is_table_receptance(one.observation):
            response, gradient = table_receptance_gradient(one.terms, joints)
            return response, gradient[self.joints.rows] * self.joints.slopes(joints)[:, None]
        return _displacement(one, joints), central_differences(
            lambda x: _displacement(one, self.joints.joints(x, one.observation.conditions)), coordinates, _STEP
        )


def response_problem(
    joints: JointCoordinates,
    observations: Sequence[FrequencyResponseObservation],
    *,
    form: ResidualForm = ResidualForm.COMPLEX,
    minimum_positions: int = 1,
) -> ResponseProblem:
    """Make the problem of finding the joints from frequency responses.

    Parameters
    ----------
    joints : JointCoordinates
    observations : sequence of FrequencyResponseObservation
    form : ResidualForm
        ``LOGARITHMIC`` for a search over decades, ``COMPLEX`` for the answer.
    minimum_positions : int
        Fewer are refused.

    Raises
    ------
    NotIdentifiableError
        If there are too few positions, or fewer lines than free joints.
    OutsideValidityError
        If a response is zero at a line and its logarithm is asked for, or a position is not on the screw.
    """
    n_positions, needed = len({one.conditions.position for one in observations}), max(minimum_positions, 1)
    if n_positions < needed:
        raise NotIdentifiableError(
            f"joints must be identified from responses at {needed} positions at least; got {n_positions}"
        )
    n_lines = sum(one.frequency.size for one in observations)
    if 2 * n_lines < len(joints.free):
        raise NotIdentifiableError(
            f"{len(joints.free)} free joints need half as many lines at least; got {n_lines}; measure more lines"
        )
    return ResponseProblem(joints, form, tuple(_prepared(joints, one, form) for one in observations))


def in_form(problem: ResponseProblem, form: ResidualForm) -> ResponseProblem:
    """Return the same problem with the other residuals.

    Parameters
    ----------
    problem : ResponseProblem
    form : ResidualForm

    Raises
    ------
    OutsideValidityError
        If a response is zero at a line and its logarithm is asked for.
    """
    measured = tuple(replace(one, weight=line_weight(one.observation, form)) for one in problem._measured)
    return ResponseProblem(problem.joints, form, measured)


def _prepared(joints: JointCoordinates, one: FrequencyResponseObservation, form: ResidualForm) -> _Measured:
    omega = 2.0 * np.pi * one.frequency
    scale = np.asarray(-(omega**2) if one.response_point.is_acceleration else np.ones_like(omega), dtype=np.complex128)
    terms = position_terms(joints.axis, omega, one.conditions, motor_end_of(one.excitation, MotorEnd.FREE))
    return _Measured(one, terms, scale, line_weight(one, form))


def logarithm(ratio: ComplexArray) -> ComplexArray:
    """Return log magnitude and, as imaginary part, phase within ±π."""
    logarithm: ComplexArray = np.log(ratio)
    return logarithm


def line_weight(one: FrequencyResponseObservation, form: ResidualForm) -> FloatArray:
    """Return what the residual of each line is multiplied with, shape (n_frequencies,)."""
    if form is ResidualForm.COMPLEX:
        return 1.0 / one.standard_deviation
    magnitude = np.abs(one.response)
    if not np.all(magnitude > 0.0):
        zero = one.frequency[magnitude.argmin()]
        raise OutsideValidityError(f"a response must not be zero where its logarithm is compared; got 0 at {zero:g} Hz")
    return np.asarray(magnitude / one.standard_deviation)


def _is_table_receptance(one: FrequencyResponseObservation) -> bool:
    of_table = (ResponsePoint.ACCELERATION_AT_TABLE, ResponsePoint.DISPLACEMENT_AT_TABLE)
    return one.excitation is ExcitationPoint.FORCE_AT_TABLE and one.response_point in of_table


def _displacement(one: _Measured, joints: JointParameters) -> ComplexArray:
    """Return the displacement of table or nut, or the angle of the motor, per unit excitation."""
    observation = one.observation
    if _is_table_receptance(observation):
        return table_receptance(one.terms, joints)
    return receptance_between(one.terms, joints, observation.excitation, observation.response_point)


def real_and_imaginary(values: ComplexArray) -> FloatArray:
    """Put the imaginary parts behind the real ones, along the last axis."""
    parts: FloatArray = np.concatenate([values.real, values.imag], axis=-1)
    return parts
