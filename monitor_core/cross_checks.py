r"""Compare what windows state twice: each pair is a row with what is stated, what is seen, and what follows.

**Trace and acceleration.** The acceleration a is the second derivative of the position x. With a smooth \(\varphi\)
that vanishes with its slope at both ends of a window, integration by parts leaves no boundary terms,

.. math:: \int \varphi\,a\,dt = \int \ddot\varphi\,x\,dt, \qquad
    \varphi = \tfrac14\,(1 - \cos 2\pi t/T)^2\, e^{-j\omega t}

(the weak form: Messenger & Bortz, Multiscale Model. Simul. 19 (2021) 1474), so that nothing drifts as an acceleration
does that is integrated twice. Over some frequencies well below the mode, where the table follows the screw, one
regression gives scale and lag of the trace.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray, SampleArray
from monitor_core.recording import (
    Doubt,
    DoubtReason,
    ExcitationQuantity,
    Rejection,
    RejectionReason,
    ResponseQuantity,
    Window,
)

#: What two numbers in different units differ by, and the unit that one of them is in instead.
_UNITS = (
    (1e6, "10⁶, as of µm for m"),
    (1e3, "1000, as of mm for m, g for kg, or kHz for Hz"),
    (9.80665, "9.81, as of g for m/s², or kgf for N"),
    (2.0 * math.pi, "2π, as of turns for radians, or rad/s for Hz"),
    (60.0, "60, as of minutes for seconds, or 1/min for Hz"),
    (180.0 / math.pi, "57.3, as of degrees for radians"),
)
#: Two numbers of one quantity that were read apart agree to this, relative; 57.3 and 60 are 4.6 % apart [-].
_SAME = 0.02


def looks_like_unit(ratio: float, uncertainty: float = 0.0) -> str | None:
    """Return the unit that two numbers of one quantity look like having been mixed up, or ``None``.

    Their ratio with its relative standard uncertainty; a factor or its reciprocal is found, of either sign.

    Examples
    --------
    >>> looks_like_unit(0.001003)
    'a factor of 1000, as of mm for m, g for kg, or kHz for Hz'
    >>> looks_like_unit(1.4)

    """
    if not (math.isfinite(ratio) and ratio != 0.0):
        return None
    off, unit = min((abs(abs(math.log(abs(ratio))) - math.log(factor)), unit) for factor, unit in _UNITS)
    return f"a factor of {unit}" if off < _SAME + 2.0 * uncertainty else None


#: A step by more than this share of all that is covered is no motion of one sample …
_JUMP = 0.6
#: … where steps are usually below this share of it, and none but the jumps is larger than that: noise has steps of
#: every size.
_USUAL_STEP, _LARGEST_STEP = 0.1, 0.3
#: So many steps on either side of a jump show which way it went: straight, and as fast before as behind.
_N_AROUND, _STRAIGHT, _AS_FAST = 16, 0.75, 0.25


@np.errstate(invalid="ignore")
def wraps_in(steps: FloatArray, covered: float) -> BoolArray:
    """Tell which steps are jumps of nearly all that is covered, against the motion before and behind them."""
    size = np.abs(steps)
    jumps: BoolArray = size > _JUMP * covered
    if not covered > 0.0 or not jumps.any() or not np.nanmedian(size) < _USUAL_STEP * covered:
        return np.zeros_like(jumps)
    slow = np.where(jumps | ~np.isfinite(steps), 0.0, steps)
    if np.max(np.abs(slow)) > _LARGEST_STEP * covered:
        return np.zeros_like(jumps)
    along, way = (np.concatenate(([0.0], np.cumsum(of))) for of in (slow, np.abs(slow)))
    at = np.flatnonzero(jumps)
    first, last = np.maximum(at - _N_AROUND, 0), np.minimum(at + 1 + _N_AROUND, along.size - 1)
    before, behind = along[at] - along[first], along[last] - along[at + 1]
    is_straight = (np.abs(before) >= _STRAIGHT * (way[at] - way[first])) & (
        np.abs(behind) >= _STRAIGHT * (way[last] - way[at + 1])
    )
    slower, faster = np.minimum(np.abs(before), np.abs(behind)), np.maximum(np.abs(before), np.abs(behind))
    against = (before * steps[at] < 0.0) & (behind * steps[at] < 0.0) & is_straight & (slower > _AS_FAST * faster)
    jumps[at[~against]] = False
    return jumps


def refuse_wraps(window: Window) -> Rejection | None:
    """Refuse a position or angle that begins anew within a window, as a count of one lead, a turn or 16 bits does."""
    for name, trace, scale, unit in (
        ("position trace", window.position_trace, 1e3, "mm"),
        (str(window.response_quantity), window.response, 1.0, window.response_quantity.unit),
    ):
        if trace is window.response and window.response_quantity.derivatives < 2:
            continue
        if trace is not None and (refusal := _refuse_wrap(name, trace, scale, unit)) is not None:
            return refusal
    return None


def _refuse_wrap(name: str, trace: SampleArray, scale: float, unit: str) -> Rejection | None:
    if trace.size < 3:
        return None
    steps: FloatArray = np.diff(trace).astype(np.float64)
    covered = float(trace.max() - trace.min())
    if not max(float(steps.max()), -float(steps.min())) > _JUMP * covered:  # nearly always
        return None
    jumps = wraps_in(steps, covered)
    if not jumps.any():
        return None
    first = int(np.argmax(jumps))
    return Rejection(
        RejectionReason.POSITION_WRAPS,
        f"expected a {name} that does not begin anew; it jumps by {scale * steps[first]:.6g} {unit} behind sample "
        f"{first}, against the way it goes, as a count that wraps: unwrap it before it is sent, as numpy.unwrap "
        "does with its period; of a raw file, wraps_at in the map does",
    )


@dataclass(frozen=True, slots=True)
class StatedTwice:
    """A quantity that is stated in two ways, in one unit."""

    doubt: DoubtReason  # what a contradiction is called
    quantity: str  # what is stated, and what it is compared with
    stated: float
    seen: float
    tolerance: float  # a larger difference is a contradiction
    unit: str
    consequence: str  # what is done where they contradict
    leaves_trace: bool = False  # where they contradict
    takes_seen: bool = False  # in place of what is stated, where they contradict

    @property
    def contradiction(self) -> Doubt | None:
        """The doubt in one sentence; ``None`` where the two agree."""
        if abs(self.stated - self.seen) <= self.tolerance:
            return None
        looks_like = looks_like_unit(self.stated / self.seen) if self.unit and self.seen else None
        unit = f" {self.unit}" if self.unit else ""
        within = f" to within {self.tolerance:.2g}{unit}" if self.tolerance else ""
        return Doubt(
            self.doubt,
            f"expected {self.quantity}, {self.seen:.4g}{unit}{within}; got {self.stated:.4g}{unit}"
            f"{'' if looks_like is None else f', which looks like {looks_like}'}: {self.consequence}",
        )


@dataclass(frozen=True, slots=True, eq=False)
class CrossChecked:
    """The windows of a measurement as they are believed, and what in them contradicts itself."""

    windows: tuple[Window, ...]
    doubts: tuple[Doubt, ...] = ()
    #: 1 where a positive torque accelerates along the position trace, -1 where against it; None: not seen
    trace_polarity: int | None = None


#: A position tag is rounded, and read off another scale than the trace [m]. It may mean any place of the travel.
_TAG_TOLERANCE = 0.003
#: Longer than any lead [m]: a trace that stays below counts within a turn, for no nut comes so near a bearing.
_ONE_TURN = 0.040
_LONGEST_AXIS = 50.0  # [m]


def cross_checked(windows: Sequence[Window], below: float, trace_polarity: int | None = None) -> CrossChecked:
    """Compare what the windows of one measurement state twice; where they contradict themselves, say what is believed.

    A trace that the acceleration contradicts, below a frequency from which on the mode bends the axis [Hz], is left
    out: the position is the tag then, and there is no friction torque. So is one that the torque drives the other way
    than it did at the calibration, whose polarity is given. Of one that both bear out, the mean is the position of a
    window whose tag is off it: it is measured where a tag is typed.
    """
    motion = _motion(windows, below)
    rows = [_duration(windows)]
    if motion is not None:
        rows += [*motion.rows, _reversal(motion.trace_polarity, trace_polarity)]
    is_left_out = any(row.contradiction for row in rows if row is not None and row.leaves_trace)
    if is_left_out:
        windows = [replace(window, position_trace=None) for window in windows]
    of_tag: dict[float, list[Window]] = {}
    for window in windows:
        of_tag.setdefault(window.conditions.position, []).append(window)
    places = {tag: _position(tag, alike) for tag, alike in of_tag.items()}
    believed = tuple(_placed(window, places[window.conditions.position]) for window in windows)
    doubts: dict[DoubtReason, Doubt] = {}
    for row in (*rows, *places.values()):
        if row is not None and (found := row.contradiction) is not None:
            doubts.setdefault(found.reason, found)
    polarity = None if motion is None or is_left_out else motion.trace_polarity
    return CrossChecked(believed, tuple(doubts.values()), polarity)


def _position(tag: float, windows: Sequence[Window]) -> StatedTwice | None:
    """Compare a position tag with the traces of its windows; one that passes through zero is no position from zero.

    The place is the mean of the traces. Where a stroke rests at one of its ends the mode is seen at both: what the mean
    differs by from that over the energy of the acceleration is left open.
    """
    known = [
        (window.position_trace, window.response)
        for window in windows
        if window.position_trace is not None and not window.position_trace.min() <= 0.0 <= window.position_trace.max()
    ]
    if not known:
        return None
    mean, tolerance = float(np.mean([trace.mean() for trace, _ in known])), _TAG_TOLERANCE
    if abs(tag - mean) > tolerance:  # hardly ever
        energy = [(response - response.mean(dtype=np.float64)) ** 2 for _, response in known]
        moment = sum(float(e @ (trace - mean)) for e, (trace, _) in zip(energy, known, strict=True))
        tolerance += abs(moment) / max(sum(float(e.sum()) for e in energy), 1e-300)
    is_place = _ONE_TURN < mean < _LONGEST_AXIS
    return StatedTwice(
        DoubtReason.POSITION_CONTRADICTS_TRACE,
        "the position tag at the mean of the position trace",
        1e3 * tag,
        1e3 * mean,
        1e3 * tolerance,
        "mm",
        "the trace is taken for the position"
        if is_place
        else "no nut is there, the trace may count within one turn of the screw: the tag is taken for the position",
        takes_seen=is_place,
    )


def _placed(window: Window, place: StatedTwice | None) -> Window:
    """Return a window at the place that its trace shows, where that contradicts its tag."""
    if place is None or not place.takes_seen or place.contradiction is None:
        return window
    return replace(window, conditions=replace(window.conditions, position=1e-3 * place.seen))


#: Starts are stated to a second by some, and windows that follow each other are late by as much as a clock is set [s].
_CLOCK, _CLOCK_SHARE = 1.0, 0.05


def _duration(windows: Sequence[Window]) -> StatedTwice | None:
    """Compare what windows last by their sampling rate with the times between their starts."""
    ordered = sorted(windows, key=lambda window: window.started_at)
    lasting = sum(window.n_samples / window.sample_rate for window in ordered[:-1])
    between = (ordered[-1].started_at - ordered[0].started_at).total_seconds()
    tolerance = _CLOCK + _CLOCK_SHARE * between
    if lasting <= between + tolerance or any(map(_go_on, ordered, ordered[1:])):
        return None
    return StatedTwice(
        DoubtReason.RATE_CONTRADICTS_TIMES,
        "windows that last by their sampling rate no longer than from the first start to the last",
        lasting,
        between,
        tolerance,
        "s",
        "the sampling rate is taken as stated, and every frequency with it",
    )


def _go_on(window: Window, after: Window) -> bool:
    """Tell whether a window repeats the samples of the one before from its start on, as overlapping windows do."""
    start = round((after.started_at - window.started_at).total_seconds() * window.sample_rate)
    part = slice(start, start + 16)  # of both channels: a scale at rest is like itself
    pairs = ((window.response, after.response), (window.excitation, after.excitation))
    return bool(window.response[part].size) and all(
        np.array_equal(first[part], second[: first[part].size]) for first, second in pairs
    )


@dataclass(frozen=True, slots=True, eq=False)
class _TestFunctions:
    """Functions that windows are multiplied by, of one length and sampling rate."""

    omega: FloatArray  # shape (n,) [rad/s]
    plain: ComplexArray  # shape (n_samples, n) [s]
    second_derivative: ComplexArray  # shape (n_samples, n) [1/s]
    lags: FloatArray  # that are tried [s]
    turns: ComplexArray  # shape (n, n_lags)


#: Lowest frequency: accelerometers know no lower ones, and a window must hold some periods of it [Hz].
_LOWEST, _FEWEST_PERIODS, _N_LINES = 8.0, 4.0, 8
#: Of the frequency from which on the mode is looked for: there the table moves by a twentieth more than the screw.
_BELOW_MODE = 0.2


@lru_cache(maxsize=16)
def _test_functions(n_samples: int, sample_rate: float, below: float) -> _TestFunctions | None:
    duration = n_samples / sample_rate
    low, high = max(_LOWEST, _FEWEST_PERIODS / duration), _BELOW_MODE * below
    if high < 1.5 * low:
        return None
    omega = 2.0 * np.pi * np.linspace(low, high, _N_LINES)
    time = (np.arange(n_samples) + 0.5) / sample_rate
    u = 2.0 * np.pi / duration
    cos, sin = np.cos(u * time)[:, None], np.sin(u * time)[:, None]
    taper, slope, curvature = 0.25 * (1 - cos) ** 2, 0.5 * u * (1 - cos) * sin, 0.5 * u**2 * (sin**2 + (1 - cos) * cos)
    wave = np.exp(-1j * omega * time[:, None])
    second = (curvature - 2j * omega * slope - omega**2 * taper) * wave
    lags: FloatArray = 2.5e-4 * np.arange(-400.0, 601.0, dtype=np.float64)
    return _TestFunctions(
        omega, taper * wave / sample_rate, second / sample_rate, lags, np.exp(-1j * np.outer(omega, lags))
    )


#: Motion that the acceleration must show between the frequencies of the test functions before a trace is judged [m].
_LEAST_MOTION = 2e-5
#: A trace that goes with the acceleration less than this follows another motion, where the torque does as much.
_FOLLOWS, _TORQUE_FOLLOWS = 0.9, 0.8
#: Gains of accelerometers, and what bends between screw and table, leave so much of the scale open [-].
_SCALE_TOLERANCE = 0.25
#: An accelerometer leads by as much at low frequencies; with three standard uncertainties of the lag besides [s].
_LAG_TOLERANCE = 0.0015


#: Responses that a position trace is compared with.
_COMPARED = (ResponseQuantity.ACCELERATION, ResponseQuantity.DISPLACEMENT)


@dataclass(frozen=True, slots=True)
class _Motion:
    """What the motion of position traces states twice."""

    rows: tuple[StatedTwice, ...]
    trace_polarity: int | None  # as of :class:`CrossChecked`


def _motion(windows: Sequence[Window], below: float) -> _Motion | None:
    """Compare the motion of the position traces of one measurement with that of its acceleration."""
    first = windows[0]
    derivatives = first.response_quantity.derivatives
    is_torque = first.excitation_quantity is ExcitationQuantity.TORQUE
    if first.response_quantity not in _COMPARED or not is_torque or any(w.position_trace is None for w in windows):
        return None
    if len({(w.n_samples, w.sample_rate) for w in windows}) > 1:
        return None
    functions = _test_functions(first.n_samples, first.sample_rate, below)
    if functions is None:
        return None
    traces = np.array([w.position_trace for w in windows], dtype=np.float64)
    moved = _tested(traces - traces.mean(axis=1, keepdims=True), functions.second_derivative)
    responses = np.array([w.response for w in windows], dtype=np.float64)
    if derivatives:
        responses -= responses.mean(axis=1, keepdims=True)
    accelerated = _tested(responses, functions.second_derivative if derivatives else functions.plain)
    driven = np.array([w.excitation for w in windows], dtype=np.float64)
    torque, duration = _tested(driven, functions.plain), first.n_samples / first.sample_rate
    return _compared(moved, accelerated, torque, functions=functions, duration=duration)


def _tested(samples: FloatArray, functions: ComplexArray) -> ComplexArray:
    """Return the sums of windows times functions, shape (n_windows, n): real and imaginary parts as columns."""
    return (samples @ functions.view(np.float64)).view(np.complex128)


def _compared(
    moved: ComplexArray,
    accelerated: ComplexArray,
    driven: ComplexArray,
    *,
    functions: _TestFunctions,
    duration: float,
) -> _Motion | None:
    """Return the rows of scale and lag, of motions and torques by test functions, shape (n_windows, n).

    The sign of one measurement says nothing: torque and acceleration count either way along an axis.
    """
    to_motion = math.sqrt(2.0 / len(moved)) / (0.375 * duration)  # 3/8: mean of the taper
    of_trace, of_acceleration = (
        to_motion * float(np.linalg.norm(each / functions.omega**2)) for each in (moved, accelerated)
    )
    if of_acceleration < _LEAST_MOTION:
        return None
    power = float(np.linalg.norm(moved)) * float(np.linalg.norm(accelerated))
    evidence = ((moved.conj() * accelerated).sum(axis=0) @ functions.turns).real
    best = int(np.argmax(np.abs(evidence)))
    correlation = float(evidence[best]) / power if power > 0.0 else 0.0
    by_torque = float(np.vdot(driven, accelerated).real)
    by_torque /= float(np.linalg.norm(driven)) * float(np.linalg.norm(accelerated)) or 1.0
    if abs(correlation) < _FOLLOWS and abs(by_torque) < _TORQUE_FOLLOWS:
        return None  # the acceleration is mostly noise here
    row = _of_trace("the motion of the position trace as the acceleration integrated twice has it")
    rows = [row(1e3 * of_trace, 1e3 * of_acceleration, 1e3 * _SCALE_TOLERANCE * of_acceleration, "mm")]
    row = _of_trace("the position trace to go with the acceleration, correlation")
    rows.append(row(abs(correlation), 1.0, 1.0 - _FOLLOWS, ""))
    if abs(correlation) >= _FOLLOWS:
        spread = math.sqrt((1.0 - min(correlation**2, 1.0)) / moved.size) / correlation**2
        lag_uncertainty = spread / float(np.sqrt(np.mean(functions.omega**2)))
        row = _of_trace("the lag of the position trace behind the acceleration", " until it is shifted by as much")
        rows.append(row(1e3 * float(functions.lags[best]), 0.0, 1e3 * (_LAG_TOLERANCE + 3.0 * lag_uncertainty), "ms"))
    is_seen = abs(correlation) >= _FOLLOWS and abs(by_torque) >= _TORQUE_FOLLOWS
    return _Motion(tuple(rows), int(math.copysign(1.0, correlation * by_torque)) if is_seen else None)


def _reversal(seen: int | None, calibrated: int | None) -> StatedTwice | None:
    """Compare which way the torque drives the trace with the way that it did at the calibration."""
    if seen is None or calibrated is None:
        return None
    row = _of_trace("the torque to drive the position trace as at the calibration, sign")
    return row(float(seen), float(calibrated), 0.0, "")


def _of_trace(quantity: str, until: str = "") -> Callable[[float, float, float, str], StatedTwice]:
    consequence = f"the trace is left out{until}, the tag is taken for the position, and friction is not known"
    return lambda stated, seen, tolerance, unit: StatedTwice(
        DoubtReason.TRACE_CONTRADICTS_MOTION, quantity, stated, seen, tolerance, unit, consequence, leaves_trace=True
    )
