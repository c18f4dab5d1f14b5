"""Draw the report as a page of HTML that needs nothing else: no script, no font, no other file."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from monitor_core.discrepancy import Explanation, MisfitMap, Outcome
from monitor_core.shown import Panel
from service.documents.explanation_sentences import extent_in_words, map_title, parameter_words, row_label
from service.report.charts import gap_chart, misfit_map_chart, panel_chart, pull_chart, shade_names, style_of
from service.report.content import Cell, added_words, report_content
from service.report.hero import NARROW, WIDE, hero_chart, largest_gap, miss, zoomed
from service.report.verdict import nothing_held_out

_TEMPLATES: Final = Path(__file__).parent / "templates"
#: The look of the dashboard, which the report takes over into itself.
_DASHBOARD_STYLE: Final = Path(__file__).parents[1] / "web" / "static"

_ENVIRONMENT: Final = Environment(
    loader=FileSystemLoader([_TEMPLATES, _DASHBOARD_STYLE]),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


def explanation_page(explanation: Explanation, model_text: str, subject: str) -> str:
    """Return the page, with the augmented model as TOML; its title says what was compared with what, the subject."""
    gap = explanation.gap
    both = [("before", gap.before), ("after", gap.after)]
    ladder = [
        ("nothing added", gap.before),
        *((f"+ {added_words(step.effects)}", step.gap) for step in explanation.steps),
    ]
    worst = largest_gap(explanation.panels)
    return _ENVIRONMENT.get_template("explanation.html").render(
        explanation=explanation,
        content=report_content(explanation),
        subject=subject,
        model_text=model_text,
        shades=shade_names(),
        models=_models(explanation),
        first=worst,
        heroes=_heroes(explanation, worst),
        nothing_held_out=nothing_held_out(explanation),
        number=_number,
        gap_picture=gap_chart("gap", "Gap before and after", both, gap.noise_floor, gap.unit),
        ladder=gap_chart("ladder", "Gap after each step", ladder, gap.noise_floor, gap.unit),
        maps=[_maps(i, shown) for i, shown in enumerate(explanation.maps)],
        panels=[(panel, panel_chart(f"panel-{i}", panel)) for i, panel in enumerate(_worst_first(explanation.panels))],
        pull_picture=pull_chart("pulls", {parameter_words(name): pull for name, pull in explanation.pulls.items()})
        if explanation.pulls
        else None,
    )


def _heroes(explanation: Explanation, worst: Panel | None) -> list[tuple[str, Markup]]:
    """Return the picture that the page begins with, for wide pages and for phones."""
    if worst is None:
        return []
    names = {"before": "model"}
    if explanation.steps:
        helps = explanation.outcome is Outcome.UNKNOWN
        names = {"before": "model before", "after": "with what helps most" if helps else "with what was found"}
    frames = {"wide": WIDE, "narrow": NARROW}
    return [(size, hero_chart(f"hero-{size}", zoomed(worst), frame, names)) for size, frame in frames.items()]


def _maps(number: int, shown: MisfitMap) -> tuple[str, Markup, Markup]:
    """Return the title of a map and both of its pictures."""
    title = map_title(shown.over)
    rows, columns = tuple(map(row_label, shown.rows)), tuple(map(extent_in_words, shown.columns))
    before, after = (
        misfit_map_chart(f"map-{number}-{time}", f"{title}, {time}", rows, columns, values)
        for time, values in (("before", shown.before), ("after", shown.after))
    )
    return title, before, after


def _worst_first(panels: Sequence[Panel]) -> list[Panel]:
    """Return responses with those first that the model before misses most; other panels as they come."""
    return sorted(panels, key=lambda panel: -miss(panel) if panel.logarithmic else 0.0)


def _models(explanation: Explanation) -> list[tuple[str, str]]:
    """Return the names of the models in the panels, each with its style, in the order in which they come."""
    names = dict.fromkeys(model for panel in explanation.panels for model in panel.models)
    return [(name, style_of(name)) for name in names]


def _number(cell: Cell) -> Markup:
    """Show a cell; a number that is known is in the same element in full, for programs."""
    if math.isnan(cell.value):
        return escape(str(cell))
    return Markup('<data value="{}">{}</data>{}').format(repr(float(cell.value)), cell.text, cell.note)
