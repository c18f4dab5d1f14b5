"""Lay out what the history of an axis says: what is normal, where the trend goes, how often it alarms falsely."""

from dataclasses import dataclass

import scipy

from monitor_core.preload import Calibration, preload_from_feature
from monitor_core.trend import DetectorState, FoundRate, TrendLine
from service.clock import text_of
from service.json_types import JsonObject


def baseline_document(state: DetectorState, calibration: Calibration) -> JsonObject | None:
    """Lay out what is normal: mean, and the 95 % prediction interval of one more healthy session."""
    baseline, prior = state.baseline, state.prior
    if baseline is None:
        return None
    interval = baseline.prediction_interval()
    # the feature falls as the preload rises, so its upper end is the lower preload
    lower, upper = (preload_from_feature(end, calibration.coefficients) for end in (interval.upper, interval.lower))
    lent: JsonObject = {"n_sisters": 0, "weight_in_scatter": 0.0}
    if prior is not None and prior.n_sisters:
        weight = min(prior.degrees_of_freedom / baseline.degrees_of_freedom, 1.0)
        lent = {"n_sisters": prior.n_sisters, "weight_in_scatter": weight}
    return {
        "preload_n": preload_from_feature(baseline.mean, calibration.coefficients),
        "prediction_interval_95_n": [lower, upper],
        "size": baseline.size,
        "n_measurements": baseline.n_observations,
        "autocorrelation": baseline.autocorrelation,
        "started_at": text_of(baseline.started_at),
        "ended_at": text_of(baseline.ended_at),
        "not_seen": list(baseline.not_seen),
        "sisters": lent,
    }


#: What to do about an alert that stands, by where the preload has gone.
_ALERT = {
    "rise": (
        "since {since:%Y-%m-%d} the preload is on average {change:.0f} N above what was learnt as healthy, over "
        "{count} sessions. That is no loss, but nothing tightens by itself: are payload, temperature and position as "
        "stated, was the machine worked on? A small rise is learnt after {settled} sessions; a larger one, once it is "
        "explained, by activating a new calibration"
    ),
    "fall": (
        "since {since:%Y-%m-%d} the preload is on average {change:.0f} N below what was learnt as healthy, over "
        "{count} sessions, which is not enough for an alarm: measure again, at another position too"
    ),
}


def alert_document(state: DetectorState, calibration: Calibration, settled: int) -> JsonObject | None:
    """Lay out the alert that stands: how far the preload is off, and what to do; a rise settles in so many sessions."""
    run, baseline = state.charts.ewma_run, state.baseline
    if state.alert is None or state.alarm is not None or run is None or baseline is None:
        return None
    change = preload_from_feature(baseline.mean + run.total / run.count, calibration.coefficients)
    change -= preload_from_feature(baseline.mean, calibration.coefficients)
    direction = "fall" if state.charts.ewma > 0.0 else "rise"
    words = _ALERT[direction].format(since=run.since, change=abs(change), count=run.count, settled=settled)
    return {
        "raised_at": text_of(state.alert.raised_at),
        "since": text_of(run.since),
        "direction": direction,
        "mean_change_n": change,
        "n_sessions": run.count,
        "sentence": words,
    }


def line_document(line: TrendLine, calibration: Calibration) -> JsonObject:
    """Lay out the line through the trend in newtons a year, at the preload where it ends; losses are negative."""
    preload = preload_from_feature(line.at_end.value, calibration.coefficients)
    per_feature = -3.0 * preload / line.at_end.value  # preload = (g/k3)^-3
    reach = float(scipy.special.stdtrit(line.slope.degrees_of_freedom, 0.975)) * line.slope.standard_uncertainty
    ends = sorted(per_feature * (line.slope.value + side * reach) for side in (-1.0, 1.0))
    return {
        "preload_at_end_n": preload,
        "slope_n_per_year": per_feature * line.slope.value,
        "interval_95_n_per_year": [*ends],
        "interval_kind": "confidence",
        "started_at": text_of(line.started_at),
        "ended_at": text_of(line.ended_at),
        "n_sessions": line.n_sessions,
    }


@dataclass(frozen=True, slots=True)
class RateOfFalseAlarms:
    """What was stated, and what the axis' own history says; None where it is too short to say anything."""

    stated: float  # a year
    found: FoundRate | None
    n_sessions: int
    fewest_sessions: int  # that anything is said of


def false_alarms_document(rate: RateOfFalseAlarms) -> JsonObject:
    """Lay out stated and found rate, with a sentence for people."""
    document: JsonObject = {"stated_per_year": rate.stated, "n_sessions": rate.n_sessions}
    if rate.found is None:
        return document | {
            "found_per_year": None,
            "interval_95_per_year": None,
            "sentence": (
                f"stated {rate.stated:g} a year; the history of this axis says nothing yet: {rate.fewest_sessions} "
                f"sessions are needed, got {rate.n_sessions}"
            ),
        }
    lower, upper = rate.found.interval.lower, rate.found.interval.upper
    return document | {
        "found_per_year": rate.found.rate,
        "interval_95_per_year": [lower, upper],
        "interval_kind": "confidence",
        "sentence": (
            f"stated {rate.stated:g} a year; the last {rate.n_sessions} sessions of this axis, in blocks of a "
            f"fortnight, say {rate.found.rate:.1f} ({lower:.1f} to {upper:.1f})"
        ),
    }
