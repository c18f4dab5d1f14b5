"""Screen an uncertain parameter without the tolerance that holds it."""

import math
from collections.abc import Sequence

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.screening.projection import Projection
from monitor_core.discrepancy.screening.screened import N_STARTS, Screened
from monitor_core.discrepancy.screening.sizes import signed_ratios
from monitor_core.effects.effect import Effect, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.conditions.groups import has_lines
from monitor_core.fitting.solver.hypothesis_fit import Fitted

_RIDGE = 10.0  # of χ², between one minimum and another
_FINER_STEPS = (0.25, 0.125)  # of ln ratio, about the best: a coarse step may miss a narrow minimum


def screen_without_tolerance(
    fitted: Fitted[Physics], projection: Projection, effect: Effect[Physics], index: int
) -> Screened[Physics]:
    """Screen an uncertain parameter without its tolerance: the residuals stay, its prior goes.

    ``effect`` calls the parameter wrong; ``index`` is its place among the uncertain ones.
    """
    decrease, of_one_deviation = projection.freed(index)
    parameter, hypothesis = effect.parameters[0], fitted.hypothesis
    spread = hypothesis.axis.uncertain[hypothesis.uncertain[index]]
    information = of_one_deviation * (parameter.scale / spread) ** 2
    here = projection.residuals(fitted.standardised)
    tried = [(decrease, fitted.coordinates)]

    def at_ratio(ratio: float) -> tuple[float, FloatArray]:
        trial = fitted.coordinates.copy()
        trial[index] = ratio / spread
        try:
            left = projection.residuals(fitted.around.residuals(hypothesis.physics(trial)))
        except OutsideValidityError:
            return -math.inf, trial
        return float(here @ here - left @ left), trial

    elsewhere: FloatArray | None = None
    if not has_lines(fitted.comparison.layout):
        far = [at_ratio(ratio) for ratio in sorted(signed_ratios(parameter))]
        elsewhere = _beyond_a_ridge(far, index, float(fitted.coordinates[index]))
        for step in _FINER_STEPS if far else ():
            nearest = spread * max(far, key=lambda pair: pair[0])[1][index]
            around = (nearest + step, nearest - step)
            far += [at_ratio(ratio) for ratio in around if parameter.lower <= ratio <= parameter.upper]
        tried += [pair for pair in far if math.isfinite(pair[0])]
    tried.sort(key=lambda pair: pair[0], reverse=True)
    with_effect = hypothesis.with_effect(effect)
    starts = tuple(with_effect.carried_over(hypothesis, at) for _, at in tried[:N_STARTS])
    apart = None if elsewhere is None else with_effect.carried_over(hypothesis, elsewhere)
    return Screened(effect, starts, tried[0][0], decrease, information, apart)


def _beyond_a_ridge(tried: Sequence[tuple[float, FloatArray]], index: int, at_fit: float) -> FloatArray | None:
    """Return the best of the coordinates that lie in another minimum than those of the fit; None if none does.

    Where a parameter brings another mode to a measured frequency, χ² falls again beyond a ridge. What screening finds
    there is still far from the data: a fit comes nearer. Where the model has no answer there is no ridge.
    """
    tried = [pair for pair in tried if math.isfinite(pair[0])]
    below = sorted((pair for pair in tried if pair[1][index] < at_fit), key=lambda pair: -pair[1][index])
    above = sorted((pair for pair in tried if pair[1][index] > at_fit), key=lambda pair: pair[1][index])
    beyond: list[tuple[float, FloatArray]] = []
    for side in (below, above):
        ridges = np.minimum.accumulate([decrease for decrease, _ in side])
        beyond += [pair for pair, ridge in zip(side, ridges, strict=True) if min(pair[0], 0.0) > ridge + _RIDGE]
    return max(beyond, key=lambda pair: pair[0])[1] if beyond else None
