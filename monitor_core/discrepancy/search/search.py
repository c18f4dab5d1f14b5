"""The search for what is missing: textbook physics first, then one effect after the other, each step undone if it can.

1. Physics that the family leaves out, at its textbook values, in every combination: where several strong effects are
   missing at once a single one may make things worse, and a greedy search would go astray.
2. Look at every effect (``scan``), refit the most promising, accept the best that the evidence carries.
3. After each step, leave out again what is no longer needed.

What the data cannot tell from an accepted effect is kept beside it.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Generic, TypeVar

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.screening import Scanned, scan
from monitor_core.discrepancy.search.distance import (
    gap,
    has_one_minimum,
    is_far,
    is_near,
    looks_mislead,
    may_be_elsewhere,
)
from monitor_core.discrepancy.search.substitution import in_place_of, instead
from monitor_core.effects.effect import Effect
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Comparison
from monitor_core.fitting.conditions.settings import is_testable
from monitor_core.fitting.described_axis import DescribedAxis
from monitor_core.fitting.evidence import VERY_STRONG, Yardstick, delta_bic, least_difference, yardstick
from monitor_core.fitting.hold_out import fitted_values, gain, leaves_something, promised_gain
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit

Physics = TypeVar("Physics")

#: Of the cost: fits that differ by less ended in one minimum.
_ONE_MINIMUM = 1e-4
_TEXTBOOK = 0.2  # of the scale of a parameter: a value so near its textbook value is that


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """When the evidence carries an effect. The figures are set on simulated machines, see benchmarks/hidden_effects."""

    #: Of the gain of log-likelihood that an effect promises on held-out values, less twice what that gain scatters by.
    least_held_out_share: float = 0.3
    #: Of what an effect gains where it is fitted, what may be lost where it is not: a parameter beyond its tolerance
    #: gains by its prior alone and changes hardly a residual, those held out for the worse or the better.
    forgiven_share: float = 0.05
    least_promise: float = 12.0  # of χ², by a look, for an effect to be refitted
    n_refitted: int = 6  # by what they promise at the best size tried
    n_refitted_by_slope: int = 1
    #: Of what a refit has gained: what promises less is not refitted beside it, where looks can be relied upon.
    least_share_of_gain: float = 0.3
    most_rise: float = 25.0  # of χ², by a look, for an effect to be refitted in the place of one that was found
    most_effects: int = 4
    n_first_steps: int = 2  # tried one after the other where the best one does not lead to the floor


@dataclass(frozen=True, eq=False)
class Rival(Generic[Physics]):
    """An effect that was refitted in the place of an accepted one."""

    effect: Effect[Physics]
    fitted: Fitted[Physics]
    delta_bic: float  # against the fit without any of them


@dataclass(frozen=True, eq=False)
class Accepted(Generic[Physics]):
    """An effect with what was refitted beside it, all against the fit without it."""

    effect: Effect[Physics]
    delta_bic: float
    held_out_gain: float
    rivals: tuple[Rival[Physics], ...]  # best first, the effect itself left out
    without: Fitted[Physics]  # the effect


@dataclass(frozen=True, eq=False)
class Found(Generic[Physics]):
    """Where a search ended."""

    baseline: Fitted[Physics]
    steps: tuple[Fitted[Physics], ...]  # after each accepted effect
    final: Fitted[Physics]
    accepted: tuple[Accepted[Physics], ...]
    yardstick: Yardstick
    looks: tuple[Scanned[Physics], ...]  # at what is not in the final fit
    least_delta_bic: float  # that one more effect would have needed


@dataclass(frozen=True, eq=False)
class Search(Generic[Physics]):
    """What is searched, and in what."""

    comparison: Comparison[Physics]
    subject: DescribedAxis[Physics]
    candidates: tuple[Effect[Physics], ...]
    settings: SearchSettings = SearchSettings()
    progress: Callable[[str], None] = lambda _sentence: None
    _known_fits: dict[frozenset[str], Fitted[Physics]] = field(default_factory=dict, init=False)
    _known_looks: dict[bytes, tuple[Scanned[Physics], ...]] = field(default_factory=dict, init=False)
    _known_rivals: dict[bytes, tuple[Rival[Physics], ...]] = field(default_factory=dict, init=False)

    def run(self) -> tuple[Fitted[Physics], ...]:
        """Return the fits of the search: without any effect, and after each step.

        Raises
        ------
        OutsideValidityError
            If the subject itself has no answer.
        """
        hypothesis = Hypothesis(self.subject)
        baseline = self._fit(hypothesis, hypothesis.null)
        first = self._with_textbook_physics(baseline)
        steps = self._from(first, [first] if first is not baseline else [])
        self._remember(baseline)
        baseline = self._known_fits[frozenset()]  # no false minimum, as far as an effect has led out of one
        first = first if first.hypothesis.effects else baseline
        current = steps[-1] if steps else baseline
        rivals = self._rivals(first) if gap(current) > 1.0 else ()
        for rival in rivals[1 : self.settings.n_first_steps]:
            least = self.settings.least_share_of_gain * rivals[0].delta_bic
            if rival.delta_bic < max(least, self._least_evidence(first)):
                break
            if not self._holds(first, rival.fitted, yardstick(rival.fitted)):
                continue
            other = self._from(rival.fitted, [rival.fitted])
            if delta_bic(current, other[-1], yardstick(other[-1])) > least_difference(self.comparison):
                steps, current = other, other[-1]
        final = self._pruned(current, current.hypothesis.effects)
        before = [self._known_fits[frozenset()], *steps[:-1]] if final.hypothesis.effects else []
        return _leading_to(final, before)

    def leave_out(self, steps: Sequence[Fitted[Physics]], effect: Effect[Physics]) -> tuple[Fitted[Physics], ...]:
        """Return the fits of a search that ends without one of its effects."""
        final = self.without(steps[-1], effect)
        return _leading_to(final, [one for one in steps if _keys(one) < _keys(final)])

    def found(self, steps: Sequence[Fitted[Physics]]) -> Found[Physics]:
        """Judge what a search has found: the evidence for each effect, and what else would do in its place."""
        final = steps[-1]
        by = yardstick(final)
        accepted = tuple(self._judged(final, effect, by) for effect in final.hypothesis.effects)
        baseline = self._known_fits[frozenset()] if accepted else final
        return Found(baseline, tuple(steps[1:]), final, accepted, by, self._looks(final), self._least_evidence(final))

    def without(self, fitted: Fitted[Physics], effect: Effect[Physics]) -> Fitted[Physics]:
        """Return the best fit known without one of the effects of a fit.

        From where the fuller one ended, and no worse than the best one known by then with still fewer effects: evidence
        would else be of a false minimum.
        """
        hypothesis = fitted.hypothesis.without(effect.key)
        keys = frozenset(one.key for one in hypothesis.effects)
        from_fuller = self._try(hypothesis, hypothesis.carried_over(fitted.hypothesis, fitted.coordinates))
        best = _better(self._known_fits.get(keys), from_fuller)
        plain = _better(*(known for those, known in self._known_fits.items() if those < keys))
        if plain is not None and (best is None or plain.cost < best.cost):
            start = hypothesis.carried_over(plain.hypothesis, plain.coordinates)
            best = _better(best, self._try(hypothesis, start))
        best = best or self._fit(hypothesis, hypothesis.null)
        self._remember(best)
        return best

    def _from(self, start: Fitted[Physics], steps: Sequence[Fitted[Physics]]) -> list[Fitted[Physics]]:
        """Return the steps of adding one effect after the other, as long as the evidence carries them."""
        current, taken = start, list(steps)
        self._remember(current)
        while len(current.hypothesis.effects) < self.settings.most_effects:
            self.progress(f"{len(current.hypothesis.effects)} effects found")
            better = self._best_addition(current)
            if better is None:
                break
            again = self._again(current, better)
            if delta_bic(again, better, yardstick(better)) < self._least_evidence(again):
                current = again  # the effect had only led out of a false minimum
                taken[-1:] = [again] if taken else []
                continue
            before = _keys(current)
            current = self._pruned(better, better.hypothesis.effects[:-1])
            if _keys(current) <= before:
                break
            self._remember(current)
            taken.append(current)
        return taken

    def _remember(self, fitted: Fitted[Physics]) -> None:
        keys = _keys(fitted)
        if keys not in self._known_fits or fitted.cost < self._known_fits[keys].cost:
            self._known_fits[keys] = fitted

    def _fit(self, hypothesis: Hypothesis[Physics], start: FloatArray) -> Fitted[Physics]:
        return fit(self.comparison, hypothesis, start, fitted_values(self.comparison.layout))

    def _remaining(self, fitted: Fitted[Physics]) -> tuple[Effect[Physics], ...]:
        """Return the candidates that could still be added."""
        present = {effect.key for effect in fitted.hypothesis.effects}
        physics = fitted.physics()
        layout = self.comparison.layout
        return tuple(
            one
            for one in self.candidates
            if one.key not in present and is_testable(one, layout) and one.applies(physics)
        )

    def _with_textbook_physics(self, baseline: Fitted[Physics]) -> Fitted[Physics]:
        """Return the fit with those effects, at their textbook values, that together help most."""
        physics = baseline.physics()
        known = [one for one in self.candidates if one.textbook is not None and one.applies(physics)]
        best = baseline
        for size in range(1, len(known) + 1):
            for effects in combinations(known, size):
                hypothesis = Hypothesis(self.subject, effects)
                start = hypothesis.at_textbook_values(baseline.coordinates)
                trial = self._try(hypothesis, start)
                if trial is not None and delta_bic(best, trial, yardstick(trial)) > self.comparison.least_delta_bic:
                    best = trial
        # a single effect that helps may be a stand-in; whoever is needed is found again one after the other
        return best if len(best.hypothesis.effects) != 1 else baseline

    def _try(self, hypothesis: Hypothesis[Physics], start: FloatArray) -> Fitted[Physics] | None:
        try:
            return self._fit(hypothesis, start)
        except OutsideValidityError:
            return None

    def _best_addition(self, current: Fitted[Physics]) -> Fitted[Physics] | None:
        """Return the fit with the best further effect, or None if the evidence carries none."""
        least = self._least_evidence(current)
        for rival in self._rivals(current):
            by = yardstick(rival.fitted)
            if delta_bic(current, rival.fitted, by) < least:
                return None
            if self._holds(current, rival.fitted, by):
                return rival.fitted
        return None

    def _least_evidence(self, without: Fitted[Physics]) -> float:
        """Return the gain of BIC that one more effect needs.

        Where a fit leaves no more than a healthy axis would, nothing but the choice of this effect among all that were
        looked at speaks for it, which may gain 2 ln n by chance (Chen and Chen, Biometrika 95 (2008) 759).
        """
        least = self.comparison.least_delta_bic
        if leaves_something(without):
            return least
        return max(least, VERY_STRONG + 2.0 * math.log(max(len(self._remaining(without)), 1)))

    def _rivals(self, current: Fitted[Physics]) -> tuple[Rival[Physics], ...]:
        """Return the most promising effects, refitted, best first; those of one fit once only."""
        key = _identity(current)
        if key not in self._known_rivals:
            self._known_rivals[key] = self._refitted(current)
        return self._known_rivals[key]

    def _refitted(self, current: Fitted[Physics]) -> tuple[Rival[Physics], ...]:
        refitted: list[tuple[Effect[Physics], Fitted[Physics]]] = []
        best = current
        for look in self._promising(current):
            surpassed = look.promise < self.settings.least_share_of_gain * (current.cost - best.cost)
            there = gap(best) < 1.0 and not looks_mislead(current)
            if surpassed and (is_near(current) or there):
                continue
            self.progress(f"refitting with {look.effect.key}")
            trial = self._from_best_start(current, look)
            if trial is not None:
                refitted.append((look.effect, trial))
                best = min(best, trial, key=lambda one: one.cost)
        done = {effect.key for effect, _ in refitted}
        for look in self._looks(current) if may_be_elsewhere(current) else ():
            if look.elsewhere is None or look.effect.key in done:
                continue
            self.progress(f"refitting with {look.effect.key}")
            trial = self._try(current.hypothesis.with_effect(look.effect), look.elsewhere)
            if trial is not None:
                refitted.append((look.effect, trial))
        if not refitted:
            return ()
        by = yardstick(min((trial for _, trial in refitted), key=lambda one: one.cost))
        rivals = [Rival(effect, trial, delta_bic(current, trial, by)) for effect, trial in refitted]
        return tuple(sorted(rivals, key=lambda one: one.delta_bic, reverse=True))

    def _promising(self, current: Fitted[Physics]) -> list[Scanned[Physics]]:
        """Return what is worth a refit: by what the best size tried promises, then by what the slope promises.

        If anything is, so is whatever promises as much but for a margin, or it would be missing where effects are not
        told apart.
        """
        looks = self._looks(current)
        worth_it = [one for one in looks if one.promise > self.settings.least_promise]
        if not worth_it:
            return []
        chosen = sorted(worth_it, key=lambda one: one.decrease, reverse=True)[: self.settings.n_refitted]
        by_slope = sorted(worth_it, key=lambda one: one.score, reverse=True)[: self.settings.n_refitted_by_slope]
        # of χ²: near the data, where looks foretell what refits find, its difference is that of BIC
        least = max(one.promise for one in worth_it) - least_difference(self.comparison)
        alike = [one for one in looks if one.promise >= least]
        return list(dict.fromkeys((*chosen, *by_slope, *alike)))

    def _looks(self, current: Fitted[Physics]) -> tuple[Scanned[Physics], ...]:
        """Return a look at everything that could still be added; at one fit once only."""
        key = _identity(current)
        if key not in self._known_looks:
            self._known_looks[key] = scan(current, self._remaining(current))
        return self._known_looks[key]

    def _from_best_start(self, current: Fitted[Physics], look: Scanned[Physics]) -> Fitted[Physics] | None:
        """Return the best fit from where a look leads, from another minimum, instead of a parameter, or from nothing.

        Of starts from a look and from where the effect is absent, one is enough if it ends at the floor, where there is
        but one minimum, and where it gains what the look has promised, if looks can be relied upon. Two are enough if
        they end in one minimum that gains something.
        """
        near = is_near(current)
        hypothesis = current.hypothesis.with_effect(look.effect)
        absent = hypothesis.carried_over(current.hypothesis, current.coordinates)
        apart = [instead(current, look.effect), look.elsewhere]
        trials = [self._try(hypothesis, start) for start in apart if start is not None]
        best = min((one for one in trials if one is not None), key=lambda one: one.cost, default=None)
        for start in (*(look.starts[:1] if near else look.starts), absent):
            trial = self._try(hypothesis, start)
            if trial is None:
                continue
            again = best is not None and abs(trial.cost - best.cost) < _ONE_MINIMUM * best.cost
            if best is None or trial.cost < best.cost:
                best = trial
            if again and best.cost < current.cost:
                break
            gained = current.cost - best.cost
            if gained > 0.0 and (has_one_minimum(best) or (near and 2.0 * gained > look.decrease)):
                break
        return best

    def _holds(self, without: Fitted[Physics], fuller: Fitted[Physics], by: Yardstick) -> bool:
        """Tell whether an effect that helps where it was fitted helps where it was not."""
        before, after = without.held_out, fuller.held_out
        if before is None or after is None:
            return True
        promised = promised_gain(before, after, by)
        forgiven = self.settings.forgiven_share * 0.5 * max(delta_bic(without, fuller, by), 0.0)
        least = self.settings.least_held_out_share * promised - 2.0 * math.sqrt(2.0 * promised)
        return gain(before, after, by) > least - forgiven

    def _again(self, current: Fitted[Physics], fuller: Fitted[Physics]) -> Fitted[Physics]:
        """Return the better fit of what was there before an effect: the one that was, or one from where the effect led.

        An effect, whichever, may show the way out of a false minimum. That is no evidence for it.
        """
        again = self.without(fuller, fuller.hypothesis.effects[-1])
        return current if current.cost - again.cost < _ONE_MINIMUM * abs(current.cost) else again

    def _pruned(self, fitted: Fitted[Physics], effects: Sequence[Effect[Physics]]) -> Fitted[Physics]:
        """Return the fit without those of some effects that are not needed."""
        for effect in effects:
            without = self.without(fitted, effect)
            if delta_bic(without, fitted, yardstick(fitted)) < self._least_evidence(without):
                kept = [one for one in effects if one.key != effect.key]
                return self._pruned(without, kept)
        return fitted

    def _in_place_of(
        self, final: Fitted[Physics], effect: Effect[Physics], known: Collection[str]
    ) -> list[tuple[Effect[Physics], Fitted[Physics]]]:
        """Return further effects that may do in the place of one, refitted from where the data are near.

        Whatever looked little promising from far away was not refitted there.
        """
        self.progress(f"looking for what would do in the place of {effect.key}")
        found = []
        for other in self._remaining(final):
            if other.key in known:
                continue
            rise, start = in_place_of(final, effect, other)
            hypothesis = final.hypothesis.without(effect.key).with_effect(other)
            trial = self._try(hypothesis, start) if rise < self.settings.most_rise else None
            if trial is not None:
                found.append((other, trial))
        return found

    def _judged(self, final: Fitted[Physics], effect: Effect[Physics], by: Yardstick) -> Accepted[Physics]:
        """Return the evidence for an effect of the final fit, and what else would do in its place.

        Physics without which the model is far from the data, and that is found at its textbook value, has no rival.
        """
        without = self.without(final, effect)
        plain = _is_at_textbook_value(final, effect) and is_far(without)
        refitted = [] if plain else [(one.effect, one.fitted) for one in self._rivals(without)]
        if not plain and looks_mislead(without):
            refitted += self._in_place_of(final, effect, {one.key for one, _ in refitted})
        others = [
            Rival(other, trial, delta_bic(without, trial, by)) for other, trial in refitted if other.key != effect.key
        ]
        rivals = sorted(others, key=lambda one: one.delta_bic, reverse=True)
        held_out_gain = gain(without.held_out, final.held_out, by)
        return Accepted(effect, delta_bic(without, final, by), held_out_gain, tuple(rivals), without)


def _keys(fitted: Fitted[Physics]) -> frozenset[str]:
    return frozenset(effect.key for effect in fitted.hypothesis.effects)


def _leading_to(final: Fitted[Physics], earlier: Sequence[Fitted[Physics]]) -> tuple[Fitted[Physics], ...]:
    """Return fits with the final one at their end; one of the same effects gives way to it."""
    return (*(one for one in earlier if _keys(one) != _keys(final)), final)


def _better(*fits: Fitted[Physics] | None) -> Fitted[Physics] | None:
    """Return the best of the fits that there are."""
    return min((one for one in fits if one is not None), key=lambda one: one.cost, default=None)


def _is_at_textbook_value(fitted: Fitted[Physics], effect: Effect[Physics]) -> bool:
    values = fitted.hypothesis.values(fitted.coordinates)[effect.key]
    return effect.textbook is not None and all(
        abs(values[one.name] - effect.textbook[one.name]) < _TEXTBOOK * abs(one.scale) for one in effect.parameters
    )


def _identity(fitted: Fitted[Physics]) -> bytes:
    keys = ",".join(effect.key for effect in fitted.hypothesis.effects)
    return keys.encode() + fitted.coordinates.tobytes()
