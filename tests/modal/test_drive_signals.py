"""Modes from what a control logs: current or a commanded acceleration, and a scale, an encoder or a speed.

The truth is that of a drive in closed loop that shares no code with the product (``tests/plant/drive.py``).
"""

from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
import scipy

from monitor_core.modal import ModalMeasurement, ModeGate, measure_mode
from monitor_core.quality import QualityGate, gate_window
from monitor_core.recording import (
    Conditions,
    ExcitationQuantity,
    ExcitationSource,
    Rejection,
    RejectionReason,
    ResponseQuantity,
    Window,
)
from monitor_core.spectral import motion_spectra
from tests.plant.drive import Drive, delayed, quantised, run

START = datetime(2026, 3, 2, 6, tzinfo=UTC)
NM = 1e-9


def windows_of(
    excitation,
    response,
    quantity=ResponseQuantity.DISPLACEMENT,
    *,
    driven_by=ExcitationQuantity.CURRENT,
    resolution=None,
) -> list[Window]:
    source = ExcitationSource.DRIVE if driven_by is ExcitationQuantity.CURRENT else ExcitationSource.COMMANDED
    return [
        Window(x, y, Drive().sample_rate, START + timedelta(seconds=3 * k), Conditions(0.3), "m", driven_by, source,
               response_quantity=quantity, response_resolution=resolution)
        for k, (x, y) in enumerate(zip(excitation, response, strict=True))
    ]  # fmt: skip


def measured(windows, around: float, **stated) -> ModalMeasurement:
    answer = measure_mode(windows, band=(0.6 * around, 1.6 * around), gate=ModeGate(), **stated)
    assert isinstance(answer, ModalMeasurement), answer
    return answer


def is_covered(estimate, truth: float) -> bool:
    reach = scipy.stats.t.ppf(0.975, estimate.degrees_of_freedom) * estimate.standard_uncertainty
    return bool(abs(estimate.value - truth) <= reach)


# ---- the derivative -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("quantity", "derivatives"), [("displacement", 2), ("velocity", 1)])
def test_a_sampled_sine_has_the_acceleration_of_a_sine(quantity, derivatives) -> None:
    assert ResponseQuantity(quantity).derivatives == derivatives
    rate, n = 2000.0, 2000
    time = np.arange(n) / rate
    for f in (7.0, 125.0, 612.0, 940.0):
        wave = np.cos(2.0 * np.pi * f * time + 0.3)
        # Hann: the samples that the ends lack count for nothing
        spectra = motion_spectra(wave[None], wave[None], rate, (f - 3.0, f + 3.0), derivatives=derivatives)
        _, plain, derived = spectra.tapered("hann")
        at = int(np.argmax(np.abs(plain[0])))
        assert derived[0, at] / plain[0, at] == pytest.approx((2j * np.pi * f) ** derivatives, rel=1e-4)


# ---- one axis, all responses ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def logged():
    drive = Drive(damping=5e-5)
    log = run(drive, 0.3, 200.0, n_windows=8, n_samples=2000, rng=np.random.default_rng(4), disturbance=2.0)
    return drive, log, float(drive.poles(0.3, 200.0)[0])


def responses_of(log, drive, rng):
    encoder = quantised(log.motor_angle, 2.0 * np.pi / 2**20, rng)
    relative = encoder * drive.transmission - quantised(log.table, 10.0 * NM, rng)
    return {
        ResponseQuantity.ACCELERATION: log.table_acceleration,
        ResponseQuantity.DISPLACEMENT: quantised(log.table, 100.0 * NM, rng),
        ResponseQuantity.VELOCITY: np.diff(log.table, axis=1, prepend=log.table[:, :1]) * drive.sample_rate,
        ResponseQuantity.MOTOR_ANGLE: encoder,
        ResponseQuantity.MOTOR_SPEED: np.diff(log.motor_angle, axis=1, prepend=log.motor_angle[:, :1]) * 2000.0,
        ResponseQuantity.RELATIVE_DISPLACEMENT: relative,
    }


