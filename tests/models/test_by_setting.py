"""An axis that is another one at each setting: each setting answers as a plain axis with what it has there."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from monitor_core.models.extended import natural_frequencies, physics_of, prepare_lines, responses
from monitor_core.models.extended.by_setting import axes_by_setting
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


def test_settings_at_which_the_axis_is_the_same_are_evaluated_together():
    """The axis follows the excitation alone: there are as many axes as levels, each with all of its positions."""
    pair = ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ACCELERATION_AT_TABLE
    lines = prepare_lines([case_of(PARAMETERS, BAND, at, *pair) for at in settings()])
    axes = list(axes_by_setting(replace(physics_of(PARAMETERS), by_setting=(Softer(),)), lines))
    assert len(axes) == len(LEVELS)
    assert all(part.cases.size == len(SHARES) for _, part in axes)
    assert np.array_equal(np.sort(np.concatenate([part.place for _, part in axes])), np.arange(lines.omega.size))


def test_every_setting_has_the_modes_of_its_axis():
    physics, ends = physics_of(PARAMETERS), [MotorEnd.FREE] * len(settings())
    found = natural_frequencies(replace(physics, by_setting=(Softer(),)), settings(), ends, 2000.0)
    for conditions, modes in zip(settings(), found, strict=True):
        (alone,) = natural_frequencies(plain_at(conditions, physics), [conditions], [MotorEnd.FREE], 2000.0)
        assert modes == alone


def test_lines_under_other_conditions_follow_them():
    """A comparison moves positions; what depends on the setting moves along."""
    physics = replace(physics_of(PARAMETERS), by_setting=(Softer(),))
    pair = ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ACCELERATION_AT_TABLE
    lines = prepare_lines([case_of(PARAMETERS, BAND, at, *pair) for at in settings()])
    moved = replace(lines, conditions=replace(lines.conditions, position=lines.conditions.position + 0.01))
    there = [replace(at, position=at.position + 0.01) for at in settings()]
    expected = responses(physics, prepare_lines([case_of(PARAMETERS, BAND, at, *pair) for at in there]))
    np.testing.assert_allclose(responses(physics, moved), expected, rtol=1e-12)
