"""Draw the report as a page of HTML that needs nothing else: no script, no font, no other file."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from monitor_core.discrepancy import Explanation
from monitor_core.fitting.comparison import Panel
from service.report.charts import gap_chart, misfit_map_chart, panel_chart, pull_chart, shade_names, style_of
from service.report.content import Cell, report_content
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
    ladder = [("nothing added", gap.before), *((f"+ {step.effect}", step.gap) for step in explanation.steps)]
    return _ENVIRONMENT.get_template("explanation.html").render(
        explanation=explanation,
        content=report_content(explanation),
        subject=subject,
        model_text=model_text,
        shades=shade_names(),
        models=_models(explanation),
        nothing_held_out=nothing_held_out(explanation),
        number=_number,
        gap_picture=gap_chart("gap", "Gap before and after", both, gap.noise_floor, gap.unit),
        ladder=gap_chart("ladder", "Gap after each step", ladder, gap.noise_floor, gap.unit),
        maps=[
            (
                shown.title,
                misfit_map_chart(f"map-{i}-before", f"{shown.title}, before", shown, shown.before),
                misfit_map_chart(f"map-{i}-after", f"{shown.title}, after", shown, shown.after),
            )
            for i, shown in enumerate(explanation.maps)
        ],
        panels=[(panel, panel_chart(f"panel-{i}", panel)) for i, panel in enumerate(_worst_first(explanation.panels))],
        pull_picture=pull_chart("pulls", explanation.pulls) if explanation.pulls else None,
    )


def _worst_first(panels: Sequence[Panel]) -> list[Panel]:
    """Return responses with those first that the model before misses most; other panels as they come."""
    return sorted(panels, key=lambda panel: -_relative_error(panel) if panel.logarithmic else 0.0)


def _relative_error(panel: Panel) -> float:
    """Return the rms of ln(model/measured) of the first model, 0 where no model has an answer."""
    first = next(iter(panel.models.values()), panel.measured)
    squares = np.log(first / panel.measured) ** 2
    known = squares[np.isfinite(squares)]
    return float(np.sqrt(np.mean(known))) if known.size else 0.0


def _models(explanation: Explanation) -> list[tuple[str, str]]:
    """Return the names of the models in the panels, each with its style, in the order in which they come."""
    names = dict.fromkeys(model for panel in explanation.panels for model in panel.models)
    return [(name, style_of(name)) for name in names]


def _number(cell: Cell) -> Markup:
    """Show a cell; a number that is known is in the same element in full, for programs."""
    if math.isnan(cell.value):
        return escape(str(cell))
    return Markup('<data value="{}">{}</data>{}').format(repr(float(cell.value)), cell.text, cell.note)