def test_every_response_shows_the_same_mode_and_the_motor_its_antiresonance(logged, subtests) -> None:
    drive, log, truth = logged
    for quantity, response in responses_of(log, drive, np.random.default_rng(5)).items():
        with subtests.test(quantity=str(quantity)):
            found = measured(windows_of(log.current, response, quantity), truth)
            frequency = found.mode.frequency
            # three in a thousand where all are as stated
            assert abs(frequency.value - truth) < 3.0 * frequency.standard_uncertainty < 0.01 * truth
            of_motor = quantity in (ResponseQuantity.MOTOR_ANGLE, ResponseQuantity.MOTOR_SPEED)
            assert (found.antiresonance is not None) == of_motor
            if found.antiresonance is not None:
                held = found.antiresonance
                assert abs(held.value - drive.held(0.3, 200.0)) < 3.0 * held.standard_uncertainty < 0.01 * truth


def test_windows_of_two_responses_are_not_averaged(logged) -> None:
    _, log, _ = logged
    of_table, of_motor = (
        windows_of(log.current, response, quantity)[:4]
        for quantity, response in (
            (ResponseQuantity.DISPLACEMENT, log.table), (ResponseQuantity.MOTOR_ANGLE, log.motor_angle)
        )
    )  # fmt: skip
    answer = measure_mode(of_table + of_motor, band=(100.0, 200.0), gate=ModeGate())
    assert isinstance(answer, Rejection)
    assert answer.reason is RejectionReason.EXCITATION_SOURCE_MISMATCH
    assert answer.detail == "windows of one measurement must share a response; got displacement, motor-angle"


# ---- coverage -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Draw:
    kind: ExcitationQuantity
    step: float
    covered: bool
    error: float  # in standard uncertainties


def drawn(seed: int) -> Draw | None:
    """Measure an axis of its own by its scale, counted and late, under a random force on the table; None: refused."""
    rng = np.random.default_rng(seed)
    drive = Drive(
        damping=rng.choice([2e-5, 5e-5, 1.1e-4]), table_mass=rng.uniform(15.0, 60.0), inertia=rng.uniform(3e-4, 1.2e-3)
    )
    position, preload = rng.uniform(0.15, 0.7), rng.uniform(60.0, 350.0)
    step, delay = rng.choice([10.0, 100.0, 1000.0]) * NM, rng.choice([0.0, 1.0, 2.0])
    kind = ExcitationQuantity(rng.choice(["current", "acceleration"]))
    is_current = kind is ExcitationQuantity.CURRENT
    log = run(
        drive, position, preload, n_windows=12, n_samples=2000, rng=rng, disturbance=rng.choice([0.5, 5.0]),
        torque=0.3 if is_current else 0.0, acceleration=0.0 if is_current else 1.0,
    )  # fmt: skip
    open_loop = drive.poles(position, preload)[0]
    poles = drive.poles(position, preload, closed=not is_current)
    truth = float(poles[np.argmin(np.abs(poles - open_loop))])
    table = quantised(delayed(log.table, delay), step, rng)
    excitation = quantised(log.current, 0.005, rng) if is_current else log.commanded
    windows = windows_of(excitation, table, driven_by=kind, resolution=step)
    answer = measure_mode(windows, band=(0.7 * truth, 1.4 * truth), gate=ModeGate())
    if isinstance(answer, Rejection):
        return None
    frequency = answer.mode.frequency
    error = (frequency.value - truth) / frequency.standard_uncertainty
    return Draw(kind, step, is_covered(frequency, truth), error)


def test_a_counted_and_late_scale_covers_the_frequency_canary() -> None:
    draws = [draw for seed in range(6) if (draw := drawn(seed)) is not None]
    assert len(draws) >= 4
    assert sum(draw.covered for draw in draws) >= len(draws) - 1  # of a coverage of 95 % once in 33 not


