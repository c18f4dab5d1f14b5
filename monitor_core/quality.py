"""Judge whether a window may be used, before it is averaged (ISO 13374: DM, first gate)."""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import SampleArray
from monitor_core.errors import OutsideValidityError
from monitor_core.recording import ExcitationQuantity, Rejection, RejectionReason, ResponseQuantity, Window

_RATE_TOLERANCE = 1e-6  # relative; clocks of acquisition systems are quoted to a few parts in 10⁶
_LEAST_SLOW_LENGTH = 4096  # below, even the slowest length costs less than the rest of the road


@dataclass(frozen=True, slots=True)
class QualityGate:
    """What a window must meet."""

    minimum_samples: int = 256
    sample_rate: float | None = None  # that of the axis; None accepts any [Hz]
    position_span_limit: float = 0.020  # travel within the window [m]
    minimum_band_excitation: float = 0.0  # rms of the excitation in the band [its unit]
    stuck_share: float = 0.1  # longest run of one value off the rest level, as a share of the window [-]
    slow_length_factor: float = 8.0  # reckoned cost of the FFT against that of the next shorter good length [-]


def gate_window(window: Window, gate: QualityGate, *, band: tuple[float, float] | None = None) -> Rejection | None:
    """Refuse a window that cannot be judged, with the first reason found; ``None`` where it may be averaged.

    In this order:

    - sampling rate other than that of the axis; too short;
    - a sample that is not a finite number, in any channel;
    - dead: a channel of one value throughout, or a scale or an encoder that moves by fewer than four of its steps,
      whose rounding is then no noise but part of the motion;
    - stuck: a channel holds one value, off its rest level, for a tenth of the window. A run at the rest level is
      silence before or after the move (a noise-free or coarsely quantised record holds exact zeros there), and a run
      at the largest or smallest excitation is a drive at its torque limit: both pass. A displacement, an angle or a
      speed has no rest level: it is stuck where it holds a value while the excitation goes on as elsewhere;
    - clipped: an acceleration, or a force, piles up at its extreme (see ``is_clipped``). A torque is not asked: the
      limit of the drive looks the same and is true; a scale ends nowhere;
    - travel within the window: the frequency moves with the position;
    - a length whose FFT costs several times that of a slightly shorter one;
    - too little excitation in the band.

    The band [Hz] is where the mode is looked for; without it the excitation is not judged. ``OutsideValidityError`` if
    it does not lie between 0 Hz and half the sampling rate.
    """
    return (
        _check_sampling(window, gate)
        or _check_channels(window, gate)
        or _check_travel(window, gate)
        or _check_length(window.n_samples, gate)
        or (None if band is None else _check_excitation(window, gate, band))
    )


def _check_sampling(window: Window, gate: QualityGate) -> Rejection | None:
    if gate.sample_rate is not None and not math.isclose(window.sample_rate, gate.sample_rate, rel_tol=_RATE_TOLERANCE):
        return Rejection(
            RejectionReason.SAMPLE_RATE_MISMATCH,
            f"sampling rate must be {gate.sample_rate:g} Hz; got {window.sample_rate:g} Hz",
        )
    if window.n_samples < gate.minimum_samples:
        return Rejection(
            RejectionReason.TOO_SHORT, f"at least {gate.minimum_samples} samples are needed; got {window.n_samples}"
        )
    return None


def _check_channels(window: Window, gate: QualityGate) -> Rejection | None:
    channels = {"excitation": window.excitation, "response": window.response}
    others = {"position": window.position_trace, "reference": window.reference}
    stated = {name: samples for name, samples in others.items() if samples is not None}
    for name, samples in (channels | stated).items():
        if not np.isfinite(samples).all():
            first = int(np.argmin(np.isfinite(samples)))
            return Rejection(RejectionReason.NOT_FINITE, f"{name} must be finite; got {samples[first]} at {first}")
    of_scale = window.response_quantity.derivatives > 0
    for name, samples in (channels | stated).items():
        if name != "position" and samples.min() == samples.max():
            return Rejection(RejectionReason.DEAD_CHANNEL, f"{name} must change; got {samples[0]:g} throughout")
    for name, samples in channels.items():
        held = _check_scale(window, gate) if of_scale and name == "response" else _check_stuck(name, samples, gate)
        if held is not None:
            return held
    clippable = [] if of_scale else ["response"]
    clippable += ["excitation"] if window.excitation_quantity is ExcitationQuantity.FORCE else []
    for name in clippable:
        for samples in (channels[name], -channels[name]):
            if is_clipped(samples):
                return Rejection(
                    RejectionReason.CLIPPED,
                    f"{name} must not reach the end of its range; it piles up at ±{abs(samples.max()):g}",
                )
    return None


