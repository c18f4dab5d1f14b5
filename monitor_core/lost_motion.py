r"""Measure lost motion: by how much the table lags the motor at reversals, and which part of that is play.

Where an axis turns back, the table waits until the screw has come as far as it gives way and has play. With the motor
angle θ, the lead P_h and the linear scale x, the relative displacement is

.. math:: d = \frac{P_h}{2\pi}\,\theta - x

and what lies between its values at one place, approached from either side, is the reversal value of ISO 230-2. It is
not play: friction winds the drive up by :math:`2 F_f / k` without any. The torque of the motor distinguishes the two.
While the drive turns over, its force is

.. math:: F = F_0 + k\,\mathrm{dz}(d - d_0;\, b) + F_s\,\bigl(1 - 2\,e^{-|u - u_r|/s}\bigr)

with the dead zone dz, which is 0 within ± b/2 and rises with slope 1 beyond, the stiffness k, and the friction of screw
and bearings before the spring, which builds up over a path s of the motor from the point u_r where it turned (Dahl
1968). Play b is where d grows and the force does not. The unit of the force drops out of b: motor current serves.

References
----------
.. [1] ISO 230-2:2014, Test code for machine tools: Determination of accuracy and repeatability of positioning.
.. [2] P. R. Dahl, A solid friction model, Aerospace Corporation TOR-0158(3107-18)-1, 1968.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import FloatArray, SampleArray
from monitor_core.recording import ExcitationQuantity, Rejection, RejectionReason, ResponseQuantity, Window
from monitor_core.uncertainty import Estimate

#: Reversals below which their scatter says nothing of what they share.
FEWEST_REVERSALS = 4
#: A turning point is one after which the motor goes back by this part of its whole path at least.
_TURN = 0.1
#: Part of the way back on which the levels of both senses are compared: past the turn, and before the next.
_COMPARED = (0.3, 0.8)
#: Path after a turn that is fitted, in reversal values, ...
_REACHES = (5.0, 10.0)
#: ... and from which play, of the reversal value, and path of the friction, in reversal values, the fit is begun.
_PLAYS, _PATHS = (0.1, 0.5, 0.9, 0.97), (0.5, 2.5)
#: Samples of a reversal that are fitted, each a mean of more.
_MOST_SAMPLES = 100
#: Standard uncertainty of what lies anywhere between 0 and 1.
_UNIFORM = 1.0 / math.sqrt(12.0)
#: Exponents of force over deflection: of a preloaded pair of contacts, and of a single one (Hertz).
_STRAIGHT, _HERTZ = 1.0, 1.5
#: Samples of a reversal in the shorter of the two, below which the force over the deflection is no curve.
_FEWEST_SAMPLES = 8
#: A reversal value below so many of its standard uncertainties, or steps of the encoders, is not looked into.
_SEEN = 3.0
#: Play is said to be there where chance alone would say so once in a thousand records without any.
_CHANCE = 1e-3


@dataclass(frozen=True, slots=True)
class LostMotion:
    """Lost motion of the reversals of one measurement."""

    reversal_value: Estimate  # mean over both senses, ISO 230-2 [m]
    play: Estimate | Rejection  # from 0 to the reversal value [m]
    n_reversals: int

    @property
    def has_play(self) -> bool:
        """Tell whether the play is more than chance would show where there is none."""
        if isinstance(self.play, Rejection):
            return False
        chance = float(scipy.special.stdtrit(self.play.degrees_of_freedom, 1.0 - _CHANCE))
        return self.play.value > chance * self.play.standard_uncertainty


def estimate_lost_motion(windows: Sequence[Window]) -> LostMotion | Rejection:
    """Return the lost motion of the slow reversals in windows of one measurement, or why they tell none.

    The response is the relative displacement, with the position of the table as trace; the excitation a torque, force
    or current of either sign. Of a commanded acceleration the play is refused, and the reversal value bounds it.

    The reversals are fitted together, each with its own force and place of the dead zone: pitch error of the screw,
    ripple of the motor and drift differ from one to the next. The standard uncertainty holds the scatter of the
    reversals (jackknife) and what the fit moves by in three ways: with half the path; with a friction that turns over
    as 1/(1 + u/s) instead of exponentially, for no record says which it is; and with deflections in steps twice as
    coarse, for their errors flatten the curve. Go slowly: what both encoders are read apart, times twice the speed, is
    in the reversal value.
    """
    reversals: list[_Reversal] = []
    for window in windows:
        if window.response_quantity is not ResponseQuantity.RELATIVE_DISPLACEMENT or window.position_trace is None:
            return Rejection(
                RejectionReason.EXCITATION_SOURCE_MISMATCH,
                "lost motion needs a relative displacement (motor less scale) and the position of the table; got "
                f"{window.response_quantity}{'' if window.position_trace is None else ' with position'}",
            )
        reversals += _reversals(window.response.astype(np.float64), window.position_trace, window.excitation)
    if len(reversals) < FEWEST_REVERSALS:
        return Rejection(
            RejectionReason.TOO_FEW_AVERAGES,
            f"lost motion needs at least {FEWEST_REVERSALS} reversals of the motor; got {len(reversals)} in "
            f"{len(windows)} windows",
        )
    value = _reversal_value(reversals)
    if windows[0].excitation_quantity is ExcitationQuantity.ACCELERATION:
        return LostMotion(value, _NO_DRIVE, len(reversals))
    step = min(_step(window.response) for window in windows)
    return LostMotion(value, _play(reversals, value, step), len(reversals))


_NO_DRIVE = Rejection(
    RejectionReason.EXCITATION_SOURCE_MISMATCH,
    "play is told from wind-up by the torque or current of the motor; got a commanded acceleration",
)


@dataclass(frozen=True, slots=True, eq=False)
class _Reversal:
    """Samples from where the motor turned back, in their order; forces and deflections count in its old sense."""

    travel: FloatArray  # of the motor since it turned [m]
    deflection: FloatArray  # [m]
    force: FloatArray  # [any unit]
    value: float  # difference of the deflection between both senses at the same places [m]
    sense: float  # old, +1 or −1


def _turning_points(motor: FloatArray) -> list[int]:
    least = _TURN * float(np.ptp(motor))
    turns: list[int] = []
    extreme, sense = 0, 0.0
    for i, place in enumerate(motor.tolist()):
        gone = place - float(motor[extreme])
        if sense == 0.0 and abs(gone) > least:
            sense, extreme = math.copysign(1.0, gone), i
        elif sense * gone > 0.0:
            extreme = i
        elif sense * gone < -least:
            turns.append(extreme)
            sense, extreme = -sense, i
    return turns


def _reversals(relative: FloatArray, position: FloatArray, drive: SampleArray) -> list[_Reversal]:
    """Cut a record at the turning points of the motor; the end of the last way back needs no turn."""
    motor, force = position + relative, drive.astype(np.float64)
    turns = _turning_points(motor)
    reversals = []
    for begin, turn, end in zip([0, *turns], turns, [*turns[1:], motor.size], strict=False):
        sense = math.copysign(1.0, motor[turn] - motor[begin])
        before, after = slice(begin, turn + 1), slice(turn, end)
        back = sense * (motor[turn] - motor[after])
        reach = min(float(back.max()), abs(float(motor[turn] - motor[begin])))
        places = motor[turn] - sense * np.linspace(*_COMPARED, 60) * reach
        old, new = (_at(places, motor[side], relative[side]) for side in (before, after))
        value = sense * float(np.mean(old - new))
        reversals.append(
            _Reversal(back, sense * (relative[after] - relative[turn]), sense * force[after], value, sense)
        )
    return reversals


def _at(places: FloatArray, motor: FloatArray, values: FloatArray) -> FloatArray:
    order = np.argsort(motor, kind="stable")
    return np.interp(places, motor[order], values[order])


def _reversal_value(reversals: Sequence[_Reversal]) -> Estimate:
    """Average over both senses: a drift counts for one as much as against the other."""
    values = np.array([reversal.value for reversal in reversals])
    both = 0.5 * (values[:-1] + values[1:])
    # each reversal but the outermost stands in two of the means
    uncertainty = float(both.std(ddof=1)) * math.sqrt(2.0 / both.size)
    return Estimate(float(both.mean()), uncertainty, max(0.5 * both.size, 1.0))


def _play(reversals: Sequence[_Reversal], value: Estimate, step: float) -> Estimate | Rejection:
    """Return the play, or, where the fit knows less, that it is anything up to the reversal value."""
    if not value.value > _SEEN * max(value.standard_uncertainty, step):
        anything = max(value.value, step)
        return Estimate(0.5 * anything, _UNIFORM * anything)
    far, near = (_DeadZoneFit(reversals, value.value, reach) for reach in _REACHES[::-1])
    if near.off.size < _FEWEST_SAMPLES * len(reversals):
        return Rejection(
            RejectionReason.TOO_FEW_AVERAGES,
            f"play needs {_FEWEST_SAMPLES} samples while the drive turns over; got "
            f"{near.off.size / len(reversals):.1f}: reverse more slowly",
        )
    best = far.solve(_exponential)
    coarse = _DeadZoneFit(reversals, value.value, _REACHES[1], 2.0 * step)
    others = (
        far.solve(_hyperbolic, best.numbers),
        near.solve(_exponential, best.numbers),
        coarse.solve(_exponential, best.numbers),
    )
    plays = [float(solution.numbers[0]) for solution in (best, *others)]
    uncertainty = math.hypot(far.jackknife(best), max(plays) - min(plays), step / math.sqrt(12.0) / value.value)
    if not uncertainty < _UNIFORM:
        return Estimate(0.5 * value.value, _UNIFORM * value.value)
    return Estimate(plays[0] * value.value, uncertainty * value.value, len(reversals) - 1)


def _step(values: SampleArray) -> float:
    """Return the smallest step between values that differ, to rounding."""
    steps = np.abs(np.diff(values.astype(np.float64)))
    reach = float(np.ptp(values))
    return float(steps[steps > 1e-6 * reach].min(initial=reach))


def _exponential(path: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Turn the friction over as bristles do."""
    left = np.exp(-path)
    return left, -left


