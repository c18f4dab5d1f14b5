"""Derive velocity and acceleration of an axis from its measured position."""

from dataclasses import dataclass

import numpy as np
from scipy import signal

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import OutsideValidityError

#: Above the bandwidth of position loops, below what an encoder differentiated twice drowns in: that of the published
#: identification of the EMPS.
_HIGHEST_CUTOFF = 100.0  # [Hz]
#: Central differences read a sine of a tenth of the sample rate 6.5 % too small, one of a twenty-fifth 1 %.
_CUTOFF_SHARE = 0.1
_ORDER = 4


@dataclass(frozen=True, slots=True, eq=False)
class Kinematics:
    """How an axis moved, uniformly sampled."""

    sample_rate: float  # [Hz]
    velocity: FloatArray  # shape (n_samples,) [m/s]
    acceleration: FloatArray  # shape (n_samples,) [m/s²]

    def __post_init__(self) -> None:
        object.__setattr__(self, "velocity", read_only(self.velocity))
        object.__setattr__(self, "acceleration", read_only(self.acceleration))
        if self.velocity.shape != self.acceleration.shape or self.velocity.ndim != 1:
            raise OutsideValidityError(
                "velocity and acceleration must be of one length; "
                f"got shapes {self.velocity.shape} and {self.acceleration.shape}"
            )


def cutoff_frequency(sample_rate: float) -> float:
    """Return up to where a recorded motion is looked at: 100 Hz, or a tenth of a sample rate below 1 kHz [Hz]."""
    return min(_HIGHEST_CUTOFF, _CUTOFF_SHARE * sample_rate)


def kinematics_of(position: FloatArray, sample_rate: float) -> Kinematics:
    """Differentiate a measured position, shape (n_samples,), in metres.

    A Butterworth filter of order 4 at :func:`cutoff_frequency`, forwards and backwards so that nothing is delayed, then
    central differences, as in [1]_. The ends, about a tenth of a second, are those of the filter rather than of the
    axis. Too few samples for the filter raise ``OutsideValidityError``.

    References
    ----------
    .. [1] A. Janot, M. Gautier, M. Brunot, Data set and reference models of EMPS, Workshop on Nonlinear System
       Identification Benchmarks, 2019.
    """
    filtering = signal.butter(_ORDER, cutoff_frequency(sample_rate), output="sos", fs=sample_rate)
    fewest = 10 * _ORDER
    if position.size < fewest:
        raise OutsideValidityError(f"a motion needs at least {fewest} samples; got {position.size}")
    smooth = signal.sosfiltfilt(filtering, position)
    second = np.diff(smooth, 2) * sample_rate**2
    return Kinematics(sample_rate, np.gradient(smooth, 1.0 / sample_rate), np.pad(second, 1, mode="edge"))
