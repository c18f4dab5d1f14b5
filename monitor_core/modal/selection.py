"""Choose the number of modes and tones; more are added only where the data require them."""

import math
from dataclasses import replace

import numpy as np
import scipy.special

from monitor_core.modal.fit_lines import FitLines, ModelOrder
from monitor_core.modal.model import basis_of, forced_cost, overdispersion
from monitor_core.modal.residual import noise_weight, strongest_tone
from monitor_core.modal.starts import start_one_mode, start_two_modes
from monitor_core.modal.variable_projection import Solution, degrees_of_freedom, minimise

_MAXIMUM_TONES = 2
_SCREENING_PROBABILITY = 0.01
#: Difference of the criterion that is asked for, three times what is called very strong evidence: a change of model
#: moves the frequency, and between measurements of one axis that looks like a change of the axis.
_STRONG_EVIDENCE = 30.0


def likeliest_model(
    lines: FitLines, frequency: float, damping_ratio: float, maximum_modes: int
) -> tuple[FitLines, Solution] | None:
    """Choose between one and two modes, each with the noise and the tones it needs, from a start [Hz], [-].

    Returned are the lines as weighted in the end, and the fit to them; ``None`` if there is no optimum near the start.
    """
    if degrees_of_freedom(lines, ModelOrder(1)) <= 0:
        return None
    white = minimise(lines, start_one_mode(lines, frequency, damping_ratio), ModelOrder(1))
    one_mode = None if white is None else _with_noise_and_tones(lines, white)
    if one_mode is None or maximum_modes < 2 or not _leaves_response(*one_mode):
        return one_mode
    richer = _richer_model(lines, one_mode[1])
    return one_mode if richer is None else _with_noise_and_tones(lines, richer)


def _with_noise_and_tones(lines: FitLines, solution: Solution) -> tuple[FitLines, Solution] | None:
    """Weight the lines by their noise, add significant sines one at a time, and fit everything again."""
    lines = lines.weighted(noise_weight(lines, solution))
    weighted = minimise(lines, solution.parameters, solution.order)
    while weighted is not None and weighted.order.n_tones < _MAXIMUM_TONES:
        tone = strongest_tone(lines, weighted)
        if tone is None:
            break
        order = replace(weighted.order, n_tones=weighted.order.n_tones + 1)
        more = minimise(lines, np.append(weighted.parameters, tone), order)
        if more is None or more.bic > weighted.bic:
            break
        lines = lines.weighted(noise_weight(lines, more))
        weighted = minimise(lines, more.parameters, order)
    return None if weighted is None else (lines, weighted)


def _leaves_response(lines: FitLines, one_mode: Solution) -> bool:
    """Tell whether a richer B at the same pole explains significantly more; cheap, nothing is searched."""
    plain, background = _plain_and_background(one_mode)
    if degrees_of_freedom(lines, background) <= 0:
        return False
    nuisance = basis_of(lines, one_mode.parameters, plain)
    costs = [forced_cost(lines, one_mode.parameters, order, nuisance) for order in (plain, background)]
    n_more = 2 * (background.n_response_terms - plain.n_response_terms)
    gain = 2 * lines.response.size * math.log(costs[0] / costs[1])
    return bool(gain > scipy.special.chdtri(n_more, _SCREENING_PROBABILITY))


def _richer_model(white: FitLines, one_mode: Solution) -> Solution | None:
    r"""Return a richer B of the one mode, or a second mode, if the excitation's own trace in the residual asks for it.

    All are judged with the noise of the richest, and with the same terms of the windows (those of the one mode, two
    degrees richer): a second pole would bend them to each window's accidents, and win with what is not of the axis.
    What remains is the quasi-BIC

    .. math:: \frac{N}{\hat c} \ln \sum |R|^2 + k \ln N

    with :math:`k` parameters of the axis, :math:`N` real data and the overdispersion :math:`\hat c`.
    """
    plain, background = _plain_and_background(one_mode)
    rich = minimise(white, one_mode.parameters, background)
    two_modes = _two_modes(white, one_mode)
    richest = two_modes or rich
    if richest is None:
        return None
    lines = white.weighted(noise_weight(white, richest))
    single = minimise(lines, one_mode.parameters, plain)
    if single is None:
        return None
    refined = [minimise(lines, start.parameters, start.order) for start in (rich, two_modes) if start is not None]
    nuisance = basis_of(lines, single.parameters, plain)
    n_data = 2 * lines.response.size
    n_effective = n_data / overdispersion(lines, single.parameters, plain, background)

    def criterion(solution: Solution) -> float:
        n_axis = 2 * solution.order.n_modes + 2 * solution.order.n_response_terms
        cost = forced_cost(lines, solution.parameters, solution.order, nuisance)
        return n_effective * math.log(cost) + n_axis * math.log(n_data)

    best = min((solution for solution in refined if solution is not None), key=criterion, default=single)
    return best if criterion(best) < criterion(single) - _STRONG_EVIDENCE else None


def _plain_and_background(one_mode: Solution) -> tuple[ModelOrder, ModelOrder]:
    plain = replace(one_mode.order, transient_modes=2)
    return plain, replace(plain, response_modes=2)


def _two_modes(lines: FitLines, one_mode: Solution) -> Solution | None:
    """Fit two modes, with the tones found so far and without: what one mode leaves may have passed for a tone."""
    if degrees_of_freedom(lines, ModelOrder(2, one_mode.order.n_tones)) <= 0:
        return None
    starts = start_two_modes(lines, one_mode.parameters[:2])
    found = [
        minimise(lines, np.append(start, tones), ModelOrder(2, tones.size))
        for tones in ([one_mode.tones] if one_mode.order.n_tones == 0 else [one_mode.tones, one_mode.tones[:0]])
        for start in starts
    ]
    return min((solution for solution in found if solution is not None), key=lambda s: s.bic, default=None)