def _hyperbolic(path: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Turn the friction over as fast at first, and more slowly in the end."""
    left = 1.0 / (1.0 + path)
    return left, -(left**2)


#: What is left of the old friction after a path in units of its own, and the slope of that.
_Law = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
#: Bounds of what all reversals share: play, stiffness, friction, its path, exponent of the contact.
_LEAST, _MOST = (0.0, 0.0, 0.0, 1e-3, _STRAIGHT), (0.999, 1e3, 1.0, 1e2, _HERTZ)
_SHARED = len(_LEAST)


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """A fit: its numbers, what it leaves of the force, and the slopes of that."""

    numbers: FloatArray  # shape (n_numbers,)
    left: FloatArray  # shape (n_samples,)
    slopes: FloatArray  # shape (n_samples, n_numbers)


class _DeadZoneFit:
    """Least squares of the force of all reversals: play, stiffness, friction, its path; force and place of each.

    Lengths are in reversal values, forces in the range of a reversal.
    """

    def __init__(self, reversals: Sequence[_Reversal], value: float, reach: float, step: float = 0.0) -> None:
        pieces = []
        for reversal in reversals:
            end = int(np.argmax(reversal.travel > reach * value)) or reversal.travel.size
            # the dead zone lies in the middle between both levels: friction winds the drive up as far either way
            off = reversal.deflection[:end] + 0.5 * reversal.value
            off = np.round(off / step) * step if step > 0.0 else off
            columns = (reversal.travel[:end] / value, off / value, reversal.force[:end])
            pieces.append([_averaged(column, max(end // _MOST_SAMPLES, 1)) for column in columns])
        span = float(np.median([np.ptp(force) for *_, force in pieces]))
        self.n = len(pieces)
        self.of = np.repeat(np.arange(self.n), [force.size for *_, force in pieces])
        self.travel, self.off, self.force = (np.concatenate(column) for column in zip(*pieces, strict=True))
        # against the old sense the force falls, whichever way it counts
        falls = sum(float(force[0] - force[-1]) for *_, force in pieces)
        span = math.copysign(span, falls)
        self.force = self.force / span
        self.middles = np.array([0.5 * (force[0] + force[-1]) / span for *_, force in pieces])

    def solve(self, law: _Law, start: FloatArray | None = None) -> _Solution:
        """Fit from one start, or the best of many."""
        starts = [start]
        if start is None:
            first = [(play, 0.7 / (1.0 - play), 0.2, path, 1.1) for play in _PLAYS for path in _PATHS]
            starts = [np.concatenate([shared, self.middles]) for shared in first]
        free = np.full(self.n, np.inf)
        bounds = np.concatenate([_LEAST, -free]), np.concatenate([_MOST, free])
        fits = [
            scipy.optimize.least_squares(
                self._left, begin, jac=self._jacobian, args=(law,), bounds=bounds, max_nfev=100, x_scale="jac"
            )
            for begin in starts
        ]
        best = min(fits, key=lambda fit: float(fit.cost))
        return _Solution(best.x, best.fun, best.jac)

    def jackknife(self, solution: _Solution) -> float:
        """Return the standard uncertainty of the play from the reversals, each left out once."""
        information = solution.slopes.T @ solution.slopes
        little = 1e-9 * np.diag(np.diag(information))  # a path of the friction that ends on its bound tells nothing
        moved = []
        for number in range(self.n):
            slopes, left = (array[self.of == number] for array in (solution.slopes, solution.left))
            moved.append(np.linalg.solve(information - slopes.T @ slopes + little, slopes.T @ left)[0])
        return math.sqrt((self.n - 1) * float(np.var(moved)))

    def _left(self, p: FloatArray, law: _Law) -> FloatArray:
        play, stiffness, friction, path, exponent = p[:_SHARED]
        left, _ = law(self.travel / path)
        spring = stiffness * np.sign(self.off) * _engaged(self.off, play) ** exponent
        return np.asarray(p[_SHARED:][self.of] + spring - friction * (1.0 - 2.0 * left) - self.force)

    def _jacobian(self, p: FloatArray, law: _Law) -> FloatArray:
        play, stiffness, friction, path, exponent = p[:_SHARED]
        left, slope = law(self.travel / path)
        engaged, sign = _engaged(self.off, play), np.sign(self.off)
        columns = np.zeros((self.force.size, p.size))
        steepness = np.where(engaged > 0.0, exponent * np.maximum(engaged, 1e-12) ** (exponent - 1.0), 0.0)
        columns[:, 0] = -0.5 * stiffness * sign * steepness
        columns[:, 1] = sign * engaged**exponent
        columns[:, 2] = 2.0 * left - 1.0
        columns[:, 3] = -2.0 * friction * slope * self.travel / path**2
        columns[:, 4] = stiffness * sign * scipy.special.xlogy(engaged**exponent, engaged)
        columns[np.arange(self.force.size), _SHARED + self.of] = 1.0
        return columns


def _averaged(samples: FloatArray, together: int) -> FloatArray:
    """Average so many samples each, the last few left out."""
    whole = samples.size // together * together
    return np.asarray(samples[:whole].reshape(-1, together).mean(axis=1))


def _engaged(off: FloatArray, play: float) -> FloatArray:
    """Return how far the spring is deflected, either way."""
    return np.maximum(np.abs(off) - 0.5 * play, 0.0)
