"""Read how axes stand, their trends, and single measurements."""

import base64
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import Generic, Literal, NamedTuple, TypeVar

from sqlalchemy import Connection

from monitor_core.trend import paper_rule
from service.clock import now, text_of
from service.documents.lost_motion import LostMotionNow
from service.documents.stored_measurement import NOTHING_MEASURED, StoredMeasurement
from service.errors import DocumentDamagedError, UnreadableBodyError
from service.json_types import JsonObject, document_of
from service.operations.monitoring.axis_configuration import AxisConfiguration, load_configuration
from service.operations.monitoring.extremes import extremes
from service.operations.monitoring.intake.chart_state import load_design, load_state, state_now
from service.operations.monitoring.lost_motion import lost_motion_now
from service.store import alarms, axes, measurements
from service.store.database import Database
from service.store.intake import outcomes_of
from service.store.lookup import Remembered
from service.store.rejudged import Stale, stale_axes
from service.store.retention import LetGo, let_go
from service.store.tables import AxisRow, MeasurementDocumentRow, MeasurementRow, WindowRow, moment_of
from service.store.trend.lost_motion import ChartedReading, newest_readings
from service.store.trend.points import (
    Cursor,
    Quality,
    Span,
    last_points,
    point_of,
    preloads,
    quality_of_newest,
)
from service.store.trend.shown import PageOf, ShownPoint, ToldColumns, page_of_columns, page_of_points

#: Which measurements a page of the trend is asked for.
Only = Literal["refused", "in-doubt"]
#: A page of some of the measurements looks at so many.
LOOKED_AT = 2000
#: So many of the newest measurements say how good the data are now.
LOOKED_AT_FOR_QUALITY = 200
#: So many answers are remembered, a few of each axis.
MOST_REMEMBERED = 20_000
#: Readings in each group of the paper's rule (Nguyen et al. 2018, section 3.3).
PAPER_READINGS = 20


@dataclass(frozen=True, slots=True)
class PaperRule:
    """Intervals of the mean of the first measurements and of the latest [N], and whether they part."""

    first_n: tuple[float, float]
    latest_n: tuple[float, float]
    n_latest: int
    distinguished: bool


@dataclass(frozen=True, slots=True)
class PreloadLeft:
    """The share of the commissioned preload that is left, with its 95 % coverage interval; an open end is None."""

    share: float
    interval_95: tuple[float | None, float | None]


@dataclass(frozen=True, slots=True)
class AxisStatus:
    """An axis and how it stands at this moment."""

    row: AxisRow
    configuration: AxisConfiguration
    state: str
    since: datetime | None
    last_measurement: StoredMeasurement | None
    open_alarms: int
    stale: Stale | None = None  # what it says is about to be replaced
    lost_motion: LostMotionNow | None = None  # None: never measured

    @property
    def last(self) -> StoredMeasurement:
        """What was said about the last measurement; nothing if there is none."""
        return self.last_measurement or NOTHING_MEASURED

    @property
    def preload_left(self) -> PreloadLeft | None:
        """What is left of the commissioned preload by the last measurement; None if either is not known."""
        commissioned, preload, interval = (
            self.configuration.commissioned_preload_n, self.last.preload_n, self.last.interval_95_n
        )  # fmt: skip
        if commissioned is None or preload is None or interval is None:
            return None
        lower, upper = (None if end is None else end / commissioned for end in interval)
        return PreloadLeft(preload / commissioned, (lower, upper))


#: Worst first; an axis nobody can judge comes before one that is well.
SEVERITY = ("alarm", "alert", "unknown", "learning", "normal")


@dataclass(frozen=True, slots=True)
class Machine:
    """A machine, with its axes in order of name."""

    name: str
    place: str | None
    axes: tuple[AxisStatus, ...]

    @property
    def state(self) -> str:
        """How the worst of its axes stands."""
        return min((axis.state for axis in self.axes), key=SEVERITY.index)


