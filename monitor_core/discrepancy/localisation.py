r"""Locate a misfit, as places and as maps: where data and model differ, and what the difference looks like.

Residuals that are standard normal and independent where the model is right are tested, together at one level (Holm):
is their sum of squares too large, over all and over every band, channel, position, preload, payload, temperature,
excitation level and direction (χ²); do they go along a signature, or more so with a condition (rank correlation). What
is found is narrowed to the place that holds it, named by its kind and taken out; then the rest is tested again. A map
has the rms of the misfit by the values of a condition and by frequency band.

A signature is how the residuals move with a stiffness, a mass, a damping, a delay. Subspaces of signatures of different
dimension are compared by

.. math:: \min_{s^2 \ge 1} \; n \ln s^2 + \mathrm{RSS}/s^2 + k \ln n

the BIC of k signatures in n residuals that are standard normal, or wider where nothing explains all of them (Schwarz
1978). Two kinds follow from the others: a hysteretic loss is a damping whose force does not grow with the rate, and
a misfit depends on the amplitude if settings that differ in nothing but the excitation level need different amounts.
"""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.discrepancy.explanation import Misfit, MisfitKind, MisfitPlace
from monitor_core.effects import PREFIX
from monitor_core.effects.effect import ConditionAxis, Effect, Physics
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
    has_lines,
    levels_of,
    previous_in_series,
)
from monitor_core.fitting.solver.derivatives import derivative
from monitor_core.fitting.solver.hypothesis_fit import Fitted

#: By the unit that ends the name of what an effect, or a wrong parameter, is stated in.
_KINDS = (
    ("ns_per_m", MisfitKind.DAMPING),
    ("nms_per_rad", MisfitKind.DAMPING),
    ("loss_factor", MisfitKind.DAMPING),
    ("n_per_m", MisfitKind.STIFFNESS),
    ("nm_per_rad", MisfitKind.STIFFNESS),
    ("m_per_n", MisfitKind.STIFFNESS),
    ("_kg", MisfitKind.MASS),
    ("kg_m2", MisfitKind.MASS),
    ("delay_s", MisfitKind.DELAY),
)


def signatures(fitted: Fitted[Physics], effects: Sequence[Effect[Physics]]) -> dict[MisfitKind, FloatArray]:
    """Return the change of the residuals with each effect that is a stiffness, a mass, a damping or a delay.

    Shape (n_effects, n_values) for each kind. Effects of no plain kind, and those of several quantities, are passed
    over.
    """
    rows: dict[MisfitKind, list[FloatArray]] = {}
    for effect in effects:
        kind = kind_of_effect(effect)
        if kind is None:
            continue
        hypothesis = fitted.hypothesis.with_effect(effect)
        start = hypothesis.carried_over(fitted.hypothesis, fitted.coordinates)
        try:
            slope = derivative(fitted.around, hypothesis, start, fitted.misfit, start.size - 1)
        except OutsideValidityError:
            continue
        if np.any(slope):
            rows.setdefault(kind, []).append(fitted.around.whitened_by(slope))
    return {kind: np.array(signatures) for kind, signatures in rows.items()}


def kind_of_effect(effect: Effect[Physics]) -> MisfitKind | None:
    """Return what kind of quantity an effect adds, None where it is of no plain kind."""
    if len(effect.parameters) != 1:
        return None
    name = effect.key.removeprefix(PREFIX) if effect.key.startswith(PREFIX) else effect.parameters[0].name
    return next((kind for ending, kind in _KINDS if name.endswith(ending)), None)


#: Difference of BIC that is called very strong evidence (Kass and Raftery 1995).
_CLEAR = 10.0
_MOST_KINDS = 3
#: A kind is stated if it and its companions explain this share of what is in the place, and the law of a loss if they
#: explain that one: where a misfit is large, what the linear signatures leave of it is like a loss of another law.
_LEAST_SHARE, _LEAST_SHARE_FOR_LAW = 0.6, 0.8
#: An extra mode stays within the first range, relatively, wherever the table is; it is not wider than the second, and
#: looked for as far as the third on either side.
_STANDS_STILL, _NARROW, _AROUND = 0.05, 2.0, 1.3
_RANK = 1e-10  # of a normalised Gram matrix
_UNSEEN = 1e-9  # share of a direction: less of it in some values is rounding, and its amount there would be anything


@dataclass(frozen=True, slots=True, eq=False)
class Signature:
    """Directions in which one cause moves the residuals."""

    kind: MisfitKind
    rows: FloatArray  # shape (n_directions, n_values)
    root: MisfitKind  # the kind that was given and this one follows from


@dataclass(frozen=True, slots=True, eq=False)
class KindFound:
    """What a misfit looks like, and the directions that explain it."""

    kind: MisfitKind
    rows: FloatArray  # shape (n_directions, n_values); none where nothing explains it
    companions: FloatArray  # of other kinds that are there as well, shape (n_others, n_values)
    share: float  # of the sum of squares beyond noise that all of them explain [-]


