"""The baseline: what it learns, and how it judges."""

import math
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.trend import Observation, learn_baseline, prediction_interval_of_next

START = datetime(2025, 1, 1, tzinfo=UTC)


def observations(values, standard_uncertainty=0.0):
    return [Observation(START + timedelta(days=i), float(v), standard_uncertainty) for i, v in enumerate(values)]


def later(value, standard_uncertainty=0.0, systematic_uncertainty=0.0):
    return Observation(START + timedelta(days=1000), value, standard_uncertainty, systematic_uncertainty)


def test_residual_of_a_new_measurement_has_unit_variance_over_all_baselines():
    # t of m − 1 degrees of freedom: variance (m − 1)/(m − 3)
    rng = np.random.default_rng(3)
    z = [learn_baseline(observations(rng.normal(300.0, 10.0, 20))).standardise(later(rng.normal(300.0, 10.0)))
         for _ in range(4000)]  # fmt: skip
    # three times the sampling error of a variance from 4000 values, 2.5 % with these tails
    assert np.var(z) == pytest.approx(19.0 / 17.0, rel=0.08)


def test_the_mean_of_the_baseline_scatters_too():
    baseline = learn_baseline(observations(300.0 + 10.0 * math.sqrt(19.0 / 20.0) * np.array([1.0, -1.0] * 10)))
    assert baseline.scatter == pytest.approx(10.0)
    assert baseline.degrees_of_freedom == 19
    assert baseline.standardise(later(310.0)) == pytest.approx(1.0 / math.sqrt(1.0 + 1.0 / 20.0))


def test_a_zero_spread_is_not_learned_unless_an_uncertainty_is_stated():
    assert learn_baseline(observations([0.4911] * 5)) is None
    stated = learn_baseline(observations([0.4911] * 5, standard_uncertainty=0.01))
    assert stated.scatter == pytest.approx(0.01)
    assert stated.autocorrelation == 0.0
    assert learn_baseline(observations([300.0])) is None


def test_stated_uncertainty_is_a_floor_and_nothing_more():
    values = [290.0, 310.0] * 10
    assert learn_baseline(observations(values, 1.0)).scatter == pytest.approx(np.std(values, ddof=1))
    assert learn_baseline(observations(values, 50.0)).scatter == pytest.approx(50.0)


def test_a_poor_measurement_is_believed_to_be_poor():
    baseline = learn_baseline(observations([290.0, 310.0] * 10))
    assert abs(baseline.standardise(later(200.0, standard_uncertainty=100.0))) < 1.0
    assert baseline.standardise(later(200.0)) < -9.0


def test_a_change_that_the_corrections_could_explain_is_no_evidence():
    baseline = learn_baseline(observations([290.0, 310.0] * 10))
    assert baseline.standardise(later(270.0, systematic_uncertainty=16.0)) == 0.0
    without, with_doubt = baseline.standardise(later(200.0)), baseline.standardise(later(200.0, 0.0, 10.0))
    assert with_doubt / without == pytest.approx((100.0 - 19.6) / 100.0)
    assert baseline.standardise(later(400.0, 0.0, 10.0)) == pytest.approx(-with_doubt)


def test_autocorrelation_is_found_and_widens_the_scatter_as_the_long_run_does():
    rng = np.random.default_rng(4)
    x = np.zeros(2000)
    for i in range(1, x.size):
        x[i] = 0.5 * x[i - 1] + rng.standard_normal()
    baseline = learn_baseline(observations(x))
    assert baseline.autocorrelation == pytest.approx(0.5, abs=0.06)  # three standard errors
    # standard deviation of means of 50 against that of independent values: √((1 + ρ)/(1 − ρ)) for a long mean
    of_means = x.reshape(-1, 50).mean(axis=1).std(ddof=1) * math.sqrt(50.0) / x.std(ddof=1)
    assert baseline.dependence == pytest.approx(of_means, rel=0.3)  # 40 means: 11 % standard error


def test_independent_baselines_are_seldom_taken_as_dependent():
    rng = np.random.default_rng(5)
    widened = sum(learn_baseline(observations(rng.standard_normal(20))).dependence > 1.0 for _ in range(2000))
    assert widened / 2000 < 0.015  # a one-sided test of 1 %; the normal approximation is rough at m = 20


@pytest.mark.parametrize(
    "bad", [{"value": math.nan}, {"standard_uncertainty": -1.0}, {"systematic_uncertainty": math.inf}]
)
def test_a_broken_observation_is_refused(bad):
    with pytest.raises(OutsideValidityError, match="must be finite"):
        Observation(**({"at": START, "value": 300.0} | bad))


def test_a_time_without_zone_is_refused():
    with pytest.raises(OutsideValidityError, match="time zone"):
        Observation(datetime(2025, 1, 1), 300.0)  # noqa: DTZ001 (that is the point)


def test_prediction_interval_is_that_of_the_readings_themselves():
    values = np.random.default_rng(8).normal(4.0, 0.3, 20)
    interval, expected = learn_baseline(observations(values)).prediction_interval(), prediction_interval_of_next(values)
    assert (interval.lower, interval.upper) == pytest.approx((expected.lower, expected.upper), rel=1e-12)
    assert interval.kind is expected.kind
