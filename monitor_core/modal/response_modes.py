r"""Find the modes of frequency responses that are given as they are, without the windows they were averaged from.

Responses of one axis under the same conditions share their poles. Each is a sum of modes with a low and a high
remainder, fitted to the lines of a band:

.. math:: H(f) = \sum_i \frac{R_i f_i^2}{f_i^2 - f^2 + 2 j \zeta_i f_i f} + c_0 + \frac{c_1}{f^2}

of a displacement; an acceleration is :math:`f^2` times that, up to its sign (Ewins, Modal Testing, 2nd ed., 2000,
section 4.4: lower and upper residual). All but the poles is linear and is projected out.

What a sum of modes leaves of a real structure is mostly no noise: each line counts with its stated deviation and 1 % of
the highest one, and the uncertainties are those of the residuals, with their correlation from line to line.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.recording import Rejection, RejectionReason
from monitor_core.uncertainty import Estimate

#: Of the logarithm of the magnitude: 0.9 dB, and so many deviations of a line.
_LEAST_PROMINENCE, _RIPPLE = 0.1, 8.0
#: Width of a peak at half its prominence, in lines: fewer are no resonance that a fit could find.
_LEAST_LINES = 3
#: Of the highest peak.
_LEAST_PEAK = 0.02
_MODEL_ERROR = 0.01
_MOST_MODES = 8
#: How many of the least prominent peaks may give way to a mode that shows no peak.
_PEAKS_SPARED = 2
_DAMPING = (1e-5, 0.3)
_START_DAMPING = 0.02
_BAND_MARGIN = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class GivenResponse:
    """A frequency response with the noise of its lines, as measured."""

    frequency: FloatArray  # rising [Hz]
    response: ComplexArray
    standard_deviation: FloatArray  # of real and of imaginary part, in the unit of the response
    is_acceleration: bool


@dataclass(frozen=True, slots=True)
class ResponseMode:
    """A mode that responses share."""

    frequency: Estimate  # [Hz]
    damping_ratio: Estimate  # [-]


@dataclass(frozen=True, slots=True, eq=False)
class ResponseModes:
    """Modes by rising frequency, and how well they meet the responses."""

    modes: tuple[ResponseMode, ...]
    unexplained: float  # rms of what is left, as a share of the rms of the responses [-]
    band: tuple[float, float]  # of the lines [Hz]


def modes_of_responses(
    responses: Sequence[GivenResponse], *, band: tuple[float, float] | None = None, n_modes: int | None = None
) -> ResponseModes | Rejection:
    """Fit modes to responses that share their poles: one for each peak, or as many as are asked for.

    Parameters
    ----------
    responses : sequence of GivenResponse
        Of one axis under the same conditions, at least one.
    band : tuple of float, optional
        Lines to take; without it from below the lowest peak to above the highest. [Hz]
    n_modes : int, optional
        How many modes; without it one for each peak. More explain shoulders, which show no peak.

    Returns
    -------
    ResponseModes or Rejection
        ``NO_PEAK_IN_BAND`` if no line stands out.

    Raises
    ------
    OutsideValidityError
        If there is no response, or fewer than eight lines are in the band.
    """
    if not responses:
        raise OutsideValidityError("modes need at least one response; got none")
    low, high = band or (0.0, math.inf)
    taken = [_within(response, low, high) for response in responses]
    peaks = _peaks(taken)
    if not peaks:
        frequency = taken[0].frequency
        return Rejection(
            RejectionReason.NO_PEAK_IN_BAND, f"no peak stands out from {frequency[0]:g} to {frequency[-1]:g} Hz"
        )
    if band is None:
        low, high = _BAND_MARGIN * min(peaks), max(peaks) / _BAND_MARGIN
        taken = [_within(response, low, high) for response in taken]
    lines = [_Lines.of(response) for response in taken]
    solution = _fitted(lines, peaks[:n_modes], n_modes)
    if solution is None:
        return Rejection(RejectionReason.FIT_FAILED, f"no modes fit the {len(peaks)} peaks of the response")
    ends = (float(min(r.frequency[0] for r in taken)), float(max(r.frequency[-1] for r in taken)))
    return ResponseModes(_modes(lines, solution), _unexplained(lines, solution), ends)


def _within(response: GivenResponse, low: float, high: float) -> GivenResponse:
    inside = (response.frequency >= low) & (response.frequency <= high) & (response.frequency > 0.0)
    if inside.sum() < 8:
        raise OutsideValidityError(f"a fit needs at least 8 lines from {low:g} to {high:g} Hz; got {inside.sum()}")
    return GivenResponse(
        response.frequency[inside],
        response.response[inside],
        response.standard_deviation[inside],
        response.is_acceleration,
    )


def _peaks(responses: Sequence[GivenResponse]) -> list[float]:
    """Return the frequencies of the peaks of all responses together, those that stand out most first [Hz]."""
    frequency = responses[0].frequency
    shares, noise = np.zeros(frequency.size), np.zeros(frequency.size)
    for response in responses:
        magnitude = np.abs(response.response)
        level = float(np.median(magnitude)) or 1.0
        shares += np.interp(frequency, response.frequency, magnitude / level) ** 2
        noise += np.interp(frequency, response.frequency, response.standard_deviation / level) ** 2
    together = np.maximum(np.sqrt(shares), np.finfo(np.float64).tiny)
    lines, properties = scipy.signal.find_peaks(np.log(together), prominence=_LEAST_PROMINENCE, width=_LEAST_LINES)
    prominences = properties["prominences"]
    highest = float(together[lines].max(initial=0.0))
    peaks = [
        (float(prominence), float(frequency[line]))
        for line, prominence in zip(lines, prominences, strict=True)
        if prominence > _RIPPLE * math.sqrt(noise[line]) / together[line] and together[line] > _LEAST_PEAK * highest
    ]
    return [peak for _, peak in sorted(peaks, reverse=True)][:_MOST_MODES]


@dataclass(frozen=True, slots=True, eq=False)
class _Lines:
    """Whitened lines of one response."""

    frequency: FloatArray
    whitened: ComplexArray
    weight: FloatArray
    is_acceleration: bool

    @classmethod
    def of(cls, response: GivenResponse) -> "_Lines":
        floor = _MODEL_ERROR * float(np.abs(response.response).max())
        weight = 1.0 / np.hypot(response.standard_deviation, floor)
        return cls(response.frequency, response.response * weight, weight, response.is_acceleration)

    def residual(self, parameters: FloatArray) -> ComplexArray:
        f = self.frequency
        shapes = [
            natural**2 / (natural**2 - f**2 + 2j * math.exp(log_damping) * natural * f)
            for natural, log_damping in parameters.reshape(-1, 2)
        ]
        middle = f[f.size // 2]
        shapes += [np.ones_like(f, dtype=np.complex128), (middle / f).astype(np.complex128) ** 2]
        scale = self.weight * (f / middle) ** 2 if self.is_acceleration else self.weight
        basis = np.column_stack(shapes) * scale[:, None]
        coefficients = np.linalg.lstsq(basis, self.whitened, rcond=None)[0]
        left: ComplexArray = basis @ coefficients - self.whitened
        return left


def _residuals(parameters: FloatArray, lines: Sequence[_Lines]) -> FloatArray:
    left = np.concatenate([response.residual(parameters) for response in lines])
    return np.concatenate([left.real, left.imag])


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    parameters: FloatArray  # natural frequency [Hz] and logarithm of the damping ratio of each mode
    cost: float
    jacobian: FloatArray


def _fitted(lines: Sequence[_Lines], peaks: Sequence[float], n_modes: int | None) -> _Solution | None:
    """Fit a mode to each peak; where their number is stated, also fewer peaks and modes where most is left."""
    if n_modes is None:
        return _of_peaks(lines, peaks)
    fits = []
    for n_peaks in range(len(peaks), max(len(peaks) - _PEAKS_SPARED, 1) - 1, -1):
        best = _of_peaks(lines, peaks[:n_peaks])
        while best is not None and best.parameters.size // 2 < n_modes:
            best = _with_one_more(lines, best)
        if best is not None:
            fits.append(best)
    return min(fits, key=lambda solution: solution.cost, default=None)


def _of_peaks(lines: Sequence[_Lines], peaks: Sequence[float]) -> _Solution | None:
    """Fit a mode to each peak; a peak that no mode fits goes, the least prominent first."""
    for n_peaks in range(len(peaks), 0, -1):
        damping = np.full(n_peaks, math.log(_START_DAMPING))
        minimum = _minimised(lines, np.column_stack([peaks[:n_peaks], damping]).ravel())
        if minimum is not None:
            return minimum
    return None


def _with_one_more(lines: Sequence[_Lines], best: _Solution) -> _Solution | None:
    """Add the mode that leaves least, from starts where much is left."""
    frequency = np.concatenate([response.frequency for response in lines])
    left = np.abs(np.concatenate([response.residual(best.parameters) for response in lines])) ** 2
    edges = np.quantile(frequency, np.linspace(0.0, 1.0, 13))
    places = [
        float(frequency[inside][np.argmax(left[inside])])
        for low, high in pairwise(edges)
        if (inside := (frequency >= low) & (frequency <= high)).any()
    ]
    places.sort(key=lambda place: -float(left[np.argmin(np.abs(frequency - place))]))
    richer = [_minimised(lines, np.append(best.parameters, [place, math.log(_START_DAMPING)])) for place in places[:3]]
    return min((solution for solution in richer if solution is not None), key=lambda s: s.cost, default=None)


def _minimised(lines: Sequence[_Lines], start: FloatArray) -> _Solution | None:
    low, high = float(min(r.frequency[0] for r in lines)), float(max(r.frequency[-1] for r in lines))
    n_modes = start.size // 2
    lower, upper = np.tile([low, math.log(_DAMPING[0])], n_modes), np.tile([high, math.log(_DAMPING[1])], n_modes)
    begin = np.clip(start, lower + 1e-9, upper - 1e-9)
    scale = np.column_stack([0.02 * begin[::2], np.full(n_modes, 0.3)]).ravel()
    try:
        result = scipy.optimize.least_squares(
            _residuals, begin, args=(lines,), bounds=(lower, upper), x_scale=scale, max_nfev=60
        )
    except np.linalg.LinAlgError:
        return None
    parameters: FloatArray = result.x
    on_bound: BoolArray = np.isclose(parameters[::2], low, rtol=1e-6) | np.isclose(parameters[::2], high, rtol=1e-6)
    if on_bound.any() or np.any(np.isclose(parameters[1::2], upper[1::2])):
        return None  # a mode that fled to the end of the band is none of it
    return _Solution(parameters, float(2.0 * result.cost), np.asarray(result.jac, dtype=np.float64))


def _unexplained(lines: Sequence[_Lines], solution: _Solution) -> float:
    power = sum(float(np.sum(np.abs(response.whitened) ** 2)) for response in lines)
    return math.sqrt(solution.cost / power)


def _modes(lines: Sequence[_Lines], solution: _Solution) -> tuple[ResponseMode, ...]:
    n_data = 2 * sum(response.frequency.size for response in lines)
    freedom = max(n_data - solution.parameters.size - 2 * len(lines) * (solution.parameters.size // 2 + 2), 1)
    spread = solution.cost / freedom * _correlated_lines(lines, solution)
    covariance = np.linalg.pinv(solution.jacobian.T @ solution.jacobian) * spread
    modes = []
    for i, (natural, log_damping) in enumerate(solution.parameters.reshape(-1, 2)):
        deviation = np.sqrt(np.diag(covariance)[2 * i : 2 * i + 2])
        damping = math.exp(log_damping)
        modes.append(
            ResponseMode(
                Estimate(float(natural), float(deviation[0]), float(freedom)),
                Estimate(damping, damping * float(deviation[1]), float(freedom)),
            )
        )
    return tuple(sorted(modes, key=lambda mode: mode.frequency.value))


def _correlated_lines(lines: Sequence[_Lines], solution: _Solution) -> float:
    """Return over how many lines residuals are alike, from the correlation of neighbours: (1 + ρ)/(1 − ρ)."""
    above, all_of_it = 0.0, 0.0
    for response in lines:
        left = response.residual(solution.parameters)
        above += float(np.sum((left[1:] * left[:-1].conj()).real))
        all_of_it += float(np.sum(np.abs(left) ** 2))
    correlation = min(max(above / all_of_it if all_of_it > 0.0 else 0.0, 0.0), 0.999)
    return (1.0 + correlation) / (1.0 - correlation)
