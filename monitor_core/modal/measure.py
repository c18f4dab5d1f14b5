"""Measure one mode: average the windows of one position, fit the peak, apply the gates (ISO 13374: DM into SD).

Measurements under another force are hardly comparable, and get a remark: joints with play or friction are softer under
a large force. The natural frequency of a wing with bolted joints (the F-16 of the benchmarks of nonlinear
identification) fell by 2 % at eight times the force; on an axis that reads as a loss.
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import pairwise

import numpy as np

from monitor_core.arrays import SampleArray
from monitor_core.errors import OutsideValidityError
from monitor_core.modal.antiresonance import antiresonance_of
from monitor_core.modal.averaging import AveragedFit, average_and_fit, candidate_peaks, strongest_peaks
from monitor_core.modal.channels import (
    LOWEST,
    Contamination,
    PhaseReference,
    contamination,
    excitation_noise,
    rigid_line,
)
from monitor_core.modal.gates import GateReading, ModeGate, gate_readings, judge_fit, mode_coherence
from monitor_core.modal.refine import LEAST_LINES, ModeFit
from monitor_core.recording import (
    Conditions,
    ExcitationQuantity,
    ExcitationSource,
    Rejection,
    RejectionReason,
    ResponseQuantity,
    Window,
)
from monitor_core.response import FrequencyResponse, ModalParameters
from monitor_core.spectral import (
    BandSpectra,
    Taper,
    cross_spectra,
    estimate_frf,
    joint_input_output,
    least_leaking_taper,
    motion_spectra,
)
from monitor_core.uncertainty import Estimate


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
    excitation_quantity: ExcitationQuantity
    excitation_source: ExcitationSource
    response_quantity: ResponseQuantity
    excitation_level: float  # rms per root hertz around the mode [unit of the excitation/√Hz]
    excitation_rms: float  # over the search band [unit of the excitation]
    taper: Taper  # of the frequency response and coherence
    random_uncertainty: float | None = None  # of that of the frequency, what is new in each measurement [Hz]
    noise_level: float = math.nan  # of what the fit leaves of the response, rms per root hertz [m/(s²·√Hz)]
    leaves_response: bool = False  # whether the excitation explains more than one mode does, where no more was asked
    friction_torque: float | None = None  # over all motion of the windows; None: no motion, position or torque [N·m]
    trace_polarity: int | None = None  # which way the torque drives the position trace, as of ``CrossChecked``
    antiresonance: Estimate | None = None  # of motor angle or speed: the frequency with the motor held [Hz]
    rigid_line: Estimate | None = None  # below the mode; None: not seen [unit of the response]


def measure_mode(
    windows: Sequence[Window],
    *,
    band: tuple[float, float],
    gate: ModeGate,
    phase: PhaseReference | None = None,
    maximum_modes: int = 2,
    lines: tuple[float, float] | None = None,
) -> ModalMeasurement | Rejection:
    """Find the mode in a band from the windows of one measurement, or say why not.

    Average (H1), take the candidate peak that carries most of the response among those whose coherence is above the
    warning level, or else above the least level; fit it by maximum likelihood; drop windows that do not belong, and
    say so; gate on mean coherence over the half-power band, the number of averages that it asks for, phase of the
    residue, uncertainty of the frequency, and ambiguity. What noise on the excitation did to the frequency is taken off
    (:mod:`monitor_core.modal.channels`).

    The windows are gated ones of one measurement, of one rate, one length and one excitation; band and lines are in
    hertz, the lines those of the frequency response that is returned, where more is wanted of it than the band of the
    mode. Without a calibrated polarity and delay the phase is not judged, and the result warns. ``maximum_modes`` is 1
    where a calibration rests on fits of one mode: the frequencies of one and of two modes fitted to the same peak
    differ a little, and a change of model must not look like a change of preload. A refusal is not an error;
    ``OutsideValidityError`` if the band does not lie between 0 Hz and half the sampling rate.

    Examples
    --------
    A mass on a spring at 180 Hz, ζ = 2 %: noise as torque, and the acceleration by its transfer function, with noise.

    >>> from datetime import UTC, datetime, timedelta
    >>> import numpy as np
    >>> import monitor_core as mc
    >>> rng, rate, omega, zeta = np.random.default_rng(1), 2048.0, 2 * np.pi * 180.0, 0.02
    >>> f = np.fft.rfftfreq(16384, 1 / rate)
    >>> torque = np.fft.irfft(np.fft.rfft(rng.standard_normal(16384)) * (f < 600.0))
    >>> s = 2j * np.pi * f
    >>> acceleration = np.fft.irfft(np.fft.rfft(torque) * s**2 / (s**2 + 2 * zeta * omega * s + omega**2))
    >>> acceleration += 0.02 * rng.standard_normal(16384)
    >>> start = datetime(2026, 3, 2, tzinfo=UTC)
    >>> windows = [
    ...     mc.Window(torque[i : i + 2048], acceleration[i : i + 2048], rate, start + timedelta(seconds=i / rate),
    ...               mc.Conditions(0.5), "m")
    ...     for i in range(0, 16384, 2048)
    ... ]
    >>> mode = mc.measure_mode(windows, band=(140.0, 230.0), gate=ModeGate()).mode
    >>> f"{mode.frequency.value:.0f} Hz, {100 * mode.damping_ratio.value:.0f} %"
    '180 Hz, 2 %'
    """
    if (refusal := _check_windows(windows, gate)) is not None:
        return refusal
    lines = lines or band
    every_line, spectra = _spectra_around(windows, band, lines)
    quantity = _quantity_of(windows[0])
    answer = average_and_fit(spectra, band, gate, lines=lines, quantity=quantity, maximum_modes=maximum_modes)
    if isinstance(answer, Rejection):
        return answer
    noisy = _contamination(answer, spectra, windows)
    fit, moved = _without(answer.fit, noisy, windows)
    mode = fit.modes[0]
    coherence = mode_coherence(answer.frf, mode)
    if (refusal := judge_fit(fit, coherence, answer.frf.n_averages, band=band, gate=gate, phase=phase)) is not None:
        return refusal
    mode, distorted = _with_distortion(fit)
    used = [window for window, keep in zip(windows, answer.kept, strict=True) if keep]
    conditions, mixed = _mean_conditions(used)
    return ModalMeasurement(
        mode=mode,
        coherence=coherence,
        n_averages=answer.frf.n_averages,
        n_modes=len(fit.modes),
        tones=fit.tones,
        warnings=(*answer.warnings, *moved, *distorted, *_lost(every_line), *_warnings(coherence, gate, phase), *mixed),
        refused_windows=answer.refused,
        frequency_response=_within(answer.frf, lines),
        conditions=conditions,
        started_at=used[0].started_at,
        measurement=windows[0].measurement,
        excitation_quantity=windows[0].excitation_quantity,
        excitation_source=windows[0].source,
        response_quantity=windows[0].response_quantity,
        excitation_level=_excitation_level(spectra.of_windows(answer.kept), mode),
        excitation_rms=_excitation_rms(spectra.of_windows(answer.kept), band),
        taper=answer.taper,
        random_uncertainty=fit.random_uncertainty,
        noise_level=_noise_level(answer, noisy, spectra),
        leaves_response=fit.leaves_response,
        antiresonance=antiresonance_of(fit, spectra.of_windows(answer.kept))
        if windows[0].response_quantity.is_of_motor
        else None,
        rigid_line=None  # of what is commanded: the table follows, whatever its mass
        if windows[0].excitation_quantity is ExcitationQuantity.ACCELERATION
        else rigid_line(every_line, answer.kept, fit.modes, answer.taper),
    )


def measure_modes(
    windows: Sequence[Window], *, band: tuple[float, float], gate: ModeGate, n_modes: int
) -> tuple[ModalMeasurement | Rejection, ...]:
    """Measure up to so many modes in a band, by rising frequency, each as :func:`measure_mode` does it.

    Of the peaks that may be modes, those of the best class of coherence that carry most of the response are taken; each
    is measured between the middles to its neighbours, on a logarithmic scale, and may be refused for itself. Raises as
    :func:`measure_mode`; a refusal of the windows or of the whole band stands alone.
    """
    if (refusal := _check_windows(windows, gate)) is not None:
        return (refusal,)
    _, spectra = _spectra_around(windows, band, band)
    cross = cross_spectra(spectra, taper=least_leaking_taper(spectra))
    candidates = candidate_peaks(estimate_frf(cross, quantity="accelerance"), band)
    peaks = sorted(candidate.frequency for candidate in strongest_peaks(candidates, cross, gate)[:n_modes])
    if not peaks:
        detail = f"no significant peak from {band[0]:g} to {band[1]:g} Hz in {len(windows)} averages"
        return (Rejection(RejectionReason.NO_PEAK_IN_BAND, detail),)
    middles = [math.sqrt(low * high) for low, high in pairwise(peaks)]
    bands = pairwise([band[0], *middles, band[1]])
    return tuple(measure_mode(windows, band=around, gate=gate) for around in bands)


@dataclass(frozen=True, slots=True, eq=False)
class ModeReadings:
    """What the gates read of the windows of one measurement, refused or not."""

    mode: ModalParameters
    gates: tuple[GateReading, ...]


def read_gates(
    windows: Sequence[Window],
    *,
    band: tuple[float, float],
    gate: ModeGate,
    phase: PhaseReference | None = None,
    maximum_modes: int = 2,
) -> ModeReadings | Rejection:
    """Return what each gate reads of a mode that :func:`measure_mode` finds in the same windows, or refuses.

    A refusal says that no mode could be fitted: then there is nothing that gates could read.
    """
    if (refusal := _check_windows(windows, gate)) is not None:
        return refusal
    _, spectra = _spectra_around(windows, band, band)
    quantity = _quantity_of(windows[0])
    answer = average_and_fit(spectra, band, gate, lines=band, quantity=quantity, maximum_modes=maximum_modes)
    if isinstance(answer, Rejection):
        return answer
    fit, _ = _without(answer.fit, _contamination(answer, spectra, windows), windows)
    coherence = mode_coherence(answer.frf, fit.modes[0])
    readings = gate_readings(fit.modes, coherence, answer.frf.n_averages, band=band, gate=gate, phase=phase)
    return ModeReadings(fit.modes[0], readings)


def averaged_response(windows: Sequence[Window], lines: tuple[float, float]) -> FrequencyResponse | Rejection:
    """Average the response of the windows of one measurement on all lines between two frequencies [Hz], ungated."""
    if (refusal := _check_windows(windows, ModeGate())) is not None:
        return refusal
    high = min(lines[1], 0.5 * windows[0].sample_rate)
    _, spectra = _spectra_around(windows, (lines[0], 0.999 * high), lines)
    quantity = _quantity_of(windows[0])
    return _within(estimate_frf(cross_spectra(spectra, taper=least_leaking_taper(spectra)), quantity=quantity), lines)


def _quantity_of(window: Window) -> str:
    """Name the acceleration per excitation (ISO 7626, ISO 2041)."""
    of_motor = window.response_quantity.is_of_motor
    accelerance = "angular_accelerance" if of_motor else "accelerance"
    if window.excitation_quantity is ExcitationQuantity.ACCELERATION:
        return f"{accelerance}_per_acceleration" if of_motor else "transmissibility"
    return (
        accelerance
        if window.excitation_quantity is ExcitationQuantity.FORCE
        else (f"{window.excitation_quantity}_{accelerance}")
    )


def _check_windows(windows: Sequence[Window], gate: ModeGate) -> Rejection | None:
    """Refuse windows that cannot be averaged together."""
    if len(windows) < gate.minimum_averages:
        return Rejection(
            RejectionReason.TOO_FEW_AVERAGES,
            f"at least {gate.minimum_averages} windows are needed, for one is never judged; got {len(windows)}",
        )
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
    responses = sorted({str(window.response_quantity) for window in windows})
    references = sorted({"none" if window.reference is None else "a reference" for window in windows})
    for what, got in (("an excitation", sources), ("a response", responses), ("a reference, or none", references)):
        if len(got) > 1:
            return Rejection(
                RejectionReason.EXCITATION_SOURCE_MISMATCH,
                f"windows of one measurement must share {what}; got {', '.join(got)}",
            )
    return None


def _spectra_around(
    windows: Sequence[Window], band: tuple[float, float], lines: tuple[float, float]
) -> tuple[BandSpectra, BandSpectra]:
    """Compute spectra over all lines that are wanted, and around the band as far as a fit on its edge often reaches.

    Returned are those that also reach down to the rigid-body line below the mode, and those without it.
    """
    # a fit that would reach farther, of a mode damped by more than 3 % on the upper edge, says so
    sample_rate = windows[0].sample_rate
    margin = max(0.25 * band[1], LEAST_LINES * sample_rate / windows[0].n_samples)
    low, high = min(band[0] - margin, lines[0]), max(band[1] + margin, lines[1])
    around = (max(low, 0.0), min(high, 0.5 * sample_rate))
    if not 0.0 < band[0] < band[1] < 0.5 * sample_rate:
        raise OutsideValidityError(
            f"band must lie between 0 Hz and half the sampling rate, {0.5 * sample_rate:g} Hz; "
            f"got {band[0]:g} to {band[1]:g} Hz"
        )
    excitation: SampleArray = np.array([window.excitation for window in windows])
    response: SampleArray = np.array([window.response for window in windows])
    reach = (min(LOWEST * band[0], around[0]), around[1])
    derivatives = windows[0].response_quantity.derivatives
    every_line = motion_spectra(excitation, response, sample_rate, reach, derivatives=derivatives)
    if windows[0].reference is not None:
        reference: SampleArray = np.array([window.reference for window in windows])
        every_line = joint_input_output(every_line, reference, reach)
    return every_line, every_line.around(*around)


def _excitation_level(spectra: BandSpectra, mode: ModalParameters) -> float:
    """Return the root of the one-sided spectral density of the excitation, mean over the half-power band."""
    half_width = max(mode.damping_ratio.value * mode.frequency.value, spectra.resolution)
    lines = spectra.within(mode.frequency.value - half_width, mode.frequency.value + half_width).excitation
    density = 2.0 * np.mean(np.abs(lines) ** 2, dtype=np.float64) / (spectra.n_samples * spectra.sample_rate)
    return float(np.sqrt(density))


def _excitation_rms(spectra: BandSpectra, band: tuple[float, float]) -> float:
    """Return the rms of what lies in a band, over all windows, by Parseval's theorem."""
    power = np.abs(spectra.within(*band).excitation) ** 2
    return math.sqrt(2.0 * float(np.sum(power, dtype=np.float64)) / spectra.n_windows) / spectra.n_samples


