"""Choose the values of a motion record to compare, and estimate the noise of its force.

Compared is a low-passed, slower copy without its ends and standstill. The noise is that of a motion that repeats, or
else of frequencies above any motion.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.conditions.groups import Indices
from monitor_core.models.motion import Kinematics, cutoff_frequency
from monitor_core.recording import MotionRecord

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
        smooth: FloatArray = scipy.signal.sosfiltfilt(self.filtering, samples)
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
    filtering = scipy.signal.cheby1(_ORDER, _RIPPLE, _BAND * rate / step, output="sos", fs=rate)
    return MotionSampling(rate, cutoff, n, n_end, step, np.flatnonzero(moves), filtering)


def _moves(velocity: FloatArray, shortest: int) -> BoolArray:
    """Tell where the axis does not stand still for some time; a reversal is no standstill."""
    slow = np.abs(velocity) <= _STANDSTILL * np.max(np.abs(velocity), initial=0.0)
    edges = np.flatnonzero(np.diff(np.r_[False, slow, False]))
    moves = np.ones(velocity.size, dtype=np.bool_)
    for start, stop in edges.reshape(-1, 2):
        moves[start:stop] = stop - start < shortest
    return moves


#: Root-mean-square difference of a repeated motion, as a share of its range. A shift of a sample from the
#: repetition of a motion of seconds at 1 kHz makes more.
_SAME = 1e-4
#: What repeats must have been elsewhere between.
_ELSEWHERE = 0.1
#: Of the record, both ends of the comparison that a shift leaves.
_LEAST_OVERLAP = 0.25
#: No force is known better, as a share of its root mean square: 13 bits of its range.
_FINEST = 1e-4
#: Median of the magnitude of normal noise, in standard deviations.
_NORMAL_MEDIAN = 0.6745


def force_noise(record: MotionRecord, force: FloatArray, sampling: MotionSampling) -> float:
    """Return the standard deviation of the values of a measured force between repetitions of the same motion [N].

    Where the reference repeats, or else the position, it is the deviation between times that are a whole number of
    repetitions apart, as near to half the record as possible: between what is fitted and what is held out. It is
    taken from the median of the differences, so that a disturbance which comes and goes is no noise. Where
    nothing repeats it is the noise above the cut-off frequency of the kinematics, taken as white. That is a lower bound
    that ignores friction which changes from stroke to stroke. It is never less than 1e-4 of the force's root mean
    square.
    """
    repeatability = _repeatability(record, force, sampling)
    noise = _white_noise(force, sampling) if repeatability is None else repeatability
    return max(noise, _FINEST * float(np.sqrt(np.mean(sampling.values(force) ** 2))))


def repetition_shift(trajectory: FloatArray) -> int | None:
    """Return the number of samples after which a motion is the same again; the one nearest to half of it.

    None where it does not repeat, or does so too late to be compared.
    """
    n = trajectory.size
    extent = float(np.ptp(trajectory))
    difference = np.sqrt(_mean_square_difference(trajectory)[: round((1.0 - _LEAST_OVERLAP) * n)])
    elsewhere = np.flatnonzero(difference > _ELSEWHERE * extent)
    if not elsewhere.size:
        return None
    same = np.flatnonzero(difference < _SAME * extent)
    same = same[same > elsewhere[0]]
    if not same.size:
        return None
    runs = np.split(same, np.flatnonzero(np.diff(same) > 1) + 1)
    shifts = [int(run[np.argmin(difference[run])]) for run in runs]
    return min(shifts, key=lambda shift: abs(shift - 0.5 * n))


def _repeatability(record: MotionRecord, force: FloatArray, sampling: MotionSampling) -> float | None:
    for trajectory in (record.reference, record.position):
        shift = None if trajectory is None else repetition_shift(sampling.inner(trajectory))
        if shift is not None:
            smooth = sampling.low_passed(force)
            difference = np.abs(smooth[shift:] - smooth[:-shift])
            return float(np.median(difference)) / (_NORMAL_MEDIAN * math.sqrt(2.0))
    return None


def _white_noise(force: FloatArray, sampling: MotionSampling) -> float:
    """Return what noise that is white up to half the sample rate has in the compared band."""
    spectrum = scipy.fft.rfft(sampling.inner(force))
    spectrum[scipy.fft.rfftfreq(sampling.inner(force).size, 1.0 / sampling.sample_rate) < sampling.cutoff] = 0.0
    high = scipy.fft.irfft(spectrum, sampling.inner(force).size)
    deviation = float(np.median(np.abs(high))) / _NORMAL_MEDIAN  # jumps at reversals are no noise, and rare
    return deviation * float(np.sqrt(sampling.band / (0.5 * sampling.sample_rate - sampling.cutoff)))


def _mean_square_difference(trajectory: FloatArray) -> FloatArray:
    """Return the mean of (x(t + s) − x(t))² over t for every shift s, shape (n_samples,)."""
    x = trajectory - np.mean(trajectory)
    n = x.size
    size = scipy.fft.next_fast_len(2 * n, real=True)
    products = scipy.fft.irfft(np.abs(scipy.fft.rfft(x, size)) ** 2, size)[:n]
    square = np.r_[0.0, np.cumsum(x**2)]
    both = square[n - np.arange(n)] + square[n] - square[np.arange(n)]
    mean: FloatArray = np.maximum(both - 2.0 * products, 0.0) / (n - np.arange(n))  # rounding may leave less than none
    return mean
