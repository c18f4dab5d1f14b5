"""Take out wrong records one by one, worst first, before anything is explained and again with what was found."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic

from monitor_core.discrepancy.explanation import WrongRecord
from monitor_core.discrepancy.records.look import record_under, worst_record
from monitor_core.discrepancy.records.masking import bent_to
from monitor_core.effects.effect import Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Comparison, HasRecords
from monitor_core.fitting.described_axis import DescribedAxis
from monitor_core.fitting.hold_out import fitted_values
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit

#: Of the records, how many may be wrong; more is another model.
_MOST_WRONG = 0.2
#: Records without which a fit is made again, of those that it seems to have bent to.
_MOST_CLOSELY = 2


@dataclass(frozen=True, slots=True, eq=False)
class Records(Generic[Physics]):
    """All records of a comparison, and which of them are taken out."""

    whole: Comparison[Physics]  # of one without records nothing is taken out
    wrong: frozenset[int] = frozenset()  # by their settings
    baseline: Fitted[Physics] | None = None  # of the axis as described to all records, where none is taken out

    @property
    def kept(self) -> Comparison[Physics]:
        """The comparison without the records that are taken out."""
        if not self.wrong or not isinstance(self.whole, HasRecords):
            return self.whole
        return self.whole.only(frozenset(range(len(self.whole.layout.settings))) - self.wrong)

    def with_wrong(self, number: int) -> "Records[Physics]":
        """Return the records with one more taken out, by its number from 1."""
        return Records(self.whole, self.wrong | {number - 1})

    def worst(self, fitted: Fitted[Physics]) -> WrongRecord | None:
        """Return the record that is most surely wrong under a fit of those that are kept, None without any."""
        if not isinstance(self.whole, HasRecords) or len(self.wrong) >= _MOST_WRONG * len(self.whole.layout.settings):
            return None
        return worst_record(fitted, self.whole, self.wrong) or self._bent_to(fitted)

    def _bent_to(self, fitted: Fitted[Physics]) -> WrongRecord | None:
        """Return the record that is most surely wrong under a fit without it, None without any."""
        kept, whole = self.kept, self.whole
        if not isinstance(kept, HasRecords) or not isinstance(whole, HasRecords):
            return None
        numbers = [index + 1 for index in range(len(whole.layout.settings)) if index not in self.wrong]
        for place in bent_to(fitted, kept)[:_MOST_CLOSELY]:
            rest = self.with_wrong(numbers[place]).kept
            try:
                without = fit(rest, fitted.hypothesis, fitted.coordinates, fitted_values(rest.layout))
            except OutsideValidityError:
                continue
            worst = worst_record(without, whole, self.wrong)
            if worst is not None and worst.number == numbers[place]:
                return worst
        return None

    def named(self, fitted: Fitted[Physics]) -> tuple[WrongRecord, ...]:
        """Return what is wrong with the records that are taken out, under the final fit, worst first.

        One that goes with the others under this fit is not among them.
        """
        if not isinstance(self.whole, HasRecords):
            return ()
        found = [record_under(fitted, self.whole, index) for index in self.wrong]
        return tuple(sorted((each for each in found if each is not None), key=lambda each: -each.delta_bic))


def cleared(
    comparison: Comparison[Physics], axis: DescribedAxis[Physics], progress: Callable[[str], None]
) -> Records[Physics]:
    """Return the records without those that stand out from the others under the axis as it is described.

    Raises OutsideValidityError if the axis has no answer.
    """
    records = Records(comparison)
    if not isinstance(comparison, HasRecords):
        return records
    hypothesis = Hypothesis(axis)
    at = hypothesis.null
    while True:
        kept = records.kept
        fitted = fit(kept, hypothesis, at, fitted_values(kept.layout))
        worst = records.worst(fitted)
        if worst is None:
            return records if records.wrong else Records(comparison, baseline=fitted)
        progress(f"taking out record {worst.number} ({worst.setting})")
        records = records.with_wrong(worst.number)
        at = fitted.coordinates
