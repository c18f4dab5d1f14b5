"""A preload that falls while its baseline is learnt: how often it is said, of whom, and what is not learnt from it."""

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from scipy import stats

from benchmarks.learning import N_SESSIONS, ROWS, said_at
from monitor_core.trend import (
    Chart,
    DetectorSettings,
    DetectorState,
    LossDirection,
    Observation,
    Prior,
    TrendStatus,
    design_detector,
    reset,
    step,
)
from monitor_core.trend.belief import STRUCTURES
from monitor_core.trend.learning import (
    EVIDENCE_LIMIT,
    FALSE_SHARE,
    LOSS_OF_A_SESSION,
    MOST,
    UNSTATED_SEASON,
    weigh_fall,
)
from monitor_core.trend.observation import Session, first_of
from tests.conftest import canary

START = datetime(2026, 3, 2, 6, tzinfo=UTC)
DAY = timedelta(days=1)
FALLS, RISES = (design_detector(DetectorSettings(loss=loss)) for loss in (LossDirection.FALL, LossDirection.RISE))


def sessions_of(values, temperatures=None) -> list[Session]:
    """One measurement a day."""
    told = [None] * len(values) if temperatures is None else temperatures
    return [
        first_of(Observation(START + day * DAY, float(value), temperature=temperature))
        for day, (value, temperature) in enumerate(zip(values, told, strict=True))
    ]


def run(values, design=FALLS, temperatures=None, state=None):
    """States after each of the values, a day apart."""
    told = [None] * len(values) if temperatures is None else temperatures
    state, history = state or DetectorState(), []
    for value, temperature in zip(values, told, strict=True):
        at = START if state.last_at is None else state.last_at + DAY
        state = step(state, Observation(at, float(value), temperature=temperature), design)
        history.append(state)
    return history


def falling(rng, count=N_SESSIONS, lost=13.0, scatter=2.0):
    """Return a hundred that falls evenly, by so much in twenty sessions."""
    return 100.0 - lost * np.arange(count) / (N_SESSIONS - 1) + scatter * rng.standard_normal(count)


# --- rates -----------------------------------------------------------------------------------------------------------

#: Kinds of axes and how many of each: healthy ones of every row of the benchmark before a release.
HEALTHY = [("medium, Student t3, no thermometer", 12), *((row, 150) for row in ROWS)]
#: Of those that fall, the machines; the other rows are of axes that scatter by 2 % and more.
FALLING = [("heavy, AR(1) 0.5, thermometer", 8), *((row, 60) for row in ROWS if "thermometer" in row)]


@pytest.mark.parametrize(("row", "n_axes"), canary(HEALTHY))
def test_no_more_healthy_axes_than_stated_are_said_to_fall_in_all_their_learning(row, n_axes):
    false = sum(math.isfinite(said_at(row, 0.0, 3, axis)) for axis in range(n_axes))
    # what is stated is an upper limit: as many as that by chance in one of a thousand draws
    assert false <= stats.binom.ppf(0.999, n_axes, FALSE_SHARE)


@pytest.mark.parametrize(("row", "n_axes"), canary(FALLING))
def test_nine_of_ten_that_lose_13_percent_are_said_to_fall_by_the_twentieth_session(row, n_axes):
    said = sum(said_at(row, 0.13, 4, axis) <= N_SESSIONS for axis in range(n_axes))
    assert said >= stats.binom.ppf(0.001, n_axes, 0.9)


# --- the law ---------------------------------------------------------------------------------------------------------


