"""Step the state of an axis from measurement to measurement, from unknown to alarm (ISO 13374: SD).

The detector is one pure function, :func:`step`. It never learns a new baseline by itself: a person does, with
:func:`reset`, or by a new calibration, which starts from a new :class:`monitor_core.trend.state.DetectorState`.
"""

from dataclasses import replace
from datetime import datetime

from monitor_core.errors import OutsideValidityError
from monitor_core.trend.baseline import Baseline, Observation, learn_baseline
from monitor_core.trend.design import EWMA_WEIGHT, SHEWHART_CONSECUTIVE, DetectorDesign, LossDirection
from monitor_core.trend.state import Chart, DetectorState, Evidence, Run, TrendStatus, cusum_step, ewma_step, winsorise

#: Hysteresis: an alarm or an alert ends when its chart was below this fraction of its limit ...
RELEASE_FRACTION = 0.5
#: ... for so many measurements in a row.
RELEASE_COUNT = 3
#: The CUSUM stops filling at so many limits, so that it can empty again once the cause is repaired.
FULL_CHART = 2.0


def step(state: DetectorState, observation: Observation, design: DetectorDesign) -> DetectorState:
    """Judge one more accepted measurement, later than all before it and in the same unit.

    A life begins with ``DetectorState()``. On-delay: an alarm takes two measurements at least. One alone can fill half
    of a CUSUM that was at rest, and the Shewhart rule waits for confirmation. Off-delay: see :data:`RELEASE_FRACTION`
    and :data:`RELEASE_COUNT`. An observation that is not later than the last raises ``OutsideValidityError``.
    """
    if state.last_at is not None and observation.at <= state.last_at:
        raise OutsideValidityError(
            f"observations must come in time order: expected one after {state.last_at.isoformat()}; "
            f"got {observation.at.isoformat()}"
        )
    if state.baseline is None:
        return _learn(state, observation, design.settings.baseline_size)
    return _watch(state, state.baseline, observation, design)


def reset(state: DetectorState) -> DetectorState:
    """Learn a new baseline, because a person has looked at the axis and found it in order.

    The stated false-alarm rate assumes that this is how a false alarm is cleared. Only the time of the last
    observation is kept, so that an old one cannot come again.
    """
    return DetectorState(last_at=state.last_at)


def _learn(state: DetectorState, observation: Observation, baseline_size: int) -> DetectorState:
    collected = (*state.learning, observation)
    # values all alike do not tell the scatter: then the baseline grows beyond its size until they do
    baseline = learn_baseline(collected) if len(collected) >= baseline_size else None
    status = TrendStatus.LEARNING if baseline is None else TrendStatus.NORMAL
    return DetectorState(
        status=status,
        since=state.since if state.status is status else observation.at,
        last_at=observation.at,
        learning=collected if baseline is None else (),
        baseline=baseline,
    )


def _watch(state: DetectorState, baseline: Baseline, observation: Observation, design: DetectorDesign) -> DetectorState:
    towards_loss = -1.0 if design.settings.loss is LossDirection.FALL else 1.0
    residual = towards_loss * baseline.standardise(observation)
    difference = observation.value - baseline.mean

    cusum = min(
        cusum_step(state.cusum, residual, design.cusum_reference, design.largest_increment),
        FULL_CHART * design.cusum_limit,
    )
    ewma = ewma_step(state.ewma, winsorise(residual, design.largest_residual), EWMA_WEIGHT)
    after = replace(
        state,
        last_at=observation.at,
        residual=residual,
        cusum=cusum,
        ewma=ewma,
        cusum_run=_extend(state.cusum_run, observation.at, difference) if cusum > 0.0 else None,
        shewhart_run=(
            _extend(state.shewhart_run, observation.at, difference) if residual > design.shewhart_limit else None
        ),
        ewma_run=_extend(state.ewma_run if ewma * state.ewma > 0.0 else None, observation.at, difference),
    )
    return _judge(after, observation.at, baseline, design)


def _extend(run: Run | None, at: datetime, difference: float) -> Run:
    return Run(at, 1, difference) if run is None else Run(run.since, run.count + 1, run.total + difference)


def _judge(state: DetectorState, at: datetime, baseline: Baseline, design: DetectorDesign) -> DetectorState:
    """Raise, keep or release alarm and alert from the charts as they are now."""
    alarm, alert = state.alarm, state.alert
    if alarm is None and state.shewhart_run is not None and state.shewhart_run.count >= SHEWHART_CONSECUTIVE:
        change = state.shewhart_run.mean_change(baseline)
        alarm = Evidence(Chart.SHEWHART, at, state.residual, design.shewhart_limit, state.shewhart_run.since, change)
    if alarm is None and state.cusum_run is not None and state.cusum > design.cusum_limit:
        change = state.cusum_run.mean_change(baseline)
        alarm = Evidence(Chart.CUSUM, at, state.cusum, design.cusum_limit, state.cusum_run.since, change)
    if alert is None and state.ewma_run is not None and abs(state.ewma) > design.ewma_limit:
        change = state.ewma_run.mean_change(baseline)
        alert = Evidence(Chart.EWMA, at, state.ewma, design.ewma_limit, state.ewma_run.since, change)

    alarm_charts_low = state.cusum < RELEASE_FRACTION * design.cusum_limit and state.shewhart_run is None
    quiet_alarm = state.quiet_alarm + 1 if alarm_charts_low else 0
    quiet_alert = state.quiet_alert + 1 if abs(state.ewma) < RELEASE_FRACTION * design.ewma_limit else 0
    alarm = None if quiet_alarm >= RELEASE_COUNT else alarm
    alert = None if quiet_alert >= RELEASE_COUNT else alert
    status = TrendStatus.ALARM if alarm else TrendStatus.ALERT if alert else TrendStatus.NORMAL
    return replace(
        state,
        status=status,
        since=state.since if status is state.status else at,
        alarm=alarm,
        alert=alert,
        quiet_alarm=quiet_alarm,
        quiet_alert=quiet_alert,
    )
