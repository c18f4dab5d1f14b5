"""Step the state of an axis from measurement to measurement, from unknown to alarm (ISO 13374: SD).

The detector is one pure function, :func:`step`. It learns what is healthy as long as nothing speaks against it, a fall
while it learns included; after an alarm a person says so with :func:`reset`, or with a new calibration, which starts
from a new :class:`monitor_core.trend.state.DetectorState`.
"""

import math
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

from monitor_core.errors import OutsideValidityError
from monitor_core.trend.baseline import baseline_of, contradicts, learn_baseline, learn_level_again
from monitor_core.trend.belief import Belief, Prediction, Prior, learn, pass_over, predict
from monitor_core.trend.charts import (
    EWMA_WEIGHT,
    SHEWHART_CONSECUTIVE,
    DetectorDesign,
    LossDirection,
    cusum_step,
    ewma_step,
    winsorise,
)
from monitor_core.trend.lasting_loss import Beginnings, LastingLoss, weigh, without_loss
from monitor_core.trend.learning import EVIDENCE_LIMIT, is_covered, weigh_fall
from monitor_core.trend.observation import Observation, Session, first_of
from monitor_core.trend.state import (
    Chart,
    Charts,
    DetectorState,
    Evidence,
    Foreseen,
    Run,
    TrendStatus,
)

#: Hysteresis: an alarm or an alert ends when its chart was below this fraction of its limit ...
RELEASE_FRACTION = 0.5
#: ... for so many sessions in a row.
RELEASE_COUNT = 3
#: The CUSUM stops filling at so many limits, so that it can empty again once the cause is repaired.
FULL_CHART = 2.0
#: Sessions are learnt as long as the CUSUM is below this fraction of its limit; others wait until it is again.
LEARNING_FRACTION = 0.3
#: So many sessions tell the level again after an inspection.
LEVEL_SIZE = 10
#: The reference of the CUSUM grows by so many standard deviations of what the baseline may be wrong by, which is common
#: to one session after another.
BASELINE_ALLOWANCE = 0.5
#: A session that the corrections of payload, temperature and position may shift by more of the scatter teaches nothing.
LARGEST_SYSTEMATIC = 0.5
#: A session of two measurements or more that lies so far towards loss alarms at once, not only when the next one does:
#: on a healthy axis one day in three million does.
SUDDEN_LIMIT = 5.0
#: A session is judged as soon as it has so large a part of the measurements that others had, or when it is over.
WHOLE = 0.9
#: A rise of the preload by at most so many standard deviations of a session may be an error of what twenty sessions
#: taught of the level; a larger one is a change that somebody should look into.
LARGEST_SETTLED = 1.0
#: A longer silence, of a machine at rest or a clock that was wrong, says nothing more of how often sessions come.
LONGEST_SILENCE = timedelta(days=30)


def step(state: DetectorState, observation: Observation, design: DetectorDesign) -> DetectorState:
    """Judge one more accepted measurement, later than all before it and in the same unit.

    A life begins with ``DetectorState()``, or one with a prior. On-delay: an alarm takes two sessions that speak for
    it, or two measurements of one that lies beyond :data:`SUDDEN_LIMIT`. One session can fill half of a CUSUM that was
    at rest, the Shewhart rule waits for confirmation, and a loss that lasts began before this session. Off-delay: see
    :data:`RELEASE_FRACTION` and :data:`RELEASE_COUNT`. An observation that is not later than the last raises
    ``OutsideValidityError``.
    """
    if state.last_at is not None and observation.at <= state.last_at:
        raise OutsideValidityError(
            f"observations must come in time order: expected one after {state.last_at.isoformat()}; "
            f"got {observation.at.isoformat()}"
        )
    if state.session is not None and state.session.takes(observation.at):
        session = state.session.with_observation(observation)
        state = replace(state, session=session, last_at=observation.at)
    else:
        session = first_of(observation)
        state = replace(
            _closed(state, design), session=session, last_at=observation.at,
            first_at=_first_at(state, observation.at), n_sessions=state.n_sessions + 1,
        )  # fmt: skip
    design = state.of(design)
    if state.known is None or state.learnt is None:
        return _learn(state, session, design)
    return _watch(state, state.learnt, state.known, session, design)


