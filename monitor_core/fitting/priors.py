"""What is known of joints before anything is measured, as further data of a problem."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.problem import Problem


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
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return self.problem.names

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        """Return the residuals of the data, then those of the priors."""
        known = np.isfinite(self.standard_uncertainty)
        of_prior = (coordinates - self.estimate)[known] / self.standard_uncertainty[known]
        return np.concatenate([self.problem.residuals(coordinates), of_prior])

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        """Return their derivatives, shape (n_residuals, n_parameters)."""
        known = np.isfinite(self.standard_uncertainty)
        of_prior = np.diag(1.0 / self.standard_uncertainty)[known]
        return np.concatenate([self.problem.jacobian(coordinates), of_prior])


def with_priors(problem: Problem, priors: FloatArray | None) -> Problem:
    """Return the problem with its priors, from :func:`relative_priors`, or as it is without any."""
    return problem if priors is None else WithPriors(problem, priors[0], priors[1])


def relative_priors(
    names: tuple[str, ...], values: Mapping[str, float], relative: Mapping[str, float]
) -> FloatArray | None:
    """Return estimates and standard uncertainties of decimal logarithms, shape (2, n_parameters); none without a prior.

    A relative standard deviation r is that of the natural logarithm, Gaussian in ln p, so that u = r/ln 10.
    """
    if not relative:
        return None
    uncertainty = [relative.get(name, math.inf) / math.log(10.0) for name in names]
    return np.array([np.log10([values[name] for name in names]), uncertainty])
