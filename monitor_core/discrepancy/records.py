r"""Find records that do not go with the others: wrongly tagged, with a wrong gain, or wrong altogether.

They are taken out one by one, worst first, before anything is explained and again with what was found. With the misfit
m of a record, the deviations :math:`\sigma` of its values and the change S of the misfit by its condition errors, χ² of
a record under given physics is

.. math::

    \chi^2 = r^T (I + T^T T)^{-1} r, \qquad r = m/\sigma, \qquad T = S/\sigma

A direction g with an unknown amount, such as a gain, takes :math:`(g^T C^{-1} m)^2 / (g^T C^{-1} g)` of it. A tag is
sought over the whole range that a machine has: a misprint knows no tolerance. The evidence of a fault is a difference
of BIC. With χ² of a record before and after, its mean square s² over the records at large and the share a of its values
that is independent,

.. math::

    \Delta = \frac{a}{s^2} (\chi^2_0 - \chi^2_1) - \ln (a N) - 2 \ln n_{looks}

The last term is the price of having looked at every record for every fault. A record that is wrong in another way has a
variance q s² of its own; with n values that is worth :math:`a n (q - 1 - \ln q)`.

What stands out together with the others of one level, all that were taken warm, say, is an effect and no record. Once
nothing else is missing, a record that the fit has bent to, so that others stand out in its place, is judged by a refit.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Generic

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.discrepancy.explanation import RecordFault, WrongRecord
from monitor_core.discrepancy.screening import screen
from monitor_core.effects.effect import ConditionAxis, Effect, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.axis import DescribedAxis
from monitor_core.fitting.comparison import Comparison, HasRecords
from monitor_core.fitting.conditions.groups import CONDITIONS, levels_of
from monitor_core.fitting.evidence import VERY_STRONG, delta_bic, evidence_scale
from monitor_core.fitting.hold_out import fitted_values, judged_gap
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit

#: From the median of absolute deviations to the standard deviation of a normal distribution.
_NORMAL = 1.4826
#: When likely errors are the same, in standard deviations; and beyond which one is taken as linear.
_SAME, _LIKELY = 0.05, 5.0


@dataclass(frozen=True, slots=True, eq=False)
class RecordCosts:
    """The misfits of all records under one model, each with the condition errors that are likely for it."""

    setting: npt.NDArray[np.intp]  # of each value, shape (n_values,)
    scaled: FloatArray  # misfit in standard deviations, shape (n_values,)
    deviation: FloatArray  # shape (n_values,)
    directions: FloatArray  # T, shape (n_errors, n_values)
    inverse: FloatArray  # (I + T T^T)^-1 of each record, shape (n_settings, n_errors, n_errors)

    @property
    def chi_squared(self) -> FloatArray:
        """χ² of each record, shape (n_settings,)."""
        return self._product(self.scaled, self.scaled)

    @property
    def n_values(self) -> FloatArray:
        """How many values a record has, shape (n_settings,)."""
        return np.bincount(self.setting).astype(np.float64)

    def taken_by(self, change: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what an unknown amount of a change of the misfit, (n_values,), takes of χ², the amount, its deviation.

        The shapes are (n_settings,); the amount of a record that the change does not move is 0, its deviation infinite.
        """
        along = change / self.deviation
        slope, information = self._product(along, self.scaled), self._product(along, along)
        known = information > 0.0
        safe = np.where(known, information, 1.0)
        amount = np.where(known, -slope / safe, 0.0)
        return np.where(known, slope**2 / safe, 0.0), amount, np.where(known, safe**-0.5, np.inf)

    def likely_errors(self) -> FloatArray:
        """Return the most likely condition errors, in the deviations that they scatter by, (n_settings, n_errors)."""
        along = np.stack([np.bincount(self.setting, weights=row * self.scaled) for row in self.directions], axis=-1)
        return np.asarray(-np.einsum("skl,sl->sk", self.inverse, along))

    def _product(self, first: FloatArray, second: FloatArray) -> FloatArray:
        plain = np.bincount(self.setting, weights=first * second)
        a, b = (
            np.stack([np.bincount(self.setting, weights=row * values) for row in self.directions], axis=-1)
            for values in (first, second)
        )
        return np.asarray(plain - np.einsum("sk,skl,sl->s", a, self.inverse, b))


