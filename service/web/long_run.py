"""``/axes/{axis}/long-run``: responses over a long time, axes of the same type, and where the trend would go."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import Final

import numpy as np
from fastapi import APIRouter, Response
from markupsafe import Markup

from service.api.access import needs
from service.api.services import Services, ServicesOf
from service.documents.history import ProjectedPreload
from service.documents.measurement import numbers_of
from service.documents.said import N_
from service.operations.access.scopes import Scope
from service.operations.fields import AxisId
from service.operations.monitoring.long_run import (
    Sister,
    Spectrum,
    sisters_with_trend,
    spectra_of,
)
from service.report.trend_chart import (
    LOW_NARROW,
    LOW_WIDE,
    Marks,
    ShareLine,
    TrendPicture,
    Wedge,
    sisters_chart,
    trend_chart,
)
from service.report.waterfall import Response as DrawnResponse, waterfall
from service.store.trend.points import Span
from service.store.trend.shown import ShownPoint, ToldColumns
from service.web.shown import decimal
from service.web.site import PageOf
from service.web.trend_view import Charts, preload_marks, twice
from service.web.words import Words

router = APIRouter(include_in_schema=False)

_WIDE, _NARROW = 1180.0, 388.0
#: Points before a projection.
_BEFORE: Final = 70


@dataclass(frozen=True, slots=True)
class ListedResponse:
    """A response as a line of the table."""

    point: ShownPoint
    spectrum: Spectrum
    largest: float


@dataclass(frozen=True, slots=True)
class ListedSister:
    """An axis of the type as a line of the table."""

    number: int
    sister: Sister
    share: float
    at: datetime


@router.get("/axes/{axis}/long-run", dependencies=[needs(Scope.TRENDS_READ)])
def long_run_page(axis: AxisId, page: PageOf, on: ServicesOf) -> Response:
    """Show what an axis did over a long time."""
    history, words = on.history.of(axis), page.words
    spectra = spectra_of(on.database, axis, history.healthy)
    shares = [
        (sister, line) for sister in sisters_with_trend(on.database, axis) if (line := _share(sister, axis)) is not None
    ]
    projected = history.projected
    return page.show(
        "axis_long_run.html",
        axis=on.axes.get(axis),
        spectra=[_listed(spectrum) for spectrum in spectra],
        spectra_chart=_waterfalls(words, spectra) if len(spectra) > 1 else None,
        multiples=_multiples(words, spectra),
        sisters=[
            ListedSister(number, sister, line.share[-1], line.at[-1])
            for number, (sister, line) in enumerate(shares, start=1)
        ],
        sisters_chart=_sisters(words, [line for _, line in shares]) if len(shares) > 1 else None,
        projected=projected,
        projection_chart=None if projected is None else _projection(words, axis, projected, on),
    )


def _listed(spectrum: Spectrum) -> ListedResponse:
    return ListedResponse(spectrum.point, spectrum, float(np.nanmax(spectrum.magnitude)))


def _waterfalls(words: Words, spectra: Sequence[Spectrum]) -> Charts:
    responses = [
        DrawnResponse(spectrum.point.at, spectrum.frequency, spectrum.magnitude, spectrum.mode) for spectrum in spectra
    ]
    title, axis_words = (
        words(N_("Size of the response around the mode, newest at the top")),
        words(N_("frequency at the usual position, Hz")),
    )
    return twice(words, partial(waterfall, title, responses, axis_words=axis_words), _WIDE, _NARROW)


def _multiples(words: Words, spectra: Sequence[Spectrum]) -> list[tuple[str, Markup]]:
    """Draw what the quality of the responses was: a small picture for each number, with its title."""
    numbers = (
        (words(N_("Coherence over the half-power band")), "", [spectrum.coherence for spectrum in spectra]),
        (words(N_("What one mode leaves of the response")), "%", [_percent(each.unexplained) for each in spectra]),
        (
            words(N_("Half of what torque forward and backward differ by")),
            "N·m",
            [spectrum.point.friction_torque_nm for spectrum in spectra],
        ),
    )
    at, kinds = [spectrum.point.at for spectrum in spectra], [spectrum.point.state for spectrum in spectra]
    nothing = np.full(len(spectra), np.nan)
    drawn = []
    for title, unit, values in numbers:
        if sum(value is not None for value in values) > 1:
            marks = Marks(np.array([each.timestamp() for each in at]), numbers_of(values), nothing, nothing, kinds)
            picture = TrendPicture(title, unit, min(at), max(at), marks)
            drawn.append((title, trend_chart(picture, LOW_NARROW, partial(decimal, words))))
    return drawn


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share


def _share(sister: Sister, own: str) -> ShareLine | None:
    """Return the line of an axis: what is left of the baseline that held then."""
    shares = [
        (point.at, point.preload_n / point.baseline_preload_n)
        for point in sister.points
        if point.preload_n is not None and point.baseline_preload_n and point.set_preload_n is None
    ]
    if len(shares) < 2:
        return None
    return ShareLine(sister.name, [at for at, _ in shares], [share for _, share in shares], sister.id == own)


def _sisters(words: Words, lines: Sequence[ShareLine]) -> Charts:
    title = words(N_("Share of the baseline preload, axes of one type"))
    return twice(words, partial(sisters_chart, title, lines), LOW_WIDE, LOW_NARROW)


def _projection(words: Words, axis: str, projected: ProjectedPreload, on: Services) -> Charts:
    """Draw what the projection rests on, as much time before it, and where the preload would go."""
    last = projected.at[0]
    start = projected.line.started_at - (last - projected.line.started_at) / 2
    points = on.trend.at_resolution(axis, Span(start), _BEFORE).points
    marks = preload_marks(ToldColumns.of([point for point in points if point.preload_n is not None]))
    wedge = Wedge(projected.at, projected.preload_n, projected.lower_n, projected.upper_n)
    picture = TrendPicture(words(N_("Projection of the preload")), "N", start, projected.at[-1], marks, wedge=wedge)
    return twice(words, partial(trend_chart, picture), LOW_WIDE, LOW_NARROW)
