"""The detector: its false alarms, its delays, and the laws of its states."""

import math
from dataclasses import FrozenInstanceError, replace
from datetime import UTC, datetime, timedelta
from functools import cache

import numpy as np
import pytest
from pydantic import TypeAdapter
from scipy import stats

from monitor_core.errors import OutsideValidityError
from monitor_core.trend import (
    Chart,
    DetectorSettings,
    DetectorState,
    LossDirection,
    Observation,
    TrendStatus,
    design_detector,
    reset,
    state_at,
    step,
)
from monitor_core.trend.design import baseline_errors, expected_false_alarms
from monitor_core.trend.run_length import cusum_run_length

START = datetime(2025, 1, 1, tzinfo=UTC)
DAY = timedelta(days=1)
#: Their variance over mean is known to 6 to 9 %.
N_AXES = 500


@cache
def design(**settings):
    return design_detector(DetectorSettings(**settings))


def run(values, the_design=None, state=None, **uncertainties):
    """States after each of the values, a day apart, from an empty state or from a given one."""
    the_design = the_design or design()
    state = state or DetectorState()
    history = []
    for value in values:
        at = START if state.last_at is None else state.last_at + DAY
        state = step(state, Observation(at, float(value), **uncertainties), the_design)
        history.append(state)
    return history


def healthy(rng, n, scatter=10.0):
    return 300.0 + scatter * rng.standard_normal(n)


@pytest.fixture
def watching():
    """Learn a baseline of 300 ± 10 N."""
    exact = 300.0 + 10.0 * math.sqrt(19.0 / 20.0) * np.array([1.0, 1.0, -1.0, -1.0] * 5)
    return run(exact)[-1]


# --- false alarms ----------------------------------------------------------------------------------------------------


def false_alarms(rng, the_design, *, n_axes, clear=True):
    """Count alarms of healthy axes in 365 measurements on learned baselines; each axis draws its own."""
    counts = np.zeros(n_axes, dtype=int)
    for axis in range(n_axes):
        state, alarmed, n_watched, i = DetectorState(), False, 0, 0
        while n_watched < 365:
            n_watched += state.baseline is not None
            state = step(state, Observation(START + i * DAY, rng.normal(300.0, 10.0)), the_design)
            onset, alarmed = state.alarm is not None and not alarmed, state.alarm is not None
            counts[axis] += onset
            if onset and clear:
                state, alarmed = reset(state), False
            i += 1
    return counts


@cache
def counts_of_axis_years(rate):
    return false_alarms(np.random.default_rng(100), design(false_alarms_per_year=rate), n_axes=N_AXES)


@pytest.mark.slow
def test_false_alarms_in_100_axis_years_agree_with_the_stated_rate():
    counts = counts_of_axis_years(1.0)[:100]
    lower, upper = stats.poisson.interval(0.95, 100.0)
    assert lower <= counts.sum() <= upper


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "dispersion"), [(1.0, 1.4), (4.0, 2.0)])
def test_mean_number_of_false_alarms_over_500_axis_years(rate, dispersion):
    counts = counts_of_axis_years(rate)
    # variance over mean: 1 is Poisson, the rest comes from misjudged baselines
    assert counts.var() / counts.mean() == pytest.approx(dispersion, rel=0.2)
    assert counts.mean() == pytest.approx(rate, abs=3.0 * math.sqrt(dispersion * rate / N_AXES))


def false_alarms_at_once(rng, the_design, *, n_axes):
    """Count as `false_alarms` does, all axes together, from the equations of the charts instead of the detector."""
    m, h = the_design.settings.baseline_size, the_design.cusum_limit

    def learn(n):
        readings = rng.standard_normal((n, m))
        return readings.mean(axis=1), readings.std(axis=1, ddof=1) * math.sqrt(1.0 + 1.0 / m)

    mean, scatter = learn(n_axes)
    cusum, beyond_before, counts = np.zeros(n_axes), np.zeros(n_axes, dtype=bool), np.zeros(n_axes)
    for _ in range(round(the_design.settings.measurements_per_year)):
        z = (mean - rng.standard_normal(n_axes)) / scatter
        cusum = np.maximum(0.0, cusum + np.minimum(z - the_design.cusum_reference, 0.5 * h))
        beyond = z > the_design.shewhart_limit
        alarmed = (cusum > h) | (beyond & beyond_before)
        counts += alarmed
        mean[alarmed], scatter[alarmed] = learn(alarmed.sum())
        cusum[alarmed], beyond_before = 0.0, beyond & ~alarmed
    return counts


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"false_alarms_per_year": 4.0},
        {"false_alarms_per_year": 0.2},
        {"baseline_size": 5},
        {"baseline_size": 50},
        {"measurements_per_year": 52.0},
    ],
)
def test_every_setting_gives_its_own_rate(settings):
    the_design = design(**settings)
    counts = false_alarms_at_once(np.random.default_rng(77), the_design, n_axes=8000)
    # three standard errors, and 3 % for a hazard that is not quite constant in the first measurements after learning
    rate = the_design.settings.false_alarms_per_year
    assert counts.mean() == pytest.approx(rate, abs=3.0 * counts.std() / math.sqrt(8000) + 0.03 * rate)


