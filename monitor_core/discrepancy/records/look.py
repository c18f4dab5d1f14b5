r"""Look for the record that stands out: worse than the others, and better with one tag or gain of its own.

The evidence of a fault is a difference of BIC. With χ² of a record before and after, its mean square s² over the
records at large and the share a of its values that is independent,

.. math::

    \Delta = \frac{a}{s^2} (\chi^2_0 - \chi^2_1) - \ln (a N) - 2 \ln n_{looks}

The last term is the price of having looked at every record for every fault. A record that is wrong in another way has a
variance q s² of its own; with n values that is worth :math:`a n (q - 1 - \ln q)`.

What stands out together with the others of one level, all that were taken warm, say, is an effect and no record.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.discrepancy.explanation import RecordFault, WrongRecord
from monitor_core.discrepancy.records.faults import RecordsUnderTest
from monitor_core.discrepancy.records.record_cost import RecordCosts, record_costs, scatter_of
from monitor_core.effects.effect import Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import HasRecords
from monitor_core.fitting.conditions.groups import CONDITIONS, levels_of
from monitor_core.fitting.evidence import VERY_STRONG, evidence_scale
from monitor_core.fitting.hold_out import judged_gap
from monitor_core.fitting.solver.hypothesis_fit import Fitted

#: Records that are looked at closely at once, of those that stand out.
_MOST_CLOSELY = 3
#: Of the evidence of a record, what the others of its level have where their level is what is wrong: squares of misfits
#: that are a fifth of its own.
_ALIKE = 0.04
#: Before anything is explained a wrong record must stand out by this factor from the next.
STANDS_OUT = 3.0
#: Mean square in that of the others, up to which a tag or a gain explains a record.
_EXPLAINED = 3.0
#: Of the misfit beyond that, what may be left of it.
_LEFT = 0.1
_FEWEST_RECORDS = 6
#: Standard uncertainties that a tag or a gain is off by at least.
_LEAST_SIZE = 3.0


@dataclass(frozen=True, slots=True)
class Look:
    """What counts as evidence."""

    factor: float  # a/s² [-]
    mean_square: float  # s² [-]
    share: float  # a [-]
    penalty: float  # ln (a N)
    price: float  # 2 ln n_looks

    def of_taken(self, taken: FloatArray | float) -> FloatArray:
        """Return the evidence of something with an unknown of its own."""
        return np.asarray(self.factor * np.asarray(taken) - self.penalty - self.price)

    def of_variance(self, chi_squared: FloatArray | float, n_values: FloatArray | float) -> FloatArray:
        """Return the evidence of a variance of its own, where it is larger."""
        q = np.maximum(np.asarray(chi_squared) / (self.mean_square * np.asarray(n_values)), 1.0)
        return np.asarray(self.share * np.asarray(n_values) * (q - 1.0 - np.log(q)) - self.penalty - self.price)


def worst_record(
    fitted: Fitted[Physics],
    whole: HasRecords[Physics],
    known: frozenset[int],
    right: frozenset[int] = frozenset(),
) -> WrongRecord | None:
    """Return the record that is most surely wrong under a fit, None without any.

    ``whole`` is the comparison of all records, of which ``known`` are found to be wrong already and were not fitted;
    those that are ``right`` may stand out.
    """
    overview = _overview(fitted, whole)
    if overview is None:
        return None
    here, look, _ = overview
    numbers = np.arange(here.chi_squared.size)
    wrong_before = np.isin(numbers, list(known))
    others = ~wrong_before & ~np.isin(numbers, list(right))
    scores = np.where(others, _scores(fitted, whole, here, look), -np.inf)
    order = np.argsort(-scores, kind="stable")
    found = [
        wrong
        for index in order[:_MOST_CLOSELY].tolist()
        if scores[index] > VERY_STRONG
        and not _shared_by_level(whole, index, scores, others, wrong_before)
        and (wrong := record_under(fitted, whole, index)) is not None
    ]
    worst = max(found, key=lambda wrong: wrong.delta_bic, default=None)
    if worst is None or not judged_gap(fitted).exceeds_healthy:
        return worst
    next_best = float(np.max(np.delete(scores, worst.number - 1), initial=0.0))
    return worst if worst.delta_bic > STANDS_OUT * next_best else None


def record_under(fitted: Fitted[Physics], whole: HasRecords[Physics], index: int) -> WrongRecord | None:
    """Return what is wrong with one record under a fit, None if nothing is that the evidence carries."""
    overview = _overview(fitted, whole)
    if overview is None:
        return None
    here, look, scatter = overview
    physics = fitted.physics()
    alone = whole.only(frozenset((index,)))
    tested = RecordsUnderTest(alone, physics, scatter, whole.tag_ranges(physics, index))
    chi_squared, n_values = float(here.chi_squared[index]), float(here.n_values[index])
    allowed = max(_EXPLAINED, _LEFT * chi_squared / (look.mean_square * n_values)) * look.mean_square * n_values
    wrong = WrongRecord(
        index + 1,
        whole.records[index],
        whole.layout.settings[index].name,
        RecordFault.OUTLIER,
        delta_bic=float(look.of_variance(chi_squared, n_values)),
        misfit=math.sqrt(chi_squared / n_values),
    )
    best = min(tested.freed(), key=lambda freed: chi_squared - float(freed.taken[0]))
    evidence = float(look.of_taken(best.taken)[0])
    deviation = float(best.deviation[0]) / math.sqrt(look.factor)
    has_size = abs(float(best.found[0]) - float(best.stated[0])) >= _LEAST_SIZE * deviation
    if chi_squared - float(best.taken[0]) <= allowed and evidence > VERY_STRONG and has_size:
        wrong = replace(
            wrong,
            fault=best.fault,
            stated=float(best.stated[0]),
            found=float(best.found[0]),
            standard_uncertainty=deviation,
            unit=best.unit,
            delta_bic=evidence,
        )
    return wrong if wrong.delta_bic > VERY_STRONG else None


def _overview(fitted: Fitted[Physics], whole: HasRecords[Physics]) -> tuple[RecordCosts, Look, FloatArray] | None:
    """Return the misfits of all records under a fit, and what counts as evidence; None where they say nothing."""
    if len(whole.layout.settings) < _FEWEST_RECORDS:
        return None
    scatter = scatter_of(fitted.around.whitened_by.pulls(fitted.misfit))
    try:
        here = record_costs(whole, fitted.physics(), scatter)
    except OutsideValidityError:
        return None
    scale = evidence_scale(fitted)
    mean_square = max(float(np.median(here.chi_squared / here.n_values)), 1.0)
    n_looks = len(whole.layout.settings) * len(RecordFault)
    look = Look(scale.share / mean_square, mean_square, scale.share, scale.penalty(1), 2.0 * math.log(n_looks))
    return here, look, scatter


def _scores(fitted: Fitted[Physics], whole: HasRecords[Physics], here: RecordCosts, look: Look) -> FloatArray:
    """Return how much speaks against each record at first sight, shape (n_settings,).

    A variance of its own, a gain, or an error of a tag as far as it is linear.
    """
    found = [look.of_variance(here.chi_squared, here.n_values)]
    amplitude = np.where(np.isinf(whole.layout.period), 1.0, 0.0)
    found.append(look.of_taken(here.taken_by(amplitude)[0]))
    for row in here.directions:
        found.append(look.of_taken(here.taken_by(row * here.deviation)[0]))
    return np.asarray(np.max(found, axis=0))


def _shared_by_level(
    whole: HasRecords[Physics], index: int, scores: FloatArray, others: BoolArray, wrong_before: BoolArray
) -> bool:
    """Return whether the other records of an unusual level of one condition stand out, too, or stood out before."""
    for axis in CONDITIONS:
        levels = levels_of(whole.layout, axis)
        same = levels == levels[index]
        same[index] = False
        n_same, n_wrong = int(np.count_nonzero(same)), int(np.count_nonzero(same & wrong_before))
        if not n_same or 2 * n_same > levels.size:
            continue
        # with this one more than half of the level would be wrong
        if n_wrong and 2 * n_wrong >= n_same:
            return True
        rest = same & others
        if np.any(rest) and float(np.median(scores[rest])) > _ALIKE * scores[index]:
            return True
    return False
