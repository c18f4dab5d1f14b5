"""Refit the effects that screening finds promising, each from its best start."""

from collections.abc import Iterator

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.screening.screened import Screened
from monitor_core.discrepancy.search.distance import (
    gap,
    has_one_minimum,
    is_near,
    may_be_elsewhere,
    screening_misleads,
)
from monitor_core.discrepancy.search.found import Rival
from monitor_core.discrepancy.search.substitution import substitute_parameter
from monitor_core.discrepancy.search.workspace import SAME_MINIMUM, Workspace, identity, lowest_cost
from monitor_core.effects.effect import Effect, Physics
from monitor_core.fitting.evidence import delta_bic, evidence_scale, least_difference
from monitor_core.fitting.solver.hypothesis_fit import Fitted


def rivals_at(workspace: Workspace[Physics], current: Fitted[Physics]) -> tuple[Rival[Physics], ...]:
    """Return the most promising effects, refitted, best first; those of each fit once only."""
    key = identity(current)
    if key not in workspace.rivals:
        refitted = [*_refit_promising(workspace, current)]
        done = {effect.key for effect, _ in refitted}
        refitted += _refit_elsewhere(workspace, current, done)
        workspace.rivals[key] = _ranked(current, refitted)
    return workspace.rivals[key]


def _ranked(
    current: Fitted[Physics], refitted: list[tuple[Effect[Physics], Fitted[Physics]]]
) -> tuple[Rival[Physics], ...]:
    best = lowest_cost(*(trial for _, trial in refitted))
    if best is None:
        return ()
    scale = evidence_scale(best)
    rivals = [Rival(effect, trial, delta_bic(current, trial, scale)) for effect, trial in refitted]
    return tuple(sorted(rivals, key=lambda rival: rival.delta_bic, reverse=True))


def _refit_promising(
    workspace: Workspace[Physics], current: Fitted[Physics]
) -> Iterator[tuple[Effect[Physics], Fitted[Physics]]]:
    """Yield refits of promising effects, until the gain predicted for the next is surpassed by far."""
    best = current
    for screened in _promising(workspace, current):
        gained = current.cost - best.cost
        surpassed = screened.predicted_gain < workspace.settings.least_share_of_gain * gained
        at_floor = gap(best) < 1.0 and not screening_misleads(current)
        if surpassed and (is_near(current) or at_floor):
            continue
        workspace.progress(f"refitting with {screened.effect.key}")
        trial = _fit_from_best_start(workspace, current, screened)
        if trial is not None:
            yield screened.effect, trial
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
    if not worth_it:
        return []
    chosen = sorted(worth_it, key=lambda result: result.decrease, reverse=True)[: settings.n_refitted]
    by_slope = sorted(worth_it, key=lambda result: result.score, reverse=True)[: settings.n_refitted_by_slope]
    # of χ²: near the data, where screening foretells what refits find, its difference is that of BIC
    least = max(result.predicted_gain for result in worth_it) - least_difference(workspace.comparison)
    alike = [result for result in screened if result.predicted_gain >= least]
    return list(dict.fromkeys((*chosen, *by_slope, *alike)))


def _fit_from_best_start(
    workspace: Workspace[Physics], current: Fitted[Physics], screened: Screened[Physics]
) -> Fitted[Physics] | None:
    """Return the best fit from where screening leads, another minimum, a substituted parameter, or a null effect.

    Of the starts by screening and of the null effect, a single fit is enough if it ends at the floor, where there is
    but one minimum, or if it gains what screening has predicted, where that can be relied upon. Two fits are enough if
    they end in the same minimum and gain something.
    """
    near = is_near(current)
    hypothesis = current.hypothesis.with_effect(screened.effect)
    absent = hypothesis.carried_over(current.hypothesis, current.coordinates)
    apart: list[FloatArray | None] = [substitute_parameter(current, screened.effect), screened.elsewhere]
    best = lowest_cost(*[workspace.try_fit(hypothesis, start) for start in apart if start is not None])
    for start in (*(screened.starts[:1] if near else screened.starts), absent):
        trial = workspace.try_fit(hypothesis, start)
        if trial is None:
            continue
        again = best is not None and abs(trial.cost - best.cost) < SAME_MINIMUM * best.cost
        if best is None or trial.cost < best.cost:
            best = trial
        if again and best.cost < current.cost:
            break
        gained = current.cost - best.cost
        if gained > 0.0 and (has_one_minimum(best) or (near and 2.0 * gained > screened.decrease)):
            break
    return best
