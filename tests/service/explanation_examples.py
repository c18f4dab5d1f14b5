"""Explanations of every outcome, as tests of their reports need them, and a page as it is read."""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise

import numpy as np

from monitor_core.discrepancy import Dimension, Extent
from monitor_core.discrepancy.explanation import (
    Candidate,
    Described,
    Explanation,
    FoundEffect,
    FoundParameter,
    Gap,
    GapPair,
    Misfit,
    MisfitKind,
    MisfitMap,
    MisfitPlace,
    NextStep,
    Outcome,
    Step,
    StepEffect,
    StepKind,
    Untested,
    UntestedReason,
)
from monitor_core.effects import ConditionAxis, Form, Law, Variable, varying
from monitor_core.shown import Panel
from monitor_core.uncertainty import Estimate
from service.report.page import explanation_page

SUBJECT = "x-axis.frf.h5 against hybrid.toml"
MODEL = 'family = "hybrid"\n\n[parameters]\ntable_mass_kg = 20.54\n\n[effects.added-mass]\nmass_kg = 0.81\n'
#: Names as a user's own file of effects might bring them.
HOSTILE = '"><script>alert(1)</script>&amp;|`*'
TEMPERATURE, LEVEL = ConditionAxis.TEMPERATURE, ConditionAxis.LEVEL
VOID = {"meta", "link", "br", "hr", "img", "input"}
FAR_BEARING = FoundEffect(
    key="far-bearing-stiffness",
    name="Stiffness of the far bearing",
    physics="The far end of the screw is held axially; the axis is stiffer there, and the more so the nearer the nut.",
    parameters={"stiffness_n_per_m": FoundParameter(Estimate(3.8e7, 1.0e6), "N/m", (3.6e7, 4.0e7), plausible=True)},
    equivalent_to=(),
    delta_bic=41.2,
    held_out_log_likelihood_gain=33.0,
)
ADDED_MASS = FoundEffect(
    key="added-mass",
    name="Mass that the description leaves out",
    physics="A mass moves with the table.",
    parameters={"mass_kg": FoundParameter(Estimate(-13.6, 0.4), "kg", (-14.4, -12.8), plausible=False)},
    equivalent_to=(),
    delta_bic=212.0,
    held_out_log_likelihood_gain=151.0,
)
CANDIDATES = (
    Candidate("thermal-preload", math.nan, math.nan, None, "N/K", Untested(UntestedReason.NOT_VARIED, (TEMPERATURE,))),
    Candidate("guide-friction", -6.2, -0.4, 14.0, "N"),
    Candidate("loss-factor", 2.4, 0.3, 0.0021, "-"),
    Candidate("base-compliance", -11.9, -2.0, 4.3e-10, "m/N"),
    Candidate("wrong-parameter:bearing_stiffness_n_per_m", -13.0, -2.1, math.log(5.0), "-"),
    Candidate("wrong-parameter:table_mass_kg", -14.0, -2.2, 0.04, "-"),
)
FAR_END = MisfitPlace((Extent(Dimension.POSITION, (0.5, 0.85)), Extent(Dimension.BAND, (150.0, 200.0))))
ONE_PRELOAD = MisfitPlace((Extent(Dimension.PRELOAD, (400.0, 400.0)), Extent(Dimension.BAND, (24.0, 60.0))))
LOCALISATION = (
    Misfit(FAR_END, 8.31, MisfitKind.STIFFNESS, 3.0e-9),
    Misfit(ONE_PRELOAD, 1.74, MisfitKind.UNCLEAR, 0.013),
)
SETTINGS = ("150 mm, 250 N", "300 mm, 250 N", "500 mm, 250 N", "700 mm, 250 N", "850 mm, 400 N, +6 kg, +15 K")
EDGES = (24.0, 60.0, 120.0, 150.0, 200.0, 400.0, 800.0, 1500.0)
BANDS = tuple(Extent(Dimension.BAND, ends) for ends in pairwise(EDGES))


