"""The catalogue of motion effects: nothing at null values, something at any other, in any order."""

import pickle
from itertools import permutations

import numpy as np
import pytest

from monitor_core.effects import (
    MOTION_EFFECTS,
    sized_for,
    with_effects,
    wrong_motion_parameter,
    wrong_motion_parameters,
)
from monitor_core.effects.sizes import motion_sizes
from monitor_core.effects.units import recorded_unit
from monitor_core.errors import OutsideValidityError
from monitor_core.models.motion import Kinematics, MotionModel, MotionParameters, forces
from tests.effects.test_effects import strong_values
from tests.models.simulated_motion import RATE, Motion, Truth

STATED = MotionParameters(moving_mass=95.0, viscous_friction=200.0, screw_lead=0.02)
WITHOUT_FRICTION = MotionParameters(moving_mass=95.0)
#: The keys of files, the part that is about motions; viscous friction is for models that state none.
KEYS = [
    "coulomb-friction", "force-offset", "direction-dependent-friction", "stribeck-friction", "force-delay",
    "force-scale", "viscous-friction", "unit",
]  # fmt: skip
ENDINGS = {"N": "_n", "N·s/m": "_ns_per_m", "m/s": "_m_per_s", "s": "_s"}
TIME = np.arange(4000) / RATE
MOTION = Kinematics(RATE, Motion().at(TIME, 1), Motion().at(TIME, 2))

#: As the motion of an axis of 95 kg is recorded.
EFFECTS = sized_for(MOTION_EFFECTS, motion_sizes(force=54.0, change=54.0, velocity=0.09, cutoff=100.0))

every_effect = pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.key)


def axis_for(effect):
    """Return an axis that the effect applies to, with other effects already there."""
    stated = WITHOUT_FRICTION if effect.key == "viscous-friction" else STATED
    present = {"coulomb-friction": {"friction_n": 4.0}, "force-delay": {"delay_s": 3e-4}}
    return with_effects(MotionModel.of(stated), present).physics


def test_keys_are_those_of_the_formats() -> None:
    assert [effect.key for effect in MOTION_EFFECTS] == KEYS


def test_effects_travel_between_processes() -> None:
    effects = (*MOTION_EFFECTS, *wrong_motion_parameters(STATED))
    copies = pickle.loads(pickle.dumps(effects))  # noqa: S301 made here
    assert [effect.key for effect in copies] == [effect.key for effect in effects]


@every_effect
def test_every_effect_says_what_it_is(effect) -> None:
    assert effect.name
    assert effect.physics.endswith(".")
    assert effect.source
    for parameter in effect.parameters:
        assert parameter.unit == "-" or parameter.name.endswith(ENDINGS[parameter.unit])


@every_effect
def test_nothing_changes_at_null_values(effect) -> None:
    axis = axis_for(effect)
    np.testing.assert_array_equal(
        forces(effect.added_to(axis, effect.null_values()), MOTION), forces(axis, MOTION), strict=True
    )


@every_effect
def test_every_parameter_moves_the_force(effect) -> None:
    axis = axis_for(effect)
    strong = strong_values(effect)
    before = forces(effect.added_to(axis, strong), MOTION)
    for parameter in effect.parameters:
        after = forces(effect.added_to(axis, strong | {parameter.name: parameter.null + 1.5 * parameter.scale}), MOTION)
        assert np.max(np.abs(after - before)) > 1e-3 * np.max(np.abs(before))


@every_effect
def test_half_the_smallest_size_is_half_the_change(effect) -> None:
    """A search starts at the null values and needs a slope there."""
    axis = axis_for(effect)
    first = effect.parameters[0]

    def change(size):
        added = effect.added_to(axis, effect.null_values() | {first.name: size * first.scale})
        return forces(added, MOTION) - forces(axis, MOTION)

    np.testing.assert_allclose(change(1e-3), 2.0 * change(5e-4), atol=2e-3 * np.max(np.abs(change(1e-3))))


TRUTHS = {
    "coulomb-friction": ({"friction_n": 12.0}, Truth(95.0, 200.0, coulomb=12.0)),
    "direction-dependent-friction": (
        {"viscous_difference_ns_per_m": -60.0},
        Truth(95.0, 200.0, towards_higher=-30.0, towards_lower=30.0),
    ),
    "stribeck-friction": (
        {"friction_n": -5.0, "velocity_m_per_s": 0.02},
        Truth(95.0, 200.0, low_speed=-5.0, low_speed_width=0.02),
    ),
    "viscous-friction": ({"friction_ns_per_m": 150.0}, Truth(95.0, 150.0)),
}


@pytest.mark.parametrize("key", TRUTHS)
def test_a_friction_is_that_of_the_simulated_axis(key) -> None:
    values, truth = TRUTHS[key]
    stated = WITHOUT_FRICTION if key == "viscous-friction" else STATED
    model = with_effects(MotionModel.of(stated), {key: values})
    np.testing.assert_allclose(model.forces(MOTION), truth.force(MOTION.velocity, MOTION.acceleration), atol=1e-10)


