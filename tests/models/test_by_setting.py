"""An axis that is another one at each setting: each setting answers as a plain axis with what it has there."""

from dataclasses import dataclass, fields, replace

import numpy as np
import pytest

from monitor_core.models.extended import AxisSetting, natural_frequencies, physics_of, prepare_lines, responses
from monitor_core.models.extended.settings import axes_by_setting
from monitor_core.models.protocol import ExcitationPoint, MotorEnd, ResponsePoint
from tests.models.extended_axes import add, bundled, case_of, conditions_of

PARAMETERS = bundled("hybrid").parameters
BAND = np.geomspace(20.0, 900.0, 40)
SHARES, LEVELS = (0.2, 0.45, 0.7), (0.05, 0.15, 0.5)


@dataclass(frozen=True)
class Softer:
    """The bearing is softer the more the axis is excited."""

    def __call__(self, axis, setting):
        stiffness = axis.joints.bearing_stiffness * softened(setting.excitation_level)
        return replace(axis, joints=replace(axis.joints, bearing_stiffness=stiffness))


def softened(level):
    return 1.0 - 0.5 * level


def settings():
    return [conditions_of(PARAMETERS, share, excitation_level=level) for share in SHARES for level in LEVELS]


def plain_at(conditions, physics):
    stiffness = physics.joints.bearing_stiffness * softened(conditions.excitation_level)
    return replace(physics, joints=replace(physics.joints, bearing_stiffness=stiffness))


@pytest.mark.parametrize("added", [{}, {"guide_friction": 0.02}], ids=["linear", "friction"])
def test_every_setting_answers_as_the_axis_that_it_has(added):
    """With friction the excitation of each setting goes with its lines."""
    physics = add(physics_of(PARAMETERS), **added)
    points = (
        (ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ACCELERATION_AT_TABLE),
        (ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ANGLE_AT_MOTOR),
        (ExcitationPoint.FORCE_AT_TABLE, ResponsePoint.ACCELERATION_AT_NUT),
    )
    cases = [case_of(PARAMETERS, BAND, at, *pair) for at in settings() for pair in points]
    found = responses(replace(physics, by_setting=(Softer(),)), prepare_lines(cases))
    alone = [responses(plain_at(case.conditions, physics), prepare_lines([case])) for case in cases]
    np.testing.assert_allclose(found, np.concatenate(alone), rtol=1e-12)


@dataclass(frozen=True)
class AnotherAtEach:
    """Everything that a drive has is another value at each setting; what acts at some of them only is named."""

    at_some: tuple[tuple[str, float], ...] = ()

    def __call__(self, axis, setting):
        factor = 1.0 + 0.1 * setting.position + 0.2 * setting.excitation_level
        for record in ("screw", "joints", "bodies", "added"):
            part = getattr(axis, record)
            axis = replace(axis, **{record: replace(part, **varied(part, factor))})
        return add(axis, **dict(self.at_some)) if setting.excitation_level > 0.1 else axis


def varied(record, factor):
    """Shares have a bound, and a longer screw or another lead are no numbers of a setting."""
    names = (item.name for item in fields(record) if item.name not in ("length", "lead", "far_end_held_share"))
    values = {name: getattr(record, name) for name in names if not name.endswith("_share")}
    return {name: factor * value for name, value in values.items() if value and np.isfinite(value)}


EVERYTHING = {
    "table_mass": 1.0, "nut_mass": 0.4, "table_absorber_mass": 2.0, "table_absorber_frequency": 150.0,
    "table_absorber_damping_ratio": 0.02, "nut_absorber_mass": 0.3, "nut_absorber_frequency": 310.0,
    "rotor_absorber_inertia": 1e-5, "rotor_absorber_frequency": 250.0, "screw_end_absorber_mass": 0.5,
    "screw_end_absorber_frequency": 420.0, "series_compliance": 1e-9, "guide_stiffness": 1e6, "servo_stiffness": 5.0,
    "base_compliance": 1e-9, "base_frequency": 90.0, "base_damping_ratio": 0.05, "thermal_stiffness": -1e-4,
    "periodic_preload_cosine": 0.1, "position_offset": 1e-3, "torque_delay": 1e-5, "response_delay": 2e-5,
    "angle_delay": 3e-5, "response_ln_factor": 0.1, "torque_ln_factor": -0.1, "mounting_inverse_square": 1e-8,
    "mounting_damping_ratio": 0.02, "second_mode_residue": 1e-3, "second_mode_frequency": 500.0,
    "second_mode_damping_ratio": 0.01,
}  # fmt: skip


