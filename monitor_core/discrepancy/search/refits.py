"""Refit the effects that screening finds promising, each from its best start.

A parameter that has been pulled far from what is stated may stand in for an effect: the two may add up to the same
along a valley that is too long and bent for a fit to go through. And once an effect has brought the model to the data,
others may do as well that screening from far away has missed.

A fit also starts with an effect in place of a pulled parameter, or of another effect.
"""

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.screening import Projection, Screened
from monitor_core.discrepancy.search.workspace import (
    Rival,
    Workspace,
    has_one_minimum,
    in_same_minimum,
    is_near,
    lowest_cost,
    may_be_elsewhere,
    may_lack_more,
    screening_misleads,
)
from monitor_core.effects.effect import Effect, EffectParameter, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.conditions.groups import has_lines
from monitor_core.fitting.evidence import delta_bic, evidence_scale, least_difference
from monitor_core.fitting.hypothesis import is_size, searched_coordinates
from monitor_core.fitting.solver.hypothesis_fit import Fitted

#: Standard deviations: a parameter so far from what is stated may stand in for an effect.
_PULLED = 3.0
_SMALLEST, _LARGEST = 0.1, 1e4  # sizes that are tried, in scales: a range may have no end
_FINE = 1.25  # ratio of sizes: some size then brings modes near to where the parameter has brought them
_COARSE = 2.0  # the same, where the rest is taken up linearly
_FINER = (0.5, 0.25, 0.125)  # powers of the ratio: about the best of them

#: Of a gain that screening predicts near the data, what a refit may gain; of a cost, what it may leave.
_MOST_OF_PREDICTED, _LEAST_LEFT = 2.0, 0.1


def substitute_parameter(fitted: Fitted[Physics], effect: Effect[Physics]) -> FloatArray | None:
    """Return the coordinates of a fit with an effect substituted for the parameter that is pulled furthest.

    The effect has the size that fits best, and the parameter is as stated. None where no parameter is pulled far except
    one that the effect itself frees, where the effect has a frequency of its own, or where the model has no answer with
    it.
    """
    hypothesis = fitted.hypothesis.with_effect(effect)
    there = hypothesis.carried_over(fitted.hypothesis, fitted.coordinates)
    pulls = np.abs(there[: hypothesis.n_uncertain])
    if effect.frequency is not None or np.max(pulls, initial=0.0) < _PULLED:
        return None
    there[np.argmax(pulls)] = 0.0

    def cost(trial: FloatArray) -> float:
        standardised = fitted.around.residuals(hypothesis.physics(trial))
        return float(np.sum(standardised[fitted.fitted] ** 2))

    size_at = there.size - len(effect.parameters)
    least, best = _best_size(there, size_at, effect, effect.parameters[0], _FINE, cost)
    return best if math.isfinite(least) else None


def substitute_effect(
    fitted: Fitted[Physics], effect: Effect[Physics], other: Effect[Physics]
) -> tuple[float, FloatArray]:
    """Return by how much χ² rises with another effect substituted for a found effect, and where.

    The rise is that at the best of the sizes of the other effect, what is left taken up linearly. It is infinite where
    the model has no answer, and for an effect with a frequency of its own, of which a few sizes tell nothing. The
    coordinates are of the hypothesis with the other effect as its last.
    """
    hypothesis = fitted.hypothesis.without(effect.key).with_effect(other)
    there = hypothesis.carried_over(fitted.hypothesis, fitted.coordinates)
    if other.frequency is not None:
        return math.inf, there
    projection = Projection(fitted, without=effect)
    here = projection.residuals(fitted.standardised)

    def rise(trial: FloatArray) -> float:
        left = projection.residuals(fitted.around.residuals(hypothesis.physics(trial)))
        return float(left @ left - here @ here)

    first = there.size - len(other.parameters)
    least, best = math.inf, there
    for index, parameter in enumerate(other.parameters, first):
        if not is_size(parameter):
            continue
        found_there = _best_size(there, index, other, parameter, _COARSE, rise)
        least, best = min((least, best), found_there, key=lambda pair: pair[0])
    return least, best


def _best_size(  # noqa: PLR0917
    there: FloatArray,
    index: int,
    effect: Effect[Physics],
    parameter: EffectParameter,
    ratio: float,
    cost: Callable[[FloatArray], float],
) -> tuple[float, FloatArray]:
    """Return the least cost of sizes that are a ratio apart, then of closer ones about the best, and where."""
    best = _best(there, index, _sizes(effect, parameter, ratio), cost)
    low, high = searched_coordinates(effect, parameter)
    for power in _FINER:
        size, factor = best[1][index], ratio**power
        around = [finer for finer in (size * factor, size / factor) if low <= finer <= high]
        best = min(best, _best(best[1], index, around, cost), key=lambda pair: pair[0])
    return best


