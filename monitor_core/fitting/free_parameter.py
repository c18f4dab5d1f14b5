"""A free parameter of a fit: its name, how its coordinate becomes its value, and what is known of it beforehand.

A fit moves coordinates, plain numbers of comparable size. An identification moves decimal logarithms of stiffnesses; an
explanation moves the sizes of effects in their scales, and uncertain parameters in their standard deviations. Both
state what they move as such records, and their priors become residuals in the same way.

What is known of coordinates before anything is measured, as further data of a fit.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.problem import Problem


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
    known = np.isfinite(standard_uncertainty)
    return np.asarray((coordinates - estimate)[known] / standard_uncertainty[known])


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
