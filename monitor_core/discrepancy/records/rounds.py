r"""Take out wrong records one by one, worst first, before anything is explained and again with what was found.

A wrong record pulls the fit towards itself. What is left of its misfit is small then, and other records stand out in
its place. With the residuals r of the fit, their derivatives J by its coordinates, the precision
:math:`G = J^T J + \Pi` with the priors', and the change d of the residuals by a tag of one record, a linear refit with
that tag free takes

.. math::

    \Delta\chi^2 = \frac{(d^T r)^2}{d^T d - d^T J G^{-1} J^T d}

Added-variable test of a mean shift (Cook and Weisberg, Residuals and Influence in Regression, 1982, section 2.2).

A record that was taken warm may stand out where the others of its level do not. Either it is wrong; or it is right,
shows what warmth does to the axis, and the fit has bent to another; or another was not as warm as it says. The tag of
that one changes nothing in a model without an effect of temperature, and such an effect explains little while the tag
counts as right: so both are tried together, and the evidence decides between the accounts.
"""

import math
from collections.abc import Callable, Iterator, Sequence, Set as AbstractSet
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.explanation import RecordFault, WrongRecord
from monitor_core.discrepancy.records.single import STANDS_OUT, TAGS, record_under, slope_by_tag, worst_record
from monitor_core.discrepancy.screening.screen import screen
from monitor_core.effects.effect import ConditionAxis, Effect, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.axis import DescribedAxis
from monitor_core.fitting.comparison import Comparison, HasRecords
from monitor_core.fitting.conditions.groups import levels_of
from monitor_core.fitting.evidence import VERY_STRONG, EvidenceScale, delta_bic, evidence_scale
from monitor_core.fitting.hold_out import fitted_values, judged_gap
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit

#: Of the squares of a direction, what a refit must leave of it for it to say anything.
_LEAST_LEFT = 1e-3
#: Of a range of tags, to see how the misfit moves with one.
_STEP = 1e-3


def bent_to(fitted: Fitted[Physics], records: HasRecords[Physics]) -> dict[int, float]:
    """Return the records of a fit that would very strongly have a tag or gain of their own, with the evidence for it.

    By their places, best first. ``records`` is the comparison that was fitted. A record that was held out has bent
    nothing.
    """
    taken = np.max([taken_by_each(fitted, row) for row in _directions(fitted, records)], axis=0)
    scale = evidence_scale(fitted)
    price = 2.0 * math.log(taken.size * len(RecordFault))
    evidence = scale.factor * taken - scale.penalty(1) - price
    order = np.argsort(-evidence, kind="stable")
    return {index: float(evidence[index]) for index in order.tolist() if evidence[index] > VERY_STRONG}


def _directions(fitted: Fitted[Physics], records: HasRecords[Physics]) -> Iterator[FloatArray]:
    """Yield the changes of the misfit by the condition errors, and by the tags that are none, shape (n_values,)."""
    whitened_by = fitted.around.whitened_by
    yield from whitened_by.directions * whitened_by.deviation
    physics = fitted.physics()
    ranges = records.tag_ranges(physics, 0)
    for tag in TAGS:
        if tag in ranges and tag not in {"position", "preload"}:
            tags, (low, high) = records.tags(tag), ranges[tag]
            try:
                yield slope_by_tag(records, physics, tag, tags, np.full_like(tags, _STEP * (high - low)))
            except OutsideValidityError:
                continue


def taken_by_each(fitted: Fitted[Physics], change: FloatArray) -> FloatArray:
    """Return what an unknown amount of a change of the misfit in one record alone takes of χ², (n_settings,).

    Everything else is refitted, as far as the misfit is linear in it.
    """
    chosen, setting = fitted.fitted, fitted.comparison.layout.setting
    n_settings = len(fitted.comparison.layout.settings)
    along = np.where(chosen, fitted.around.whitened_by(change), 0.0)
    inverse = np.linalg.pinv(fitted.precision(), hermitian=True)

    def sums(values: FloatArray) -> FloatArray:
        return np.bincount(setting, weights=along * values, minlength=n_settings).astype(np.float64)

    square = sums(along)
    with_coordinates = np.array([sums(column) for column in fitted.jacobian.T]).reshape(-1, n_settings)
    left = square - np.einsum("ks,kl,ls->s", with_coordinates, inverse, with_coordinates)
    known = left > _LEAST_LEFT * square
    return np.where(known, sums(fitted.standardised) ** 2 / np.where(known, left, 1.0), 0.0)


