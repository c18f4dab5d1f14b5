"""Slopes of responses: against differences of the responses themselves, by every number that an axis has."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest

from monitor_core.models.extended import (
    AxisPhysics,
    Move,
    ScrewBending,
    log_response_slopes,
    physics_of,
    prepare_lines,
    responses,
)
from monitor_core.models.extended.settings import NUMBERS
from monitor_core.models.extended.traced import Traced, derivatives
from monitor_core.models.protocol import ExcitationPoint, ResponsePoint
from tests.models.extended_axes import FAMILIES, add, bundled, case_of, conditions_of
from tests.models.test_by_setting import EVERYTHING

POINTS = (
    (ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ACCELERATION_AT_TABLE),
    (ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ANGLE_AT_MOTOR),
    (ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ACCELERATION_AT_NUT),
    (ExcitationPoint.FORCE_AT_TABLE, ResponsePoint.DISPLACEMENT_AT_TABLE),
    (ExcitationPoint.FORCE_AT_TABLE, ResponsePoint.ACCELERATION_AT_NUT),
)
#: What would be noticed of what a plain axis lacks.
SIZES = EVERYTHING | {"causal_loss_factor": 0.02, "loss_factor": 0.02, "far_bearing_stiffness": 1e7,
                      "nut_segment_inertia": 1e-5, "motor_segment_inertia": 1e-5, "preload_change": 50.0,
                      "thermal_preload": 5.0, "motor_damping": 0.01, "coupling_damping": 0.01,
                      "bearing_damping": 100.0, "far_bearing_damping": 100.0, "nut_damping": 100.0,
                      "table_damping": 100.0, "rotor_inertia": 1e-5, "thermal_stiffness": 1e-3,
                      "second_mode_residue": 1e-9, "compliance": 1e-9, "damping_ratio": 0.03}  # fmt: skip
#: Numbers of which an iteration, not a formula, says what they do.
OF_LEVEL = ("guide_friction", "cubic_nut_stiffness")


def lines_of(family, **changes):
    parameters = bundled(family).parameters
    band = np.geomspace(20.0, 900.0, 60)
    settings = [conditions_of(parameters, share, payload_mass=3.0, temperature_deviation=5.0, excitation_level=level)
                for share, level in ((0.2, 0.1), (0.6, 0.3))]  # fmt: skip
    return prepare_lines([case_of(parameters, band, at, *pair) for at in settings for pair in POINTS])


def full(family):
    """Return an axis that has everything, its shares within their bounds."""
    places = ("table", "nut", "rotor", "screw_end")
    damped = {f"{place}_absorber_damping_ratio": 0.03 for place in places}  # a difference sees no resonance as sharp
    axis = add(physics_of(bundled(family).parameters), **(EVERYTHING | damped | {"second_mode_damping_ratio": 0.03}))
    shares = {"axial_mass_share": 0.8, "torsional_inertia_share": 0.7, "torsion_share": 0.9, "far_end_held_share": 0.3}
    screw = replace(axis.screw, causal_loss_factor=0.002, nut_segment_mass=0.2, **shares)
    joints = replace(axis.joints, causal_loss_factor=0.01, loss_factor=0.02, bearing_damping=50.0, nut_damping=80.0,
                     bracket_stiffness=3e8, far_bearing_stiffness=2e7)  # fmt: skip
    bodies = replace(axis.bodies, nut_mass=1.0, table_damping=100.0, motor_damping=0.01)
    bending = ScrewBending(compliance=1e-9, frequency=90.0, damping_ratio=0.03)
    return replace(axis, screw=screw, joints=joints, bodies=bodies, bending=bending)


def moved(axis, record, name, by):
    part = getattr(axis, record)
    return replace(axis, **{record: replace(part, **{name: getattr(part, name) + by})})


def ln_ratio(lines, ahead, behind):
    return np.log(responses(ahead, lines) / responses(behind, lines))


def values_of(axis):
    return {(record, name): getattr(getattr(axis, record), name) for record, name in NUMBERS if name not in OF_LEVEL}


@dataclass(frozen=True)
class Firmer:
    """The bearing is firmer the further away the table is."""

    by: float = 0.3

    def __call__(self, axis, setting):
        stiffness = axis.joints.bearing_stiffness * (1.0 + self.by * setting.position)
        return replace(axis, joints=replace(axis.joints, bearing_stiffness=stiffness))


@pytest.mark.parametrize(
    "by_setting",
    [pytest.param((), id="alike", marks=pytest.mark.release), pytest.param((Firmer(),), id="by setting")],
)
@pytest.mark.parametrize("family", FAMILIES)
def test_every_number_of_a_full_axis_has_its_slope(family, by_setting):
    axis, lines = replace(full(family), by_setting=by_setting), lines_of(family)
    steps = {key: 1e-5 if key[1].endswith("_frequency") else 3e-5 for key in values_of(axis)}  # some resonate sharply
    there = {key: steps[key] * abs(value) for key, value in values_of(axis).items() if value and np.isfinite(value)}
    assert len(there) > 50
    moves = [Move(moved(axis, *key, -step), moved(axis, *key, step), 2.0 * step) for key, step in there.items()]
    slopes = log_response_slopes(axis, lines, moves)
    for (key, step), move, slope in zip(there.items(), moves, slopes, strict=True):
        wide = ln_ratio(lines, move.ahead, move.behind) / move.distance
        narrow_ends = moved(axis, *key, 0.5 * step), moved(axis, *key, -0.5 * step)
        difference = (4.0 * ln_ratio(lines, *narrow_ends) / step - wide) / 3.0  # to the fourth power of the step
        atol = 1e-6 * np.max(np.abs(difference)) + 1e-14 / step  # and the rounding of the difference
        np.testing.assert_allclose(slope, difference, rtol=0, atol=atol, err_msg=str(key))


@pytest.mark.parametrize("family", FAMILIES)
def test_what_is_absent_has_its_slope_where_it_begins(family):
    """A derivative at null of what a plain axis lacks; what needs a frequency of its own is given one."""
    axis, lines = physics_of(bundled(family).parameters), lines_of(family)
    frequencies = {name: value for name, value in EVERYTHING.items() if name.endswith("_frequency")}
    axis = add(axis, **frequencies)
    bounded = ("_share", "_frequency")
    absent = [key for key, value in values_of(axis).items() if value == 0.0 and not key[1].endswith(bounded)]
    if axis.joints.dynamic_load_rating is None:
        of_preload = ("preload_exponent_change", "preload_change", "thermal_preload")
        absent = [key for key in absent if key[1] not in of_preload]
    moves = []
    for key in absent:
        step = 1e-4 * abs(SIZES.get(key[1], 1.0))
        moves.append(Move(axis, moved(axis, *key, step), step))
    for key, move, slope in zip(absent, moves, log_response_slopes(axis, lines, moves), strict=True):
        far = moved(axis, *key, 2.0 * move.distance)
        difference = (4.0 * ln_ratio(lines, move.ahead, axis) - ln_ratio(lines, far, axis)) / (2.0 * move.distance)
        rounding = 3e-15 / move.distance  # of what a number hardly does
        atol = 1e-4 * np.max(np.abs(difference)) + rounding
        np.testing.assert_allclose(slope, difference, rtol=0, atol=atol, err_msg=str(key))


def test_a_law_that_begins_has_its_slope():
    """From an axis that is the same at all settings to one that is not."""
    axis, lines = full("hybrid"), lines_of("hybrid")
    ahead, behind = (replace(axis, by_setting=(Firmer(by),)) for by in (1e-5, -1e-5))
    (slope,) = log_response_slopes(axis, lines, [Move(behind, ahead, 2e-5)])
    difference = ln_ratio(lines, ahead, behind) / 2e-5
    np.testing.assert_allclose(slope, difference, rtol=0, atol=1e-6 * np.max(np.abs(difference)))


def test_what_acts_through_the_amplitude_has_no_slope_here():
    plain, lines = physics_of(bundled("hybrid").parameters), lines_of("hybrid")
    rubbing = add(plain, guide_friction=0.02)
    mass = partial(moved, record="bodies", name="table_mass", by=0.1)
    heavier, to_friction = Move(plain, mass(plain), 0.1), Move(plain, rubbing, 0.02)
    slope, none = log_response_slopes(plain, lines, [heavier, to_friction])
    assert slope is not None
    assert none is None
    assert log_response_slopes(rubbing, lines, [Move(rubbing, mass(rubbing), 0.1)]) == [None]


@dataclass(frozen=True)
class HeldAtSome:
    """The far bearing holds at some settings only."""

    def __call__(self, axis: AxisPhysics, setting):
        stiffness = 1e7 if setting.excitation_level > 0.2 else 0.0
        return replace(axis, joints=replace(axis.joints, far_bearing_stiffness=stiffness))


def test_an_axis_of_other_terms_at_some_settings_has_no_slopes():
    axis, lines = replace(physics_of(bundled("hybrid").parameters), by_setting=(HeldAtSome(),)), lines_of("hybrid")
    assert log_response_slopes(axis, lines, [Move(axis, moved(axis, "bodies", "table_mass", 0.1), 0.1)]) == [None]


@pytest.mark.parametrize(
    "function",
    [
        lambda x, y: x * y + x / y - 2.0 / (x - y),
        lambda x, y: np.array([2.0, 3.0]) ** x + x**y + x**2.0,
        lambda x, y: np.exp(np.sin(x) * np.cos(y)) - np.arctan(x * y),
        lambda x, y: np.sqrt(x + 2j * y) * np.where(np.array([True, False]), x, y),
        lambda x, y: np.maximum(x, y) * np.maximum(x, 1.5) - (-y),
    ],
)
def test_a_traced_function_has_the_slopes_of_its_differences(function):
    x, y, step = np.array([1.2, 1.9]), np.array([0.7, 2.4]), 1e-6
    found = derivatives(function(traced_x := Traced(x), traced_y := Traced(y)), [traced_x, traced_y])
    by_x = (function(x + step, y) - function(x - step, y)) / (2.0 * step)
    by_y = (function(x, y + step) - function(x, y - step)) / (2.0 * step)
    np.testing.assert_allclose(found[0] + np.zeros(2), by_x, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(found[1] + np.zeros(2), by_y, rtol=1e-7, atol=1e-9)


def test_a_number_that_nothing_was_made_of_has_no_slope():
    value, other = Traced(np.array([1.0])), Traced(np.array([2.0]))
    assert derivatives(value * value, [other]) == [0.0]