@pytest.mark.release
def test_a_counted_and_late_scale_covers_the_frequency_in_93_to_97_of_100() -> None:
    tried = [drawn(seed) for seed in range(5000, 5400)]
    draws = [draw for draw in tried if draw is not None]
    assert len(draws) >= 0.9 * len(tried)
    covered = sum(draw.covered for draw in draws)
    # 93 to 97 % is asked for; of 400 draws of exactly 95 % so many lie inside but 1 in 1000
    low, high = scipy.stats.binom.ppf([5e-4, 1.0 - 5e-4], len(draws), [0.93, 0.97])
    assert low <= covered <= high
    # unbiased; the median, for errors of few windows have no narrow mean
    assert abs(np.median([draw.error for draw in draws])) < 1.25 * 3.3 / np.sqrt(len(draws))


# ---- a mode that is hardly excited -----------------------------------------------------------------------------------

MACHINES = {
    "small": Drive(),
    "heavy": Drive(
        table_mass=180.0, inertia=6e-3, lead=0.02, screw_mass=12.0,
        nut_stiffness=400e6, bracket_stiffness=250e6, bearing_stiffness=250e6, screw_stiffness=200e6,
    ),
    "light": Drive(
        table_mass=8.0, inertia=1.2e-4, lead=0.005, screw_mass=1.0,
        nut_stiffness=150e6, bearing_stiffness=60e6, screw_stiffness=30e6,
    ),
}  # fmt: skip
BANDS = ((0.7, 1.4), (0.5, 2.0), (0.4, 4.0))


def hardly_excited(machine: str, seed: int) -> list[tuple[float, ModalMeasurement | Rejection]]:
    """Measure in narrow and wide bands what a coarse scale shows of a tenth to three times the usual excitation.

    Returned with the natural frequency: where noise stands higher than the mode, it has peaks of its own.
    """
    base, rng = MACHINES[machine], np.random.default_rng([seed, list(MACHINES).index(machine)])
    drive = replace(
        base,
        damping=rng.choice([2e-5, 5e-5, 1.1e-4]),
        table_mass=base.table_mass * rng.uniform(0.6, 2.0),
        inertia=base.inertia * rng.uniform(0.6, 2.0),
    )
    position, preload = rng.uniform(0.15, 0.7), rng.uniform(60.0, 350.0)
    step, delay = 1e-6 * rng.choice([0.1, 0.5, 1.0, 2.0, 5.0]), rng.choice([0.0, 1.0, 2.0])
    is_current, strength = rng.choice([True, False]), rng.choice([0.1, 0.3, 1.0, 3.0])
    of_usual = (drive.inertia + drive.table_mass * drive.transmission**2) / 6.875e-4  # [1/(kg.m2)]
    log = run(
        drive, position, preload, n_windows=12, n_samples=2000, rng=rng,
        disturbance=rng.choice([0.5, 5.0]) * drive.table_mass / 24.0,
        torque=0.3 * strength * of_usual if is_current else 0.0, acceleration=0.0 if is_current else strength,
    )  # fmt: skip
    open_loop, poles = drive.poles(position, preload)[0], drive.poles(position, preload, closed=not is_current)
    truth = float(poles[np.argmin(np.abs(poles - open_loop))])
    table = quantised(delayed(log.table, delay), step, rng)
    excitation = quantised(log.current, 0.005, rng) if is_current else log.commanded
    kind = ExcitationQuantity.CURRENT if is_current else ExcitationQuantity.ACCELERATION
    windows = windows_of(excitation, table, driven_by=kind, resolution=step)
    kept = [window for window in windows if gate_window(window, QualityGate()) is None]
    return [
        (truth, measure_mode(kept, band=(low * truth, min(high * truth, 900.0)), gate=ModeGate()))
        for low, high in BANDS
    ]


def is_another_peak(truth: float, answer: ModalMeasurement) -> bool:
    """Whether a frequency is no reading of the mode: off by far more than its interval and than a mode is wide."""
    reach = 2.0 * scipy.stats.t.ppf(0.975, answer.mode.frequency.degrees_of_freedom)
    off = abs(answer.mode.frequency.value - truth)
    return bool(off > reach * answer.mode.frequency.standard_uncertainty and off > 0.02 * truth)


