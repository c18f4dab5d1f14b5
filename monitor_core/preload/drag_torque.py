r"""Estimate the friction of the running axis: the second indicator of preload, independent of any natural frequency.

One friction of a measurement, from whatever its windows hold: the work of all their moves where they tell it, which is
nearly always, else the drag torque of what little they travel at constant velocity. The work of large accelerations
needs torque and position at one time: δ apart they add :math:`\delta \sum T \dot v / \sum |v|`, which is as large as
a small friction after a third of a millisecond. Where the drag torque is known it tells.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from monitor_core.arrays import FloatArray, SampleArray
from monitor_core.recording import ExcitationQuantity, Rejection, RejectionReason, Window
from monitor_core.uncertainty import Estimate, plus_minus

#: Span over which the position is differentiated [s]: short against a ramp of 30 ms, long against encoder steps.
_VELOCITY_SPAN = 0.005
#: The table travels while it is faster than this part of its highest speed ...
_MOVING = 0.5
#: ... for at least so long [s].
_SHORTEST_TRAVEL = 0.016
#: Left out at each end of a travel: the acceleration, and most of the ringing after it.
_TRIMMED = 0.25
#: What is left is at constant velocity if its speed varies by less than this part (standard deviation), and comparable
#: with the other travels if its mean differs from their median by less than twice as much.
_SPEED_TOLERANCE = 0.05
#: Path of the windows below which they stand still, mean of a window [m].
_SHORTEST_PATH = 1e-4
#: Pairs of travels, there and back, below which their scatter says nothing.
FEWEST_PAIRS = 3
#: Share of the path that net travel must leave unexplained: in one direction alone friction and offset are one number.
_BOTH_DIRECTIONS = 0.01
#: Channels that are sampled together are together to this part of a sample: work that so little would make ...
_TOGETHER = 0.25
#: ... must be less than this part of the friction torque ...
_SMALL = 0.5
#: ... which must not differ from a drag torque known to a tenth by more than this factor ...
_AGREES = 2.0
_WELL_KNOWN = 10.0
#: ... and one of fewer standard uncertainties is none.
_KNOWN = 4.0


@dataclass(frozen=True, slots=True)
class DragTorque:
    """Friction torque of the screw at constant velocity, apart from what does not change sign with the direction."""

    drag: Estimate  # (T₊ − T₋)/2 [N·m]
    offset: Estimate  # (T₊ + T₋)/2: weight of a slanted axis, zero error of the torque channel [N·m]
    speed: float  # travelling speed [m/s]; drag torques are comparable at one speed only
    n_pairs: int  # constant-velocity travels, one of each direction


@dataclass(frozen=True, slots=True)
class Friction:
    """Friction of the axis over one measurement, positive whichever way torque and position count."""

    torque: Estimate  # :func:`friction_torque`; of windows too few for it the drag torque [N·m]
    drag: DragTorque | Rejection  # at constant velocity
    trace_polarity: int  # 1: the torque is positive where the position rises, -1: where it falls


@dataclass(frozen=True, slots=True, eq=False)
class Moves:
    """Windows of one sampling rate and length, and the velocity over each."""

    rate: float  # [Hz]
    torque: FloatArray  # shape (n_windows, n_samples) [N·m]
    velocity: FloatArray  # of the same shape [m/s]


def estimate_friction(windows: Sequence[Window], trace_polarity: int | None = None) -> Friction | Rejection:
    """Return the friction of the windows of one measurement, or why they tell none: motion, position, torque, noise.

    Friction takes work: where the polarity is known, 1 or -1 as of the result, what gives work is none.
    """
    moves = moves_of(windows)
    drag, torque = estimate_drag_torque(windows, moves), friction_torque(windows, moves)
    if isinstance(drag, DragTorque) and (isinstance(torque, Rejection) or not _is_of_friction(torque, drag, moves)):
        torque = drag.drag
    if isinstance(torque, Rejection):
        return torque
    polarity = trace_polarity or (-1 if torque.value < 0.0 else 1)
    torque = replace(torque, value=polarity * torque.value)
    if torque.value < _KNOWN * torque.standard_uncertainty:
        return Rejection(
            RejectionReason.LITTLE_EXCITATION,
            f"friction torque must exceed {_KNOWN:g} of its standard uncertainties; got "
            f"({plus_minus(torque.value, torque.standard_uncertainty)}) N·m",
        )
    if isinstance(drag, DragTorque):
        drag = replace(drag, drag=replace(drag.drag, value=polarity * drag.drag.value))
    return Friction(torque, drag, polarity)


def _is_of_friction(torque: Estimate, drag: DragTorque, moves: Sequence[Moves]) -> bool:
    """Tell whether the work of all moves is that of the friction: not of a delay, as far as the drag torque tells."""
    of_delay = abs(sum(float(np.vdot(alike.torque, np.gradient(alike.velocity, axis=1))) for alike in moves))
    path = sum(float(np.abs(alike.velocity).sum()) for alike in moves)
    if _TOGETHER * of_delay > _SMALL * abs(torque.value) * path:
        return False
    if abs(drag.drag.value) < _WELL_KNOWN * drag.drag.standard_uncertainty:
        return True
    return 1.0 / _AGREES < torque.value / drag.drag.value < _AGREES


def estimate_drag_torque(windows: Sequence[Window], moves: Sequence[Moves] | None = None) -> DragTorque | Rejection:
    r"""Average the torque of the constant-velocity travels of both directions.

    .. math::

        T_\mathrm{drag} = \frac{T_+ - T_-}{2}, \qquad T_\mathrm{offset} = \frac{T_+ + T_-}{2}

    The dynamic preload drag torque of section 3.7 of [1]_, which is measured over both directions. It needs windows of
    one measurement with motor torque and position trace; a force, mixed torque sources and too few travels (no motion,
    no position) are refused.

    The uncertainty is the scatter of the pairs: what both share, be it friction or zero error, then enters the right
    one of the two.
    Friction depends on speed: travels that are not within a tenth of the median speed are left out. The moves are those
    of :func:`moves_of`, where they are known already.

    References
    ----------
    .. [1] ISO 3408-3:2006, Ball screws: Acceptance conditions and acceptance tests.
    """
    for window in windows:
        if window.excitation_quantity is not ExcitationQuantity.TORQUE:
            return Rejection(
                RejectionReason.EXCITATION_SOURCE_MISMATCH,
                f"drag torque needs windows of torque in N·m; got {window.excitation_quantity.value}",
            )
    if len({window.excitation_source for window in windows}) > 1:
        return Rejection(
            RejectionReason.EXCITATION_SOURCE_MISMATCH, "drag torque needs one torque source; got sensor and drive"
        )
    travels = [_constant_velocity_travels(alike) for alike in (moves_of(windows) if moves is None else moves)]
    velocity, torque = np.concatenate([np.empty((2, 0)), *travels], axis=1)
    speed = float(np.median(np.abs(velocity))) if velocity.size else 0.0
    comparable = np.abs(np.abs(velocity) - speed) <= 2.0 * _SPEED_TOLERANCE * speed
    forward, back = torque[comparable & (velocity > 0.0)], torque[comparable & (velocity < 0.0)]
    n_pairs = min(forward.size, back.size)
    if n_pairs < FEWEST_PAIRS:
        return Rejection(
            RejectionReason.TOO_FEW_AVERAGES,
            f"drag torque needs at least {FEWEST_PAIRS} constant-velocity travels in each direction, with position; "
            f"got {forward.size} forward and {back.size} back in {len(windows)} windows",
        )
    forward, back = forward[:n_pairs], back[:n_pairs]
    return DragTorque(
        drag=mean_of(0.5 * (forward - back)), offset=mean_of(0.5 * (forward + back)), speed=speed, n_pairs=n_pairs
    )


def friction_torque(windows: Sequence[Window], moves: Sequence[Moves] | None = None) -> Estimate | Rejection:
    r"""Return the friction torque over all motion of the windows of one measurement, from the work that it takes [N·m].

    .. math:: T_f = \frac{\sum T\,v}{\sum |v|}

    with the torque T and the velocity v of the screw's travel. What is accelerated gives its energy back, and an
    offset of the torque drops out by a second column for the net travel, so that windows with a whole number of moves
    know the mean friction better than the few stretches at constant velocity. Its uncertainty is the scatter of the
    windows about both. It is no drag torque of ISO 3408-3: the damping of the structure is in it, and no speed is
    singled out. It serves comparisons with the same moves of the same axis. Windows without motion, position trace or
    torque, or with motion in one direction only, are refused.
    """
    if any(window.excitation_quantity is not ExcitationQuantity.TORQUE for window in windows):
        return Rejection(RejectionReason.EXCITATION_SOURCE_MISMATCH, "friction torque needs windows of torque in N·m")
    work = [
        ((v.torque * v.velocity).sum(axis=1), np.abs(v.velocity).sum(axis=1), v.velocity.sum(axis=1))
        for v in (moves_of(windows) if moves is None else moves)
    ]
    done, path, net = np.concatenate([np.empty((3, 0)), *work], axis=1)
    own = float(path @ path - (path @ net) ** 2 / max(float(net @ net), 1e-300))  # of the path, not of the net travel
    if (
        done.size < FEWEST_PAIRS
        or path.sum() < _SHORTEST_PATH * done.size * windows[0].sample_rate
        or own < _BOTH_DIRECTIONS * float(path @ path)
    ):
        return Rejection(
            RejectionReason.TOO_FEW_AVERAGES,
            f"friction torque needs at least {FEWEST_PAIRS} windows with motion in both directions and position; "
            f"got {done.size}",
        )
    columns = np.column_stack([path, net])
    coefficients = np.linalg.lstsq(columns, done)[0]
    left, degrees_of_freedom = done - columns @ coefficients, done.size - 2
    uncertainty = math.sqrt(float(left @ left) / degrees_of_freedom / own)
    return Estimate(float(coefficients[0]), uncertainty, degrees_of_freedom)


def moves_of(windows: Sequence[Window]) -> list[Moves]:
    """Return the motion of the windows whose position is known for long enough."""
    alike: dict[tuple[float, int], list[Window]] = {}
    for window in windows:
        shortest = max(_span(window.sample_rate), _SHORTEST_TRAVEL * window.sample_rate)
        if window.position_trace is not None and window.n_samples >= shortest and _span(window.sample_rate) >= 3:
            alike.setdefault((window.sample_rate, window.n_samples), []).append(window)
    return [
        Moves(
            rate,
            np.array([window.excitation for window in together], dtype=np.float64),
            velocity_of(np.array([window.position_trace for window in together]), rate),
        )
        for (rate, _), together in alike.items()
    ]


def velocity_of(traces: SampleArray, rate: float, span: float = _VELOCITY_SPAN) -> FloatArray:
    """Return the slope of the line through the samples around each; at either end that of the first and last line.

    A Savitzky–Golay filter of the first order, by which a window is as long as its trace.
    """
    half = _span(rate, span) // 2
    steps = np.arange(-half, half + 1)
    velocity: FloatArray = scipy.ndimage.correlate1d(traces, rate * steps / float(steps @ steps), output=np.float64)
    velocity[:, :half], velocity[:, -half:] = velocity[:, [half]], velocity[:, [-half - 1]]
    return velocity


def _span(sample_rate: float, span: float = _VELOCITY_SPAN) -> int:
    """Return the samples over which the position is differentiated, an odd number."""
    return 2 * round(0.5 * span * sample_rate) + 1


def _constant_velocity_travels(moves: Moves) -> FloatArray:
    """Return mean velocity [m/s] and mean torque [N·m] of the travels of windows, shape (2, n_travels)."""
    # one sample of rest before and behind each window: a travel ends with it
    torque, velocity = (np.pad(of, ((0, 0), (1, 1))).ravel() for of in (moves.torque, moves.velocity))
    speed = np.abs(moves.velocity)
    moving = np.pad(speed > _MOVING * speed.max(axis=1, keepdims=True), ((0, 0), (1, 1))).ravel()
    begin, end = (np.flatnonzero(moving[1:] != moving[:-1]) + 1).reshape(-1, 2).T
    is_long = end - begin >= _SHORTEST_TRAVEL * moves.rate
    trimmed = np.rint(_TRIMMED * (end - begin)[is_long]).astype(np.intp)
    begin, end = begin[is_long] + trimmed, end[is_long] - trimmed
    if not begin.size:
        return np.empty((2, 0))
    # the sums of every other stretch: from each beginning to its end
    inner = np.column_stack([begin, end]).ravel()
    mean, mean_torque, square = (
        np.add.reduceat(of, inner)[::2] / (end - begin) for of in (velocity, torque, velocity**2)
    )
    is_constant = square - mean**2 < (_SPEED_TOLERANCE * mean) ** 2
    return np.array([mean[is_constant], mean_torque[is_constant]])


def mean_of(values: FloatArray) -> Estimate:
    """Return the mean with the scatter of the values behind it."""
    return Estimate(float(values.mean()), float(values.std(ddof=1)) / math.sqrt(values.size), values.size - 1)
