"""Free one tag or gain of a record at a time, and see how much of its misfit that takes away.

A tag is sought over the whole range that a machine has: a misprint knows no tolerance.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Generic

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.explanation import RecordFault
from monitor_core.discrepancy.records.record_cost import RecordCosts, least_along, record_costs
from monitor_core.effects.effect import Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import HasRecords

_N_GRID, _N_HALVINGS = 31, 10
#: Of a value, to see how the misfit moves with it.
_STEP = 1e-3
#: By name in :class:`ConditionArrays`: the fault, its unit and what that is of the unit inside.
TAGS = {
    "position": (RecordFault.POSITION, "mm", 1e3),
    "preload": (RecordFault.PRELOAD, "N", 1.0),
    "payload_mass": (RecordFault.PAYLOAD, "kg", 1.0),
    "temperature_deviation": (RecordFault.TEMPERATURE, "K", 1.0),
}


@dataclass(frozen=True, slots=True, eq=False)
class Freed:
    """What one fault would explain of each record; all of shape (n_settings,)."""

    fault: RecordFault
    unit: str
    stated: FloatArray
    found: FloatArray
    deviation: FloatArray  # of what was found
    taken: FloatArray  # of χ²


@dataclass(frozen=True, slots=True, eq=False)
class RecordsUnderTest(Generic[Physics]):
    """Some records, and a model that is not fitted to them."""

    comparison: HasRecords[Physics]  # of these records
    physics: Physics
    scatter: FloatArray  # of condition errors, in their tolerances, shape (n_errors,)
    ranges: Mapping[str, tuple[float, float]]  # of tags

    def costs(self) -> RecordCosts:
        """Return the misfits as stated."""
        return record_costs(self.comparison, self.physics, self.scatter)

    def freed(self) -> Iterator[Freed]:
        """Yield what each fault would explain; a tag that the misfit does not depend on is left out."""
        here = self.costs()
        yield from self._gains(here)
        for tag in TAGS:
            freed = self._tag(tag, here)
            if freed is not None:
                yield freed

    def _gains(self, here: RecordCosts) -> Iterator[Freed]:
        """Yield the gain of all responses of a record, and the best of those of a single response."""
        amplitude = np.where(np.isinf(self.comparison.layout.period), 1.0, 0.0)
        yield _gain(here, amplitude)
        response = self.comparison.response_of_value
        first = np.r_[True, np.diff(self.comparison.layout.setting) > 0]
        within = response - np.maximum.accumulate(np.where(first, response, 0))
        for column in range(int(np.max(within)) + 1) if np.max(within) else ():
            yield _gain(here, np.where(within == column, amplitude, 0.0))

    def _tag(self, tag: str, here: RecordCosts) -> Freed | None:
        records = self.comparison
        fault, unit, per_unit = TAGS[tag]
        stated = records.tags(tag)
        if tag not in self.ranges:
            return None

        def chi_squared(values: FloatArray) -> FloatArray:
            try:
                return record_costs(records.retagged(tag, values), self.physics, self.scatter, 1).chi_squared
            except OutsideValidityError:
                return np.full(values.shape, np.inf)

        low, high = (np.full_like(stated, end) for end in self.ranges[tag])
        step = np.maximum(_STEP * (high - low), 1e-12)
        if not np.any(slope_by_tag(records, self.physics, tag, stated, step)):
            return None
        spaced = np.geomspace if tag == "preload" else np.linspace
        grid = spaced(low, high, _N_GRID)
        found, _ = least_along(chi_squared, grid, _N_HALVINGS)
        there = record_costs(records.retagged(tag, found), self.physics, self.scatter)
        taken = here.chi_squared - there.chi_squared
        _, _, deviation = there.taken_by(slope_by_tag(records, self.physics, tag, found, step))
        return Freed(fault, unit, stated * per_unit, found * per_unit, deviation * per_unit, taken)


def slope_by_tag(
    records: HasRecords[Physics], physics: Physics, tag: str, at: FloatArray, step: FloatArray
) -> FloatArray:
    """Return the derivative of the misfit by the tags of all records, shape (n_values,).

    ``at`` are the tags and ``step`` how far to move them, to the other side where the model has no answer; shape
    (n_settings,) both.
    """
    here = records.retagged(tag, at).misfit(physics)
    try:
        moved, step = records.retagged(tag, at - step).misfit(physics), -step
    except OutsideValidityError:
        moved = records.retagged(tag, at + step).misfit(physics)
    return np.asarray(records.layout.difference(moved, here) / step[records.layout.setting])


def _gain(here: RecordCosts, along: FloatArray) -> Freed:
    """Return what a gain explains, by which the measured values are too large: ln of it, added, brings them right."""
    taken, amount, deviation = here.taken_by(along)
    gain = np.exp(amount)
    return Freed(RecordFault.GAIN, "1", np.ones_like(gain), gain, deviation * gain, taken)
