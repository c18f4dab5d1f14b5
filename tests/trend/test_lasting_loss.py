"""What all sessions together say of a loss that lasts, against the same without any filter."""

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from scipy import integrate, special, stats

from benchmarks import false_alarms
from benchmarks.false_alarms import delay_of
from monitor_core.trend import (
    Chart,
    DetectorSettings,
    DetectorState,
    LossDirection,
    Observation,
    TrendStatus,
    design_detector,
    lasting_loss,
    reset,
    step,
)
from monitor_core.trend.belief import STRUCTURES, Prior, begin, healthy_value, learn, predict
from monitor_core.trend.lasting_loss import KEPT, STEP, Beginnings, LastingLoss, weigh, without_loss
from monitor_core.trend.observation import first_of
from tests.trend.test_baseline import only

START = datetime(2025, 1, 1, tzinfo=UTC)
DAY = timedelta(days=1)
VARIANCE = 30.0
N_HEALTHY = 20  # sessions that are learnt before any is weighed


def sessions_of(values, days=None):
    days = np.arange(len(values)) if days is None else days
    return [first_of(Observation(START + float(d) * DAY, float(v))) for d, v in zip(days, values, strict=True)]


def weighed(values, days=None, towards_loss=1.0, prior=None):
    """Beginnings, loss and belief after each session that is weighed."""
    sessions = sessions_of(values, days)
    belief = begin(sessions[0], prior or Prior(), VARIANCE)
    beginnings, history = Beginnings(), []
    for number, session in enumerate(sessions):
        prediction = predict(belief, session)
        loss = None
        if number >= N_HEALTHY:
            beginnings, loss = weigh(beginnings, prediction, session, towards_loss=towards_loss, learns=True)
        belief = learn(belief, prediction, session)
        history.append((beginnings, loss, belief))
    return history[N_HEALTHY:]


def covariance(structure, days):
    """Return that of the sessions of a healthy axis: the scale of their multivariate t."""
    angle = 2.0 * math.pi * days / 365.25
    prior = Prior().deviations
    apart = np.abs(days[:, None] - days)
    own = structure.share * structure.correlation**apart + (1.0 - structure.share) * np.eye(len(days))
    for column, deviation in ((np.ones(len(days)), 100.0), (1.0 - np.cos(angle), prior[0]), (np.sin(angle), prior[1])):
        own = own + deviation**2 * np.outer(column, column)
    return VARIANCE * own


def gain_of_a_step(information, cross, squares, n):
    """Integrate over σ and a half-normal step of STEP σ how much better a step explains; σ² of the unit is VARIANCE."""
    log_sigma = np.linspace(-2.0, 4.0, 3001)
    sigma, half_nu = np.exp(log_sigma), 0.5 * Prior().degrees_of_freedom
    log_posterior = -(2.0 * half_nu + n) * log_sigma - (half_nu + 0.5 * squares) / sigma**2
    own = information + STEP**-2
    log_gain = (
        math.log(2.0) + special.log_ndtr(cross / sigma / math.sqrt(own))
        - 0.5 * math.log(STEP**2 * own) + 0.5 * (cross / sigma) ** 2 / own
    )  # fmt: skip
    density = np.exp(log_posterior - log_posterior.max())
    return math.log(
        integrate.simpson(density * np.exp(log_gain), x=log_sigma) / integrate.simpson(density, x=log_sigma)
    )


def directly(values, days, onset):
    """Compute the evidence of a step since a session from the multivariate t of all sessions, without a filter."""
    error, since = values - values[0], (np.arange(len(values)) >= onset) * 1.0
    nu, n = Prior().degrees_of_freedom, len(values)
    healthy, stepped = [], []
    for structure in STRUCTURES:
        shape = covariance(structure, days)
        inverse, volume = np.linalg.inv(shape), np.linalg.slogdet(shape)[1]
        squares = error @ inverse @ error
        log_density = math.log(structure.weight) - 0.5 * volume - 0.5 * (nu + n) * math.log1p(squares / nu)
        healthy.append(log_density)
        information = since @ inverse @ since * VARIANCE
        cross = since @ inverse @ error * math.sqrt(VARIANCE)
        stepped.append(log_density + gain_of_a_step(information, cross, squares, n))
    return special.logsumexp(stepped) - special.logsumexp(healthy)


@pytest.mark.parametrize("seed", range(4))
def test_the_evidence_is_that_of_all_sessions_together_without_a_filter(monkeypatch, seed):
    monkeypatch.setattr(lasting_loss, "KEPT", 1000)
    monkeypatch.setattr(lasting_loss, "LARGEST_WORD", math.inf)
    rng = np.random.default_rng(seed)
    days = np.sort(rng.choice(80, 36, replace=False)).astype(float)
    days -= days[0]
    values = 300.0 + 5.0 * rng.uniform(-1.5, 1.5, 36) + 8.0 * (np.arange(36) >= 25)
    expected = special.logsumexp([directly(values, days, onset) for onset in range(N_HEALTHY, 35)])
    assert weighed(values, days)[-1][1].log_evidence == pytest.approx(expected, abs=0.02)


