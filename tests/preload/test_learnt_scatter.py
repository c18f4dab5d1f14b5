"""An interval follows the scatter that the axis has shown, wider or narrower, and the declared where little was."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats

from monitor_core.preload import excess_variance_of, widened, with_history
from monitor_core.uncertainty import Interval, IntervalKind

K3 = 2097e-8  # Nguyen et al. (2018), Table 3 [s²·N^(1/3)]


def feature(preload: float) -> float:
    return K3 * preload ** (-1 / 3)


def interval_of(preload: float, scatter: float) -> Interval:
    """Return the interval that a feature known to so much has, by Eq. (8) at both its ends."""
    ends = [(feature(preload) + side * 1.959963985 * scatter) / K3 for side in (1.0, -1.0)]
    return Interval(ends[0] ** -3.0, ends[1] ** -3.0 if ends[1] > 0.0 else math.inf, IntervalKind.COVERAGE)


@given(preload=st.floats(30.0, 900.0), own=st.floats(1e-3, 0.1), learnt=st.floats(1e-3, 0.1))
def test_variances_add_in_the_feature(preload: float, own: float, learnt: float) -> None:
    own, learnt = own * feature(preload), learnt * feature(preload)
    found = widened(interval_of(preload, own), preload, feature(preload), learnt**2)
    expected = interval_of(preload, math.hypot(own, learnt))
    back = widened(expected, preload, feature(preload), -(learnt**2))
    if math.isfinite(expected.upper):
        assert (back.lower, back.upper) == pytest.approx(
            (interval_of(preload, own).lower, interval_of(preload, own).upper), rel=1e-4
        )
    assert (found.lower, found.upper) == pytest.approx((expected.lower, expected.upper), rel=1e-7)


def test_as_much_as_was_budgeted_changes_nothing() -> None:
    interval = interval_of(300.0, 1e-8)
    assert widened(interval, 300.0, feature(300.0), excess_variance_of(1e-8, 1e-8)) is interval


def test_declared_and_shown_scatter_are_pooled_as_a_bayesian_pools_them() -> None:
    # the mean of 1/σ² under a gamma prior of eight degrees of freedom, by brute force over σ²
    declared, shown, dof = 1.0, 0.5, 24.0
    precision = np.linspace(1e-4, 30.0, 400_001)
    of_prior = stats.gamma.pdf(precision, 4.0, scale=1.0 / (4.0 * declared**2))
    likelihood = precision ** (dof / 2.0) * np.exp(-0.5 * dof * shown**2 * precision)
    mean = float((precision * of_prior * likelihood).sum() / (of_prior * likelihood).sum())
    assert with_history(declared, shown, dof) == pytest.approx(mean**-0.5, rel=1e-4)
    assert with_history(1.0, 2.0, dof) > 1.5
    assert with_history(1.0, 2.0, 0.0) == 1.0


def test_an_open_end_stays_open() -> None:
    found = widened(Interval(0.0, math.inf, IntervalKind.COVERAGE), 300.0, feature(300.0), 1e-16)
    assert (found.lower, found.upper) == (0.0, math.inf)
    assert widened(interval_of(300.0, 1e-8), 300.0, feature(300.0), feature(300.0) ** 2).upper == math.inf


def test_an_axis_that_scatters_more_than_its_calibration_knew_is_covered_all_the_same() -> None:
    rng, truth = np.random.default_rng(7), 300.0
    own, day = 0.002 * feature(truth), 0.006 * feature(truth)  # the day is not in the budget
    measured = feature(truth) + math.hypot(own, day) * rng.standard_normal(2000)
    preloads = (measured / K3) ** -3.0
    stated = [interval_of(p, own) for p in preloads]
    learnt = excess_variance_of(float(measured.std()), own)
    wider = [widened(i, p, g, learnt) for i, p, g in zip(stated, preloads, measured, strict=True)]
    assert np.mean([i.covers(truth) for i in stated]) < 0.6
    assert np.mean([i.covers(truth) for i in wider]) == pytest.approx(0.95, abs=0.015)  # three standard errors