def _contamination(answer: AveragedFit, spectra: BandSpectra, windows: Sequence[Window]) -> Contamination:
    """Tell what noise on the excitation did to the first mode of a fit.

    It is no more than what explains all that the fit leaves: a servo trembles at rest, and the axis answers to that.
    """
    if windows[0].reference is not None:  # no noise on the excitation is common with a reference
        return Contamination(0.0, 0.0)
    at_rest = excitation_noise(np.array([w.excitation for w, keep in zip(windows, answer.kept, strict=True) if keep]))
    left, gain = _left_and_gain(answer)
    noise = min(at_rest, left / gain)
    lines = spectra.of_windows(answer.kept).within(*answer.fit.band)
    return contamination(lines, answer.fit.modes[0].frequency.value, noise, answer.taper)


def _without(fit: ModeFit, noisy: Contamination, windows: Sequence[Window]) -> tuple[ModeFit, tuple[str, ...]]:
    """Take off what noise on the excitation did to the first mode, with half of it as uncertainty, and say so."""
    if noisy.shift == 0.0:
        return fit, ()
    mode, frequency = fit.modes[0], fit.modes[0].frequency
    uncertainty = math.hypot(frequency.standard_uncertainty, 0.5 * noisy.shift)
    without = replace(frequency, value=frequency.value + noisy.shift, standard_uncertainty=uncertainty)
    unit = windows[0].excitation_quantity.unit
    detail = (
        f"noise of {math.sqrt(noisy.noise / windows[0].n_samples):.2g} {unit} rms on the excitation moves the "
        f"frequency by {-noisy.shift:+.2g} Hz: taken off, and half of it joins the uncertainty"
    )
    return replace(fit, modes=(replace(mode, frequency=without), *fit.modes[1:])), (detail,)


