"""Two columns: what a history says under one calibration, and under another."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from statistics import median

from sqlalchemy import Connection
from sqlalchemy.orm import Session

from service.documents.measurement import interval_of
from service.operations.monitoring.intake.charts import Uncharted
from service.store import alarms
from service.store.intake import AxisRecord
from service.store.trend.points import Span, TrendPoint

#: Of an axis that alarms more often the first ones are named; how many there are is said anyway.
MOST_NAMED = 50


@dataclass(frozen=True, slots=True)
class Column:
    """What a history says under one calibration."""

    calibration: int | None
    state: str  # of the axis after the last measurement
    n_measurements: int
    n_refused: int
    states: dict[str, int]  # after how many measurements the axis stood so
    n_alarms: int
    first_alarm_at: datetime | None
    alarms_at: tuple[datetime, ...]  # when the measurements were made that raised them
    median_preload_n: float | None
    median_interval_95_n: tuple[float | None, float | None]  # of the lower and of the upper ends; None: mostly open


def column_of(connection: Connection, axis: AxisRecord, span: Span, points: Sequence[TrendPoint], state: str) -> Column:
    """Return what the points of a span say, with the alarms that were raised in it."""
    raised = _raised(connection, axis.id, span)
    judged = [
        point
        for point in points
        if point.preload_n is not None and point.set_preload_n is None and point.uncharted != Uncharted.WAVEFORM_GONE
    ]
    intervals = [interval_of(point) for point in judged]
    return Column(
        calibration=axis.active_calibration_id,
        state=state,
        n_measurements=len(points),
        n_refused=sum(point.refusal_reason is not None for point in points),
        states=dict(sorted(Counter(point.state for point in points).items())),
        n_alarms=len(raised),
        first_alarm_at=raised[0] if raised else None,
        alarms_at=tuple(raised[:MOST_NAMED]),
        median_preload_n=_median([point.preload_n for point in judged]),
        median_interval_95_n=(
            _median([lower for lower, _ in intervals]),
            _median([upper for _, upper in intervals]),
        ),
    )


def _raised(connection: Connection, axis_id: str, span: Span) -> list[datetime]:
    with Session(connection) as session:
        rows = alarms.raised_after(session, axis_id, 0, None)
    return [
        row.measured_at
        for row in rows
        if (span.start is None or row.measured_at >= span.start) and (span.end is None or row.measured_at < span.end)
    ]


def _median(values: Sequence[float | None]) -> float | None:
    """Return the median, open ends counted as the largest; None where there is none, or it is open."""
    if not values:
        return None
    found = median(float("inf") if value is None else value for value in values)
    return found if found < float("inf") else None
