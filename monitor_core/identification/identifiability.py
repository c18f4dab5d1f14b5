"""Judge how well a fit knows each coordinate, which it cannot distinguish, and which directions it does not see."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial

import numpy as np

from monitor_core.arrays import FloatArray, read_only
from monitor_core.fitting.problem import Bounds, Problem
from monitor_core.fitting.solver.global_search import MapFunction
from monitor_core.fitting.solver.least_squares import LocalFit
from monitor_core.identification.profiles import Profile, ProfileInterval, quantile
from monitor_core.uncertainty import Interval, IntervalKind

#: Part of the largest movement along a direction from which on a coordinate belongs to it.
_BELONGS = 0.3


class Verdict(StrEnum):
    """How well the data determine something."""

    DETERMINED = "determined"
    POORLY_DETERMINED = "poorly determined"
    NOT_DETERMINED = "not determined"


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Between the verdicts, in the unit of the coordinates; the defaults are meant for decimal logarithms."""

    determined: float = 0.03  #: standard uncertainty up to which: 7 %, the 95 % interval within 15 % either way
    not_determined: float = 0.15  #: … from which on not: the 95 % interval is a factor of two either way
    inseparable: float = 0.9  #: absolute correlation from which on two coordinates are not told apart [-]

    def verdict(self, standard_uncertainty: float) -> Verdict:
        """Return the verdict on a standard uncertainty."""
        if standard_uncertainty <= self.determined:
            return Verdict.DETERMINED
        return Verdict.POORLY_DETERMINED if standard_uncertainty < self.not_determined else Verdict.NOT_DETERMINED


@dataclass(frozen=True, slots=True, eq=False)
class Direction:
    """A direction in the coordinates, and how far the data let one move along it."""

    names: tuple[str, ...]  # of all coordinates
    movement: FloatArray  # of each coordinate while χ² rises by one residual variance, shape (n_parameters,)
    beyond_bounds: bool  # χ² would rise by less over the whole width of the bounds, where the movement is cut off
    verdict: Verdict  # on the coordinate that moves most

    def __post_init__(self) -> None:
        object.__setattr__(self, "movement", read_only(self.movement))

    @property
    def members(self) -> tuple[str, ...]:
        """Coordinates that take part, the one that moves most first."""
        order = np.argsort(-np.abs(self.movement))
        least = _BELONGS * np.max(np.abs(self.movement))
        return tuple(self.names[i] for i in order if abs(self.movement[i]) >= least)

    @property
    def factors(self) -> dict[str, float]:
        """By what each member is multiplied, where the coordinates are decimal logarithms. [-]."""
        return {name: float(10.0 ** self.movement[self.names.index(name)]) for name in self.members}

    def describe(self) -> str:
        """Say which coordinates it is: ``k_al against k_ar``, ``c_n alone``."""
        first, *others = self.members
        if not others:
            return f"{first} alone"
        sign = math.copysign(1.0, self.movement[self.names.index(first)])
        against = [name for name in others if sign * self.movement[self.names.index(name)] < 0.0]
        together = " with ".join([first, *(name for name in others if name not in against)])
        return f"{together} against {' and '.join(against)}" if against else together


def directions(fit: LocalFit, bounds: Bounds, thresholds: Thresholds) -> tuple[Direction, ...]:
    r"""Return the principal directions of what is unknown, least seen first.

    Singular vectors of :math:`J\,\mathrm{diag}(w)` with the widths w of the bounds (or the value, where they are
    infinite), so that coordinates of different units can be compared. Along the vector v with singular value
    :math:`\lambda` a movement of :math:`s\,w v/\lambda` raises χ² by one residual variance s².
    """
    values = fit.coordinates.values
    width = bounds.upper - bounds.lower
    width = np.where(np.isfinite(width), width, np.maximum(np.abs(values), 1.0))
    _, singular, vectors = np.linalg.svd(fit.jacobian * width, full_matrices=False)
    unseen = []
    for strength, vector in zip(singular[::-1], vectors[::-1], strict=True):
        farthest = 1.0 / float(np.max(np.abs(vector)))  # one coordinate then crosses its whole width
        reach = math.sqrt(fit.residual_variance) / max(float(strength), 1e-300)
        movement = min(reach, farthest) * vector * width
        if movement[np.argmax(np.abs(movement))] < 0.0:
            movement = -movement
        verdict = thresholds.verdict(float(np.max(np.abs(movement))))
        unseen.append(Direction(fit.names, movement, reach > farthest, verdict))
    return tuple(unseen)


#: The linear interval is not trusted where the profile's ends lie further from the best value than its own by this
#: factor or more, or less far by as much; nor where a bound lies within so many standard uncertainties.
TRUSTED_WITHIN = 1.2
BOUND_WITHIN = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class CoordinateJudgement:
    """What is known of one coordinate."""

    name: str
    value: float
    standard_uncertainty: float  # linear
    linear: Interval  # may reach beyond the bounds
    profile: ProfileInterval | None  # where the linear one is not to be trusted
    at_bound: bool
    verdict: Verdict

    @property
    def interval(self) -> Interval:
        """The interval to be stated."""
        return self.linear if self.profile is None else self.profile.interval


@dataclass(frozen=True, slots=True)
class InseparablePair:
    """Two coordinates of which little more than a combination is known."""

    first: str
    second: str
    correlation: float  # [-]
    if_other_known: tuple[float, float]  # standard uncertainty of each if the other were known