@pytest.mark.slow
def test_false_alarms_left_standing_are_not_many_more():
    counts = false_alarms(np.random.default_rng(7), design(), n_axes=300, clear=False)
    # 1.2 times the stated rate; three standard errors at a dispersion of 1.7
    assert counts.mean() == pytest.approx(1.2, abs=3.0 * math.sqrt(1.2 * 1.7 / 300))


@pytest.mark.parametrize("size", [5, 20, 2000])
def test_baseline_errors_have_the_moments_of_sampling_theory(size):
    errors = baseline_errors(size)
    widened = 1.0 + 1.0 / size
    assert errors.weight.sum() == pytest.approx(1.0)
    assert errors.weight @ (errors.shift / errors.scale) ** 2 == pytest.approx(1.0 / size)  # variance of a mean
    assert errors.weight @ (1.0 / errors.scale**2) == pytest.approx(widened)  # E[s²] = σ²
    # E[1/s²] is the variance of Student's t; heavy-tailed at m = 5, where 15 nodes give it to 1 %
    assert errors.weight @ errors.scale**2 * widened == pytest.approx((size - 1) / (size - 3), rel=0.01)


def test_baselines_that_alarm_are_replaced_until_they_do_not():
    # one in five alarms at once, the others never: 1/4 = 1/5 + 1/25 + … alarms, and no more however long one watches
    expected = expected_false_alarms(np.array([1e12, 1.0]), np.array([0.8, 0.2]), n_measurements=1000)
    assert expected == pytest.approx(0.25)
    assert expected_false_alarms(np.array([50.0]), np.ones(1), n_measurements=365) == pytest.approx(365 / 50)


@pytest.mark.slow
def test_rarer_false_alarms_cost_wider_limits():
    limits = [design(false_alarms_per_year=r).cusum_limit for r in (4.0, 1.0)]
    assert limits == sorted(limits)
    assert design(measurements_per_year=8766.0).cusum_limit > design().cusum_limit
    rare = design(false_alarms_per_year=0.1)
    assert rare.cusum_reference > design().cusum_reference


# --- delays ----------------------------------------------------------------------------------------------------------


LONGEST_DELAY = 500


def delay_after_learning(rng, loss, scatter):
    """Return how many measurements after a loss the alarm comes, or one more than the longest delay."""
    state = run(healthy(rng, 20, scatter))[-1]
    assert state.status is TrendStatus.NORMAL
    for delay in range(1, LONGEST_DELAY + 1):
        state = run(healthy(rng, 1, scatter) - loss, state=state)[-1]
        if state.status is TrendStatus.ALARM:
            return delay
    return LONGEST_DELAY + 1


@pytest.mark.parametrize(
    ("loss", "scatter"),
    # 35 N is the paper's scatter of a single reading
    [(20.0, 5.0), (50.0, 5.0), (100.0, 10.0), (20.0, 10.0), (50.0, 35.0), (100.0, 35.0)],
)
def test_delay_of_a_sudden_loss_is_that_of_the_chain(loss, scatter):
    """Charts at rest on learned baselines: the mean over baselines of the run lengths that the tables have judged."""
    rng = np.random.default_rng(50)
    delays = np.array([delay_after_learning(rng, loss, scatter) for _ in range(300)])
    assert np.all(delays <= LONGEST_DELAY)  # none is dropped, none cut short
    errors = baseline_errors(design().settings.baseline_size)
    chain = errors.weight @ cusum_run_length(
        design().cusum_limit,
        reference=design().cusum_reference,
        shift=errors.shift + loss / scatter * errors.scale,
        scale=errors.scale,
        largest_increment=design().largest_increment,
        confirmed_limit=design().shewhart_limit,
    )
    # A loss of ten standard deviations is always confirmed by the second measurement: there the error is rounding.
    error = 3.0 * delays.std(ddof=1) / math.sqrt(delays.size)
    assert delays.mean() == pytest.approx(float(chain), abs=max(error, 1e-6))