def _with_distortion(fit: ModeFit) -> tuple[ModalParameters, tuple[str, ...]]:
    """Add to the uncertainty of the first mode what its windows, all of one excitation, are distorted by alike.

    It joins behind the gates. They ask whether windows determine the mode, and refuse what more, longer or stronger
    windows would mend; a distortion that repeats stays, whatever their number. Refused, a log of such periods could not
    be watched at all, though its interval, widened, says what is not known, and charts take the random part alone.
    """
    mode, frequency = fit.modes[0], fit.modes[0].frequency
    uncertainty = math.hypot(frequency.standard_uncertainty, fit.distortion)
    if uncertainty < _SAID_DISTORTION * frequency.standard_uncertainty:
        return mode, ()
    detail = (
        "all windows repeat one excitation, and with it what distorts the response, as friction does: "
        f"{fit.distortion:.2g} Hz joins the uncertainty"
    )
    return replace(mode, frequency=replace(frequency, standard_uncertainty=uncertainty)), (detail,)


#: A distortion that widens the uncertainty by less is neither added nor said.
_SAID_DISTORTION = 1.05
#: Of the noise around a mode, what stays where noise on the excitation seems to explain all of it.
_LEAST_UNEXPLAINED = 0.1


def _noise_level(answer: AveragedFit, noisy: Contamination, spectra: BandSpectra) -> float:
    """Return the root of the one-sided spectral density of what no torque explains, mean over the band of the fit.

    What noise on the excitation makes of a response is none of it.
    """
    power, gain = _left_and_gain(answer)
    if noisy.noise > 0.0:
        power = max(power - noisy.noise * gain, _LEAST_UNEXPLAINED * power)
    return math.sqrt(2.0 * power / (spectra.n_samples * spectra.sample_rate))


