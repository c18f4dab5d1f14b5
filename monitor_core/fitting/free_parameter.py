"""A free parameter of a fit: its name, how its coordinate becomes its value, and what is known of it beforehand.

A fit moves coordinates, plain numbers of comparable size. An identification moves decimal logarithms of stiffnesses; an
explanation moves the sizes of effects in their scales, and uncertain parameters in their standard deviations. Both
state what they move as such records, and their priors become residuals in the same way.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from monitor_core.arrays import FloatArray


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
