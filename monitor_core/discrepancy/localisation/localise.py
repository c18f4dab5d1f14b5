r"""Locate a misfit, as places and as maps: where data and model differ, and what the difference looks like.

Residuals that are standard normal and independent where the model is right are tested, together at one level (Holm):
is their sum of squares too large, over all and over every band, channel, position, preload, payload, temperature,
excitation level and direction (χ²); do they go along a signature, or more so with a condition (rank correlation). What
is found is narrowed to the place that holds it, named by its kind and taken out; then the rest is tested again. A map
has the rms of the misfit by the values of a condition and by frequency band.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.discrepancy.explanation import Misfit, MisfitKind, MisfitPlace
from monitor_core.discrepancy.localisation.misfit_kind import (
    KindFound,
    Signature,
    explained,
    kind_of,
    take_out,
    with_derived_kinds,
)
from monitor_core.effects.effect import ConditionAxis
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Layout
from monitor_core.fitting.conditions.groups import (
    CONDITIONS,
    Extent,
    Grouping,
    Indices,
    by_condition,
    by_frequency,
    by_stretch,
    groupings,
    levels_of,
    previous_in_series,
)


def varied_conditions_of_maps(layout: Layout) -> tuple[ConditionAxis, ...]:
    """Return what a picture of the misfit may go over: every condition of which there is more than one value."""
    groupings = {axis: by_condition(layout, axis) for axis in CONDITIONS}
    return tuple(axis for axis, grouping in groupings.items() if grouping is not None and grouping.n_groups > 1)


def misfit_map(
    layout: Layout, standardised: FloatArray, over: ConditionAxis | None, bands: int = 8
) -> tuple[tuple[Extent, ...], tuple[Extent, ...], FloatArray]:
    """Return what rows and columns are, and the rms of the standardised misfit, shape (n_rows, n_columns).

    The rows are the values of a condition, or one row of everything. The columns are bands of frequency, modes, or
    stretches of settings one after the other, at most ``bands`` of them. The rms is NaN where there is no value.
    """
    rows = (None if over is None else by_condition(layout, over)) or by_stretch(layout, 1)
    columns = by_frequency(layout, bands) or by_stretch(layout, bands)
    both = (rows.group >= 0) & (columns.group >= 0)
    cell = rows.group[both] * columns.n_groups + columns.group[both]
    n_cells = rows.n_groups * columns.n_groups
    n = np.bincount(cell, minlength=n_cells)
    squares = np.bincount(cell, weights=standardised[both] ** 2, minlength=n_cells)
    mean = np.divide(squares, n, out=np.full(n_cells, np.nan), where=n > 0)
    return rows.parts, columns.parts, np.sqrt(mean).reshape(rows.n_groups, columns.n_groups)


#: Probability of any place at all where the model is right.
LEVEL = 0.01


def holm(p_values: Sequence[float]) -> FloatArray:
    """Return p-values corrected for their number (Holm 1979), in the order given, shape (n_tests,)."""
    p = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(p)
    stepped = np.maximum.accumulate(p[order] * np.arange(p.size, 0, -1))
    corrected = np.empty_like(p)
    corrected[order] = np.minimum(stepped, 1.0)
    return corrected


def amount_trend_p_value(levels: FloatArray, along: FloatArray, squares: FloatArray) -> float:
    r"""Return the p-value of an amount of a signature that goes with the ranks of a condition.

    With :math:`t = \sum s e` (``along``) and :math:`w = \sum s^2` (``squares``) of each setting and the ranks a less
    their mean weighted with w, :math:`\sum a t / \sqrt{\sum a^2 w}` is exactly standard normal and blind to an amount
    that is the same everywhere. All arrays have shape (n_settings,); a level is NaN where it is not stated.
    """
    usable = np.isfinite(levels) & (squares > 0.0)
    ranks, t, w = scipy.stats.rankdata(levels[usable]), along[usable], squares[usable]
    if ranks.size < 2 or np.ptp(ranks) == 0.0:
        return 1.0
    a = ranks - np.average(ranks, weights=w)
    return float(2.0 * scipy.special.ndtr(-abs(a @ t) / np.sqrt(a**2 @ w)))


@dataclass(frozen=True, slots=True, eq=False)
class _UnderTest:
    """Residuals that are independent and standard normal where the model is right, and which of them count."""

    layout: Layout
    previous: Indices  # in the series, −1 for none, shape (n_values,)
    groupings: tuple[Grouping, ...]
    signatures: tuple[Signature, ...]  # the given ones first
    n_given: int
    residuals: FloatArray
    counts: BoolArray


def _joint_test(tested: _UnderTest) -> tuple[float, bool, tuple[ConditionAxis, ...]]:
    """Run all tests at once, corrected for their number.

    Returned are the smallest p-value, whether a group is too large, and not only the whole, and what amounts go with.
    """
    residuals, of, layout = tested.residuals, tested.counts, tested.layout
    given = [signature.rows[:, of] for signature in tested.signatures[: tested.n_given]]
    squares, n = [float(np.sum(residuals[of] ** 2))], [float(np.count_nonzero(of))]
    for rows in given:
        gain, n_directions = explained(rows, residuals[of])
        squares.append(gain)
        n.append(max(n_directions, 1))
    first_group = len(squares)
    for grouping in tested.groupings:
        n_of_groups, of_groups = (grouping.sums(each, of) for each in (np.ones_like(residuals), residuals**2))
        squares += of_groups[n_of_groups > 0.0].tolist()
        n += n_of_groups[n_of_groups > 0.0].tolist()
    setting = layout.setting[of]
    trends, p_values = list[ConditionAxis](), [float(p) for p in scipy.special.chdtrc(n, squares)]
    for axis in CONDITIONS:
        levels = levels_of(layout, axis)
        for row in (row for rows in given for row in rows):
            along, own = (np.bincount(setting, each, levels.size) for each in (row * residuals[of], row**2))
            p_values.append(amount_trend_p_value(levels, np.asarray(along, np.float64), np.asarray(own, np.float64)))
            trends.append(axis)
    corrected = holm(p_values)
    is_significant = corrected <= LEVEL
    going = (axis for axis, so in zip(trends, is_significant[len(squares) :], strict=True) if so)
    in_groups = bool(np.any(is_significant[first_group : len(squares)]))
    return float(np.min(corrected)), in_groups, tuple(dict.fromkeys(going))


#: A neighbour belongs to the place if it has this share of the mean square of the worst: half of its amplitude.
_BELONGS = 0.25
#: Probability at which the groups of a place and the others are said to differ.
_DIFFERS = 1e-3


def narrow(groupings: Sequence[Grouping], squares: FloatArray, of: BoolArray) -> dict[int, list[int]]:
    """Return the groups, by index of their grouping, that hold the misfit; groupings that do not matter are left out.

    The grouping that separates the misfit best from the rest comes first; each of the next is tested within it.
    ``squares`` are those of residuals that are standard normal where the model is right; those ``of`` are tested.
    """
    chosen: dict[int, list[int]] = {}
    while True:
        inside = within(groupings, chosen, of)
        options = {
            index: _worst_groups(grouping, squares, inside)
            for index, grouping in enumerate(groupings)
            if index not in chosen
        }
        gain, index = max(((gain, index) for index, (gain, _) in options.items()), default=(0.0, -1))
        if gain <= 0.0:
            return chosen
        chosen[index] = options[index][1]


def within(groupings: Sequence[Grouping], chosen: Mapping[int, Sequence[int]], of: BoolArray) -> BoolArray:
    """Return which of some values are in the chosen groups of every grouping, shape (n_values,)."""
    place = of.copy()
    for index, groups in chosen.items():
        place &= groupings[index].holds(groups)
    return place


def _worst_groups(grouping: Grouping, squares: FloatArray, of: BoolArray) -> tuple[float, list[int]]:
    r"""Return the groups that hold the misfit and how clearly they differ from the rest, 0 if they do not.

    The measure is the gain of log-likelihood by two variances in place of one,
    :math:`\frac{1}{2} (n \ln s^2 - n_{in} \ln s_{in}^2 - n_{out} \ln s_{out}^2)`, none of them below 1.
    """
    n, sums = (grouping.sums(values, of) for values in (np.ones_like(squares), squares))
    present = np.flatnonzero(n > 0.0)
    excess = sums[present] / n[present] - 1.0
    worst = int(np.argmax(excess * np.sqrt(n[present])))
    belongs = excess >= _BELONGS * excess[worst]
    if grouping.ordered:
        gaps = np.flatnonzero(~belongs)
        first = np.max(gaps[gaps < worst], initial=-1) + 1
        end = np.min(gaps[gaps > worst], initial=belongs.size)
        belongs = (np.arange(belongs.size) >= first) & (np.arange(belongs.size) < end)
    groups = present[belongs].tolist()
    inside = of & grouping.holds(groups)
    parts = [squares[of], squares[inside], squares[of & ~inside]]
    if excess[worst] <= 0.0 or not parts[2].size:
        return 0.0, groups
    whole, hot, rest = (max(float(np.mean(part)), 1.0) for part in parts)
    if scipy.stats.f.sf(hot / rest, parts[1].size, parts[2].size) > _DIFFERS:
        return 0.0, groups
    terms = [part.size * np.log(variance) for part, variance in zip(parts, (whole, hot, rest), strict=True)]
    return 0.5 * float(terms[0] - terms[1] - terms[2]), groups


_MOST_PLACES = 6
_SEARCH_BANDS = 24
#: What is smaller than the worst place by this factor is its skirt, unless it is of a kind of its own.
_SKIRT = 0.3


@dataclass(frozen=True, slots=True)
class HealthyScatter:
    """How the standardised residuals scatter where the model is right.

    Both are stated and not estimated from the residuals that are tested: a misfit is correlated itself, and an estimate
    would explain it away. The residuals of the best explanation show them.
    """

    correlation: float = 0.0  # of neighbours in a series, from -1 to 1
    deviation: float = 1.0

    def __post_init__(self) -> None:
        if not (-1.0 < self.correlation < 1.0 and self.deviation > 0.0):
            raise OutsideValidityError(
                "a correlation between -1 and 1 and a positive deviation were expected; "
                f"got {self.correlation} and {self.deviation}"
            )


def localise(
    layout: Layout,
    standardised: FloatArray,
    signatures: Mapping[MisfitKind, FloatArray],
    scatter: HealthyScatter | None = None,
) -> tuple[Misfit, ...]:
    """Return where data and model differ, worst first, at most six; one case in a hundred where the model is right.

    The standardised misfit, shape (n_values,), is in standard deviations: standard normal where the model is right, and
    independent but for neighbours; values of a setting and channel follow one another in frequency or time. Signatures,
    shape (n_directions, n_values), are its change with a unit of each stiffness, mass, damping, delay that the model
    could be wrong in. The scatter is for neighbours in a series that are correlated, or deviations off by a factor.
    ``OutsideValidityError`` if the arrays do not fit the layout.
    """
    _check(layout, standardised, signatures)
    scatter = scatter or HealthyScatter()
    previous = previous_in_series(layout)
    white = [
        Signature(signature.kind, _whitened(signature.rows, previous, scatter), signature.root)
        for signature in with_derived_kinds(layout, signatures)
    ]
    tested = _UnderTest(
        layout=layout,
        previous=previous,
        groupings=groupings(layout, _SEARCH_BANDS),
        signatures=tuple(white),
        n_given=sum(1 for rows in signatures.values() if rows.size),
        residuals=_whitened(standardised, previous, scatter),
        counts=np.ones(layout.n_values, dtype=np.bool_),
    )
    return tuple(sorted(_places(tested, standardised), key=lambda misfit: -misfit.size))


def _check(layout: Layout, standardised: FloatArray, signatures: Mapping[MisfitKind, FloatArray]) -> None:
    if standardised.shape != (layout.n_values,) or not np.all(np.isfinite(standardised)):
        raise OutsideValidityError(
            f"one finite residual for each of {layout.n_values} values was expected; got the shape {standardised.shape}"
            f" with {np.count_nonzero(~np.isfinite(standardised))} that are not finite"
        )
    for kind, rows in signatures.items():
        if rows.ndim != 2 or rows.shape[1] != layout.n_values:
            raise OutsideValidityError(
                f"the signature {kind} needs the shape (n_directions, {layout.n_values}); got {rows.shape}"
            )


def _whitened(values: FloatArray, previous: Indices, scatter: HealthyScatter) -> FloatArray:
    """Return what is new in each value against the one before it, shape (..., n_values).

    Of an autoregression of first order with the stated correlation this is independent and of one deviation.
    """
    follows = previous >= 0
    white = np.array(values, dtype=np.float64)
    white[..., follows] -= scatter.correlation * values[..., previous[follows]]
    white[..., follows] /= np.sqrt(1.0 - scatter.correlation**2)
    return white / scatter.deviation


def _places(tested: _UnderTest, standardised: FloatArray) -> Iterator[Misfit]:
    """Yield places one after the other, each found in what those before it have left."""
    worst, remnant, reported = 0.0, 0.0, {MisfitKind.UNCLEAR, MisfitKind.EXTRA_MODE}
    for _ in range(_MOST_PLACES):
        p_value, in_groups, trends = _joint_test(tested)
        if p_value > LEVEL:
            return
        chosen = narrow(tested.groupings, tested.residuals**2, tested.counts) if in_groups else {}
        place = within(tested.groupings, chosen, tested.counts)
        kind = _kind(tested, chosen, place)
        left, size = (float(np.sqrt(np.mean(values[place] ** 2))) for values in (tested.residuals, standardised))
        if left > worst:
            # Linear signatures leave a part of a large misfit, which may look like any other kind.
            worst, remnant = left, min(float(np.sqrt(max(1.0 - kind.share, 0.0))), _SKIRT)
        if left >= (_SKIRT if kind.kind in reported else remnant) * worst:
            extents = tuple(tested.groupings[index].extent(chosen[index]) for index in sorted(chosen))
            yield Misfit(MisfitPlace(extents, () if extents else trends), size, kind.kind, p_value)
        reported.add(kind.kind)
        # The value after the place has a part of its last one in it, where neighbours are correlated.
        rest = tested.counts & ~place & ~(place[tested.previous] & (tested.previous >= 0))
        if not np.any(rest):
            return
        tested = replace(tested, residuals=take_out(tested.residuals, kind, rest), counts=rest)


def _kind(tested: _UnderTest, chosen: Mapping[int, Sequence[int]], place: BoolArray) -> KindFound:
    """Compare kinds over all frequencies, channels and levels that were measured under the conditions of a place."""
    whole = (None, ConditionAxis.FREQUENCY, ConditionAxis.LEVEL)
    conditions = {index: groups for index, groups in chosen.items() if tested.groupings[index].axis not in whole}
    return kind_of(
        tested.layout, tested.residuals, tested.signatures, place, within(tested.groupings, conditions, tested.counts)
    )
