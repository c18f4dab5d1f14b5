"""Say what would confirm what was described, or show its form: a place between those measured, a part, two settings.

Each step is one sentence with a quantity of this machine and what the description expects of it.
"""

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from monitor_core.discrepancy.explanation import Described
from monitor_core.discrepancy.verdict.what_is_left import plain
from monitor_core.effects import ConditionAxis, Form, Law, Variable
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Layout
from monitor_core.fitting.conditions.groups import levels_of

#: What a law may follow that is set, with its unit and how many of those one SI unit is.
_SET = {
    Variable.POSITION: (ConditionAxis.POSITION, "mm", 1e3),
    Variable.PRELOAD: (ConditionAxis.PRELOAD, "N", 1.0),
    Variable.PAYLOAD: (ConditionAxis.PAYLOAD, "kg", 1.0),
    Variable.TEMPERATURE: (ConditionAxis.TEMPERATURE, "K", 1.0),
    Variable.EXCITATION: (ConditionAxis.LEVEL, "", 1.0),  # N or N·m, by what excites
}
#: About a resonance, what shows it whole. [of its frequency]
_ABOUT = (0.8, 1.2)


def checks_of_described(found: Described, layout: Layout) -> Iterator[str]:
    """Yield what to measure next of one thing that was described."""
    if found.has_no_form:
        yield from _two_settings(found)
        return
    if found.frequency_hz is not None:
        yield from _part_that_swings(found, layout)
    if found.law is not None:
        yield from _between(found, found.law, layout)


def _two_settings(found: Described) -> Iterator[str]:
    ranked = sorted(found.factors, key=lambda name: found.factors[name])
    least, most = ranked[0], ranked[-1]
    yield (
        f"measure {least} and {most} again, three times in turns: {found.parameter} at the {found.place} would be "
        f"{plain(found.factors[least], 3)} times what it is at the first and {plain(found.factors[most], 3)} times at "
        "the second; what stays follows from how the axis is set, what does not from time"
    )


def _part_that_swings(found: Described, layout: Layout) -> Iterator[str]:
    frequency, size, unit = found.frequency_hz, found.mass_kg, "kg"
    if found.inertia_kg_m2 is not None:
        size, unit = found.inertia_kg_m2, "kg·m²"
    if frequency is None:
        return
    if size is None:
        if found.place == "screw":
            yield (
                f"tap the screw across, near its middle, with an accelerometer on it there: one that bends rings at "
                f"{plain(frequency)} Hz; then look whether nut, guides and bearings are in line"
            )
        return
    low, high = (plain(share * frequency) for share in _ABOUT)
    yield (
        f"look at the {found.place} for what swings at {plain(frequency)} Hz with {plain(size)} {unit}, hold it fast "
        f"or take it off, and measure {layout.settings[0].name} again from {low} to {high} Hz: the resonance must go"
    )


def _between(found: Described, law: Law, layout: Layout) -> Iterator[str]:
    """Yield a setting between those measured, where the law says what no measurement has."""
    if law.variable is Variable.ORDER:
        factor = _factor(found, law, 1.0)
        yield (
            f"measure {layout.settings[0].name}, the first that was measured, again now: {found.parameter} would be "
            f"{_times(factor)} of what it was then, if it goes with time"
        )
        return
    axis, unit, per = _SET[law.variable]
    measured = levels_of(layout, axis)
    levels = np.unique(measured[np.isfinite(measured)])
    if levels.size < 2:
        return
    if law.form in (Form.PERIODIC, Form.YIELDING):
        start = float(levels[levels.size // 2])
        at = [start + share * law.scale for share in (0.25, 0.5, 0.75)]
        listed = ", ".join(plain(per * x, 4) for x in at)
        factors = ", ".join(_times(_factor(found, law, x)) for x in at)
        whole = "its mean" if law.form is Form.PERIODIC else "what is stated"
        yield (
            f"measure within one turn of the screw, at {listed} {unit}: {found.parameter} would be {factors} of {whole}"
        )
        return
    where, unit = ("at", f" {unit}") if unit else (f"{layout.settings[0].name} at an excitation level of", "")
    low, high = max(pairwise(levels.tolist()), key=lambda pair: pair[1] - pair[0])
    middle = math.sqrt(low * high) if law.variable is Variable.EXCITATION and low > 0.0 else 0.5 * (low + high)
    there, at_the_lower = (_times(_factor(found, law, x)) for x in (middle, low))
    yield (
        f"measure {where} {plain(per * middle)}{unit}, between {plain(per * low)} and {plain(per * high)}, where "
        f"nothing was measured: by this law {found.parameter} would be {there} of its level there, and "
        f"{at_the_lower} at {plain(per * low)}{unit}"
    )


def _factor(found: Described, law: Law, x: float) -> float:
    coefficients = tuple(found.parameters[item.name].estimate.value for item in law.parameters)
    try:
        return law.factor(x, coefficients)
    except OutsideValidityError:
        return math.nan


def _times(factor: float) -> str:
    return f"{plain(100.0 * factor)} %" if math.isfinite(factor) else "hardly any"