def _left_and_gain(answer: AveragedFit) -> tuple[float, float]:
    """Return the mean squares of what a fit leaves of a line, and of the response, over the band of the fit."""
    left = answer.fit.solution.projection.residual / answer.fit.weight
    gain = _within(answer.frf, answer.fit.band).response
    return float(np.mean(np.abs(left) ** 2)), float(np.mean(np.abs(gain) ** 2))


def _lost(spectra: BandSpectra) -> tuple[str, ...]:
    """Say which windows have no excitation that follows their reference (see ``joint_input_output``)."""
    lost = np.flatnonzero(~spectra.excitation.any(axis=1)) + 1
    if not lost.size:
        return ()
    numbers = ", ".join(map(str, lost))
    return (f"the excitation does not go with its reference in windows {numbers} of {spectra.n_windows}: not used",)


def _warnings(coherence: float, gate: ModeGate, phase: PhaseReference | None) -> tuple[str, ...]:
    warnings = []
    if coherence < gate.warn_coherence:
        warnings.append(f"mean coherence {coherence:.2f} is below {gate.warn_coherence:g}")
    if phase is None:
        warnings.append("phase not judged: polarity and delay are not calibrated")
    return tuple(warnings)


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


#: An excitation this many times above or below the usual one is said. The calibration doubts from here on, too.
COMPARABLE_FACTOR = 1.5