def misfit_map() -> MisfitMap:
    """Return a map with its worst place at the far end around the first mode, and an empty cell."""
    rng = np.random.default_rng(1)
    after = 1.0 + 0.15 * rng.standard_normal((len(SETTINGS), len(BANDS)))
    before = after + 9.0 * np.outer(np.linspace(0.1, 1.0, len(SETTINGS)), np.exp(-((np.arange(7) - 3.0) ** 2)))
    before[0, 6] = after[0, 6] = np.nan
    rows = tuple(Extent(Dimension.SETTINGS, names=(name, name)) for name in SETTINGS)
    return MisfitMap(None, rows, BANDS, before, after)


def panels() -> tuple[Panel, ...]:
    """Return responses with a gap in the data, one held out, and a natural frequency over three positions."""
    f = np.linspace(24.0, 1500.0, 1477)
    rng = np.random.default_rng(2)

    def response(natural: float) -> np.ndarray:
        return np.abs(f**2 / (natural**2 - f**2 + 0.03j * natural * f)) / 20.0

    made = []
    for i, position in enumerate((150, 300, 500, 700, 850)):
        true = response(180.0 + 8.0 * i)
        measured = true * np.exp(0.02 * rng.standard_normal(f.size))
        measured[600:640] = np.nan
        models: Mapping[str, np.ndarray] = {"before": response(176.0), "after": true}
        made.append(
            Panel(
                f"{position} mm, 250 N", "frequency [Hz]", "|torque accelerance| [m/(N·m·s²)]", f, measured, models,
                logarithmic=True, held_out=i in {1, 3},
            )
        )  # fmt: skip
    x = np.array([300.0, 500.0, 700.0])
    frequency = np.array([176.0, 181.2, 190.4])
    models = {"before": frequency - [1.0, 4.0, 11.0], "after": frequency + 0.1}
    return (*made, Panel("first mode, 200 N", "position [mm]", "natural frequency [Hz]", x, frequency, models))


def explanation(outcome: Outcome) -> Explanation:
    """Return an example of each outcome."""
    named = Explanation(
        outcome=Outcome.NAMED,
        effects=(FAR_BEARING,),
        localisation=LOCALISATION,
        remainder=(),
        gap=Gap("sigma", 1.0, GapPair(12.1, 12.6), GapPair(1.02, 1.07)),
        steps=(Step(("far-bearing-stiffness",), GapPair(1.02, 1.07)),),
        candidates=CANDIDATES,
        pulls={"position": 0.93, "preload": 1.12, "gain": 0.71, "table_mass_kg": 0.2},
        least_delta_bic=50.0,
        next_steps=(NextStep(StepKind.KNOWN_MASS, ConditionAxis.PAYLOAD, values={"mass_kg": 6.0}),),
        ln_ratios={"table_mass_kg": 0.02},
        added={"far-bearing-stiffness": {"stiffness_n_per_m": 3.8e7}},
        panels=panels(),
        maps=(misfit_map(),),
        gap_by_channel={"acceleration-at-table, amplitude": (9.1, 1.04), "acceleration-at-table, phase": (14.5, 0.998)},
    )
    match outcome:
        case Outcome.NAMED:
            return named
        case Outcome.EQUIVALENT:
            alike = replace(FAR_BEARING, equivalent_to=("screw-axial-stiffness", "torsional-flexibility"))
            return replace(named, outcome=outcome, effects=(alike,))
        case Outcome.PARTIAL:
            return replace(
                named,
                outcome=outcome,
                effects=(FAR_BEARING, ADDED_MASS),
                remainder=LOCALISATION[1:],
                gap=Gap("Hz", 0.13, GapPair(63.3, 63.1), GapPair(2.7, 3.4)),
                steps=(
                    Step(("far-bearing-stiffness",), GapPair(7.27, 8.1)),
                    Step(("added-mass",), GapPair(2.7, 3.4)),
                ),
                pulls={**named.pulls, "preload": 4.8},
            )
        case Outcome.NONE:
            same = GapPair(1.01, 0.98)
            return replace(
                named, outcome=outcome, effects=(), localisation=(), gap=Gap("sigma", 1.0, same, same), steps=()
            )
        case Outcome.DESCRIBED:
            estimate = FoundParameter(Estimate(-0.31, 0.02), "-", (-0.35, -0.27), plausible=True)
            law = Law(Variable.EXCITATION, Form.POWER, reference=0.15, scale=0.4)
            softening = Described(
                place="nut",
                parameter="nut stiffness",
                law=law,
                parameters={"exponent": estimate},
                effects=(varying("joints", "nut_stiffness", law),),
                alternatives=(),
                share=0.97,
                delta_bic=312.0,
                held_out_log_likelihood_gain=84.0,
            )
            return replace(named, outcome=outcome, effects=(), steps=(), described=(softening,))
        case Outcome.UNKNOWN:
            same = GapPair(6.3, math.nan)
            return replace(named, outcome=outcome, effects=(), gap=Gap("%", 0.4, same, same), steps=(), pulls={})


