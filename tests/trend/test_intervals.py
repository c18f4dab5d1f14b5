"""Intervals against tables and against what they promise."""

import math

import numpy as np
import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.trend import confidence_interval_of_mean, paper_rule

LEVELS = pytest.mark.parametrize("level", [0.8, 0.95, 0.99])


def readings_with(mean: float, scatter: float, n: int) -> np.ndarray:
    """Make readings whose sample mean and sample standard deviation are exactly these (n even)."""
    return mean + scatter * math.sqrt((n - 1) / n) * np.array([-1.0, 1.0] * (n // 2))


def test_twenty_readings_take_t_of_nineteen_degrees_of_freedom_and_not_the_papers_2_086():
    interval = confidence_interval_of_mean(readings_with(0.0, math.sqrt(20.0), 20))
    assert interval.upper == pytest.approx(2.093, abs=5e-4)  # any table of Student's t
    assert interval.lower == pytest.approx(-2.093, abs=5e-4)
    twenty_one = confidence_interval_of_mean(readings_with(0.0, 1.0, 20))
    assert twenty_one.upper * math.sqrt(20.0) != pytest.approx(2.086, abs=5e-4)


@LEVELS
def test_the_interval_covers_the_mean_as_often_as_it_says(level):
    rng = np.random.default_rng(20)
    n_trials, n = 2000, 8
    hits = sum(confidence_interval_of_mean(rng.normal(250.0, 30.0, n), level).covers(250.0) for _ in range(n_trials))
    # four standard deviations of a binomial share
    assert hits / n_trials == pytest.approx(level, abs=4.0 * math.sqrt(level * (1.0 - level) / n_trials))


def test_the_papers_rule_tells_its_own_two_levels_apart_and_not_two_halves_of_one():
    # 100 N and 200 N at the paper's largest scatter, 35.5 N: half-widths of 16.6 N
    assert paper_rule(readings_with(100.0, 35.5, 20), readings_with(200.0, 35.5, 20)).distinguished
    assert not paper_rule(readings_with(300.0, 35.5, 20), readings_with(270.0, 35.5, 20)).distinguished


def test_scatter_from_day_to_day_turns_the_papers_rule_into_a_false_alarm():
    # 20 readings of 20 N scatter a day, days that differ by 10 N: the rule knows the former only (half-width 9.4 N)
    rng = np.random.default_rng(22)
    apart = sum(
        paper_rule(
            rng.normal(rng.normal(300.0, 10.0), 20.0, 20), rng.normal(rng.normal(300.0, 10.0), 20.0, 20)
        ).distinguished
        for _ in range(400)
    )
    assert apart / 400 > 0.15


@pytest.mark.parametrize("readings", [[], [1.0], [1.0, math.nan], [[1.0, 2.0], [3.0, 4.0]]])
def test_too_few_or_broken_readings_are_refused(readings):
    with pytest.raises(OutsideValidityError):
        confidence_interval_of_mean(readings)


def test_a_level_of_one_is_refused():
    with pytest.raises(OutsideValidityError, match="level must lie between 0 and 1"):
        confidence_interval_of_mean([1.0, 2.0], level=1.0)