def counted(cases) -> tuple[int, int, int]:
    """Return how many measurements there are, how many are refused, and how many are of another peak."""
    answers = [answer for machine, seed in cases for answer in hardly_excited(machine, seed)]
    measured = [(truth, answer) for truth, answer in answers if isinstance(answer, ModalMeasurement)]
    return len(answers), len(answers) - len(measured), sum(is_another_peak(truth, answer) for truth, answer in measured)


def test_no_peak_of_noise_is_taken_for_the_mode_canary() -> None:
    # of these each had one that was, up to 142 Hz off, until a mode had to stand above the noise
    n, refused, of_noise = counted([("light", 135), ("light", 172), ("small", 137), ("small", 190)])
    assert refused < n
    assert of_noise == 0


@pytest.mark.release
def test_no_peak_of_noise_is_taken_for_the_mode() -> None:
    n, refused, of_noise = counted([(machine, seed) for seed in range(700, 800) for machine in MACHINES])
    assert refused < 0.35 * n  # many are hardly excited
    assert of_noise <= 1  # of 900


def test_what_repeats_with_the_excitation_joins_the_uncertainty() -> None:
    rng, rate, n, f, zeta = np.random.default_rng(8), 2000.0, 2000, 127.0, 0.05
    lines = np.fft.rfftfreq(n, 1.0 / rate)
    response = -(lines**2) / (f**2 - lines**2 + 2j * zeta * f * lines)
    to_displacement = -1.0 / np.maximum(2.0 * np.pi * lines, 1.0) ** 2
    covered, stated = [], []
    for _ in range(24):
        phases = np.exp(2j * np.pi * rng.uniform(size=lines.size)) * ((lines > 10.0) & (lines < 300.0))
        # friction answers each line with others, and in each period alike: 5 % of the response, anyhow
        distorted = response * (1.0 + 0.05 * (rng.normal(size=lines.size) + 1j * rng.normal(size=lines.size)))
        x, y = (np.fft.irfft(spectrum, n) * n for spectrum in (phases, phases * distorted * to_displacement))
        noise = 1e-3 * y.std() * rng.normal(size=(12, n))
        found = measured(windows_of(np.tile(x, (12, 1)), y + noise), f, maximum_modes=1)
        covered.append(is_covered(found.mode.frequency, f))
        stated.append(any("repeat one excitation" in warning for warning in found.warnings))
    assert all(stated)
    assert sum(covered) >= scipy.stats.binom.ppf(1e-3, 24, 0.95)


# ---- gates ----------------------------------------------------------------------------------------------------------


def test_a_scale_is_refused_at_rest_and_stuck_and_not_for_counting_slowly(logged) -> None:
    _, log, _ = logged
    rng = np.random.default_rng(6)
    # counts one step to and fro
    (at_rest,) = windows_of(log.current[:1], quantised(0.5 + 0.9e-6 * rng.uniform(-1.0, 1.0, (1, 2000)), 1e-6, rng))
    refusal = gate_window(at_rest, QualityGate())
    assert refusal is not None
    assert refusal.reason is RejectionReason.DEAD_CHANNEL
    assert "displacement must move by 4 steps of 1e-06 m or more" in refusal.detail

    (slow,) = windows_of(log.current[:1], quantised(log.table[:1], 1000.0 * NM, rng))
    assert gate_window(slow, QualityGate()) is None
    # stands at the end of its travel, as it does after a move
    stopped = np.where(np.arange(2000) < 1500, slow.response, slow.response[1500])
    quiet = np.where(np.arange(2000) < 1500, slow.excitation, 0.0)
    assert gate_window(replace(slow, response=stopped, excitation=quiet), QualityGate()) is None

    refusal = gate_window(replace(slow, response=stopped), QualityGate())
    assert refusal is not None
    assert refusal.reason is RejectionReason.STUCK_CHANNEL
    assert "while the excitation goes on" in refusal.detail