def with_derived_kinds(layout: Layout, signatures: Mapping[MisfitKind, FloatArray]) -> tuple[Signature, ...]:
    """Add the signatures that follow from the given ones: hysteretic and amplitude-dependent.

    Given is the change of the standardised residuals with a unit of each cause, shape (n_directions, n_values).
    A viscous force c·v has a loss that grows with frequency; k·η/ω in place of c has one that does not, so the rows are
    those of the dampings over the frequency. Where values have no frequency the rows of a damping go with the speed and
    those of a hysteretic loss with its sign.
    """
    given = [Signature(kind, rows, kind) for kind, rows in signatures.items() if rows.size]
    if MisfitKind.DAMPING in signatures:
        rate_free = _without_rate(layout, signatures[MisfitKind.DAMPING])
        given.append(Signature(MisfitKind.HYSTERESIS, rate_free, MisfitKind.DAMPING))
    level = _level_within_matched_settings(layout)[layout.setting]
    if np.any(level):
        given += [
            Signature(MisfitKind.AMPLITUDE, np.vstack([signature.rows, signature.rows * level]), signature.root)
            for signature in given
        ]
    return tuple(given)


def kind_of(
    layout: Layout, residuals: FloatArray, signatures: Sequence[Signature], place: BoolArray, compared: BoolArray
) -> KindFound:
    """Say what the misfit in a place looks like: ``UNCLEAR`` where no kind explains the place, or two do equally well.

    ``residuals`` are independent and standard normal where the model is right, and ``signatures`` are theirs. Kinds are
    told apart by the values ``compared``: the place with all that was measured under the same conditions, since far
    from a resonance a mass differs from a stiffness. All arrays have shape (n_values,).
    """
    chosen = _select(residuals, signatures, compared)
    rows = _rows_of(chosen, layout.n_values)
    amounts = _amounts(rows, residuals, compared)
    share = _share(residuals, residuals - amounts @ rows, place)
    if not chosen or share < _LEAST_SHARE:
        extra = _is_extra_mode(layout, residuals, signatures, place)
        return KindFound(MisfitKind.EXTRA_MODE if extra else MisfitKind.UNCLEAR, rows[:0], rows, share)
    ends = np.cumsum([signature.rows.shape[0] for signature, _ in chosen])[:-1]
    parts = [part @ signature.rows for part, (signature, _) in zip(np.split(amounts, ends), chosen, strict=True)]
    strongest = int(np.argmax([np.sum(part[place] ** 2) for part in parts]))
    signature, kind = chosen[strongest]
    if kind is MisfitKind.HYSTERESIS and share < _LEAST_SHARE_FOR_LAW:
        kind = signature.root
    others = _rows_of(chosen[:strongest] + chosen[strongest + 1 :], layout.n_values)
    return KindFound(kind, signature.rows, others, share)


def take_out(residuals: FloatArray, kind: KindFound, of: BoolArray) -> FloatArray:
    """Return the residuals without what the kind explains of the chosen values besides its companions."""
    rows = np.vstack([kind.rows, kind.companions])
    amounts = _amounts(rows, residuals, of)
    return residuals - amounts[: kind.rows.shape[0]] @ kind.rows


def explained(rows: FloatArray, residuals: FloatArray) -> tuple[float, int]:
    """Return the sum of squares that rows explain, and along how many independent directions."""
    norms = np.linalg.norm(rows, axis=1)
    scaled = rows[norms > 0.0] / norms[norms > 0.0, None]
    values, vectors = np.linalg.eigh(scaled @ scaled.T)
    kept = values > _RANK * scaled.shape[0]
    along = (vectors[:, kept].T @ (scaled @ residuals)) ** 2 / values[kept]
    return float(np.sum(along)), int(np.count_nonzero(kept))


def _amounts(rows: FloatArray, residuals: FloatArray, of: BoolArray) -> FloatArray:
    """Return the amounts of rows that explain the chosen residuals best, 0 of rows that these values do not see."""
    norms = np.linalg.norm(rows[:, of], axis=1)
    seen = norms > _UNSEEN * np.linalg.norm(rows, axis=1)
    scaled = rows[seen][:, of] / norms[seen, None]
    amounts = np.zeros(norms.size)
    amounts[seen] = np.linalg.pinv(scaled @ scaled.T, rcond=_RANK, hermitian=True) @ (scaled @ residuals[of])
    amounts[seen] /= norms[seen]
    return amounts


def _select(
    residuals: FloatArray, signatures: Sequence[Signature], compared: BoolArray
) -> list[tuple[Signature, MisfitKind]]:
    """Choose signatures one after the other while the BIC supports them, each with the kind that may be stated."""
    values = residuals[compared]
    total, n = float(values @ values), values.size
    chosen: list[tuple[Signature, MisfitKind]] = []
    best = _bic(total, n, 0)
    while len(chosen) < _MOST_KINDS:
        trials = []
        for signature in signatures:
            if any(signature.root is other.root for other, _ in chosen):
                continue  # two kinds that are alike would be set against each other to bend what neither is
            rows = np.vstack([_rows_of(chosen, residuals.size), signature.rows])
            gain, n_directions = explained(rows[:, compared], values)
            trials.append((_bic(total - gain, n, n_directions), n_directions, signature))
        least, size, winner = min(trials, key=lambda trial: trial[0], default=(math.inf, 0, None))
        if winner is None or least > best - _CLEAR:
            break
        # Few directions alone must not decide: a rival has to do worse by the mild penalty of Akaike (1974) as well.
        milder = math.log(n) - 2.0
        rivals = [signature for bic, k, signature in trials if bic - max(k - size, 0) * milder < least + _CLEAR]
        chosen.append((winner, _common_kind(rivals)))
        best = least
    return chosen


