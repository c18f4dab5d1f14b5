"""Decide which raw waveforms are kept, pin some of them, and survey what is stored."""

import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from itertools import pairwise

from sqlalchemy import Connection

from service.clock import now
from service.documents.measurement import read_evidence
from service.settings import Settings
from service.store import measurements, retention
from service.store.axes import get_axis
from service.store.database import Database
from service.store.lookup import existing_of
from service.store.retention import StoredWindow, settled_with
from service.store.tables import PinRow, PurgeRow
from service.store.trend.points import Span
from service.store.waveforms import WaveformStore, folder_of_day


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
        if window.measurement_id in self.pinned or any(span.holds(window.measured_at) for span in self.pinned_spans):
            return Why.PIN
        if window.preload_was_set:
            return Why.CALIBRATION
        return Why.ALARM if any(span.holds(window.measured_at) for span in self.alarm_spans) else None


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


@dataclass(frozen=True, slots=True)
class Reason:
    """Why something is pinned, and by whom."""

    reason: str
    who: str


def pin(database: Database, axis_id: str, what: int | Span, why: Reason) -> PinRow:
    """Keep the waveforms of a measurement, by its number, or of all that began in a span, those to come included.

    A measurement that is pinned already is kept for the new reason. Raises LetGoError if its waveforms were let go.
    """
    with database.write() as session, settled_with(session.connection()):
        row = None
        if isinstance(what, Span):
            get_axis(session, axis_id)
            start, end, measurement_id = what.start, what.end, None
        else:
            measurements.get_measurement(session, axis_id, what)
            retention.require_stored(session.connection(), [what])
            row, start, end, measurement_id = retention.pin_of_measurement(session, what), None, None, what
        if row is None:
            row = PinRow(axis_id=axis_id, measurement_id=measurement_id, start_at=start, end_at=end)
        row.reason, row.who, row.at = why.reason, why.who, now()
        session.add(row)
        return row


def remove_pin(database: Database, axis_id: str, pin_id: int) -> PinRow:
    """Let the rule decide again about what a pin kept; return it as it was."""
    with database.write() as session, settled_with(session.connection()):
        row = existing_of(axis_id, session.get(PinRow, pin_id), f"pin {pin_id}")
        session.delete(row)
        return row


def list_pins(database: Database, axis_id: str, before_id: int | None, limit: int) -> list[PinRow]:
    """Return pins of an axis, newest first."""
    with database.read() as session:
        get_axis(session, axis_id)
        return retention.list_pins(session, axis_id, before_id, limit)


#: To walk through all files takes seconds where there are many: what was counted is told again for so long.
FRESH_S = 60.0
#: The pace is that of so many days.
PACE_DAYS, FEWEST_DAYS = 30, 1.0
MOST_PURGES = 10
_YEAR = timedelta(days=365.25)
_BYTES_PER_GB = 1e9


@dataclass(frozen=True, slots=True)
class Share:
    """So many windows, and the bytes that they take on the disk."""

    n_windows: int
    n_bytes: int


@dataclass(frozen=True, slots=True)
class Pace:
    """What an axis stores."""

    axis_id: str
    days: float  # that it was counted over
    n_bytes: int  # stored in these days

    @property
    def gb_per_year(self) -> float | None:
        """What a year would bring at this pace [GB, 1e9 bytes]; None: less than a day says nothing of a year."""
        if self.days < FEWEST_DAYS:
            return None
        return self.n_bytes / _BYTES_PER_GB * (_YEAR / timedelta(days=self.days))


@dataclass(frozen=True, slots=True)
class Survey:
    """What is stored at one moment."""

    at: datetime
    rule: Rule
    lets_go_before: datetime | None
    n_files: int
    n_bytes: int
    kept: dict[Why, Share]
    to_let_go: Share
    unnamed_bytes: int  # of old files that no window names: a crash of the service left them
    n_let_go: int  # windows whose waveforms earlier purges let go
    purges: Sequence[PurgeRow]  # newest first
    paces: Sequence[Pace]