def machines_of(axes: Iterable[AxisStatus]) -> list[Machine]:
    """Return the machines that axes are of, in order of name; one of the same name elsewhere is another one."""
    owned: dict[tuple[str, str], list[AxisStatus]] = defaultdict(list)
    for axis in axes:
        configuration = axis.configuration
        if configuration.machine is not None:
            owned[configuration.machine, configuration.machine_place or ""].append(axis)
    return [Machine(name, place or None, tuple(own)) for (name, place), own in sorted(owned.items())]


@dataclass(frozen=True, slots=True)
class DamagedAxis:
    """An axis of which something stored cannot be read."""

    id: str
    name: str
    detail: str  # what, and what to do about it


@dataclass(frozen=True, slots=True)
class Fleet:
    """All axes."""

    axes: list[AxisStatus]
    damaged: list[DamagedAxis]


Points = TypeVar("Points")


@dataclass(frozen=True, slots=True)
class TrendPage(Generic[Points]):
    """A page of the trend, point by point or as columns."""

    points: Points
    next_cursor: str | None
    revision: int  # of the axis when it was read
    stale: Stale | None  # what it says is about to be replaced


@dataclass(frozen=True, slots=True)
class MeasurementView:
    """One measurement with the evidence behind its value; of one that is open there is none yet."""

    row: MeasurementRow
    outcome: StoredMeasurement | None
    response: JsonObject | None
    windows: list[WindowRow]
    let_go: LetGo | None  # None: all waveforms are stored


