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

    minimum_averages: int = 2  # however good they are; how many are needed follows from the two errors below [-]
    maximum_random_error: float = 0.25  # of the response over the half-power band: 8 averages of coherence 0.5 [-]
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


def averages_needed(coherence: float, n_averages: float, gate: ModeGate) -> int:
    r"""Return from how many averages on a response is known well enough, of the coherence that some showed [-].

    .. math:: n \ge \frac{1 - \gamma^2}{2 \gamma^2 \varepsilon^2}, \qquad
        \gamma^2 = \frac{n_d \hat\gamma^2 - 1}{n_d - 1}

    Random error ε of a magnitude: Bendat and Piersol [1]_, Eq. (9.90), solved. A coherence :math:`\hat\gamma^2` of few
    averages is too high, 1/n_d where there is none: the second equation takes that off.

    Examples
    --------
    Five hits of coherence 0.99 are enough, five of 0.5 are not:

    >>> averages_needed(0.99, 5, ModeGate()), averages_needed(0.5, 5, ModeGate())
    (2, 14)

    References
    ----------
    .. [1] J. S. Bendat, A. G. Piersol, Random Data, 4th ed., Wiley, 2010.
    """
    unbiased = (n_averages * coherence - 1.0) / (n_averages - 1.0)
    if unbiased <= 0.0:
        return MOST_AVERAGES
    needed = (1.0 - unbiased) / (2.0 * unbiased * gate.maximum_random_error**2)
    return min(max(gate.minimum_averages, math.ceil(needed)), MOST_AVERAGES)


#: Where a coherence is no higher than chance makes it, no number of averages is known to be enough.
MOST_AVERAGES = 1000


def judge_fit(
    fit: ModeFit,
    coherence: float,
    n_averages: float,
    *,
    band: tuple[float, float],
    gate: ModeGate,
    phase: PhaseReference | None,
) -> Rejection | None:
    """Return the first reason against the first mode of a fit, or ``None``.

    The coherence is its mean over the half-power band, of ``n_averages``, ``band`` where the mode is expected [Hz].
    Without a calibrated
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
    if n_averages < (needed := averages_needed(coherence, n_averages, gate)):
        return Rejection(
            RejectionReason.TOO_FEW_AVERAGES,
            f"at a mean coherence of {coherence:.3f} over the half-power band {needed} windows are needed for a random "
            f"error of {100.0 * gate.maximum_random_error:.0f} %; got {n_averages:.0f}",
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
            f"got {frequency.standard_uncertainty:.3g} Hz from {n_averages:.0f} windows",
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
