"""χ² along one coordinate with all others fitted again, and the interval that it bounds."""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import MonitorCoreError, NotIdentifiableError
from monitor_core.fitting.problem import Bounds, Problem
from monitor_core.fitting.solver.least_squares import FitSettings, LocalFit, Patience, fit_local
from monitor_core.uncertainty import Interval, IntervalKind

#: Refits of the other coordinates need no more digits than the ends of an interval.
_REFIT = FitSettings(patience=Patience(200, flat=1e-6))
_WIDENINGS = 20
#: Within which share of it the end of an interval is found; where ζ itself is ten times as near, at once.
_AT_END = 2e-3
#: How finely the way to a bound is looked through before an end is called open: from a 64th of it on.
_HALVINGS = 6
#: Stands for a χ² beyond all measure (no answer of the model): the root-finder needs a number.
_BEYOND = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class ProfileInterval:
    """Interval of one coordinate from the profile of χ²."""

    name: str
    interval: Interval  # the bound stands where it is open
    open_below: bool  # the data do not exclude the lower bound
    open_above: bool
    points: FloatArray  # coordinate, and rise of χ² in residual variances, in order; shape (n_points, 2)
    undercut: float  # by how much χ² was found below the fit's, in residual variances; 0: nowhere [-]
    lowest: FloatArray  # coordinates where χ² was least: those of the fit, or a start for a better one

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", read_only(self.points))
        object.__setattr__(self, "lowest", read_only(self.lowest))


def quantile(fit: LocalFit, level: float) -> float:
    """Return half the width of the linear interval in standard uncertainties: normal, or t with s² estimated. [-]."""
    if fit.uncertainties_stated:
        return float(scipy.special.ndtri(0.5 + 0.5 * level))
    return float(scipy.special.stdtrit(fit.coordinates.degrees_of_freedom, 0.5 + 0.5 * level))


