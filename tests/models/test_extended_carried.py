"""What hangs at the contacts of the nut, and what screw and rotor lose: matrices, closed forms, power."""

import math
from dataclasses import replace

import numpy as np
import pytest

from monitor_core.models.extended import ExtendedModel, natural_frequencies, physics_of, prepare_lines
from monitor_core.models.extended.conditions import axis_states
from monitor_core.models.extended.rms_motion import motion_at
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from tests.models.extended_axes import add, bundled, case_of, response_of, undamped
from tests.models.test_extended_modes import assembled

PARAMETERS = bundled("receptance").parameters
POSITION = 0.37 * PARAMETERS.screw_length
FORCE, TORQUE = ExcitationPoint.FORCE_AT_TABLE, ExcitationPoint.TORQUE_AT_MOTOR
TABLE, NUT, ANGLE = (
    ResponsePoint.DISPLACEMENT_AT_TABLE, ResponsePoint.ACCELERATION_AT_NUT, ResponsePoint.ANGLE_AT_MOTOR
)  # fmt: skip
BAND = np.geomspace(20.0, 900.0, 40)
NUT_AND_ABSORBERS = {
    "nut_mass": 1.3, "series_compliance": 4e-9,
    "table_absorber_mass": 0.8, "table_absorber_frequency": 170.0, "table_absorber_damping_ratio": 0.03,
    "nut_absorber_mass": 0.2, "nut_absorber_frequency": 450.0, "nut_absorber_damping_ratio": 0.08,
}  # fmt: skip
AT_ROTOR_AND_END = {
    "rotor_absorber_inertia": 2e-4, "rotor_absorber_frequency": 300.0, "rotor_absorber_damping_ratio": 0.05,
    "screw_end_absorber_mass": 3.0, "screw_end_absorber_frequency": 400.0, "screw_end_absorber_damping_ratio": 0.06,
}  # fmt: skip


def answer(physics, excitation, response, frequency=BAND):
    case = case_of(PARAMETERS, frequency, DriveConditions(POSITION), excitation, response)
    return response_of(physics, replace(case, motor_end=MotorEnd.FREE))


@pytest.mark.release
@pytest.mark.parametrize("more", [{}, AT_ROTOR_AND_END, {**AT_ROTOR_AND_END, "base_compliance": 3e-9,
                                                         "base_frequency": 240.0}])  # fmt: skip
def test_responses_are_those_of_finite_elements_with_dampers(more) -> None:
    """To the length of the elements, which moves the modes by some 1e-4."""
    physics = add(undamped(physics_of(PARAMETERS)), **NUT_AND_ABSORBERS, **more)
    elements = assembled(PARAMETERS, POSITION, **NUT_AND_ABSORBERS, **more)
    omega = 2.0 * np.pi * BAND
    nut = elements.size - 3 - 2 * ("rotor_absorber_inertia" in more)
    for point, excitation in ((elements.table, FORCE), (elements.rotor, TORQUE)):
        load = np.zeros(elements.size)
        load[point] = 1.0
        stiffness, damping, mass = (
            matrix.toarray() for matrix in (elements.screw + elements.springs, elements.damping, elements.mass)
        )
        used = np.flatnonzero(mass.diagonal() > 0)
        at = np.ix_(used, used)
        motion = np.zeros((omega.size, elements.size), dtype=complex)
        for line, w in enumerate(omega):
            motion[line, used] = np.linalg.solve((stiffness + 1j * w * damping - w**2 * mass)[at], load[used])
        for response, theirs in ((TABLE, motion[:, elements.table]), (NUT, -(omega**2) * motion[:, nut])):
            ours = answer(physics, excitation, response)
            assert np.max(np.abs(ours - theirs)) < 3e-3 * np.max(np.abs(theirs))
            np.testing.assert_allclose(ours, theirs, rtol=0.02)


@pytest.mark.parametrize("place", ["table", "nut"])
def test_an_absorber_holds_what_it_hangs_on_still_at_its_own_frequency(place) -> None:
    """Den Hartog: without a damper, the body at √(k/m) does not move; with one of ratio ζ, by 2ζ as much and so on."""
    hanging = {f"{place}_absorber_mass": 0.4, f"{place}_absorber_frequency": 310.0, "series_compliance": 4e-9}
    response = TABLE if place == "table" else NUT
    plain = add(physics_of(PARAMETERS), series_compliance=4e-9)
    free = answer(plain, TORQUE, response, [310.0])
    moved = [
        answer(add(plain, **hanging, **{f"{place}_absorber_damping_ratio": ratio}), TORQUE, response, [310.0])
        for ratio in (0.0, 1e-6, 2e-6)
    ]
    assert abs(moved[0][0]) < 1e-12 * abs(free[0])
    assert moved[2][0] == pytest.approx(2.0 * moved[1][0], rel=1e-3)
    if place == "nut":  # and the table then is driven by nothing: the force on it goes through the bracket alone
        table = answer(add(plain, **hanging), TORQUE, TABLE, [310.0])
        assert abs(table[0]) < 1e-9 * abs(answer(plain, TORQUE, TABLE, [310.0])[0])