def _best(
    coordinates: FloatArray, index: int, values: Iterable[float], cost: Callable[[FloatArray], float]
) -> tuple[float, FloatArray]:
    """Return the least cost of values of one coordinate, and where; infinite where there is no answer, unmoved."""
    least, best = math.inf, coordinates
    for value in values:
        trial = coordinates.copy()
        trial[index] = value
        try:
            here = cost(trial)
        except OutsideValidityError:
            continue
        if here < least:
            least, best = here, trial
    return least, best


def _sizes(effect: Effect[Physics], parameter: EffectParameter, ratio: float) -> Iterator[float]:
    low, high = searched_coordinates(effect, parameter)
    largest = min(max(-low, high), _LARGEST)
    for size in np.geomspace(_SMALLEST, largest, math.ceil(math.log(largest / _SMALLEST, ratio)) + 1).tolist():
        yield from (signed for signed in (size, -size) if low <= signed <= high)


def rivals_at(workspace: Workspace[Physics], current: Fitted[Physics]) -> tuple[Rival[Physics], ...]:
    """Return the most promising effects, refitted, best first; those of each minimum once only."""

    def refit() -> tuple[Rival[Physics], ...]:
        refitted = [*_refit_promising(workspace, current)]
        done = {effect.key for effect, _ in refitted}
        return _ranked(current, [*refitted, *_refit_elsewhere(workspace, current, done)])

    return workspace.rivals(current, refit)


def _ranked(
    current: Fitted[Physics], refitted: list[tuple[Effect[Physics], Fitted[Physics]]]
) -> tuple[Rival[Physics], ...]:
    """Return the refits, best first, without those that resonate where nothing was measured."""
    refitted = [(effect, trial) for effect, trial in refitted if _resonates_in_band(trial, effect)]
    best = lowest_cost(*(trial for _, trial in refitted))
    if best is None:
        return ()
    scale = evidence_scale(best)
    rivals = [Rival(effect, trial, delta_bic(current, trial, scale)) for effect, trial in refitted]
    return tuple(sorted(rivals, key=lambda rival: rival.delta_bic, reverse=True))


def _resonates_in_band(fitted: Fitted[Physics], effect: Effect[Physics]) -> bool:
    """Return whether an effect has no frequency of its own, or one where lines of responses were measured.

    Below or above the band an own resonance is nothing but a mass or a spring, of which there are effects.
    """
    layout, own = fitted.comparison.layout, effect.frequency
    if own is None or not has_lines(layout):
        return True
    frequency = fitted.hypothesis.values(fitted.coordinates)[effect.key][own.name]
    return bool(np.nanmin(layout.frequency) <= frequency <= np.nanmax(layout.frequency))


def _refit_promising(
    workspace: Workspace[Physics], current: Fitted[Physics]
) -> Iterator[tuple[Effect[Physics], Fitted[Physics]]]:
    """Yield refits of promising effects, until the gain predicted for the next is surpassed by far."""
    best = current
    promising = _promising(workspace, current)
    for number, screened in enumerate(promising, start=1):
        gained = current.cost - best.cost
        surpassed = screened.predicted_gain < workspace.settings.least_share_of_gain * gained
        at_floor = surpassed and not may_lack_more(best) and not screening_misleads(current)
        if surpassed and (is_near(current) or at_floor):
            continue
        workspace.progress(f"refitting with {screened.effect.key} ({number} of {len(promising)})")
        trial = _fit_from_best_start(workspace, current, screened, best)
        if trial is not None:
            yield screened.effect, trial
            if _resonates_in_band(trial, screened.effect):  # or it is no rival, and surpasses none
                best = min(best, trial, key=lambda fitted: fitted.cost)


def _refit_elsewhere(
    workspace: Workspace[Physics], current: Fitted[Physics], done: set[str]
) -> Iterator[tuple[Effect[Physics], Fitted[Physics]]]:
    """Yield refits of other effects from another minimum, where so much is left that the best may lie there."""
    for screened in workspace.screened(current) if may_be_elsewhere(current) else ():
        if screened.elsewhere is None or screened.effect.key in done:
            continue
        workspace.progress(f"refitting with {screened.effect.key}")
        trial = workspace.try_fit(current.hypothesis.with_effect(screened.effect), screened.elsewhere)
        if trial is not None:
            yield screened.effect, trial


