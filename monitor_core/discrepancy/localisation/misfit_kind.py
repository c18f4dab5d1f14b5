r"""Say what a misfit looks like: which signatures it is made of.

A signature is how the residuals move with a stiffness, a mass, a damping, a delay. Subspaces of signatures of different
dimension are compared by

.. math:: \min_{s^2 \ge 1} \; n \ln s^2 + \mathrm{RSS}/s^2 + k \ln n

the BIC of k signatures in n residuals that are standard normal, or wider where nothing explains all of them (Schwarz
1978). Two kinds follow from the others: a hysteretic loss is a damping whose force does not grow with the rate, and
a misfit depends on the amplitude if settings that differ in nothing but the excitation level need different amounts.
"""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.discrepancy.explanation import MisfitKind
from monitor_core.effects import PREFIX
from monitor_core.effects.effect import ConditionAxis, Effect, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Layout
from monitor_core.fitting.conditions.groups import has_lines, levels_of
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
