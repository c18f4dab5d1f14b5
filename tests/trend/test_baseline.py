"""What is learnt of a healthy axis: sessions, filter, baseline, what sisters lend, and the line of the trend."""

import math
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from scipy import stats

from monitor_core.errors import OutsideValidityError
from monitor_core.trend import Observation, Prior, learn_baseline
from monitor_core.trend.baseline import CONTRADICTED_BY_CHANCE, baseline_of, contradicts
from monitor_core.trend.belief import STRUCTURES, begin, change_in_a_day, learn, pass_over, predict
from monitor_core.trend.line import trend_line
from monitor_core.trend.observation import first_of, sessions_of
from monitor_core.trend.sisters import prior_from

START = datetime(2025, 1, 1, tzinfo=UTC)
DAY = timedelta(days=1)


def only(structure, **changes):
    """State one structure of dependence as known."""
    return Prior(weights=tuple(1.0 if i == structure else 1e-200 for i in range(len(STRUCTURES))), **changes)


def observations(values, temperatures=None, every=DAY, **uncertainties):
    return [
        Observation(
            START + i * every,
            float(value),
            temperature=None if temperatures is None else float(temperatures[i]),
            **uncertainties,
        )
        for i, value in enumerate(values)
    ]


def learnt(values, prior=None, **kwargs):
    return learn_baseline(sessions_of(observations(values, **kwargs)), prior)


def residual(belief, value, days=1, **kwargs):
    session = first_of(Observation(belief.last_at + days * DAY, value, **kwargs))
    return predict(belief, session).residual()


def expected(belief, session):
    return session.value - predict(belief, session).difference


# --- sessions --------------------------------------------------------------------------------------------------------


def test_measurements_of_a_day_are_one_session():
    values = [300.0, 304.0, 290.0, 310.0, 306.0]
    at = [START, START + timedelta(hours=3), START + DAY, START + timedelta(days=1, hours=19.9), START + 2 * DAY]
    first, second, third = sessions_of([Observation(t, v, 2.0) for t, v in zip(at, values, strict=True)])
    assert (first.value, second.value, third.value) == (302.0, 300.0, 306.0)
    assert (first.squares, second.squares, third.squares) == (8.0, 200.0, 0.0)
    assert first.own_variance == pytest.approx(2.0)  # 2² / 2
    assert (first.count, first.started_at, first.last_at) == (2, at[0], at[1])


@pytest.mark.parametrize(
    "bad",
    [{"value": math.nan}, {"standard_uncertainty": -1.0}, {"systematic_uncertainty": math.inf},
     {"temperature": math.inf}, {"friction_torque": math.nan}],
)  # fmt: skip
def test_a_broken_observation_is_refused(bad):
    with pytest.raises(OutsideValidityError, match="must be finite"):
        Observation(**({"at": START, "value": 300.0} | bad))


def test_a_time_without_zone_is_refused():
    with pytest.raises(OutsideValidityError, match="time zone"):
        Observation(datetime(2025, 1, 1), 300.0)  # noqa: DTZ001 (that is the point)


# --- the filter ------------------------------------------------------------------------------------------------------


