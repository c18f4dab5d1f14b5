"""Define what a fit moves and minimises: free parameters with priors, and residuals in units of their uncertainty.

A fit moves coordinates, plain numbers of comparable size. An identification moves decimal logarithms of stiffnesses; an
explanation moves the sizes of effects in their scales, and uncertain parameters in their standard deviations. Both
state what they move as such records, and their priors become residuals in the same way, as further data.

A function without derivatives in closed form has them by differences.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import OutsideValidityError


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """Where each coordinate of a fit may lie."""

    lower: FloatArray  # shape (n_parameters,)
    upper: FloatArray  # shape (n_parameters,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "lower", read_only(self.lower))
        object.__setattr__(self, "upper", read_only(self.upper))
        if self.lower.shape != self.upper.shape or self.lower.ndim != 1 or not (self.lower < self.upper).all():
            raise OutsideValidityError("lower bounds must lie below upper bounds, one of each per parameter")


class Problem(Protocol):
    """Residuals of a model against data, in coordinates that a fit may move freely.

    The coordinates are the fit's own (decimal logarithms of stiffnesses and dampings, or the parameters as they are):
    a fit knows nothing of them but their number. Residuals are divided by the standard uncertainty of the datum, so
    that their sum of squares is a χ² where the uncertainties are stated.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates, in order."""
        ...

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        """Return the weighted residuals, shape (n_residuals,) [-]."""
        ...

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        """Return their derivatives, shape (n_residuals, n_parameters)."""
        ...


_Number = TypeVar("_Number", np.float64, np.complex128)


def central_differences(
    function: Callable[[FloatArray], npt.NDArray[_Number]], coordinates: FloatArray, step: float
) -> npt.NDArray[_Number]:
    r"""Return the derivatives of a function from four points of each coordinate, shape (n_parameters, n_values).

    .. math::

        y' = \frac{8 (y_{+h} - y_{-h}) - (y_{+2h} - y_{-2h})}{12 h} + O(h^4)

    with the step h in decades. Two points reach 1e-8, which is not enough: joints in series (bearing, bracket,
    coupling) are not told apart by any natural frequency, and errors of 1e-8 pass for what tells them apart. The
    standard uncertainty of a predicted frequency of Nguyen's axis then comes out a third too large.
    """
    slopes = []
    for direction in step * np.eye(coordinates.size):
        near = function(coordinates + direction) - function(coordinates - direction)
        far = function(coordinates + 2.0 * direction) - function(coordinates - 2.0 * direction)
        slopes.append((8.0 * near - far) / (12.0 * step))
    return np.array(slopes)


@dataclass(frozen=True, slots=True)
class Linear:
    """A value that grows by ``scale`` with each unit of its coordinate."""

    origin: float  # value at coordinate 0
    scale: float  # may be negative, not 0

    def value(self, coordinate: float) -> float:
        """Return the value at a coordinate."""
        return self.origin + self.scale * coordinate

    def coordinate(self, value: float) -> float:
        """Return the coordinate of a value."""
        return (value - self.origin) / self.scale


@dataclass(frozen=True, slots=True)
class Decades:
    """A positive value that grows tenfold with each unit of its coordinate: the coordinate is its decimal logarithm."""

    def value(self, coordinate: float) -> float:
        """Return the value at a coordinate."""
        return float(10.0**coordinate)

    def coordinate(self, value: float) -> float:
        """Return the coordinate of a positive value."""
        return float(np.log10(value))


Transform: TypeAlias = Linear | Decades


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of a coordinate before anything is measured; Gaussian."""

    estimate: float
    standard_uncertainty: float  # infinite where nothing is known


@dataclass(frozen=True, slots=True)
class FreeParameter:
    """One coordinate of a fit."""

    name: str
    transform: Transform
    prior: Prior = Prior(0.0, math.inf)  # of the coordinate


def positive_parameter(name: str, value: float, relative: float = math.inf) -> FreeParameter:
    """Return a positive parameter in decades, with a relative prior standard deviation about its stated value.

    A relative standard deviation r is that of the natural logarithm, Gaussian in ln p: the standard uncertainty of the
    coordinate is r/ln 10.
    """
    return FreeParameter(name, Decades(), Prior(Decades().coordinate(value), relative / math.log(10.0)))


def stated_priors(parameters: Sequence[FreeParameter]) -> FloatArray:
    """Return estimates and standard uncertainties of the coordinates, shape (2, n_parameters)."""
    priors = [(parameter.prior.estimate, parameter.prior.standard_uncertainty) for parameter in parameters]
    return np.array(priors).reshape(-1, 2).T


def prior_residuals(priors: FloatArray, coordinates: FloatArray) -> FloatArray:
    """Return (x − x₀)/u of each coordinate that something is known of.

    ``priors`` are estimates x₀ and standard uncertainties u, infinite where nothing is known, shape (2, n_parameters).
    """
    estimate, standard_uncertainty = priors
    stated = np.isfinite(standard_uncertainty)
    return np.asarray((coordinates - estimate)[stated] / standard_uncertainty[stated])


def prior_jacobian(priors: FloatArray) -> FloatArray:
    """Return the derivatives of :func:`prior_residuals`, shape (n_known, n_parameters)."""
    return np.asarray(np.diag(1.0 / priors[1])[np.isfinite(priors[1])])


@dataclass(frozen=True, slots=True, eq=False)
class WithPriors:
    """A problem with one more residual, (x − x₀)/u, for each coordinate that a prior estimate x₀ ± u is stated of."""

    problem: Problem
    estimate: FloatArray  # x₀, shape (n_parameters,)
    standard_uncertainty: FloatArray  # u; infinite where nothing is known, shape (n_parameters,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "estimate", read_only(self.estimate))
        object.__setattr__(self, "standard_uncertainty", read_only(self.standard_uncertainty))
        expected = (len(self.problem.names),)
        if self.estimate.shape != expected or self.standard_uncertainty.shape != expected:
            raise OutsideValidityError(
                f"a prior needs an estimate and a standard uncertainty for each of {expected[0]} coordinates; got "
                f"{self.estimate.shape} and {self.standard_uncertainty.shape}"
            )
        if not np.all(self.standard_uncertainty > 0.0):
            raise OutsideValidityError(
                f"standard uncertainties of a prior must be positive; got {self.standard_uncertainty.min()}"
            )

    @property
    def priors(self) -> FloatArray:
        """Estimates and standard uncertainties, shape (2, n_parameters)."""
        return np.array([self.estimate, self.standard_uncertainty])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return self.problem.names

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        """Return the residuals of the data, then those of the priors."""
        return np.concatenate([self.problem.residuals(coordinates), prior_residuals(self.priors, coordinates)])

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        """Return their derivatives, shape (n_residuals, n_parameters)."""
        return np.concatenate([self.problem.jacobian(coordinates), prior_jacobian(self.priors)])


def with_priors(problem: Problem, priors: FloatArray | None) -> Problem:
    """Return the problem with its priors, of shape (2, n_parameters), or as it is without any."""
    return problem if priors is None else WithPriors(problem, priors[0], priors[1])
