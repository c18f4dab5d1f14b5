"""Estimate the noise of a measured force from a motion that repeats, or else from frequencies above any motion."""

import numpy as np
from scipy import fft

from monitor_core.arrays import FloatArray
from monitor_core.fitting.residuals.motion.sampling import MotionSampling
from monitor_core.motion import MotionRecord

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
    repetitions apart, as near to half the record as possible: between what is fitted and what is held out. Where
    nothing repeats it is the noise above the cut-off frequency of the kinematics, taken as white. That is a lower bound
    that ignores friction which changes from stroke to stroke. It is never less than 1e-4 of the force's root mean
    square.
    """
    found = _repeatability(record, force, sampling)
    noise = _white_noise(force, sampling) if found is None else found
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
            return float(np.sqrt(0.5 * np.mean((smooth[shift:] - smooth[:-shift]) ** 2)))
    return None


def _white_noise(force: FloatArray, sampling: MotionSampling) -> float:
    """Return what noise that is white up to half the sample rate has in the compared band."""
    spectrum = fft.rfft(sampling.inner(force))
    spectrum[fft.rfftfreq(sampling.inner(force).size, 1.0 / sampling.sample_rate) < sampling.cutoff] = 0.0
    high = fft.irfft(spectrum, sampling.inner(force).size)
    deviation = float(np.median(np.abs(high))) / _NORMAL_MEDIAN  # jumps at reversals are no noise, and rare
    return deviation * float(np.sqrt(sampling.band / (0.5 * sampling.sample_rate - sampling.cutoff)))


def _mean_square_difference(trajectory: FloatArray) -> FloatArray:
    """Return the mean of (x(t + s) − x(t))² over t for every shift s, shape (n_samples,)."""
    x = trajectory - np.mean(trajectory)
    n = x.size
    size = fft.next_fast_len(2 * n, real=True)
    products = fft.irfft(np.abs(fft.rfft(x, size)) ** 2, size)[:n]
    square = np.r_[0.0, np.cumsum(x**2)]
    both = square[n - np.arange(n)] + square[n] - square[np.arange(n)]
    mean: FloatArray = np.maximum(both - 2.0 * products, 0.0) / (n - np.arange(n))  # rounding may leave less than none
    return mean
