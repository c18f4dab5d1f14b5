"""See whether an effect was found for the sake of one record, which is wrong: the others do not ask for it."""

import math
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import Generic

import numpy as np

from monitor_core.discrepancy.explanation import RecordFault
from monitor_core.discrepancy.records.masking import bent_to
from monitor_core.effects.effect import Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import HasRecords
from monitor_core.fitting.evidence import VERY_STRONG, delta_bic, evidence_scale
from monitor_core.fitting.hold_out import fitted_values
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit

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
