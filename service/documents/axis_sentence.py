"""Say of an axis in one sentence how it stands, and in another what to do next.

Texts are English with named places for values; a page puts them into its own language, numbers and days included.
"""

from dataclasses import dataclass
from datetime import datetime

from service.documents.frequency_fall import FrequencyFall, fall_sentence
from service.documents.history import AlertView, LineView
from service.documents.measurement import AlarmEvidence, Loss
from service.documents.said import N_, PlusMinus, Said, Sentence, Value


@dataclass(frozen=True, slots=True)
class Cleared:
    """The newest clearing of an alarm: when, by whom if that is known, and why."""

    at: datetime
    who: str | None
    comment: str


@dataclass(frozen=True, slots=True)
class OpenAlarm:
    """An alarm that stands: since when preload is being lost, and who has seen it."""

    onset: datetime
    baseline: float | None  # [N]; None without a calibration
    owner: str | None
    acknowledged_at: datetime | None
    other_cause: str | None = None  # what was examined says that it is not the preload
    loss: Loss | None = None  # of a preload that falls while its baseline is learnt
    fall: FrequencyFall | None = None  # of the frequency when it was raised, without a calibration
    while_learning: bool = False  # there is no baseline, and none is learnt until it is cleared


@dataclass(frozen=True, slots=True)
class AxisFacts:
    """What is known of an axis at this moment."""

    state: str  # of the charts: silence is not seen in it
    is_silent: bool
    heard_at: datetime | None  # last measurement that moved the charts
    silent_after_hours: float
    in_force: int | None  # number of the calibration
    stored: int | None  # newest calibration, in force or not
    judged_anew_by: int | None  # calibration that is put in force when what was measured is judged by it
    last_at: datetime | None  # last measurement that was judged
    last_refused: str | None  # why, if it was
    preload: float | None  # of the last measurement [N]
    baseline: float | None  # [N]
    has_friction: bool  # the last measurement tells the friction torque
    cleared: Cleared | None = None  # since then nothing was measured
    alert: AlertView | None = None
    alarm: OpenAlarm | None = None
    lost_motion_grows: Said | None = None  # how much it is, while its alarm stands
    changed_since: datetime | None = None  # several numbers together; None: they show no change
    fall: FrequencyFall | None = None  # of the last measurement, without a calibration
    present: LineView | None = None  # line since the last change; None: too few sessions since


@dataclass(frozen=True, slots=True)
class Standing:
    """How an axis stands, and what to do next."""

    sentence: Said
    next_step: Said


_MEASURE = Said("Measure the axis: windows of motor torque and nut acceleration, at a position of the calibration.")
_MEASURE_FIRST = Said(
    N_("Measure the axis: from the first measurement on its frequency is watched, and a calibration adds newtons.")
)
_GO_ON = Said("Nothing is to be done. Go on measuring.")
_CALIBRATE = N_("Go on measuring. A calibration, of three positions and one known preload or more, would add newtons.")


def standing(facts: AxisFacts) -> Standing:
    """Return how an axis stands, and what to do next."""
    if facts.alarm is not None:
        return _alarmed(facts, facts.alarm)
    if facts.lost_motion_grows is not None:
        return _loses_motion(facts.lost_motion_grows)
    is_calm = not facts.is_silent and facts.state != "alert" and facts.changed_since is None
    return _judged_anew(facts.judged_anew_by) if facts.judged_anew_by is not None and is_calm else _without_alarm(facts)


def _without_alarm(facts: AxisFacts) -> Standing:
    if facts.is_silent or facts.state == "unknown":
        return _unknown(facts)
    if facts.state == "learning":
        text = N_("The baseline is being learnt. Until then only a preload that falls all the while raises an alarm.")
        if facts.in_force is None:
            text = N_(
                "The baseline is being learnt. Until then only a natural frequency that falls all the while raises an "
                "alarm."
            )
        return Standing(Said(text), Said("Measure on as usual, on different days, until the baseline is learnt."))
    if facts.changed_since is not None or facts.state == "alert":
        if facts.changed_since is None:
            return _alerted(facts.alert)
        return _changed_together(facts.changed_since, alone=facts.state == "alert")
    if facts.in_force is None:
        text = N_("No loss is seen: the natural frequency is as it was learnt, at the same place.")
        return Standing(Said(text), _to_newtons(facts))
    return Standing(Said("No loss of preload is seen."), _GO_ON)


def _judged_anew(calibration: int) -> Standing:
    text = N_(
        "What was measured is being judged anew, by calibration %(number)s; until that is done all stands as before."
    )
    step = N_("Nothing is to be done: what is said here changes by itself.")
    return Standing(Said(text, {"number": str(calibration)}), Said(step))


def _to_newtons(facts: AxisFacts) -> Said:
    """Say what a calibration would add to an axis without one."""
    if facts.stored is None:
        return Said(_CALIBRATE)
    text = N_("Look at calibration %(number)s and activate it: what was measured is judged anew, in newtons.")
    return Said(text, {"number": str(facts.stored)})


