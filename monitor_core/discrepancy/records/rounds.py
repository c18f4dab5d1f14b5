"""Take out wrong records one by one, worst first, before anything is explained and again with what was found."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic

from monitor_core.discrepancy.explanation import WrongRecord
from monitor_core.discrepancy.records.accounts import accounted_for
from monitor_core.discrepancy.records.behind import found_for
from monitor_core.discrepancy.records.look import STANDS_OUT, record_under, worst_record
from monitor_core.discrepancy.records.masking import bent_to
from monitor_core.effects.effect import Effect, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.axis import DescribedAxis
from monitor_core.fitting.comparison import Comparison, HasRecords
from monitor_core.fitting.hold_out import fitted_values, judged_gap
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit

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
        found = found_for(fitted, without, kept, frozenset(numbers.index(each) for each in self.right - self.wrong))
        if found is None:
            return None
        record = self._worst_at(numbers[found.place], found.without, whole)
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
        found = [record_under(fitted, self.whole, index) for index in self.wrong]
        return tuple(sorted((each for each in found if each is not None), key=lambda each: -each.delta_bic))


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
    at = hypothesis.null
    while True:
        kept = records.kept
        fitted = fit(kept, hypothesis, at, fitted_values(kept.layout))
        worst = records.worst(fitted)
        if worst is None:
            return replace(records, right=frozenset(), baseline=None if records.wrong else fitted)
        progress(f"taking out record {worst.record.number} ({worst.record.setting})")
        records = records.with_wrong(worst)
        at = fitted.coordinates
