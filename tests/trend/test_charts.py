"""Run lengths against published tables and against the charts themselves."""

import math

import numpy as np
import pytest
from scipy import stats

from monitor_core.errors import OutsideValidityError
from monitor_core.trend.charts import (
    cusum_run_length,
    cusum_step,
    ewma_run_length,
    ewma_step,
    shewhart_run_length,
    winsorise,
)


@pytest.mark.parametrize(
    ("limit", "shift", "published"),
    # Montgomery, Introduction to Statistical Quality Control, Table 9.3 (k = 1/2, two-sided)
    [(4.0, 0.0, 168.0), (5.0, 0.0, 465.0), (4.0, 1.0, 8.38), (5.0, 1.0, 10.4), (4.0, 0.5, 26.6), (5.0, 2.0, 4.01)],
)
def test_two_sided_cusum_meets_the_table(limit, shift, published):
    # both sides cannot signal together while h > k, so that their rates add (Lucas & Crosier 1982, Eq. 6)
    up = cusum_run_length(limit, reference=0.5, shift=shift)
    down = cusum_run_length(limit, reference=0.5, shift=-shift)
    assert 1.0 / (1.0 / up + 1.0 / down) == pytest.approx(published, rel=5e-3)  # three digits are printed


@pytest.mark.parametrize(
    ("weight", "width", "shift", "published"),
    # Lucas & Saccucci (1990), Table 3
    [(0.1, 2.814, 0.0, 500.0), (0.2, 2.962, 0.0, 500.0), (0.1, 2.814, 1.0, 10.3), (0.2, 2.962, 1.0, 10.5)],
)
def test_two_sided_ewma_meets_the_table(weight, width, shift, published):
    limit = width * math.sqrt(weight / (2.0 - weight))
    assert ewma_run_length(limit, weight=weight, shift=shift, n_cells=161) == pytest.approx(published, rel=5e-3)


def test_charts_meet_the_published_comparison_of_rules():
    """Limits for one false alarm in a year of hourly windows; windows to detect 20 N at σ = 8, 20 and 35 N."""
    shift = 20.0 / np.array([8.0, 20.0, 35.0])
    hourly = pytest.approx(8766.0, rel=0.03)  # the limits are printed to three digits
    assert cusum_run_length(12.9, reference=0.25) == hourly
    assert shewhart_run_length(3.69) == hourly
    limit = 3.39 * math.sqrt(0.05 / 1.95)
    assert 2.0 * ewma_run_length(limit, weight=0.05, n_cells=161) == hourly  # the table counts falls only

    def published(*windows):
        return pytest.approx(np.array(windows), rel=0.06)  # two digits, simulated

    assert shewhart_run_length(3.69, shift=shift) == published(9.0, 295.0, 1153.0)
    assert ewma_run_length(limit, weight=0.05, shift=shift) == published(5.4, 16.0, 38.0)
    # The table's charts have been running when the step comes, and a running CUSUM is not empty: a walk with the drift
    # −k is on average Σ E[max(N(−kn, n), 0)]/n above its lowest point (Spitzer 1956), and so much nearer to the limit.
    k, n = 0.25, np.arange(1, 2000)
    root = np.sqrt(n)
    ahead = np.sum((root * stats.norm.pdf(k * root) - k * n * stats.norm.sf(k * root)) / n)
    running = cusum_run_length(12.9, reference=k, shift=shift) - ahead / (shift - k)
    assert running == published(5.7, 16.0, 36.0)


@pytest.mark.parametrize(("shift", "published"), [(0.0, 370.4), (1.0, 43.9), (2.0, 6.30), (3.0, 2.00)])
def test_three_sigma_chart_meets_the_table(shift, published):
    assert shewhart_run_length(3.0, shift=shift, two_sided=True) == pytest.approx(published, rel=2e-3)


def test_ewma_with_weight_one_is_the_shewhart_chart():
    assert ewma_run_length(3.0, weight=1.0) == pytest.approx(shewhart_run_length(3.0, two_sided=True))


def test_cusum_with_a_reference_of_the_size_of_its_limit_tends_to_the_shewhart_chart():
    # with h → 0 the sum signals when a single residual exceeds k
    assert cusum_run_length(1e-6, reference=3.0) == pytest.approx(shewhart_run_length(3.0), rel=1e-4)


@pytest.mark.parametrize("shift", [0.0, 0.7])
@pytest.mark.parametrize("scale", [1.0, 1.3])
def test_run_lengths_are_those_of_the_charts_themselves(shift, scale):
    rng = np.random.default_rng(7)
    n_runs, h, c, largest = 1500, 3.0, 0.6, 1.5
    lengths = np.zeros((3, n_runs))
    for run in range(n_runs):
        s, v, confirmed = 0.0, 0.0, 0
        signalled = [False] * 3
        n = 0
        while not all(signalled):
            n += 1
            z = shift + scale * rng.standard_normal()
            s = cusum_step(s, z, 0.25, largest)
            v = ewma_step(v, winsorise(z, 2.0), 0.2)
            confirmed = confirmed + 1 if z > 1.5 else 0
            for i, beyond in enumerate((s > h, abs(v) > c, confirmed >= 2)):
                if beyond and not signalled[i]:
                    signalled[i], lengths[i, run] = True, n
    expected = [
        cusum_run_length(h, reference=0.25, shift=shift, scale=scale, largest_increment=largest),
        ewma_run_length(c, weight=0.2, shift=shift, scale=scale, largest_residual=2.0),
        shewhart_run_length(1.5, shift=shift, scale=scale, consecutive=2),
    ]
    standard_error = lengths.std(axis=1) / math.sqrt(n_runs)
    assert np.all(np.abs(lengths.mean(axis=1) - expected) < 4.0 * standard_error + 0.01 * np.array(expected))


def test_distributions_come_as_arrays():
    shift, scale = np.array([[0.0], [1.0]]), np.array([0.8, 1.0, 1.2])
    together = cusum_run_length(4.0, reference=0.5, shift=shift, scale=scale)
    assert together.shape == (2, 3)
    assert together[1, 2] == pytest.approx(float(cusum_run_length(4.0, reference=0.5, shift=1.0, scale=1.2)))
    assert np.all(np.diff(together, axis=1) < 0.0)  # more scatter, shorter runs
    assert np.all(together[1] < together[0])


def test_a_chart_that_never_signals_runs_for_ever_and_does_not_fail():
    assert cusum_run_length(50.0, reference=2.0) == pytest.approx(1e12, rel=1e-3)
    assert shewhart_run_length(40.0) == pytest.approx(1e12)


def test_a_limit_of_zero_is_refused():
    with pytest.raises(OutsideValidityError, match="limit must be positive; got 0"):
        ewma_run_length(0.0, weight=0.2)
