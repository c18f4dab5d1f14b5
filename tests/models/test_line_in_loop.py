"""A session of a drive in its speed loop, shaken by a cutting force that nobody measures, is identified."""

from datetime import UTC, datetime

import numpy as np
import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.modal import ModalMeasurement, ModeGate, measure_mode
from monitor_core.models.generator import SimulationSettings, StatedSimulation, simulate_motion, windows_of_motion
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from monitor_core.models.published.transmission_line import SpeedControl, TransmissionLineModel
from monitor_core.models.published.transmission_line.mobility import DiscreteDrive, response_at
from monitor_core.recording import ExcitationSource, MotionProfile
from tests.modal.test_drive_signals import is_covered
from tests.models.line_reference import HEAVY, shaft


def identified(seed):
    """Return what the reference shows of a drive of its own in a loop of its own, and the pole of its lines."""
    rng = np.random.default_rng(seed)
    drive = shaft(table_mass=rng.uniform(200.0, 450.0), nut_stiffness=rng.uniform(4e8, 8e8))
    model, here = TransmissionLineModel(drive, least_torsional_sections=20), DriveConditions(rng.uniform(0.3, 1.0))
    truth = next(m.frequency for m in model.natural_frequencies(here, MotorEnd.FREE) if m.frequency > 0.0)
    control = SpeedControl(rng.uniform(1.0, 3.0), rng.uniform(0.01, 0.03), rng.uniform(2e-4, 5e-4), 1.25e-4)
    settings = SimulationSettings(
        sample_rate=2000.0, excitation_source=ExcitationSource.DRIVE, random_speed=0.03, torque_noise=0.01,
        acceleration_noise=0.02,
    )  # fmt: skip
    time = np.arange(0.0, 26.0, 1e-3)
    cutting = MotionProfile(time, np.zeros_like(time), is_speed=True, force=200.0 * rng.standard_normal(time.size))
    motion = simulate_motion(model, here, cutting, StatedSimulation(control=control), settings, rng=rng)
    windows = windows_of_motion(
        motion, here, settings, measurement="m", starts=datetime(2025, 1, 1, tzinfo=UTC), rng=rng
    )
    gate = ModeGate(maximum_frequency_uncertainty=0.01)
    return measure_mode(windows[1:], band=(0.7 * truth, 1.4 * truth), gate=gate, maximum_modes=1), truth


def test_a_simulated_drive_in_its_loop_is_identified_by_its_reference():
    answers = [identified(seed) for seed in range(4)]
    assert all(isinstance(answer, ModalMeasurement) for answer, _ in answers)
    assert sum(is_covered(answer.mode.frequency, truth) for answer, truth in answers) >= 3


HERE = DriveConditions(0.6)


def followed(speed, duration, gain=2.0, sample_rate=2000.0, **damping):
    """Return what a drive does that follows a speed [m/s] of the table, and its model."""
    model = TransmissionLineModel(shaft(**damping), least_torsional_sections=20)
    time = np.linspace(0.0, duration, 2001)
    profile = MotionProfile(time, speed(time), is_speed=True)
    stated = StatedSimulation(control=SpeedControl(gain, 0.01, 1e-4, 1.25e-4))
    settings = SimulationSettings(sample_rate=sample_rate)
    return simulate_motion(model, HERE, profile, stated, settings, rng=np.random.default_rng(0)), model


def test_recorded_speed_and_torque_are_those_of_the_drive_up_to_the_filter():
    # A burst after which everything is at rest again: the ratio of the transforms is the response.
    def burst(t):
        return np.where(t < 6e-3, 0.01 * np.sin(np.pi * t / 6e-3) ** 2 * np.sin(2.0 * np.pi * 650.0 * t), 0.0)

    motion, model = followed(burst, 0.3, **HEAVY)
    frequency = np.fft.rfftfreq(motion.time.size, 1.0 / 2000.0)
    near = (frequency > 500.0) & (frequency < 800.0)
    omega = 2j * np.pi * frequency[near]
    recorded = np.fft.rfft(motion.speed)[near] / np.fft.rfft(motion.motor_torque)[near]
    drive = DiscreteDrive(model.parameters, model.grid, HERE, MotorEnd.FREE)
    angle = response_at(drive, omega, ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ANGLE_AT_MOTOR)
    np.testing.assert_allclose(recorded, omega * angle, rtol=2e-3)


@pytest.mark.parametrize(
    ("speed", "duration", "changes", "message"),
    [
        (0.05, 0.3, {"gain": 5000.0}, "the speed loop is unstable or does not follow the motion"),
        (0.05, 0.3, {"sample_rate": 400e3}, "sample_rate must not exceed that of the lines"),
        (0.05, 1e-6, {}, "a motion must last for four samples, 0.002 s; got 1e-06 s"),
        (0.05, 8e-5, {}, "a motion must last for four samples, 0.002 s; got 8e-05 s"),
    ],
)
def test_a_motion_that_no_session_can_be_made_of_is_refused(speed, duration, changes, message):
    with pytest.raises(OutsideValidityError, match=message):
        followed(lambda t: np.full_like(t, speed), duration, **changes)