#: Of the evidence for the effect, what there must be for a tag or gain of the record, which is far from linear.
_WORTH_A_LOOK = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Behind(Generic[Physics]):
    """The record that an effect was found for."""

    place: int  # among the records that were fitted
    without: Fitted[Physics]  # the fit to the others that lacks the effect


def found_for(
    fitted: Fitted[Physics], without: Fitted[Physics], records: HasRecords[Physics], right: AbstractSet[int]
) -> Behind[Physics] | None:
    """Return the record that is all that speaks for an effect, and would go with the others better with a fault.

    The evidence of the others for the effect falls below what any effect needs. Where the effect explains the record as
    well as a fault does there is no telling them apart, and the record is right.

    Parameters
    ----------
    fitted, without : Fitted
        The fits with the effect and without it.
    records : HasRecords
        The comparison that was fitted.
    right : set of int
        Places of records that are right.
    """
    bent = {place: of for place, of in bent_to(without, records).items() if place not in right}
    place, evidence = next(iter(bent.items()), (0, 0.0))
    if evidence <= _WORTH_A_LOOK * max(delta_bic(without, fitted, evidence_scale(fitted)), 0.0):
        return None
    n_records = len(records.layout.settings)
    rest = records.only(frozenset(range(n_records)) - {place})
    seen = fitted_values(rest.layout)
    try:
        others, plain = (fit(rest, each.hypothesis, each.coordinates, seen) for each in (fitted, without))
    except OutsideValidityError:
        return None
    scale = evidence_scale(others)
    if delta_bic(plain, others, scale) >= rest.least_delta_bic:
        return None
    n_values = np.count_nonzero(fitted.fitted & (records.layout.setting == place))
    expected = n_values * _chi_squared(others) / np.count_nonzero(others.fitted)  # of one like the others
    strange = _chi_squared(fitted) - _chi_squared(others) - expected
    of_effect = scale.penalty(fitted.n_seen - without.n_seen)
    of_fault = scale.penalty(1) + 2.0 * math.log(n_records * len(RecordFault))
    return Behind(place, plain) if scale.factor * strange + of_effect - of_fault > VERY_STRONG else None


def _chi_squared(fitted: Fitted[Physics]) -> float:
    return float(np.sum(fitted.standardised[fitted.fitted] ** 2))


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
    tags = whole.tags(_TAG)
    return bool(np.any(slope_by_tag(whole, fitted.physics(), _TAG, tags, np.ones_like(tags))))


#: Of the records, how many may be wrong; more is another model.
_MOST_WRONG = 0.2
#: Records without which a fit is made again, of those that it seems to have bent to.
_MOST_CLOSELY = 2


@dataclass(frozen=True, slots=True)
class Worst:
    """The record that is most surely wrong, and those that stand out and are right if it is wrong."""

    record: WrongRecord
    right: frozenset[int] = frozenset()  # by their settings


