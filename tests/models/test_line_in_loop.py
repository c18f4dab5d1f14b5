"""A session of a drive in its speed loop, shaken by a cutting force that nobody measures, is identified."""

from datetime import UTC, datetime

import numpy as np

from monitor_core.modal import ModalMeasurement, ModeGate, measure_mode
from monitor_core.models.generator import SimulationSettings, StatedSimulation, simulate_motion, windows_of_motion
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.transmission_line import SpeedControl, TransmissionLineModel
from monitor_core.recording import ExcitationSource, MotionProfile
from tests.modal.test_drive_signals import is_covered
from tests.models.line_reference import shaft


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
