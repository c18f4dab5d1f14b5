"""Choose the number of modes and tones by the residual of a fit: more only where the data require them.

The residual gives the noise of each line, and sines that persist in every window; starts come from quick fits.
"""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import scipy

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray
from monitor_core.modal.model import (
    FitLines,
    ModelOrder,
    basis_of,
    cost_at,
    forced_cost,
    nested_costs,
    overdispersion,
    pole_factor,
)
from monitor_core.modal.variable_projection import Solution, degrees_of_freedom, minimise
from monitor_core.spectral import BandSpectra, cross_spectra, least_leaking_taper

_ITERATIONS = 4
#: Least share of the mean level: a line must not count for more than a thousand average ones.
_FLOOR = 1e-3
#: Probability that a clean band is said to hold a tone.
_FALSE_ALARM_PROBABILITY = 1e-3
_LINES_APART = 1.5
#: Of a tone's power over its neighbours'. With more than about a dozen windows this rise, not the significance level,
#: decides: the level then lies below three times the noise.
_LEAST_RISE = 3.0


def noise_weight(lines: FitLines, solution: Solution) -> FloatArray:
    r"""Return one over the standard deviation of the noise at each line, 1 at the least noisy, shape (n_frequencies,).

    .. math:: \sigma^2(f) = \sigma_0^2 + \sum_i \sigma_i^2\, \frac{\min |A_i|^2}{|A_i(f)|^2}

    The first part is the accelerometer's; that of a scale or an encoder, white as long as it counts on (q²/12 of a step
    q), rises with the fourth power of the frequency once it is an acceleration. The others are forces that nobody
    measures, such as friction: they reach the sensor through the mode, so their noise has its shape; on an axis with
    friction they are nearly all of it. Fitted to the residual's mean power over windows, whose standard deviation is
    proportional to itself (maximum likelihood of the gamma distribution by repeated non-negative least squares).
    """
    power = np.mean(np.abs(solution.projection.residual) ** 2, axis=0) / lines.weight**2
    floor = _FLOOR * float(power.mean())
    shapes = [(lines.frequency / lines.frequency[-1]) ** (2 * lines.derivatives)]
    for natural_frequency, damping_ratio in solution.modes:
        shape = 1.0 / np.abs(pole_factor(lines.frequency, natural_frequency, damping_ratio)) ** 2
        shapes.append(shape / shape.max())
    columns = np.column_stack(shapes)
    level = np.full_like(power, power.mean())
    for _ in range(_ITERATIONS):
        share, _ = scipy.optimize.nnls(columns / level[:, None], power / level)
        level = np.maximum(columns @ share, floor)
    weight: FloatArray = np.sqrt(level.min() / level)
    return weight


def strongest_tone(lines: FitLines, solution: Solution) -> float | None:
    r"""Return the frequency in hertz of the strongest sine that the fit leaves, or ``None`` if none is significant.

    A sine of unknown amplitude and phase in each window, of one frequency in all, stands out on its line, or, halfway
    between two, in their difference (the line shape changes sign there):

    .. math:: S(f_k) = \frac{2}{\sigma^2} \sum_s |R_s(k)|^2,\qquad
        S(f_{k+1/2}) = \frac{2}{\sigma^2} \sum_s \tfrac12 |R_s(k) - R_s(k+1)|^2

    Both are :math:`\chi^2` with two degrees of freedom per window if there is none; the level is divided by the number
    of places, on the lines and between them. A line and a half on either side of a mode are left out: there a sine
    cannot be told from ringing that the model does not quite meet. What stands no higher than its neighbourhood is
    noise of another colour than supposed, and no sine either.
    """
    f, residual = lines.frequency, solution.projection.residual
    power = np.sum(np.abs(residual) ** 2, axis=0)
    between = 0.5 * np.sum(np.abs(np.diff(residual, axis=1)) ** 2, axis=0)
    places = np.concatenate([f, 0.5 * (f[:-1] + f[1:])])
    candidates = np.where(_apart_from_modes(places, solution, lines.resolution), np.concatenate([power, between]), 0.0)
    best = int(np.argmax(candidates))
    distance = np.abs(f - places[best]) / lines.resolution
    # places are whole and half lines: limits between those are met alike however the frequencies are rounded
    neighbours = power[(distance > 1.75) & (distance < 6.25)].mean()
    level = scipy.special.chdtri(2 * lines.n_windows, _FALSE_ALARM_PROBABILITY / places.size)
    significant = 2.0 * candidates[best] / solution.noise_variance > level
    return float(places[best]) if significant and candidates[best] > _LEAST_RISE * neighbours else None