def record_costs(
    comparison: Comparison[Physics], physics: Physics, scatter: FloatArray, n_rounds: int = 4
) -> RecordCosts:
    """Return the misfits of all records, linearised around the condition errors that are likely for each.

    ``scatter`` is by how much condition errors scatter in the tolerances that are assumed, shape (n_errors,).
    In each of ``n_rounds`` the likely errors and the misfit around them are found anew.
    """
    layout = comparison.layout
    deviation, setting = layout.standard_deviation, layout.setting
    errors = np.zeros((len(layout.settings), scatter.size))
    for _ in range(n_rounds):
        try:
            around = comparison.shifted(errors)
            misfit = around.misfit(physics)
        except OutsideValidityError:
            errors = np.zeros_like(errors)
            around = comparison
            misfit = around.misfit(physics)
        change = around.condition_errors(physics, misfit)
        scaled = (misfit - np.sum(change * errors[setting].T, axis=0)) / deviation
        directions = change * scatter[:, None] / deviation
        grams = np.array([[np.bincount(setting, weights=row * other) for other in directions] for row in directions])
        inverse = np.linalg.inv(np.eye(scatter.size) + np.moveaxis(grams, -1, 0))
        costs = RecordCosts(setting, scaled, deviation, directions, inverse)
        likely = np.clip(costs.likely_errors(), -_LIKELY, _LIKELY) * scatter
        if np.max(np.abs(likely - errors), initial=0.0) < _SAME:
            break
        errors = likely
    return costs


def scatter_of(pulls: FloatArray) -> FloatArray:
    """Return by how much each kind of condition error scatters, 1 at the least, as the bulk of the records shows it.

    ``pulls`` have shape (n_settings, n_errors); a single one that is far out does not count for it.
    """
    scatter = [
        _NORMAL * float(np.median(np.abs(column[np.isfinite(column)]))) if np.any(np.isfinite(column)) else 1.0
        for column in pulls.T
    ]
    return np.maximum(scatter, 1.0)


def least_along(
    cost: Callable[[FloatArray], FloatArray], grid: FloatArray, n_halvings: int
) -> tuple[FloatArray, FloatArray]:
    """Return where along a grid the costs of all records are least, and the costs there, shape (n_settings,) both.

    ``cost`` takes a value for each record and answers with its cost, shape (n_settings,); ``grid`` has shape
    (n_values, n_settings), rising. The grid is halved so many times around the best value of each record.
    """
    costs = np.array([cost(row) for row in grid])
    columns = np.arange(grid.shape[1])
    best = np.argmin(costs, axis=0)
    minimiser, least = grid[best, columns], costs[best, columns]
    below = minimiser - grid[np.maximum(best - 1, 0), columns]
    step = np.maximum(below, grid[np.minimum(best + 1, len(grid) - 1), columns] - minimiser)
    for _ in range(n_halvings):
        step = 0.5 * step
        low, high = (np.clip(minimiser + side * step, grid[0], grid[-1]) for side in (-1.0, 1.0))
        of_low, of_high = cost(low), cost(high)
        lower = np.where(of_low < of_high, low, high)
        minimiser = np.where(np.minimum(of_low, of_high) < least, lower, minimiser)
        least = np.minimum(np.minimum(of_low, of_high), least)
    return minimiser, least


_N_GRID, _N_HALVINGS = 31, 10
#: Of a range of tags, to see how the misfit moves with one.
_STEP = 1e-3
#: By name in :class:`ConditionArrays`: the fault, its unit and what that is of the unit inside.
TAGS = {
    "position": (RecordFault.POSITION, "mm", 1e3),
    "preload": (RecordFault.PRELOAD, "N", 1.0),
    "payload_mass": (RecordFault.PAYLOAD, "kg", 1.0),
    "temperature_deviation": (RecordFault.TEMPERATURE, "K", 1.0),
}


