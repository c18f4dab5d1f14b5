"""Unwrap numbers that begin anew: a position modulo the lead or a turn, a count of 16 bits.

Unwrapped where the map says where they wrap (``wraps_at``); else refused, since a jump back is no travel.
"""

from collections.abc import Sequence

import numpy as np

from monitor_core.arrays import FloatArray, SampleArray
from monitor_core.cross_checks import wraps_in
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.raw.channel_time import Run
from monitor_core.recordings.raw.mapping.map_records import MappedChannel

#: Where counts wrap: converters and encoders of so many bits, a turn in degrees, gon or radians.
_USUAL = (*(2.0**bits for bits in (8, 10, 12, 13, 14, 16, 18, 20, 24, 32)), 360.0, 400.0, 2.0 * np.pi)
_TOLERANCE = 0.02  # of a usual count: the sample before the wrap stands below it


def unwrapped(samples: SampleArray, source: MappedChannel, where: str, runs: Sequence[Run] = ()) -> SampleArray:
    """Return numbers that go on where they began anew; others as they are.

    ``RecordingFormatError`` if they wrap and the map does not say where, or if it says so of windows in an array, or of
    samples with a break, in which they may go on by any number of turns.

    Examples
    --------
    >>> turns = MappedChannel("a", "deg", 1.0, float, wraps_at=360.0)
    >>> unwrapped(np.array([350.0, 355.0, 0.0, 5.0]), turns, "example").tolist()
    [350.0, 355.0, 360.0, 365.0]

    """
    if samples.ndim != 1 and source.wraps_at is not None:
        raise RecordingFormatError(f"{where}: expected one-dimensional numbers for wraps_at; got shape {samples.shape}")
    if source.wraps_at is not None and len(runs) > 1:
        raise RecordingFormatError(
            f"{where}: expected samples without a break for wraps_at; got one behind sample {runs[0].n_samples - 1}: "
            "how many turns lie in it, the file does not say; give the parts as files of their own"
        )
    if samples.ndim != 1 or samples.size < 3:
        return samples
    if source.wraps_at is not None:
        is_finite = np.isfinite(samples)
        going_on = samples.astype(np.float64)
        going_on[is_finite] = np.unwrap(going_on[is_finite], period=source.wraps_at)
        return going_on
    finite = samples[np.isfinite(samples)].astype(np.float64)
    if finite.size < samples.size // 2 + 1:
        return samples
    steps: FloatArray = np.diff(samples.astype(np.float64))
    wraps = wraps_in(steps, float(np.ptp(finite)))
    if wraps.any():
        first = int(np.argmax(wraps))
        size = float(np.nanmax(np.abs(steps)))
        usual = next((count for count in _USUAL if abs(count - size) <= _TOLERANCE * count), None)
        count = "where they do" if usual is None else f"{usual:.12g}"
        raise RecordingFormatError(
            f"{where}: expected numbers that do not begin anew; they jump by {steps[first]:.6g} behind sample {first}, "
            f"against the way they go, as a count that wraps: wraps_at = {count} in the map unwraps them"
        )
    return samples