def excitation_remark(measurement: ModalMeasurement, usual: float, of_what: str) -> str | None:
    """Return what is said of a measurement whose excitation is not the usual one; ``None`` where it is.

    ``usual``: the level to compare with [N·m/√Hz] or [N/√Hz]; ``of_what``: whose it is, for the sentence.
    """
    ratio = measurement.excitation_level / usual
    if not (ratio > COMPARABLE_FACTOR or ratio < 1.0 / COMPARABLE_FACTOR):
        return None
    unit = f"{measurement.excitation_quantity.unit}/√Hz"
    return (
        f"the excitation is {ratio:.2g} times that of {of_what} ({measurement.excitation_level:.2g} against "
        f"{usual:.2g} {unit} around the mode): where the frequency follows the force, that would pass for a change of "
        "preload"
    )


def session_remarks(measurements: Sequence[ModalMeasurement]) -> tuple[str | None, ...]:
    """Return a remark for each measurement of a session that was driven otherwise than most of its kind.

    The usual level is the median over the logarithms, of the same quantity from the same source: of two measurements
    each is compared with their geometric mean, so that the remark begins at a factor of 2.25 between them. Where the
    measurements of its conditions show that the frequency falls or rises with the level, the remark says by how much.
    """
    kinds = [(m.excitation_quantity, m.excitation_source) for m in measurements]
    usual = {
        kind: math.exp(
            statistics.median(
                math.log(m.excitation_level)
                for m, of in zip(measurements, kinds, strict=True)
                if of == kind and m.excitation_level > 0.0
            )
        )
        for kind in {kind for m, kind in zip(measurements, kinds, strict=True) if m.excitation_level > 0.0}
    }
    # to a millimetre, along which a frequency changes by less than it is known
    places = [(round(m.conditions.position, 3), m.conditions.payload_mass, m.conditions.preload) for m in measurements]
    remarks = list[str | None]()
    for m, kind, place in zip(measurements, kinds, places, strict=True):
        remark = excitation_remark(m, usual[kind], "the session's median") if kind in usual else None
        if remark is not None:
            alike = [of == (kind, place) for of in zip(kinds, places, strict=True)]
            remark += _dependence_on_level([o for o, same in zip(measurements, alike, strict=True) if same])
        remarks.append(remark)
    return tuple(remarks)


