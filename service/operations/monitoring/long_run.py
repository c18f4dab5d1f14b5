"""Answer what an axis did over a long time: its responses, its sisters, and where its trend would go."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Final

import numpy as np
from pydantic import BaseModel, TypeAdapter

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError
from monitor_core.trend import project
from service.documents.measurement import read_evidence
from service.operations.monitoring.axis_configuration import sisters_of
from service.operations.monitoring.extremes import extremes
from service.store import alarms, axes, measurements
from service.store.database import Database
from service.store.trend.points import Span
from service.store.trend.shown import PageOf, ShownPoint, page_of_points

#: Responses of a picture, from as many stretches of the time.
MOST_SPECTRA: Final = 26
#: So many measurements they are chosen from.
_CHOSEN_FROM: Final = 6 * MOST_SPECTRA
_LOOKED_AT: Final = 400
MOST_SISTERS: Final = 6
_OF_A_SISTER: Final = 60
#: Without an alarm, the projection rests on so many of the newest measurements.
_NEWEST: Final = 30
_LONGEST_AHEAD: Final = timedelta(days=90)
_DAY: Final = timedelta(days=1)


class _Response(BaseModel):
    """A frequency response as it is stored."""

    frequency_hz: list[float]
    real: list[float | None]
    imaginary: list[float | None]


_RESPONSE: Final = TypeAdapter(_Response)


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """The size of the response of one measurement; shape (n_frequencies,)."""

    point: ShownPoint
    frequency: FloatArray  # [Hz]
    magnitude: FloatArray  # in the unit of the response


@dataclass(frozen=True, slots=True)
class Sister:
    """An axis of a type with the newest of what it measured, in time order."""

    id: str
    name: str
    state: str
    points: list[ShownPoint]


@dataclass(frozen=True, slots=True)
class ProjectedPreload:
    """Where the preload would go if it went on as it does now: a projection, no measurement."""

    since: datetime  # of what it rests on
    n_measurements: int
    slope_n_per_day: float
    at: list[datetime]
    preload_n: list[float]
    lower_n: list[float]  # of the 95 % prediction interval of one measurement
    upper_n: list[float]


def spectra_of(database: Database, axis_id: str) -> list[Spectrum]:
    """Return responses over the time, newest first: of each stretch the one measured nearest to one position.

    The position is the usual one, and those under a payload are left out if there are others: both move the mode.
    """
    with database.read() as session:
        number = axes.get_axis(session, axis_id).number
        points = extremes(session.connection(), number, Span(), _CHOSEN_FROM)
        measured = [point for point in points if point.frequency_hz is not None and point.set_preload_n is None]
        bare = [point for point in measured if not point.payload_kg]
        chosen = _alike((bare if len(bare) > 1 else measured)[::-1])
        stored = measurements.responses_of(session, [point.measurement_id for point in chosen])
    return [_spectrum(point, stored[point.measurement_id]) for point in chosen if point.measurement_id in stored]


def sisters_with_trend(database: Database, axis_id: str) -> list[Sister]:
    """Return the axis and others of its type, each with its trend in brief; none if there is no other."""
    with database.read() as session:
        own = axes.get_axis(session, axis_id)
        others = list(itertools.islice(sisters_of(session, own), MOST_SISTERS))
        rows = [own, *others] if others else []
        return [
            Sister(row.id, row.name, row.state, extremes(session.connection(), row.number, Span(), _OF_A_SISTER))
            for row in rows
        ]


def projection_of(database: Database, axis_id: str) -> ProjectedPreload | None:
    """Return where the preload would go; None if too little was measured.

    It rests on what was measured since the onset of the alarm that stands, without one on the newest measurements.
    """
    with database.read() as session:
        row = axes.get_axis(session, axis_id)
        newest = alarms.list_alarms(
            session, axis_id=axis_id, status=None, before_id=None, limit=1, by_measurements=True
        )
        standing = newest and newest[0].status in alarms.OPEN
        span = Span(read_evidence(newest[0].evidence).onset if standing else None)
        points = page_of_points(session.connection(), row.number, PageOf(span, _LOOKED_AT, newest_first=True))
    judged = [
        point for point in points
        if point.preload_n is not None and point.set_preload_n is None and not point.doubts
    ]  # fmt: skip
    return _projected(judged[::-1] if standing else judged[:_NEWEST][::-1])


def _alike(points: Sequence[ShownPoint]) -> list[ShownPoint]:
    if not points:
        return []
    usual = float(np.median([point.position_mm for point in points]))
    edges = np.linspace(0, len(points), min(MOST_SPECTRA, len(points)) + 1).astype(int)
    stretches = [points[begin:end] for begin, end in itertools.pairwise(edges)]
    return [min(stretch, key=lambda point: abs(point.position_mm - usual)) for stretch in stretches]


def _spectrum(point: ShownPoint, document: object) -> Spectrum:
    response = _RESPONSE.validate_python(document)
    real = np.array(response.real, dtype=np.float64)
    imaginary = np.array(response.imaginary, dtype=np.float64)
    return Spectrum(point, np.array(response.frequency_hz), np.hypot(real, imaginary))


def _projected(points: Sequence[ShownPoint]) -> ProjectedPreload | None:
    if not points:
        return None
    first, last = points[0].at, points[-1].at
    days = np.array([(point.at - last) / _DAY for point in points])
    values = np.array([point.preload_n for point in points], dtype=np.float64)
    reach = min(last - first, _LONGEST_AHEAD)
    ahead = np.linspace(0.0, reach / _DAY, 13)
    try:
        projection = project(days, values, ahead)
    except NotIdentifiableError:
        return None
    moments = [last + float(day) * _DAY for day in ahead]
    return ProjectedPreload(
        first, len(points), projection.slope.value, moments,
        projection.value.tolist(), projection.lower.tolist(), projection.upper.tolist(),
    )  # fmt: skip
