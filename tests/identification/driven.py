"""An axis of wave lines driven by its motor, whose joints and whose sensors are not quite as stated.

Waves on the screw share no formula with the model that is fitted (`tests/hidden_effects/truth/wave_network`). Its steel
is without the loss that the truth of the hidden effects has and no description holds.
"""

from dataclasses import replace

import numpy as np

from monitor_core.fitting.coordinates import FreeParameters
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, ResponsePoint
from monitor_core.recordings.model_file import parse_model
from tests.hidden_effects.cases import baseline_text
from tests.hidden_effects.truth.axis import Axis, Parts, Setting
from tests.hidden_effects.truth.wave_network import Lines, network_of
from tests.identification.simulated import factored

FREQUENCY = np.geomspace(24.0, 1500.0, 150)  # [Hz]
POSITIONS, PRELOADS = (0.211, 0.476, 0.739), (120.0, 360.0)  # [m], [N]
POINTS = ResponsePoint.ACCELERATION_AT_TABLE, ResponsePoint.ANGLE_AT_MOTOR
#: What is drawn, by the names of the plant and of the model file.
JOINTS = {
    "bearing_stiffness": "bearing_stiffness_n_per_m", "nut_rigidity": "nut_stiffness_n_per_m",
    "coupling_stiffness": "coupling_stiffness_nm_per_rad", "bearing_damping": "bearing_damping_ns_per_m",
    "nut_damping": "nut_damping_ns_per_m", "coupling_damping": "coupling_damping_nms_per_rad",
}  # fmt: skip
STATED = FreeParameters(
    "receptance", parse_model(baseline_text(Parts(), "receptance"), "wave lines").parameters, tuple(JOINTS.values())
)


def machine(
    rng: np.random.Generator, change: np.ndarray, noise: float = 0.02
) -> tuple[FrequencyResponseObservation, ...]:
    """Measure a machine whose joints are off by ``change`` [decades], each response with a factor of its own.

    Factors scatter by 2 % and 1.2°, lines by ``noise`` of |H| besides.
    """
    stated = Parts()
    changed = {part: getattr(stated, part) * 10.0**x for part, x in zip(JOINTS, change, strict=True)}
    axis, lossless = Axis(parts=replace(stated, **changed)), np.ones(FREQUENCY.size, dtype=np.complex128)
    measured = []
    for position, preload in ((x, force) for x in POSITIONS for force in PRELOADS):
        lines = Lines(2j * np.pi * FREQUENCY, lossless, lossless)
        seen = network_of(axis, Setting(position=position, preload=preload), lines).seen(1.0)
        for point, response in zip(POINTS, seen, strict=True):
            deviation = noise * np.abs(response) / np.sqrt(2.0)
            scatter = rng.standard_normal(FREQUENCY.size) + 1j * rng.standard_normal(FREQUENCY.size)
            torque, conditions = ExcitationPoint.TORQUE_AT_MOTOR, DriveConditions(position, preload)
            measured.append(
                FrequencyResponseObservation(
                    conditions, FREQUENCY, response + deviation * scatter, deviation, torque, point
                )
            )
    return factored(tuple(measured), rng)