def test_few_beginnings_keep_the_evidence_of_all(monkeypatch):
    rng = np.random.default_rng(5)
    steps = [1.0, 2.0, 3.0]
    draws = [300.0 + 5.0 * (rng.standard_normal(80) + size * (np.arange(80) >= 40)) for size in steps for _ in range(5)]
    few = [max(loss.log_evidence for _, loss, _ in weighed(values) if loss) for values in draws]
    assert all(len(weighed(values)[-1][0].at) == KEPT for values in draws[:2])
    monkeypatch.setattr(lasting_loss, "KEPT", 1000)
    every = [max(loss.log_evidence for _, loss, _ in weighed(values) if loss) for values in draws]
    assert few == pytest.approx(every, abs=0.5)


def test_onset_and_size_are_those_of_the_step_and_the_healthy_level_is_the_one_before():
    rng = np.random.default_rng(6)
    values = 300.0 + 5.0 * rng.standard_normal(100)
    values[60:] -= 15.0
    beginnings, loss, belief = weighed(values, towards_loss=-1.0)[-1]
    assert abs((loss.onset - START) / DAY - 60.0) <= 3.0
    assert abs(loss.change.value + 15.0) <= 3.0 * loss.change.standard_uncertainty
    assert 0.5 < loss.change.standard_uncertainty < 4.0
    healthy = without_loss(belief, beginnings, loss.onset, -1.0)
    mean, uncertainty = healthy_value(healthy, START + 60 * DAY)
    assert abs(mean - 300.0) <= 3.0 * uncertainty
    assert uncertainty < 5.0
    learnt, _ = healthy_value(belief, START + 100 * DAY)
    assert learnt < mean - 7.0  # what the belief had taken for its level is given back


def test_the_healthy_level_under_a_loss_is_that_of_a_regression_with_a_step(monkeypatch, subtests):
    """Bayesian linear regression of all sessions at once, the step one of its columns."""
    for structure in range(len(STRUCTURES)):
        with subtests.test(structure=structure):
            monkeypatch.setattr(lasting_loss, "KEPT", 1000)
            monkeypatch.setattr(lasting_loss, "LARGEST_WORD", math.inf)
            values = 300.0 + 5.0 * np.random.default_rng(7).uniform(-1.0, 1.0, 60) + 6.0 * (np.arange(60) >= 30)
            days = np.arange(60.0)
            beginnings, _, belief = weighed(values, prior=only(structure))[-1]
            healthy = without_loss(belief, beginnings, START + 30 * DAY, 1.0)

            angle = 2.0 * math.pi * days / 365.25
            x = np.column_stack([np.ones(60), 1.0 - np.cos(angle), np.sin(angle), days >= 30])
            own = STRUCTURES[structure]
            apart = np.abs(days[:, None] - days)
            inverse = np.linalg.inv(own.share * own.correlation**apart + (1.0 - own.share) * np.eye(60))
            precision = x.T @ inverse @ x + np.diag([1e-4, *(d**-2.0 for d in Prior().deviations[:2]), STEP**-2])
            level = np.linalg.solve(precision, x.T @ inverse @ (values - values[0]))[0]
            assert healthy_value(healthy, START)[0] == pytest.approx(values[0] + level, abs=1e-4)


def test_a_rise_is_no_loss_and_one_session_says_nothing_that_lasts():
    values = np.full(60, 300.0) + 5.0 * np.resize([1.0, -1.0], 60)
    up = values + 20.0 * (np.arange(60) >= 40)
    nothing = math.log(60 - N_HEALTHY)  # R of a healthy axis is in the mean the number of sessions that were weighed
    assert weighed(up, towards_loss=-1.0)[-1][1].log_evidence < nothing < weighed(up)[-1][1].log_evidence
    assert weighed(values[: N_HEALTHY + 1])[-1][1] is None
    outlier = values.copy()
    outlier[50] += 1e6
    assert max(loss.log_evidence for _, loss, _ in weighed(outlier) if loss) < 3.0


def watched(values, design):
    state, states = DetectorState(), []
    for day, value in enumerate(values):
        state = step(state, Observation(START + day * DAY, float(value)), design)
        states.append(state)
    return states


def followed_step():
    """Draw a loss of 1.2 standard deviations that all sessions together see first."""
    design = design_detector(DetectorSettings(loss=LossDirection.RISE))
    for seed in range(100):
        values = np.random.default_rng([8, seed]).standard_normal(260)
        values[40:200] += 1.2
        states = watched(values, design)
        first = next((n for n, state in enumerate(states) if state.alarm is not None), None)
        if first is not None and 45 < first < 150 and states[first].alarm.chart is Chart.SHIRYAEV_ROBERTS:
            return values, states, first
    raise AssertionError("none of a hundred axes has such an alarm")