#: Standard uncertainties from which on a dependence on the level is said.
_SAID_FROM = 3.0


def _dependence_on_level(measurements: Sequence[ModalMeasurement]) -> str:
    """Say how the frequency of measurements of the same conditions goes with their level; empty where it does not.

    Weighted least squares of the logarithm of the frequency on that of the level; what scatters about the line more
    than the frequencies' own uncertainty widens that of the slope.
    """
    measurements = [m for m in measurements if m.excitation_level > 0.0]
    levels = np.log([m.excitation_level for m in measurements])
    if np.ptp(levels) < math.log(COMPARABLE_FACTOR):
        return ""
    frequencies = np.array([m.mode.frequency.value for m in measurements])
    own = np.array([m.mode.frequency.standard_uncertainty for m in measurements]) / frequencies
    weight = own**-2
    from_mean = levels - np.average(levels, weights=weight)
    spread = float(np.sum(weight * from_mean**2))
    slope = float(np.sum(weight * from_mean * np.log(frequencies))) / spread
    left = np.log(frequencies) - np.average(np.log(frequencies), weights=weight) - slope * from_mean
    scatter = float(np.sum(weight * left**2)) / max(levels.size - 2, 1)
    if abs(slope) < _SAID_FROM * math.sqrt(max(scatter, 1.0) / spread):
        return ""
    low, high = (measurements[int(end)] for end in (np.argmin(levels), np.argmax(levels)))
    return (
        f"; here it {'falls' if slope < 0.0 else 'rises'} with the level, from {low.mode.frequency.value:.5g} Hz at "
        f"{low.excitation_level:.2g} to {high.mode.frequency.value:.5g} Hz at {high.excitation_level:.2g} "
        f"{low.excitation_quantity.unit}/√Hz"
    )
