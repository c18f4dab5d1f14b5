"""Say how the lost motion of an axis stands, and on what its alarms rest."""

from dataclasses import dataclass
from datetime import datetime

from monitor_core.trend import DetectorState, Evidence, latest_difference
from service.documents.measurement import AlarmEvidence, chart_in_english, evidence_document
from service.documents.said import N_, Said, Value
from service.json_types import JsonObject
from service.store.trend.lost_motion import LOST_MOTION, SIGNS, ChartedReading

_CHECK_NEXT = "measure again, slowly and at the same place; check nut, screw, bearings and their mounting for play"


def lost_motion_evidence(reading: ChartedReading, state: DetectorState) -> JsonObject:
    """Lay out why an alarm of lost motion was raised: how much it is, the chart, and since when."""
    alarm, baseline, session = state.alarm, state.baseline, state.session
    if alarm is None or session is None:
        raise AssertionError("an alarm has evidence, and a session that raised it")
    rise, reach = alarm.change.value, alarm.change.expanded_uncertainty
    difference = latest_difference(state)
    now = f"is {session.value:.3g} µm on {reading.at:%Y-%m-%d}"
    if baseline is None or difference is None:
        words = (
            f"since {alarm.onset:%Y-%m-%d} lost motion has grown while its baseline was learnt, by "
            f"{rise:.2g} µm, and {now}; the logarithm of the evidence is {alarm.value:.1f}, its limit "
            f"{alarm.limit:.1f}"
        )
    else:
        words = (
            f"since {alarm.onset:%Y-%m-%d} lost motion has grown and {now}, {difference:.2g} µm above the baseline's "
            f"{baseline.mean:.3g} µm: {chart_in_english(alarm, 'growth')}"
        )
    size = {
        "lost_motion_um": session.value,
        "lost_motion_interval_95_um": list(reading.interval_95),
        "lost_motion_baseline_um": None if baseline is None else baseline.mean,
        "lost_motion_rise_um": difference,
        "mean_rise_since_onset_um": rise,
        "mean_rise_interval_95_um": [rise - reach, rise + reach],
    }
    chart = (str(alarm.chart), alarm.value, alarm.limit, alarm.onset)
    return evidence_document(reading, chart, size, sentence=words, check_next=_CHECK_NEXT)


@dataclass(frozen=True, slots=True)
class LostMotionNow:
    """The newest lost motion of an axis, and the state of its chart as it counts now."""

    measured_at: datetime
    reversal_value_um: float
    reversal_value_interval_95_um: tuple[float, float]
    state: str
    #: Without a further reading the state is unknown from then on; None: it is already, or an alarm, which silence
    #: does not end.
    valid_until: datetime | None


