"""Project a trend: the textbook's interval, and readings fall into it as often as is said."""

import numpy as np
import pytest
from scipy import stats

from monitor_core.errors import NotIdentifiableError
from monitor_core.trend import FEWEST_READINGS, project


def test_the_line_is_that_of_scipy() -> None:
    rng = np.random.default_rng(1)
    days = np.sort(rng.uniform(0.0, 30.0, 15))
    values = 300.0 - 1.5 * days + rng.normal(0.0, 4.0, 15)
    fitted = stats.linregress(days, values)
    found = project(days, values, np.array([0.0, 45.0]))
    assert found.slope.value == pytest.approx(fitted.slope, rel=1e-12)
    assert found.slope.standard_uncertainty == pytest.approx(fitted.stderr, rel=1e-12)
    assert found.value == pytest.approx([fitted.intercept, fitted.intercept + 45.0 * fitted.slope], rel=1e-12)
    assert found.upper - found.value == pytest.approx(found.value - found.lower, rel=1e-12)


def test_one_more_reading_lies_in_the_interval_19_times_of_20() -> None:
    rng = np.random.default_rng(2)
    days, ahead, held, n = np.arange(0.0, 24.0, 2.0), np.array([60.0]), 0, 4000
    for _ in range(n):
        values = 300.0 - 1.5 * days + rng.normal(0.0, 4.0, days.size)
        found = project(days, values, ahead)
        held += bool(found.lower[0] < 300.0 - 1.5 * ahead[0] + rng.normal(0.0, 4.0) < found.upper[0])
    assert held / n == pytest.approx(0.95, abs=3.0 * (0.95 * 0.05 / n) ** 0.5)


def test_too_few_readings_or_one_moment_say_nothing() -> None:
    few = np.arange(FEWEST_READINGS - 1.0)
    with pytest.raises(NotIdentifiableError, match="8 readings or more, of several moments; got 7"):
        project(few, few, few)
    same = np.zeros(FEWEST_READINGS)
    with pytest.raises(NotIdentifiableError):
        project(same, same, same)