def test_the_filter_is_the_multivariate_t_of_all_sessions_together(subtests):
    """Closed form without any filter: conditional of Student's multivariate t on irregular days."""
    for structure in range(len(STRUCTURES)):
        with subtests.test(structure=structure):
            rng = np.random.default_rng(structure)
            phi, share = STRUCTURES[structure].correlation, STRUCTURES[structure].share
            days = np.sort(rng.choice(90, 25, replace=False)).astype(float)
            days -= days[0]
            temperatures = 20.0 + 4.0 * rng.standard_normal(25)
            values = 300.0 + 0.9 * (temperatures - 20.0) + 5.0 * rng.standard_normal(25)
            sessions = [
                first_of(Observation(START + d * DAY, v, temperature=t))
                for d, v, t in zip(days, values, temperatures, strict=True)
            ]
            prior = only(structure)
            belief = begin(sessions[0], prior, 30.0)
            for session in sessions[:-1]:
                belief = learn(belief, predict(belief, session), session)

            angle = 2.0 * math.pi * days / 365.25
            warmer = np.append(0.0, np.diff(temperatures) / np.diff(days)) / 10.0  # in a day
            x = np.column_stack([
                np.ones(25), 1.0 - np.cos(angle), np.sin(angle), warmer, (temperatures - temperatures[0]) / 10.0
            ])  # fmt: skip
            variances = np.array([1e4, *(d**2 for d in prior.deviations[:4])])
            apart = np.abs(days[:, None] - days)
            # with no correlation, 0⁰ = 1 on the diagonal
            dependence = share * phi**apart + (1.0 - share) * np.eye(25)
            shape = 30.0 * (x @ np.diag(variances) @ x.T + dependence)
            error = values - values[0]
            old, cross = shape[:-1, :-1], shape[-1, :-1]
            weights = np.linalg.solve(old, cross)
            nu = prior.degrees_of_freedom
            squares = error[:-1] @ np.linalg.solve(old, error[:-1])
            scale = math.sqrt((nu + squares) / (nu + 24) * (shape[-1, -1] - cross @ weights))
            expected = stats.norm.ppf(stats.t.cdf((error[-1] - weights @ error[:-1]) / scale, nu + 24))
            prediction = predict(belief, sessions[-1])
            assert values[-1] - prediction.difference == pytest.approx(values[0] + weights @ error[:-1], rel=1e-6)
            # the autoregression begins in its stationary state in both
            assert prediction.residual() == pytest.approx(expected, abs=1e-5)


@pytest.mark.release
def test_residual_of_a_new_session_has_unit_variance_over_all_baselines():
    rng = np.random.default_rng(3)
    z = [residual(learnt(rng.normal(300.0, 10.0, 20)), rng.normal(300.0, 10.0)) for _ in range(600)]
    # three times the sampling error of a variance from 600 values; that the axis may depend on itself costs a little
    assert 0.8 < np.var(z) < 1.17


def test_a_poor_session_is_believed_to_be_poor():
    belief = learnt([290.0, 310.0] * 10)
    assert abs(residual(belief, 200.0, standard_uncertainty=100.0)) < 1.0
    assert residual(belief, 200.0) < -4.0


def test_what_goes_beyond_the_temperatures_that_were_seen_is_predicted_more_widely():
    rng = np.random.default_rng(9)
    belief = learnt(rng.normal(300.0, 10.0, 40), temperatures=rng.uniform(18.0, 22.0, 40))
    near, far = (
        predict(belief, first_of(Observation(belief.last_at + DAY, 300.0, temperature=t))).scale.mean()
        for t in (20.0, 35.0)
    )
    assert far > 1.5 * near


def test_a_lesson_is_limited_so_that_an_outlier_teaches_little():
    values = list(np.random.default_rng(1).normal(300.0, 10.0, 30))
    clean, outlier = learnt(values), learnt([*values[:20], 1300.0, *values[20:]])
    assert baseline_of(outlier).mean == pytest.approx(baseline_of(clean).mean, abs=4.0)
    assert baseline_of(outlier).scatter < 1.6 * baseline_of(clean).scatter


def test_sessions_that_are_passed_over_teach_no_level_and_no_scatter():
    belief = before = learnt(np.random.default_rng(2).normal(300.0, 10.0, 30))
    for i in range(1, 200):
        session = first_of(Observation(before.last_at + i * DAY, 200.0))
        belief = pass_over(belief, predict(belief, session), session)
    assert belief.n_sessions == before.n_sessions
    assert baseline_of(belief).scatter == pytest.approx(baseline_of(before).scatter)
    assert baseline_of(belief).mean == pytest.approx(baseline_of(before).mean, abs=15.0)  # by its season only


# --- the baseline ----------------------------------------------------------------------------------------------------


