"""Describe a misfit that no effect of the catalogue explains: which quantity varies, where, and by which law.

One quantity at a time varies freely over the settings (:mod:`.free_variation`); the laws that come near to what the
best of them would explain are refitted, with everything else, and judged on data that no fit saw.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from monitor_core.discrepancy.description.bases import bases
from monitor_core.discrepancy.description.free_variation import fitted_settings, vary_freely
from monitor_core.discrepancy.description.laws import TriedLaw, tried_laws
from monitor_core.discrepancy.description.quantities import Quantity, quantities_of
from monitor_core.discrepancy.explanation import Described
from monitor_core.discrepancy.search.time_limit import TimeIsUpError
from monitor_core.discrepancy.verdict.classes import Member, found_parameters
from monitor_core.discrepancy.verdict.outcome import explained_share, remainder_of
from monitor_core.effects import Effect, varying
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.evidence import EvidenceScale, delta_bic, evidence_scale, least_difference
from monitor_core.fitting.hold_out import gain, gap_of
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit
from monitor_core.models.extended import AxisPhysics

_FEWEST_SETTINGS = 6
_QUANTITIES, _LAWS_OF_EACH, _REFITS = 3, 2, 4
#: Of what the best law takes away, how much less another one may at first sight: everything else was not refitted yet.
_WORTH_A_REFIT = 0.15
#: Of the misfit, what a description must explain; and of what the quantity would explain if it varied freely, what its
#: law must. Less is no law, but one of many that point the same way.
_LEAST_EXPLAINED, _LEAST_OF_FREE = 0.8, 0.6
#: Noise floors, of the gap on held-out data: what leaves more describes something else along the way.
_MOST_LEFT = 1.2


@dataclass(frozen=True, eq=False)
class Description:
    """A fit with the law, and what it says."""

    described: Described
    fitted: Fitted[Any]
    keeps_found: bool  # whether it stands beside the effects that had been found, and not in their place


@dataclass(frozen=True, eq=False)
class _Refitted:
    base: Fitted[AxisPhysics]
    tried: TriedLaw
    effect: Effect[AxisPhysics]
    fitted: Fitted[AxisPhysics]

    @property
    def words(self) -> str:
        quantity = self.tried.variation.quantity
        return f"{quantity.name} at the {quantity.place}, {self.tried.law.variable}"

    @property
    def subject(self) -> tuple[Quantity, str]:
        return self.tried.variation.quantity, self.tried.law.variable


def describe(
    baseline: Fitted[Any],
    final: Fitted[Any],
    candidates: Sequence[Effect[Any]],
    progress: Callable[[str], None],
) -> Description | None:
    """Return what can be said of a misfit without a name; None where no law holds, of a rigid axis, or of few settings.

    ``baseline`` is the fit without any effect, ``final`` that with what was found.
    """
    if not isinstance(baseline.physics(), AxisPhysics) or len(fitted_settings(baseline)) < _FEWEST_SETTINGS:
        return None
    with suppress(TimeIsUpError):
        progress("describing what is left")
        return _described(baseline, final, candidates, progress)
    return None


def _described(
    baseline: Fitted[AxisPhysics],
    final: Fitted[AxisPhysics],
    candidates: Sequence[Effect[AxisPhysics]],
    progress: Callable[[str], None],
) -> Description | None:
    hints = [(base, tried) for base in bases(baseline, final, candidates) for tried in _hints(base)]
    hints.sort(key=lambda hint: hint[1].cost)
    promising = [hint for hint in hints[:_REFITS] if _is_near(hint[1], hints[0][1])]
    refitted = [answer for base, tried in promising if (answer := _refit(base, tried, progress)) is not None]
    if not refitted:
        return None
    scale = evidence_scale(min((answer.fitted for answer in refitted), key=lambda fitted: fitted.cost))
    refitted.sort(key=lambda answer: delta_bic(baseline, answer.fitted, scale), reverse=True)
    best = refitted[0]
    if not _holds(baseline, best, scale):
        return None
    alike = [
        answer
        for answer in refitted[1:]
        if answer.subject != best.subject
        and delta_bic(baseline, best.fitted, scale) - delta_bic(baseline, answer.fitted, scale)
        < least_difference(best.fitted.comparison)
    ]
    found = best.base is final and bool(final.hypothesis.effects)
    return Description(_answer(best, alike, scale), best.fitted, found)


def _hints(base: Fitted[AxisPhysics]) -> Iterator[TriedLaw]:
    """Yield the laws that promise most, of the quantities whose free variation leaves least."""
    physics, settings = base.physics(), fitted_settings(base)
    free = [vary_freely(base, quantity) for quantity in quantities_of(physics)]
    variations = sorted((variation for variation in free if variation is not None), key=lambda each: each.free)
    for variation in variations[:_QUANTITIES]:
        yield from tried_laws(variation, settings, physics.screw.lead)[:_LAWS_OF_EACH]


def _is_near(tried: TriedLaw, best: TriedLaw) -> bool:
    """Return whether a refit might make a law as good as the best, given what that takes away."""
    return tried.cost <= best.cost + _WORTH_A_REFIT * (best.variation.alike - best.cost)


def _refit(base: Fitted[AxisPhysics], tried: TriedLaw, progress: Callable[[str], None]) -> _Refitted | None:
    quantity, law = tried.variation.quantity, tried.law
    progress(f"refitting with {quantity.name} that varies with {law.variable}, {law.form}")
    effect: Effect[AxisPhysics] = varying(quantity.record, quantity.field, law)
    hypothesis = base.hypothesis.with_effect(effect)
    start = hypothesis.carried_over(base.hypothesis, base.coordinates)
    pairs = zip(tried.coefficients, effect.parameters, strict=True)
    start[start.size - len(effect.parameters) :] = [(value - item.null) / item.scale for value, item in pairs]
    try:
        return _Refitted(base, tried, effect, fit(base.comparison, hypothesis, start, base.fitted))
    except OutsideValidityError:
        return None


def _holds(baseline: Fitted[AxisPhysics], answer: _Refitted, scale: EvidenceScale) -> bool:
    """Return whether a law explains most of what is missing, on data that were held out, too."""
    fitted, remainder = answer.fitted, remainder_of(answer.fitted)
    enough = delta_bic(answer.base, fitted, scale) >= fitted.comparison.least_delta_bic
    of_missing = explained_share(baseline, fitted, remainder.misfit)
    gained = gain(baseline.held_out, fitted.held_out, scale)
    left = gap_of(fitted.comparison, fitted.held_out)
    held = math.isnan(gained) or (gained > 0.0 and left <= _MOST_LEFT * fitted.comparison.noise_floor)
    return enough and held and of_missing >= _LEAST_EXPLAINED and _share_of_free(answer.tried) >= _LEAST_OF_FREE


def _share_of_free(tried: TriedLaw) -> float:
    variation = tried.variation
    room = variation.alike - variation.free
    return min((variation.alike - tried.cost) / room, 1.0) if room > 0.0 else 0.0


def _answer(answer: _Refitted, alike: Sequence[_Refitted], scale: EvidenceScale) -> Described:
    fitted, quantity, law = answer.fitted, answer.tried.variation.quantity, answer.tried.law
    evidence = delta_bic(answer.base, fitted, scale)
    added, own = fitted.physics().added, quantity.field.removesuffix("_frequency").removesuffix("_mass")
    hangs = own.endswith("absorber")
    return Described(
        place=str(quantity.place),
        parameter=quantity.name,
        law=law,
        parameters=found_parameters(Member(answer.effect, fitted, evidence, True), fitted, scale),
        effect=answer.effect,
        alternatives=tuple(dict.fromkeys(other.words for other in alike)),
        share=_share_of_free(answer.tried),
        delta_bic=evidence,
        held_out_log_likelihood_gain=gain(answer.base.held_out, fitted.held_out, scale),
        frequency_hz=getattr(added, f"{own}_frequency") if hangs else None,
        mass_kg=getattr(added, f"{own}_mass") if hangs else None,
    )
