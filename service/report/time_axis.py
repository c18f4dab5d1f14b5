"""Round moments for the time axis of a chart, and how they are written: ISO, as short as the span allows."""

from datetime import UTC, datetime, timedelta
from typing import Final

_HOUR, _DAY = timedelta(hours=1), timedelta(days=1)
_STEPS: Final = (
    *(timedelta(minutes=minutes) for minutes in (1, 5, 15, 30)),
    *(_HOUR * hours for hours in (1, 3, 6, 12)),
    *(_DAY * days for days in (1, 2, 4, 7, 14)),
)
#: Steps in months, where days are too many.
_MONTHS: Final = (1, 2, 3, 6, 12, 24, 60, 120)
_MONTH = 30.4 * _DAY
_EPOCH: Final = datetime(2000, 1, 3, tzinfo=UTC)  # a Monday, so that steps of weeks begin with one


def time_ticks(start: datetime, end: datetime, most: int) -> list[tuple[datetime, str]]:
    """Return at most so many round moments between two others, each with its label."""
    span = end - start
    for step in _STEPS:
        if span / step <= most - 1:
            first = _EPOCH + -(-(start - _EPOCH) // step) * step
            moments = [first + i * step for i in range(most) if first + i * step <= end]
            return [(moment, f"{moment:%H:%M}" if step < _DAY else f"{moment:%m-%d}") for moment in moments]
    months = next((months for months in _MONTHS if span / (months * _MONTH) <= most - 1), _MONTHS[-1])
    count = start.year * 12 + start.month - 1
    number = -(-(count + 1) // months) * months
    ticks: list[tuple[datetime, str]] = []
    while (moment := datetime(number // 12, number % 12 + 1, 1, tzinfo=UTC)) <= end and len(ticks) < most:
        ticks.append((moment, f"{moment:%Y-%m}" if months < 12 else f"{moment:%Y}"))
        number += months
    return ticks