@dataclass(frozen=True, slots=True)
class ReadingStanding:
    """How lost motion or a quantity of the torque stands at a moment. *Not looked at* is ``unknown``."""

    quantity: str
    state: str
    since: datetime | None
    newest: ChartedReading | None  # of those that are compared
    baseline: float | None
    baseline_interval_95: tuple[float, float] | None  # of one more healthy session
    n_sessions: int  # that the baseline is learnt from so far
    baseline_size: int  # sessions that it takes
    false_alarms_per_year: float  # as stated, beside those of the preload
    place_mm: float | None  # where it is watched
    speed_mm_per_s: float | None  # at which torque is
    alarm: Evidence | None = None
    alert: Evidence | None = None

    @property
    def sentence(self) -> Said:
        """How it stands, in words."""
        if self.newest is None and self.quantity != LOST_MOTION:
            return Said("It was not measured: nothing is known of it.")
        if self.newest is None:
            return Said("Lost motion was not measured: nothing is known of it.")
        return self._of_lost_motion(self.newest) if self.quantity == LOST_MOTION else self._of_torque(self.newest)

    def _of_lost_motion(self, newest: ChartedReading) -> Said:
        values: dict[str, Value] = {"value": newest.value, "day": newest.at}
        if self.baseline is not None:
            values["baseline"] = self.baseline
        if self.alarm is not None and self.state == "alarm":
            text = N_(
                "Lost motion grows while its baseline is being learnt, since %(day)s: it is %(value)s µm now. Nothing "
                "of that is learnt as healthy."
            )
            if self.baseline is not None:
                text = N_(
                    "Lost motion has grown since %(day)s: it is %(value)s µm now, the baseline is %(baseline)s µm."
                )
            return Said(text, values | {"day": self.alarm.onset})
        if self.state == "unknown":
            text = N_("Nothing is known of lost motion now: it was last measured on %(day)s, %(value)s µm.")
            return Said(text, values)
        if self.state == "learning":
            text = N_(
                "Lost motion is %(value)s µm. Its baseline is being learnt, %(n)s of %(size)s sessions; until then "
                "only one that grows all the while raises an alarm."
            )
            return Said(text, values | {"n": self.n_sessions, "size": self.baseline_size})
        if self.state == "alert" and self.alert is not None:
            text = N_("Since %(day)s lost motion is %(change)s µm below its baseline on average. That is no play.")
            if self.alert.change.value > 0.0:
                text = N_(
                    "Since %(day)s lost motion is %(change)s µm above its baseline on average, not enough for an alarm."
                )
            return Said(text, {"day": self.alert.onset, "change": abs(self.alert.change.value)})
        text = N_("Lost motion is as it was learnt: %(value)s µm, the baseline is %(baseline)s µm.")
        return Said(text, values)

    def _of_torque(self, newest: ChartedReading) -> Said:
        values: dict[str, Value] = {"value": newest.value, "unit": newest.unit, "day": newest.at}
        if self.baseline is not None:
            values["baseline"] = self.baseline
        if self.state == "learning":
            text = N_("%(value)s %(unit)s. The baseline is being learnt, %(n)s of %(size)s sessions.")
            return Said(text, values | {"n": self.n_sessions, "size": self.baseline_size})
        if self.alarm is not None and self.state == "alarm":
            rises = SIGNS[self.quantity] > 0.0
            text = N_("It falls while its baseline is being learnt, since %(day)s: it is %(value)s %(unit)s now.")
            if rises:
                text = N_("It rises while its baseline is being learnt, since %(day)s: it is %(value)s %(unit)s now.")
            if self.baseline is not None:
                text = N_(
                    "It has fallen since %(day)s: it is %(value)s %(unit)s now, the baseline is %(baseline)s %(unit)s."
                )
            if self.baseline is not None and rises:
                text = N_(
                    "It has risen since %(day)s: it is %(value)s %(unit)s now, the baseline is %(baseline)s %(unit)s."
                )
            return Said(text, values | {"day": self.alarm.onset})
        if self.alert is not None and self.state == "alert":
            change = SIGNS[self.quantity] * self.alert.change.value
            text = N_("Since %(day)s it is %(change)s %(unit)s below its baseline on average.")
            if change > 0.0:
                text = N_("Since %(day)s it is %(change)s %(unit)s above its baseline on average.")
            return Said(text, {"day": self.alert.onset, "change": abs(change), "unit": newest.unit})
        if self.state == "unknown":
            text = N_("Nothing is known of it now: it was last measured on %(day)s, %(value)s %(unit)s.")
            return Said(text, values)
        text = N_("It is as it was learnt: %(value)s %(unit)s, the baseline is %(baseline)s %(unit)s.")
        return Said(text, values)


def lost_motion_alarm_sentence(evidence: AlarmEvidence, axis: str) -> Said:
    """Return what happened when an alarm of lost motion was raised."""
    values: dict[str, Value] = {
        "axis": axis, "day": evidence.at, "onset": evidence.onset, "value": evidence.lost_motion_um or 0.0
    }  # fmt: skip
    if evidence.lost_motion_baseline_um is None:
        text = N_(
            "On %(day)s %(axis)s lost %(value)s µm of motion at reversals; it has grown since %(onset)s, while its "
            "baseline was being learnt."
        )
        return Said(text, values)
    text = N_(
        "On %(day)s %(axis)s lost %(value)s µm of motion at reversals, its baseline is %(baseline)s µm; it has grown "
        "since about %(onset)s."
    )
    return Said(text, values | {"baseline": evidence.lost_motion_baseline_um})