def _rows_of(chosen: Sequence[tuple[Signature, MisfitKind]], n_values: int) -> FloatArray:
    return np.vstack([np.zeros((0, n_values)), *(signature.rows for signature, _ in chosen)])


def _common_kind(rivals: Sequence[Signature]) -> MisfitKind:
    """Return the kind of signatures that do equally well: the plainest of one root, which comes first."""
    same = len({rival.kind for rival in rivals}) == 1 or len({rival.root for rival in rivals}) == 1
    return rivals[0].kind if same else MisfitKind.UNCLEAR


def _bic(rss: float, n: int, n_directions: int) -> float:
    variance = max(rss / n, 1.0)
    return n * math.log(variance) + rss / variance + n_directions * math.log(n)


def _share(before: FloatArray, after: FloatArray, place: BoolArray) -> float:
    n = np.count_nonzero(place)
    excess, left = (max(float(np.sum(part[place] ** 2)) - n, 0.0) for part in (before, after))
    return 1.0 - left / excess if excess > 0.0 else 1.0


def _is_extra_mode(layout: Layout, residuals: FloatArray, signatures: Sequence[Signature], place: BoolArray) -> bool:
    """Return whether a misfit is narrow, at one frequency at every position, and not where the model has a mode.

    Where the model has its own modes is where its dampings are seen; a misfit there is more likely theirs.
    """
    positions = levels_of(layout, ConditionAxis.POSITION)[layout.setting]
    distinct = np.unique(positions[np.isfinite(positions)])
    if not has_lines(layout) or distinct.size < 2 or not np.all(np.isin(distinct, positions[place])):
        return False
    low, high = np.min(layout.frequency[place]), np.max(layout.frequency[place])
    around = (layout.frequency >= low / _AROUND) & (layout.frequency <= high * _AROUND)
    of_positions = [
        around & (positions == position) & np.isin(layout.channel, layout.channel[place]) for position in distinct
    ]
    centres = [np.average(np.log(layout.frequency[lines]), weights=residuals[lines] ** 2) for lines in of_positions]
    dampings = [signature.rows for signature in signatures if signature.kind is MisfitKind.DAMPING]
    own = np.sum(np.vstack([np.zeros((1, layout.n_values)), *dampings]) ** 2, axis=0)
    still = high <= _NARROW * low and np.ptp(centres) < _STANDS_STILL
    return bool(still and np.mean(own[place]) <= np.mean(own))


def _without_rate(layout: Layout, dampings: FloatArray) -> FloatArray:
    stated = np.isfinite(layout.frequency)
    if not np.any(stated):
        return np.asarray(np.sign(dampings) / layout.standard_deviation)
    return dampings * np.divide(1.0, layout.frequency, out=np.zeros(layout.n_values), where=stated)


def _level_within_matched_settings(layout: Layout) -> FloatArray:
    """Return ln of the excitation level against the mean of the settings that differ in nothing else, (n_settings,)."""
    level = levels_of(layout, ConditionAxis.LEVEL)
    matched: dict[tuple[tuple[str, str], ...], list[int]] = defaultdict(list)
    for index, setting in enumerate(layout.settings):
        others = sorted(
            (str(axis), f"{value:.6g}") for axis, value in setting.values.items() if axis != ConditionAxis.LEVEL
        )
        if level[index] > 0.0:
            matched[tuple(others)].append(index)
    centred = np.zeros(level.size)
    for members in matched.values():
        logarithm = np.log(level[members])
        centred[members] = logarithm - np.mean(logarithm)
    return centred


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


def ranks_of(values: FloatArray) -> FloatArray:
    """Return the rank of each value from 1, the mean of theirs for equal ones (``scipy.stats`` takes long to load)."""
    _, which, counts = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(counts) - 0.5 * (counts - 1))[which])


def amount_trend_p_value(levels: FloatArray, along: FloatArray, squares: FloatArray) -> float:
    r"""Return the p-value of an amount of a signature that goes with the ranks of a condition.

    With :math:`t = \sum s e` (``along``) and :math:`w = \sum s^2` (``squares``) of each setting and the ranks a less
    their mean weighted with w, :math:`\sum a t / \sqrt{\sum a^2 w}` is exactly standard normal and blind to an amount
    that is the same everywhere. All arrays have shape (n_settings,); a level is NaN where it is not stated.
    """
    usable = np.isfinite(levels) & (squares > 0.0)
    ranks, t, w = ranks_of(levels[usable]), along[usable], squares[usable]
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
    if scipy.special.fdtrc(parts[1].size, parts[2].size, hot / rest) > _DIFFERS:
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