def test_wear_of_1_newton_a_day_is_alarmed_after_11_newtons():
    # 24 windows a day of 35 N scatter each, as in the comparison of rules: 7.1 N for their mean
    rng = np.random.default_rng(51)
    lost, n_dropped = [], 0
    for _ in range(60):
        values = healthy(rng, 25 + 60, 35.0 / math.sqrt(24.0))
        values[25:] -= np.arange(1.0, 61.0)
        status = [s.status for s in run(values)]
        if TrendStatus.ALARM in status[:25]:
            n_dropped += 1
        else:
            lost.append(status.index(TrendStatus.ALARM) - 24)
    assert n_dropped <= 3  # false alarms in 5 measurements: 60 · 5/365 are 0.8
    assert np.mean(lost) == pytest.approx(11.0, abs=2.0)  # standard error 0.5


# --- laws of the states ----------------------------------------------------------------------------------------------


def test_nothing_is_unknown_then_learning_then_normal():
    assert DetectorState().status is TrendStatus.UNKNOWN
    history = run(healthy(np.random.default_rng(1), 21))
    assert [s.status for s in history[:19]] == [TrendStatus.LEARNING] * 19
    assert history[18].since == START
    assert history[19].status is TrendStatus.NORMAL
    assert history[19].baseline.size == 20


def test_a_zero_spread_stays_in_learning_until_the_scatter_is_known():
    history = run([300.0] * 30)
    assert {s.status for s in history} == {TrendStatus.LEARNING}
    after = run([305.0, 300.0], state=history[-1])
    assert after[-1].baseline.size == 31


def test_no_single_measurement_alarms_on_a_chart_at_rest(watching):
    outlier = run([-1e6, 300.0, 300.0, 300.0, 300.0], state=watching)
    assert TrendStatus.ALARM not in [s.status for s in outlier]
    assert outlier[0].cusum == pytest.approx(design().largest_increment)
    assert run([-1e6, -1e6], state=watching)[-1].alarm.chart is Chart.SHEWHART


def test_the_evidence_tells_chart_onset_and_loss(watching):
    alarm = next(s.alarm for s in run([300.0] * 3 + [288.0] * 20, state=watching) if s.alarm)
    assert alarm.chart is Chart.CUSUM
    assert alarm.value > alarm.limit == design().cusum_limit
    assert alarm.onset == START + 23 * DAY
    assert alarm.change.value == pytest.approx(-12.0)
    n = (alarm.raised_at - alarm.onset) / DAY + 1
    assert alarm.change.standard_uncertainty == pytest.approx(10.0 * math.sqrt(1.0 / n + 1.0 / 20.0))


def test_the_baseline_is_never_learned_again_by_itself(watching):
    wear = run(300.0 - 0.1 * np.arange(1500), state=watching)
    assert all(s.baseline == watching.baseline for s in wear)
    assert wear[-1].status is TrendStatus.ALARM


def test_only_a_person_resets_and_old_measurements_do_not_come_again(watching):
    alarmed = run([200.0] * 5, state=watching)[-1]
    cleared = reset(alarmed)
    assert cleared.baseline is None
    assert cleared.status is TrendStatus.UNKNOWN
    with pytest.raises(OutsideValidityError, match="time order"):
        step(cleared, Observation(alarmed.last_at, 200.0), design())
    assert run([200.0], state=cleared)[0].status is TrendStatus.LEARNING


def test_an_alarm_ends_some_time_after_the_cause_is_repaired_and_not_before(watching):
    alarmed = run([200.0] * 200, state=watching)[-1]
    repaired = run([300.0] * 60, state=alarmed)
    status = [s.status for s in repaired]
    # from twice the limit to half of it, by k a measurement, and three more
    expected = math.ceil(1.5 * design().cusum_limit / design().cusum_reference) + 2
    assert status.index(TrendStatus.NORMAL) == pytest.approx(expected, abs=1)
    assert TrendStatus.ALARM not in status[expected + 1 :]


