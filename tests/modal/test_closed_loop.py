"""The natural frequency of an axis in a speed loop, with and without the reference that the loop follows.

The plant shares no code with the product; the truth is a pole of its matrices (``tests/plant/speed_loop.py``).
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy

from monitor_core.modal import ModalMeasurement, ModeGate, measure_mode
from monitor_core.quality import QualityGate, gate_window
from monitor_core.recording import Rejection, RejectionReason, Window
from monitor_core.spectral import band_spectra, cross_spectra, estimate_frf, joint_input_output, random_error
from tests.modal.test_drive_signals import is_covered, windows_of
from tests.plant.drive import Drive, quantised
from tests.plant.speed_loop import SpeedLoop


def with_reference(windows: list[Window], references) -> list[Window]:
    return [replace(window, reference=samples) for window, samples in zip(windows, references, strict=True)]


@dataclass(frozen=True)
class Draw:
    by_h1: ModalMeasurement | Rejection
    by_reference: ModalMeasurement | Rejection
    truth: float


def drawn(seed: int, *, n_windows: int = 24) -> Draw:
    """Measure an axis of its own, shaken by friction about as much as by its commands.

    One mode is asked for, as with a calibration: with more, what a richer response would move it by joins the
    uncertainty, and intervals are wider than the scatter.
    """
    rng = np.random.default_rng(seed)
    drive = Drive(damping=rng.uniform(1e-4, 2e-4), table_mass=rng.uniform(18.0, 40.0))
    loop = SpeedLoop(drive, bandwidth=rng.uniform(500.0, 750.0), lag=rng.uniform(2e-4, 4e-4))
    position, preload = rng.uniform(0.15, 0.7), rng.uniform(60.0, 350.0)
    reference, current, table = loop.logged(
        position, preload, n_windows=n_windows, n_samples=2000, rng=rng, commanded=1.0, friction=rng.uniform(0.1, 0.2)
    )
    step = rng.choice([1e-8, 1e-7])
    windows = windows_of(quantised(current, 0.005, rng), quantised(table, step, rng), resolution=step)
    truth = float(drive.poles(position, preload)[0])
    gate = ModeGate(maximum_frequency_uncertainty=0.01)
    by_h1, by_reference = (
        measure_mode(chosen, band=(0.7 * truth, 1.4 * truth), gate=gate, maximum_modes=1)
        for chosen in (windows, with_reference(windows, reference))
    )
    return Draw(by_h1, by_reference, truth)


def errors(draws: list[Draw], *, reference: bool) -> tuple[list[float], list[bool]]:
    """Return the errors of frequencies in standard uncertainties, and which intervals hold the truth."""
    answers = [(draw.by_reference if reference else draw.by_h1, draw.truth) for draw in draws]
    found = [(answer.mode.frequency, truth) for answer, truth in answers if isinstance(answer, ModalMeasurement)]
    off = [(frequency.value - truth) / frequency.standard_uncertainty for frequency, truth in found]
    return off, [is_covered(frequency, truth) for frequency, truth in found]


def test_a_reference_takes_off_what_the_loop_does_to_the_frequency_canary() -> None:
    draws = [drawn(seed) for seed in range(6)]
    _, covered = errors(draws, reference=True)
    assert len(covered) >= 5
    assert sum(covered) >= len(covered) - 1
    off, covered_by_h1 = errors(draws, reference=False)
    # all on one side, toward the antiresonance of the motor
    assert np.median(off) < -1.0
    assert sum(covered_by_h1) < sum(covered)


@pytest.mark.release
def test_a_reference_takes_off_what_the_loop_does_to_the_frequency() -> None:
    draws = [drawn(seed) for seed in range(6000, 6220)]
    off, covered = errors(draws, reference=True)
    assert len(covered) >= 200
    # 93 to 97 % is asked for; of so many draws of exactly 95 % so many lie inside but 1 in 1000
    low, high = scipy.stats.binom.ppf([5e-4, 1.0 - 5e-4], len(covered), [0.93, 0.97])
    assert low <= sum(covered) <= high
    assert abs(np.median(off)) < 1.25 * 3.3 / np.sqrt(len(off))
    off_by_h1, covered_by_h1 = errors(draws, reference=False)
    assert np.median(off_by_h1) < -1.0
    assert np.mean(covered_by_h1) < 0.8


def test_line_by_line_it_is_the_joint_input_output_estimator_with_its_random_error() -> None:
    # y = G u + v in a loop u = r - K y: G = 2, K = 0.7 on all lines, no axis
    rng, n, rate = np.random.default_rng(11), 200_000, 1000.0
    reference, disturbance = rng.normal(size=(2, n // 1000, 1000))
    u = (reference - 0.7 * disturbance) / (1.0 + 0.7 * 2.0)
    y = 2.0 * u + disturbance
    band = (50.0, 400.0)
    spectra = band_spectra(u, y, rate, band)
    by_h1 = estimate_frf(cross_spectra(spectra), quantity="accelerance")
    # S_uy/S_uu = (2 S_rr - 0.7 S_vv)/(S_rr + 0.49 S_vv)
    assert np.mean(by_h1.response) == pytest.approx(1.3 / 1.49, abs=0.02)
    joint = estimate_frf(cross_spectra(joint_input_output(spectra, reference, band)), quantity="accelerance")
    error = joint.response - 2.0
    assert abs(np.mean(error)) < 4.0 * np.std(error) / np.sqrt(error.size / 3.0)  # Hann: neighbours are alike
    # var H = S_vv S_rr/(n |S_ru|^2), Soderstrom & Stoica; of each of the two parts half of it
    expected = np.sqrt(0.5 * (1.0 + 0.7 * 2.0) ** 2 / (n // 1000))
    assert np.sqrt(np.mean(np.abs(error) ** 2) / 2.0) == pytest.approx(expected, rel=0.15)
    stated = np.abs(joint.response) * random_error(joint.coherence, joint.n_averages)
    assert np.mean(stated) == pytest.approx(expected, rel=0.1)


def test_windows_with_and_without_a_reference_are_not_averaged_and_a_dead_reference_is_refused() -> None:
    rng = np.random.default_rng(3)
    reference, current, table = SpeedLoop().logged(
        0.3, 200.0, n_windows=6, n_samples=2000, rng=rng, commanded=1.0, friction=0.1
    )
    windows = windows_of(current, table)
    mixed = with_reference(windows[:3], reference[:3]) + windows[3:]
    refusal = measure_mode(mixed, band=(100.0, 200.0), gate=ModeGate())
    assert isinstance(refusal, Rejection)
    assert refusal.reason is RejectionReason.EXCITATION_SOURCE_MISMATCH
    assert refusal.detail == "windows of one measurement must share a reference, or none; got a reference, none"
    (dead,) = with_reference(windows[:1], np.zeros((1, 2000)))
    refused = gate_window(dead, QualityGate())
    assert refused is not None
    assert refused.reason is RejectionReason.DEAD_CHANNEL
    assert refused.detail == "reference must change; got 0 throughout"


def test_a_reference_that_the_loop_does_not_follow_is_refused_and_not_believed() -> None:
    loop, rng = SpeedLoop(Drive(damping=1.5e-4)), np.random.default_rng(4)
    _, current, table = loop.logged(0.3, 200.0, n_windows=12, n_samples=2000, rng=rng, commanded=1.0, friction=0.1)
    windows = with_reference(windows_of(current, table), rng.normal(size=current.shape))
    assert isinstance(measure_mode(windows, band=(100.0, 200.0), gate=ModeGate()), Rejection)


@pytest.mark.parametrize("spike", [10.0, 30.0, 100.0])  # times the usual lines
def test_a_lost_sample_of_a_reference_costs_its_window_and_not_the_measurement(spike: float) -> None:
    drive, rng = Drive(damping=1.5e-4), np.random.default_rng(12)
    reference, current, table = SpeedLoop(drive).logged(
        0.3, 200.0, n_windows=15, n_samples=2000, rng=rng, commanded=1.0, friction=0.1
    )
    truth = float(drive.poles(0.3, 200.0)[0])
    healthy, broken = (
        measure_mode(
            with_reference(windows_of(current, table), samples),
            band=(0.7 * truth, 1.4 * truth),
            gate=ModeGate(maximum_frequency_uncertainty=0.01),
            maximum_modes=1,
        )
        # a spike of 1 is [1, -2, 1] when it is differenced twice
        for samples in (reference, reference + spike * _usual_spike(reference))
    )
    assert isinstance(healthy, ModalMeasurement)
    assert isinstance(broken, ModalMeasurement)
    assert is_covered(broken.mode.frequency, truth)
    assert broken.mode.frequency.standard_uncertainty < 1.3 * healthy.mode.frequency.standard_uncertainty
    said = "the excitation does not go with its reference in windows 4 of 15: not used"
    assert said in broken.warnings
    assert said not in healthy.warnings


def _usual_spike(reference):
    """Return one sample in the fourth window, as strong as all its window is when both are differenced twice."""
    spike = np.zeros_like(reference)
    spike[3, 700] = np.sqrt(np.sum(np.diff(reference[3], 2) ** 2) / 6.0)
    return spike
