"""What is stored and shown of an outcome: plain JSON, every quantity with its unit in its name."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Literal, overload

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from monitor_core.arrays import FloatArray
from monitor_core.axis_state import AxisState
from monitor_core.modal import ModalMeasurement
from monitor_core.pipeline import MeasurementOutcome
from monitor_core.preload import (
    Calibration,
    DragTorque,
    Friction,
    IfStated,
    PreloadEstimate,
    SessionPreload,
    excess_variance_of,
    preload_from_feature,
    widened,
    widened_ends,
)
from monitor_core.recording import Doubt, Rejection
from monitor_core.recordings.elements.units import to_millimetres
from monitor_core.trend import Chart, DetectorState, Evidence, latest_difference
from monitor_core.uncertainty import Interval, IntervalKind, plus_minus
from service.clock import text_of
from service.documents.frequency_fall import REACH, FrequencyFall, fall_in_english, fall_of
from service.json_types import Json, JsonObject

if TYPE_CHECKING:  # the command line writes documents without a database
    from service.store.intake import MeasurementRecord
    from service.store.trend.lost_motion import ChartedReading
    from service.store.trend.points import TrendPoint
    from service.store.trend.shown import ShownPoint, ToldColumns


@overload
def finite_or_null(value: Mapping[str, object]) -> JsonObject: ...
@overload
def finite_or_null(value: float) -> float | None: ...
@overload
def finite_or_null(value: object) -> Json: ...
def finite_or_null(value: object) -> Json:
    """Return a value as JSON has it, infinities and NaN as null, at any depth; raises TypeError if it is none."""
    if isinstance(value, Mapping):
        return {key: finite_or_null(item) for key, item in value.items()}
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if value is None or isinstance(value, int):
        return value
    if isinstance(value, str):
        return str(value)  # a named reason as its name
    if isinstance(value, Sequence):
        return [finite_or_null(item) for item in value]
    if isinstance(value, np.generic | np.ndarray):
        return finite_or_null(value.tolist())
    raise TypeError(f"expected a JSON value; got {type(value).__name__}")


def members(record: object, *names: str) -> dict[str, object]:
    """Return members of a record that a document calls by the same names."""
    return {name: getattr(record, name) for name in names}


def modal_document(modal: ModalMeasurement) -> JsonObject:
    """Lay out a measured mode; the keys are those of ``preload frf``."""
    mode, held = modal.mode, modal.antiresonance
    of_held: JsonObject = (
        {}
        if held is None
        else {
            "antiresonance_hz": held.value,
            "antiresonance_standard_uncertainty_hz": held.standard_uncertainty,
        }
    )
    return of_held | {
        "position_mm": to_millimetres(modal.conditions.position),
        "frequency_hz": mode.frequency.value,
        "frequency_standard_uncertainty_hz": mode.frequency.standard_uncertainty,
        "damping_ratio": mode.damping_ratio.value,
        "damping_ratio_standard_uncertainty": mode.damping_ratio.standard_uncertainty,
        "residue_phase_rad": mode.residue_phase,
        "coherence": modal.coherence,
        "n_averages": modal.n_averages,
        "n_modes": modal.n_modes,
        "tones_removed_hz": list(modal.tones),
        "warnings": list(modal.warnings),
        "windows_dropped": len(modal.refused_windows),
        "payload_kg": modal.conditions.payload_mass,
        "temperature_c": modal.conditions.temperature,
    }


def estimate_document(estimate: PreloadEstimate) -> JsonObject:
    """Lay out a preload with its 95 % coverage interval and what it rests on; an open end is ``null``."""
    return {
        "preload_n": estimate.preload,
        "interval_95_n": list(ends_in_newtons(estimate.interval)),
        "interval_kind": f"95 % {estimate.interval.kind}",
        "extrapolated": estimate.extrapolated,
        "outside": list(estimate.outside),
        "assumptions": list(estimate.assumptions),
        "doubts": doubt_documents(estimate.doubts),
        "compared_with_calibration": {
            str(name): {"relative_difference": math.expm1(deviation.logarithm), "standard_deviations": deviation.score}
            for name, deviation in estimate.deviations.items()
        },
        "preload_feature_s2": estimate.feature.value,
        "preload_feature_standard_uncertainty_s2": estimate.feature.standard_uncertainty,
        "variance_shares": asdict(estimate.shares),
        "if_stated": _if_stated_documents(estimate.if_stated),
    }


def session_document(joint: SessionPreload) -> JsonObject:
    """Lay out the one preload of a session, with the weight of each of its measurements."""
    return {
        "preload_n": joint.preload,
        "interval_95_n": list(ends_in_newtons(joint.interval)),
        "interval_kind": f"95 % {joint.interval.kind}",
        "variance_shares": asdict(joint.shares),
        "if_stated": _if_stated_documents(joint.if_stated),
        "weights": list(joint.weights),
    }


def _if_stated_documents(if_stated: Iterable[IfStated]) -> list[JsonObject]:
    return [
        {"quantities": list(better.quantities), "interval_95_n": list(ends_in_newtons(better.interval))}
        for better in if_stated
    ]


def doubt_documents(doubts: Iterable[Doubt]) -> list[JsonObject]:
    """Lay out what speaks against a number."""
    return [{"reason": str(doubt.reason), "detail": doubt.detail} for doubt in doubts]


#: Of an interval [N]; an open end is None.
Ends = tuple[float | None, float | None]


def ends_in_newtons(interval: Interval) -> Ends:
    """Return both ends of an interval; an open one is None [N]."""
    return interval.lower, interval.upper if math.isfinite(interval.upper) else None


def if_stated_in_words(ends: Ends, if_stated: Iterable[tuple[Sequence[str], Ends]]) -> str:
    """Say what stating a quantity would bring: ± 22 N; with the temperature ± 7 N. Empty where all is stated."""
    brought = [f"with the {' and the '.join(names)} {_half(better)}" for names, better in if_stated]
    return "; ".join([_half(ends), *brought]) if brought else ""


def _half(ends: Ends) -> str:
    lower, upper = ends
    if lower is None or upper is None:
        return "open upwards"
    return f"± {plus_minus(0.0, (upper - lower) / 2.0).partition('± ')[2] or 0} N"


#: What the shares of a variance are, for a person; a share that is not named here is shown by its key.
SHARES = {
    "frequency": "the frequency of this measurement",
    "reproducibility": "scatter from one measurement to the next",
    "calibration": "the coefficients of the calibration",
    "payload": "the moved mass",
    "temperature": "temperature, and a structure that lags behind it",
    "friction": "friction that is not the usual",
    "lubrication": "a friction that no window shows",
    "position": "where the table was",
    "between_session": "what another day changes",
}
#: A share below this is shown as none [-].
_NO_SHARE = 0.005


def shares_in_words(shares: Mapping[str, float]) -> list[tuple[str, float]]:
    """Return the shares of a variance in words, the largest first; those that are nothing are left out [-]."""
    ranked = sorted(shares.items(), key=lambda share: -share[1])
    return [(SHARES.get(name, name), share) for name, share in ranked if share > _NO_SHARE]


def refusal_document(rejection: Rejection) -> JsonObject:
    """Lay out a refusal."""
    return {"refused": True, "reason": str(rejection.reason), "detail": rejection.detail}


def measurement_document(row: "MeasurementRecord", outcome: MeasurementOutcome) -> JsonObject:
    """Lay out everything that is said about one measurement by itself; what could not be said is ``null``."""
    refusal = outcome.refusal
    document: JsonObject = {
        "measurement_id": row.id,
        "measurement": row.name,
        "started_at": text_of(row.started_at),
        "position_mm": row.position_mm,
        "frequency_hz": None,
        "preload_n": None,
        "interval_95_n": None,
        "calibration": row.calibration_id,
        "refused": False,
    }
    if isinstance(outcome.modal, ModalMeasurement):
        document |= modal_document(outcome.modal)
    if isinstance(outcome.preload, PreloadEstimate):
        document |= estimate_document(outcome.preload)
    elif outcome.preload is None:
        document["doubts"] = doubt_documents(outcome.doubts)
    if refusal is not None:
        document |= refusal_document(refusal)
    document |= friction_document(outcome.friction)
    return finite_or_null(document)


def friction_document(friction: Friction | Rejection) -> JsonObject:
    """Lay out the friction of a measurement; what its windows do not tell is left out."""
    if isinstance(friction, Rejection):
        return {}
    told = {"friction_torque": friction.torque}
    if isinstance(friction.drag, DragTorque):
        told["drag_torque"] = friction.drag.drag
    return {
        name: value
        for quantity, estimate in told.items()
        for name, value in (
            (f"{quantity}_nm", estimate.value),
            (f"{quantity}_standard_uncertainty_nm", estimate.standard_uncertainty),
        )
    }


def excess_variance(point: "TrendPoint | ShownPoint") -> float:
    """Return by how much an axis scatters more from session to session than its budget states, or less [s⁴]."""
    of_point = ((point.learnt_scatter_s2,), (point.shown_scatter_s2,), (point.feature_scatter_s2,))
    return float(np.nan_to_num(_excess_variances(*of_point)[0]))


def _excess_variances(
    learnt: Sequence[float | None], shown: Sequence[float | None], of_older: Sequence[float | None]
) -> FloatArray:
    """Return excess variances; NaN where nothing was learnt. What an older program judged is never narrowed."""
    scatter, budgeted = numbers_of(learnt), numbers_of(shown)
    older = np.maximum(excess_variance_of(scatter, numbers_of(of_older)), 0.0)
    return np.where(np.isnan(budgeted), older, excess_variance_of(scatter, budgeted))


def interval_of(point: "TrendPoint | ShownPoint") -> Ends:
    """Return the coverage interval of a preload with what its axis had learnt [N]; an open end is None."""
    return with_what_was_learnt((point.interval_lower_n, point.interval_upper_n), point)


def with_what_was_learnt(ends: Ends, point: "TrendPoint | ShownPoint") -> Ends:
    """Return an interval of a measurement with what its axis had learnt [N]."""
    lower, upper = ends
    if point.preload_n is None or point.feature_s2 is None or lower is None:
        return ends
    judged = Interval(lower, math.inf if upper is None else upper, IntervalKind.COVERAGE)
    return ends_in_newtons(widened(judged, point.preload_n, point.feature_s2, excess_variance(point)))


def ends_of(told: "ToldColumns") -> tuple[Sequence[float | None], Sequence[float | None]]:
    """Return the ends of all intervals, each as :func:`interval_of` has them."""
    excess = _excess_variances(told.learnt_scatter_s2, told.shown_scatter_s2, told.feature_scatter_s2)
    lower, preload, feature = (
        numbers_of(column) for column in (told.interval_lower_n, told.preload_n, told.feature_s2)
    )
    wider = np.flatnonzero((excess != 0.0) & ~np.isnan(excess + lower + preload + feature))
    if not wider.size:
        return told.interval_lower_n, told.interval_upper_n
    upper = numbers_of(told.interval_upper_n)
    closed = np.where(np.isnan(upper), np.inf, upper)
    lower[wider], upper[wider] = widened_ends(
        (lower[wider], closed[wider]), preload[wider], feature[wider], excess[wider]
    )
    return numbers(lower), numbers(upper)


def numbers_of(column: Sequence[float | None]) -> FloatArray:
    """Return a column as numbers; None is NaN."""
    return np.array(column, dtype=np.float64)


def falls_of(told: "ToldColumns") -> tuple[Sequence[float | None], ...]:
    """Return by how many percent each frequency lies below the expected, and both ends of the 95 % interval of that.

    None where nothing was expected: of a preload in newtons, or while the baseline was learnt.
    """
    if all(expected is None for expected in told.expected_frequency_hz):
        nothing = [None] * len(told.at_us)
        return nothing, nothing, nothing
    frequency, own, expected, of_expected = map(numbers_of, (
        told.frequency_hz, told.frequency_uncertainty_hz, told.expected_frequency_hz,
        told.expected_frequency_uncertainty_hz,
    ))  # fmt: skip
    fall = 100.0 * (1.0 - frequency / expected)
    half = 100.0 * REACH * np.hypot(own, of_expected) / expected
    return numbers(fall), numbers(fall - half), numbers(fall + half)


def charted(point: "TrendPoint") -> bool:
    """Tell whether a measurement moved the charts: not if it was refused, nor for the reason that it names."""
    return point.refusal_reason is None and point.uncharted is None


def response_document(outcome: MeasurementOutcome) -> JsonObject | None:
    """Lay out the frequency response around the mode, for a picture."""
    if isinstance(outcome.modal, Rejection):
        return None
    frf = outcome.modal.frequency_response
    return {
        "quantity": frf.quantity,
        "frequency_hz": numbers(frf.frequency),
        "real": numbers(frf.response.real),
        "imaginary": numbers(frf.response.imag),
        "coherence": None if frf.coherence is None else numbers(frf.coherence),
    }


def numbers(values: FloatArray) -> list[float | None]:
    """Return numbers as a list, null for one that is not finite."""
    finite = np.isfinite(values).tolist()
    return [value if is_finite else None for value, is_finite in zip(values.tolist(), finite, strict=True)]


#: Which share of 1/f² depends on the preload, by a drive model; None without one.
Share = Callable[[], Interval | None]
#: What a chart that raises alarms has found, for a sentence.
_CHART = {
    Chart.CUSUM: "the sum of what exceeds chance stands at {value:.1f} standard deviations, its limit is {limit:.1f}",
    Chart.SHEWHART: (
        "each session since then is more than {limit:.1f} standard deviations off, the latest {value:.1f}"
    ),
    Chart.SHIRYAEV_ROBERTS: (
        "all sessions together speak for a {change} that has lasted since then, the logarithm of the evidence is "
        "{value:.1f}, its limit {limit:.1f}"
    ),
}


def chart_in_english(alarm: Evidence, change: str) -> str:
    """Return what the chart that raised an alarm shows; ``change`` is what it is about, in a word."""
    return _CHART[alarm.chart].format(value=alarm.value, limit=alarm.limit, change=change)


def alarm_evidence(
    point: "TrendPoint", state: AxisState, calibration: Calibration | None, share: Share
) -> JsonObject:  # fmt: skip
    """Lay out why an alarm was raised: the measurement, the chart, and since when.

    ``share`` returns which share of 1/f² depends on the preload; it is asked for without a calibration alone.
    """
    alarm, baseline, difference = state.detector.alarm, state.detector.baseline, latest_difference(state.detector)
    if alarm is not None and alarm.level is not None:
        return _evidence_while_learning(point, state.detector, alarm, alarm.level, calibration=calibration, share=share)
    if alarm is None or baseline is None or difference is None:
        raise AssertionError("an alarm has evidence and a baseline behind it")
    if calibration is None:
        expected, uncertainty = point.expected_frequency_hz or math.nan, point.expected_frequency_uncertainty_hz or 0.0
        fall = fall_of(difference / baseline.mean, 2.0 * uncertainty / expected, share())
        size, lost_in_words = _in_percent(fall), fall_in_english(fall)
    else:
        size, lost_in_words = _in_newtons(point, baseline.mean, difference, alarm.change.value, calibration)
    learnt = {
        "baseline_started_at": text_of(baseline.started_at),
        # what was learnt before anybody could know is no reference for the change
        "baseline_ended_at": text_of(min(baseline.ended_at, alarm.onset - timedelta(microseconds=1))),
    }
    friction = "" if point.friction_torque_nm is None else "compare the friction torque; "
    return evidence_document(
        point,
        (str(alarm.chart), alarm.value, alarm.limit, alarm.onset),
        size | learnt,
        sentence=f"since {alarm.onset:%Y-%m-%d} {lost_in_words}: {chart_in_english(alarm, 'loss')}",
        check_next=f"measure again at another position; {friction}check nut and bearing mounting",
    )


def evidence_document(
    raised_by: "TrendPoint | ChartedReading",
    chart: tuple[str, float, float, datetime],
    size: Mapping[str, object],
    *,
    sentence: str,
    check_next: str,
) -> JsonObject:
    """Lay out what every alarm says of itself: the measurement, how much it is, chart, value, limit and onset."""
    name, value, limit, onset = chart
    document: JsonObject = finite_or_null({
        "at": text_of(raised_by.at),
        "measurement": raised_by.name,
        **dict.fromkeys(("preload_n", "baseline_preload_n", "preload_loss_n")),
        "interval": [None, None],
        "interval_kind": "95 % coverage",
        **size,
        "chart": name,
        "chart_value": value,
        "chart_limit": limit,
        "onset": text_of(onset),
        "sentence": sentence,
        "check_next": check_next,
    })  # fmt: skip
    return document


def _evidence_while_learning(
    point: "TrendPoint", state: DetectorState, alarm: Evidence, level: float, *,
    calibration: Calibration | None, share: Share,
) -> JsonObject:  # fmt: skip
    """Lay out why an axis is said to fall while its baseline is learnt: there is none to compare it with."""
    change = alarm.change
    reach = change.expanded_uncertainty
    if calibration is None:
        fall = fall_of(change.value / level, reach / REACH / level, share())
        size, words = _in_percent(fall), f"while the baseline is learnt {fall_in_english(fall)}"
    else:
        # the feature is the inverse cube root of the preload
        lower, lost, upper = (100.0 - 100.0 * (1.0 + (change.value + d) / level) ** -3 for d in (-reach, 0.0, reach))
        size = {
            "preload_n": point.preload_n,
            "interval": list(interval_of(point)),
            "loss_percent": lost,
            "loss_interval_95_percent": [lower, upper],
        }
        words = f"the preload falls while its baseline is learnt: {plus_minus(-lost, 0.5 * (upper - lower))} %"
    unstated = any(session.temperature is None for session in (*state.learning, state.session) if session is not None)
    doubt = "; temperature was not stated, so that a colder axis is not told from it" if unstated else ""
    return evidence_document(
        point,
        (str(alarm.chart), alarm.value, alarm.limit, alarm.onset),
        size,
        sentence=f"{words} from {alarm.onset:%Y-%m-%d} to {point.at:%Y-%m-%d}; the logarithm of the evidence is "
        f"{alarm.value:.1f}, its limit {alarm.limit:.1f}{doubt}",
        check_next="inspect nut, bearings and mounting; when the axis is in order clear the alarm, which begins the "
        "baseline anew; until then none is learnt",
    )


def _in_newtons(
    point: "TrendPoint", healthy_feature: float, difference: float, mean_difference: float, calibration: Calibration
) -> tuple[dict[str, object], str]:
    """Return the size of a loss by a calibration, and the words for it.

    One size, wherever it is told: that of the session, not of one of its places, and not a mean since the onset, which
    of a loss that grows is half of it.
    """
    healthy = preload_from_feature(healthy_feature, calibration.coefficients)
    lost, lost_since_onset = (
        healthy - preload_from_feature(healthy_feature + change, calibration.coefficients)
        for change in (difference, mean_difference)
    )
    return {
        "preload_n": point.preload_n,
        "interval": list(interval_of(point)),
        "baseline_preload_n": healthy,
        "preload_loss_n": lost,
        "mean_loss_since_onset_n": lost_since_onset,
    }, f"preload is being lost, and is now {lost:.0f} N below the baseline's {healthy:.0f} N"


def _in_percent(fall: FrequencyFall) -> dict[str, object]:
    return {
        "frequency_fall_percent": fall.percent,
        "frequency_fall_interval_95_percent": list(fall.interval_95_percent),
        "preload_lost_if_preload_percent": list(fall.lost_percent),
        "share_by_model": fall.share_by_model,
    }


@dataclass(frozen=True, slots=True)
class Loss:
    """Share of the preload that is lost from an onset until a moment, with half of its 95 % interval [%]."""

    percent: float
    half_width: float
    until: datetime


class ChangedNumber(BaseModel):
    """What one of several numbers has to do with an alarm of all."""

    model_config = ConfigDict(frozen=True)

    number: str
    change_percent: float = Field(description="since the onset")
    interval_95_percent: tuple[float, float]
    interval_kind: Literal["confidence"] = "confidence"
    share: float = Field(description="of the evidence, 0 to 1")


@dataclass(frozen=True, slots=True)
class AlarmEvidence:
    """What is read again of the evidence of an alarm."""

    at: datetime
    onset: datetime
    preload_n: float | None
    interval: tuple[float | None, float | None]
    preload_loss_n: float | None
    baseline_preload_n: float | None
    baseline_started_at: datetime | None = None  # older versions did not say when the baseline was learnt
    baseline_ended_at: datetime | None = None
    loss_percent: float | None = None  # of what falls while its baseline is learnt
    loss_interval_95_percent: tuple[float, float] | None = None
    frequency_fall_percent: float | None = None  # without a calibration, as what follows
    frequency_fall_interval_95_percent: tuple[float, float] | None = None
    preload_lost_if_preload_percent: tuple[float, float] | None = None
    share_by_model: bool = False
    chart: str | None = None
    numbers: tuple[ChangedNumber, ...] = ()  # of an alarm of several numbers together, by share
    lost_motion_um: float | None = None  # of an alarm of lost motion, as what follows
    lost_motion_interval_95_um: tuple[float, float] | None = None
    lost_motion_baseline_um: float | None = None  # None: it grew while its baseline was learnt

    @property
    def while_learning(self) -> bool:
        """Whether the axis fell while its baseline was learnt, so that there is none to compare with."""
        return self.chart == Chart.TREND

    @property
    def loss(self) -> Loss | None:
        """What is lost of a preload that falls while its baseline is learnt; None: below one, or only a frequency."""
        if self.loss_percent is None or self.loss_interval_95_percent is None:
            return None
        lower, upper = self.loss_interval_95_percent
        return Loss(self.loss_percent, 0.5 * (upper - lower), self.at)

    @property
    def fall(self) -> FrequencyFall | None:
        """By how much the frequency fell; None of an alarm in newtons."""
        if self.frequency_fall_percent is None or self.frequency_fall_interval_95_percent is None:
            return None
        lower, upper = self.frequency_fall_interval_95_percent
        lost = self.preload_lost_if_preload_percent or (0.0, 100.0)
        return FrequencyFall(self.frequency_fall_percent, 0.5 * (upper - lower), lost, self.share_by_model)


_EVIDENCE = TypeAdapter(AlarmEvidence)


def read_evidence(document: JsonObject) -> AlarmEvidence:
    """Return the stored evidence of an alarm."""
    return _EVIDENCE.validate_python(document)
