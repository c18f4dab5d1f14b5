"""Hold what a search works on: comparison, axis, candidates, settings, and the fits that are known already.

The gap is measured in noise floors: at 1 nothing is left to find, below ``_ONE_MINIMUM`` a fit has not ended in a false
minimum, beyond ``_FAR`` nothing makes up by chance for what is missing. Where misfits are small the model is nearly
linear in what may be added, and screening foretells what refits find.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Generic

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.screening import Screened, screen
from monitor_core.effects import PREFIX
from monitor_core.effects.effect import ConditionAxis, Effect, Physics
from monitor_core.errors import MonitorCoreError, OutsideValidityError
from monitor_core.fitting.axis import DescribedAxis
from monitor_core.fitting.comparison import Comparison
from monitor_core.fitting.conditions.groups import has_lines
from monitor_core.fitting.conditions.settings import is_testable, varied_conditions
from monitor_core.fitting.evidence import VERY_STRONG, EvidenceScale
from monitor_core.fitting.hold_out import fitted_values, judged_gap
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit

_ONE_MINIMUM, _FAR = 1.5, 10.0  # gaps, in floors
_SMALL_MISFIT, _ALMOST_ALL = 0.15, 0.98  # a misfit that this share of the values stays within
_SMALL_PULL = 6.0  # of a position or a preload, in its standard deviations
#: Variance of the pulls of settings that too small a tolerance explains: thrice is the most.
PULLS_OF_TOLERANCES = 9.0
#: Standard deviations that a declared parameter is pulled by at most where nothing is missing.
STRAINED = 4.0


def gap(fitted: Fitted[Physics]) -> float:
    """Return the gap on the fitted values, in floors of the data."""
    return fitted.gap / fitted.comparison.noise_floor


def is_near(fitted: Fitted[Physics]) -> bool:
    """Return whether screening foretells what refits find.

    It does not where errors of the settings would take up what is missing: they are far from where it will be
    found, and the model is not linear so far.
    """
    small = float(np.quantile(np.abs(fitted.misfit[fitted.fitted]), _ALMOST_ALL)) < _SMALL_MISFIT
    return small and _largest_pull(fitted) < _SMALL_PULL


def _largest_pull(fitted: Fitted[Physics]) -> float:
    """Return by how much a setting is pulled at most but for gains, which act linearly, in standard deviations."""
    names = fitted.comparison.condition_error_names
    moving = [column for column, name in enumerate(names) if not name.startswith("gain")]
    pulls = fitted.around.whitened_by.pulls(fitted.misfit)[:, moving]
    return float(np.max(np.abs(np.nan_to_num(pulls)), initial=0.0))


def variances_of_pulls(fitted: Fitted[Physics]) -> dict[str, float]:
    """Return the variance of each kind of condition error, 1 on average where all is right.

    It is taken about their mean: an error that is alike in all settings is left to a tolerance or an offset.
    """
    errors = fitted.around.whitened_by.pulls(fitted.misfit)
    variances = {}
    for name, column in zip(fitted.comparison.condition_error_names, errors.T, strict=True):
        known = column[np.isfinite(column)]
        if known.size:
            variances[name] = float(np.var(known))
    return variances


def are_pulled(variances: Mapping[str, float], most: float) -> bool:
    """Return whether errors of settings scatter more than that; gains are left to their tolerance."""
    return any(value > most for name, value in variances.items() if not name.startswith("gain"))


def is_far(fitted: Fitted[Physics]) -> bool:
    """Return whether nothing makes up by chance for what this fit is without."""
    return gap(fitted) > _FAR


def screening_misleads(fitted: Fitted[Physics]) -> bool:
    """Return whether screening predicts much less than refits gain: for frequencies of modes, far from the data."""
    return not has_lines(fitted.comparison.layout) and is_far(fitted)


def may_be_elsewhere(fitted: Fitted[Physics]) -> bool:
    """Return whether so much is left that a better minimum may lie elsewhere."""
    return gap(fitted) >= _ONE_MINIMUM


def may_lack_more(fitted: Fitted[Physics]) -> bool:
    """Return whether more is left than a healthy axis leaves; about half of them leave a gap of more than one floor."""
    return judged_gap(fitted).exceeds_healthy


def has_one_minimum(fitted: Fitted[Physics]) -> bool:
    """Return whether a fit that improves is the best one: false minima come from phases, far from the data."""
    phases = np.any(np.isfinite(fitted.comparison.layout.period))
    return not phases or not may_be_elsewhere(fitted)


#: Of the cost: fits that differ by less ended in the same minimum.
SAME_MINIMUM = 1e-4
#: The same for fits that end with a tolerance, once that shrinks by no more than a thousandth: χ² by twice as much. And
#: by which share of its scale, or of itself, a coordinate may then differ: many a place leaves as much of a large gap.
_SAME_TEMPERED, _SAME_PLACE = 2e-3, 0.03


def in_same_minimum(first: Fitted[Physics], second: Fitted[Physics]) -> bool:
    """Return whether two fits of the same effects ended in the same minimum."""
    apart, least = abs(first.cost - second.cost), min(abs(first.cost), abs(second.cost))
    if not (first.tolerance and second.tolerance):
        return apart < SAME_MINIMUM * least
    effects = slice(first.hypothesis.n_uncertain, None)
    there = first.hypothesis.carried_over(second.hypothesis, second.coordinates)
    off = np.abs(first.coordinates - there)[effects] / np.maximum(1.0, np.abs(there[effects]))
    return apart < _SAME_TEMPERED * least and bool(np.all(off < _SAME_PLACE))


def better_minimum(first: Fitted[Physics], second: Fitted[Physics]) -> Fitted[Physics]:
    """Return the second of two fits of the same effects if it ended in a better minimum, else the first."""
    return second if first.cost - second.cost >= SAME_MINIMUM * abs(first.cost) else first


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """When the evidence carries an effect. The figures are set on simulated machines, see benchmarks/hidden_effects."""

    #: Of the gain of log-likelihood that is expected on held-out values, less twice what that gain scatters by.
    least_held_out_share: float = 0.3
    #: Of what an effect gains where it is fitted, what may be lost where it is not: a parameter beyond its tolerance
    #: gains by its prior alone and changes hardly a residual, those held out for the worse or the better.
    forgiven_share: float = 0.05
    least_predicted_gain: float = 12.0  # of χ², by screening, for an effect to be refitted
    n_refitted: int = 6  # by the gain predicted at the best size tried
    n_refitted_by_slope: int = 1
    #: Of what a refit has gained: what promises less is not refitted besides it, where screening can be relied upon.
    least_share_of_gain: float = 0.3
    most_rise: float = 25.0  # of χ², by screening, for an effect to be refitted in the place of an effect found
    most_effects: int = 5
    n_first_steps: int = 2  # tried one after the other where the best one does not lead to the floor


@dataclass(frozen=True, eq=False)
class Rival(Generic[Physics]):
    """An effect that was refitted in the place of an accepted effect."""

    effect: Effect[Physics]
    fitted: Fitted[Physics]
    delta_bic: float  # against the fit without any of them


@dataclass(frozen=True, eq=False)
class Accepted(Generic[Physics]):
    """An effect with its rivals, all against the fit without it."""

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
    evidence_scale: EvidenceScale
    screened: tuple[Screened[Physics], ...]  # what is not in the final fit
    least_delta_bic: float  # that one more effect would have needed


class TimeIsUpError(MonitorCoreError, RuntimeError):
    """A search was left before its end; what it had come to is in its workspace."""


class StoppableAxis(Generic[Physics]):
    """A described axis that leaves a search, once."""

    def __init__(self, axis: DescribedAxis[Physics], time_is_up: Callable[[], bool]) -> None:
        self._axis, self._time_is_up, self._may_stop = axis, time_is_up, False

    @contextmanager
    def stoppable(self) -> Iterator[None]:
        """Leave what is done meanwhile once time is up; what is made of a search that came to its end is not left."""
        self._may_stop = True
        try:
            yield
        finally:
            self._may_stop = False

    @property
    def uncertain(self) -> Mapping[str, float]:
        """As of the axis."""
        return self._axis.uncertain

    def physics(self, ln_ratios: Mapping[str, float]) -> Physics:
        """Return the axis with parameters moved, as the axis does; raises TimeIsUpError where it may stop, once."""
        if self._may_stop and self._time_is_up():
            self._may_stop = False
            raise TimeIsUpError("time was up before the search had come to its end")
        return self._axis.physics(ln_ratios)


@dataclass(frozen=True, eq=False)
class Workspace(Generic[Physics]):
    """What is searched, in what, and what the steps of the search share: the best fits, screenings and rivals known."""

    comparison: Comparison[Physics]
    axis: DescribedAxis[Physics]
    candidates: tuple[Effect[Physics], ...]
    settings: SearchSettings = SearchSettings()
    progress: Callable[[str], None] = lambda _sentence: None
    #: Asked of the fits without any effect and with one: whether what no effect is explains all that is missing.
    is_explained_otherwise: Callable[[Fitted[Physics], Fitted[Physics]], bool] = lambda _baseline, _fitted: False
    #: By the keys of their effects.
    best_fits: dict[frozenset[str], Fitted[Physics]] = field(default_factory=dict, init=False)
    #: With the fit that they start from, and by its effects; from each minimum they are refitted once only.
    _rivals: list[tuple[Fitted[Physics], tuple[Rival[Physics], ...]]] = field(default_factory=list, init=False)
    _screened: list[tuple[Fitted[Physics], tuple[Screened[Physics], ...]]] = field(default_factory=list, init=False)
    #: Fits of the steps of the search so far, without any effect and after each that was added.
    so_far: list[Fitted[Physics]] = field(default_factory=list, init=False)
    #: By the effects, all of them candidates, the start, and the condition errors there: several ways lead to the same
    #: fit. None: no answer there.
    _fits: dict[tuple[tuple[int, ...], bytes, bytes], Fitted[Physics] | None] = field(default_factory=dict, init=False)
    #: Costs that these had to beat.
    _given_up: dict[tuple[tuple[int, ...], bytes, bytes], float] = field(default_factory=dict, init=False)

    def fit(self, hypothesis: Hypothesis[Physics], start: FloatArray) -> Fitted[Physics]:
        """Fit a hypothesis to the values that fits see; raises OutsideValidityError without an answer at the start."""
        return fit(self.comparison, hypothesis, start, fitted_values(self.comparison.layout))

    def try_fit(
        self,
        hypothesis: Hypothesis[Physics],
        start: FloatArray,
        to_beat: float = math.inf,
        *,
        errors: FloatArray | None = None,
    ) -> Fitted[Physics] | None:
        """Fit a hypothesis, once only from each start; None where the model has no answer at the start.

        A fit that will not come below a cost ``to_beat`` may be given up. It begins with no condition errors, or with
        ``errors`` that are likely at the start.
        """
        key = tuple(map(id, hypothesis.effects)), start.tobytes(), b"" if errors is None else errors.tobytes()
        known = self._fits.get(key)
        if key not in self._fits or (known is not None and known.given_up and to_beat > self._given_up[key]):
            self._given_up[key] = to_beat
            try:
                chosen = fitted_values(self.comparison.layout)
                known = fit(self.comparison, hypothesis, start, chosen, to_beat=to_beat, errors=errors)
            except OutsideValidityError:
                known = None
            self._fits[key] = known
        return known

    def reach(self, *steps: Fitted[Physics]) -> None:
        """Keep the steps of a search as its answer if it had to be given now."""
        if not self.so_far or steps[-1].cost < self.so_far[-1].cost:
            self.so_far[:] = steps

    @property
    def tried(self) -> frozenset[str]:
        """The keys of all effects that any fit had."""
        fits = (fitted for fitted in self._fits.values() if fitted is not None)
        return frozenset(key for fitted in fits for key in fitted.hypothesis.keys)

    def remember(self, fitted: Fitted[Physics]) -> None:
        """Keep a fit if it is the best of its effects."""
        keys = fitted.hypothesis.keys
        if keys not in self.best_fits or fitted.cost < self.best_fits[keys].cost:
            self.best_fits[keys] = fitted

    @property
    def baseline(self) -> Fitted[Physics]:
        """The best fit without any effect."""
        return self.best_fits[frozenset()]

    def without(self, fitted: Fitted[Physics], effect: Effect[Physics]) -> Fitted[Physics]:
        """Return the best fit known without one of the effects of a fit.

        It starts from where the fuller fit ended. It is no worse than the best fit with still fewer effects that is
        known by then: the evidence would otherwise be that of a false minimum.
        """
        hypothesis = fitted.hypothesis.without(effect.key)
        from_fuller = self.try_fit(hypothesis, hypothesis.carried_over(fitted.hypothesis, fitted.coordinates))
        best = lowest_cost(self.best_fits.get(hypothesis.keys), from_fuller)
        plain = lowest_cost(*(known for those, known in self.best_fits.items() if those < hypothesis.keys))
        if plain is not None and (best is None or plain.cost < best.cost):
            start = hypothesis.carried_over(plain.hypothesis, plain.coordinates)
            best = lowest_cost(best, self.try_fit(hypothesis, start))
        best = best or self.fit(hypothesis, hypothesis.null)
        self.remember(best)
        return best

    def remaining(self, fitted: Fitted[Physics]) -> tuple[Effect[Physics], ...]:
        """Return the candidates that could still be added.

        What goes with the amplitude is one at a single level of excitation, too: the amplitude differs from setting to
        setting all the same, and something else that goes with position or preload would get its name.
        """
        present = fitted.hypothesis.keys
        physics, layout = fitted.physics(), self.comparison.layout
        not_needed = {ConditionAxis.LEVEL} if has_lines(layout) else set()
        return tuple(
            effect
            for effect in self.candidates
            if effect.key not in present
            and (is_testable(effect, layout) or effect.needs - varied_conditions(layout) == not_needed)
            and effect.applies(physics)
        )

    def screened(self, fitted: Fitted[Physics]) -> tuple[Screened[Physics], ...]:
        """Screen everything that could still be added to a fit, once only in each minimum."""
        known = self._known_screening(fitted)
        if known is None:
            known = screen(fitted, self.remaining(fitted), self.progress)
            self._screened.append((fitted, known))
        return known

    def known_screening(self, fitted: Fitted[Physics]) -> tuple[Screened[Physics], ...]:
        """Return what screening has found where it is done, else nothing."""
        return self._known_screening(fitted) or ()

    def _known_screening(self, fitted: Fitted[Physics]) -> tuple[Screened[Physics], ...] | None:
        effects = fitted.hypothesis.effects  # in their order: what was found are coordinates
        same = (
            screened
            for earlier, screened in self._screened
            if earlier.hypothesis.effects == effects and in_same_minimum(earlier, fitted)
        )
        return next(same, None)

    def rivals(
        self, fitted: Fitted[Physics], refit: Callable[[], tuple[Rival[Physics], ...]]
    ) -> tuple[Rival[Physics], ...]:
        """Return the refits with one more effect from a fit, made by ``refit`` once only in each minimum."""
        keys = fitted.hypothesis.keys
        for earlier, rivals in self._rivals:
            if earlier.hypothesis.keys == keys and in_same_minimum(earlier, fitted):
                return rivals
        rivals = refit()
        self._rivals.append((fitted, rivals))
        return rivals

    def least_evidence(self, without: Fitted[Physics], effect: Effect[Physics] | None = None) -> float:
        """Return the gain of BIC that one more effect needs.

        Where a fit leaves no more than a healthy axis would, nothing but the choice of this effect among all that were
        screened speaks for it, which may gain 2 ln n by chance (Chen and Chen, Biometrika 95 (2008) 759). That is all
        that is asked of a parameter that the fit pulls beyond belief: the least of a comparison is what the form of a
        model may feign, and that pulls no tolerance so far.
        """
        least = self.comparison.least_delta_bic
        if judged_gap(without).exceeds_healthy:
            return least
        by_chance = VERY_STRONG + 2.0 * math.log(max(len(self.remaining(without)), 1))
        pulls = dict(zip(without.hypothesis.uncertain, without.coordinates.tolist(), strict=False))
        pull = 0.0 if effect is None else pulls.get(effect.key.removeprefix(PREFIX), 0.0)
        return by_chance if abs(pull) > STRAINED else max(least, by_chance)


def lowest_cost(*fits: Fitted[Physics] | None) -> Fitted[Physics] | None:
    """Return the fit with the lowest cost; None if all failed."""
    return min((fitted for fitted in fits if fitted is not None), key=lambda fitted: fitted.cost, default=None)
