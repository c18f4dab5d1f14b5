"""Where the peak of each mode lies, and how well a peak is known."""

import itertools
import math
from collections.abc import Sequence

from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.observations import AssignedPeak, ModalObservation
from monitor_core.fitting.residuals.peak_grid import Band

#: Relative standard uncertainties where an observation states none: a peak read off lines of 1 Hz and more, and the
#: height of a peak as hammer, sensor and a joint's damping repeat it.
FREQUENCY_UNCERTAINTY, AMPLITUDE_UNCERTAINTY = 0.01, 0.20


def mode_bands(peaks: Sequence[AssignedPeak], *, margin: float = 0.35) -> dict[int, Band]:
    """Return a band for each mode: around its measured frequencies, up to half way (geometrically) to the next mode.

    It reaches beyond the measured frequencies by ``margin``, relative. Raises OutsideValidityError if two modes change
    places along the screw, so that no band holds one of them alone.
    """
    extent: dict[int, tuple[float, float]] = {}
    for peak in peaks:
        low, high = extent.get(peak.mode, (math.inf, 0.0))
        extent[peak.mode] = (min(low, peak.observation.frequency), max(high, peak.observation.frequency))
    bands = {}
    for mode, (low, high) in extent.items():
        below = [other for _, other in extent.values() if other < low]
        above = [other for other, _ in extent.values() if other > high]
        lower = max([low / (1.0 + margin), *(math.sqrt(low * other) for other in below)])
        upper = min([high * (1.0 + margin), *(math.sqrt(high * other) for other in above)])
        bands[mode] = Band(lower, upper)
    by_frequency = sorted(bands, key=lambda mode: bands[mode].lower)
    for lower_mode, upper_mode in itertools.pairwise(by_frequency):
        if bands[lower_mode].upper > bands[upper_mode].lower * (1.0 + 1e-9):
            raise OutsideValidityError(
                f"the measured frequencies of modes {lower_mode} and {upper_mode} must not overlap for a band of each; "
                "they cross along the screw, so state bands"
            )
    return bands


def relative_frequency_uncertainty(observation: ModalObservation) -> float:
    """Return the standard uncertainty of the frequency over the frequency [-], the default where none is stated."""
    stated = observation.frequency_uncertainty
    return FREQUENCY_UNCERTAINTY if stated is None else stated / observation.frequency


def relative_amplitude_uncertainty(observation: ModalObservation) -> float:
    """Return the standard uncertainty of the amplitude over the amplitude [-], the default where none is stated."""
    if observation.amplitude is None or observation.amplitude_uncertainty is None:
        return AMPLITUDE_UNCERTAINTY
    return observation.amplitude_uncertainty / observation.amplitude