def test_evidence_is_the_ratio_of_the_marginal_likelihoods_that_quadrature_finds():
    """Over level, scale and loss on a grid, with the densities of SciPy."""
    days, values = np.array([0.0, 1.0, 2.0, 4.0, 5.0]), np.array([3.0, 2.2, 2.6, 1.1, 0.7])
    sessions = [first_of(Observation(START + day * DAY, float(v))) for day, v in zip(days, values, strict=True)]
    pace = days[-1] / (len(days) - 1)
    angle = 2.0 * np.pi * days / 365.25
    season = UNSTATED_SEASON * np.stack([1.0 - np.cos(angle), np.sin(angle)], axis=1)
    level, log_scale = np.linspace(-12.0, 16.0, 141), np.linspace(-3.0, 3.5, 66)
    loss = np.linspace(0.0, 6.0 * LOSS_OF_A_SESSION, 61)
    likelihood = np.zeros(len(loss))
    for structure in STRUCTURES:
        correlation = structure.correlation ** np.abs(days[:, None] - days[None, :])
        covariance = structure.share * correlation + (1.0 - structure.share) * np.eye(5) + season @ season.T
        normal = stats.multivariate_normal(cov=covariance)
        scale = np.exp(log_scale)[:, None, None]
        for i, size in enumerate(loss):
            left = (values - level[None, :, None]) / scale + size * days / pace
            density = normal.pdf(left) / scale[:, :, 0] ** 5
            likelihood[i] += structure.weight * np.trapezoid(np.trapezoid(density, level, axis=1), log_scale)
    weight = 2.0 * stats.norm.pdf(loss, scale=LOSS_OF_A_SESSION)
    expected = math.log(np.trapezoid(weight * likelihood, loss) / likelihood[0])
    fall = weigh_fall(sessions, Prior(), towards_loss=-1.0)
    assert fall.log_evidence == pytest.approx(expected, abs=0.02)


def test_unit_zero_and_direction_do_not_matter():
    values = falling(np.random.default_rng(1))
    fall = weigh_fall(sessions_of(values), Prior(), towards_loss=-1.0)
    other = weigh_fall(sessions_of(7.0 - 1e-6 * values), Prior(), towards_loss=1.0)
    assert other.log_evidence == pytest.approx(fall.log_evidence, abs=1e-6)
    assert other.change.value == pytest.approx(-1e-6 * fall.change.value)
    assert other.level == pytest.approx(7.0 - 1e-6 * fall.level)


@pytest.mark.parametrize("rho", [0.0, 0.5])
def test_interval_of_the_loss_covers_it(rho):
    rng, n_axes, covered, inside_t = np.random.default_rng(5), 300, 0, 0.975
    for _ in range(n_axes):
        noise = rng.standard_normal(N_SESSIONS)
        for day in range(1, N_SESSIONS):
            noise[day] = rho * noise[day - 1] + math.sqrt(1.0 - rho**2) * noise[day]
        values = 100.0 - 13.0 * np.arange(N_SESSIONS) / (N_SESSIONS - 1) + 2.0 * noise
        change = weigh_fall(sessions_of(values), Prior(), towards_loss=-1.0).change
        reach = stats.t.ppf(inside_t, change.degrees_of_freedom) * change.standard_uncertainty
        covered += abs(change.value + 13.0) <= reach
    # what a season may have done widens it: more than 95 % is no fault here
    assert covered >= stats.binom.ppf(0.001, n_axes, 0.95)


def test_a_fall_that_the_temperature_explains_is_none_and_the_state_says_that_it_may_hide_a_loss():
    rng = np.random.default_rng(7)
    temperatures = 20.0 + 6.0 * np.arange(N_SESSIONS) / (N_SESSIONS - 1) + 0.8 * rng.standard_normal(N_SESSIONS)
    values = 100.0 - 3.0 * (temperatures - 20.0) + 2.0 * rng.standard_normal(N_SESSIONS)
    untold = weigh_fall(sessions_of(values), Prior(), towards_loss=-1.0)
    told = weigh_fall(sessions_of(values, temperatures.tolist()), Prior(), towards_loss=-1.0)
    assert untold.log_evidence > EVIDENCE_LIMIT > 0.5 > told.log_evidence
    learnt = run(values, temperatures=temperatures.tolist())[-1]
    assert learnt.baseline is not None
    assert learnt.covered
    steady = run(values + 3.0 * (temperatures - 20.0), temperatures=temperatures.tolist())[-1]
    assert steady.baseline is not None
    assert not steady.covered


