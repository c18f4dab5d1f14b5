"""Hypotheses: coordinates mean what they say, nothing is lost on the way from one hypothesis to another."""

import math
from dataclasses import replace

import numpy as np
import pytest

from monitor_core.effects import wrong_parameter
from monitor_core.effects.effect import EffectParameter
from monitor_core.fitting.hypothesis import Hypothesis, searched_range
from monitor_core.models.extended import physics_of
from tests.discrepancy.axes import AXIS, TOLERANCES, effects_by_key, subject

EFFECTS = effects_by_key()
WRONG_BEARING = wrong_parameter("bearing_stiffness_n_per_m", AXIS)
FAR, MASS, MOUNTING = (
    EFFECTS[key] for key in ("far-bearing-stiffness", "added-mass", "sensor-mounting-resonance")
)  # fmt: skip


def test_coordinates_are_priors_and_scales() -> None:
    """One standard deviation of each uncertain parameter; effects from their null by their scale."""
    hypothesis = Hypothesis(subject(), (FAR, MOUNTING))
    found = hypothesis.physics(np.array([1.0, -2.0, 0.0, 0.5, 1.0, -0.5]))
    bearing, bracket = 1e8 * math.exp(0.2), 2.1e8 * math.exp(-0.4)
    assert found.joints.bearing_stiffness == pytest.approx(bearing)
    assert found.joints.bracket_stiffness == pytest.approx(bracket)
    assert found.joints.loss_factor == AXIS.loss_factor
    assert found.joints.far_bearing_stiffness == pytest.approx(0.5 * FAR.parameters[0].scale)
    inverse_square, bandwidth = MOUNTING.parameters
    assert found.added.mounting_inverse_square == pytest.approx(inverse_square.scale)
    # the bandwidth b = 2 ζ f, with the frequency f = 1/(2π √q)
    frequency = 1.0 / (2.0 * math.pi * math.sqrt(inverse_square.scale))
    assert 2.0 * found.added.mounting_damping_ratio * frequency == pytest.approx(bandwidth.null - 0.5 * bandwidth.scale)


def test_null_is_the_axis_as_stated() -> None:
    hypothesis = Hypothesis(subject(), (FAR, MASS))
    assert hypothesis.n_coordinates == len(TOLERANCES) + 2
    assert hypothesis.physics(hypothesis.null) == physics_of(AXIS)


def test_a_parameter_that_is_called_wrong_is_not_held_by_its_tolerance() -> None:
    hypothesis = Hypothesis(subject(), (WRONG_BEARING,))
    assert hypothesis.uncertain == tuple(name for name in TOLERANCES if name != "bearing_stiffness_n_per_m")
    at = np.array([0.0, 0.0, 7.0])
    assert hypothesis.ln_ratios(at) == dict.fromkeys(hypothesis.uncertain, 0.0)
    assert hypothesis.physics(at).joints.bearing_stiffness == pytest.approx(1e8 * math.exp(0.7))


def test_calling_a_parameter_wrong_leaves_the_axis_where_its_tolerance_let_it_go() -> None:
    held = Hypothesis(subject(), (FAR,))
    at = np.array([1.3, -0.4, 0.2, 0.6])
    freed = held.with_effect(WRONG_BEARING)
    before, after = held.physics(at), freed.physics(freed.carried_over(held, at))
    assert after.joints.bearing_stiffness == pytest.approx(before.joints.bearing_stiffness, rel=1e-12)
    assert after.joints.bracket_stiffness == pytest.approx(before.joints.bracket_stiffness, rel=1e-12)
    assert after.joints.far_bearing_stiffness == before.joints.far_bearing_stiffness


def test_there_and_back_again() -> None:
    """What another hypothesis lacks is null in it, and its own coordinates stay."""
    fuller = Hypothesis(subject(), (FAR, MASS))
    other = fuller.without("added-mass").with_effect(MOUNTING)
    at = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    there = other.carried_over(fuller, at)
    np.testing.assert_allclose(there, [0.1, 0.2, 0.3, 0.4, 0.0, 0.0])
    np.testing.assert_allclose(fuller.carried_over(other, there), [0.1, 0.2, 0.3, 0.4, 0.0])


def test_bounds_hold_sizes_to_a_possible_sign_and_let_them_leave_the_plausible_range() -> None:
    """A stiffness may not be negative, yet be far above what is plausible; what shapes an effect may do neither."""
    hypothesis = Hypothesis(subject(), (FAR, MOUNTING, WRONG_BEARING, EFFECTS["torque-delay"]))
    lower, upper = hypothesis.bounds
    far, inverse_square, bandwidth, wrong, delay = range(2, 7)
    assert np.all(np.isinf(np.r_[lower[:2], upper[:2]]))
    assert lower[far] == 0.0
    assert upper[far] * FAR.parameters[0].scale > 2.0 * FAR.parameters[0].upper
    assert lower[inverse_square] == 0.0
    for index, parameter in ((bandwidth, MOUNTING.parameters[1]), (wrong, WRONG_BEARING.parameters[0])):
        assert parameter.null + parameter.scale * lower[index] == pytest.approx(parameter.lower)
        assert parameter.null + parameter.scale * upper[index] == pytest.approx(parameter.upper)
    of_delay = EFFECTS["torque-delay"].parameters[0]
    assert of_delay.scale * lower[delay] < 2.0 * of_delay.lower
    assert of_delay.scale * upper[delay] > 2.0 * of_delay.upper
    assert searched_range(FAR, FAR.parameters[0]) == pytest.approx((0.0, upper[far] * FAR.parameters[0].scale))


def test_textbook_values() -> None:
    """All of the screw's mass and inertia are spread along it, uncertain parameters stay where they were."""
    known = [effect for effect in EFFECTS.values() if effect.textbook is not None]
    hypothesis = Hypothesis(subject(), tuple(known))
    at = hypothesis.at_textbook_values(np.array([0.5, 0.0, 0.0]))
    physics = hypothesis.physics(at)
    assert physics.screw.axial_mass_share == pytest.approx(1.0)
    assert physics.screw.torsional_inertia_share == pytest.approx(1.0)
    assert physics.screw.torsion_share == 1.0
    assert physics.joints.bearing_stiffness == pytest.approx(1e8 * math.exp(0.1))


def test_bounds_of_what_can_only_be_less() -> None:
    """As a user's own effect may be: a preload that was lost, say."""
    parameter = EffectParameter("size", "-", lower=-5.0, upper=0.0, scale=-0.5)
    hypothesis = Hypothesis(subject(), (replace(FAR, parameters=(parameter,)),))
    lower, upper = hypothesis.bounds
    assert lower[-1] < upper[-1]