def _promising(workspace: Workspace[Physics], current: Fitted[Physics]) -> list[Screened[Physics]]:
    """Return what is worth a refit: by the gain predicted at the best size tried, then by the slope.

    If anything is, so is whatever promises as much but for a margin: it would otherwise be missing among the
    indistinguishable effects.
    """
    settings, screened = workspace.settings, workspace.screened(current)
    worth_it = [result for result in screened if result.predicted_gain > settings.least_predicted_gain]
    if is_near(current):
        worth_it = [result for result in worth_it if _may_be_carried(workspace, current, result)]
    if not worth_it:
        return []
    chosen = sorted(worth_it, key=lambda result: result.decrease, reverse=True)[: settings.n_refitted]
    by_slope = sorted(worth_it, key=lambda result: result.score, reverse=True)[: settings.n_refitted_by_slope]
    # of χ²: near the data, where screening foretells what refits find, its difference is that of BIC
    least = max(result.predicted_gain for result in worth_it) - least_difference(workspace.comparison)
    alike = [result for result in screened if result.predicted_gain >= max(least, settings.least_predicted_gain)]
    return list(dict.fromkeys((*chosen, *by_slope, *alike)))


def _may_be_carried(workspace: Workspace[Physics], current: Fitted[Physics], screened: Screened[Physics]) -> bool:
    """Return whether the evidence may carry an effect, by a bound that holds near the data.

    There a refit gains no more than a multiple of what screening predicts. A resonance was tried at a few frequencies
    only, which is no bound.
    """
    if screened.effect.frequency is not None:
        return True
    scale, gain = evidence_scale(current), _MOST_OF_PREDICTED * screened.predicted_gain
    left = max(current.cost - gain, _LEAST_LEFT * current.cost)  # what is left counts as noise
    evidence = scale.factor * gain * max(current.cost / left, 1.0) if left > 0.0 else math.inf
    return evidence - scale.penalty(len(screened.effect.parameters)) >= workspace.least_evidence(
        current, screened.effect
    )


def _fit_from_best_start(
    workspace: Workspace[Physics], current: Fitted[Physics], screened: Screened[Physics], leader: Fitted[Physics]
) -> Fitted[Physics] | None:
    """Return the best fit from where screening leads, another minimum, a substituted parameter, or a null effect.

    Of the starts by screening and of the null effect, a single fit is enough if it ends at the floor, where there is
    but one minimum, or if it gains what screening has predicted, where that can be relied upon. Two fits are enough if
    they end in the same minimum and gain something. What promises, and from its best start gains, a small share of what
    another effect, the ``leader``, has gained is not fitted from others.
    """
    worth_more = workspace.settings.least_share_of_gain * (current.cost - leader.cost)
    near = is_near(current)
    hypothesis = current.hypothesis.with_effect(screened.effect)
    absent = hypothesis.carried_over(current.hypothesis, current.coordinates)
    apart: list[FloatArray | None] = [substitute_parameter(current, screened.effect), screened.elsewhere]
    best = None
    for start in apart:
        if start is not None:
            best = lowest_cost(best, workspace.try_fit(hypothesis, start, math.inf if best is None else best.cost))
    if best is not None and not best.tolerance and has_one_minimum(best) and best.cost < current.cost:
        return best
    for start, errors in _starts(current, screened, absent, near=near):
        limit = math.inf if best is None else best.cost
        trial = workspace.try_fit(hypothesis, start, limit, errors=errors)
        if trial is None:
            continue
        again = best is not None and in_same_minimum(trial, best)
        if best is None or trial.cost < best.cost:
            best = trial
        if again and best.cost < current.cost:
            break
        gained = current.cost - best.cost
        if gained > 0.0 and (has_one_minimum(best) or (near and 2.0 * gained > screened.decrease)):
            break
        if max(gained, screened.predicted_gain) < worth_more and not screening_misleads(current):
            break
    return best


def _starts(
    current: Fitted[Physics], screened: Screened[Physics], absent: FloatArray, *, near: bool
) -> Iterator[tuple[FloatArray, FloatArray | None]]:
    """Yield where screening leads and the null effect, each with the condition errors there where they are known.

    Responses near the data have one minimum. Where the first start has led astray from it, the null effect leads back,
    beside the errors as they are; other starts are then worth a fit of what resonates only.
    """
    first, others = screened.starts[:1], () if near else screened.starts[1:]
    yield from ((start, None) for start in first)
    if not has_lines(current.comparison.layout) or may_be_elsewhere(current):
        yield from ((start, None) for start in (*others, absent))
        return
    yield absent, current.around.errors
    yield from ((start, None) for start in others if screened.effect.frequency is not None)
