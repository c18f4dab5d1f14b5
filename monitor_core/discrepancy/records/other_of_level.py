"""See which of two records of one level is wrong where nothing as described depends on what the level is of.

A record that was taken warm stands out, the other one does not. Either the first is wrong, or it is right and shows
what warmth does to the axis, and the second was not as warm as it says. The tag of the second changes nothing in a
model without an effect of temperature, and such an effect explains nothing while the tag counts as right: so both are
tried together, and the evidence decides between the two accounts.
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
    alone = record_under(_refitted(fitted, whole.only(every - known - {index})), whole, index) or worst
    accounts = [
        account
        for other in sorted(same)
        for account in _accounts(fitted, whole, every - known - {other}, other, effects)
        if account.evidence > _evidence(account, whole, alone) + VERY_STRONG
    ]
    return max(accounts, key=lambda account: account.evidence).wrong if accounts else None


@dataclass(frozen=True, slots=True, eq=False)
class _Account(Generic[Physics]):
    """An effect, and a record that is not as warm as it says."""

    wrong: WrongRecord
    evidence: float  # for both
    without: Fitted[Physics]  # the effect, of all records but that one
    scale: EvidenceScale


def _accounts(
    fitted: Fitted[Physics],
    whole: HasRecords[Physics],
    kept: frozenset[int],
    other: int,
    effects: Sequence[Effect[Physics]],
) -> Iterator[_Account[Physics]]:
    """Yield the evidence for each effect together with a tag of the record that is not among those that are kept."""
    without = _refitted(fitted, whole.only(kept))
    for screened in screen(without, [effect for effect in effects if effect.applies(without.physics())]):
        hypothesis = without.hypothesis.with_effect(screened.effect)
        try:
            trial = fit(without.comparison, hypothesis, screened.starts[0], without.fitted)
        except OutsideValidityError:
            continue
        values = hypothesis.values(trial.coordinates)[screened.effect.key]
        is_plausible = all(each.lower <= values[each.name] <= each.upper for each in screened.effect.parameters)
        wrong = record_under(trial, whole, other) if is_plausible else None
        if wrong is not None and wrong.fault is RecordFault.TEMPERATURE:
            scale = evidence_scale(trial)
            evidence = delta_bic(without, trial, scale) - _of_tag(scale, whole)
            yield _Account(wrong, evidence, without, scale)


def _evidence(account: _Account[Physics], whole: HasRecords[Physics], alone: WrongRecord) -> float:
    """Return the evidence for one wrong record in the place of an account, from the same records.

    With another tag the record is fitted with the others, as the effect is.
    """
    tag, per_unit = next(
        ((tag, per_unit) for tag, (fault, _, per_unit) in TAGS.items() if fault is alone.fault), ("", 1.0)
    )
    without = account.without
    rest = without.comparison
    if not tag or not isinstance(rest, HasRecords):
        return alone.delta_bic
    values = np.where([each == alone.observations for each in rest.records], alone.found / per_unit, rest.tags(tag))
    try:
        retagged = fit(rest.retagged(tag, values), without.hypothesis, without.coordinates, without.fitted)
    except OutsideValidityError:
        return alone.delta_bic
    return delta_bic(without, retagged, account.scale) - _of_tag(account.scale, whole)


def _of_tag(scale: EvidenceScale, whole: HasRecords[Physics]) -> float:
    """Return what a tag of one record costs, as any fault of any record might have been found."""
    return scale.penalty(1) + 2.0 * math.log(len(whole.layout.settings) * len(RecordFault))


def _refitted(fitted: Fitted[Physics], rest: HasRecords[Physics]) -> Fitted[Physics]:
    return fit(rest, fitted.hypothesis, fitted.coordinates, fitted_values(rest.layout))


def _depends(fitted: Fitted[Physics], whole: HasRecords[Physics]) -> bool:
    """Return whether a model depends on the temperature at all."""
    at = whole.tags(_TAG)
    return bool(np.any(slope_by_tag(whole, fitted.physics(), _TAG, at, np.ones_like(at))))