def _unknown(facts: AxisFacts) -> Standing:
    if facts.last_at is None:
        step = _MEASURE_FIRST if facts.in_force is None else _MEASURE
        return Standing(Said("Nothing was measured yet, so nothing is known about the preload."), step)
    if facts.cleared is not None:
        return _cleared(facts.cleared)
    if facts.is_silent and facts.heard_at is not None:
        return _silent(facts, facts.heard_at)
    return _uncalibrated(facts) if facts.in_force is None else _unheard(facts)


def _uncalibrated(facts: AxisFacts) -> Standing:
    """Nothing that was measured says how a healthy axis of its own preload is: refused, or with the preload set."""
    if facts.stored is not None:
        text = N_("Nothing can be said about the preload: calibration %(number)s is stored, and none is in force.")
        return Standing(Said(text, {"number": str(facts.stored)}), _to_newtons(facts))
    if facts.last_refused is not None:
        text = N_("Nothing is known about the preload: no measurement was accepted yet.")
        return Standing(Said(text), Said("See below why measurements are refused, and measure again."))
    text = N_("Nothing can be said about the preload yet: all that was measured had its preload set on purpose.")
    step = N_("Calibrate the axis with it, or measure as it is: then its frequency is watched.")
    return Standing(Said(text), Said(step))


def _alarmed(facts: AxisFacts, alarm: OpenAlarm) -> Standing:
    sentence = _what_is_lost(facts, alarm)
    if alarm.while_learning:
        step = N_(
            "Inspect nut, bearings and mounting. When the axis is in order, clear the alarm: a new baseline is learnt "
            "from then on."
        )
        return Standing(sentence, Said(step))
    if facts.is_silent and facts.heard_at is not None:
        step = N_(
            "Nothing was accepted since %(day)s: see that the axis is measured, then check nut preload and lubrication."
        )
        return Standing(sentence, Said(step, {"day": facts.heard_at}))
    if facts.has_friction:
        step = N_("Measure at another position, compare the friction torque, check nut preload and lubrication.")
    else:
        step = N_("Measure at another position, check nut preload and lubrication.")
    return Standing(sentence, Said(step))


def _loses_motion(grows: Said) -> Standing:
    step = N_("Measure it again, slowly and at the same place; check nut, screw, bearings and mounting for play.")
    return Standing(grows, Said(step))


def _what_is_lost(facts: AxisFacts, alarm: OpenAlarm) -> Said:
    if alarm.loss is not None:
        return falls_while_learning(alarm.onset, alarm.loss)
    values: dict[str, Value] = {"day": alarm.onset}
    if alarm.other_cause is not None:
        text = N_("Since %(day)s the frequency is lower, as when preload is lost. What was measured says: %(cause)s.")
        return Said(text, values | {"cause": Sentence(alarm.other_cause)})
    fall = facts.fall if facts.fall is not None and facts.fall.is_evident else alarm.fall
    if fall is not None:
        return fall_sentence(fall, alarm.onset)
    baseline = facts.baseline or alarm.baseline
    if baseline is not None and facts.preload is not None:
        lost = round(baseline) - round(facts.preload)  # of what is shown beside it
        if lost > 0:
            return _how_fast(values | {"lost": lost}, facts.present, is_silent=facts.is_silent)
    text = N_("Preload is lower than the baseline since %(day)s.")
    if facts.in_force is None:
        text = N_("The natural frequency is lower than the baseline since %(day)s.")
    return Said(text, values)


def _how_fast(values: dict[str, Value], present: LineView | None, *, is_silent: bool) -> Said:
    """Say what was lost, and whether it goes on: a step is no rate, and what is not evident is none."""
    change = None if present is None else present.change_a_day
    if present is None or change is None:
        text = N_(
            "%(lost)s N of preload were lost since %(day)s; whether it goes on is known after ten sessions, of a week "
            "or more."
        )
        return Said(text, values)
    loss, half = -change[0], change[1]
    text = N_("%(lost)s N of preload were lost since %(day)s; now it loses %(rate)s N a day.")
    if is_silent:
        text = N_("%(lost)s N of preload were lost since %(day)s; until %(until)s it lost %(rate)s N a day.")
    if loss <= half:
        text = N_("%(lost)s N of preload were lost since %(day)s; that it goes on is not evident: %(rate)s N a day.")
    return Said(text, values | {"rate": PlusMinus(loss, half), "until": present.ended_at})


def falls_while_learning(onset: datetime, loss: Loss) -> Said:
    """Return what is said of an axis whose preload falls while there is no baseline yet."""
    text = N_(
        "The preload falls while its baseline is being learnt: −%(lost)s %% from %(day)s to %(until)s. "
        "Nothing of that is learnt as healthy."
    )
    return Said(text, {"lost": PlusMinus(loss.percent, loss.half_width), "day": onset, "until": loss.until})


