"""Describe a misfit that no effect of the catalogue explains: what swings where, which quantity varies by which law.

One quantity at a time varies freely over the settings (:mod:`.variation`); the laws that come near to what the
best of them would explain are refitted, with everything else. They compete with what may swing at a port of the drive
(:mod:`.answers`), which comes first where it leaves next to nothing. All are judged on data that no fit saw; where none
holds, that something varies may still be sure.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.description.answers import (
    Answer,
    Base,
    bases,
    bases_at_ports,
    described_by,
    is_evident,
    settled,
    share_of_free,
)
from monitor_core.discrepancy.description.variation import (
    FreeVariation,
    TriedLaw,
    contacts_for,
    fitted_settings,
    hung_elsewhere,
    quantities_of,
    tried_law,
    tried_laws,
    vary_freely,
)
from monitor_core.discrepancy.explanation import Described, DescribedAlternative
from monitor_core.discrepancy.search.search import LEAST_SIZE, findings
from monitor_core.discrepancy.search.workspace import Found, may_lack_more
from monitor_core.discrepancy.verdict.classes import EquivalenceClass, goes_with_amplitude
from monitor_core.discrepancy.verdict.outcome import explained_share, remainder_of
from monitor_core.effects import Effect, Law, MachineSizes, Variable, varying
from monitor_core.effects.effect import ConditionAxis
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.conditions.settings import varied_conditions
from monitor_core.fitting.evidence import EvidenceScale, delta_bic, evidence_scale, least_difference, significance
from monitor_core.fitting.hold_out import gain, gap_of, judged_gap
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit
from monitor_core.models.extended import AxisPhysics

_FEWEST_SETTINGS = 6
_CLOSER = 2  # times as many quantities as are kept: seen roughly, these are looked at more closely
_QUANTITIES, _LAWS_OF_EACH, _REFITS, _UNFITTED_REFITS = 3, 2, 4, 2
#: Of what the best law takes away, how much less another one may at first sight: everything else was not refitted yet.
_WORTH_A_REFIT = 0.15
#: Of the misfit, what a description must explain; and of what the quantity would explain if it varied freely, what its
#: law must. Less is no law, but one of many that point the same way.
_LEAST_EXPLAINED, _LEAST_OF_FREE = 0.8, 0.6
#: Times χ² of the best law, from where on that of the same thing at another place is a fit that went astray.
_ASTRAY = 2.0
#: Of χ², what something that swings at a port may leave for no law to be tried in its place.
_NOTHING_ELSE = 0.1
#: Times the evidence for the first name: what explains so much more is what is missing, and the name was in its place.
_AS_MUCH_AGAIN = 2.0
#: Noise floors, of the gap on held-out data: what leaves more describes something else along the way.
_MOST_LEFT = 1.2
_Varied = list[tuple[Base, FreeVariation]]


@dataclass(frozen=True, eq=False)
class Description:
    """What can be said, and the fit with it; of what has no form there is none."""

    described: Described
    fitted: Fitted[Any] | None
    kept: frozenset[str]  # keys of the effects with names that it stands beside; it is in the place of others
    before: Fitted[Any] | None = None  # the fit without anything, where it is judged by other values than a search is

    @property
    def follows_excitation(self) -> bool:
        """Whether it is a law of the excitation, in the place of every name."""
        law = self.described.law
        return law is not None and law.variable is Variable.EXCITATION and not self.kept

    def put_into(
        self, found: Found[Any], classes: Sequence[EquivalenceClass[Any]]
    ) -> tuple[Found[Any], tuple[EquivalenceClass[Any], ...]]:
        """Return what was found with the description, beside the classes of effects or in their place."""
        if self.fitted is None:
            return found, tuple(classes)
        pairs = zip(found.accepted, classes, strict=True)
        kept = [(accepted, group) for accepted, group in pairs if group.representative.effect.key in self.kept]
        steps = (*found.steps, self.fitted) if len(kept) == len(classes) and self.before is None else (self.fitted,)
        accepted = tuple(accepted for accepted, _ in kept)
        baseline = self.before or found.baseline
        stated = replace(found, baseline=baseline, final=self.fitted, steps=steps, accepted=accepted)
        return stated, tuple(group for _, group in kept)


def describe(
    baseline: Fitted[Any],
    final: Fitted[Any],
    candidates: Sequence[Effect[Any]],
    sizes: MachineSizes | None,
    progress: Callable[[str], None],
) -> Description | None:
    """Return what can be said of a misfit without a name; None where nothing holds, of a rigid axis, or few settings.

    ``baseline`` is the fit without any effect, ``final`` that with what was found; ``sizes`` of the machine are those
    in which something may swing at a port. What is least simple is tried where there would be no answer.
    """
    if not may_be_described(baseline):
        return None
    progress("describing what is left")
    at_ports = _at_ports(baseline, (baseline, final), sizes)
    swinging = best_of(list_of((), at_ports, baseline, progress), baseline, final)
    if swinging is not None and _leaves_nothing_else(baseline, swinging):
        return swinging
    of_catalogue = tuple(bases(baseline, final, candidates))
    lists = (list_of(with_laws, at_ports, baseline, progress) for with_laws in (of_catalogue, at_ports))
    return next((best for rivals in lists if (best := best_of(rivals, baseline, final)) is not None), None)


def describe_in_place(
    baseline: Fitted[Any], fitted: Fitted[Any], sizes: MachineSizes | None, progress: Callable[[str], None]
) -> Description | None:
    """Return what leaves nothing else to seek in the place of the first name, which ``fitted`` has come to.

    That follows the excitation by a law of its own, or swings at a port that the catalogue has nothing for, and
    explains more: as much again, or so much that it leaves no more than a healthy axis does. None of a rigid axis or
    few settings.
    """
    effects, lacks = findings(fitted), may_lack_more(fitted)
    varied = may_be_described(baseline) and ConditionAxis.LEVEL in varied_conditions(baseline.comparison.layout)
    may_follow = varied and len(effects) == 1 and (lacks or goes_with_amplitude(effects[0]))
    if not may_be_described(baseline) or not (lacks or may_follow):
        return None
    progress("asking whether what has no name explains more")
    at_ports = _at_ports(baseline, (baseline, fitted), sizes) if lacks else ()
    rivals = list_of((Base(baseline),) if may_follow else (), at_ports, baseline, progress)
    best = best_of(rivals, baseline, fitted, least_explained=0.0)
    if best is None or best.fitted is None or (best.described.law is not None and not best.follows_excitation):
        return None
    scale = evidence_scale(best.fitted)
    again = delta_bic(baseline, best.fitted, scale) > _AS_MUCH_AGAIN * delta_bic(baseline, fitted, scale)
    if judged_gap(best.fitted).exceeds_healthy:
        return best if again and best.follows_excitation else None
    # where names leave nothing, what explains more than they do need not explain most of what is missing
    share = explained_share(baseline, best.fitted, remainder_of(best.fitted).misfit)
    enough = share >= _LEAST_EXPLAINED if best.follows_excitation else _leaves_nothing_else(baseline, best)
    return best if again or enough or not lacks else None


def describe_elsewhere(
    final: Fitted[Any],
    without: Sequence[Fitted[Any]],
    sizes: MachineSizes | None,
    progress: Callable[[str], None],
) -> Description | None:
    """Return what swings at a port that the catalogue has nothing for, where it explains more than what has a name.

    Among effects of the catalogue alone the place that is nearest would get the name. ``final`` is the fit with what
    was found, ``without`` are fits that each lack one effect of it, which swings by itself.
    """
    for before in without:
        if isinstance(before.physics(), AxisPhysics):
            progress("asking whether it swings elsewhere")
            rivals = list_of((), tuple(bases_at_ports((before,), sizes)), before, progress)
            if (best := best_of(rivals, before, final)) is not None:
                return best
    return None


def may_be_described(baseline: Fitted[Any]) -> bool:
    """Return whether it is a drive, at enough settings; a rigid axis has no ports."""
    return isinstance(baseline.physics(), AxisPhysics) and len(fitted_settings(baseline)) >= _FEWEST_SETTINGS


def _at_ports(
    baseline: Fitted[AxisPhysics], from_here: Sequence[Fitted[AxisPhysics]], sizes: MachineSizes | None
) -> tuple[Base, ...]:
    swings = any(effect.frequency is not None for each in from_here for effect in each.hypothesis.effects)
    missed = judged_gap(baseline).exceeds_healthy or swings  # or no response has a resonance too many
    return tuple(bases_at_ports(from_here, sizes)) if missed else ()


def _believed(answers: Sequence[Answer], evidence: Callable[[Answer], float]) -> Answer:
    """Return the first, of most evidence, or what cannot be told from it and is likelier.

    Contacts yield before solid parts; of one quantity in one fit, the law of fewest numbers.
    """
    first = answers[0]
    least = evidence(first) - least_difference(first.fitted.comparison)
    near = [other for other in answers if other.tried and evidence(other) >= least]
    if first.tried is None:
        return first
    quantity = contacts_for(first.tried.variation.quantity)
    of_contacts = [other for other in near if other.tried and other.tried.variation.quantity == quantity]
    first = of_contacts[0] if of_contacts else first
    alike = [other for other in near if other.is_of_same(first)]
    return min(alike, key=lambda other: other.n_found)


def _leaves_nothing_else(baseline: Fitted[AxisPhysics], swinging: Description) -> bool:
    """Return whether what swings at a port takes so much away that no law need be sought."""
    fitted = swinging.fitted
    return fitted is not None and not judged_gap(fitted).exceeds_healthy and fitted.cost < _NOTHING_ELSE * baseline.cost


def list_of(
    with_laws: Sequence[Base], swinging: Sequence[Base], baseline: Fitted[AxisPhysics], progress: Callable[[str], None]
) -> list[Answer]:
    """Return the laws that promise most in the fits ``with_laws``, and what swings at a port in those ``swinging``."""
    varied = [(base, variation) for base in with_laws for variation in closer_variations(base.fitted)]
    promising = _promising(varied, baseline) if varied else ()
    answers = [answer for base, tried in promising if (answer := refit_with_law(base, tried, progress)) is not None]
    answers += list(_hung_elsewhere(answers, with_laws, progress))
    return answers + [Answer(base, base.fitted, base.port) for base in swinging if base.port is not None]


def best_of(
    answers: Sequence[Answer],
    without: Fitted[AxisPhysics],
    final: Fitted[AxisPhysics],
    *,
    least_explained: float = _LEAST_EXPLAINED,
    before: Fitted[AxisPhysics] | None = None,
) -> Description | None:
    """Return what holds best of one list, by one evidence: that over a fit ``without`` any of them; None if none does.

    ``final`` is the fit with the effects that have names, which it stands beside, or surpasses in their place. Where a
    search is judged by other values than these fits, ``before`` is the fit without anything.
    """
    answers = [each for each in answers if is_evident(each) and (each.tried or holds(without, each, each.scale))]
    if not answers:
        return None
    scale = min(answers, key=lambda answer: answer.fitted.cost).scale
    answers.sort(key=lambda answer: answer.evidence(without, scale), reverse=True)
    best = _believed(answers, lambda answer: answer.evidence(without, scale))
    others = [answer for answer in answers if answer is not best]
    best = settled(best)
    kept = best.base.named & final.hypothesis.keys
    best = _without_needless(best, kept)
    kept &= best.fitted.hypothesis.keys
    if not holds(without, best, scale, least_explained) or not (kept or surpasses(final, best, scale)):
        return None
    described = described_by(best, alike_to(without, best, others, scale), scale)
    return Description(described, best.fitted, kept, before)


def _promising(varied: _Varied, baseline: Fitted[AxisPhysics]) -> list[tuple[Base, TriedLaw]]:
    """Return the laws that are worth a refit, and the fit that each of them starts from."""
    hints = [(base, tried) for base, variation in varied for tried in _laws(base.fitted, variation)]
    hints.sort(key=lambda hint: hint[1].cost)
    of_fits = [hint for hint in hints if not hint[0].is_unfitted]
    promising = [hint for hint in of_fits[:_REFITS] if _is_near(hint[1], of_fits[0][1])]
    # a law of the axis as stated has an answer, too, where an effect that was found stands in its way
    of_stated = [hint for hint in of_fits if hint[0].fitted is baseline][:1]
    promising += [hint for hint in of_stated if hint not in promising]
    promising += [hint for hint in hints if hint[0].is_unfitted][:_UNFITTED_REFITS]
    tried = {_asked(*hint) for hint in promising}
    of_contacts = [(base, law) for base, hint in promising if (law := _of_contacts(base, hint)) is not None]
    return promising + [hint for hint in of_contacts if _asked(*hint) not in tried]


def _asked(base: Base, tried: TriedLaw) -> tuple[int, str, Law]:
    return id(base), tried.variation.quantity.field, tried.law


def _of_contacts(base: Base, tried: TriedLaw) -> TriedLaw | None:
    """Return the same law of the contacts in series with a solid part; None where there are none."""
    quantity = contacts_for(tried.variation.quantity)
    variation = None if quantity is None else vary_freely(base.fitted, quantity)
    return None if variation is None else tried_law(variation, tried.law, fitted_settings(base.fitted))


def closer_variations(fitted: Fitted[AxisPhysics]) -> Iterator[FreeVariation]:
    """Yield the quantities whose free variation leaves least, best first."""
    roughly = best_first(vary_freely(fitted, quantity, roughly=True) for quantity in quantities_of(fitted.physics()))
    closer = (vary_freely(fitted, each.quantity) for each in roughly[: _CLOSER * _QUANTITIES])
    yield from best_first(closer)[:_QUANTITIES]


def best_first(variations: Iterable[FreeVariation | None]) -> list[FreeVariation]:
    """Return those that have an answer, that which leaves least first."""
    return sorted((each for each in variations if each is not None), key=lambda each: each.free)


def _laws(fitted: Fitted[AxisPhysics], variation: FreeVariation) -> tuple[TriedLaw, ...]:
    """Return the laws that promise most."""
    return tried_laws(fitted, variation)[:_LAWS_OF_EACH]


def _is_near(tried: TriedLaw, best: TriedLaw) -> bool:
    """Return whether a refit might make a law as good as the best, given what that takes away."""
    return tried.cost <= best.cost + _WORTH_A_REFIT * (best.variation.alike - best.cost)


def refit_with_law(
    base: Base, tried: TriedLaw, progress: Callable[[str], None], others: FloatArray | None = None
) -> Answer | None:
    """Return a fit with a law of a quantity, and with all else; None where the axis has no answer with it.

    All else starts as it is in the base, or from ``others``.
    """
    quantity, law, before = tried.variation.quantity, tried.law, base.fitted
    progress(f"refitting with {quantity.name} that varies with {law.variable}, {law.form}")
    effect: Effect[AxisPhysics] = varying(quantity.record, quantity.field, law)
    hypothesis = before.hypothesis.with_effect(effect)
    start = hypothesis.carried_over(before.hypothesis, before.coordinates if others is None else others)
    pairs = zip(tried.coefficients, effect.parameters, strict=True)
    start[start.size - len(effect.parameters) :] = [(value - item.null) / item.scale for value, item in pairs]
    try:
        return Answer(base, fit(before.comparison, hypothesis, start, before.fitted), effect, tried)
    except OutsideValidityError:
        return None


def _hung_elsewhere(
    answers: Sequence[Answer], bases: Sequence[Base], progress: Callable[[str], None]
) -> Iterator[Answer]:
    """Yield the best law, if it is of what hangs on the nut, for the same thing on the table, or the other way round.

    Without a law the fit of one may have gone to where the law does not lead back from: it starts from the other.
    """
    best = min(answers, key=lambda answer: answer.fitted.cost, default=None)
    tried = None if best is None else best.tried
    quantity = hung_elsewhere(tried.variation.quantity) if tried else None
    hanging = (base for base in bases if base.hangs_last and quantity and quantity.of(base.fitted.physics()))
    base = next(hanging, None)
    if best is None or tried is None or quantity is None or base is None or not best.base.hangs_last:
        return
    there = (other for other in answers if other.tried and other.tried.variation.quantity == quantity)
    if any(other.fitted.cost < _ASTRAY * best.fitted.cost for other in there):
        return
    progress(f"refitting with {quantity.name} at the {quantity.place} that varies with {tried.law.variable}")
    effect: Effect[AxisPhysics] = varying(quantity.record, quantity.field, tried.law)
    hypothesis, best_fit = base.fitted.hypothesis.with_effect(effect), best.fitted
    start = hypothesis.carried_over(best_fit.hypothesis, best_fit.coordinates)
    n_own = sum(len(each.parameters) for each in hypothesis.effects[-2:])
    start[start.size - n_own :] = best_fit.coordinates[best_fit.coordinates.size - n_own :]
    moved = replace(tried, variation=replace(tried.variation, quantity=quantity))
    with suppress(OutsideValidityError):
        yield Answer(base, fit(best_fit.comparison, hypothesis, start, best_fit.fitted), effect, moved)


def _without_needless(answer: Answer, kept: frozenset[str]) -> Answer:
    """Return an answer without effects that had been found beside it, but whose size may be nothing now."""
    fitted, hypothesis = answer.fitted, answer.fitted.hypothesis
    for effect in hypothesis.effects:
        if effect.key in kept and significance(fitted, effect, answer.scale) < LEAST_SIZE:
            hypothesis = hypothesis.without(effect.key)
    if hypothesis.keys == fitted.hypothesis.keys:
        return answer
    start = hypothesis.carried_over(fitted.hypothesis, fitted.coordinates)
    try:
        return replace(answer, fitted=fit(fitted.comparison, hypothesis, start, fitted.fitted))
    except OutsideValidityError:
        return answer


def holds(
    baseline: Fitted[AxisPhysics], answer: Answer, scale: EvidenceScale, least_explained: float = _LEAST_EXPLAINED
) -> bool:
    """Return whether it explains most of what is missing, on data that were held out, too."""
    fitted, remainder = answer.fitted, remainder_of(answer.fitted)
    of_missing = explained_share(baseline, fitted, remainder.misfit)
    gained = gain(baseline.held_out, fitted.held_out, scale)
    left = gap_of(fitted.comparison, fitted.held_out)
    held = math.isnan(gained) or (gained > 0.0 and left <= _MOST_LEFT * fitted.comparison.noise_floor)
    return held and of_missing >= least_explained and share_of_free(answer) >= _LEAST_OF_FREE


def surpasses(final: Fitted[AxisPhysics], answer: Answer, scale: EvidenceScale) -> bool:
    """Return whether it explains more than the effects with names in whose place it would stand, if there are any."""
    more = delta_bic(final, answer.fitted, scale)
    return not final.hypothesis.effects or more >= least_difference(answer.fitted.comparison)


def alike_to(
    baseline: Fitted[AxisPhysics], best: Answer, others: Sequence[Answer], scale: EvidenceScale
) -> tuple[DescribedAlternative, ...]:
    """Return what the data do not distinguish from the best."""
    least = delta_bic(baseline, best.fitted, scale) - least_difference(best.fitted.comparison)
    return tuple(
        dict.fromkeys(
            other.as_alternative
            for other in others
            if other.as_alternative != best.as_alternative and delta_bic(baseline, other.fitted, scale) > least
        )
    )
