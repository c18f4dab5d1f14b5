"""Turn plans, fits and catalogue data into pictures of a page, each for wide pages and for phones."""

from collections.abc import Callable, Sequence
from functools import partial

from markupsafe import Markup
from pydantic import BaseModel

from monitor_core.recordings.elements.units import to_millimetres
from service.documents.said import N_
from service.operations.calibrating.catalogue import AxisProposal
from service.operations.calibrating.plan import AxisPlan
from service.report.calibration_charts import (
    NARROW,
    WIDE,
    ChartSize,
    Curve,
    Spot,
    expected_chart,
    residual_chart,
    settings_chart,
)
from service.web.shown import decimal, number
from service.web.trend_view import Charts
from service.web.words import Words


class Reading(BaseModel):
    """A reading that a calibration was fitted to."""

    measurement: int
    position_mm: float
    preload_n: float
    frequency_hz: float
    residual_hz: float


def expected_charts(words: Words, proposal: AxisProposal) -> Charts:
    """Draw where the first axial mode is expected."""
    mode = proposal.mode
    curve = Curve(
        [to_millimetres(x) for x in mode.position.tolist()], mode.frequency.tolist(), mode.lower.tolist(),
        mode.upper.tolist(), proposal.search_band_hz,
    )  # fmt: skip
    title = words(N_("Expected first axial frequency over the position of the table"))
    return _both(words, lambda size, write: expected_chart(curve, size, title, write))


def settings_charts(words: Words, plan: AxisPlan) -> Charts:
    """Draw the map of positions and preloads, with what is measured, awaited, refused and still to be measured."""
    spots = [
        *(
            Spot(to_millimetres(hole.position), hole.preload, "hole", words(N_("not measured yet")))
            for hole in plan.plan.holes
        ),
        *(
            Spot(item.position_mm, item.set_preload_n, kind, _words_of(words, kind))
            for item in plan.measured
            for kind in [kind_of(item.status, item.frequency_hz)]
        ),
        Spot(to_millimetres(plan.plan.proposed.position), plan.plan.proposed.preload, "next", words(N_("next"))),
    ]
    title = words(N_("Settings of the calibration: preload over position"))
    return _both(words, lambda size, write: settings_chart(spots, size, title, write))


def kind_of(status: str, frequency_hz: float | None) -> str:
    """Return how a measurement stands on the map."""
    if frequency_hz is not None:
        return "measured"
    return "waiting" if status == "open" else "refused"


def residual_charts(words: Words, readings: Sequence[Reading]) -> Charts | None:
    """Draw what is left of the readings about a fit; None if they are not known."""
    if not readings:
        return None
    spots = [
        Spot(item.position_mm, item.residual_hz, "measured", f"{number(words, item.preload_n)} N") for item in readings
    ]
    title = words(N_("What is left of each reading about the fit, over the position"))
    return _both(words, lambda size, write: residual_chart(spots, size, title, write))


def _words_of(words: Words, kind: str) -> str:
    return words(
        {"measured": N_("measured"), "waiting": N_("windows are awaited"), "refused": N_("no mode was found")}[kind]
    )


def _both(words: Words, draw: Callable[[ChartSize, Callable[[str], str]], Markup]) -> Charts:
    write = partial(decimal, words)
    return Charts(draw(WIDE, write), draw(NARROW, write))
