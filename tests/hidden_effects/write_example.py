"""Write the bundled example in which an effect is found: ``python -m tests.hidden_effects.write_example``.

A machine of the transmission-line plant, which shares no formula with the models, about the description of its maker;
a cover swings on its table, of which the description knows nothing. Written are the responses at the table, the
description, what is hidden in truth, and the picture in the README: of what ``preload explain`` makes of the first two.
"""

import sys
from dataclasses import replace
from pathlib import Path

from markupsafe import Markup

from monitor_core.discrepancy import Explanation, explain
from monitor_core.recordings.frf_set import read_frf_set
from monitor_core.recordings.model_file import read_model_file
from service.report.hero import WIDE, hero_chart, largest_gap, zoomed
from service.report.svg import element
from tests.hidden_effects.cases import Case, draw_case
from tests.hidden_effects.frf_file import write_case
from tests.hidden_effects.truth import transmission_line

PROJECT = Path(__file__).resolve().parents[2]
FOLDER = PROJECT / "replay_data" / "hidden-effect"
PICTURE = PROJECT / "docs" / "figures" / "hidden-effect.svg"
NAME = "mill"
HIDDEN = "table-absorber"
#: Of the 31 settings of a blind case: enough to find it, and small enough to be bundled.
PRELOADS = (120.0, 220.0)  # [N]
SEED = 500
_STYLE = """
svg { background: #fff; } text { font: 12px system-ui, sans-serif; fill: #1c2530; }
.quiet { fill: #5b6875; } .frame { fill: none; stroke: #5b6875; } .grid { stroke: #d8dee5; }
.model { fill: none; stroke-width: 1.6; } .model.before { stroke: #b85c00; stroke-dasharray: 6 3; }
.model.after { stroke: #1f5f99; } path.measured { fill: none; stroke: #7d8894; stroke-width: 4; stroke-opacity: .6; }
circle.measured { fill: none; stroke: #7d8894; stroke-width: 2; } .point.before { fill: #b85c00; }
.point.after { fill: #1f5f99; } .reference { stroke: #1c2530; stroke-width: 1.5; stroke-dasharray: 5 3; }
"""


def example() -> Case:
    """Return the case, with the responses of the table alone, at two preloads."""
    case = draw_case(HIDDEN, "large", seed=SEED, respond=transmission_line.respond)
    kept = [
        frf for frf in case.measured if frf.output == "acceleration-at-table" and frf.stated.preload in PRELOADS
    ]  # fmt: skip
    return replace(case, measured=tuple(kept))


def explained(folder: Path = FOLDER) -> Explanation:
    """Return what the workflow makes of the files."""
    responses = read_frf_set(folder / f"{NAME}.frf.h5").observations
    return explain(read_model_file(folder / f"{NAME}.toml"), responses)


def truth_text(case: Case) -> str:
    """Return what is hidden, as a model file would have it."""
    lines = ["# What is hidden in the machine; the workflow is not given this file."]
    for key, values in case.truth.items():
        lines += ["", f"[effects.{key}]", *(f"{name} = {value!r}" for name, value in values.items())]
    return "\n".join(lines) + "\n"


def drawn(explanation: Explanation) -> str:
    """Return the first picture of the report as a file of its own."""
    panel = largest_gap(explanation.panels)
    if panel is None:
        raise ValueError("an explanation of responses has a picture; got none")
    said = {"before": "model of the maker", "after": "with the swinging cover that was found"}
    chart = str(hero_chart("hidden-effect", zoomed(panel), WIDE, said))
    sized = chart.replace("<svg ", f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDE.width:g}" ', 1)
    return sized.replace(">", f">{element('style', Markup(_STYLE))}", 1) + "\n"  # noqa: S704 - a style sheet of ours


def main() -> None:
    """Write the files and the picture; say what was found."""
    case = example()
    FOLDER.mkdir(exist_ok=True)
    write_case(case, FOLDER, NAME)
    (FOLDER / "truth.toml").write_text(truth_text(case), encoding="utf-8")
    explanation = explained()
    PICTURE.write_text(drawn(explanation), encoding="utf-8")
    sys.stdout.write(f"{explanation.outcome}: {', '.join(effect.key for effect in explanation.effects)}\n")


if __name__ == "__main__":
    main()
