"""Say what the numbers of an axis that are watched together show."""

import math
from dataclasses import replace
from datetime import datetime, timedelta
from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict, Field

from monitor_core.trend import JOINT_SHARE, DetectorDesign, JointEvidence, JointState, NumberChange, joint_limit
from monitor_core.uncertainty import plus_minus
from service.clock import text_of
from service.documents.measurement import ChangedNumber, evidence_document, interval_of
from service.json_types import JsonObject

if TYPE_CHECKING:
    from service.store.trend.points import TrendPoint

#: What the numbers are called in sentences.
_CALLED = {
    "frequency": "natural frequency", "friction-torque": "friction torque", "damping-ratio": "damping ratio",
    "residue": "residue",
}  # fmt: skip

#: Whether they go as a loss moves them; older versions did not keep it.
_AS_LOSS = {True: " as when preload is lost", False: ", though not as when preload is lost", None: ""}


class TogetherAlarm(BaseModel):
    """The alarm of the numbers together that stands."""

    model_config = ConfigDict(frozen=True)

    raised_at: datetime
    onset: datetime
    log_evidence: float
    limit: float
    numbers: tuple[ChangedNumber, ...]


class TogetherView(BaseModel):
    """The numbers of an axis that are watched together, and what they show."""

    model_config = ConfigDict(frozen=True)

    numbers: tuple[str, ...] = Field(description="that are watched together; none while the baseline is learnt")
    missing: tuple[str, ...] = Field(description="numbers that the latest session lacks")
    log_evidence: float | None = Field(
        description="logarithm of the evidence of a change that lasts; null: too little to say"
    )
    limit: float
    false_alarms_per_year: float = Field(description="that may come on top of those stated for the axis")
    alarm: TogetherAlarm | None
    sentence: str


def together_view(state: JointState, design: DetectorDesign) -> TogetherView:
    """Say what the numbers of an axis that are watched together show."""
    learnt, alarm, limit = state.learnt if state.watching else None, state.alarm, joint_limit(state, design)
    rate = JOINT_SHARE * design.settings.false_alarms_per_year
    return TogetherView(
        numbers=() if learnt is None else learnt.names,
        missing=state.missing,
        log_evidence=state.chart.log_evidence,
        limit=limit,
        false_alarms_per_year=rate,
        alarm=None if alarm is None else _alarm(alarm),
        sentence=_sentence(state, limit),
    )


def _sentence(state: JointState, limit: float) -> str:
    if not state.watching or state.learnt is None:
        return "not watched yet: a baseline with two numbers or more in nearly every session is needed"
    if (since := state.uncompared_since) is None:
        return _shown(state, limit)
    return (
        f"not looked at since {since:%Y-%m-%d}, for too much is open of what place and payload do to numbers there; "
        f"until then: {_shown(replace(state, missing=()), limit)}"
    )


def _shown(state: JointState, limit: float) -> str:
    if state.alarm is not None:
        return said_of(state.alarm)
    watched, evidence = _listed(() if state.learnt is None else state.learnt.names), state.chart.log_evidence
    lacks = f"; the latest session lacks {_listed(state.missing)}, and is judged by the rest" if state.missing else ""
    if evidence is None:
        return f"{watched} are watched together; one more session is needed before they say anything{lacks}"
    return (
        f"{watched} show no change that lasts: the logarithm of the evidence is {evidence:.1f}, its limit "
        f"{limit:.1f}{lacks}"
    )


def said_of(alarm: JointEvidence) -> str:
    """Say in one sentence what an alarm of several numbers is about, and which share each has."""
    parts = []
    for change in alarm.changes:
        number = _changed(change)
        half = 0.5 * (number.interval_95_percent[1] - number.interval_95_percent[0])
        sign = "+" if number.change_percent > 0.0 else ""
        parts.append(
            f"{_CALLED[change.name]} by {sign}{plus_minus(number.change_percent, half)} % "
            f"({100.0 * change.share:.0f} % of the evidence)"
        )
    return (
        f"since {alarm.onset:%Y-%m-%d} several numbers together have changed{_AS_LOSS[alarm.as_loss]}: "
        f"{', '.join(parts)}; the logarithm of the evidence is {alarm.log_evidence:.1f}, its limit {alarm.limit:.1f}"
    )


def together_evidence(point: "TrendPoint", state: JointState) -> JsonObject:
    """Lay out why several numbers together raised an alarm: each with its change and its share, and since when."""
    alarm, learnt = state.alarm, state.learnt
    if alarm is None or learnt is None:
        raise AssertionError("an alarm has evidence and a baseline behind it")
    size = {
        "preload_n": point.preload_n,
        "interval": list(interval_of(point)),
        "baseline_preload_n": point.baseline_preload_n,
        "baseline_started_at": text_of(learnt.started_at),
        "baseline_ended_at": text_of(alarm.onset - timedelta(microseconds=1)),
        "numbers": [_changed(change).model_dump() for change in alarm.changes],
    }
    return evidence_document(
        point,
        ("several-numbers", alarm.log_evidence, alarm.limit, alarm.onset),
        size,
        sentence=said_of(alarm),
        check_next="measure again at another position; check nut preload, lubrication and mounting",
    )


def _listed(names: tuple[str, ...]) -> str:
    called = [_CALLED[name] for name in names]
    return called[0] if len(called) == 1 else f"{', '.join(called[:-1])} and {called[-1]}"


def _alarm(alarm: JointEvidence) -> TogetherAlarm:
    return TogetherAlarm(
        raised_at=alarm.raised_at,
        onset=alarm.onset,
        log_evidence=alarm.log_evidence,
        limit=alarm.limit,
        numbers=tuple(map(_changed, alarm.changes)),
    )


def _changed(change: NumberChange) -> ChangedNumber:
    """Return a change of a logarithm in percent."""
    size = change.change
    reach = size.expanded_uncertainty
    lower, value, upper = (100.0 * math.expm1(size.value + side) for side in (-reach, 0.0, reach))
    return ChangedNumber(
        number=change.name, change_percent=value, interval_95_percent=(lower, upper), share=change.share
    )
