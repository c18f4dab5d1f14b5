"""Group effects that the data cannot distinguish, and state how well a found effect is known.

To tell what goes with the amplitude from another law of it takes enough levels of excitation. At one level a nut that
gives way under load is a softer nut. At two, a cubic stiffness, a play and a contact that opens give the same two
stiffnesses, and friction may stand in for a part of it: the third level tells which law it is, if the effect is large
enough for the laws to differ there.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Final, Generic

import numpy as np

from monitor_core.discrepancy.explanation import FoundParameter
from monitor_core.discrepancy.search.workspace import Accepted, Found
from monitor_core.effects import PREFIX
from monitor_core.effects.effect import ConditionAxis, Effect, EffectParameter, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Layout
from monitor_core.fitting.conditions.groups import has_lines, levels_of, modes_that_stay
from monitor_core.fitting.evidence import STRONG, VERY_STRONG, EvidenceScale, covariance, least_difference
from monitor_core.fitting.hold_out import judged_gap
from monitor_core.fitting.hypothesis import is_size
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit
from monitor_core.uncertainty import Estimate

#: What may be there in the place of an effect at fewer levels than these: its key, for it is none of the catalogue.
AMPLITUDE_LAW: Final = "amplitude-law"
_ENOUGH_LEVELS = 3
#: Levels that are nearer to each other, as a ratio, are one.
_ANOTHER_LEVEL = 1.5
#: Of what an effect does to the data, what another law does otherwise (choices): within the responses where it agrees
#: at one or two levels, and at the third.
_WITHIN_RESPONSES, _AT_THIRD_LEVEL = 0.1, 0.2
#: What a nut that goes with the amplitude passes for: at one or two levels it is a softer one, at one it follows the
#: preload, too, since a stiffer nut is deflected less.
WRONG_NUT_STIFFNESS, PRELOAD_EXPONENT = f"{PREFIX}nut_stiffness_n_per_m", "preload-exponent"


def n_levels(layout: Layout) -> int:
    """Return at how many levels of excitation was measured; settings without one do not count, and 1 if none has one.

    Any difference lets an effect be tested (``varied_conditions``); to tell laws from each other levels must be apart.
    """
    stated = levels_of(layout, ConditionAxis.LEVEL)
    known = np.sort(stated[stated > 0.0])
    levels, last = 0, 0.0
    for level in known.tolist():
        if level > _ANOTHER_LEVEL * last:
            levels, last = levels + 1, level
    return max(levels, 1)


def indistinguishable_law(effect: Effect[Physics], gain: float, layout: Layout) -> str:
    r"""Return the key of the law that such data cannot tell from an effect; empty where they can.

    ================================  ===============  =====================================
    effect                            is left open at  unless
    ================================  ===============  =====================================
    what goes with the amplitude      1 level          –
    what goes with the amplitude      2 levels         :math:`\epsilon^2 G` is very strong evidence
    what goes with the amplitude      3 and more       the same, with ε = 0.2
    another stiffness of the nut      1 or 2 levels    –
    another exponent of the preload   1 level          :math:`\epsilon^2 G` is very strong evidence
    ================================  ===============  =====================================

    G is the ``gain``, the ΔBIC of the effect. Another law that agrees where it was measured differs within the
    responses, whose amplitude goes with the frequency, by a share ε = 0.1 of what the effect does (a choice): of that
    the data would show :math:`\epsilon^2 G`. Of natural frequencies alone it is empty: a table does not say at which
    level they are.
    """
    levels = n_levels(layout)
    if not has_lines(layout):
        return ""
    if goes_with_amplitude(effect):
        apart = _AT_THIRD_LEVEL if levels >= _ENOUGH_LEVELS else _WITHIN_RESPONSES
        is_open = levels == 1 or not _shows(apart, gain)
    elif effect.key == WRONG_NUT_STIFFNESS:
        is_open = levels < _ENOUGH_LEVELS
    else:
        is_open = effect.key == PRELOAD_EXPONENT and levels == 1 and not _shows(_WITHIN_RESPONSES, gain)
    return AMPLITUDE_LAW if is_open else ""


def _shows(apart: float, gain: float) -> bool:
    """Return whether data show what is a share ``apart`` of what they show with a gain of BIC."""
    return apart**2 * gain >= VERY_STRONG


def goes_with_amplitude(effect: Effect[Physics]) -> bool:
    """Return whether an effect changes with the level of the excitation."""
    return ConditionAxis.LEVEL in effect.needs


#: Key of what changes from one measurement to the next where that may be there in the place of an effect.
TIME_LAW: Final = "time-law"
#: A frequency that is off by more, in ln f, is of a mode that the model has not.
_ANOTHER_MODE = 0.25


def foreign_modes(without: Fitted[Physics], effects: Sequence[Effect[Physics]]) -> tuple[str, ...]:
    """Return the keys of effects that may have made a mode which a fit lacks, and which only responses would show.

    Such a mode stays at one frequency under all conditions. What resonates there by itself moves no mode of the drive.
    """
    layout = without.comparison.layout
    frequencies = []
    for channel in modes_that_stay(layout):
        lines = without.fitted & (layout.channel == channel)
        if np.any(lines) and np.min(np.abs(without.misfit[lines])) > _ANOTHER_MODE:
            frequencies.append(float(np.exp(np.mean(np.log(layout.frequency[lines])))))
    return tuple(
        effect.key for effect in effects if any(_may_hide_at(effect, frequency, without) for frequency in frequencies)
    )


def _may_hide_at(effect: Effect[Physics], frequency: float, without: Fitted[Physics]) -> bool:
    """Return whether an effect resonates at a frequency and moves no other, so that no measurement shows it."""
    resonance = effect.frequency
    if resonance is None or not resonance.lower <= frequency <= resonance.upper:
        return False
    if not effect.applies(without.physics()):
        return False
    hypothesis = without.hypothesis.with_effect(effect)
    there = hypothesis.carried_over(without.hypothesis, without.coordinates)
    of_effect = there[there.size - len(effect.parameters) :]
    of_effect[0] = 1.0
    of_effect[effect.parameters.index(resonance)] = (frequency - resonance.null) / resonance.scale
    return np.array_equal(without.around.misfit(hypothesis.physics(there)), without.misfit)


#: Effects that leave the same residuals are aliases: the same finding under two names.
_SAME_COST = 0.5
_SAME_RESIDUALS = 0.02  # rms difference, in standard deviations
_AT_THE_END = 1e-3  # of the range of a parameter that is not sought beyond it: there the search lacked room

#: The formula of an effect may be off by such a share of what it does, though nothing that is left shows it; but only
#: such a share of the values can hide.
_SHAPE_ERROR = 0.05
_HIDDEN = 0.01
#: Where something is left the model lacks more: then a smaller share of the gain of BIC distinguishes no effects.
_MARGIN_OF_GAIN = 0.05


@dataclass(frozen=True, eq=False)
class Member(Generic[Physics]):
    """An effect that would do, with the fit that has it."""

    effect: Effect[Physics]
    fitted: Fitted[Physics]
    delta_bic: float
    plausible: bool
    aliases: tuple[str, ...] = ()  # keys of effects that leave the same residuals


@dataclass(frozen=True, eq=False)
class EquivalenceClass(Generic[Physics]):
    """Effects that the data cannot distinguish, the representative in front."""

    members: tuple[Member[Physics], ...]
    untested: tuple[str, ...]  # keys of what such data cannot test, and that would do as well when it was refitted
    held_out_gain: float
    #: Keys of laws that such data cannot tell from the representative, of the amplitude or of time. No effect of the
    #: catalogue is one: they make no name doubtful where the model lacks something else.
    other_laws: tuple[str, ...] = ()

    @property
    def is_plausible(self) -> bool:
        """Return whether the representative may be what is missing."""
        return self.representative.plausible

    @property
    def look_alikes(self) -> tuple[str, ...]:
        """Return the keys of effects that may be the true one as well as the representative."""
        return (*(key for other in self.members[1:] for key in (other.effect.key, *other.aliases)), *self.untested)

    @property
    def others(self) -> tuple[str, ...]:
        """Return the keys of all that may be there in the place of the representative."""
        return (*self.look_alikes, *self.other_laws)

    @property
    def aliases(self) -> tuple[str, ...]:
        """Return the keys of effects that leave the same residuals as the representative."""
        return self.representative.aliases

    @property
    def representative(self) -> Member[Physics]:
        """Return the member to be named first."""
        return self.members[0]

    @property
    def keys(self) -> tuple[str, ...]:
        """Return the keys of all that may be the true effect."""
        return (self.representative.effect.key, *self.others, *self.aliases)


def classes_with_fit(
    found: Found[Physics], candidates: Sequence[Effect[Physics]]
) -> tuple[tuple[EquivalenceClass[Physics], ...], Fitted[Physics]]:
    """Return the classes of the accepted effects, and the fit with their representatives.

    What has no answer together with the other representatives represents no class.
    """
    classes: list[EquivalenceClass[Physics]] = []
    final = found.final
    for accepted in found.accepted:
        representing = {other.representative.effect.key for other in classes}
        barred: set[str] = set()
        while True:
            grouped = equivalence_class(found, accepted, candidates, representing=representing, barred=barred)
            refitted = _with_representative(final, accepted.effect, grouped.representative)
            if refitted is not None:
                break
            barred.add(grouped.representative.effect.key)
        final = refitted
        classes.append(grouped)
    return tuple(classes), final


def _with_representative(
    final: Fitted[Physics], accepted: Effect[Physics], member: Member[Physics]
) -> Fitted[Physics] | None:
    """Return a fit with a member in the place of the accepted effect; None where it has no answer."""
    if member.effect.key == accepted.key:
        return final
    hypothesis = final.hypothesis.without(accepted.key).with_effect(member.effect)
    if hypothesis.keys == member.fitted.hypothesis.keys:
        return member.fitted
    start = hypothesis.carried_over(final.hypothesis, final.coordinates)
    own = hypothesis.carried_over(member.fitted.hypothesis, member.fitted.coordinates)
    n_own = len(member.effect.parameters)
    start[start.size - n_own :] = own[own.size - n_own :]
    try:
        return fit(final.comparison, hypothesis, start, final.fitted)
    except OutsideValidityError:
        return None


def equivalence_class(
    found: Found[Physics],
    accepted: Accepted[Physics],
    candidates: Sequence[Effect[Physics]],
    *,
    representing: Collection[str] = (),
    barred: Collection[str] = (),
) -> EquivalenceClass[Physics]:
    """Group an accepted effect with what would do in its place.

    Among members that leave the same residuals the effect of the catalogue is the representative, unless its value is
    not plausible: an added mass and a wrong mass are then one finding, not two. Keys in ``representing`` represent
    other classes and are in none again, since no effect is in a model twice; those that are ``barred`` may not
    represent this one.
    """
    scale = found.evidence_scale
    own = _member(accepted.effect, found.final, accepted.delta_bic, scale)
    rivals = [
        _member(rival.effect, rival.fitted, rival.delta_bic, scale)
        for rival in accepted.rivals
        if rival.effect.key not in representing
    ]
    margin = margin_between(found, accepted.delta_bic)
    best = max([own.delta_bic, *(rival.delta_bic for rival in rivals)])
    inside = [own, *(rival for rival in rivals if rival.delta_bic >= best - margin)]
    ordered = sorted(inside, key=lambda member: (member.effect.key in barred, *_precedence(member)))
    members: list[Member[Physics]] = []
    for member in ordered:
        alike = next((n for n, other in enumerate(members) if _are_aliases(member, other)), None)
        if alike is None:
            members.append(member)
        else:
            members[alike] = replace(members[alike], aliases=(*members[alike].aliases, member.effect.key))
    members.sort(key=lambda member: (member.effect.key in barred, not member.plausible, -member.delta_bic))
    another = indistinguishable_law(members[0].effect, members[0].delta_bic, found.final.comparison.layout)
    untested, laws = foreign_modes(accepted.without, candidates), (another,) if another else ()
    return EquivalenceClass(tuple(members), untested, accepted.held_out_gain, laws)


def margin_between(found: Found[Physics], gain: float) -> float:
    """Return by how much of BIC two effects have to differ that are told apart, the one found with a gain of BIC."""
    if judged_gap(found.final).exceeds_healthy:
        of_gain = _MARGIN_OF_GAIN * gain
    else:
        of_gain = min(_margin_of_shape(gain), _HIDDEN * found.evidence_scale.n_values * found.evidence_scale.share)
    return max(least_difference(found.final.comparison), of_gain)


def _margin_of_shape(gain: float) -> float:
    r"""Return the least difference D of BIC that an effect whose form is a little off does not feign.

    What it does to the data measures √G standard deviations, and where another does best by D the two are √D apart. An
    error ε√G along that distance moves D by :math:`2 \epsilon \sqrt{G D}`: what is left is to be very strong evidence.
    """
    error = _SHAPE_ERROR * math.sqrt(max(gain, 0.0))
    return (error + math.hypot(error, math.sqrt(VERY_STRONG))) ** 2


def _precedence(member: Member[Physics]) -> tuple[bool, bool, float]:
    return (not member.plausible, member.effect.key.startswith(PREFIX), -member.delta_bic)


def _are_aliases(member: Member[Physics], other: Member[Physics]) -> bool:
    difference = member.fitted.standardised - other.fitted.standardised
    same = float(np.sqrt(np.mean(difference**2))) < _SAME_RESIDUALS
    return same and abs(member.fitted.cost - other.fitted.cost) < _SAME_COST


def _member(
    effect: Effect[Physics], fitted: Fitted[Physics], delta_bic: float, scale: EvidenceScale
) -> Member[Physics]:
    own = [index for index, (other, _) in enumerate(fitted.hypothesis.unknowns) if other.key == effect.key]
    return Member(effect, fitted, delta_bic, all(_is_plausible(fitted, index, scale) for index in own))


def _is_plausible(fitted: Fitted[Physics], index: int, scale: EvidenceScale) -> bool:
    """Return whether an unknown lies within its plausible range, and not at an end that the data want it to leave."""
    effect, parameter = fitted.hypothesis.unknowns[index]
    value = fitted.hypothesis.values(fitted.coordinates)[effect.key][parameter.name]
    if parameter.beyond or not _at_an_end(effect, parameter, value):
        return parameter.lower <= value <= parameter.upper
    coordinate = fitted.hypothesis.n_uncertain + index
    slope = float(fitted.jacobian[fitted.fitted, coordinate] @ fitted.standardised[fitted.fitted])
    downhill = -slope * parameter.scale  # a scale may be negative: that of what can only become less
    outward = downhill > 0.0 if parameter.upper - value < value - parameter.lower else downhill < 0.0
    promised = scale.factor**2 * slope**2 * float(covariance(fitted, scale)[coordinate, coordinate])
    return not (outward and promised > STRONG)


def _at_an_end(effect: Effect[Physics], parameter: EffectParameter, value: float) -> bool:
    """Return whether a parameter not sought beyond its range stands at an end of it; at a textbook value it may."""
    known = effect.textbook is not None and abs(value - effect.textbook[parameter.name]) < _AT_THE_END
    if (parameter.beyond and parameter is effect.parameters[0]) or known:
        return False
    room = min(value - parameter.lower, parameter.upper - value) / (parameter.upper - parameter.lower)
    return 0.0 <= room < _AT_THE_END


def found_parameters(
    member: Member[Physics], stated: Fitted[Physics], scale: EvidenceScale, equal: Sequence[Fitted[Physics]] = ()
) -> dict[str, FoundParameter]:
    """Return the parameters of a member with their standard uncertainties and 95 % coverage intervals.

    ``stated`` is the fit with it and with all else that was found, as the augmented model has it: at the mode of the
    posterior. Beside the scatter of the data stands what the formula of the effect leaves out, of a size. What fits
    that the data cannot tell from it, ``equal`` ones, have for the same parameter lies in the interval, too. An
    interval ends at 0 where a parameter cannot have the other sign; it has no end, and the value no uncertainty, where
    the search was stopped by an end of its range: the value is a bound.
    """
    values = stated.hypothesis.values(stated.coordinates)[member.effect.key]
    others = [fitted.hypothesis.values(fitted.coordinates).get(member.effect.key, {}) for fitted in equal]
    variances = np.diag(covariance(stated, scale))
    parameters = {}
    for index, (effect, parameter) in enumerate(stated.hypothesis.unknowns):
        if effect.key != member.effect.key:
            continue
        value, coordinate = values[parameter.name], stated.hypothesis.n_uncertain + index
        scatter = math.sqrt(max(float(variances[coordinate]), 0.0))
        form = effect.form_share * abs(value) if is_size(parameter) else 0.0
        deviation = math.hypot(parameter.scale * scatter, form)
        alike = [value, *(other[parameter.name] for other in others if parameter.name in other)]
        low, high = min(alike) - 1.959964 * deviation, max(alike) + 1.959964 * deviation
        if at_end := _at_an_end(effect, parameter, value):
            deviation, upwards = math.inf, parameter.upper - value < value - parameter.lower
            low, high = (low, math.inf) if upwards else (-math.inf, high)
        interval = (
            max(low, 0.0) if parameter.lower == 0.0 else low,
            min(high, 0.0) if parameter.upper == 0.0 else high,
        )
        plausible = _is_plausible(stated, index, scale)
        parameters[parameter.name] = FoundParameter(
            Estimate(value, deviation), parameter.unit, interval, plausible, at_end
        )
    return parameters