def _apart_from_modes(tones: FloatArray, solution: Solution, resolution: float) -> BoolArray:
    apart = np.ones(tones.size, dtype=np.bool_)
    for natural_frequency in solution.modes[:, 0]:
        apart &= np.abs(tones - natural_frequency) > _LINES_APART * resolution
    return apart


_DAMPING_FACTORS = (1 / 3, 1.0, 3.0)
_PLACES = 16
_DAMPING_LIMITS = (1e-5, 0.5)
_RATIONAL_ITERATIONS = 8


def start_one_mode(lines: FitLines, frequency: float, damping_ratio: float) -> FloatArray:
    """Return the likeliest of a few dampings at a frequency, as parameters of the fit."""
    starts = [np.array([frequency, math.log(damping_ratio * factor)]) for factor in _DAMPING_FACTORS]
    return min(starts, key=lambda start: cost_at(lines, start, ModelOrder(1)))


def start_two_modes(lines: FitLines, one_mode: FloatArray) -> list[FloatArray]:
    """Return the two likeliest starts of two modes, the likelier first: a rational fit, or a second near the first."""
    order = ModelOrder(2)
    places = np.linspace(lines.frequency[0], lines.frequency[-1], _PLACES)
    # Two modes that were fitted with one gave it too much damping.
    starts = [
        np.array([one_mode[0], one_mode[1] - narrower, place, one_mode[1] - narrower])
        for place, narrower in product(places, (0.0, 1.0))
    ]
    poles = rational_poles(*_measured_response(lines), order.n_modes)
    if poles.shape[0] == order.n_modes:
        starts.append(np.column_stack([poles[:, 0], np.log(poles[:, 1])]).ravel())
    return sorted(starts, key=lambda start: cost_at(lines, start, order))[:2]


def rational_poles(frequency: FloatArray, response: ComplexArray, weight: FloatArray, n_modes: int) -> FloatArray:
    r"""Return the poles of a local rational fit to a frequency response.

    .. math:: \min \sum_k w_k \left| \frac{A(g_k) H_k - B(g_k)}{A_\mathrm{previous}(g_k)} \right|^2

    with ``A`` of degree ``n_modes`` and ``B`` one higher in the normalised frequency: the poles at negative frequency
    are far away (Sanathanan and Koerner [1]_).

    H is weighted by its inverse variance, up to a factor. Returned are natural frequency [Hz] and damping ratio [-] of
    the stable poles, by rising frequency, shape (n_stable, 2).

    References
    ----------
    .. [1] C. K. Sanathanan, J. Koerner, Transfer function synthesis as a ratio of two complex polynomials, IEEE Trans.
       Autom. Control 8 (1963) 56-58.
    """
    centre, half_width = 0.5 * (frequency[0] + frequency[-1]), 0.5 * (frequency[-1] - frequency[0])
    g = (frequency - centre) / half_width
    powers = g[:, None] ** np.arange(n_modes + 2)
    columns = np.hstack([response[:, None] * powers[:, :n_modes], -powers])
    root_weight = np.sqrt(weight)
    roots: ComplexArray = np.empty(0, dtype=np.complex128)
    for _ in range(_RATIONAL_ITERATIONS):
        a = np.linalg.lstsq(root_weight[:, None] * columns, -root_weight * response * g**n_modes)[0][:n_modes]
        roots = np.roots([1.0, *a[::-1]]).astype(np.complex128)
        root_weight = np.sqrt(weight) / np.abs(np.prod(g[:, None] - roots, axis=1))
    poles = centre + half_width * roots
    natural = np.abs(poles)
    damping = poles.imag / natural
    stable = (damping > _DAMPING_LIMITS[0]) & (damping < _DAMPING_LIMITS[1])
    kept = np.column_stack([natural[stable], damping[stable]])
    return kept[np.argsort(kept[:, 0])]