def test_effects_may_come_in_any_order() -> None:
    values = {effect.key: strong_values(effect) for effect in EFFECTS if effect.key != "viscous-friction"}
    values |= {
        "wrong-parameter:moving_mass_kg": {"ln_ratio": 0.2},
        "wrong-parameter:viscous_friction_ns_per_m": {"ln_ratio": -0.4},
    }
    model = MotionModel.of(STATED)
    first = with_effects(model, values).forces(MOTION)
    for order in list(permutations(values))[::4001]:
        again = with_effects(model, {key: values[key] for key in order}).forces(MOTION)
        np.testing.assert_allclose(again, first, rtol=1e-12, atol=1e-9)


def test_a_wrong_parameter_is_another_value_in_the_file() -> None:
    for name, field in (("moving_mass_kg", "moving_mass"), ("viscous_friction_ns_per_m", "viscous_friction")):
        wrong = wrong_motion_parameter(name, STATED).added_to(MotionModel.of(STATED).physics, {"ln_ratio": np.log(1.3)})
        assert getattr(wrong, field) == pytest.approx(1.3 * getattr(STATED, field), rel=1e-12)


def test_what_moves_no_force_cannot_be_wrong() -> None:
    assert [effect.key.partition(":")[2] for effect in wrong_motion_parameters(STATED)] == [
        "moving_mass_kg",
        "viscous_friction_ns_per_m",
    ]
    assert [effect.key.partition(":")[2] for effect in wrong_motion_parameters(WITHOUT_FRICTION)] == ["moving_mass_kg"]
    with pytest.raises(OutsideValidityError, match="moving_mass_kg, viscous_friction_ns_per_m; got 'screw_lead_m'"):
        wrong_motion_parameter("screw_lead_m", STATED)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        (
            {"coulomb-friction": {"friction_n": -1.0}},
            "coulomb-friction: coulomb_friction must not be negative; got -1.0",
        ),
        ({"viscous-friction": {"friction_ns_per_m": 1.0}}, "the effect viscous-friction does not apply"),
        ({"guide-friction": {"friction_n": 1.0}}, "one of coulomb-friction, .*; got 'guide-friction'"),
        ({"force-delay": {"delay": 1.0}}, "force-delay has the parameters delay_s; got delay"),
    ],
)
def test_what_does_not_fit_is_refused(values, sentence) -> None:
    with pytest.raises(OutsideValidityError, match=sentence):
        with_effects(MotionModel.of(STATED), values)


def test_an_offset_and_coulomb_friction_are_alike_in_one_direction_alone() -> None:
    """Both need the direction to vary, and say so."""
    one_way = Kinematics(RATE, np.abs(MOTION.velocity) + 1e-6, MOTION.acceleration)
    changes = [
        with_effects(MotionModel.of(STATED), values).forces(one_way)
        for values in ({"coulomb-friction": {"friction_n": 5.0}}, {"force-offset": {"force_n": 5.0}})
    ]
    np.testing.assert_allclose(changes[0], changes[1], rtol=1e-12)
    needs = {effect.key for effect in MOTION_EFFECTS if "direction" in effect.needs}
    assert needs == {"coulomb-friction", "force-offset", "direction-dependent-friction"}


@pytest.mark.parametrize("factor", [1.0 / 4.4482216152605, 1e-3])
def test_another_unit_of_force_and_of_position_are_one_factor(factor) -> None:
    """A force in pounds, of which friction is in pounds too; and a motion in millimetres, of which it is in newtons."""
    unit = next(effect for effect in EFFECTS if effect.key == "unit")
    axis = MotionModel.of(STATED).physics
    wrong = unit.added_to(axis, {"ln_factor": np.log(factor)})
    np.testing.assert_allclose(forces(wrong, MOTION), factor * forces(axis, MOTION), rtol=1e-12)
    with_friction = with_effects(MotionModel.of(STATED), {"coulomb-friction": {"friction_n": 4.0}}).physics
    recorded = Kinematics(RATE, MOTION.velocity / factor, MOTION.acceleration / factor)
    also_wrong = unit.added_to(with_friction, {"ln_factor": np.log(factor)})
    np.testing.assert_allclose(forces(also_wrong, recorded), forces(with_friction, MOTION), rtol=1e-9)


def test_a_unit_is_said_where_the_factor_is_known_to_be_its_own() -> None:
    def units(factor, deviation):
        found = recorded_unit("Unit of force or position", np.log(factor), deviation)
        assert found.factor == pytest.approx(factor)
        return found.units

    assert units(1.0 / 4.4482216152605, 0.05) == ("force in lbf",)
    assert units(1.0 / 9.80665, 0.02) == ("force in kgf", "force in daN")
    assert units(1.0 / 60.0, 0.05) == ()
    assert units(1e-3, np.inf) == ()  # at an end of its range the factor is a bound
    assert units(1e-3, 0.01) == ("force in kN", "position in mm")
