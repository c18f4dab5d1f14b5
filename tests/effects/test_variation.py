"""Effects by which a quantity follows how the axis is set: their laws, and what no axis could have."""

import math
from dataclasses import replace

import numpy as np
import pytest

from monitor_core.effects import Form, Law, Variable, varying
from monitor_core.effects.variation import GEAR_RATIO
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended import (
    AxisSetting,
    ResponseCase,
    moving_mass,
    physics_of,
    prepare_lines,
    responses,
)
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from tests.models.extended_axes import bundled

TABLE = ResponsePoint.ACCELERATION_AT_TABLE
PHYSICS = physics_of(bundled("hybrid").parameters)
AT = AxisSetting(
    position=0.3, preload=250.0, payload_mass=4.0, temperature_deviation=10.0, excitation_level=0.4, order=0.5
)


def stiffness_at(effect, values, setting=AT):
    axis = effect.added_to(PHYSICS, values)
    for change in axis.by_setting:
        axis = change(axis, setting)
    return axis.joints.bearing_stiffness / PHYSICS.joints.bearing_stiffness


@pytest.mark.parametrize(
    ("law", "values", "factor"),
    [
        (Law(Variable.EXCITATION, Form.LINEAR, 0.1, 0.3), {"change": -0.5}, 0.5),
        (Law(Variable.PAYLOAD, Form.QUADRATIC, 2.0, 4.0), {"change": 0.2, "curvature": 0.4}, 1.2),
        (Law(Variable.POSITION, Form.PERIODIC, 0.0, 0.4), {"cosine": 0.1, "sine": 0.2}, 0.8),
        (Law(Variable.POSITION, Form.YIELDING, 0.0, 0.4), {"cosine": 0.3, "sine": 0.4}, 1.0 / 1.1),
        (Law(Variable.PRELOAD, Form.POWER, 1000.0, 1000.0), {"exponent": 0.5}, 0.5),
        (Law(Variable.EXCITATION, Form.SATURATING, 0.2, 0.2), {"change": -0.6, "half_at": 2.0}, 0.7),
        (Law(Variable.ORDER, Form.LINEAR, 0.0, 1.0), {"change": -0.2}, 0.9),
        (Law(Variable.TEMPERATURE, Form.LINEAR, 5.0, 10.0), {"change": 0.3}, 1.15),
        (Law(Variable.NOTHING, Form.CONSTANT, 0.0, 1.0), {"change": 0.3}, 1.3),
        (Law(Variable.POSITION, Form.STEP, 0.25, 0.05), {"change": -0.4}, 0.6),
        (Law(Variable.POSITION, Form.STEP, 0.35, 0.05), {"change": -0.4}, 1.0),
        (Law(Variable.POSITION, Form.DIP, 0.2, 0.1), {"change": -0.4}, 1.0 - 0.4 * math.exp(-0.5)),
        # Abramowitz and Stegun, table 26.1: of a normal variable 0.6826894921370859 lie within one deviation
        (Law(Variable.EXCITATION, Form.CLIPPED, 0.4, 0.4), {"scale_over_limit": 1.0}, 0.6826894921370859),
        (
            Law(Variable.POSITION, Form.LEVELS, 0.6, 0.6, (0.2, 0.6, 0.8)),
            {"change_1": 0.4, "change_2": 0.0, "change_3": -0.2},
            1.3,
        ),
    ],
    ids=lambda value: value.form if isinstance(value, Law) else "",
)
def test_laws_multiply_as_written(law, values, factor):
    assert math.isclose(stiffness_at(varying("joints", "bearing_stiffness", law), values), factor, rel_tol=1e-12)


def test_at_null_the_axis_is_the_same():
    effect = varying("joints", "bearing_stiffness", Law(Variable.EXCITATION, Form.SATURATING, 0.2, 0.2))
    assert effect.added_to(PHYSICS, effect.null_values()) == PHYSICS