def test_a_slow_absorber_is_not_there_and_a_fast_one_is_its_mass() -> None:
    physics = physics_of(PARAMETERS)
    slow = add(physics, table_absorber_mass=0.8, table_absorber_frequency=0.2)
    fast = add(physics, table_absorber_mass=0.8, table_absorber_frequency=1e6)
    np.testing.assert_allclose(answer(slow, FORCE, TABLE), answer(physics, FORCE, TABLE), rtol=2e-3)
    np.testing.assert_allclose(
        answer(fast, FORCE, TABLE), answer(add(physics, table_mass=0.8), FORCE, TABLE), rtol=1e-4
    )


def test_the_nut_takes_nothing_from_the_whole_and_is_the_table_behind_a_rigid_bracket() -> None:
    physics = physics_of(PARAMETERS)
    moved = add(physics, series_compliance=4e-9, nut_mass=1.3)
    slowly = np.array([0.5])
    whole = answer(add(physics, series_compliance=4e-9), TORQUE, TABLE, slowly)
    assert answer(moved, TORQUE, TABLE, slowly)[0] == pytest.approx(whole[0], rel=1e-6)
    rigid = add(physics, nut_mass=1.3)
    np.testing.assert_allclose(answer(rigid, TORQUE, TABLE), answer(physics, TORQUE, TABLE), rtol=1e-12)


def test_an_accelerometer_on_the_nut_knows_its_mass_already() -> None:
    """Its response holds the stated mass before the bracket: the effect adds none, until it is more."""
    stated = replace(PARAMETERS, nut_mass=1.3, bracket_stiffness=2.1e8)
    physics = physics_of(stated)
    np.testing.assert_allclose(
        answer(add(physics, nut_mass=1.3), TORQUE, NUT), answer(physics, TORQUE, NUT), rtol=1e-10
    )
    assert not np.allclose(answer(add(physics, nut_mass=2.0), TORQUE, NUT), answer(physics, TORQUE, NUT), rtol=1e-3)


@pytest.mark.parametrize("loss_factor", [0.002, pytest.param(0.05, marks=pytest.mark.release)])
def test_damping_ratio_of_a_free_bar_is_half_the_loss_factor_of_its_steel(loss_factor) -> None:
    r"""Of :math:`M s^2 + K (s/\omega_0)^\gamma = 0` it is −cos(π/(2 − γ)), γ = 2/π arctan η; η/2 for a small η.

    The springs that hold the bar lose nothing and are a ten-thousandth of its own stiffness.
    """
    physics = undamped(
        physics_of(replace(PARAMETERS, screw_nut_segment_mass=0.0)),
        bearing_stiffness=3e3, far_bearing_stiffness=0.0, nut_stiffness=3e3,
    )  # fmt: skip
    lossy = replace(physics, screw=replace(physics.screw, causal_loss_factor=loss_factor))
    modes = natural_frequencies(lossy, [DriveConditions(POSITION)], [MotorEnd.CLAMPED], 4500.0)[0]
    speed = math.sqrt(physics.screw.axial_rigidity / physics.screw.mass_per_length)
    bar = speed / (2.0 * physics.screw.length)
    (first,) = (mode for mode in modes if 0.97 * bar < mode.frequency < 1.1 * bar)
    gamma = 2.0 / math.pi * math.atan(loss_factor)
    assert first.damping_ratio == pytest.approx(-math.cos(math.pi / (2.0 - gamma)), rel=1e-3)
    assert first.damping_ratio == pytest.approx(0.5 * loss_factor, rel=0.03)


def test_a_screw_of_lossy_steel_is_one_of_complex_moduli() -> None:
    """At 200 Hz the moduli are E (1 + jη) and G (1 + jη): held at its end, the screw alone is that spring."""
    physics = undamped(physics_of(PARAMETERS), bearing_stiffness=1e15, nut_stiffness=1e15, far_bearing_stiffness=0.0)
    light = replace(physics.screw, mass_per_length=1e-9, inertia_per_length=1e-12, torsion_share=0.0,
                    nut_segment_mass=0.0, nut_segment_inertia=0.0, motor_segment_inertia=0.0)  # fmt: skip
    screw = replace(physics, screw=replace(light, causal_loss_factor=0.04))
    case = case_of(PARAMETERS, [200.0], DriveConditions(POSITION), FORCE, TABLE)
    (response,) = response_of(screw, replace(case, motor_end=MotorEnd.CLAMPED))
    moving = PARAMETERS.table_mass + PARAMETERS.nut_mass
    i = physics.screw.transmission_ratio
    held = 1.0 / response + (400.0 * np.pi) ** 2 * moving
    compliance = POSITION / (physics.screw.axial_rigidity * (1.0 + 0.04j)) + i**2 / physics.joints.coupling_stiffness
    assert held == pytest.approx(1.0 / compliance, rel=1e-5)