@dataclass(frozen=True, slots=True)
class Freed:
    """What one fault would explain of a record."""

    fault: RecordFault
    unit: str
    stated: float
    found: float
    deviation: float  # of what was found
    taken: float  # of χ²


def _freed(
    record: HasRecords[Physics], physics: Physics, scatter: FloatArray, ranges: Mapping[str, tuple[float, float]]
) -> Iterator[Freed]:
    """Yield what each fault would explain of one record; a tag that the misfit does not depend on is left out.

    The model is not fitted to it. ``scatter`` is that of condition errors, in their tolerances, shape (n_errors,).
    """
    here = record_costs(record, physics, scatter)
    amplitude = np.where(np.isinf(record.layout.period), 1.0, 0.0)
    response = record.response_of_value - record.response_of_value[0]
    single = [np.where(response == column, amplitude, 0.0) for column in range(int(np.max(response)) + 1)]
    for along in [amplitude, *(single if len(single) > 1 else [])]:
        (taken,), (amount,), (deviation,) = here.taken_by(along)
        gain = math.exp(amount)  # by which the measured values are too large: ln of it, added, brings them right
        yield Freed(RecordFault.GAIN, "1", 1.0, gain, deviation * gain, taken)
    for tag, (fault, unit, per_unit) in TAGS.items():
        stated = record.tags(tag)
        if tag not in ranges:
            continue
        low, high = (np.full_like(stated, end) for end in ranges[tag])
        step = np.maximum(_STEP * (high - low), 1e-12)
        if not np.any(slope_by_tag(record, physics, tag, stated, step)):
            continue
        spaced = np.geomspace if tag == "preload" else np.linspace
        most_likely, _ = least_along(
            partial(_cost_of_tag, record, physics, scatter, tag), spaced(low, high, _N_GRID), _N_HALVINGS
        )
        there = record_costs(record.retagged(tag, most_likely), physics, scatter)
        _, _, (deviation,) = there.taken_by(slope_by_tag(record, physics, tag, most_likely, step))
        taken = float((here.chi_squared - there.chi_squared)[0])
        yield Freed(fault, unit, stated[0] * per_unit, most_likely[0] * per_unit, deviation * per_unit, taken)


def _cost_of_tag(
    record: HasRecords[Physics], physics: Physics, scatter: FloatArray, tag: str, values: FloatArray
) -> FloatArray:
    try:
        return record_costs(record.retagged(tag, values), physics, scatter, 1).chi_squared
    except OutsideValidityError:
        return np.full(values.shape, np.inf)


def slope_by_tag(
    records: HasRecords[Physics], physics: Physics, tag: str, tags: FloatArray, step: FloatArray
) -> FloatArray:
    """Return the derivative of the misfit by the tags of all records, shape (n_values,).

    ``tags`` are what they are and ``step`` how far to move them, to the other side where the model has no answer; shape
    (n_settings,) both.
    """
    here = records.retagged(tag, tags).misfit(physics)
    try:
        moved, step = records.retagged(tag, tags - step).misfit(physics), -step
    except OutsideValidityError:
        moved = records.retagged(tag, tags + step).misfit(physics)
    return np.asarray(records.layout.difference(moved, here) / step[records.layout.setting])


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
    scores = np.where(others, _scores(whole, here, look), -np.inf)
    order = np.argsort(-scores, kind="stable")
    candidates = [
        wrong
        for index in order[:_MOST_CLOSELY].tolist()
        if scores[index] > VERY_STRONG
        and not _shared_by_level(whole, index, scores, others, wrong_before)
        and (wrong := record_under(fitted, whole, index)) is not None
    ]
    worst = max(candidates, key=lambda wrong: wrong.delta_bic, default=None)
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
    freed = _freed(whole.only(frozenset((index,))), physics, scatter, whole.tag_ranges(physics, index))
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
    best = max(freed, key=lambda each: each.taken)
    evidence = float(look.of_taken(best.taken))
    deviation = best.deviation / math.sqrt(look.factor)
    has_size = abs(best.found - best.stated) >= _LEAST_SIZE * deviation
    if chi_squared - best.taken <= allowed and evidence > VERY_STRONG and has_size:
        wrong = replace(wrong, fault=best.fault, stated=best.stated, found=best.found, standard_uncertainty=deviation,
                        unit=best.unit, delta_bic=evidence)  # fmt: skip
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