def test_a_baseline_knows_mean_and_scatter_and_what_it_has_not_seen():
    exact = 300.0 + 10.0 * np.array([1.0, 1.0, -1.0, -1.0] * 10)
    baseline = baseline_of(learnt(exact, temperatures=[19.0, 23.0] * 20))
    assert baseline.mean == pytest.approx(300.0, abs=baseline.standard_uncertainty)
    assert baseline.scatter == pytest.approx(10.0, rel=0.1)
    assert baseline.size == 40
    assert baseline.not_seen == (
        "other seasons than those 39 days",
        "temperatures below 19.0 or above 23.0 °C",
    )
    assert "any temperature: none was stated" in baseline_of(learnt(exact)).not_seen
    year = baseline_of(learnt(300.0 + 10.0 * np.random.default_rng(0).standard_normal(340)))
    assert not any("season" in what for what in year.not_seen)


def test_a_zero_spread_is_not_learned_unless_an_uncertainty_is_stated():
    assert learnt([0.4911] * 5) is None
    assert learnt([300.0]) is None
    # five sessions of no scatter speak for less than is stated of each
    stated = baseline_of(learnt([0.4911] * 5, standard_uncertainty=0.01))
    assert 0.001 < stated.scatter <= 0.01


@pytest.mark.parametrize(("correlation", "size"), [(0.0, 300), (0.3, 300), (0.6, 300)])
def test_dependence_is_found_and_widens_the_mean_as_the_long_run_does(correlation, size):
    rng = np.random.default_rng(4)
    found = []
    for _ in range(8):
        x = rng.standard_normal(size)
        for i in range(1, size):
            x[i] = correlation * x[i - 1] + math.sqrt(1.0 - correlation**2) * x[i]
        found.append(baseline_of(learnt(x)))
    assert np.mean([b.autocorrelation for b in found]) == pytest.approx(correlation, abs=0.12)
    # √((1 + φ)/(1 − φ)), and of a mean of 50 by the sum of its covariances
    assert np.mean([b.dependence for b in found]) == pytest.approx(
        math.sqrt((1.0 + correlation) / (1.0 - correlation)), rel=0.2
    )
    of_mean = math.sqrt((correlation ** np.abs(np.subtract.outer(np.arange(50), np.arange(50)))).sum()) / 50.0
    assert np.mean([b.scatter_of_mean(50) for b in found]) == pytest.approx(of_mean, rel=0.2)


def test_prediction_interval_covers_the_next_session():
    rng, inside = np.random.default_rng(8), 0
    for _ in range(300):
        values = rng.normal(4.0, 0.3, 41)
        interval = baseline_of(learnt(values[:40])).prediction_interval()
        inside += interval.lower <= values[40] <= interval.upper
    low, high = stats.binom.ppf([0.002, 0.998], 300, 0.95)
    assert low <= inside <= high


# --- sisters ---------------------------------------------------------------------------------------------------------


def an_axis(rng, size, *, per_kelvin, correlation=0.6, scatter=10.0):
    """Draw a healthy axis that follows its temperature, day after day."""
    noise = rng.standard_normal(size)
    for i in range(1, size):
        noise[i] = correlation * noise[i - 1] + math.sqrt(1.0 - correlation**2) * noise[i]
    temperatures = 20.0 + 3.0 * rng.standard_normal(size)
    return 300.0 + scatter * noise + per_kelvin * (temperatures - 20.0), temperatures


def test_without_sisters_the_default_stands():
    assert prior_from([]) == Prior()


def test_sisters_lend_temperature_scatter_and_dependence_with_their_number():
    rng = np.random.default_rng(12)
    sisters = []
    for _ in range(5):
        values, temperatures = an_axis(rng, 300, per_kelvin=4.0)
        sisters.append(learnt(values, temperatures=temperatures))
    prior = prior_from(sisters)
    assert prior.n_sisters == 5
    assert math.sqrt(prior.variance) == pytest.approx(10.0, rel=0.2)
    assert prior.coefficients[3] == pytest.approx(40.0, rel=0.2)  # per 10 K
    assert prior.deviations[3] < Prior().deviations[3]
    independent = prior.weights[0]
    assert independent < 0.5 * Prior().weights[0]
    assert sum(prior.weights) == pytest.approx(1.0)