@pytest.mark.parametrize("at_some", [(), (("guide_friction", 0.02),), (("cubic_nut_stiffness", 1e8),)])
def test_whatever_differs_is_evaluated_as_at_each_setting_alone(at_some):
    physics = add(physics_of(PARAMETERS), **EVERYTHING)
    physics = replace(physics, joints=replace(physics.joints, causal_loss_factor=0.01, bearing_damping=50.0))
    physics = replace(physics, screw=replace(physics.screw, causal_loss_factor=0.002))
    points = (
        (ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ACCELERATION_AT_TABLE),
        (ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ANGLE_AT_MOTOR),
        (ExcitationPoint.FORCE_AT_TABLE, ResponsePoint.ACCELERATION_AT_NUT),
    )
    cases = [case_of(PARAMETERS, BAND, at, *pair) for at in settings() for pair in points]
    change = AnotherAtEach(at_some)
    found = responses(replace(physics, by_setting=(change,)), prepare_lines(cases))
    alone = [responses(change(physics, setting_of(case.conditions)), prepare_lines([case])) for case in cases]
    np.testing.assert_allclose(found, np.concatenate(alone), rtol=1e-10)


def setting_of(conditions):
    return AxisSetting(position=conditions.position, excitation_level=conditions.excitation_level)


@pytest.mark.parametrize(("at_some", "n_groups"), [((), 1), ((("table_absorber_mass", 1.0),), 2)])
def test_settings_are_evaluated_together_but_for_those_with_other_terms(at_some, n_groups):
    """An absorber that hangs at some settings only has no frequency elsewhere."""
    pair = ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ACCELERATION_AT_TABLE
    lines = prepare_lines([case_of(PARAMETERS, BAND, at, *pair) for at in settings()])
    change = AnotherAtEach((*at_some, ("table_absorber_frequency", 150.0)) if at_some else ())
    axes = list(axes_by_setting(replace(physics_of(PARAMETERS), by_setting=(change,)), lines))
    assert len(axes) == n_groups
    assert np.array_equal(np.sort(np.concatenate([part.place for _, part in axes])), np.arange(lines.omega.size))


def test_one_axis_after_another_is_answered_on_the_same_lines():
    """What was remembered of an axis with one quantity that differs is not taken for another one."""
    pair = ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ACCELERATION_AT_TABLE
    cases = [case_of(PARAMETERS, BAND, at, *pair) for at in settings()]
    lines, plain = prepare_lines(cases), physics_of(PARAMETERS)
    for physics in (plain, replace(plain, by_setting=(Softer(),)), replace(plain, by_setting=(AnotherAtEach(),))):
        np.testing.assert_allclose(responses(physics, lines), responses(physics, prepare_lines(cases)), rtol=1e-12)


def test_every_setting_has_the_modes_of_its_axis():
    physics, ends = physics_of(PARAMETERS), [MotorEnd.FREE] * len(settings())
    found = natural_frequencies(replace(physics, by_setting=(Softer(),)), settings(), ends, 2000.0)
    for conditions, modes in zip(settings(), found, strict=True):
        (alone,) = natural_frequencies(plain_at(conditions, physics), [conditions], [MotorEnd.FREE], 2000.0)
        pairs = [[(mode.frequency, mode.damping_ratio) for mode in each] for each in (modes, alone)]
        np.testing.assert_allclose(*pairs, rtol=1e-9)


def test_lines_under_other_conditions_follow_them():
    """A comparison moves positions; what depends on the setting moves along."""
    physics = replace(physics_of(PARAMETERS), by_setting=(Softer(),))
    pair = ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ACCELERATION_AT_TABLE
    lines = prepare_lines([case_of(PARAMETERS, BAND, at, *pair) for at in settings()])
    moved = replace(lines, conditions=replace(lines.conditions, position=lines.conditions.position + 0.01))
    there = [replace(at, position=at.position + 0.01) for at in settings()]
    expected = responses(physics, prepare_lines([case_of(PARAMETERS, BAND, at, *pair) for at in there]))
    np.testing.assert_allclose(responses(physics, moved), expected, rtol=1e-12)
