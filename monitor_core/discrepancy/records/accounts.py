"""See what else may account for a warm record that stands out: what warmth does, and another that was not warm.

A record that was taken warm stands out, the others of its level do not. Either it is wrong; or it is right, shows what
warmth does to the axis, and the fit has bent to another; or another was not as warm as it says. The tag of that one
changes nothing in a model without an effect of temperature, and such an effect explains little while the tag counts as
right: so both are tried together, and the evidence decides between the accounts.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Generic

import numpy as np

from monitor_core.discrepancy.explanation import RecordFault, WrongRecord
from monitor_core.discrepancy.records.faults import TAGS, slope_by_tag
from monitor_core.discrepancy.records.look import record_under
from monitor_core.discrepancy.screening.screen import screen
from monitor_core.effects.effect import ConditionAxis, Effect, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import HasRecords
from monitor_core.fitting.conditions.groups import levels_of
from monitor_core.fitting.evidence import VERY_STRONG, EvidenceScale, delta_bic, evidence_scale
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit

#: A described axis does not depend on it.
_TAG = "temperature_deviation"


@dataclass(frozen=True, slots=True)
class Account:
    """What accounts for a record that stands out and is right."""

    wrong: WrongRecord | None  # that is wrong in its place; None where all are right
    right: frozenset[int]  # what stands out until the effect is known, by their settings


def accounted_for(
    fitted: Fitted[Physics],
    whole: HasRecords[Physics],
    known: frozenset[int],
    worst: WrongRecord,
    candidates: Sequence[Effect[Physics]],
) -> Account | None:
    """Return what accounts better for the worst record than that it is wrong; None if nothing does.

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
    same = frozenset(np.flatnonzero(levels == levels[index]).tolist()) - known
    effects = [each for each in candidates if ConditionAxis.TEMPERATURE in each.needs]
    if len(same) < 2 or not effects or 2 * len(same) > len(every) or _depends(fitted, whole):
        return None
    alone = record_under(_refitted(fitted, whole.only(every - known - {index})), whole, index) or worst
    best, least = None, VERY_STRONG
    for other in (None, *sorted(same - {index})):
        kept = every - known if other is None else every - known - {other}
        for trial in _trials(_refitted(fitted, whole.only(kept)), effects):
            wrong = None if other is None else record_under(trial.fitted, whole, other)
            if other is not None and (wrong is None or wrong.fault is not RecordFault.TEMPERATURE):
                continue
            of_tag = trial.scale.penalty(1) + 2.0 * math.log(len(every) * len(RecordFault))
            advantage = trial.evidence - _evidence(trial, alone, of_tag) - (0.0 if other is None else of_tag)
            if advantage > least:
                best, least = Account(wrong, same if other is None else frozenset((index,))), advantage
    return best


@dataclass(frozen=True, slots=True, eq=False)
class _Trial(Generic[Physics]):
    """A fit with an effect against the one without it, of the same records."""

    without: Fitted[Physics]
    fitted: Fitted[Physics]
    scale: EvidenceScale

    @property
    def evidence(self) -> float:
        """Evidence for the effect."""
        return delta_bic(self.without, self.fitted, self.scale)


def _trials(without: Fitted[Physics], effects: Sequence[Effect[Physics]]) -> Iterator[_Trial[Physics]]:
    """Yield the fits with each effect, as far as its values are plausible."""
    for screened in screen(without, [effect for effect in effects if effect.applies(without.physics())]):
        hypothesis = without.hypothesis.with_effect(screened.effect)
        try:
            fitted = fit(without.comparison, hypothesis, screened.starts[0])
        except OutsideValidityError:
            continue
        values = hypothesis.values(fitted.coordinates)[screened.effect.key]
        if all(each.lower <= values[each.name] <= each.upper for each in screened.effect.parameters):
            yield _Trial(without, fitted, evidence_scale(fitted))


def _evidence(trial: _Trial[Physics], alone: WrongRecord, of_tag: float) -> float:
    """Return the evidence for one wrong record in the place of an effect, from the same records.

    With another tag, which costs ``of_tag``, it is fitted with the others, as the effect is.
    """
    of_fault = {fault: (tag, per_unit) for tag, (fault, _, per_unit) in TAGS.items()}
    without, records = trial.without, trial.without.comparison
    if alone.fault not in of_fault or not isinstance(records, HasRecords):
        return alone.delta_bic
    tag, per_unit = of_fault[alone.fault]
    values = np.where(
        [each == alone.observations for each in records.records], alone.found / per_unit, records.tags(tag)
    )
    try:
        retagged = fit(records.retagged(tag, values), without.hypothesis, without.coordinates)
    except OutsideValidityError:
        return alone.delta_bic
    return delta_bic(without, retagged, trial.scale) - of_tag


def _refitted(fitted: Fitted[Physics], rest: HasRecords[Physics]) -> Fitted[Physics]:
    """Return the fit to all values of some records, held out or not."""
    return fit(rest, fitted.hypothesis, fitted.coordinates)


def _depends(fitted: Fitted[Physics], whole: HasRecords[Physics]) -> bool:
    """Return whether a model depends on the temperature at all."""
    at = whole.tags(_TAG)
    return bool(np.any(slope_by_tag(whole, fitted.physics(), _TAG, at, np.ones_like(at))))
