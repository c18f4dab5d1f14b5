"""Choose the values of a motion record to compare: a low-passed, slower copy without its ends and standstill."""

from dataclasses import dataclass

import numpy as np
from scipy import signal

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.conditions.groups import Indices
from monitor_core.models.motion import Kinematics, cutoff_frequency

#: A motion of fewer values says little of friction: half a second at 100 Hz, and as much to judge it on.
_FEWEST_VALUES = 100
#: Ends to be left out, and the shortest standstill, in periods of the cut-off frequency.
_END = 10.0
#: A slower axis stands still, as a share of its highest speed.
_STANDSTILL = 1e-3
#: The low pass of a usual decimation: Chebyshev of order 8 with 0.05 dB of ripple, up to 0.8 of half the new rate.
_ORDER, _RIPPLE, _BAND = 8, 0.05, 0.4


@dataclass(frozen=True, slots=True, eq=False)
class MotionSampling:
    """How recorded samples become the values that are compared."""

    sample_rate: float  # [Hz]
    cutoff: float  # up to which the kinematics are those of the axis [Hz]
    n_samples: int
    n_end: int  # samples at each end that are those of a filter rather than of the axis
    step: int  # samples per value
    kept: Indices  # of the values, those at which the axis moves, shape (n_values,)
    filtering: FloatArray  # second-order sections of the low pass, shape (4, 6) [-]

    @property
    def band(self) -> float:
        """Up to where values are compared [Hz]."""
        return _BAND * self.sample_rate / self.step

    @property
    def end(self) -> float:
        """How long an end that is left out is [s]."""
        return self.n_end / self.sample_rate

    @property
    def time(self) -> FloatArray:
        """Of each value, since the first sample, shape (n_values,) [s]."""
        return (self.n_end + self.step * self.kept) / self.sample_rate

    def inner(self, samples: FloatArray) -> FloatArray:
        """Return samples without the ends, shape (n_inner,)."""
        return samples[self.n_end : self.n_samples - self.n_end]

    def low_passed(self, samples: FloatArray) -> FloatArray:
        """Return samples without the ends, up to the compared band and undelayed, shape (n_inner,)."""
        smooth: FloatArray = signal.sosfiltfilt(self.filtering, samples)
        return self.inner(smooth)  # the ends that the filter makes up are among those left out

    def values(self, samples: FloatArray) -> FloatArray:
        """Return the values of recorded or predicted samples, shape (n_values,)."""
        return self.low_passed(samples)[:: self.step][self.kept]

    def instants(self, samples: FloatArray) -> FloatArray:
        """Return the samples at the times of the values, as they are, shape (n_values,)."""
        return self.inner(samples)[:: self.step][self.kept]


def sampling_of(motion: Kinematics) -> MotionSampling:
    """Return which values to compare of a motion.

    As many values per second as the cut-off frequency of the kinematics has periods, up to 0.4 of it: there central
    differences err by a percent at most. Measured and predicted force pass the same filter, and friction is formed
    before it, so that a jump stays as sharp in one as in the other. Standstill is left out: friction balances there
    what no velocity shows.

    Raises OutsideValidityError if the axis does not move, or moves too shortly.
    """
    n, rate, cutoff = motion.velocity.size, motion.sample_rate, cutoff_frequency(motion.sample_rate)
    n_end = round(_END * rate / cutoff)
    step = max(round(rate / cutoff), 2)
    moves = _moves(motion.velocity, n_end)[n_end : max(n - n_end, 0) : step]
    if np.count_nonzero(moves) < _FEWEST_VALUES:
        needed, got = _FEWEST_VALUES * step, np.count_nonzero(moves) * step
        raise OutsideValidityError(
            f"a motion to be compared must last at least {needed / rate:g} s besides {n_end / rate:g} s at each end "
            f"and standstill; got {got / rate:g} s"
        )
    filtering = signal.cheby1(_ORDER, _RIPPLE, _BAND * rate / step, output="sos", fs=rate)
    return MotionSampling(rate, cutoff, n, n_end, step, np.flatnonzero(moves), filtering)


def _moves(velocity: FloatArray, shortest: int) -> BoolArray:
    """Tell where the axis does not stand still for some time; a reversal is no standstill."""
    slow = np.abs(velocity) <= _STANDSTILL * np.max(np.abs(velocity), initial=0.0)
    edges = np.flatnonzero(np.diff(np.r_[False, slow, False]))
    moves = np.ones(velocity.size, dtype=np.bool_)
    for start, stop in edges.reshape(-1, 2):
        moves[start:stop] = stop - start < shortest
    return moves
