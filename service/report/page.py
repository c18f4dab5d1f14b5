"""The report as one page of HTML that needs nothing else: no script, no font, no other file."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from monitor_core.discrepancy.explanation import Explanation, FoundParameter
from monitor_core.fitting.comparison import Panel
from service.report import rounding, sentences
from service.report.gap_chart import gap_chart, pull_chart
from service.report.misfit_map_chart import misfit_map_chart, shade_names
from service.report.panel_chart import panel_chart, style_of

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
    """Return the page.

    Parameters
    ----------
    explanation : Explanation
    model_text : str
        The augmented drive model, as TOML.
    subject : str
        What was compared with what, as the title says it.
    """
    return _ENVIRONMENT.get_template("explanation.html").render(
        explanation=explanation,
        subject=subject,
        model_text=model_text,
        headline=sentences.headline(explanation),
        meaning=sentences.meaning(explanation),
        candidates=sentences.candidates_in_order(explanation.candidates),
        found_heading=sentences.found_heading(explanation.outcome),
        place=sentences.place,
        misfits_heading=sentences.misfits_heading(explanation.outcome),
        model_heading=sentences.model_heading(explanation.outcome),
        candidates_heading=sentences.candidates_heading(explanation.outcome),
        shades=shade_names(),
        models=_models(explanation),
        number=_number,
        parameter_value=_parameter_value,
        beside_what_is_stated=sentences.beside_what_is_stated,
        asides=sentences.asides,
        nothing_held_out=sentences.nothing_held_out,
        parameter_interval=_parameter_interval,
        quantity=rounding.quantity,
        evidence=rounding.evidence,
        probability=rounding.probability,
        detection_limit=sentences.detection_limit,
        threshold=sentences.threshold(explanation),
        **_pictures(explanation),
    )


def _pictures(explanation: Explanation) -> dict[str, Any]:
    gap = explanation.gap
    both = [("before", gap.before), ("after", gap.after)]
    ladder = [("nothing added", gap.before), *((f"+ {one.effect}", one.gap) for one in explanation.steps)]
    return {
        "gap_picture": gap_chart("gap", "Gap before and after", both, gap.noise_floor, gap.unit),
        "ladder": gap_chart("ladder", "Gap after each step", ladder, gap.noise_floor, gap.unit),
        "maps": [
            (
                one.title,
                misfit_map_chart(f"map-{i}-before", f"{one.title}, before", one, one.before),
                misfit_map_chart(f"map-{i}-after", f"{one.title}, after", one, one.after),
            )
            for i, one in enumerate(explanation.maps)
        ],
        "panels": [(one, panel_chart(f"panel-{i}", one)) for i, one in enumerate(_worst_first(explanation.panels))],
        "pull_picture": pull_chart("pulls", explanation.pulls) if explanation.pulls else None,
    }


def _worst_first(panels: Sequence[Panel]) -> list[Panel]:
    """Return responses with those first that the model before misses most; other panels as they come."""
    return sorted(panels, key=lambda one: -_relative_error(one) if one.logarithmic else 0.0)


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


def _number(value: float, shown: str) -> Markup:
    """Show a number that a program finds in full in the same element, where it is known."""
    if math.isnan(value):
        return escape(shown)
    return Markup('<data value="{}">{}</data>').format(repr(float(value)), shown)


def _parameter_value(found: FoundParameter) -> Markup:
    value, uncertainty = found.estimate.value, found.estimate.standard_uncertainty
    return _number(value, rounding.with_uncertainty(value, uncertainty) + rounding.unit_shown(found.unit))


def _parameter_interval(found: FoundParameter) -> str:
    chosen = rounding.notation(found.estimate.value, found.estimate.standard_uncertainty)
    return rounding.between(*found.interval_95, chosen) + rounding.unit_shown(found.unit)
