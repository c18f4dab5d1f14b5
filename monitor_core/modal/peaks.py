"""Find candidate modes: significant, prominent peaks of a measured frequency response."""

from dataclasses import dataclass

import numpy as np
import scipy.signal

from monitor_core.errors import OutsideValidityError
from monitor_core.response import FrequencyResponse
from monitor_core.spectral import random_error, significance_level

#: A ripple of the estimate reaches this many standard deviations of its own random error about once in 10⁴ lines.
_RIPPLE = 4.0
_LEAST_PROMINENCE = 0.1  # of the logarithm of the magnitude: 0.9 dB [-]
_DAMPING_LIMITS = (5e-4, 0.15)


@dataclass(frozen=True, slots=True)
class Candidate:
    """A peak of a frequency response that may be a mode."""

    frequency: float  # of the highest line [Hz]
    amplitude: float  # magnitude there [unit of the response]
    coherence: float  # there [-]
    prominence: float  # of the logarithm of the magnitude [-]
    damping_ratio: float  # rough, from the half-power width [-]


def candidate_peaks(frf: FrequencyResponse, band: tuple[float, float]) -> tuple[Candidate, ...]:
    """Find the peaks in a band that rise above chance, the highest first.

    A peak is a line higher than its neighbours whose coherence is significant at 5 % for the band as a whole (0.05
    shared out among its lines) and whose magnitude stands out of its surroundings by more than 0.9 dB and by more than
    four times its own random error.

    The response needs a coherence, so at least two averages: one average must not be judged, and raises
    ``OutsideValidityError``.
    """
    if frf.coherence is None:
        raise OutsideValidityError("candidates need a coherence, so at least 2 averages; got a response without")
    inside = np.flatnonzero((frf.frequency >= band[0]) & (frf.frequency <= band[1]))
    # One line beyond the band on either side, so that a peak on its edge is seen as one.
    inside = np.arange(max(inside[0] - 1, 0), min(inside[-1] + 2, frf.frequency.size)) if inside.size else inside
    frequency, coherence = frf.frequency[inside], frf.coherence[inside]
    log_magnitude = np.log(np.abs(frf.response[inside]))
    peaks, properties = scipy.signal.find_peaks(log_magnitude, prominence=_LEAST_PROMINENCE)
    significant = significance_level(frf.n_averages, false_alarm_probability=0.05 / max(inside.size, 1))
    found = []
    for i, prominence in zip(peaks, properties["prominences"], strict=True):
        if coherence[i] > significant and prominence > _RIPPLE * random_error(coherence[i], frf.n_averages):
            found.append(
                Candidate(
                    frequency=float(frequency[i]),
                    amplitude=float(np.exp(log_magnitude[i])),
                    coherence=float(coherence[i]),
                    prominence=float(prominence),
                    damping_ratio=_half_power_damping(frf, int(inside[i])),
                )
            )
    return tuple(sorted(found, key=lambda candidate: -candidate.amplitude))


def _half_power_damping(frf: FrequencyResponse, peak: int) -> float:
    """Return the nearer distance to 1/√2 of the peak over its frequency; the farther may be of a neighbouring mode."""
    below = np.flatnonzero(np.abs(frf.response) < np.abs(frf.response[peak]) / np.sqrt(2.0))
    left = below[below < peak].max(initial=0)
    right = below[below > peak].min(initial=frf.frequency.size - 1)
    at = frf.frequency[peak]
    distance = min(at - frf.frequency[left], frf.frequency[right] - at)
    return float(np.clip(distance / at, *_DAMPING_LIMITS))