def _first_at(state: DetectorState, at: datetime) -> datetime:
    """Return when the first session began, as if no silence before this one had been longer than it counts."""
    if state.first_at is None or state.last_at is None:
        return at
    return state.first_at + max(at - state.last_at - LONGEST_SILENCE, timedelta(0))


def reset(state: DetectorState) -> DetectorState:
    """Learn the level anew, because a person has looked at the axis and found it in order.

    The stated false-alarm rate assumes that this is how a false alarm is cleared. What was learnt of scatter,
    dependence, season and covariates stays, as does the time of the last observation, so that an old one cannot come
    again.
    """
    return replace(_emptied(state), learnt=state.learnt)


def _emptied(state: DetectorState) -> DetectorState:
    """Return a state of the same life that has learnt nothing yet."""
    return DetectorState(
        last_at=state.last_at, first_at=state.first_at, n_sessions=state.n_sessions, prior=state.prior,
        contradicted=state.contradicted, covered=state.covered,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class ClosedSession:
    """A session that is over, and what the charts made of it."""

    session: Session
    residual: float | None  # in standard deviations, positive towards loss; None while the baseline was learnt
    reference: float | None  # of the CUSUM
    alarmed: bool  # whether an alarm stood after it


def latest_difference(state: DetectorState) -> float | None:
    """Return by how much the session that is going on differs from what was expected, as the charts have it.

    In the unit of the observations, season and covariates taken out; None while the baseline is learnt.
    """
    if state.session is None or state.learnt is None:
        return None
    return predict(state.learnt, state.session).difference


def closed_session(before: DetectorState, after: DetectorState) -> ClosedSession | None:
    """Return the session that ended between two states of a life, the second by a later measurement or a reset.

    A session of too few measurements is judged only when a later one ends it, and may alarm then.
    """
    session = before.session
    if session is None or (after.session is not None and after.session.started_at == session.started_at):
        return None
    if before.known is None:
        return ClosedSession(session, None, None, alarmed=before.alarm is not None)
    charts = before.charts if after.session is None else after.before
    return ClosedSession(session, charts.residual, charts.reference, alarmed=charts.alarm is not None)


def _closed(state: DetectorState, design: DetectorDesign) -> DetectorState:
    """Close the session that was going on: learn it, or let it wait until nothing speaks against it any more."""
    session = state.session
    if session is None:
        return state
    if state.learnt is None or state.known is None:
        collected = (*state.learning, session) if state.alarm is None else state.learning
        return replace(state, learning=collected, session=None)
    foreseen = state.foreseen
    if foreseen is None:
        foreseen = _foreseen(state, state.learnt, predict(state.known, session), session, state.of(design))
    design = foreseen.design
    charts, beginnings, prediction = state.charts, foreseen.beginnings, foreseen.prediction
    if not _is_whole(session, state.learnt):
        late = replace(charts, lasting=foreseen.lasting)
        charts = _judge(late, session, state.learnt, design, whole=True)
    known = (learn if foreseen.teaches else pass_over)(state.known, prediction, session)
    if charts.alarm is not None:
        if charts.alarm.chart is Chart.SHIRYAEV_ROBERTS and state.before.alarm is None:
            learnt = without_loss(known, beginnings, charts.alarm.onset, _sign(design))
        else:
            learnt = _followed(state, state.learnt, prediction, session)
        known, beginnings = learnt, Beginnings()
    else:
        undisputed = charts.alert is None or _has_settled_upwards(charts, state.learnt, design)
        calm = charts.cusum <= LEARNING_FRACTION * design.cusum_limit and undisputed
        learnt = known if foreseen.teaches and calm else _followed(state, state.learnt, prediction, session)
    return replace(
        state, learnt=learnt, known=known, beginnings=beginnings, session=None, before=charts, foreseen=None
    )  # fmt: skip


def _foreseen(
    state: DetectorState, learnt: Belief, prediction: Prediction, session: Session, design: DetectorDesign
) -> Foreseen:
    """Tell what comes of a session that was predicted so by what is known. Nothing is weighed while an alarm stands."""
    teaches = not session.in_doubt and (
        session.systematic_uncertainty <= LARGEST_SYSTEMATIC * math.sqrt(learnt.bank.variance)
    )
    beginnings, lasting = state.beginnings, None
    if state.before.alarm is None:
        beginnings, lasting = weigh(
            beginnings, prediction, session, towards_loss=_sign(design), learns=teaches, limit=design.evidence_limit
        )
    return Foreseen(prediction, beginnings, lasting, design, teaches=teaches)


def _followed(state: DetectorState, learnt: Belief, prediction: Prediction, session: Session) -> Belief:
    """Let what is learnt pass over a session that was predicted so by what is known."""
    return pass_over(learnt, prediction if state.known is learnt else predict(learnt, session), session)


def _sign(design: DetectorDesign) -> float:
    """Return which way values go as preload is lost."""
    return -1.0 if design.settings.loss is LossDirection.FALL else 1.0


def _has_settled_upwards(charts: Charts, learnt: Belief, design: DetectorDesign) -> bool:
    """Tell whether an alert is about a small rise, and has lasted for as many sessions as make a baseline.

    They tell the level as well as those that it was first learnt from. A rise by more than :data:`LARGEST_SETTLED`, or
    one that goes on, stands until a person has looked.
    """
    run = charts.ewma_run
    if charts.ewma >= 0.0 or run is None or run.count < design.settings.baseline_size:
        return False
    return abs(run.total / run.count) <= LARGEST_SETTLED * math.sqrt(learnt.bank.variance)


def _learn(state: DetectorState, session: Session, design: DetectorDesign) -> DetectorState:
    """Collect the baseline and learn it once there is enough, unless it falls: then not before a person says so.

    A level that has settled lower is not learnt, either: nobody has looked why it did.
    """
    if state.alarm is not None:
        return state
    collected = (*state.learning, session)
    fall = weigh_fall(collected, state.prior or Prior(), towards_loss=_sign(design))
    if fall is not None and fall.log_evidence > EVIDENCE_LIMIT:
        evidence = (session.last_at, fall.log_evidence, EVIDENCE_LIMIT, fall.onset, fall.change, fall.level)
        charts = replace(state.charts, alarm=Evidence(Chart.TREND, *evidence))
        return replace(state, status=TrendStatus.ALARM, since=session.last_at, charts=charts)
    if state.learnt is not None:
        enough = len(collected) >= LEVEL_SIZE
        learnt, contradicted = learn_level_again(state.learnt, collected) if enough else None, state.contradicted
    else:
        span = collected[-1].started_at - collected[0].started_at
        enough = len(collected) >= design.settings.baseline_size and span >= design.settings.baseline_span
        contradicted = enough and state.prior is not None and contradicts(collected, state.prior)
        # as long as the sessions do not tell the scatter, they are not enough
        learnt = learn_baseline(collected, None if contradicted else state.prior) if enough else None
    status = TrendStatus.LEARNING if learnt is None else TrendStatus.NORMAL
    since = state.since if state.status is status else session.last_at
    if learnt is None:
        return replace(state, status=status, since=since)
    return replace(
        _emptied(state), status=status, since=since, contradicted=contradicted, learnt=learnt, known=learnt,
        covered=is_covered(collected, state.prior or Prior(), towards_loss=_sign(design)),
    )  # fmt: skip


def _watch(
    state: DetectorState, learnt: Belief, known: Belief, session: Session, design: DetectorDesign
) -> DetectorState:
    prediction = predict(learnt, session)
    difference = prediction.difference
    evident = float(session.evident(difference))
    residual = _sign(design) * prediction.residual(evident - difference)
    reference = design.cusum_reference + BASELINE_ALLOWANCE * math.sqrt(prediction.unlearnt)
    foreseen, whole = None, _is_whole(session, learnt)
    if whole:
        expected = prediction if known is learnt else predict(known, session)
        foreseen = _foreseen(state, learnt, expected, session, design)
    lasting = None if foreseen is None else foreseen.lasting
    charts = _charted(
        state.before, session, design, difference=difference, residual=residual, reference=reference, lasting=lasting
    )
    judged = _judge(charts, session, learnt, design, whole=whole)
    status = TrendStatus.ALARM if judged.alarm else TrendStatus.ALERT if judged.alert else TrendStatus.NORMAL
    return replace(
        state,
        status=status,
        since=state.since if status is state.status else session.last_at,
        charts=judged,
        foreseen=foreseen,
    )


def _charted(
    before: Charts,
    session: Session,
    design: DetectorDesign,
    *,
    difference: float,
    residual: float,
    reference: float,
    lasting: LastingLoss | None,
) -> Charts:
    """Carry the charts over a session."""
    at = session.started_at
    cusum = min(
        cusum_step(before.cusum, residual, reference, design.largest_increment), FULL_CHART * design.cusum_limit
    )
    ewma = ewma_step(before.ewma, winsorise(residual, design.largest_residual), EWMA_WEIGHT)
    beyond = residual > design.shewhart_limit
    return replace(
        before,
        residual=residual,
        reference=reference,
        cusum=cusum,
        ewma=ewma,
        cusum_run=_extend(before.cusum_run, at, difference) if cusum > 0.0 else None,
        shewhart_run=_extend(before.shewhart_run, at, difference) if beyond else None,
        ewma_run=_extend(before.ewma_run if ewma * before.ewma > 0.0 else None, at, difference),
        lasting=lasting,
    )


def _extend(run: Run | None, at: datetime, difference: float) -> Run:
    return Run(at, 1, difference) if run is None else Run(run.since, run.count + 1, run.total + difference)


def _is_whole(session: Session, learnt: Belief) -> bool:
    """Tell whether a session has about as many measurements as others had."""
    return session.count * learnt.n_sessions >= WHOLE * learnt.n_observations


def _judge(charts: Charts, session: Session, learnt: Belief, design: DetectorDesign, *, whole: bool) -> Charts:
    """Raise, keep or release alarm and alert from the charts as they are now.

    A session that is not whole yet raises nothing but the alarm of a sudden loss: whoever looks twenty times finds
    something once.
    """
    alarm, alert, at = charts.alarm, charts.alert, session.last_at
    if alarm is None and charts.shewhart_run is not None and session.count > 1 and charts.residual > SUDDEN_LIMIT:
        change = charts.shewhart_run.mean_change(baseline_of(learnt))
        alarm = Evidence(Chart.SHEWHART, at, charts.residual, SUDDEN_LIMIT, charts.shewhart_run.since, change)
    if not whole:
        return replace(charts, alarm=alarm)
    if alarm is None and charts.shewhart_run is not None and charts.shewhart_run.count >= SHEWHART_CONSECUTIVE:
        change = charts.shewhart_run.mean_change(baseline_of(learnt))
        alarm = Evidence(Chart.SHEWHART, at, charts.residual, design.shewhart_limit, charts.shewhart_run.since, change)
    if alarm is None and charts.cusum_run is not None and charts.cusum > design.cusum_limit:
        change = charts.cusum_run.mean_change(baseline_of(learnt))
        alarm = Evidence(Chart.CUSUM, at, charts.cusum, design.cusum_limit, charts.cusum_run.since, change)
    lasting = charts.lasting
    if alarm is None and lasting is not None and lasting.change is not None:
        limit, value = design.evidence_limit, lasting.log_evidence
        alarm = Evidence(Chart.SHIRYAEV_ROBERTS, at, value, limit, lasting.onset, lasting.change)
        # the charts begin to see this loss only now; it ends as it does for other alarms
        run = charts.cusum_run or _extend(None, session.started_at, lasting.change.value)
        charts = replace(charts, cusum=max(charts.cusum, design.cusum_limit), cusum_run=run)
    if alert is None and charts.ewma_run is not None and abs(charts.ewma) > design.ewma_limit:
        change = charts.ewma_run.mean_change(baseline_of(learnt))
        alert = Evidence(Chart.EWMA, at, charts.ewma, design.ewma_limit, charts.ewma_run.since, change)

    alarm_charts_low = charts.cusum < RELEASE_FRACTION * design.cusum_limit and charts.shewhart_run is None
    quiet_alarm = charts.quiet_alarm + 1 if alarm_charts_low else 0
    quiet_alert = charts.quiet_alert + 1 if abs(charts.ewma) < RELEASE_FRACTION * design.ewma_limit else 0
    return replace(
        charts,
        alarm=None if quiet_alarm >= RELEASE_COUNT else alarm,
        alert=None if quiet_alert >= RELEASE_COUNT else alert,
        quiet_alarm=quiet_alarm,
        quiet_alert=quiet_alert,
    )
