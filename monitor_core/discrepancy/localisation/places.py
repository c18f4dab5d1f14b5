r"""Where a misfit sits, and what it looks like.

Residuals that are standard normal and independent where the model is right are asked, together at one level (Holm):
is their sum of squares too large, over all and over every band, channel, position, preload, payload, temperature,
excitation level and direction (χ²); do they follow one another along a series (Ljung and Box, and the runs of their
signs); does their size go with a condition (rank correlation); do they go along a signature, or more so with a
condition. What is found is narrowed to the place that holds it, named by its kind, taken out, and the rest is asked
again.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.discrepancy.explanation import Misfit, MisfitKind
from monitor_core.discrepancy.localisation.misfit_kind import (
    KindFound,
    Signature,
    explained,
    kind_of,
    take_out,
    with_derived_kinds,
)
from monitor_core.discrepancy.localisation.misfit_place import narrow, within
from monitor_core.discrepancy.localisation.misfit_tests import (
    amount_trend_p_value,
    group_p_values,
    holm,
    order_p_values,
    size_trend_p_value,
)
from monitor_core.effects.effect import ConditionAxis
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Layout
from monitor_core.fitting.conditions.groups import (
    CONDITIONS,
    Grouping,
    Indices,
    by_condition,
    by_frequency,
    by_stretch,
    groupings,
    levels_of,
    previous_in_series,
)

#: Probability of any place at all where the model is right.
LEVEL = 0.01
_MOST_PLACES = 6
_SEARCH_BANDS = 24
#: What is smaller than the worst place by this factor is its skirt, unless it is of a kind of its own.
_SKIRT = 0.3


@dataclass(frozen=True, slots=True)
class HealthyScatter:
    """How the standardised residuals scatter where the model is right.

    Both are stated and not estimated from the residuals that are asked: a misfit is correlated itself, and an estimate
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


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """Residuals that are independent and standard normal where the model is right, and which of them count."""

    layout: Layout
    previous: Indices  # in the series, −1 for none, shape (n_values,)
    groupings: tuple[Grouping, ...]
    signatures: tuple[Signature, ...]  # the given ones first
    n_given: int
    residuals: FloatArray
    counts: BoolArray


@dataclass(frozen=True, slots=True)
class _Found:
    """What the tests together say."""

    p_value: float  # the smallest, corrected
    in_groups: bool  # whether a group is too large, and not the whole alone
    trends: tuple[ConditionAxis, ...]


def localise(
    layout: Layout,
    standardised: FloatArray,
    signatures: Mapping[MisfitKind, FloatArray],
    scatter: HealthyScatter | None = None,
) -> tuple[Misfit, ...]:
    """Say where data and model part.

    Parameters
    ----------
    layout : Layout
        What the values belong to; those of a setting and channel follow one another in frequency or time.
    standardised : ndarray, shape (n_values,)
        Misfit in standard deviations: standard normal where the model is right, and independent but for neighbours.
    signatures : mapping of MisfitKind to ndarray, shape (n_directions, n_values)
        Change of ``standardised`` with a unit of each stiffness, mass, damping, delay that the model could be wrong in.
    scatter : HealthyScatter, optional
        Where neighbours in a series are correlated, or the deviations off by a factor.

    Returns
    -------
    tuple of Misfit
        The worst first, at most six. Where the model is right there is none, but for one case in a hundred.

    Raises
    ------
    OutsideValidityError
        If the arrays do not fit the layout.
    """
    _check(layout, standardised, signatures)
    scatter = scatter or HealthyScatter()
    previous = previous_in_series(layout)
    white = [
        Signature(one.kind, _whitened(one.rows, previous, scatter), one.root)
        for one in with_derived_kinds(layout, signatures)
    ]
    asked = _Asked(
        layout=layout,
        previous=previous,
        groupings=groupings(layout, _SEARCH_BANDS),
        signatures=tuple(white),
        n_given=sum(1 for rows in signatures.values() if rows.size),
        residuals=_whitened(standardised, previous, scatter),
        counts=np.ones(layout.n_values, dtype=np.bool_),
    )
    return tuple(sorted(_places(asked, standardised), key=lambda one: -one.size))


def varied_conditions_of_maps(layout: Layout) -> tuple[ConditionAxis, ...]:
    """Return what a picture of the misfit may go over: every condition of which there is more than one value."""
    groupings = {axis: by_condition(layout, axis) for axis in CONDITIONS}
    return tuple(axis for axis, one in groupings.items() if one is not None and one.n_groups > 1)


