"""Axes and helpers for the tests of the extended drive."""

from dataclasses import replace

import numpy as np

from monitor_core.models.extended import AxisPhysics, ResponseCase, paper_motor_end, prepare_lines, responses
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, ResponsePoint, motor_end_of
from monitor_core.recordings.model_file import read_model_file
from tests.conftest import PROJECT_ROOT

FAMILIES = ("lumped", "hybrid", "receptance", "transmission-line")


def bundled(family):
    return read_model_file(PROJECT_ROOT / "replay_data" / "models" / f"{family}.toml").build()


def conditions_of(parameters, share=0.3, **changes):
    """Return conditions on the screw, with half the rated preload where the nut follows one."""
    rating = getattr(parameters, "dynamic_load_rating", None)
    preload = None if rating is None else 0.05 * rating
    return DriveConditions(share * parameters.screw_length, preload, **changes)


def case_of(parameters, frequency, conditions, excitation, response=ResponsePoint.DISPLACEMENT_AT_TABLE):
    end = motor_end_of(excitation, paper_motor_end(parameters))
    return ResponseCase(np.asarray(frequency, dtype=float), conditions, excitation, response, end)


def response_of(physics: AxisPhysics, case: ResponseCase):
    return responses(physics, prepare_lines([case]))


def add(physics: AxisPhysics, **values) -> AxisPhysics:
    return replace(physics, added=replace(physics.added, **values))


def undamped(physics: AxisPhysics, **joints) -> AxisPhysics:
    """Return the axis without any damping, with other joints."""
    none = dict.fromkeys(
        ("bearing_damping", "far_bearing_damping", "nut_damping", "coupling_damping", "loss_factor"), 0.0
    )
    return replace(
        physics,
        joints=replace(physics.joints, **(none | joints)),
        bodies=replace(physics.bodies, table_damping=0.0, motor_damping=0.0),
    )


TORQUES = (ExcitationPoint.TORQUE_AT_SCREW, ExcitationPoint.TORQUE_AT_MOTOR)