def test_a_session_that_says_itself_that_it_is_worth_little_says_little():
    values = 100.0 + np.random.default_rng(8).standard_normal(12)
    values[-1] -= 12.0
    sessions = sessions_of(values)
    doubtful = [*sessions[:-1], replace(sessions[-1], own_variance=100.0)]
    before, plain, weighed = (
        weigh_fall(each, Prior(), towards_loss=-1.0).change.value / (len(each) - 1)
        for each in (sessions[:-1], sessions, doubtful)
    )
    assert abs(weighed - before) < 0.3 * abs(plain - before)


def test_a_step_at_a_lubrication_that_was_stated_speaks_less_for_a_fall():
    values = 100.0 + np.random.default_rng(9).standard_normal(12) - 2.0 * (np.arange(12) >= 6)
    sessions = sessions_of(values)
    stated = [replace(session, lubricated=day == 6) for day, session in enumerate(sessions)]
    plain, weighed = (weigh_fall(each, Prior(), towards_loss=-1.0).log_evidence for each in (sessions, stated))
    assert weighed < plain - 0.5


# --- the axis --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("design", [FALLS, RISES])
def test_what_falls_is_said_and_no_baseline_is_learnt_from_it(design):
    sign = -1.0 if design is RISES else 1.0
    history = run(sign * falling(np.random.default_rng(11), 70), design)
    first = next(i for i, state in enumerate(history) if state.alarm is not None)
    assert first < N_SESSIONS
    alarm = history[first].alarm
    assert (alarm.chart, alarm.onset) == (Chart.TREND, START)
    assert alarm.value > alarm.limit == EVIDENCE_LIMIT
    assert alarm.level == pytest.approx(sign * 100.0, abs=4.0)
    assert {state.status for state in history[first:]} == {TrendStatus.ALARM}
    assert all(state.baseline is None for state in history)
    assert len(history[-1].learning) == first  # and nothing is kept of what comes later


def test_a_person_begins_the_baseline_anew():
    fallen = run(falling(np.random.default_rng(12)))[-1]
    assert fallen.status is TrendStatus.ALARM
    settled = run(85.0 + 2.0 * np.random.default_rng(13).standard_normal(N_SESSIONS + 1), state=reset(fallen))
    assert settled[0].status is TrendStatus.LEARNING
    assert settled[-1].baseline.mean == pytest.approx(85.0, abs=2.0)


@pytest.mark.parametrize("level", [100.0, 87.0])
def test_it_does_not_end_by_itself_when_the_level_has_settled_or_is_back(level):
    rng = np.random.default_rng(14)
    later = run(level + 2.0 * rng.standard_normal(60), state=run(falling(rng))[-1])
    assert {state.status for state in later} == {TrendStatus.ALARM}


def test_a_long_baseline_is_weighed_by_its_first_and_its_newest_sessions():
    """Learning of many sessions takes no longer for each, and a slow loss is still seen."""
    rng, many = np.random.default_rng(16), 10 * MOST
    slow = sessions_of(falling(rng, many, lost=13.0 * N_SESSIONS / many))
    fall = weigh_fall(slow, Prior(), towards_loss=-1.0)
    assert fall.log_evidence > EVIDENCE_LIMIT
    assert fall.change.value == pytest.approx(-13.0, abs=3.0 * fall.change.standard_uncertainty)


@pytest.mark.parametrize("values", [100.0 - np.arange(6.0), [100.0] * 5 + [99.0]])
def test_values_without_scatter_have_evidence(values):
    fall = weigh_fall(sessions_of(values), Prior(), towards_loss=-1.0)
    assert math.isfinite(fall.log_evidence)
    assert fall.change.value < 0.0


def test_a_rise_is_no_fall():
    assert run(200.0 - falling(np.random.default_rng(15)))[-1].baseline is not None
