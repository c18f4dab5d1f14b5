"""Describe which quantity of a drive is another one at the levels of a variable, by the simplest form that keeps it.

A place that is worn, a step, a torque that saturates, a mass that is lost: what no smooth law has is seen where a
quantity may have a value at each level, whatever its neighbours have. Which variable it follows the evidence says
before anything is fitted (:mod:`.variation`); which quantity does is told by fits of everything.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

from monitor_core.discrepancy.description.answers import Answer, Base, without_form
from monitor_core.discrepancy.description.describe import (
    Description,
    best_first,
    best_of,
    closer_variations,
    may_be_described,
    refit_with_law,
)
from monitor_core.discrepancy.description.variation import (
    FreeVariation,
    constant_law,
    evidence_of_variables,
    fitted_settings,
    judged_on_lines,
    law_of_levels,
    quantities_of,
    scale_of,
    tried_laws,
    vary_freely,
)
from monitor_core.effects import Variable
from monitor_core.effects.variation import GEAR_RATIO
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.conditions.groups import has_lines
from monitor_core.fitting.solver.hypothesis_fit import Fitted, unfitted

#: Quantities that have a value at each level, and forms that are refitted in the place of those values.
_AT_LEVELS, _FORMS = 6, 3
#: Quantities that a variable is told by, of those that leave least where they vary freely.
_SURE = 3
_ANY: tuple[Variable | None, ...] = (None, *Variable)


def describe_levels(baseline: Fitted[Any], final: Fitted[Any], progress: Callable[[str], None]) -> Description | None:
    """Return which quantity is another one at the levels of a variable, in the simplest form, or by none; or None.

    It is sought in all settings, and judged on lines of each that were held out: what is local cannot be told where
    nothing was fitted. A quantity has a value at each level first, fitted with everything else, and the simplest form
    is one that keeps the evidence for that.
    """
    if not (may_be_described(baseline) and has_lines(baseline.comparison.layout)):
        return None
    progress("describing what is left, level by level")
    with suppress(OutsideValidityError):
        again = {fitted: judged_on_lines(fitted) for fitted in (baseline, final)}
        for before in again.values():
            # where the fit went astray, each quantity is seen in the axis as stated
            base = Base(before, named=before.hypothesis.keys)
            if before.tolerance:
                base = replace(base, fitted=unfitted(before), before=before)
            roughly = (vary_freely(base.fitted, each, roughly=True) for each in quantities_of(base.fitted.physics()))
            variations = best_first(roughly)
            answers = list(_answers_at_levels(base, variations, progress))
            if (best := best_of(answers, before, again[final], before=again[baseline])) is not None:
                return best
        varied = ((each, variation) for each in again.values() for variation in closer_variations(each))
        if (unformed := without_form(list(varied))) is not None:
            return Description(unformed, None, final.hypothesis.keys)
    return None


def _answers_at_levels(
    base: Base, variations: Sequence[FreeVariation], progress: Callable[[str], None]
) -> Iterator[Answer]:
    """Yield fits of the laws of each quantity that have a value at each level of a variable, and of forms of the best.

    The variable is that which the evidence is for, of all quantities that might vary: which of them does is told by
    what the fits leave.
    """
    fitted, settings = base.fitted, fitted_settings(base.fitted)
    evidence = {each: evidence_of_variables(each, settings, scale_of(fitted, each).factor) for each in variations}
    sure = [of_one for of_one in evidence.values() if max(of_one.values()) > 0.0][:_SURE]
    totals = {variable: sum(of_one.get(variable, 0.0) for of_one in sure) for variable in _ANY}
    variable = max(totals, key=lambda each: totals[each])
    going = [each for each in variations if variable and evidence[each].get(variable, 0.0) > 0.0]
    of_levels = [law_of_levels(each, variable, settings) for each in going[:_AT_LEVELS] if variable]
    of_levels += [constant_law(each) for each in variations if each.quantity.field == GEAR_RATIO]
    answers = [answer for law in of_levels if (answer := refit_with_law(base, law, progress)) is not None]
    yield from answers
    best = min(answers, key=lambda answer: answer.fitted.cost, default=None)
    if variable is None or best is None or best.tried is None or best.tried.law.variable is not variable:
        return
    fitted, n_own = best.fitted, len(best.effect.parameters)
    plain = fitted.hypothesis.without(best.effect.key)
    others = fitted.coordinates[: fitted.coordinates.size - n_own]
    again = vary_freely(fitted, best.tried.variation.quantity, here=plain.physics(others))
    for tried in () if again is None else tried_laws(fitted, again, variable)[:_FORMS]:
        if (answer := refit_with_law(base, tried, progress, others)) is not None:
            yield answer
