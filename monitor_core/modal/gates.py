"""Judge whether a measurement is good enough to be used."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from monitor_core.errors import OutsideValidityError
from monitor_core.modal.channels import PhaseReference
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
    maximum_frequency_uncertainty: float = 0.003  # standard uncertainty, of the frequency: 0.5 Hz at 170 Hz [-]
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


@dataclass(frozen=True, slots=True)
class GateReading:
    """What a gate read of a measurement, and within which limits it lets it pass; an open side is None."""

    gate: RejectionReason  # by which it refuses
    value: float
    unit: str  # of value and limits; empty: a ratio
    lower: float | None = None
    upper: float | None = None

    @property
    def passed(self) -> bool:
        """Whether the value lies within the limits."""
        return (self.lower is None or self.value >= self.lower) and (self.upper is None or self.value <= self.upper)


def gate_readings(
    modes: Sequence[ModalParameters],
    coherence: float,
    n_averages: float,
    *,
    band: tuple[float, float],
    gate: ModeGate,
    phase: PhaseReference | None,
) -> tuple[GateReading, ...]:
    """Return what each gate reads of fitted modes, the one that is meant first, in the order in which they refuse.

    Arguments as of :func:`judge_fit`. A gate that has nothing to read is left out: the phase without a calibrated one,
    the second mode where none overlaps with the first.
    """
    mode = modes[0]
    read = [
        GateReading(RejectionReason.NO_PEAK_IN_BAND, mode.frequency.value, "Hz", *band),
        GateReading(RejectionReason.LOW_COHERENCE, coherence, "", gate.minimum_coherence),
        GateReading(RejectionReason.TOO_FEW_AVERAGES, n_averages, "", averages_needed(coherence, n_averages, gate)),
    ]
    if phase is not None:
        tolerance = math.degrees(gate.phase_tolerance)
        deviation = math.degrees(phase.deviation(mode))
        read.append(GateReading(RejectionReason.WRONG_PHASE, deviation, "°", -tolerance, tolerance))
    uncertainty, most = mode.frequency.standard_uncertainty, gate.maximum_frequency_uncertainty * mode.frequency.value
    read.append(GateReading(RejectionReason.UNCERTAIN_FREQUENCY, uncertainty, "Hz", upper=most))
    if len(modes) > 1 and (likeness := _likeness(modes[0], modes[1], band)) is not None:
        read.append(GateReading(RejectionReason.AMBIGUOUS_MODES, likeness, "", upper=gate.ambiguity_ratio))
    return tuple(read)


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
    readings = gate_readings(fit.modes, coherence, n_averages, band=band, gate=gate, phase=phase)
    failed = next((reading for reading in readings if not reading.passed), None)
    return None if failed is None else Rejection(failed.gate, _detail(failed, fit, coherence, n_averages, gate))


def _detail(failed: GateReading, fit: ModeFit, coherence: float, n_averages: float, gate: ModeGate) -> str:
    """Say in a sentence what a gate wanted and what it got."""
    match failed.gate:
        case RejectionReason.NO_PEAK_IN_BAND:
            return f"the mode lies at {failed.value:.6g} Hz, outside {failed.lower:g} to {failed.upper:g} Hz"
        case RejectionReason.LOW_COHERENCE:
            return f"mean coherence over the half-power band must reach {failed.lower:g}; got {failed.value:.3f}"
        case RejectionReason.TOO_FEW_AVERAGES:
            return (
                f"at a mean coherence of {coherence:.3f} over the half-power band {failed.lower:.0f} windows are "
                f"needed for a random error of {100.0 * gate.maximum_random_error:.0f} %; got {n_averages:.0f}"
            )
        case RejectionReason.WRONG_PHASE:
            return (
                f"phase of the residue must lie within {failed.upper:.0f}° of its calibration; got {failed.value:.0f}°"
            )
        case RejectionReason.UNCERTAIN_FREQUENCY:
            return (
                f"standard uncertainty of the frequency must not exceed {failed.upper:g} Hz; "
                f"got {failed.value:.3g} Hz from {n_averages:.0f} windows"
            )
        case _:
            first, second = (mode.frequency.value for mode in fit.modes[:2])
            return (
                f"two overlapping modes of like height, at {first:.6g} and {second:.6g} Hz; narrow the band to one of "
                "them"
            )


def _likeness(first: ModalParameters, second: ModalParameters, band: tuple[float, float]) -> float | None:
    """Return the height of the lower of two peaks over that of the higher; None if they do not overlap in the band."""
    f1, f2 = first.frequency.value, second.frequency.value
    height = [abs(m.residue) / (2.0 * m.damping_ratio.value * m.frequency.value**2) for m in (first, second)]
    bandwidth = 2.0 * max(m.damping_ratio.value * m.frequency.value for m in (first, second))
    apart = abs(f1 - f2) > 2.0 * bandwidth or not band[0] <= f2 <= band[1]
    return None if apart else min(height) / max(height)
