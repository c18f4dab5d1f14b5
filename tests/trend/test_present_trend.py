"""The present rate: a step is no rate, an onset dated late gives none, and what may be the season has a wide interval.

The sessions are drawn here, as a known curve with a scatter that depends from day to day or not.
"""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from monitor_core.trend import PresentTrend, Session, present_trend

START, YEAR = datetime(2026, 1, 5, 6, tzinfo=UTC), 365.25

#: What is lost by a day, in standard deviations of a session, and the rate of it at the end; changes are at day 40.
Course = tuple[Callable[[np.ndarray], np.ndarray], float, int]
COURSES: dict[str, Course] = {
    "step, then flat": (lambda t: np.where(t >= 40, 12.0, 0.0), 0.0, 70),
    "step, then slope": (lambda t: np.where(t >= 40, 8.0 + 0.3 * (t - 40), 0.0), 0.3, 70),
    "slope": (lambda t: 0.3 * np.clip(t - 40, 0, None), 0.3, 80),
    "slow slope": (lambda t: 0.1 * np.clip(t - 40, 0, None), 0.1, 100),
}


def sessions(values: np.ndarray, days: np.ndarray) -> list[Session]:
    moments = [START + timedelta(days=float(day)) for day in days]
    return [Session(at, at, 1, float(value)) for at, value in zip(moments, values, strict=True)]


def scatter(rng: np.random.Generator, n: int, correlation: float) -> np.ndarray:
    values = rng.standard_normal(n)
    for i in range(1, n):
        values[i] = correlation * values[i - 1] + (1.0 - correlation**2) ** 0.5 * values[i]
    return values


def present(course: str, seed: int, correlation: float) -> PresentTrend:
    curve, _, n = COURSES[course]
    days = np.arange(n, dtype=float)
    rng = np.random.default_rng([571, seed, round(10 * correlation)])
    return present_trend(sessions(curve(days) + scatter(rng, n, correlation), days), alarmed=True)


def misses(course: str, draws: int, correlation: float) -> int:
    """Count the lines whose 95 % interval leaves the present rate out, those that are not drawn included."""
    missed = 0
    for seed in range(draws):
        line = present(course, seed, correlation).line
        true = COURSES[course][1] * YEAR
        missed += line is None or abs(line.slope.value - true) > line.slope.expanded_uncertainty
    return missed


@pytest.mark.parametrize("course", COURSES)
def test_the_present_rate_is_covered_whatever_was_before(course: str) -> None:
    """Canary: of six, two or more are missed by one in thirty at .95."""
    assert misses(course, 6, 0.0) <= 1


@pytest.mark.release
@pytest.mark.parametrize("correlation", [0.0, 0.6])
@pytest.mark.parametrize("course", COURSES)
def test_the_present_rate_is_covered_in_most_draws(course: str, correlation: float) -> None:
    """Of 100, 13 or more are missed by one in a thousand at .95."""
    assert misses(course, 100, correlation) <= 12


def test_a_step_is_found_where_it_was_and_is_no_rate() -> None:
    found = present("step, then flat", 1, 0.0)
    assert found.changed_at == START + timedelta(days=40)
    assert found.n_since == 30
    assert found.line is not None
    assert abs(found.line.slope.value) < 0.1 * 12.0 / 30.0 * YEAR  # a tenth of what a mean since then would be
    assert abs(found.line.at_end.value - 12.0) < 3.0 * found.line.at_end.standard_uncertainty


def test_soon_after_a_step_nothing_is_said_of_a_rate() -> None:
    values = np.append(np.zeros(40), np.full(6, 12.0)) + scatter(np.random.default_rng(3), 46, 0.0)
    found = present_trend(sessions(values, np.arange(46.0)), alarmed=True)
    assert (found.changed_at, found.n_since, found.line) == (START + timedelta(days=40), 6, None)


def test_what_may_be_the_season_has_an_interval_that_says_so() -> None:
    """Two months of a healthy season: 2 standard deviations of amplitude on its steep side are no evident rate."""
    days = np.arange(60.0)
    for seed in range(4):
        season = 2.0 * np.sin(2.0 * np.pi * days / YEAR)
        found = present_trend(sessions(season + scatter(np.random.default_rng([4, seed]), 60, 0.0), days))
        assert found.changed_at is None
        assert found.line is not None
        assert abs(found.line.slope.value) < found.line.slope.expanded_uncertainty


def test_steady_wear_that_raises_an_alarm_keeps_its_rate() -> None:
    """It falls from the first session on, and thirty days tell its rate; of six, one may look as if it changed."""
    days, changed = np.arange(30.0), 0
    for seed in range(6):
        worn = sessions(0.3 * days + scatter(np.random.default_rng([8, seed]), 30, 0.0), days)
        found = present_trend(worn, alarmed=True)
        changed += found.changed_at is not None
        assert found.line is not None
        assert abs(found.line.slope.value - 0.3 * YEAR) < 1.5 * found.line.slope.expanded_uncertainty
    assert changed <= 1


def test_healthy_sessions_have_no_change() -> None:
    for seed in range(4):
        values = scatter(np.random.default_rng([5, seed]), 60, 0.6 * (seed % 2))
        found = present_trend(sessions(values, np.arange(60.0)))
        assert (found.changed_at, found.n_since) == (None, 60)


@pytest.mark.release
@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_one_more_session_lies_in_the_projection(correlation: float) -> None:
    """Twenty days ahead of a line, as often as is said: of 200, 23 or more misses are one in ten thousand at .95."""
    missed, days = 0, np.arange(80.0)
    for seed in range(200):
        rng = np.random.default_rng([6, seed, round(10 * correlation)])
        values = 0.05 * days + scatter(rng, 80, correlation)
        line = present_trend(sessions(values[:60], days[:60])).line
        assert line is not None
        ahead = line.ahead(20.0 / YEAR)
        missed += abs(ahead.value - values[79]) > ahead.expanded_uncertainty
    assert missed <= 22