def _measured_response(lines: FitLines) -> tuple[FloatArray, ComplexArray, FloatArray]:
    """Return frequency, H1 and excitation power, to which the inverse variance of H1 is proportional."""
    x, y = lines.excitation / lines.weight, lines.response / lines.weight
    spectra = BandSpectra(lines.frequency, x, y, lines.n_samples, lines.sample_rate, lines.derivatives)
    cross = cross_spectra(spectra, taper=least_leaking_taper(spectra))
    power = np.maximum(cross.excitation_power, np.finfo(np.float64).tiny)
    return cross.frequency, cross.cross_power / power, power


_MAXIMUM_TONES = 2
_SCREENING_PROBABILITY = 0.01
#: The same where one mode was enough before: only what is no accident of one measurement among many.
_ENOUGH_BEFORE_PROBABILITY = 1e-5
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
    if one_mode is None or maximum_modes < 2 or not leaves_response(*one_mode):
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
        anew = lines.weighted(noise_weight(lines, more))
        more = minimise(anew, more.parameters, order)
        if more is None:  # what was found before stays good
            break
        lines, weighted = anew, more
    return None if weighted is None else (lines, weighted)


def rival_of(lines: FitLines, one_mode: Solution) -> Solution | None:
    """Return two modes where they explain the lines far better than the one that was chosen.

    Within a few lines of 0 Hz a second mode beside the first makes the windows unlike each other, which passes for
    overdispersion: there the choice may be wrong, and the rival tells by how much.
    """
    if one_mode.order.n_modes > 1:
        return None
    rival = _two_modes(lines, one_mode)
    return None if rival is None or rival.bic > one_mode.bic - _STRONG_EVIDENCE else rival


def leaves_response(lines: FitLines, one_mode: Solution, *, enough_before: bool = False) -> bool:
    r"""Tell whether a richer B at the same pole explains significantly more; cheap, nothing is searched.

    Twice the gain in likelihood is :math:`\chi^2` once it is divided by the overdispersion: what friction does to
    neighbouring lines alike would otherwise call for a second mode in every other measurement. ``enough_before``: of
    the same peak one mode was enough in the measurements of a calibration.
    """
    plain, background = _plain_and_background(one_mode)
    if degrees_of_freedom(lines, background) <= 0:
        return False
    cost, of_background = nested_costs(lines, one_mode.parameters, plain, background)
    n_more = 2 * (background.n_response_terms - plain.n_response_terms)
    gain = 2 * lines.response.size * math.log(cost / of_background)
    probability = _ENOUGH_BEFORE_PROBABILITY if enough_before else _SCREENING_PROBABILITY
    limit = float(scipy.special.chdtri(n_more, probability))
    return gain > limit and gain > limit * overdispersion(lines, one_mode.parameters, plain, background)


def stands_out(lines: FitLines, solution: Solution, mode: int) -> tuple[float, float]:
    r"""Return what a mode of a solution brings in twice the log likelihood, and what chance alone seldom brings.

    .. math:: N \ln \frac{\sum |R_{-i}|^2}{\sum |R|^2}

    with N real data, and the residual :math:`R_{-i}` without the pole, of as many terms of the response and of the
    windows, under the same noise. Noise has peaks, too, those of a scale the higher the frequency, and of few windows
    some are coherent by chance; a smooth response explains them nearly as well as a mode does. Chance: a
    :math:`\chi^2` of frequency, damping and the peak in the response and in each window, sought on all lines. What the
    windows ring counts, for of a hammer's hit that is all there is.
    """
    order, kept = solution.order, np.arange(solution.parameters.size) // 2 != mode
    without = replace(
        order,
        n_modes=order.n_modes - 1,
        response_modes=order.response_modes or order.n_modes,
        transient_modes=order.transient_modes or order.n_modes,
    )
    cost = cost_at(lines, solution.parameters[kept], without)
    gain = 2 * lines.response.size * math.log(cost / solution.projection.cost)
    n_chances = 2 + 2 * (lines.n_windows + 1)
    return gain, float(scipy.special.chdtri(n_chances, _FALSE_ALARM_PROBABILITY / lines.frequency.size))


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
    pairs = [
        minimise(lines, np.append(start, tones), ModelOrder(2, tones.size))
        for tones in ([one_mode.tones] if one_mode.order.n_tones == 0 else [one_mode.tones, one_mode.tones[:0]])
        for start in starts
    ]
    return min((solution for solution in pairs if solution is not None), key=lambda s: s.bic, default=None)
