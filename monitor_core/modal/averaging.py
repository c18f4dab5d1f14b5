"""Average the windows of a measurement, choose the peak, fit it, and leave out windows that do not belong.

``scipy.signal.find_peaks`` finds the same peaks, but it takes half a second to import, half the start of a command,
and nothing else in measuring modes needs it. ``tests/modal/test_prominence.py`` compares the two.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.modal.gates import ModeGate
from monitor_core.modal.refine import ModeFit, fit_modes, window_misfit
from monitor_core.recording import Rejection, RejectionReason
from monitor_core.response import FrequencyResponse
from monitor_core.spectral import (
    TAPERS,
    BandSpectra,
    CrossSpectra,
    Taper,
    cross_spectra,
    estimate_frf,
    mean_coherence,
    median_misfit,
    outlying,
    random_error,
    significance_level,
)

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
    peaks, prominences = prominent_peaks(log_magnitude, _LEAST_PROMINENCE)
    significant = significance_level(frf.n_averages, false_alarm_probability=0.05 / max(inside.size, 1))
    candidates = []
    for i, prominence in zip(peaks, prominences, strict=True):
        if coherence[i] > significant and prominence > _RIPPLE * random_error(coherence[i], frf.n_averages):
            candidates.append(
                Candidate(
                    frequency=float(frequency[i]),
                    amplitude=float(np.exp(log_magnitude[i])),
                    coherence=float(coherence[i]),
                    prominence=float(prominence),
                    damping_ratio=_half_power_damping(frf, int(inside[i])),
                )
            )
    return tuple(sorted(candidates, key=lambda candidate: -candidate.amplitude))


def _half_power_damping(frf: FrequencyResponse, peak: int) -> float:
    """Return the nearer distance to 1/√2 of the peak over its frequency; the farther may be of a neighbouring mode."""
    below = np.flatnonzero(np.abs(frf.response) < np.abs(frf.response[peak]) / np.sqrt(2.0))
    left = below[below < peak].max(initial=0)
    right = below[below > peak].min(initial=frf.frequency.size - 1)
    frequency = frf.frequency[peak]
    distance = min(frequency - frf.frequency[left], frf.frequency[right] - frequency)
    return float(np.clip(distance / frequency, *_DAMPING_LIMITS))


#: Windows dropped or taken back by the fit change the fit; what has not settled after so many is warned about.
_PASSES = 3
#: Peaks that are fitted, one after another, until one stands out: the strongest.
_MOST_PEAKS = 5
#: Lines in which a peak can be told: the outermost two have no neighbour.
_FEWEST_LINES = 3
#: Share of a window's response that the median response of the windows leaves unexplained, for a gross misfit.
_GROSS_SHARE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class AveragedFit:
    """The windows kept, their average and the fit to them."""

    kept: BoolArray  # shape (n_windows,)
    taper: Taper
    frf: FrequencyResponse  # H1 over the search band and around it
    fit: ModeFit
    refused: tuple[tuple[int, Rejection], ...]  # index of the window, and why
    warnings: tuple[str, ...]


def average_and_fit(
    spectra: BandSpectra,  # un-windowed lines over the search band and as far around it as a fit may reach
    band: tuple[float, float],  # search band [Hz]
    gate: ModeGate,
    *,
    lines: tuple[float, float],  # what the taper and windows that do not belong at all are told by [Hz]
    quantity: str,  # what the response is, e.g. "torque_accelerance"
    maximum_modes: int,  # 1 or 2
) -> AveragedFit | Rejection:
    """Average, choose the peak, fit; leave out windows that do not belong and take back those that do."""
    looked_at = spectra.within(*lines)
    if looked_at.frequency.size < _FEWEST_LINES:
        return Rejection(
            RejectionReason.NO_PEAK_IN_BAND,
            f"at least {_FEWEST_LINES} lines of the spectrum are needed from {lines[0]:g} to {lines[1]:g} Hz; "
            f"got {looked_at.frequency.size}, {spectra.resolution:g} Hz apart",
        )
    taper, gross, first_share = _first_look(looked_at, gate)
    kept = ~gross
    for _ in range(_PASSES):
        if kept.sum() < gate.minimum_averages:
            return Rejection(
                RejectionReason.TOO_FEW_AVERAGES,
                f"at least {gate.minimum_averages} windows are needed; "
                f"{kept.sum()} of {kept.size} are left after outlying ones",
            )
        cross = cross_spectra(spectra.of_windows(kept), taper=taper)
        frf = estimate_frf(cross, quantity=quantity)
        fit: ModeFit | Rejection = Rejection(
            RejectionReason.NO_PEAK_IN_BAND,
            f"no significant peak from {band[0]:g} to {band[1]:g} Hz in {kept.sum()} averages",
        )
        for candidate in strongest_peaks(candidate_peaks(frf, band), cross, gate)[:_MOST_PEAKS]:
            fit = _fit_peak(spectra.of_windows(kept), candidate, maximum_modes, band)
            if not (isinstance(fit, Rejection) and fit.reason is RejectionReason.NO_PEAK_IN_BAND):
                break
        if isinstance(fit, Rejection):
            return fit
        residual, response = window_misfit(fit, spectra)
        share = np.where(gross, first_share, residual / response)
        answer = AveragedFit(kept, taper, frf, fit, _refusals(kept, share), fit.warnings)
        kept = _drop(gross | outlying(residual, response), gate)
        if np.array_equal(kept, answer.kept):
            return answer
    unsettled = (
        f"which windows belong has not settled in {_PASSES} passes: {answer.kept.sum()} of {kept.size} are kept, "
        f"the fit to them would keep {kept.sum()}"
    )
    return replace(answer, warnings=(*answer.warnings, unsettled))


def _first_look(spectra: BandSpectra, gate: ModeGate) -> tuple[Taper, BoolArray, FloatArray]:
    """Choose the taper; return with it the windows far from the median response, and the share it leaves of each.

    It knows nothing of ringing from before the window, so only gross misfits count. They stay out: the fit would take
    a wrong response to an early impact for such ringing.
    """
    looks = []
    for taper in TAPERS:
        residual, response = median_misfit(spectra, taper)
        gross = ~_drop(outlying(residual, response, least_share=_GROSS_SHARE), gate)
        looks.append((mean_coherence(spectra.of_windows(~gross), taper), taper, gross, residual / response))
    _, taper, gross, share = max(looks, key=lambda look: look[0])
    return taper, gross, share


def _drop(flagged: BoolArray, gate: ModeGate) -> BoolArray:
    """Keep what is not flagged; all of it if too much is flagged for "outlying" to be the word."""
    return ~flagged if flagged.mean() <= gate.maximum_outlying_share else np.ones_like(flagged)


def strongest_peaks(candidates: Sequence[Candidate], cross: CrossSpectra, gate: ModeGate) -> list[Candidate]:
    """Return the peaks of the best class of coherence, those that carry most of the response first.

    Not the highest peaks of H1: a null of the excitation makes false ones, whose coherence may even pass, but there the
    axis does not ring. The response explained by the excitation, γ² S_yy = |H1|² S_xx, is small at such a peak.
    """

    def explained_response(candidate: Candidate) -> float:
        line = int(np.argmin(np.abs(cross.frequency - candidate.frequency)))
        return float(candidate.amplitude**2 * cross.excitation_power[line])

    for level in (gate.warn_coherence, gate.minimum_coherence, 0.0):
        passing = [candidate for candidate in candidates if candidate.coherence >= level]
        if passing:
            return sorted(passing, key=explained_response, reverse=True)
    return []


def _fit_peak(
    spectra: BandSpectra, candidate: Candidate, maximum_modes: int, band: tuple[float, float]
) -> ModeFit | Rejection:
    """Fit one or two modes; two within a half-power bandwidth are one peak, fitted as one, with a warning.

    From one measurement to the next it would be unclear which of the two is meant. Half of what the choice moves the
    frequency by joins the uncertainty.
    """

    def fit_up_to(n_modes: int) -> ModeFit | Rejection:
        return fit_modes(
            spectra,
            frequency=candidate.frequency,
            damping_ratio=candidate.damping_ratio,
            maximum_modes=n_modes,
            band=band,
        )

    fit = fit_up_to(maximum_modes)
    if isinstance(fit, Rejection) or len(fit.modes) < 2:
        return fit
    distance = abs(fit.modes[0].frequency.value - fit.modes[1].frequency.value)
    mean_bandwidth = sum(mode.damping_ratio.value * mode.frequency.value for mode in fit.modes)
    single = fit_up_to(1) if distance < mean_bandwidth else fit
    if single is fit or isinstance(single, Rejection):
        return fit
    mode = single.modes[0]
    shift = abs(fit.modes[0].frequency.value - mode.frequency.value)
    uncertainty = math.hypot(mode.frequency.standard_uncertainty, 0.5 * shift)
    widened = replace(mode, frequency=replace(mode.frequency, standard_uncertainty=uncertainty))
    warning = (
        f"two modes {distance:.2g} Hz apart are fitted as one; "
        f"half of the {shift:.2g} Hz that this moves the frequency by joins its uncertainty"
    )
    return replace(single, modes=(widened,), warnings=(*single.warnings, warning))


def _refusals(kept: BoolArray, share: FloatArray) -> tuple[tuple[int, Rejection], ...]:
    usual = float(np.median(share[kept]))
    return tuple(
        (
            int(i),
            Rejection(
                RejectionReason.OUTLYING_WINDOW,
                f"the response common to the other windows leaves {share[i]:.2g} of this window's power near the mode "
                f"unexplained; {usual:.2g} is usual here",
            ),
        )
        for i in np.flatnonzero(~kept)
    )


Lines = npt.NDArray[np.intp]


def prominent_peaks(values: FloatArray, least_prominence: float) -> tuple[Lines, FloatArray]:
    """Return where the peaks are that stand out by so much, and by how much each does; both shape (n_peaks,).

    A peak is higher than its neighbours; of a flat one it is the middle line. Neither end is a peak. Its prominence is
    its height over the higher one of the two lowest values between it and the next higher value, or the end, on either
    side.
    """
    peaks = _local_maxima(values)
    if not peaks.size:
        return peaks, np.empty(0)
    heights = values[peaks].tolist()
    valleys = np.minimum.reduceat(values, np.concatenate(([0], peaks))).tolist()  # before, between and behind
    before = _lowest_before(heights, valleys[:-1])
    behind = _lowest_before(heights[::-1], valleys[:0:-1])[::-1]
    prominences = np.array(heights) - np.maximum(before, behind)
    standing_out = prominences >= least_prominence
    return peaks[standing_out], prominences[standing_out]


def _local_maxima(values: FloatArray) -> Lines:
    starts = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)  # of stretches of equal values
    level = values[starts]
    above = 1 + np.flatnonzero((level[1:-1] > level[:-2]) & (level[1:-1] > level[2:]))
    middles: Lines = (starts[above] + starts[above + 1] - 1) // 2
    return middles


def _lowest_before(heights: Sequence[float], valleys: Sequence[float]) -> list[float]:
    """Return for each peak the lowest value between it and the next higher one in front of it.

    ``valleys``: the lowest value right in front of each peak, behind the peak before it.
    """
    lowest, higher = list[float](), list[tuple[float, float]]()  # the peaks that hide those in front of them
    for height, valley in zip(heights, valleys, strict=True):
        low = valley
        while higher and higher[-1][0] <= height:
            low = min(low, higher.pop()[1])
        lowest.append(low)
        higher.append((height, low))
    return lowest