def test_all_power_goes_into_the_only_damper_the_motors() -> None:
    r"""Where nothing else damps, the power that a torque brings is :math:`c |\omega \theta|^2/2`."""
    physics = undamped(physics_of(PARAMETERS))
    damped = replace(physics, bodies=replace(physics.bodies, motor_damping=4e-3))
    angle, omega = answer(damped, TORQUE, ANGLE), 2.0 * np.pi * BAND
    brought = 0.5 * (1j * omega * angle).real
    np.testing.assert_allclose(brought, 0.5 * 4e-3 * np.abs(omega * angle) ** 2, rtol=1e-6)


def test_modes_with_all_that_hangs_superpose_to_the_response() -> None:
    physics = add(undamped(physics_of(PARAMETERS)), **{
        name: value for name, value in NUT_AND_ABSORBERS.items() if not name.endswith("ratio")
    })  # fmt: skip
    modes = ExtendedModel(PARAMETERS, physics, 20_000.0).normal_modes(DriveConditions(POSITION), MotorEnd.FREE)
    frequency = np.array([40.0, 90.0, 200.0, 420.0])
    shapes = modes.angle_at_motor * modes.displacement_at_table
    square = (2.0 * np.pi * modes.frequency) ** 2 - (2.0 * np.pi * frequency[:, None]) ** 2
    np.testing.assert_allclose(
        np.sum(shapes / square, axis=1), answer(physics, TORQUE, TABLE, frequency).real, rtol=2e-3
    )


def test_damping_of_all_that_hangs_is_followed_to_the_poles() -> None:
    """Each pole is a zero of the determinant of the matrices of finite elements, to the length of the elements."""
    physics = add(undamped(physics_of(PARAMETERS)), **NUT_AND_ABSORBERS)
    modes = natural_frequencies(physics, [DriveConditions(POSITION)], [MotorEnd.FREE], 700.0)[0]
    elements = assembled(PARAMETERS, POSITION, **NUT_AND_ABSORBERS)
    stiffness, damping, mass = (
        matrix.toarray() for matrix in (elements.screw + elements.springs, elements.damping, elements.mass)
    )
    used = np.flatnonzero(mass.diagonal() > 0)
    at = np.ix_(used, used)
    inverse = np.linalg.inv(mass[at])
    n = used.size
    states = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness[at], -inverse @ damping[at]]])
    poles = np.linalg.eigvals(states)
    poles = poles[(poles.imag > 1.0) & (np.abs(poles) < 2.0 * np.pi * 700.0)]
    poles = poles[np.argsort(np.abs(poles))]
    found = [mode for mode in modes if mode.frequency > 0.0]
    assert len(found) == len(poles)
    np.testing.assert_allclose([mode.frequency for mode in found], np.abs(poles) / (2.0 * np.pi), rtol=3e-4)
    np.testing.assert_allclose(
        [mode.damping_ratio for mode in found], -poles.real / np.abs(poles), rtol=2e-3, atol=1e-6
    )


@pytest.mark.parametrize("excitation", [FORCE, TORQUE])
def test_friction_and_hardening_see_the_motion_of_what_is_carried(excitation) -> None:
    """The rms motion is that of the responses; damper and hardening act as a damper and a stiffer nut of the axis."""
    physics = add(physics_of(PARAMETERS), **NUT_AND_ABSORBERS, guide_friction=1.0, cubic_nut_stiffness=1e10)
    level, lines = 0.2, np.linspace(20.0, 900.0, 40_000)
    case = case_of(PARAMETERS, lines[[0, -1]], DriveConditions(POSITION, excitation_level=level), excitation, TABLE)
    prepared = prepare_lines([replace(case, motor_end=MotorEnd.FREE)])

    def rms(axis, damping, hardening):
        motion = motion_at(axis, prepared, axis_states(axis, prepared.conditions))
        return motion.rms(np.array([damping]), np.array([hardening]))[:, 0]

    linear = add(physics, guide_friction=0.0, cubic_nut_stiffness=0.0)
    velocity = 2.0 * np.pi * lines * np.abs(answer(linear, excitation, TABLE, lines))
    assert rms(physics, 0.0, 0.0)[0] == pytest.approx(level * math.sqrt(np.mean(velocity**2)), rel=0.01)
    damped = replace(physics, bodies=replace(physics.bodies, table_damping=physics.bodies.table_damping + 300.0))
    np.testing.assert_allclose(rms(physics, 300.0, 0.2), rms(damped, 0.0, 0.2), rtol=1e-6)
    joints = replace(physics.joints, nut_stiffness=1.2 * physics.joints.nut_stiffness)
    np.testing.assert_allclose(rms(physics, 50.0, 0.2), rms(replace(physics, joints=joints), 50.0, 0.0), rtol=1e-6)
