"""Judge whether a measurement is good enough to be used."""

import math
from dataclasses import dataclass

from monitor_core.errors import OutsideValidityError
from monitor_core.modal.phase import PhaseReference
from monitor_core.modal.refine import ModeFit
from monitor_core.recording import Rejection, RejectionReason
from monitor_core.response import FrequencyResponse, ModalParameters
from monitor_core.spectral import band_average


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


def mode_coherence(frf: FrequencyResponse, mode: ModalParameters) -> float:
    """Return the mean coherence over the half-power band, as estimated: thresholds are stated for the biased value."""
    f, zeta = mode.frequency.value, mode.damping_ratio.value
    if frf.coherence is None:
        raise OutsideValidityError("coherence needs at least 2 averages; got a response without")
    return band_average(frf.frequency, frf.coherence, (f * (1.0 - zeta), f * (1.0 + zeta)))


def judge_fit(
    fit: ModeFit,
    coherence: float,
    *,
    band: tuple[float, float],
    gate: ModeGate,
    phase: PhaseReference | None,
) -> Rejection | None:
    """Return the first reason against the first mode of a fit, or ``None``.

    The coherence is its mean over the half-power band, ``band`` where the mode is expected [Hz]. Without a calibrated
    polarity and delay the phase is not judged.
    """
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
    return _ambiguity(fit, band, gate)


def _ambiguity(fit: ModeFit, band: tuple[float, float], gate: ModeGate) -> Rejection | None:
    """Refuse two overlapping modes of like height in the band."""
    if len(fit.modes) < 2:
        return None
    first, second = fit.modes
    f1, f2 = first.frequency.value, second.frequency.value
    height = [abs(m.residue) / (2.0 * m.damping_ratio.value * m.frequency.value**2) for m in (first, second)]
    bandwidth = 2.0 * max(m.damping_ratio.value * m.frequency.value for m in (first, second))
    apart = abs(f1 - f2) > 2.0 * bandwidth or not band[0] <= f2 <= band[1]
    if apart or min(height) < gate.ambiguity_ratio * max(height):
        return None
    return Rejection(
        RejectionReason.AMBIGUOUS_MODES,
        f"two overlapping modes of like height, at {f1:.6g} and {f2:.6g} Hz; narrow the band to one of them",
    )
