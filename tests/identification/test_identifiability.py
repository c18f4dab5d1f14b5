"""What the data determine: against closed forms (a line, Fieller's ratio), simulation of known truth, and laws."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import norm, t

from monitor_core.arrays import FloatArray
from monitor_core.fitting.problem import Bounds
from monitor_core.fitting.solver.least_squares import FitSettings, fit_local
from monitor_core.identification.identifiability import (
    Thresholds,
    Verdict,
    assess,
    correlations,
    directions,
    inseparable_pairs,
    judge,
)
from monitor_core.identification.profiles import profile_interval
from tests.fitting.test_global_search import Wells
from tests.fitting.test_least_squares import Linear, everywhere, line

Z = 1.959963984540054


@dataclass(frozen=True)
class Ratio:
    """A line through zero at θ: y = b (x − θ), whose confidence limits for θ are known exactly (Fieller, 1954)."""

    x: FloatArray
    y: FloatArray
    sigma: float
    names: tuple[str, ...] = ("theta", "b")

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        theta, b = coordinates
        return (b * (self.x - theta) - self.y) / self.sigma

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        theta, b = coordinates
        return np.column_stack([np.full(self.x.size, -b), self.x - theta]) / self.sigma

    def fieller_limits(self) -> FloatArray | None:
        """Where (a − θ b)² = z² var(a − θ b), a and b those of y = b x − a; None where they enclose nothing finite."""
        design = np.column_stack([-np.ones(self.x.size), self.x])
        c = self.sigma**2 * np.linalg.inv(design.T @ design)
        a, b = np.linalg.lstsq(design, self.y, rcond=None)[0]
        if b**2 <= Z**2 * c[1, 1]:
            return None
        return np.sort(np.roots([b**2 - Z**2 * c[1, 1], -2 * (a * b - Z**2 * c[0, 1]), a**2 - Z**2 * c[0, 0]]))


RATIO_BOUNDS = Bounds(np.array([-100.0, -10.0]), np.array([100.0, 10.0]))


def ratio(rng: np.random.Generator, slope_uncertainty: float, theta: float = -2.0) -> Ratio:
    x = np.linspace(0.0, 1.0, 6)
    sigma = slope_uncertainty * float(np.linalg.norm(x - x.mean()))
    return Ratio(x, x - theta + sigma * rng.standard_normal(x.size), sigma)


@dataclass(frozen=True)
class InSeries:
    """Two springs side by side in decimal logarithms, seen by their sum and, faintly, by the lever between them."""

    lever: float
    names: tuple[str, ...] = ("k_al", "k_ar", "c_n")

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        k_al, k_ar = 10.0 ** coordinates[:2]
        return np.array([(k_al + k_ar - 2.0) / 0.02, self.lever * (k_al - k_ar), 1e-9 * coordinates[2]])

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        d_al, d_ar = math.log(10.0) * 10.0 ** coordinates[:2]
        return np.array(
            [[d_al / 0.02, d_ar / 0.02, 0.0], [self.lever * d_al, -self.lever * d_ar, 0.0], [0.0, 0.0, 1e-9]]
        )


TWO_DECADES = Bounds(np.full(3, -1.0), np.full(3, 1.0))


@dataclass(frozen=True)
class UpperLimit:
    """10^c seen as 0 ± 1: a damping too small for the data."""

    names: tuple[str, ...] = ("c",)

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        return 10.0**coordinates

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        return np.array([math.log(10.0) * 10.0**coordinates])


def test_correlation_of_intercept_and_slope_is_the_textbooks() -> None:
    problem = line()
    x = problem.design[:, 1]
    fit = fit_local(problem, everywhere(2), np.zeros(2))
    rho = correlations(fit)
    assert rho[0, 1] == pytest.approx(-x.mean() / math.sqrt(np.mean(x**2)), rel=1e-12)
    assert np.diag(rho) == pytest.approx([1.0, 1.0])
    (pair,) = inseparable_pairs(fit, 0.5)
    # A slope through a known intercept: σ/√Σx².
    assert pair.if_other_known[1] == pytest.approx(0.5 / math.sqrt(np.sum(x**2)), rel=1e-9)
    assert inseparable_pairs(fit, 0.9) == ()


@pytest.mark.parametrize("stated", [True, False])
def test_profile_of_a_line_is_its_linear_interval(stated: bool) -> None:
    problem = line()
    fit = fit_local(problem, everywhere(2), np.zeros(2), FitSettings(uncertainties_stated=stated))
    factor = Z if stated else t.ppf(0.975, 3)
    for i, judged in enumerate(assess(problem, everywhere(2), fit).coordinates):
        half = factor * fit.coordinates.standard_uncertainties[i]
        profile = profile_interval(problem, everywhere(2), fit, i)
        assert profile.interval.upper - judged.value == pytest.approx(half, rel=2e-3)
        assert judged.value - profile.interval.lower == pytest.approx(half, rel=2e-3)
        assert judged.profile is None  # nothing to correct
        assert judged.interval.upper - judged.value == pytest.approx(half, rel=1e-9)


@pytest.mark.release
def test_profile_ends_are_fiellers() -> None:
    rng = np.random.default_rng(11)
    compared = 0
    for _ in range(20):
        problem = ratio(rng, 0.25)
        limits = problem.fieller_limits()
        if limits is None or limits[0] < -100.0:
            continue
        fit = fit_local(problem, RATIO_BOUNDS, np.array([-2.0, 1.0]))
        interval = profile_interval(problem, RATIO_BOUNDS, fit, 0).interval
        # 0.2 % of the way to the end is what the root-finder is asked for.
        assert [interval.lower, interval.upper] == pytest.approx(limits, abs=2e-3 * (limits[1] - limits[0]))
        compared += 1
    assert compared >= 15


@dataclass(frozen=True)
class Root:
    """y = √k x + b: a stiffness from frequencies, with an offset."""

    x: FloatArray
    y: FloatArray
    names: tuple[str, ...] = ("k", "b")

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        return math.sqrt(coordinates[0]) * self.x + coordinates[1] - self.y

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        return np.column_stack([0.5 * self.x / math.sqrt(coordinates[0]), np.ones(self.x.size)])


@pytest.mark.release
def test_profile_intervals_cover_95_percent_where_linear_ones_cover_84() -> None:
    # With σ(√k) = 1 and √k = 1.5 all is known: of √k itself the line's interval is exact. The linear one of k covers
    # where |u² − 1.5²| ≤ 2 z u, u the estimate of √k: for u ≥ 0.508, 83.9 % of all; nowhere below 0. The profile's
    # misses above z and where 1.5² − 3 u ≥ z² (below the bound k = 0, u negative): 2.5 and 2.1 %.
    x = np.array([-2.0, -1.0, 0.0, 1.0, 2.0]) / math.sqrt(10.0)
    bounds = Bounds(np.array([1e-8, -50.0]), np.array([400.0, 50.0]))
    rng = np.random.default_rng(4)
    n_runs, linear, profiled, stated = 400, 0, 0, 0
    for _ in range(n_runs):
        problem = Root(x, 1.5 * x + rng.standard_normal(x.size))
        fit = fit_local(problem, bounds, np.array([1.5**2, 0.0]))
        estimate = math.sqrt(fit.coordinates.values[0])
        if not fit.at_lower:
            linear += abs(estimate**2 - 1.5**2) <= Z * fit.coordinates.standard_uncertainties[0]
        judged = judge(problem, bounds, fit, 0)
        profile = judged.profile or profile_interval(problem, bounds, fit, 0)
        profiled += profile.interval.covers(1.5**2)
        stated += judged.interval.covers(1.5**2)
    expected = 1.0 - norm.cdf(math.sqrt(Z**2 + 1.5**2) - Z - 1.5)
    assert linear / n_runs == pytest.approx(expected, abs=0.055)  # three standard deviations of 400 runs
    assert 0.92 <= profiled / n_runs <= 0.98
    assert 0.92 <= stated / n_runs <= 0.98


def test_profile_does_not_depend_on_how_the_coordinate_is_expressed() -> None:
    @dataclass(frozen=True)
    class InLogarithms:
        of: Ratio
        names: tuple[str, ...] = ("log10 b", "theta")

        def residuals(self, coordinates: FloatArray) -> FloatArray:
            return self.of.residuals(np.array([coordinates[1], 10.0 ** coordinates[0]]))

        def jacobian(self, coordinates: FloatArray) -> FloatArray:
            b = 10.0 ** coordinates[0]
            plain = self.of.jacobian(np.array([coordinates[1], b]))
            return np.column_stack([plain[:, 1] * math.log(10.0) * b, plain[:, 0]])

    problem = ratio(np.random.default_rng(2), 0.2)
    plain = profile_interval(problem, RATIO_BOUNDS, fit_local(problem, RATIO_BOUNDS, np.array([-2.0, 1.0])), 1)
    bounds = Bounds(np.array([-3.0, -100.0]), np.array([1.0, 100.0]))
    other = InLogarithms(problem)
    logarithmic = profile_interval(other, bounds, fit_local(other, bounds, np.array([0.0, -2.0])), 0)
    ends = [10.0**logarithmic.interval.lower, 10.0**logarithmic.interval.upper]
    assert ends == pytest.approx([plain.interval.lower, plain.interval.upper], rel=5e-3)


def test_directions_the_data_do_not_see_are_named() -> None:
    problem = InSeries(lever=1.0)
    fit = fit_local(problem, TWO_DECADES, np.array([0.1, -0.2, 0.3]))
    damping, split, total = directions(fit, TWO_DECADES, Thresholds())
    assert damping.describe() == "c_n alone"
    assert damping.beyond_bounds
    assert damping.verdict is Verdict.NOT_DETERMINED
    assert np.max(np.abs(damping.movement)) == pytest.approx(2.0)  # cut off at the width of the bounds
    assert split.describe() in {"k_al against k_ar", "k_ar against k_al"}
    # At k_al = k_ar = 1 a movement of ± m changes k_al − k_ar by 2 m ln 10, and χ² by one where that is 1.
    assert np.abs(split.movement[:2]) == pytest.approx(np.full(2, 1.0 / (2.0 * math.log(10.0))), rel=1e-6)
    assert sorted(split.factors.values()) == pytest.approx([math.exp(-0.5), math.exp(0.5)], rel=1e-6)
    assert split.verdict is Verdict.NOT_DETERMINED
    assert total.describe() in {"k_al with k_ar", "k_ar with k_al"}
    assert total.verdict is Verdict.DETERMINED


def test_a_split_and_an_unseen_coordinate_are_judged_as_such() -> None:
    problem = InSeries(lever=4.0)
    fit = fit_local(problem, TWO_DECADES, np.array([0.1, -0.2, 0.3]))
    known = assess(problem, TWO_DECADES, fit)
    verdicts = {coordinate.name: coordinate.verdict for coordinate in known.coordinates}
    # σ(k_al)² = (0.02² + 1/lever²)/4 in parts of k_al: 0.0545 decades.
    assert known.coordinates[0].standard_uncertainty == pytest.approx(
        math.hypot(0.02, 0.25) / 2.0 / math.log(10.0), rel=1e-6
    )
    assert verdicts == {
        "k_al": Verdict.POORLY_DETERMINED,
        "k_ar": Verdict.POORLY_DETERMINED,
        "c_n": Verdict.NOT_DETERMINED,
    }
    (pair,) = known.pairs
    assert {pair.first, pair.second} == {"k_al", "k_ar"}
    assert pair.correlation == pytest.approx((0.02**2 - 0.25**2) / (0.02**2 + 0.25**2), rel=1e-6)
    assert [direction.describe() for direction in known.unseen] == ["c_n alone"]
    c_n = known.coordinates[2]
    assert c_n.profile is not None
    assert c_n.profile.open_below
    assert c_n.profile.open_above
    assert (c_n.interval.lower, c_n.interval.upper) == (-1.0, 1.0)
    assert not known.better_exists


def test_an_upper_limit_is_one_sided_and_exact() -> None:
    bounds = Bounds(np.array([-2.0]), np.array([3.0]))
    fit = fit_local(UpperLimit(), bounds, np.array([0.0]))
    assert fit.at_lower == ("c",)
    (judged,) = assess(UpperLimit(), bounds, fit).coordinates
    assert judged.at_bound
    assert judged.profile is not None
    assert judged.profile.open_below
    assert not judged.profile.open_above
    assert judged.interval.lower == -2.0
    # χ² = 10^2c rises by z² above that at the bound.
    assert judged.interval.upper == pytest.approx(0.5 * math.log10(Z**2 + 1e-4), abs=2e-3 * 5.0)
    assert judged.verdict is Verdict.NOT_DETERMINED


def test_a_profile_that_finds_a_lower_minimum_says_so() -> None:
    bounds = Bounds(np.array([-2.0]), np.array([2.0]))
    lower, higher = (fit_local(Wells(), bounds, np.array([start])) for start in (1.5, -1.5))
    assert not assess(Wells(), bounds, lower).better_exists
    judged = assess(Wells(), bounds, higher)
    assert judged.better_exists
    profile = judged.coordinates[0].profile
    assert profile is not None
    assert profile.lowest == pytest.approx([1.0], abs=1e-4)
    assert profile.undercut == pytest.approx(higher.chi_squared, rel=1e-6)


def test_verdict_is_that_of_the_thresholds() -> None:
    for sigma, expected in ((0.03, "determined"), (0.031, "poorly determined"), (0.15, "not determined")):
        assert Thresholds().verdict(sigma) is Verdict(expected)
    design = Linear(np.array([[1.0]]), np.array([0.0]), sigma=0.1)
    fit = fit_local(design, everywhere(1), np.zeros(1))
    (judged,) = assess(design, everywhere(1), fit, Thresholds(determined=0.2, not_determined=0.4)).coordinates
    assert judged.verdict is Verdict.DETERMINED


class Springs:
    """Compliances in series, read as their sum: 1/k1 + 1/k2 = 2 ± 0.01, and 1/k3 = 1 ± 0.01 beside it."""

    names = ("k1", "k2", "k3")

    def residuals(self, x: np.ndarray) -> np.ndarray:
        c = 10.0**-x
        return np.array([c[0] + c[1] - 2.0, c[0] + c[1] - 2.0, c[2] - 1.0, c[2] - 1.0]) / 0.01

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        c = -math.log(10.0) * 10.0**-x / 0.01
        return np.array([[c[0], c[1], 0.0], [c[0], c[1], 0.0], [0.0, 0.0, c[2]], [0.0, 0.0, c[2]]])


@pytest.mark.parametrize("start", [(0.0, 0.0, 0.0), (-0.28, 1.5, 0.0), (1.5, -0.28, 0.0)])
def test_springs_in_series_are_anywhere_on_their_ridge(start: tuple[float, ...]) -> None:
    # k1 and k2 may be exchanged without any reading noticing: no interval on one side of the ridge covers
    bounds = Bounds(np.full(3, -2.0), np.full(3, 2.0))
    fit = fit_local(Springs(), bounds, np.array(start))
    known = assess(Springs(), bounds, fit)
    for coordinate in known.coordinates[:2]:
        assert coordinate.verdict is Verdict.NOT_DETERMINED
        assert (coordinate.interval.lower, coordinate.interval.upper) == (-2.0, 2.0)
    assert known.coordinates[2].verdict is Verdict.DETERMINED