def test_a_chart_at_its_limit_does_not_chatter(watching):
    rng = np.random.default_rng(9)
    history = run(300.0 - 4.0 + 10.0 * rng.standard_normal(400), state=watching)
    # a persistent loss of 0.4 standard deviations: its CUSUM wanders around the limit
    alarmed = np.array([s.status is TrendStatus.ALARM for s in history])
    bare = np.array([s.cusum > design().cusum_limit for s in history])
    assert np.abs(np.diff(alarmed.astype(int))).sum() < 0.5 * np.abs(np.diff(bare.astype(int))).sum()


def test_a_rise_alerts_and_never_alarms(watching):
    history = run([340.0] * 50, state=watching)
    assert {s.status for s in history[5:]} == {TrendStatus.ALERT}
    assert history[-1].alert.change.value == pytest.approx(40.0)


def test_a_rising_feature_is_a_falling_preload():
    values = healthy(np.random.default_rng(3), 60)
    values[40:] -= 40.0
    falling = run(values)
    rising = run(-values, design(loss=LossDirection.RISE))
    assert [s.status for s in rising] == [s.status for s in falling]
    assert rising[-1].alarm.change.value == pytest.approx(-falling[-1].alarm.change.value)


@pytest.mark.parametrize(("factor", "zero"), [(1e-3, 0.0), (1e-9, 4e-6), (250.0, -1e4)])
def test_the_unit_does_not_matter(factor, zero):
    values = healthy(np.random.default_rng(4), 60)
    values[40:] -= 25.0
    unscaled = run(values, standard_uncertainty=3.0)
    other = run(zero + factor * values, standard_uncertainty=3.0 * factor)
    assert [s.status for s in other] == [s.status for s in unscaled]
    assert other[-1].cusum == pytest.approx(unscaled[-1].cusum, rel=1e-6)


def test_what_the_payload_correction_could_explain_never_alarms(watching):
    doubtful = run([270.0] * 500, state=watching, systematic_uncertainty=16.0)  # 30 N against 1.96 · 16 N
    assert {s.status for s in doubtful} == {TrendStatus.NORMAL}
    assert run([270.0] * 10, state=watching)[-1].status is TrendStatus.ALARM


def test_silence_makes_unknown_but_ends_no_alarm(watching):
    week = timedelta(days=7)
    assert state_at(DetectorState(), START, week) is TrendStatus.UNKNOWN
    assert state_at(watching, watching.last_at + week, week) is TrendStatus.NORMAL
    assert state_at(watching, watching.last_at + 8 * DAY, week) is TrendStatus.UNKNOWN
    alarmed = run([200.0] * 5, state=watching)[-1]
    assert state_at(alarmed, alarmed.last_at + 8 * DAY, week) is TrendStatus.ALARM


@pytest.mark.parametrize("n", [7, 30, 60])
def test_a_state_survives_storage_as_json(n):
    values = healthy(np.random.default_rng(5), 60)
    values[25:] -= 50.0
    state = run(values[:n])[-1]
    adapter = TypeAdapter(DetectorState)
    stored = adapter.validate_json(adapter.dump_json(state))
    assert stored == state
    following = Observation(state.last_at + DAY, 280.0)
    assert step(stored, following, design()) == step(state, following, design())


def test_a_state_is_never_changed(watching):
    before = replace(watching)
    run([200.0] * 5, state=watching)
    assert watching == before
    with pytest.raises(FrozenInstanceError):
        watching.cusum = 0.0


@pytest.mark.parametrize(
    "wrong", [{"false_alarms_per_year": 0.0}, {"measurements_per_year": math.nan}, {"baseline_size": 2}]
)
def test_settings_that_cannot_be_met_are_refused(wrong):
    with pytest.raises(OutsideValidityError, match="must be"):
        DetectorSettings(**wrong)


def test_monthly_inspections_can_be_designed_for_and_an_alarm_at_each_cannot():
    assert design(measurements_per_year=12.0, false_alarms_per_year=0.2).cusum_limit > 1.0
    with pytest.raises(OutsideValidityError, match="ask for fewer"):
        design(measurements_per_year=12.0, false_alarms_per_year=12.0)