def test_a_young_axis_with_sisters_predicts_a_temperature_it_has_not_seen():
    rng = np.random.default_rng(13)
    sisters = [learnt(v, temperatures=t) for v, t in (an_axis(rng, 300, per_kelvin=4.0) for _ in range(4))]
    lent, alone = [], []
    for _ in range(12):
        values, temperatures = an_axis(rng, 20, per_kelvin=4.0)
        # a cool fortnight, then a hot day: 12 K above what it knows
        cool = values - 4.0 * (temperatures - 20.0)
        for prior, errors in ((prior_from(sisters), lent), (Prior(), alone)):
            young = learnt(cool, prior, temperatures=np.full(20, 20.0))
            hot = first_of(Observation(young.last_at + DAY, 348.0, temperature=32.0))
            errors.append(expected(young, hot) - 348.0)
    assert np.abs(lent).mean() < 0.4 * np.abs(alone).mean()


def test_a_structure_that_lags_behind_its_thermometer_is_learnt():
    """A structure that takes a day to follow the air: what remains is the white noise that was put on top."""
    rng = np.random.default_rng(15)
    air = 20.0 + 3.0 * rng.standard_normal(200)
    structure, state = np.empty(200), 20.0
    for day, temperature in enumerate(air):
        state += (temperature - state) * (1.0 - math.exp(-1.0))
        structure[day] = state
    values = 300.0 + 6.0 * (structure - air) + 5.0 * rng.standard_normal(200)  # corrected by the air that was measured
    own = learnt(values, temperatures=air)
    scatter = math.sqrt(own.bank.variance)
    alone = learnt(values)
    assert scatter == pytest.approx(5.0, rel=0.2)
    assert math.sqrt(alone.bank.variance) > 1.4 * scatter
    warmer = [
        expected(own, first_of(Observation(own.last_at + DAY, 300.0, temperature=float(air[-1] + kelvin))))
        for kelvin in (0.0, 5.0)
    ]
    assert warmer[1] - warmer[0] == pytest.approx(-6.0 * math.exp(-1.0) * 5.0, rel=0.35)


def test_the_air_between_two_sessions_goes_straight_on():
    assert change_in_a_day(20.0, 26.0, 3 * DAY) == pytest.approx(0.2)  # 2 K a day, in tens of kelvin
    assert change_in_a_day(20.0, 26.0, 0.9 * DAY) == pytest.approx(0.6)  # less than a day is no more
    assert change_in_a_day(None, 26.0, DAY) is change_in_a_day(20.0, None, DAY) is None


@pytest.mark.parametrize("teaches", [True, False])
def test_a_change_since_days_without_a_thermometer_is_not_known(teaches):
    """Nor is it that of one day: what it may be widens the prediction."""
    rng = np.random.default_rng(16)
    air = 20.0 + 3.0 * rng.standard_normal(60)
    own = learnt(300.0 - 2.0 * np.diff(air, prepend=air[0]) + rng.standard_normal(60), temperatures=air)
    known = predict(own, first_of(Observation(own.last_at + DAY, 300.0, temperature=20.0)))
    silent = first_of(Observation(own.last_at + DAY, 300.0))
    followed = (learn if teaches else pass_over)(own, predict(own, silent), silent)
    back = predict(followed, first_of(Observation(followed.last_at + DAY, 300.0, temperature=35.0)))
    assert back.design[3] == 0.0
    assert known.design[3] != 0.0
    # a change has a standard deviation of 4.2 K, so 8.5 of the values beside 1 of the scatter
    assert back.scale[0] > 4.0 * known.scale[0]


def test_a_sister_that_differs_is_not_forced_to_agree():
    rng = np.random.default_rng(14)
    sisters = [learnt(v, temperatures=t) for v, t in (an_axis(rng, 300, per_kelvin=4.0) for _ in range(4))]
    values, temperatures = an_axis(rng, 200, per_kelvin=-4.0, scatter=20.0)
    own = learnt(values, prior_from(sisters), temperatures=temperatures)
    slope = (
        expected(own, first_of(Observation(own.last_at + DAY, 300.0, temperature=25.0)))
        - expected(own, first_of(Observation(own.last_at + DAY, 300.0, temperature=15.0)))
    ) / 10.0
    assert slope == pytest.approx(-4.0, abs=1.0)
    assert baseline_of(own).scatter == pytest.approx(20.0, rel=0.2)