def test_an_alarm_of_all_sessions_stands_until_the_loss_is_repaired_and_names_its_onset():
    _, states, first = followed_step()
    alarm = states[first].alarm
    assert alarm.value > alarm.limit
    assert alarm.onset < START + first * DAY
    assert alarm.change.value == pytest.approx(1.2, abs=3.0 * alarm.change.standard_uncertainty)
    assert all(state.status is TrendStatus.ALARM for state in states[first:200])
    assert states[first - 1].baseline.mean > states[first + 1].baseline.mean  # as before the loss
    assert states[-1].status is not TrendStatus.ALARM
    assert reset(states[first]).beginnings == Beginnings()


def test_nothing_is_weighed_while_an_alarm_stands():
    _, states, first = followed_step()
    assert states[first].charts.lasting is not None
    assert all(state.charts.lasting is None and not state.beginnings.at for state in states[first + 1 : first + 20])


def test_neither_unit_nor_zero_nor_direction_matter(monkeypatch):
    rng = np.random.default_rng(9)
    values = 5.0 * (rng.standard_normal(50) + 2.0 * (np.arange(50) >= 30))
    rising = weighed(300.0 + values)[-1][1]
    monkeypatch.setitem(globals(), "VARIANCE", VARIANCE * 1e-6)
    falling = weighed(7.0 - 1e-3 * values, towards_loss=-1.0)[-1][1]
    assert isinstance(rising, LastingLoss)
    assert falling.log_evidence == pytest.approx(rising.log_evidence, abs=1e-7)
    assert falling.change.value == pytest.approx(-1e-3 * rising.change.value, rel=1e-7)


def after(sessions, **weighing):
    """Return the loss after sessions that are weighed on what twenty healthy ones have taught."""
    healthy = sessions_of(300.0 + 5.0 * np.resize([1.0, -1.0], N_HEALTHY))
    belief, beginnings, loss = begin(healthy[0], Prior(), VARIANCE), Beginnings(), None
    for session in healthy:
        belief = learn(belief, predict(belief, session), session)
    for session in sessions:
        prediction = predict(belief, session)
        beginnings, loss = weigh(beginnings, prediction, session, towards_loss=1.0, **weighing)
        if weighing["learns"]:
            belief = learn(belief, prediction, session)
    return loss


def test_what_corrections_could_explain_is_no_evidence():
    off = sessions_of([310.0] * 40, np.arange(N_HEALTHY, N_HEALTHY + 40))
    nothing = math.log(40.0)  # as many sessions as were weighed
    assert after(off, learns=True).log_evidence > nothing
    explained = [replace(session, systematic_uncertainty=10.0) for session in off]
    assert after(explained, learns=True).log_evidence < nothing


@pytest.mark.parametrize("doubt", [{"in_doubt": True}, {"systematic_uncertainty": 8.0}])
def test_sessions_that_teach_nothing_say_nothing_however_many_they_are(doubt):
    """Evidence is no count of sessions: at four false alarms a year it would reach its limit after 91."""
    design = design_detector(DetectorSettings(false_alarms_per_year=4.0))
    state = DetectorState()
    for day in range(170):
        said = doubt if day >= 22 else {}
        state = step(state, Observation(START + day * DAY, 300.0 + (10.0 if day % 2 else -10.0), **said), design)
        assert state.alarm is None
        if day == 22:
            begun = state.beginnings.at
    assert set(state.beginnings.at) <= {*begun, START + 21 * DAY}
    assert state.charts.lasting is None
    # and they say something again once they teach
    for day in range(170, 175):
        state = step(state, Observation(START + day * DAY, 300.0 + (10.0 if day % 2 else -10.0)), design)
    assert state.charts.lasting.log_evidence < math.log(22.0)


@pytest.mark.release
def test_a_healthy_axis_is_alarmed_by_all_sessions_together_at_most_as_often_as_a_martingale_allows():
    """R exceeds A within n sessions in n of A cases at most (Doob)."""
    rng, n, level = np.random.default_rng(10), 120, 1000.0
    beyond = sum(
        max(loss.log_evidence for _, loss, _ in weighed(300.0 + 5.0 * rng.standard_normal(N_HEALTHY + n)) if loss)
        > math.log(level)
        for _ in range(150)
    )
    assert beyond <= stats.binom.ppf(0.999, 150, n / level)


@pytest.mark.release
def test_few_steps_of_two_standard_deviations_are_missed_in_a_shop(monkeypatch):
    """The benchmark of false alarms draws 300: 1.3 %. Here those of 150 that the charts alone miss, found by a half."""

    def missed():
        return [axis for axis in range(150) if math.isinf(delay_of("2 σ step in the shop", 20, 941, axis))]

    with_all_sessions = missed()
    whole = false_alarms.limits()
    monkeypatch.setattr(false_alarms, "limits", lambda: replace(whole, evidence_limit=math.inf))
    alone = missed()
    assert len(alone) >= 4
    assert len(with_all_sessions) <= 0.5 * len(alone)
