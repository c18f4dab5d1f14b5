"""One measurement: windows of one position averaged, fitted, gated (ISO 13374: DM into SD)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from monitor_core.arrays import BoolArray
from monitor_core.errors import OutsideValidityError
from monitor_core.modal.outliers import outlying, suspected
from monitor_core.modal.peaks import Candidate, candidate_peaks
from monitor_core.modal.phase import PhaseReference
from monitor_core.modal.refine import ModeFit, fit_modes, window_misfit
from monitor_core.recording import (
    Conditions,
    ExcitationQuantity,
    ExcitationSource,
    Rejection,
    RejectionReason,
    Window,
)
from monitor_core.response import FrequencyResponse, ModalParameters
from monitor_core.spectral import (
    BandSpectra,
    CrossSpectra,
    Taper,
    band_average,
    band_spectra,
    cross_spectra,
    estimate_frf,
    least_leaking_taper,
)


#: Windows dropped or taken back by the fit change the fit; twice settles it.
_PASSES = 3


@dataclass(frozen=True, slots=True)
class ModeGate:
    """What a measurement must meet to be judged."""

    minimum_averages: int = 8
    minimum_coherence: float = 0.5  # mean over the half-power band; refused below [-]
    warn_coherence: float = 0.8  # the same; a peak above it goes before a higher one below it [-]
    phase_tolerance: float = math.radians(25.0)  # of the residue about its calibrated phase [rad]
    maximum_frequency_uncertainty: float = 0.5  # standard uncertainty [Hz]
    ambiguity_ratio: float = 0.5  # two overlapping modes whose peaks are closer than that cannot be told apart [-]
    maximum_outlying_share: float = 0.25  # of the windows; with more, none is dropped [-]

    def __post_init__(self) -> None:
        if self.minimum_averages < 2:
            raise OutsideValidityError(
                f"minimum_averages must be at least 2, for one average is never judged; got {self.minimum_averages}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class ModalMeasurement:
    """The mode of one measurement with everything it rests on."""

    mode: ModalParameters
    coherence: float  # mean over the half-power band [-]
    n_averages: float  # effective number of independent averages [-]
    n_modes: int  # fitted together
    tones: tuple[float, ...]  # persistent sines removed [Hz]
    warnings: tuple[str, ...]
    refused_windows: tuple[tuple[int, Rejection], ...]  # index in the measurement, and why
    frequency_response: FrequencyResponse  # H1 in the search band, of the windows kept
    conditions: Conditions  # mean over the windows kept
    started_at: datetime  # of the first window kept
    measurement: str
    excitation_source: ExcitationSource
    taper: Taper  # of the frequency response and coherence


def measure_mode(
    windows: Sequence[Window],
    *,
    band: tuple[float, float],
    gate: ModeGate,
    phase: PhaseReference | None = None,
    expected_frequency: float | None = None,
) -> ModalMeasurement | Rejection:
    """Find the mode in a band from the windows of one measurement, or say why not.

    Average (H1), take the candidate peak that carries most of the response among those whose coherence is above the
    warning level, or else above the least level; fit it by maximum likelihood; drop windows that do not belong, and say so; gate on mean
    coherence over the half-power band, phase of the residue, uncertainty of the frequency, and ambiguity.

    Parameters
    ----------
    windows : sequence of Window
        Gated windows of one measurement: one rate, one length, one excitation.
    band : tuple of float
        Where the mode is expected. [Hz]
    gate : ModeGate
        What must be met.
    phase : PhaseReference, optional
        Calibrated polarity and delay; without it the phase is not judged, and the result warns.
    expected_frequency : float, optional
        Where the calibrated model expects the mode; the nearest candidate is then taken instead of the highest. [Hz]

    Returns
    -------
    ModalMeasurement or Rejection
        The outcome; a refusal is not an error.

    Raises
    ------
    OutsideValidityError
        If the band does not lie between 0 Hz and half the sampling rate.
    """
    if (refusal := _check_windows(windows, gate)) is not None:
        return refusal
    spectra = _spectra_around(windows, band)
    quantity = "accelerance" if windows[0].excitation_quantity is ExcitationQuantity.FORCE else "torque_accelerance"
    searched_band = spectra.within(*band)
    taper = least_leaking_taper(searched_band)
    flagged = suspected(searched_band, taper)
    for _ in range(_PASSES):
        kept = _drop(flagged, gate)
        if kept.sum() < gate.minimum_averages:
            return _too_few(int(kept.sum()), len(windows), gate)
        cross = cross_spectra(spectra.of_windows(kept), taper=taper)
        frf = estimate_frf(cross, quantity=quantity)
        candidate = _choose(candidate_peaks(frf, band), cross, gate, expected_frequency)
        if candidate is None:
            return Rejection(
                RejectionReason.NO_PEAK_IN_BAND,
                f"no significant peak from {band[0]:g} to {band[1]:g} Hz in {kept.sum()} averages",
            )
        fit = fit_modes(
            spectra.of_windows(kept), frequency=candidate.frequency, damping_ratio=candidate.damping_ratio
        )
        if isinstance(fit, Rejection):
            return fit
        flagged = outlying(*window_misfit(fit, spectra))
        if np.array_equal(_drop(flagged, gate), kept):
            break
    coherence = _mean_coherence(frf, fit.modes[0])
    if (refusal := _gate(fit, coherence, band, gate, phase, expected_frequency)) is not None:
        return refusal
    used = [window for window, keep in zip(windows, kept, strict=True) if keep]
    conditions, mixed = _mean_conditions(used)
    return ModalMeasurement(
        mode=fit.modes[0],
        coherence=coherence,
        n_averages=frf.n_averages,
        n_modes=len(fit.modes),
        tones=fit.tones,
        warnings=(*_warnings(fit, coherence, gate, phase), *mixed),
        refused_windows=_refusals(fit, spectra, kept),
        frequency_response=_within(frf, band),
        conditions=conditions,
        started_at=used[0].started_at,
        measurement=windows[0].measurement,
        excitation_source=windows[0].excitation_source,
        taper=taper,
    )


def _check_windows(windows: Sequence[Window], gate: ModeGate) -> Rejection | None:
    """Refuse windows that cannot be averaged together."""
    if len(windows) < gate.minimum_averages:
        return _too_few(len(windows), len(windows), gate)
    rates = sorted({window.sample_rate for window in windows})
    if len(rates) > 1:
        return Rejection(
            RejectionReason.SAMPLE_RATE_MISMATCH,
            f"windows of one measurement must share a sampling rate; got {rates[0]:g} to {rates[-1]:g} Hz",
        )
    lengths = sorted({window.n_samples for window in windows})
    if len(lengths) > 1:
        return Rejection(
            RejectionReason.LENGTH_MISMATCH,
            f"windows of one measurement must be of one length; got {lengths[0]} to {lengths[-1]} samples",
        )
    sources = sorted({f"{window.excitation_quantity} from {window.excitation_source}" for window in windows})
    if len(sources) > 1:
        return Rejection(
            RejectionReason.EXCITATION_SOURCE_MISMATCH,
            f"windows of one measurement must share an excitation; got {', '.join(sources)}",
        )
    return None


def _too_few(n_kept: int, n_windows: int, gate: ModeGate) -> Rejection:
    return Rejection(
        RejectionReason.TOO_FEW_AVERAGES,
        f"at least {gate.minimum_averages} windows are needed; got {n_kept}"
        + (f" of {n_windows} after outlying ones" if n_kept < n_windows else ""),
    )


def _spectra_around(windows: Sequence[Window], band: tuple[float, float]) -> BandSpectra:
    """Transform once, over the search band and as far around it as the fit of a mode on its edge may reach."""
    margin = max(40.0, 0.25 * band[1])
    sample_rate = windows[0].sample_rate
    around = (max(band[0] - margin, 0.0), min(band[1] + margin, 0.5 * sample_rate))
    if not 0.0 < band[0] < band[1] < 0.5 * sample_rate:
        raise OutsideValidityError(
            f"band must lie between 0 Hz and half the sampling rate, {0.5 * sample_rate:g} Hz; "
            f"got {band[0]:g} to {band[1]:g} Hz"
        )
    excitation = np.stack([window.excitation for window in windows])
    response = np.stack([window.response for window in windows])
    return band_spectra(excitation, response, sample_rate, around)


def _drop(flagged: BoolArray, gate: ModeGate) -> BoolArray:
    """Keep what is not flagged; all of it if too much is flagged for "outlying" to be the word."""
    return ~flagged if flagged.mean() <= gate.maximum_outlying_share else np.ones_like(flagged)


def _choose(
    candidates: Sequence[Candidate], cross: CrossSpectra, gate: ModeGate, expected_frequency: float | None
) -> Candidate | None:
    """Take the peak that carries most of the response, or the one nearest to what is expected.

    Only peaks of the best class of coherence compete. Not the highest peak of H1: a null of the excitation makes false
    ones, whose coherence may even pass, but there the axis does not ring. The response explained by the excitation,
    γ² S_yy = |H1|² S_xx, is small at such a peak.
    """

    def preference(candidate: Candidate) -> float:
        if expected_frequency is not None:
            return -abs(candidate.frequency - expected_frequency)
        line = int(np.argmin(np.abs(cross.frequency - candidate.frequency)))
        return float(candidate.amplitude**2 * cross.excitation_power[line])

    for level in (gate.warn_coherence, gate.minimum_coherence, 0.0):
        passing = [candidate for candidate in candidates if candidate.coherence >= level]
        if passing:
            return max(passing, key=preference)
    return None


def _mean_coherence(frf: FrequencyResponse, mode: ModalParameters) -> float:
    """Average over the half-power band; its biased value, for thresholds are stated for that."""
    f, zeta = mode.frequency.value, mode.damping_ratio.value
    assert frf.coherence is not None  # noqa: S101  at least two averages, by the gate
    return band_average(frf.frequency, frf.coherence, (f * (1.0 - zeta), f * (1.0 + zeta)))


def _gate(
    fit: ModeFit,
    coherence: float,
    band: tuple[float, float],
    gate: ModeGate,
    phase: PhaseReference | None,
    expected_frequency: float | None,
) -> Rejection | None:
    mode = fit.modes[0]
    frequency = mode.frequency
    if not band[0] <= frequency.value <= band[1]:
        return Rejection(
            RejectionReason.NO_PEAK_IN_BAND,
            f"the mode lies at {frequency.value:.6g} Hz, outside {band[0]:g} to {band[1]:g} Hz",
        )
    if coherence < gate.minimum_coherence:
        return Rejection(
            RejectionReason.LOW_COHERENCE,
            f"mean coherence over the half-power band must reach {gate.minimum_coherence:g}; got {coherence:.3f}",
        )
    if phase is not None and abs(deviation := phase.deviation(mode)) > gate.phase_tolerance:
        return Rejection(
            RejectionReason.WRONG_PHASE,
            f"phase of the residue must lie within {math.degrees(gate.phase_tolerance):.0f}° of its calibration; "
            f"got {math.degrees(deviation):.0f}°",
        )
    if frequency.standard_uncertainty > gate.maximum_frequency_uncertainty:
        return Rejection(
            RejectionReason.UNCERTAIN_FREQUENCY,
            f"standard uncertainty of the frequency must not exceed {gate.maximum_frequency_uncertainty:g} Hz; "
            f"got {frequency.standard_uncertainty:.3g} Hz",
        )
    return _ambiguity(fit, band, gate, expected_frequency)


def _ambiguity(
    fit: ModeFit, band: tuple[float, float], gate: ModeGate, expected_frequency: float | None
) -> Rejection | None:
    """Refuse two overlapping modes of like height in the band, unless one of them was clearly expected."""
    if len(fit.modes) < 2:
        return None
    first, second = fit.modes
    f1, f2 = first.frequency.value, second.frequency.value
    height = [abs(m.residue) / (2.0 * m.damping_ratio.value * m.frequency.value**2) for m in (first, second)]
    bandwidth = 2.0 * max(m.damping_ratio.value * m.frequency.value for m in (first, second))
    apart = abs(f1 - f2) > 2.0 * bandwidth or not band[0] <= f2 <= band[1]
    expected = expected_frequency is not None and 2.0 * abs(f1 - expected_frequency) < abs(f2 - expected_frequency)
    if apart or expected or min(height) < gate.ambiguity_ratio * max(height):
        return None
    return Rejection(
        RejectionReason.AMBIGUOUS_MODES,
        f"two overlapping modes of like height, at {f1:.6g} and {f2:.6g} Hz; narrow the band or state what is expected",
    )


def _warnings(fit: ModeFit, coherence: float, gate: ModeGate, phase: PhaseReference | None) -> tuple[str, ...]:
    warnings = []
    if coherence < gate.warn_coherence:
        warnings.append(f"mean coherence {coherence:.2f} is below {gate.warn_coherence:g}")
    if phase is None:
        warnings.append("phase not judged: polarity and delay are not calibrated")
    return tuple(warnings)


def _refusals(fit: ModeFit, spectra: BandSpectra, kept: BoolArray) -> tuple[tuple[int, Rejection], ...]:
    residual, response = window_misfit(fit, spectra)
    share = residual / response
    usual = float(np.median(share[kept]))
    return tuple(
        (
            int(i),
            Rejection(
                RejectionReason.OUTLYING_WINDOW,
                f"the common response leaves {share[i]:.1%} of this window's response in the band unexplained; "
                f"{usual:.1%} of a window is usual here",
            ),
        )
        for i in np.flatnonzero(~kept)
    )


def _mean_conditions(windows: Sequence[Window]) -> tuple[Conditions, tuple[str, ...]]:
    """Average what all windows state; what only some state, or state differently, is said."""
    warnings = []
    means: dict[str, float | None] = {}
    for name, unit in (("payload_mass", "kg"), ("temperature", "°C"), ("preload", "N")):
        stated = [value for w in windows if (value := getattr(w.conditions, name)) is not None]
        means[name] = float(np.mean(stated)) if len(stated) == len(windows) else None
        if 0 < len(stated) < len(windows):
            warnings.append(f"{name} is stated for {len(stated)} of {len(windows)} windows only, and not used")
        elif name != "temperature" and stated and min(stated) != max(stated):
            warnings.append(f"{name} differs within the measurement: {min(stated):g} to {max(stated):g} {unit}")
    position = float(np.mean([w.conditions.position for w in windows]))
    return Conditions(position, means["payload_mass"], means["temperature"], means["preload"]), tuple(warnings)


def _within(frf: FrequencyResponse, band: tuple[float, float]) -> FrequencyResponse:
    inside = (frf.frequency >= band[0]) & (frf.frequency <= band[1])
    coherence = frf.coherence[inside] if frf.coherence is not None else None
    return FrequencyResponse(frf.frequency[inside], frf.response[inside], frf.quantity, coherence, frf.n_averages)