EXAMPLES = {outcome: explanation(outcome) for outcome in Outcome}


class Page(HTMLParser):
    """What the tests ask of a page: is it well formed, which elements with which attributes, which text in which."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[tuple[str, ...], str]] = []
        self.data: list[tuple[float, str]] = []  # value and what is shown of it
        self.cells: list[str] = []  # of the maps
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert not self._open, f"left open: {self._open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append((tuple(self._open), data))
        _, last = self.elements[-1] if self.elements else ("", {})
        if self._open[-1:] == ["data"]:
            self.data.append((float(str(last["value"])), data))
        if self._open[-1:] == ["text"] and str(last.get("class")).startswith("on-"):
            self.cells.append(data)

    def all(self, tag: str, **wanted: str) -> list[dict[str, str | None]]:
        """Return the attributes of the elements of a tag, `class_` and others as given."""
        names = {name.rstrip("_"): value for name, value in wanted.items()}
        return [found for name, found in self.elements if name == tag and names.items() <= found.items()]

    def text(self) -> str:
        return " ".join(" ".join(data for within, data in self.texts if "style" not in within).split())


def number_in(shown: str) -> float:
    """Read back what a person reads: a number, perhaps with an uncertainty and a power of ten."""
    found = re.match(r"\(?(-?[\d.]+)(?: ± [\d.]+\))?(?: × 10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+))?", shown.replace("−", "-"))
    assert found is not None, shown
    return float(found[1]) * 10.0 ** int((found[2] or "0").translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")))


def page_of(example: Explanation) -> Page:
    return Page(explanation_page(example, MODEL, SUBJECT))


def hostile(example: Explanation) -> Explanation:
    """Return the example with such names in all places that a file of a user can fill."""
    effect = replace(
        example.effects[0], key=HOSTILE, name=HOSTILE, physics=HOSTILE, equivalent_to=(HOSTILE,), aliases=(HOSTILE,),
        parameters={HOSTILE: replace(ADDED_MASS.parameters["mass_kg"], unit=HOSTILE)},
    )  # fmt: skip
    hostile_extent = Extent(Dimension.CHANNEL, names=(HOSTILE,))
    panel = replace(example.panels[-1], title=HOSTILE, x_name=HOSTILE, y_name=HOSTILE)
    return replace(
        example,
        effects=(effect,),
        localisation=(replace(LOCALISATION[0], place=MisfitPlace((hostile_extent,))),),
        gap=replace(example.gap, unit=HOSTILE),
        steps=(Step((HOSTILE,), example.gap.after), Step((HOSTILE,), example.gap.after)),
        candidates=(
            Candidate(HOSTILE, 1.0, 1.0, 1.0, HOSTILE, Untested(UntestedReason.TIME_UP)),
            Candidate(HOSTILE, 1.0, 1.0, 1.0, HOSTILE),
        ),
        pulls={HOSTILE: 1.0},
        next_steps=(NextStep(StepKind.VARY, LEVEL, effects=(StepEffect(HOSTILE),)),),
        panels=(replace(panel, models={HOSTILE: panel.measured}),),
        gap_by_channel={HOSTILE: (1.0, 1.0), f"{HOSTILE} twice": (1.0, 1.0)},
        maps=(MisfitMap(None, (hostile_extent,), (hostile_extent,), np.array([[1.0]]), np.array([[np.nan]])),),
    )