@dataclass(frozen=True, slots=True, eq=False)
class Records(Generic[Physics]):
    """All records of a comparison, and which of them are taken out."""

    whole: Comparison[Physics]  # of one without records nothing is taken out
    wrong: frozenset[int] = frozenset()  # by their settings
    baseline: Fitted[Physics] | None = None  # of the axis as described to all records, where none is taken out
    candidates: tuple[Effect[Physics], ...] = ()  # what the axis may lack
    right: frozenset[int] = frozenset()  # what stands out only until it is known what the axis lacks; by their settings

    @property
    def kept(self) -> Comparison[Physics]:
        """The comparison without the records that are taken out."""
        if not self.wrong or not isinstance(self.whole, HasRecords):
            return self.whole
        return self.whole.only(frozenset(range(len(self.whole.layout.settings))) - self.wrong)

    def with_wrong(self, worst: Worst) -> "Records[Physics]":
        """Return the records with one more taken out."""
        return replace(
            self, wrong=self.wrong | {worst.record.number - 1}, right=self.right | worst.right, baseline=None
        )

    def worst(self, fitted: Fitted[Physics]) -> Worst | None:
        """Return the record that is most surely wrong under a fit of those that are kept, None without any."""
        if not isinstance(self.whole, HasRecords) or self._has_enough_wrong:
            return None
        record = worst_record(fitted, self.whole, self.wrong, self.right) or self._bent_to(fitted)
        if record is None:
            return None
        account = accounted_for(fitted, self.whole, self.wrong, record, self.candidates)
        if account is None:
            return Worst(record)
        if account.wrong is None:
            return replace(self, right=self.right | account.right).worst(fitted)
        return Worst(account.wrong, account.right)

    def behind_effect(self, fitted: Fitted[Physics], without: Fitted[Physics]) -> Worst | None:
        """Return the wrong record that an effect was found for, None where the others ask for it, too.

        ``fitted`` is the fit with the effect, ``without`` the one that lacks it.
        """
        kept, whole = self.kept, self.whole
        if not isinstance(kept, HasRecords) or not isinstance(whole, HasRecords) or self._has_enough_wrong:
            return None
        numbers = self._numbers
        needed_for = found_for(
            fitted, without, kept, frozenset(numbers.index(each) for each in self.right - self.wrong)
        )
        if needed_for is None:
            return None
        record = self._worst_at(numbers[needed_for.place], needed_for.without, whole)
        return None if record is None else Worst(record)

    @property
    def _has_enough_wrong(self) -> bool:
        return len(self.wrong) >= _MOST_WRONG * len(self.whole.layout.settings)

    @property
    def _numbers(self) -> list[int]:
        """Settings of the records that are kept."""
        return [index for index in range(len(self.whole.layout.settings)) if index not in self.wrong]

    def _worst_at(self, index: int, without: Fitted[Physics], whole: HasRecords[Physics]) -> WrongRecord | None:
        """Return the record of a setting if it is the one that is most surely wrong under a fit without it."""
        worst = worst_record(without, whole, self.wrong, self.right)
        return worst if worst is not None and worst.number - 1 == index else None

    def _bent_to(self, fitted: Fitted[Physics]) -> WrongRecord | None:
        """Return the record that is most surely wrong under a fit without it, None without any."""
        kept, whole = self.kept, self.whole
        if not isinstance(kept, HasRecords) or not isinstance(whole, HasRecords):
            return None
        numbers = self._numbers
        evidence = {place: of for place, of in bent_to(fitted, kept).items() if numbers[place] not in self.right}
        best, *others = [*evidence.values(), 0.0]
        if judged_gap(fitted).exceeds_healthy and others and best < STANDS_OUT * others[0]:
            return None  # where much is missing the fit bends to many
        for place in list(evidence)[:_MOST_CLOSELY]:
            rest = kept.only(frozenset(range(len(numbers))) - {place})
            try:
                without = fit(rest, fitted.hypothesis, fitted.coordinates, fitted_values(rest.layout))
            except OutsideValidityError:
                continue
            worst = self._worst_at(numbers[place], without, whole)
            if worst is not None:
                return worst
        return None

    def cleared_under(self, fitted: Fitted[Physics], progress: Callable[[str], None]) -> "Records[Physics]":
        """Return the records without those that stand out, one after the other, under the same explanation refitted."""
        records = self
        while True:
            kept = records.kept
            try:
                fitted = fit(kept, fitted.hypothesis, fitted.coordinates, fitted_values(kept.layout))
            except OutsideValidityError:
                return records
            worst = records.worst(fitted)
            if worst is None:
                return records
            progress(f"once more without record {worst.record.number} ({worst.record.setting})")
            records = replace(records.with_wrong(worst), right=frozenset())

    def named(self, fitted: Fitted[Physics]) -> tuple[WrongRecord, ...]:
        """Return what is wrong with the records that are taken out, under the final fit, worst first.

        One that goes with the others under this fit is not among them.
        """
        if not isinstance(self.whole, HasRecords):
            return ()
        wrong = [record_under(fitted, self.whole, index) for index in self.wrong]
        return tuple(sorted((each for each in wrong if each is not None), key=lambda each: -each.delta_bic))


def cleared(
    comparison: Comparison[Physics],
    axis: DescribedAxis[Physics],
    progress: Callable[[str], None],
    candidates: Sequence[Effect[Physics]] = (),
) -> Records[Physics]:
    """Return the records without those that stand out from the others under the axis as it is described.

    ``candidates`` are what the axis may lack: one of them may be what makes a right record stand out.
    Raises OutsideValidityError if the axis has no answer.
    """
    records = Records(comparison, candidates=tuple(candidates))
    if not isinstance(comparison, HasRecords):
        return records
    hypothesis = Hypothesis(axis)
    start = hypothesis.null
    while True:
        kept = records.kept
        fitted = fit(kept, hypothesis, start, fitted_values(kept.layout))
        worst = records.worst(fitted)
        if worst is None:
            return replace(records, right=frozenset(), baseline=None if records.wrong else fitted)
        progress(f"taking out record {worst.record.number} ({worst.record.setting})")
        records = records.with_wrong(worst)
        start = fitted.coordinates
