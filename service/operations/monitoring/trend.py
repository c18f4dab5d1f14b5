"""Reading: how an axis stands, its trend, one measurement with the evidence behind its value."""

import base64
from dataclasses import dataclass
from datetime import UTC, datetime

from monitor_core.trend import paper_rule
from service.clock import now
from service.documents.measurement import baseline_document
from service.errors import UnreadableBodyError
from service.json_types import JsonObject
from service.operations.monitoring.axis_configuration import load_configuration
from service.operations.monitoring.monitor_state import load_state, state_now
from service.store import alarms, axes, calibrations, measurements
from service.store.database import Database
from service.store.tables import AxisRow, MeasurementRow, WindowRow

#: Readings in each group of the paper's rule (Nguyen et al. 2018, section 3.3).
PAPER_READINGS = 20


@dataclass(frozen=True, slots=True)
class AxisStatus:
    """An axis and how it stands at this moment."""

    row: AxisRow
    state: str
    since: datetime | None
    last_measurement: JsonObject | None
    refused_windows: dict[str, int]
    open_alarms: int


@dataclass(frozen=True, slots=True)
class TrendPage:
    """A page of the trend."""

    measurements: list[MeasurementRow]
    next_cursor: str | None


class Trend:
    """Answers questions about what was measured."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def status(self, axis_id: str) -> AxisStatus:
        """Tell how an axis stands; silence for too long is ``unknown``."""
        with self._database.read() as session:
            row = axes.get_axis(session, axis_id)
            configuration = load_configuration(row.configuration)
            state, since = state_now(row.monitor_state, now(), configuration.silent_after_hours)
            last = measurements.last_looked_at(session, axis_id)
            return AxisStatus(
                row=row,
                state=state,
                since=since,
                last_measurement=None if last is None else last.outcome,
                refused_windows=measurements.refused_windows(session, axis_id),
                open_alarms=alarms.count_open(session, axis_id),
            )

    def baseline(self, axis_id: str) -> JsonObject | None:
        """Return the baseline in newtons, as soon as it is learnt."""
        with self._database.read() as session:
            row = axes.get_axis(session, axis_id)
            calibration = calibrations.active_calibration(session, row)
        return None if calibration is None else baseline_document(load_state(row.monitor_state), calibration)

    def paper_rule(self, axis_id: str) -> JsonObject | None:
        """Compare the first measurements under the calibration in force with the latest, as the paper does."""
        with self._database.read() as session:
            row = axes.get_axis(session, axis_id)
            preloads = measurements.preloads_under(session, axis_id, row.active_calibration_id)
        first, latest = preloads[:PAPER_READINGS], preloads[PAPER_READINGS:][-PAPER_READINGS:]
        if len(latest) < 2:
            return None
        rule = paper_rule(first, latest)
        return {
            "first_n": [rule.baseline.lower, rule.baseline.upper],
            "latest_n": [rule.current.lower, rule.current.upper],
            "n_latest": len(latest),
            "distinguished": rule.distinguished,
        }

    def page(
        self, axis_id: str, *, start: datetime | None, end: datetime | None, cursor: str | None, limit: int
    ) -> TrendPage:
        """Return measurements in time order, refused ones included."""
        after = None if cursor is None else _decode_cursor(cursor)
        with self._database.read() as session:
            axes.get_axis(session, axis_id)
            rows = measurements.trend_page(session, axis_id, start=start, end=end, after=after, limit=limit + 1)
        more = len(rows) > limit
        rows = rows[:limit]
        return TrendPage(rows, _encode_cursor(rows[-1]) if more else None)

    def measurement(self, axis_id: str, measurement_id: int) -> tuple[MeasurementRow, list[WindowRow]]:
        """Return one measurement with its windows."""
        with self._database.read() as session:
            row = measurements.get_measurement(session, axis_id, measurement_id)
            return row, measurements.windows_of(session, measurement_id)


def thin_out(points: list[MeasurementRow], max_points: int) -> list[MeasurementRow]:
    """Keep at most ``max_points``: of each stretch of time the lowest and the highest preload.

    Extremes are kept because a reader looks for them; a mean would hide the one low value that matters.
    """
    if len(points) <= max_points:
        return points
    bins = max(max_points // 2, 1)
    kept: dict[int, MeasurementRow] = {}
    for i in range(bins):
        stretch = points[i * len(points) // bins : (i + 1) * len(points) // bins]
        valued = [row for row in stretch if row.preload_n is not None]
        extremes = (min(valued, key=_preload), max(valued, key=_preload)) if valued else (stretch[0],)
        kept |= {row.id: row for row in extremes}
    return sorted(kept.values(), key=lambda row: (row.started_at, row.id))


def _preload(row: MeasurementRow) -> float:
    return row.preload_n if row.preload_n is not None else float("inf")


def _encode_cursor(row: MeasurementRow) -> str:
    return base64.urlsafe_b64encode(f"{row.started_at.isoformat()}|{row.id}".encode()).decode()


def _decode_cursor(cursor: str) -> tuple[datetime, int]:
    try:
        moment, identity = base64.urlsafe_b64decode(cursor.encode()).decode().split("|")
        return datetime.fromisoformat(moment).astimezone(UTC), int(identity)
    except (ValueError, OverflowError) as error:
        raise UnreadableBodyError("cursor is not one that this service gave out; start again without it") from error