class Surveys:
    """Counts what is stored, one survey at a time."""

    def __init__(self, database: Database, waveforms: WaveformStore, rule: Rule) -> None:
        self._database = database
        self._waveforms = waveforms
        self._rule = rule
        self._lock = threading.Lock()
        self._newest: tuple[float, tuple[object, ...], Survey] | None = None

    @property
    def rule(self) -> Rule:
        """The rule by which waveforms are kept."""
        return self._rule

    def newest(self, within_s: float = FRESH_S) -> Survey:
        """Return a survey that is not older than so long, nor than the newest purge or pin."""
        with self._lock:
            with self._database.reading() as connection:
                changes = retention.changes(connection)
            if self._newest is None or time.monotonic() - self._newest[0] > within_s or self._newest[1] != changes:
                counted = survey(self._database, self._waveforms, self._rule, now())
                self._newest = time.monotonic(), changes, counted
            return self._newest[2]


def survey(database: Database, waveforms: WaveformStore, rule: Rule, at: datetime) -> Survey:
    """Count what is stored, and what the rule would let go now."""
    sizes, lets_go_before = dict(waveforms.sizes()), rule.lets_go_before(at)
    old = [] if lets_go_before is None else [path for path in sizes if path < folder_of_day(lets_go_before)]
    windows, taken, unnamed = Counter[Why | None](), Counter[Why | None](), 0
    with database.reading() as connection:
        holds: dict[str, Holds] = {}
        for path in old:
            stored = retention.windows_in(connection, path)
            unnamed += 0 if stored else sizes[path]
            for window, n_bytes in _bytes_of(stored, sizes[path]):
                if window.axis_id not in holds:
                    holds[window.axis_id] = holds_of(connection, window.axis_id, rule)
                why = holds[window.axis_id].why(window)
                windows[why] += 1
                taken[why] += n_bytes
        n_stored, n_let_go = retention.count_windows(connection)
        begun = retention.begun_of_axes(connection)
    with database.read() as session:
        purges = retention.newest_purges(session, MOST_PURGES)
    rest = Why.FOR_EVER if lets_go_before is None else Why.YOUNG
    windows[rest] = n_stored - windows.total()
    taken[rest] = sum(sizes.values()) - unnamed - taken.total()
    return Survey(
        at, rule, lets_go_before, len(sizes), sum(sizes.values()),
        {why: Share(windows[why], taken[why]) for why in Why if windows[why]},
        Share(windows[None], taken[None]), unnamed, n_let_go, purges, list(_paces(sizes, begun, lets_go_before, at)),
    )  # fmt: skip


def _bytes_of(windows: Sequence[StoredWindow], size: int) -> Iterator[tuple[StoredWindow, int]]:
    """Yield the windows of a file, each with its share of the bytes of its frame."""
    begins = list(dict.fromkeys(window.place.offset for window in windows))
    length = {begin: end - begin for begin, end in pairwise([*begins, size])}
    left = Counter(window.place.offset for window in windows)
    for window in windows:
        offset = window.place.offset
        share = length[offset] // left[offset]
        length[offset] -= share
        left[offset] -= 1
        yield window, share


def _paces(
    sizes: dict[str, int], begun: dict[str, datetime], lets_go_before: datetime | None, at: datetime
) -> Iterator[Pace]:
    """Yield the pace of each axis, over days of which nothing was let go yet."""
    today = at.astimezone(UTC).replace(hour=0, minute=0, second=0, microsecond=0)
    since = max(today - timedelta(days=PACE_DAYS), lets_go_before or datetime.min.replace(tzinfo=UTC))
    taken = Counter[str]()
    for path, size in sizes.items():
        if path >= folder_of_day(since):
            taken[path.split("/")[-2]] += size
    for axis_id, begun_at in sorted(begun.items()):
        days = (at - max(since, begun_at)) / timedelta(days=1)
        if days > 0.0:
            yield Pace(axis_id, days, taken[axis_id])