def alarm_sentence(evidence: AlarmEvidence, axis: str) -> Said:
    """Return what happened when an alarm was raised: by how much its session lay below the baseline."""
    if evidence.fall is not None:
        return fall_sentence(evidence.fall, evidence.onset)
    if evidence.loss is not None:
        return falls_while_learning(evidence.onset, evidence.loss)
    baseline, lost = evidence.baseline_preload_n, evidence.preload_loss_n
    values: dict[str, Value] = {"axis": axis, "onset": evidence.onset, "day": evidence.at}
    if evidence.numbers:
        text = N_(
            "On %(day)s several numbers of %(axis)s together had changed as those of a healthy axis do not, since "
            "about %(onset)s; the preload alone did not show it."
        )
        return Said(text, values)
    if baseline is None or lost is None:
        return Said("The preload of %(axis)s fell below its baseline since %(onset)s; the alarm is of %(day)s.", values)
    values |= {"lost": round(lost), "baseline": round(baseline)}
    text = N_(
        "On %(day)s %(axis)s had lost %(lost)s N of its baseline of %(baseline)s N; the loss began about %(onset)s."
    )
    return Said(text, values)


def _changed_together(since: datetime, *, alone: bool) -> Standing:
    """Say that several numbers have changed; ``alone``: the preload is off by itself, too."""
    text = N_(
        "Several numbers together have changed since %(day)s as those of a healthy axis do not; the preload alone does "
        "not show it."
    )
    if alone:
        text = N_(
            "Several numbers together have changed since %(day)s as those of a healthy axis do not; the preload alone "
            "is off its baseline, too, not enough for an alarm."
        )
    step = N_("Measure at another position, check nut preload, lubrication and mounting.")
    return Standing(Said(text, {"day": since}), Said(step))


def _cleared(cleared: Cleared) -> Standing:
    values: dict[str, Value] = {"day": cleared.at, "comment": cleared.comment}
    text = N_("The alarm was cleared on %(day)s: “%(comment)s”. Nothing was accepted since.")
    if cleared.who is not None:
        text = N_("%(who)s cleared the alarm on %(day)s: “%(comment)s”. Nothing was accepted since.")
        values["who"] = cleared.who
    return Standing(Said(text, values), Said("Measure on: what is measured from now on is learnt as the new normal."))


def _silent(facts: AxisFacts, heard_at: datetime) -> Standing:
    values: dict[str, Value] = {"day": heard_at, "hours": round(facts.silent_after_hours)}
    if facts.last_refused is not None:
        text = N_("Nothing is known about the preload now: nothing was accepted since %(day)s, the last was refused.")
        return Standing(Said(text, values), Said("See below why measurements are refused, and measure again."))
    text = N_("Nothing is known about the preload now: the last measurement is of %(day)s, more than %(hours)s h ago.")
    step = N_("See that the axis is measured: does the machine send windows, is the sensor connected?")
    return Standing(Said(text, values), Said(step))


def _unheard(facts: AxisFacts) -> Standing:
    if facts.last_refused is not None:
        text = N_("Nothing is known about the preload: no measurement was accepted under calibration %(number)s yet.")
        step = Said("See below why measurements are refused, and measure again.")
        return Standing(Said(text, {"number": str(facts.in_force)}), step)
    text = N_("Calibration %(number)s is in force. Nothing was measured with it yet.")
    return Standing(Said(text, {"number": str(facts.in_force)}), _MEASURE)


def _alerted(alert: AlertView | None) -> Standing:
    again = Said("Measure again, at another position too.")
    if alert is None:
        return Standing(Said("The last measurements are off the baseline by more than chance explains well."), again)
    if alert.mean_change_percent is not None:
        return _alerted_in_percent(alert, alert.mean_change_percent, again)
    values: dict[str, Value] = {"day": alert.since, "change": round(abs(alert.mean_change_n or 0.0))}
    if alert.direction == "rise":
        text = N_("Since %(day)s the preload is %(change)s N above the baseline on average. That is no loss.")
        step = N_(
            "Nothing tightens by itself: are payload, temperature and position as stated, was the machine worked on?"
        )
        return Standing(Said(text, values), Said(step))
    text = N_("Since %(day)s the preload is %(change)s N below the baseline on average, not enough for an alarm.")
    return Standing(Said(text, values), again)


def _alerted_in_percent(alert: AlertView, change: float, again: Said) -> Standing:
    values: dict[str, Value] = {"day": alert.since, "change": abs(change)}
    if alert.direction == "rise":
        text = N_(
            "Since %(day)s the natural frequency is %(change)s %% above the baseline on average. That is no loss."
        )
        step = N_("Are payload, temperature and position as stated, was the machine worked on?")
        return Standing(Said(text, values), Said(step))
    text = N_(
        "Since %(day)s the natural frequency is %(change)s %% below the baseline on average, not enough for an alarm."
    )
    return Standing(Said(text, values), again)