def _check_stuck(name: str, samples: SampleArray, gate: QualityGate) -> Rejection | None:
    allowed = gate.stuck_share * samples.size
    if 1 + np.count_nonzero(samples[1:] == samples[:-1]) <= allowed:  # nearly always: no run is as long
        return None
    start, run = longest_run(samples)
    if run <= allowed or not is_stuck(samples, start, run, is_excitation=name == "excitation"):
        return None
    return Rejection(
        RejectionReason.STUCK_CHANNEL,
        f"{name} may hold a value off its rest level for {allowed:.0f} samples; held {samples[start]:g} for {run}",
    )


def _check_scale(window: Window, gate: QualityGate) -> Rejection | None:
    """Refuse a scale, an encoder or a speed that is at rest on one step or the next, or stuck."""
    quantity, step = window.response_quantity, resolution_of(window)
    moved = float(np.ptp(window.response))
    if moved < _FEWEST_STEPS * step:
        return Rejection(
            RejectionReason.DEAD_CHANNEL,
            f"{quantity} must move by {_FEWEST_STEPS:g} steps of {step:.3g} {quantity.unit} or more; got {moved:.3g} "
            f"{quantity.unit}, as of an axis at rest: excite it more, or move it slowly",
        )
    start, run = longest_run(window.response)
    allowed = gate.stuck_share * window.n_samples
    if run <= allowed or not _goes_on(window.excitation, start, run):
        return None
    return Rejection(
        RejectionReason.STUCK_CHANNEL,
        f"{quantity} may stand still for {allowed:.0f} samples while the excitation goes on; held "
        f"{window.response[start]:g} {quantity.unit} for {run}",
    )


#: A scale that moves by fewer steps rounds the motion itself, and what it makes of it is no noise.
_FEWEST_STEPS = 4.0


def resolution_of(window: Window) -> float:
    """Return the step that a response is quantised in, as stated or else the smallest that it makes [its unit]."""
    if window.response_resolution is not None:
        return window.response_resolution
    return float(np.diff(np.unique(window.response)).min())


#: An excitation within a run that has this share of what it has elsewhere goes on.
_GOES_ON = 0.5


def _goes_on(excitation: SampleArray, start: int, run: int) -> bool:
    """Tell whether the excitation changes from sample to sample within a run as it does elsewhere."""
    changes = np.diff(excitation.astype(np.float64)) ** 2
    within = changes[start : start + run - 1]
    elsewhere = np.concatenate([changes[:start], changes[start + run - 1 :]])
    return bool(elsewhere.size) and float(within.mean()) > _GOES_ON**2 * float(elsewhere.mean())


def longest_run(samples: SampleArray) -> tuple[int, int]:
    """Return start and length of the longest run of one value."""
    ends = np.flatnonzero(np.append(samples[1:] != samples[:-1], True))
    lengths = np.diff(ends, prepend=-1)
    longest = int(np.argmax(lengths))
    return int(ends[longest] - lengths[longest]) + 1, int(lengths[longest])


def is_stuck(samples: SampleArray, start: int, run: int, *, is_excitation: bool) -> bool:
    """Tell whether a long run is neither rest nor, for an excitation, a limit."""
    value, low, high = float(samples[start]), float(samples.min()), float(samples.max())
    others = np.concatenate([samples[:start], samples[start + run :]])
    # 5 % of the range: a rest level read from the other samples is no better than that while they ring.
    at_rest = abs(value - float(np.median(others))) <= 0.05 * (high - low)
    at_limit = is_excitation and value in (low, high)
    return not (at_rest or at_limit)