def misfit_map(
    layout: Layout, standardised: FloatArray, over: ConditionAxis | None, bands: int = 8
) -> tuple[tuple[str, ...], tuple[str, ...], FloatArray]:
    """Return the rms of the standardised misfit as a picture.

    Parameters
    ----------
    layout : Layout
    standardised : ndarray, shape (n_values,)
        Misfit in standard deviations.
    over : ConditionAxis or None
        The condition whose values are the rows; None for one row of everything.
    bands : int
        How many columns there are at most: logarithmic bands of responses, or stretches of a motion.

    Returns
    -------
    tuple of str, tuple of str, ndarray of shape (n_rows, n_columns)
        Names of the rows, names of the columns (bands, modes, or stretches of settings one after the other), and the
        rms, NaN where there is no value.
    """
    rows = (None if over is None else by_condition(layout, over)) or by_stretch(layout, 1)
    columns = by_frequency(layout, bands) or by_stretch(layout, bands)
    both = (rows.group >= 0) & (columns.group >= 0)
    cell = rows.group[both] * columns.n_groups + columns.group[both]
    n_cells = rows.n_groups * columns.n_groups
    n = np.bincount(cell, minlength=n_cells)
    squares = np.bincount(cell, weights=standardised[both] ** 2, minlength=n_cells)
    mean = np.divide(squares, n, out=np.full(n_cells, np.nan), where=n > 0)
    return rows.names, columns.names, np.sqrt(mean).reshape(rows.n_groups, columns.n_groups)


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


def _places(asked: _Asked, standardised: FloatArray) -> Iterator[Misfit]:
    """Yield one place after the other, each found in what the ones before it have left."""
    worst, remnant, told = 0.0, 0.0, {MisfitKind.UNCLEAR, MisfitKind.EXTRA_MODE}
    for _ in range(_MOST_PLACES):
        found = _test(asked)
        if found.p_value > LEVEL:
            return
        chosen = narrow(asked.groupings, asked.residuals**2, asked.counts) if found.in_groups else {}
        place = within(asked.groupings, chosen, asked.counts)
        kind = _kind(asked, chosen, place)
        left, size = (float(np.sqrt(np.mean(values[place] ** 2))) for values in (asked.residuals, standardised))
        if left > worst:
            # Linear signatures leave a part of a large misfit, which may look like any other kind.
            worst, remnant = left, min(float(np.sqrt(max(1.0 - kind.share, 0.0))), _SKIRT)
        if left >= (_SKIRT if kind.kind in told else remnant) * worst:
            yield Misfit(_words(asked, chosen, found.trends), size, kind.kind, found.p_value)
        told.add(kind.kind)
        # The value after the place has a part of its last one in it, where neighbours are correlated.
        rest = asked.counts & ~place & ~(place[asked.previous] & (asked.previous >= 0))
        if not np.any(rest):
            return
        asked = replace(asked, residuals=take_out(asked.residuals, kind, rest), counts=rest)


def _test(asked: _Asked) -> _Found:
    """Ask everything at once."""
    residuals, of, layout = asked.residuals, asked.counts, asked.layout
    p_values = [float(stats.chi2.sf(np.sum(residuals[of] ** 2), np.count_nonzero(of)))]
    p_values += order_p_values(residuals, asked.previous, of)
    given = asked.signatures[: asked.n_given]
    for one in given:
        gain, n_directions = explained(one.rows[:, of], residuals[of])
        p_values.append(float(stats.chi2.sf(gain, max(n_directions, 1))))
    first_group = len(p_values)
    for grouping in asked.groupings:
        p_values += group_p_values(grouping, residuals, of).tolist()
    first_trend = len(p_values)
    trends = []
    for axis in CONDITIONS:
        levels = levels_of(layout, axis)
        for p_value in _trend_p_values(asked, given, levels):
            p_values.append(p_value)
            trends.append(axis)
    corrected = holm(p_values)
    significant = corrected[first_trend:] <= LEVEL
    return _Found(
        p_value=float(np.min(corrected)),
        in_groups=bool(np.any(corrected[first_group:first_trend] <= LEVEL)),
        trends=tuple(dict.fromkeys(axis for axis, so in zip(trends, significant, strict=True) if so)),
    )


def _trend_p_values(asked: _Asked, given: Sequence[Signature], levels: FloatArray) -> Iterator[float]:
    """Yield p-values of sizes, and of amounts of the given signatures, that go with a condition."""
    if np.unique(levels[np.isfinite(levels)]).size < 2:
        return
    setting, n_settings = asked.layout.setting[asked.counts], levels.size
    residuals = asked.residuals[asked.counts]

    def per_setting(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(setting, weights=values, minlength=n_settings), dtype=np.float64)

    yield size_trend_p_value(levels, per_setting(residuals**2), per_setting(np.ones_like(residuals)))
    for one in given:
        for row in one.rows[:, asked.counts]:
            yield amount_trend_p_value(levels, per_setting(row * residuals), per_setting(row**2))


def _kind(asked: _Asked, chosen: Mapping[int, Sequence[int]], place: BoolArray) -> KindFound:
    """Compare kinds over all frequencies, channels and levels that were measured under the conditions of a place."""
    whole = (None, ConditionAxis.FREQUENCY, ConditionAxis.LEVEL)
    conditions = {index: groups for index, groups in chosen.items() if asked.groupings[index].axis not in whole}
    return kind_of(
        asked.layout, asked.residuals, asked.signatures, place, within(asked.groupings, conditions, asked.counts)
    )


def _words(asked: _Asked, chosen: Mapping[int, Sequence[int]], trends: Sequence[ConditionAxis]) -> str:
    words = [asked.groupings[index].words(chosen[index]) for index in sorted(chosen)]
    if not words:
        words = ["everywhere", *(["changing with " + " and ".join(trends)] if trends else [])]
    return ", ".join(words)