class Trend:
    """Answers questions about what was measured."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._remembered = Remembered(MOST_REMEMBERED)

    def status(self, axis_id: str) -> AxisStatus:
        """Tell how an axis stands; silence for too long is ``unknown``."""
        with self._database.read() as session:
            row, documents = axes.axis_with_documents(session, axis_id)
            last, connection = None, session.connection()
            if row.last_measurement_id is not None and row.last_measured_at is not None:
                point = point_of(connection, row.number, row.last_measured_at, row.last_measurement_id)
                outcomes = outcomes_of(connection, [row.last_measurement_id])
                last = StoredMeasurement.of(outcomes[row.last_measurement_id], point) if outcomes else None
            lost = newest_readings(connection, row.number).get(row.number)
            renewed = max(axes.renewals_of(connection, axis_id), default=None) if lost is not None else None
            stale = stale_axes(session, axis_id).get(axis_id)
            return self._status(
                row, documents, last, alarms.count_open(session, axis_id), stale, lost=lost, renewed=renewed
            )

    def fleet(self, machine: str | None = None, *, archived: bool = False) -> Fleet:
        """Tell how every axis stands, or those of a machine; archived ones only where they are asked for.

        What is wrong with the documents of one keeps no other from being told.
        """
        statuses, damaged = [], []
        with self._database.read() as session:
            rows, n_open = axes.axes_with_documents(session), alarms.open_by_axis(session)
            stale = stale_axes(session)
            points = last_points(session.connection())
            outcomes = outcomes_of(session.connection(), [point.measurement_id for point in points.values()])
            lost = newest_readings(session.connection())
            renewed = axes.newest_renewals(session.connection()) if lost else {}
        for row, documents in rows:
            if row.archived_at is not None and not archived:
                continue
            point = points.get(row.number)
            last = None if point is None else StoredMeasurement.of(outcomes[point.measurement_id], point)
            try:
                status = self._status(
                    row, documents, last, n_open.get(row.id, 0), stale.get(row.id),
                    lost=lost.get(row.number), renewed=renewed.get(row.id),
                )  # fmt: skip
                statuses += [status] if machine in (None, status.configuration.machine) else []
            except DocumentDamagedError as error:
                damaged.append(DamagedAxis(row.id, row.name, str(error)))
        return Fleet(statuses, damaged)

    def newest_preloads(self, rows: Sequence[AxisRow], most: int) -> dict[str, list[float]]:
        """Return the newest preloads of axes in time order, for a small picture of each.

        Refused ones have none, and one that was set on purpose tells nothing of the course.
        """

        def read(row: AxisRow) -> list[float]:
            points = page_of_points(connection, row.number, PageOf(Span(), most, newest_first=True))
            shown = (point for point in reversed(points) if point.set_preload_n is None)
            return [point.preload_n for point in shown if point.preload_n is not None]

        with self._database.reading() as connection:
            return {
                row.id: self._remembered.of(("newest", row.id, most), row.revision, partial(read, row)) for row in rows
            }

    def paper_rule(self, row: AxisRow) -> PaperRule | None:
        """Compare the first measurements since the charts of an axis began with the latest, as the paper does."""
        return self._remembered.of(("rule", row.id), row.revision, partial(self._paper_rule, row))

    def quality(self, row: AxisRow) -> Quality | None:
        """Tell how good the newest measurements of an axis are; None if nothing was measured yet."""
        return self._remembered.of(("quality", row.id), row.revision, partial(self._quality_of, row))

    def _quality_of(self, row: AxisRow) -> Quality | None:
        with self._database.reading() as connection:
            return quality_of_newest(connection, row.number, LOOKED_AT_FOR_QUALITY)

    def _paper_rule(self, row: AxisRow) -> PaperRule | None:
        if row.epoch_from is None:
            return None
        with self._database.reading() as connection:
            earliest, latest = (
                preloads(connection, row.number, row.epoch, row.epoch_from, most, newest=newest)
                for most, newest in ((2 * PAPER_READINGS, False), (PAPER_READINGS, True))
            )
        baseline = earliest[:PAPER_READINGS]
        latest = latest[-max(len(earliest) - len(baseline), 0) :] if len(earliest) < 2 * PAPER_READINGS else latest
        if len(earliest) - len(baseline) < 2:
            return None
        rule = paper_rule(baseline, latest)
        return PaperRule(
            (rule.baseline.lower, rule.baseline.upper),
            (rule.current.lower, rule.current.upper),
            len(latest),
            rule.distinguished,
        )

    def revision(self, axis_id: str) -> tuple[int, Stale | None]:
        """Return a number that changes whenever the trend of an axis does, and what is about to replace it."""
        with self._opened(axis_id) as on:
            return on.revision, on.stale

    @contextmanager
    def _opened(self, axis_id: str) -> "Iterator[_Opened]":
        """Open the trend of an axis to be read."""
        with self._database.reading() as connection:
            key = axes.key_of(connection, axis_id)
            yield _Opened(connection, key.number, key.revision, stale_axes(connection, axis_id).get(axis_id))

    def names(self) -> dict[str, str]:
        """Return what each axis is called."""
        with self._database.read() as session:
            return axes.names(session)

    def revisions(self) -> dict[str, int]:
        """Return for each axis a number that changes whenever it does."""
        with self._database.read() as session:
            return axes.revisions(session)

    def page(
        self,
        axis_id: str,
        span: Span,
        *,
        cursor: str | None,
        limit: int,
        newest_first: bool = False,
        only: Only | None = None,
    ) -> TrendPage[list[ShownPoint]]:
        """Return measurements in time order, or newest first, refused ones included.

        ``only`` some of them: a page then looks at so many at most, and may hold fewer, or none, and still go on.
        """
        after = None if cursor is None else _decode_cursor(cursor)
        most = limit if only is None else max(limit, LOOKED_AT)
        with self._opened(axis_id) as on:
            points = page_of_points(on.connection, on.number, PageOf(span, most + 1, after, newest_first))
        looked = points[:most]
        meant = looked if only is None else [point for point in looked if _is_meant(point, only)]
        last = meant[limit - 1] if len(meant) > limit else looked[-1] if len(points) > most else None
        following = None if last is None else _encode_cursor(last.at_us, last.measurement_id)
        return TrendPage(meant[:limit], following, on.revision, on.stale)

    def told(
        self, axis_id: str, span: Span, *, cursor: str | None, limit: int, newest_first: bool
    ) -> TrendPage[ToldColumns]:
        """Return measurements as :meth:`page` does, as columns."""
        asked = PageOf(span, limit, None if cursor is None else _decode_cursor(cursor), newest_first)
        with self._opened(axis_id) as on:
            columns, goes_on = page_of_columns(on.connection, on.number, asked)
        following = _encode_cursor(columns.at_us[-1], columns.measurement_id[-1]) if goes_on else None
        return TrendPage(columns, following, on.revision, on.stale)

    def ends(self, axis_id: str) -> tuple[ShownPoint, ShownPoint] | None:
        """Return the first and the last measurement; None if nothing was measured yet."""
        with self._opened(axis_id) as on:
            first, last = (
                page_of_points(on.connection, on.number, PageOf(Span(), 1, newest_first=newest))
                for newest in (False, True)
            )
        return (first[0], last[0]) if first else None

    def at_resolution(self, axis_id: str, span: Span, resolution: int) -> TrendPage[list[ShownPoint]]:
        """Return so many points at most over any span of time: of each stretch of it the lowest and highest preload.

        Only of those whose preload was not set on purpose, which is how the axis wore.
        """
        with self._opened(axis_id) as on:
            points = extremes(on.connection, on.number, span, resolution)
            return TrendPage(points, None, on.revision, on.stale)

    def measurement(self, axis_id: str, measurement_id: int) -> MeasurementView:
        """Return one measurement with its windows."""
        with self._database.read() as session:
            row, connection = measurements.get_measurement(session, axis_id, measurement_id), session.connection()
            number = axes.get_axis(session, axis_id).number
            document = session.get(MeasurementDocumentRow, measurement_id)
            point = point_of(connection, number, row.started_at, measurement_id)
            outcome = None if document is None or point is None else StoredMeasurement.of(document.outcome, point)
            windows = measurements.windows_of(session, measurement_id)
            response = None if document is None else document.response
            gone = let_go(connection, [measurement_id]).get(measurement_id)
            return MeasurementView(row, outcome, response, windows, gone)

    def _status(
        self,
        row: AxisRow,
        documents: axes.Documents,
        last_measurement: StoredMeasurement | None,
        open_alarms: int,
        stale: Stale | None,
        *,
        lost: tuple[ChartedReading, datetime | None] | None,
        renewed: datetime | None,
    ) -> AxisStatus:
        """Return how an axis stands; raises DocumentDamagedError if something stored of it cannot be read."""
        configuration = self._remembered.of(("configuration", row.id), documents, partial(_read, documents))
        if row.archived_at is None:
            state_shown, since = state_now(row, now(), configuration.silent_after_hours)
        else:  # nobody waits for it
            state_shown, since = row.state, row.state_since
        lost_motion = lost_motion_now(lost, renewed, configuration.silent_after_hours)
        return AxisStatus(row, configuration, state_shown, since, last_measurement, open_alarms, stale, lost_motion)


def _read(documents: axes.Documents) -> AxisConfiguration:
    """Read the documents of an axis; to do so takes longer than all the rest of how it stands."""
    configuration, state, limits = map(document_of, documents)
    load_state(state)
    load_design(limits)
    return load_configuration(configuration)


class _Opened(NamedTuple):
    """The trend of an axis, open to be read."""

    connection: Connection
    number: int
    revision: int
    stale: Stale | None


def _is_meant(point: ShownPoint, only: Only) -> bool:
    return point.refusal_reason is not None if only == "refused" else bool(point.doubts)


def _encode_cursor(at_us: int, measurement_id: int) -> str:
    return base64.urlsafe_b64encode(f"{text_of(moment_of(at_us))}|{measurement_id}".encode()).decode()


def _decode_cursor(cursor: str) -> Cursor:
    try:
        moment, identity = base64.urlsafe_b64decode(cursor.encode()).decode().split("|")
        number = int(identity)
        if not 0 < number < 2**63:
            raise ValueError(f"expected a number below 2**63; got {number}")
        return datetime.fromisoformat(moment).astimezone(UTC), number
    except (ValueError, OverflowError) as error:
        raise UnreadableBodyError("cursor is not one that this service gave out; start again without it") from error