def test_a_quantity_that_an_axis_has_not_cannot_vary():
    effect = varying("added", "table_absorber_frequency", Law(Variable.POSITION, Form.LINEAR, 0.5, 1.0))
    with pytest.raises(OutsideValidityError, match="does not apply"):
        effect.added_to(PHYSICS, {"change": 0.1})


def test_a_law_that_leaves_nothing_is_refused():
    effect = varying("joints", "bearing_stiffness", Law(Variable.EXCITATION, Form.LINEAR, 0.0, 0.4))
    with pytest.raises(OutsideValidityError, match=r"keep 0\.02 of itself; got -0\.5 at a excitation of 0\.4"):
        stiffness_at(effect, {"change": -1.5})


@pytest.mark.parametrize(("reference", "scale"), [(0.0, 0.0), (math.nan, 1.0), (0.0, -1.0)])
def test_a_law_needs_a_scale(reference, scale):
    with pytest.raises(OutsideValidityError, match="positive scale"):
        Law(Variable.POSITION, Form.LINEAR, reference, scale)


def test_laws_of_two_effects_multiply():
    first = varying("joints", "bearing_stiffness", Law(Variable.EXCITATION, Form.LINEAR, 0.1, 0.3))
    axis = first.added_to(first.added_to(PHYSICS, {"change": -0.5}), {"change": -0.5})
    for change in axis.by_setting:
        axis = change(replace(axis, by_setting=()), AT)
    assert math.isclose(axis.joints.bearing_stiffness, 0.25 * PHYSICS.joints.bearing_stiffness, rel_tol=1e-12)


def response_at(axis, excitation, frequency=40.0):
    """Return the acceleration of the table per unit excitation, of an axis whose motor turns freely."""
    case = ResponseCase(np.array([frequency]), DriveConditions(0.3), excitation, TABLE, MotorEnd.FREE)
    return complex(responses(axis, prepare_lines([case]))[0])


def larger(record, quantity):
    """Return the axis with a quantity 1.3 times as large at every setting."""
    law = Law(Variable.NOTHING, Form.CONSTANT, 0.0, 1.0)
    return varying(record, quantity, law).added_to(PHYSICS, {"change": 0.3})


@pytest.mark.parametrize(
    ("quantity", "of_torque", "of_force"), [("torque_ln_factor", 1.3, 1.0), ("response_ln_factor", 1.3, 1.3)]
)
def test_gains_of_channels_multiply_what_is_recorded(quantity, of_torque, of_force) -> None:
    """More torque than is recorded moves the axis more; a response that is recorded larger looks so."""
    axis = larger("added", quantity)
    for excitation, gain in ((ExcitationPoint.TORQUE_AT_MOTOR, of_torque), (ExcitationPoint.FORCE_AT_TABLE, of_force)):
        ratio = response_at(axis, excitation) / response_at(PHYSICS, excitation)
        assert abs(ratio / gain - 1.0) < 1e-12


def test_a_gear_between_motor_and_screw_is_seen_in_the_rigid_body() -> None:
    """Newton: i' T = (J_motor + J_screw/r² + m i'²) a with the travel i' = i/r of one angle of the motor."""
    bodies = replace(PHYSICS.bodies, table_damping=0.0, motor_damping=0.0)
    axis, screw, ratio = replace(larger("", GEAR_RATIO), bodies=bodies), PHYSICS.screw, 1.3
    turning = screw.inertia_per_length * screw.length + screw.nut_segment_inertia + screw.motor_segment_inertia
    mass = moving_mass(PHYSICS) + screw.mass_per_length * screw.length * (1.0 - screw.axial_mass_share)
    travel = screw.transmission_ratio / ratio
    rigid = travel / (PHYSICS.bodies.rotor_inertia + turning / ratio**2 + mass * travel**2)
    assert response_at(axis, ExcitationPoint.TORQUE_AT_MOTOR, 1.0).real == pytest.approx(rigid, rel=2e-3)
