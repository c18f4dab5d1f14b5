"""Real impacts measured by others, as windows and as a track of frequencies. Nothing of them is kept in the project."""

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from monitor_core.modal import ModalMeasurement, ModeGate, fit_modes, measure_mode
from monitor_core.quality import QualityGate, gate_window
from monitor_core.recording import Conditions, ExcitationQuantity, Rejection, Window
from monitor_core.spectral import band_average, band_spectra, cross_spectra, estimate_frf

START = datetime(2024, 1, 1, tzinfo=UTC)
SHOCK_BAND = (3000.0, 7000.0)  # of the board [Hz]
BASELINE_SHOCKS = 8


def impact_window(force, response, sample_rate: float, number: int) -> Window:
    """Return one hit as a window; position and time are not part of these records."""
    return Window(
        excitation=force,
        response=response,
        sample_rate=sample_rate,
        started_at=START + timedelta(minutes=number),
        conditions=Conditions(position=0.0),
        measurement="impacts",
        excitation_quantity=ExcitationQuantity.FORCE,
    )


def hammer_hits(measured_data: Path) -> list[Window]:
    """Return the five hits of ``pyfrf_impacts``: 25.6 kHz, force and acceleration."""
    records = [np.load(measured_data / "pyfrf_impacts" / f"measurements_{i}.npy") for i in range(1, 6)]
    return [impact_window(record[1], record[2], 25_600.0, i) for i, record in enumerate(records)]


def board_shocks(measured_data: Path) -> dict[int, Window]:
    """Return the 32 shocks of ``pcb_shock`` by their number: 51.2 kHz, acceleration of table and of board."""
    with np.load(measured_data / "pcb_shock" / "pcb_shock.npz") as records:
        rows = zip(records["idx"], records["X"], records["Y"], strict=True)
        return {int(number): impact_window(x, y, 51_200.0, int(number)) for number, x, y in rows}


@dataclass(frozen=True)
class ShockTrack:
    """Frequency of the board's mode from shock to shock."""

    shock: tuple[int, ...]  # number of the shock
    frequency: tuple[float, ...]  # [Hz]
    random_uncertainty: tuple[float, ...]  # of the single fit; far less than the repeatability [Hz]
    coherence: tuple[float, ...]  # around the mode, of the last eight shocks up to this one [-]
    refused: dict[int, Rejection]  # shocks that the quality gate refused
    baseline: ModalMeasurement  # of the first eight good shocks


def shock_frequency_track(measured_data: Path) -> ShockTrack:
    """Follow the natural frequency of the board through the shocks.

    The mode is found once, in the first eight good shocks averaged: a peak of one shock proves nothing, its coherence
    is 1. From there each shock is fitted by itself – the fit needs no average – always from that start and with two
    modes, as the baseline was, while the coherence is watched over the last eight shocks.
    """
    windows, refused = {}, {}
    for number, window in board_shocks(measured_data).items():
        outcome = gate_window(window, QualityGate())
        if isinstance(outcome, Rejection):
            refused[number] = outcome
        else:
            windows[number] = window
    shocks = list(windows)
    first = [windows[number] for number in shocks[:BASELINE_SHOCKS]]
    baseline = measure_mode(first, band=SHOCK_BAND, gate=ModeGate(maximum_frequency_uncertainty=0.01))
    if isinstance(baseline, Rejection):
        raise AssertionError(f"no mode in the first shocks: {baseline.detail}")

    mode = baseline.mode
    spectra = band_spectra(
        np.stack([windows[number].excitation for number in shocks]),
        np.stack([windows[number].response for number in shocks]),
        51_200.0,
        (500.0, 9000.0),
    )
    frequency, uncertainty, coherence = [], [], []
    for i in range(len(shocks)):
        alone = np.arange(len(shocks)) == i
        fit = fit_modes(
            spectra.of_windows(alone), frequency=mode.frequency.value, damping_ratio=mode.damping_ratio.value
        )
        if isinstance(fit, Rejection):
            raise AssertionError(f"shock {shocks[i]}: {fit.detail}")
        frequency.append(fit.modes[0].frequency.value)
        uncertainty.append(fit.random_uncertainty)
        last = max(i + 1, BASELINE_SHOCKS)
        group = (np.arange(len(shocks)) >= last - BASELINE_SHOCKS) & (np.arange(len(shocks)) < last)
        frf = estimate_frf(cross_spectra(spectra.of_windows(group), taper=baseline.taper), quantity="accelerance")
        half_width = mode.damping_ratio.value * mode.frequency.value
        coherence.append(
            band_average(frf.frequency, frf.coherence, (frequency[-1] - half_width, frequency[-1] + half_width))
        )
    return ShockTrack(tuple(shocks), tuple(frequency), tuple(uncertainty), tuple(coherence), refused, baseline)
