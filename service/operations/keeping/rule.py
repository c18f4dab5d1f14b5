"""The rule by which raw waveforms are kept: so many days, and longer where there is a reason to."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import StrEnum

from sqlalchemy import Connection

from service.documents.measurement import read_evidence
from service.settings import Settings
from service.store import retention
from service.store.retention import StoredWindow
from service.store.trend.points import Span


class Why(StrEnum):
    """Why a window is kept."""

    FOR_EVER = "for-ever"  # there is no rule
    YOUNG = "young"
    OPEN = "open"  # its measurement may still be judged
    PIN = "pin"
    CALIBRATION = "calibration"  # its preload was set on purpose
    ALARM = "alarm"


_INCLUSIVE = timedelta(microseconds=1)


@dataclass(frozen=True, slots=True)
class Rule:
    """How long raw waveforms are kept; what is found in them is kept for ever."""

    keep_raw_days: int | None  # None: for ever
    before_alarm: timedelta
    after_alarm: timedelta

    def lets_go_before(self, at: datetime) -> datetime | None:
        """Return the moment before which a window must have arrived to be let go: days are let go as a whole, UTC.

        None: nothing is let go.
        """
        if self.keep_raw_days is None:
            return None
        today = at.astimezone(UTC).replace(hour=0, minute=0, second=0, microsecond=0)
        return today - timedelta(days=self.keep_raw_days)


def rule_of(settings: Settings) -> Rule:
    """Return the rule that is set."""
    return Rule(
        settings.keep_raw_days,
        timedelta(days=settings.keep_before_alarm_days),
        timedelta(days=settings.keep_after_alarm_days),
    )


@dataclass(frozen=True, slots=True)
class Holds:
    """What of an axis is kept whatever its age."""

    pinned: frozenset[int]  # measurements
    pinned_spans: Sequence[Span]
    alarm_spans: Sequence[Span]

    def why(self, window: StoredWindow) -> Why | None:
        """Return why a window is kept that is old enough to be let go; None: it is let go."""
        if window.is_open:
            return Why.OPEN
        if window.measurement_id in self.pinned or _within(window.measured_at, self.pinned_spans):
            return Why.PIN
        if window.preload_was_set:
            return Why.CALIBRATION
        return Why.ALARM if _within(window.measured_at, self.alarm_spans) else None


def holds_of(connection: Connection, axis_id: str, rule: Rule) -> Holds:
    """Return what of an axis is kept whatever its age: what is pinned, and what lies around its alarms."""
    pins = retention.pins_of(connection, axis_id)
    alarms = [
        Span(read_evidence(evidence).onset - rule.before_alarm, measured_at + rule.after_alarm + _INCLUSIVE)
        for measured_at, evidence in retention.alarms_of(connection, axis_id)
    ]
    return Holds(
        frozenset(number for number, _, _ in pins if number is not None),
        [Span(start, end) for number, start, end in pins if number is None],
        alarms,
    )


def _within(moment: datetime, spans: Sequence[Span]) -> bool:
    return any(
        (span.start is None or span.start <= moment) and (span.end is None or moment < span.end) for span in spans
    )