def _scores(whole: HasRecords[Physics], here: RecordCosts, look: Look) -> FloatArray:
    """Return how much speaks against each record at first sight, shape (n_settings,).

    A variance of its own, a gain, or an error of a tag as far as it is linear.
    """
    scores = [look.of_variance(here.chi_squared, here.n_values)]
    amplitude = np.where(np.isinf(whole.layout.period), 1.0, 0.0)
    scores.append(look.of_taken(here.taken_by(amplitude)[0]))
    for row in here.directions:
        scores.append(look.of_taken(here.taken_by(row * here.deviation)[0]))
    return np.asarray(np.max(scores, axis=0))


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


def _retagged(without: Fitted[Physics], wrong: WrongRecord) -> Fitted[Physics] | None:
    """Return a fit with another tag for one record, None where nothing but another tag is what is wrong with it."""
    of_fault = {fault: (tag, per_unit) for tag, (fault, _, per_unit) in TAGS.items()}
    records = without.comparison
    if wrong.fault not in of_fault or not isinstance(records, HasRecords):
        return None
    tag, per_unit = of_fault[wrong.fault]
    is_wrong = [each == wrong.observations for each in records.records]
    with suppress(OutsideValidityError):
        values = np.where(is_wrong, wrong.found / per_unit, records.tags(tag))
        return fit(records.retagged(tag, values), without.hypothesis, without.coordinates, without.fitted)
    return None


def _with_each(without: Fitted[Physics], effects: Sequence[Effect[Physics]]) -> Iterator[Fitted[Physics]]:
    """Yield the fits with each effect, as far as its values are plausible."""
    for screened in screen(without, [effect for effect in effects if effect.applies(without.physics())]):
        hypothesis = without.hypothesis.with_effect(screened.effect)
        with suppress(OutsideValidityError):
            fitted = fit(without.comparison, hypothesis, screened.starts[0])
            values = hypothesis.values(fitted.coordinates)[screened.effect.key]
            if all(each.lower <= values[each.name] <= each.upper for each in screened.effect.parameters):
                yield fitted