def test_sisters_that_disagree_lend_less():
    rng = np.random.default_rng(15)
    alike = [learnt(v, temperatures=t) for v, t in (an_axis(rng, 200, per_kelvin=4.0) for _ in range(4))]
    unlike = [learnt(v, temperatures=t) for v, t in (an_axis(rng, 200, per_kelvin=k) for k in (-6.0, 0.0, 5.0, 9.0))]
    assert prior_from(unlike).deviations[3] > 1.5 * prior_from(alike).deviations[3]


def test_what_sisters_lend_is_dropped_where_the_first_sessions_contradict_it_and_seldom_else():
    """Axes whose scatter is drawn from what was lent: the stated rate; then axes far from it."""
    rng, lent = np.random.default_rng(17), Prior(variance=1.0, degrees_of_freedom=20.0, n_sisters=4)
    spread = np.sqrt(20.0 / rng.chisquare(20.0, 100))

    def dropped(scatter):
        return sum(contradicts(sessions_of(observations(s * rng.standard_normal(20))), lent) for s in scatter)

    assert dropped(spread) <= stats.binom.ppf(0.999, 100, CONTRADICTED_BY_CHANCE)
    assert dropped([0.5] * 40) > 32  # F of 20 and 20 degrees of freedom beyond 4, less what dependence may explain
    assert dropped([2.5] * 40) > 32
    assert dropped([0.25] * 20) == 20
    steep = prior_from([learnt(v, temperatures=t) for v, t in (an_axis(rng, 300, per_kelvin=4.0) for _ in range(4))])
    values, temperatures = an_axis(rng, 20, per_kelvin=-6.0)
    assert contradicts(sessions_of(observations(values, temperatures=temperatures)), steep)  # not the scatter alone


# --- the line --------------------------------------------------------------------------------------------------------


def test_the_line_of_independent_sessions_without_season_is_least_squares():
    rng = np.random.default_rng(6)
    days = np.arange(60.0)
    values = 300.0 - 0.1 * days + rng.standard_normal(60)
    line = trend_line(sessions_of(observations(values)), only(0, deviations=(1e-5,) * 5))
    fit = stats.linregress(days / 365.25, values)
    assert line.slope.value == pytest.approx(fit.slope, rel=1e-6)
    assert line.slope.standard_uncertainty == pytest.approx(fit.stderr, rel=1e-3)
    assert line.at_end.value == pytest.approx(fit.intercept + fit.slope * 59.0 / 365.25, rel=1e-9)
    assert line.n_sessions == 60


@pytest.mark.release
@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8])
def test_the_interval_of_the_slope_covers_it_however_the_days_depend_on_each_other(correlation):
    rng, inside = np.random.default_rng(7), 0
    for _ in range(100):
        values, temperatures = an_axis(rng, 250, per_kelvin=2.0, correlation=correlation)
        line = trend_line(sessions_of(observations(values - 20.0 * np.arange(250) / 365.25, temperatures)))
        inside += abs(line.slope.value + 20.0) < 1.96 * line.slope.standard_uncertainty
    assert inside >= stats.binom.ppf(0.002, 100, 0.9)


def test_no_line_is_drawn_through_too_little():
    few = sessions_of(observations(np.arange(9.0)))
    soon = sessions_of(observations(np.arange(12.0), every=timedelta(hours=11)))
    assert trend_line(few) is None
    assert trend_line(soon) is None
    assert trend_line(sessions_of(observations([300.0] * 30))) is None


def test_what_is_lost_slowly_is_not_learnt_away_in_the_line():
    values = 300.0 - 36.5 * np.arange(300) / 365.25 + 3.0 * np.random.default_rng(10).standard_normal(300)
    line = trend_line(sessions_of(observations(values)))
    assert line.slope.value + 3.0 * line.slope.standard_uncertainty < 0.0
