"""Which effects the data cannot tell apart, and how well a found effect is known."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.explanation import FoundParameter
from monitor_core.discrepancy.search.search import Accepted, Found
from monitor_core.discrepancy.verdict.foreign_modes import modes_of_their_own
from monitor_core.effects import PREFIX
from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.fitting.evidence import STRONG, VERY_STRONG, Yardstick, least_difference
from monitor_core.fitting.hold_out import leaves_something
from monitor_core.fitting.hypothesis import is_size
from monitor_core.fitting.solver.hypothesis_fit import Fitted
from monitor_core.uncertainty import Estimate

Physics = TypeVar("Physics")

#: Two effects that leave the same residuals say one thing in two ways.
_SAME_COST = 0.5
_SAME_RESIDUALS = 0.02  # rms difference, in standard deviations
_AT_THE_END = 1e-3  # of the range of a parameter that is not sought beyond it: there the search lacked room

#: By so much of itself may be off what an effect does, though nothing is left that tells; but no more than such a share
#: of the values can hide.
_SHAPE_ERROR = 0.05
_HIDDEN = 0.01
#: Where something is left the model lacks more: then effects are not held apart by less of their gain of BIC either.
_MARGIN_OF_GAIN = 0.05


@dataclass(frozen=True, eq=False)
class Member(Generic[Physics]):
    """An effect that would do, with the fit that has it."""

    effect: Effect[Physics]
    fitted: Fitted[Physics]
    delta_bic: float
    plausible: bool
    twins: tuple[str, ...] = ()  # keys that say the same in another way


@dataclass(frozen=True, eq=False)
class EquivalenceClass(Generic[Physics]):
    """Effects that the data cannot tell apart, the one to be named first in front."""

    members: tuple[Member[Physics], ...]
    untested: tuple[str, ...]  # keys of what would do as well, as far as such data can tell at all
    held_out_gain: float

    @property
    def others(self) -> tuple[str, ...]:
        """Return the keys of what may be the true effect as well as the leader."""
        return (*(key for one in self.members[1:] for key in (one.effect.key, *one.twins)), *self.untested)

    @property
    def twins(self) -> tuple[str, ...]:
        """Return the keys that say what the leader says in another way."""
        return self.leader.twins

    @property
    def leader(self) -> Member[Physics]:
        """Return the member to be named first."""
        return self.members[0]


def equivalence_class(
    found: Found[Physics],
    accepted: Accepted[Physics],
    candidates: Sequence[Effect[Physics]],
    *,
    leading: Collection[str] = (),
    barred: Collection[str] = (),
) -> EquivalenceClass[Physics]:
    """Return an accepted effect with what would do in its place.

    Among members that leave the same residuals the one of the catalogue leads, unless it takes a value that is not
    plausible: an added mass and a wrong mass are then one finding, not two.

    Parameters
    ----------
    found : Found
    accepted : Accepted
        One of its effects.
    candidates : sequence of Effect
        Whatever the axis may lack.
    leading : collection of str, optional
        Keys that lead other classes: no effect is in a model twice.
    barred : collection of str, optional
        Keys that may not lead.
    """
    by = found.yardstick
    own = _member(accepted.effect, found.final, accepted.delta_bic, by)
    rivals = [
        _member(rival.effect, rival.fitted, rival.delta_bic, by)
        for rival in accepted.rivals
        if rival.effect.key not in leading
    ]
    if leaves_something(found.final):
        of_gain = _MARGIN_OF_GAIN * accepted.delta_bic
    else:
        of_gain = min(_margin_of_shape(accepted.delta_bic), _HIDDEN * by.n_values * by.share)
    margin = max(least_difference(found.final.comparison), of_gain)
    best = max([own.delta_bic, *(one.delta_bic for one in rivals)])
    inside = [own, *(one for one in rivals if one.delta_bic >= best - margin)]
    ordered = sorted(inside, key=lambda one: (one.effect.key in barred, *_precedence(one)))
    members: list[Member[Physics]] = []
    for one in ordered:
        alike = next((n for n, other in enumerate(members) if _are_twins(one, other)), None)
        if alike is None:
            members.append(one)
        else:
            members[alike] = replace(members[alike], twins=(*members[alike].twins, one.effect.key))
    members.sort(key=lambda one: (one.effect.key in barred, not one.plausible, -one.delta_bic))
    untested = modes_of_their_own(accepted.without, candidates)
    return EquivalenceClass(tuple(members), untested, accepted.held_out_gain)


def _margin_of_shape(gain: float) -> float:
    r"""Return the least difference D of BIC that an effect whose form is a little off does not feign.

    What it does to the data measures √G standard deviations, and where another does best by D the two are √D apart. An
    error ε√G along that distance moves D by :math:`2 \epsilon \sqrt{G D}`: what is left is to be very strong evidence.
    """
    error = _SHAPE_ERROR * math.sqrt(max(gain, 0.0))
    return (error + math.hypot(error, math.sqrt(VERY_STRONG))) ** 2


def _precedence(one: Member[Physics]) -> tuple[bool, bool, float]:
    return (not one.plausible, one.effect.key.startswith(PREFIX), -one.delta_bic)


def _are_twins(one: Member[Physics], other: Member[Physics]) -> bool:
    difference = one.fitted.standardised - other.fitted.standardised
    same = float(np.sqrt(np.mean(difference**2))) < _SAME_RESIDUALS
    return same and abs(one.fitted.cost - other.fitted.cost) < _SAME_COST


def _member(effect: Effect[Physics], fitted: Fitted[Physics], delta_bic: float, by: Yardstick) -> Member[Physics]:
    own = [index for index, (other, _) in enumerate(fitted.hypothesis.unknowns) if other.key == effect.key]
    return Member(effect, fitted, delta_bic, all(_is_plausible(fitted, index, by) for index in own))


def _is_plausible(fitted: Fitted[Physics], index: int, by: Yardstick) -> bool:
    """Tell whether an unknown lies within its plausible range, and not at an end that the data want it to leave."""
    effect, one = fitted.hypothesis.unknowns[index]
    value = fitted.hypothesis.values(fitted.coordinates)[effect.key][one.name]
    if one.beyond or not _at_an_end(effect, one, value):
        return one.lower <= value <= one.upper
    at = fitted.hypothesis.n_uncertain + index
    slope = float(fitted.jacobian[fitted.fitted, at] @ fitted.standardised[fitted.fitted])
    downhill = -slope * one.scale  # a scale may be negative: that of what can only become less
    outward = downhill > 0.0 if one.upper - value < value - one.lower else downhill < 0.0
    promised = by.factor**2 * slope**2 * float(covariance(fitted, by)[at, at])
    return not (outward and promised > STRONG)


def _at_an_end(effect: Effect[Physics], one: EffectParameter, value: float) -> bool:
    """Tell whether a parameter not sought beyond its range stands at an end of it; at a textbook value it may."""
    known = effect.textbook is not None and abs(value - effect.textbook[one.name]) < _AT_THE_END
    if (one.beyond and one is effect.parameters[0]) or known:
        return False
    room = min(value - one.lower, one.upper - value) / (one.upper - one.lower)
    return 0.0 <= room < _AT_THE_END


def covariance(fitted: Fitted[Physics], by: Yardstick) -> FloatArray:
    r"""Return the covariance of the coordinates, :math:`(f J^T J + \Pi)^{-1}` with the priors' precision Π.

    f is the yardstick's factor: residuals that hang together, or exceed their budget, say less.
    """
    n = fitted.hypothesis.n_coordinates
    precision = fitted.precision(by.factor)
    scale = np.sqrt(np.maximum(np.diag(precision), 1e-300))
    correlation = precision / np.outer(scale, scale)
    return np.asarray(np.linalg.pinv(correlation, rcond=1e-13, hermitian=True) / np.outer(scale, scale)).reshape(n, n)


def found_parameters(member: Member[Physics], stated: Fitted[Physics], by: Yardstick) -> dict[str, FoundParameter]:
    """Return the parameters of a member with their standard uncertainties and 95 % coverage intervals.

    An interval ends at 0 where a parameter cannot have the other sign.
    Beside the scatter of the data stands what the formula of the effect leaves out, of a size.

    Parameters
    ----------
    member : Member
    stated : Fitted
        With it and with all else that was found, as the augmented model has it: at the mode of the posterior.
    by : Yardstick
    """
    values = stated.hypothesis.values(stated.coordinates)[member.effect.key]
    variances = np.diag(covariance(stated, by))
    found = {}
    for index, (effect, one) in enumerate(stated.hypothesis.unknowns):
        if effect.key != member.effect.key:
            continue
        value, at = values[one.name], stated.hypothesis.n_uncertain + index
        scatter = math.sqrt(max(float(variances[at]), 0.0))
        form = effect.form_share * abs(value) if is_size(one) else 0.0
        deviation = math.hypot(one.scale * scatter, form)
        lower, upper = (end if end == 0.0 else side * math.inf for side, end in ((-1, one.lower), (1, one.upper)))
        interval = (max(lower, value - 1.959964 * deviation), min(upper, value + 1.959964 * deviation))
        at_end = _at_an_end(effect, one, value)
        plausible = _is_plausible(stated, index, by)
        found[one.name] = FoundParameter(Estimate(value, deviation), one.unit, interval, plausible, at_end)
    return found
