"""Effects by which a quantity follows how the axis is set: their laws, and what no axis could have."""

import math
from dataclasses import replace

import pytest

from monitor_core.effects import Form, Law, Variable, varying
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended import AxisSetting, physics_of
from tests.models.extended_axes import bundled

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