class Profile:
    r"""Root of the rise of χ² along one coordinate, each point fitted once.

    .. math::

        \zeta(\theta_j) = \sqrt{\left[\min_{\theta_{i \ne j}} \chi^2 - \chi^2_{min}\right] / s^2}

    (s² = 1 where uncertainties are stated): |θ_j − best|/σ for a linear model; Bates & Watts (1988), section 6.1.2.
    """

    def __init__(self, problem: Problem, bounds: Bounds, fit: LocalFit, index: int) -> None:
        self._problem, self._bounds, self.fit, self.index = problem, bounds, fit, index
        self.best = float(fit.coordinates.values[index])
        self.lower, self.upper = float(bounds.lower[index]), float(bounds.upper[index])
        variance = fit.coordinates.covariance[:, index]
        self._tangent = variance / variance[index]
        self._fitted = {self.best: (fit.chi_squared, np.array(fit.coordinates.values))}

    def root(self, value: float) -> float:
        """Return ζ at a value of the coordinate, within its bounds. [-]."""
        if value not in self._fitted:
            self._fitted[value] = self._refit(value)
        rise = (self._fitted[value][0] - self.fit.chi_squared) / self.fit.residual_variance
        return min(math.sqrt(max(rise, 0.0)), _BEYOND)

    def interval(self, level: float) -> ProfileInterval:
        r"""Return where :math:`\zeta` stays below its quantile: one-sided or open where a bound comes first.

        It is the part that hangs together with the minimum. From both ends all coordinates are let go once more: where
        that leads to a lower χ², the fit was not the best there is.
        """
        target = quantile(self.fit, level)
        lower, open_below = self._end(target, self.lower)
        upper, open_above = self._end(target, self.upper)
        values = sorted(self._fitted)
        rise = (np.array([self._fitted[v][0] for v in values]) - self.fit.chi_squared) / self.fit.residual_variance
        released = [self._release(self._fitted[value][1]) for value in (values[0], values[-1])]
        lowest, best_value = min([*self._fitted.values(), *released], key=lambda fitted: fitted[0])
        return ProfileInterval(
            name=self.fit.names[self.index],
            interval=Interval(lower, upper, IntervalKind.COVERAGE, level),
            open_below=open_below,
            open_above=open_above,
            points=np.column_stack([values, rise]),
            undercut=max((self.fit.chi_squared - lowest) / self.fit.residual_variance, 0.0),
            lowest=best_value,
        )

    def _end(self, target: float, bound: float) -> tuple[float, bool]:
        """Return where ζ first reaches the target on the way to a bound, or the bound and that it is open."""
        bracket = self._bracket(target, bound)
        if bracket is None:
            return bound, True
        inside, outside = bracket

        def short_of(value: float) -> float:
            short = self.root(value) - target
            return short if abs(short) > 0.1 * _AT_END * target else 0.0

        return float(scipy.optimize.brentq(short_of, inside, outside, xtol=_AT_END * abs(outside - self.best))), False

    def _bracket(self, target: float, bound: float) -> tuple[float, float] | None:
        """Return a value where ζ is below the target and the next one where it is not, or None up to the bound."""
        inside = self.best
        step = math.copysign(target * float(self.fit.coordinates.standard_uncertainties[self.index]), bound - self.best)
        for _ in range(_WIDENINGS):
            trial = self.best + step if abs(step) < abs(bound - self.best) else bound
            reached = self.root(trial)
            if reached >= target:
                return inside, trial
            if trial == bound:
                break
            inside = trial
            step *= min(max(1.1 * target / reached, 1.2), 3.0) if reached > 0.0 else 3.0
        if not math.isfinite(bound):
            return None
        # ζ need not rise steadily: a hump on the way shuts out what is beyond.
        inside = self.best
        for trial in self.best + (bound - self.best) * 0.5 ** np.arange(_HALVINGS, 0, -1):
            if self.root(float(trial)) >= target:
                return inside, float(trial)
            inside = float(trial)
        return None

    def _release(self, start: FloatArray) -> tuple[float, FloatArray]:
        """Return the χ² that all coordinates together come to from a point of the profile, and where."""
        try:
            released = fit_local(self._problem, self._bounds, start, _REFIT)
        except MonitorCoreError:
            return math.inf, start
        return released.chi_squared, released.coordinates.values

    def _refit(self, value: float) -> tuple[float, FloatArray]:
        """Return the least χ² with the coordinate held, and where; from the nearest point that is known."""
        nearest = min(self._fitted, key=lambda refitted: abs(refitted - value))
        refitted = self._fitted[nearest][1]
        held = _Held(self._problem, self.index, value)
        free = np.delete(np.arange(refitted.size), self.index)
        lower, upper = self._bounds.lower[free], self._bounds.upper[free]
        along = refitted + (value - nearest) * self._tangent
        starts = [np.clip(start[free], lower, upper) for start in (along, refitted)]
        chi_squared, start = min(((held.chi_squared(start), start) for start in starts), key=lambda pair: pair[0])
        if free.size > 0 and math.isfinite(chi_squared):
            try:
                refit = fit_local(held, Bounds(lower, upper), start, _REFIT)
                chi_squared, start = refit.chi_squared, refit.coordinates.values
            except NotIdentifiableError:  # no other coordinate matters here: what it is without them is what it is
                pass
            except MonitorCoreError:
                chi_squared = math.inf
        return chi_squared, held.complete(start)


@dataclass(frozen=True, slots=True, eq=False)
class _Held:
    """The problem with one coordinate held."""

    problem: Problem
    index: int
    value: float

    @property
    def names(self) -> tuple[str, ...]:
        return self.problem.names[: self.index] + self.problem.names[self.index + 1 :]

    def complete(self, free: FloatArray) -> FloatArray:
        return np.insert(free, self.index, self.value)

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        return self.problem.residuals(self.complete(coordinates))

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        return np.delete(self.problem.jacobian(self.complete(coordinates)), self.index, axis=1)

    def chi_squared(self, coordinates: FloatArray) -> float:
        try:
            residuals = self.residuals(coordinates)
        except MonitorCoreError:
            return math.inf
        return float(residuals @ residuals) if np.max(np.abs(residuals), initial=0.0) < 1e150 else math.inf


def profile_interval(
    problem: Problem, bounds: Bounds, fit: LocalFit, index: int, level: float = 0.95
) -> ProfileInterval:
    """Return the interval of one coordinate from the profile of χ², all others fitted again at each point.

    ``fit`` is the minimum within these bounds; where a lower χ² is found on the way, ``undercut`` says by how much and
    ``lowest`` where. The level is of coverage, in a model that is linear in some coordinates. The ends do not depend on
    how the coordinate is expressed (logarithm or not), unlike those of the linear interval.
    """
    return Profile(problem, bounds, fit, index).interval(level)
