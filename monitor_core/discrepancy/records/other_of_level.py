"""See which of two records of one level is wrong where nothing as described depends on what the level is of.

A record that was taken warm stands out, the other one does not. Either the first is wrong, or it is right and shows
what warmth does to the axis, and the second was not as warm as it says. The tag of the second changes nothing in a
model without an effect of temperature, and such an effect explains nothing while the tag counts as right: so both are
tried together, and the evidence decides between the two accounts.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from monitor_core.discrepancy.explanation import RecordFault, WrongRecord
from monitor_core.discrepancy.records.faults import slope_by_tag
from monitor_core.discrepancy.records.look import record_under
from monitor_core.discrepancy.screening.screen import screen
from monitor_core.effects.effect import ConditionAxis, Effect, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import HasRecords
from monitor_core.fitting.conditions.groups import levels_of
from monitor_core.fitting.evidence import VERY_STRONG, delta_bic, evidence_scale
from monitor_core.fitting.hold_out import fitted_values
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit

#: A described axis does not depend on it.
_TAG = "temperature_deviation"


def other_of_level(
    fitted: Fitted[Physics],
    whole: HasRecords[Physics],
    known: frozenset[int],
    worst: WrongRecord,
    candidates: Sequence[Effect[Physics]],
) -> WrongRecord | None:
    """Return the other record of its level that is wrong in the place of the worst one, None where that is wrong.

    Parameters
    ----------
    fitted : Fitted
        A fit in which the worst record stands out.
    whole : HasRecords
        All records, of which ``known`` are found to be wrong already.
    candidates : sequence of Effect
        What the axis may lack.
    """
    index, every = worst.number - 1, frozenset(range(len(whole.layout.settings)))
    levels = levels_of(whole.layout, ConditionAxis.TEMPERATURE)
    same = {int(each) for each in np.flatnonzero(levels == levels[index])} - known - {index}
    effects = [each for each in candidates if ConditionAxis.TEMPERATURE in each.needs]
    if not same or not effects or 2 * len(same) >= len(every) or _depends(fitted, whole):
        return None
    found: list[tuple[float, WrongRecord]] = []
    for other in sorted(same):
        found += _accounts(fitted, whole, every - known - {other}, other, effects)
    if not found:
        return None
    best, wrong = max(found, key=lambda pair: pair[0])
    alone = record_under(_refitted(fitted, whole.only(every - known - {index})), whole, index) or worst
    return wrong if best > max(alone.delta_bic, worst.delta_bic) + VERY_STRONG else None


def _accounts(
    fitted: Fitted[Physics],
    whole: HasRecords[Physics],
    kept: frozenset[int],
    other: int,
    effects: Sequence[Effect[Physics]],
) -> Iterator[tuple[float, WrongRecord]]:
    """Yield the evidence for each effect together with a tag of the other record, and that record."""
    without = _refitted(fitted, whole.only(kept))
    n_looks = len(whole.layout.settings) * len(RecordFault)
    for screened in screen(without, [effect for effect in effects if effect.applies(without.physics())]):
        hypothesis = without.hypothesis.with_effect(screened.effect)
        try:
            trial = fit(without.comparison, hypothesis, screened.starts[0], without.fitted)
        except OutsideValidityError:
            continue
        scale = evidence_scale(trial)
        evidence = delta_bic(without, trial, scale) - scale.penalty(1) - 2.0 * math.log(n_looks)
        values = hypothesis.values(trial.coordinates)[screened.effect.key]
        is_plausible = all(each.lower <= values[each.name] <= each.upper for each in screened.effect.parameters)
        record = record_under(trial, whole, other) if is_plausible else None
        if record is not None and record.fault is RecordFault.TEMPERATURE:
            yield evidence, record


def _refitted(fitted: Fitted[Physics], rest: HasRecords[Physics]) -> Fitted[Physics]:
    return fit(rest, fitted.hypothesis, fitted.coordinates, fitted_values(rest.layout))


def _depends(fitted: Fitted[Physics], whole: HasRecords[Physics]) -> bool:
    """Return whether a model depends on the temperature at all."""
    at = whole.tags(_TAG)
    return bool(np.any(slope_by_tag(whole, fitted.physics(), _TAG, at, np.ones_like(at))))
