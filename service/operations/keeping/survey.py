"""Count what is stored: what is kept and why, what a purge would let go, and how much a year brings."""

import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import pairwise

from service.clock import now
from service.operations.keeping.rule import Holds, Rule, Why, holds_of
from service.store import retention
from service.store.database import Database, reading
from service.store.retention import StoredWindow
from service.store.tables import PurgeRow
from service.store.waveforms import WaveformStore, folder_of_day

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

    def newest(self) -> Survey:
        """Return a survey that is not older than a minute, nor than the newest purge or pin."""
        with self._lock:
            with self._database.connect() as connection, reading(connection):
                changes = retention.changes(connection)
            if self._newest is None or time.monotonic() - self._newest[0] > FRESH_S or self._newest[1] != changes:
                found = survey(self._database, self._waveforms, self._rule, now())
                self._newest = time.monotonic(), changes, found
            return self._newest[2]


def survey(database: Database, waveforms: WaveformStore, rule: Rule, at: datetime) -> Survey:
    """Count what is stored, and what the rule would let go now."""
    sizes, before = dict(waveforms.sizes()), rule.lets_go_before(at)
    old = [] if before is None else [path for path in sizes if path < folder_of_day(before)]
    windows, taken, unnamed = Counter[Why | None](), Counter[Why | None](), 0
    with database.connect() as connection, reading(connection):
        holds: dict[str, Holds] = {}
        for path in old:
            found = retention.windows_in(connection, path)
            unnamed += 0 if found else sizes[path]
            for window, n_bytes in _bytes_of(found, sizes[path]):
                if window.axis_id not in holds:
                    holds[window.axis_id] = holds_of(connection, window.axis_id, rule)
                why = holds[window.axis_id].why(window)
                windows[why] += 1
                taken[why] += n_bytes
        n_stored, n_let_go = retention.count_windows(connection)
        begun = retention.begun_of_axes(connection)
    with database.read() as session:
        purges = retention.newest_purges(session, MOST_PURGES)
    rest = Why.FOR_EVER if before is None else Why.YOUNG
    windows[rest] = n_stored - windows.total()
    taken[rest] = sum(sizes.values()) - unnamed - taken.total()
    return Survey(
        at, rule, before, len(sizes), sum(sizes.values()),
        {why: Share(windows[why], taken[why]) for why in Why if windows[why]},
        Share(windows[None], taken[None]), unnamed, n_let_go, purges, list(_paces(sizes, begun, before, at)),
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


def _paces(sizes: dict[str, int], begun: dict[str, datetime], before: datetime | None, at: datetime) -> Iterator[Pace]:
    """Yield the pace of each axis, over days of which nothing was let go yet."""
    today = at.astimezone(UTC).replace(hour=0, minute=0, second=0, microsecond=0)
    since = max(today - timedelta(days=PACE_DAYS), before or datetime.min.replace(tzinfo=UTC))
    taken = Counter[str]()
    for path, size in sizes.items():
        if path >= folder_of_day(since):
            taken[path.split("/")[-2]] += size
    for axis_id, begun_at in sorted(begun.items()):
        days = (at - max(since, begun_at)) / timedelta(days=1)
        if days > 0.0:
            yield Pace(axis_id, days, taken[axis_id])