#: Of the records, how many may be wrong; more is another model.
_MOST_WRONG = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Records(Generic[Physics]):
    """All records of a comparison, and which of them are taken out."""

    whole: Comparison[Physics]  # of one without records nothing is taken out
    wrong: frozenset[int] = frozenset()  # by their settings
    baseline: Fitted[Physics] | None = None  # of the axis as described to all records, where none is taken out
    candidates: tuple[Effect[Physics], ...] = ()  # what the axis may lack

    @property
    def kept(self) -> Comparison[Physics]:
        """The comparison without the records that are taken out."""
        if not self.wrong or not isinstance(self.whole, HasRecords):
            return self.whole
        return self.whole.only(frozenset(range(len(self.whole.layout.settings))) - self.wrong)

    def without(self, record: WrongRecord) -> "Records[Physics]":
        """Return the records with one more taken out."""
        return replace(self, wrong=self.wrong | {record.number - 1}, baseline=None)

    def worst(
        self, fitted: Fitted[Physics], right: frozenset[int] = frozenset()
    ) -> tuple[WrongRecord | None, frozenset[int]]:
        """Return the record that is most surely wrong under a fit of those that are kept, None without any.

        With it come those that are ``right`` though they stand out until it is known what the axis lacks.
        """
        whole = self.whole
        if not isinstance(whole, HasRecords) or len(self.wrong) >= _MOST_WRONG * len(whole.layout.settings):
            return None, right
        record = worst_record(fitted, whole, self.wrong, right)
        if record is None:
            return None, right
        wrong, others = self._accounted_for(fitted, whole, record)
        return (wrong, right | others) if wrong is not None else self.worst(fitted, right | others)

    def bent_to(self, fitted: Fitted[Physics], to_beat: float = 0.0) -> WrongRecord | None:
        """Return the record that a fit of those that are kept has bent to, None without any.

        Its setting is pulled further than those of the others, and little of its misfit is left. So it is judged under
        a fit to the others, and its tag needs as much evidence in a fit to all as an effect, beyond ``to_beat``.
        """
        whole = self.whole
        if not isinstance(whole, HasRecords) or len(self.wrong) >= _MOST_WRONG * len(whole.layout.settings):
            return None
        pulls = np.nan_to_num(fitted.around.whitened_by.pulls(fitted.misfit), posinf=0.0, neginf=0.0)
        furthest = np.max(np.abs(pulls) / scatter_of(pulls), axis=1, initial=0.0)
        every = [index for index in range(len(whole.layout.settings)) if index not in self.wrong]
        if np.max(furthest) < _LEAST_SIZE:
            return None
        index = every[int(np.argmax(furthest))]
        others = fit(whole.only(frozenset(every) - {index}), fitted.hypothesis, fitted.coordinates)
        wrong = record_under(others, whole, index)
        retagged = None if wrong is None else _retagged(fitted, wrong)
        if retagged is None:
            return None
        scale, n_looks = evidence_scale(retagged), len(every) * len(RecordFault)
        evidence = delta_bic(fitted, retagged, scale) - scale.penalty(1) - 2.0 * math.log(n_looks)
        return wrong if evidence >= to_beat + whole.least_delta_bic else None

    def _accounted_for(
        self, fitted: Fitted[Physics], whole: HasRecords[Physics], worst: WrongRecord
    ) -> tuple[WrongRecord | None, frozenset[int]]:
        """Return which record is wrong by the evidence, and those that stand out and are right.

        One that was taken warm may stand out where the others of its level do not: it is wrong; or it is right, shows
        what warmth does to the axis, and the fit has bent to another; or another was not as warm as it says. The tag of
        that one changes nothing without an effect of temperature, and such an effect explains little while the tag
        counts as right: so both are tried together. An effect that the description states is one of them, for it may be
        stated too small; of one that the fit has found the size is fitted.
        """
        index, every = worst.number - 1, frozenset(range(len(whole.layout.settings)))
        levels, price = (
            levels_of(whole.layout, ConditionAxis.TEMPERATURE),
            2.0 * math.log(len(every) * len(RecordFault)),
        )
        same = frozenset(np.flatnonzero(levels == levels[index]).tolist()) - self.wrong
        effects = [each for each in self.candidates if ConditionAxis.TEMPERATURE in each.needs]
        is_known = any(effect in effects for effect in fitted.hypothesis.effects)
        best: tuple[WrongRecord | None, frozenset[int]] = (worst, frozenset())
        least = VERY_STRONG
        if is_known or not effects or len(same) < 2 or 2 * len(same) > len(every):
            return best

        def refitted(left_out: int | None) -> Fitted[Physics]:
            return fit(whole.only(every - self.wrong - {left_out}), fitted.hypothesis, fitted.coordinates)

        alone = record_under(refitted(index), whole, index) or worst
        for other in (None, *sorted(same - {index})):
            without = refitted(other)
            retagged = _retagged(without, alone)
            for shown in _with_each(without, effects):
                scale = evidence_scale(shown)
                wrong = None if other is None else record_under(shown, whole, other)
                if other is not None and (wrong is None or wrong.fault is not RecordFault.TEMPERATURE):
                    continue
                of_tag = scale.penalty(1) + price
                instead = alone.delta_bic if retagged is None else delta_bic(without, retagged, scale) - of_tag
                advantage = delta_bic(without, shown, scale) - instead - (0.0 if other is None else of_tag)
                if advantage > least:
                    best, least = (wrong, same if other is None else frozenset((index,))), advantage
        return best

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
    records, hypothesis = Records(comparison, candidates=tuple(candidates)), Hypothesis(axis)
    start, right = hypothesis.null, frozenset[int]()
    while True:
        kept = records.kept
        fitted = fit(kept, hypothesis, start, fitted_values(kept.layout))
        worst, right = records.worst(fitted, right)
        if worst is None:
            return records if records.wrong else replace(records, baseline=fitted)
        progress(f"taking out record {worst.number} ({worst.setting})")
        records, start = records.without(worst), fitted.coordinates