def is_clipped(samples: SampleArray) -> bool:
    """Tell whether samples pile up at their maximum.

    The maximum is held by at least three samples, and by more than the four levels below it together: a smooth peak,
    however coarsely quantised, has twice as many there. The maximum must lie off the rest level (a tenth of the range),
    and be reached either by three neighbours, or from different values each time: a noise-free periodic signal meets
    its maximum again and again, always from the same value.
    """
    top = samples.max()
    at_top = np.flatnonzero(samples == top)
    if at_top.size < 3 or float(top) - float(np.median(samples)) < 0.1 * float(top - samples.min()):
        return False
    levels = np.unique(samples)
    span = float(top - levels[0])
    quantum = max(float(np.diff(levels).min()), 1e-6 * span)
    n_next = np.count_nonzero(samples >= top - 4.5 * quantum) - at_top.size
    if at_top.size <= n_next:
        return False
    plateaus = np.split(at_top, np.flatnonzero(np.diff(at_top) > 1) + 1)
    if max(plateau.size for plateau in plateaus) >= 3:
        return True
    before = np.array([samples[max(plateau[0] - 1, 0)] for plateau in plateaus])
    return bool(np.ptp(before) > 1e-3 * span)


def _check_travel(window: Window, gate: QualityGate) -> Rejection | None:
    span = _span(window)
    if span <= gate.position_span_limit:
        return None
    return Rejection(
        RejectionReason.POSITION_SPAN_TOO_WIDE,
        f"travel within the window must not exceed {gate.position_span_limit * 1e3:g} mm; got {span * 1e3:.1f} mm",
    )


def _check_length(n_samples: int, gate: QualityGate) -> Rejection | None:
    if n_samples < _LEAST_SLOW_LENGTH:
        return None
    good = scipy.fft.prev_fast_len(n_samples, real=True)
    if _fft_cost(n_samples) / _fft_cost(good) <= gate.slow_length_factor:
        return None
    return Rejection(
        RejectionReason.SLOW_LENGTH,
        f"{n_samples} samples make the FFT several times as slow as {good} would; record {good} samples",
    )


def _fft_cost(n_samples: int) -> float:
    """Return the cost of a real FFT in the library's own reckoning (pocketfft): n times the sum of prime factors.

    Large primes go through a convolution of twice the length; its cost is what bounds the sum. Beside the clock the
    reckoning exaggerates: 20 481 samples against 20 480 are 15 here and were measured at 10 to 14, 20 002 are 7.8 and
    were measured at 3.0, so 8 here stands for a good 3.
    """

    def direct(n: int) -> float:
        total, rest, factor = 0.0, n, 2
        while factor * factor <= rest:
            while rest % factor == 0:
                total += factor if factor <= 5 else 1.1 * factor
                rest //= factor
            factor += 1
        if rest > 1:
            total += rest if rest <= 5 else 1.1 * rest
        return total * n

    convolution = 3.0 * direct(scipy.fft.next_fast_len(2 * n_samples - 1))
    return min(0.5 * direct(n_samples), convolution)


def _check_excitation(window: Window, gate: QualityGate, band: tuple[float, float]) -> Rejection | None:
    excitation = _band_rms(window.excitation, window.sample_rate, band)
    if excitation >= gate.minimum_band_excitation:
        return None
    return Rejection(
        RejectionReason.LITTLE_EXCITATION,
        f"rms excitation in the band must reach {gate.minimum_band_excitation:g} {window.excitation_quantity.unit}; "
        f"got {excitation:.3g} {window.excitation_quantity.unit}",
    )


def _band_rms(samples: SampleArray, sample_rate: float, band: tuple[float, float]) -> float:
    """Return the rms of what lies in a band, by Parseval's theorem."""
    if not 0.0 < band[0] < band[1] < 0.5 * sample_rate:
        raise OutsideValidityError(
            f"band must lie between 0 Hz and half the sampling rate, {0.5 * sample_rate:g} Hz; "
            f"got {band[0]:g} to {band[1]:g} Hz"
        )
    resolution = sample_rate / samples.size
    lines = slice(math.ceil(band[0] / resolution), math.floor(band[1] / resolution) + 1)
    spectrum = scipy.fft.rfft(samples)[lines]
    return math.sqrt(2.0 * float(np.vdot(spectrum, spectrum).real)) / samples.size


def _span(window: Window) -> float:
    if window.position_trace is not None:
        return float(np.ptp(window.position_trace))
    of_scale = window.response_quantity is ResponseQuantity.DISPLACEMENT
    return max(window.position_span, float(np.ptp(window.response)) if of_scale else 0.0)