@dataclass(frozen=True, slots=True, eq=False)
class Identifiability:
    """What the data determine."""

    coordinates: tuple[CoordinateJudgement, ...]
    correlations: FloatArray  # shape (n_parameters, n_parameters) [-]
    pairs: tuple[InseparablePair, ...]  # most correlated first
    directions: tuple[Direction, ...]  # least seen first
    better_exists: bool  # a profile led below the fit by a hundredth of a residual variance: search again

    def __post_init__(self) -> None:
        object.__setattr__(self, "correlations", read_only(self.correlations))

    @property
    def unseen(self) -> tuple[Direction, ...]:
        """Directions along which the data do not determine what moves most."""
        return tuple(direction for direction in self.directions if direction.verdict is Verdict.NOT_DETERMINED)


def assess(
    problem: Problem,
    bounds: Bounds,
    fit: LocalFit,
    thresholds: Thresholds | None = None,
    level: float = 0.95,
    *,
    map_function: MapFunction = map,
) -> Identifiability:
    """Judge each coordinate of the best fit to a problem, and what it cannot see.

    A coordinate's verdict rests on its interval of this level, divided by the width that a standard uncertainty would
    have: the linear one, or the profile where that is not to be trusted. An open interval determines nothing. Profiles
    do not depend on each other, so ``map_function`` may spread them over processes.
    """
    thresholds = thresholds or Thresholds()
    judged = partial(judge, problem, bounds, fit, thresholds=thresholds, level=level)
    pairs = inseparable_pairs(fit, thresholds.inseparable)
    in_pairs = {name for pair in pairs for name in (pair.first, pair.second)}
    beyond = fit.coordinates.standard_uncertainties > bounds.upper - bounds.lower
    coordinates = tuple(
        _anywhere(judgement, bounds, i) if beyond[i] and judgement.name in in_pairs else judgement
        for i, judgement in enumerate(map_function(judged, range(len(fit.names))))
    )
    return Identifiability(
        coordinates=coordinates,
        correlations=correlations(fit),
        pairs=pairs,
        directions=directions(fit, bounds, thresholds),
        better_exists=any(
            coordinate.profile is not None and coordinate.profile.undercut > 0.01 for coordinate in coordinates
        ),
    )


def correlations(fit: LocalFit) -> FloatArray:
    r"""Return :math:`\rho_{ij} = C_{ij}/(\sigma_i \sigma_j)` of the coordinates, shape (n_parameters, n_parameters)."""
    uncertainty = fit.coordinates.standard_uncertainties
    return np.clip(fit.coordinates.covariance / np.outer(uncertainty, uncertainty), -1.0, 1.0)


def inseparable_pairs(fit: LocalFit, least_correlation: float = 0.9) -> tuple[InseparablePair, ...]:
    """Return the pairs whose absolute correlation is at least this, most correlated first."""
    rho, uncertainty = correlations(fit), fit.coordinates.standard_uncertainties
    pairs = []
    for i, j in zip(*np.triu_indices(len(fit.names), 1), strict=True):
        if abs(rho[i, j]) >= least_correlation:
            rest = math.sqrt(1.0 - rho[i, j] ** 2)
            deviations = (float(uncertainty[i]) * rest, float(uncertainty[j]) * rest)
            pairs.append(InseparablePair(fit.names[i], fit.names[j], float(rho[i, j]), deviations))
    return tuple(sorted(pairs, key=lambda pair: -abs(pair.correlation)))


def judge(
    problem: Problem,
    bounds: Bounds,
    fit: LocalFit,
    index: int,
    *,
    thresholds: Thresholds | None = None,
    level: float = 0.95,
) -> CoordinateJudgement:
    """Judge one coordinate of a fit, as :func:`assess` does each."""
    thresholds = thresholds or Thresholds()
    value = float(fit.coordinates.values[index])
    uncertainty = float(fit.coordinates.standard_uncertainties[index])
    factor = quantile(fit, level)
    linear = Interval(value - factor * uncertainty, value + factor * uncertainty, IntervalKind.COVERAGE, level)
    curve = Profile(problem, bounds, fit, index)
    profile = None if _linear_holds(curve, linear, uncertainty, factor) else curve.interval(level)
    stated = linear if profile is None else profile.interval
    is_open = profile is not None and (profile.open_below or profile.open_above)
    name = fit.names[index]
    return CoordinateJudgement(
        name=name,
        value=value,
        standard_uncertainty=uncertainty,
        linear=linear,
        profile=profile,
        at_bound=name in (*fit.at_lower, *fit.at_upper),
        verdict=thresholds.verdict(math.inf if is_open else (stated.upper - stated.lower) / (2.0 * factor)),
    )


def _anywhere(judgement: CoordinateJudgement, bounds: Bounds, index: int) -> CoordinateJudgement:
    """Take back an interval where two coordinates are one to the data, as springs in series are.

    The profile stays on its own side of such a ridge: that they may change places, no local step finds.
    """
    interval = Interval(
        float(bounds.lower[index]), float(bounds.upper[index]), judgement.linear.kind, judgement.linear.level
    )
    return replace(judgement, linear=interval, profile=None, verdict=Verdict.NOT_DETERMINED)


def _linear_holds(curve: Profile, linear: Interval, uncertainty: float, factor: float) -> bool:
    """Tell whether the linear interval may stand for the profile's: χ² is looked at where it ends, and at bounds."""
    reach = max(factor, BOUND_WITHIN) * uncertainty
    if not (curve.lower <= curve.best - reach and curve.best + reach <= curve.upper):
        return False
    ends: Sequence[float] = (linear.lower, linear.upper)
    return all(1.0 / TRUSTED_WITHIN < curve.root(end) / factor < TRUSTED_WITHIN for end in ends)
