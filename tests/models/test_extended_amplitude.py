"""Friction and a hardening nut: the linearised drive against the motion itself, computed step by step."""

from dataclasses import replace

import numpy as np
import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended import AxisPhysics, physics_of
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, ResponsePoint
from tests.models.extended_axes import TORQUES, add, bundled, case_of, response_of, undamped

LUMPED = bundled("lumped").parameters
FORCE = ExcitationPoint.FORCE_AT_TABLE
MASS = LUMPED.table_mass + LUMPED.nut_mass + LUMPED.screw_mass
AT = DriveConditions(0.5, 400.0)
#: Lines of a periodic excitation of half a second around the only mode.
FREQUENCY = np.arange(120.0, 281.0, 2.0)
SAMPLE_RATE, PERIOD = 16_000.0, 8_000


def damped(physics: AxisPhysics, damping: float) -> AxisPhysics:
    return replace(physics, bodies=replace(physics.bodies, table_damping=damping))


def nut_alone() -> AxisPhysics:
    """Return the axis with everything rigid but the nut, whose deflection then is that of the table."""
    physics = undamped(physics_of(LUMPED), bracket_stiffness=1e14, bearing_stiffness=1e14, coupling_stiffness=1e12)
    screw = replace(physics.screw, axial_rigidity=1e14, torsion_share=0.0)
    joints = replace(physics.joints, nut_stiffness=MASS * (2.0 * np.pi * 200.0) ** 2 / 0.8)
    return replace(physics, screw=screw, joints=joints)


def response(physics: AxisPhysics, level: float, excitation=FORCE, frequency=FREQUENCY):
    conditions = replace(AT, excitation_level=level)
    return response_of(physics, case_of(LUMPED, frequency, conditions, excitation))


def simulated_response(stiffness, damping, level, *, friction=0.0, cubic=0.0, n_runs=150):
    """Return H1 of a mass on its spring under random-phase excitation of flat lines, from its motion in time.

    Leapfrog, the damper taken at mid-step. Friction is a constraint: an impulse of at most F Δt, which may bring the
    mass to rest but not turn it.
    """
    rng, step = np.random.default_rng(7), 1.0 / SAMPLE_RATE
    lines = np.rint(FREQUENCY * PERIOD / SAMPLE_RATE).astype(int)
    spectrum = np.zeros((n_runs, PERIOD // 2 + 1), dtype=complex)
    spectrum[:, lines] = np.exp(2j * np.pi * rng.random((n_runs, lines.size)))
    force = np.fft.irfft(spectrum, PERIOD, axis=1)
    force = np.ascontiguousarray((force * level / np.sqrt(np.mean(force**2))).T)
    position, velocity = np.zeros(n_runs), np.zeros(n_runs)
    moved, half = np.empty((2, PERIOD, n_runs)), 0.5 * step * damping / MASS
    for period in range(3):  # in the first the motion settles
        for n in range(PERIOD):
            if period:
                moved[period - 1, n] = position
            spring = stiffness * position * (1.0 + cubic * position**2)
            velocity = ((1.0 - half) * velocity + step / MASS * (force[n] - spring)) / (1.0 + half)
            velocity = np.sign(velocity) * np.maximum(np.abs(velocity) - step / MASS * friction / (1.0 + half), 0.0)
            position = position + step * velocity
    motion, drive = (np.fft.rfft(x, axis=-2)[..., lines, :] for x in (moved.mean(axis=0), force))
    return np.sum(motion * drive.conj(), axis=1) / np.sum(np.abs(drive) ** 2, axis=1)


def mass_spring_damper(receptance):
    """Return stiffness and damping of the oscillator, weighted as its response is large."""
    omega, stiffness = 2.0 * np.pi * FREQUENCY, 1.0 / receptance
    weight = np.abs(receptance) ** 2 / np.sum(np.abs(receptance) ** 2)
    return np.sum(weight * (stiffness.real + omega**2 * MASS)), np.sum(weight * stiffness.imag / omega)


@pytest.mark.parametrize("friction", [1.0, 3.0])
def test_friction_damps_as_in_the_motion_itself(friction) -> None:
    """At 10 N rms. What the linearisation leaves out, a velocity that is not Gaussian, is a few percent of c_e."""
    physics = damped(undamped(physics_of(LUMPED)), 400.0)
    stiffness = 1.0 / response(physics, 0.0, frequency=np.array([1e-3]))[0].real
    predicted = response(add(physics, guide_friction=friction), 10.0)
    simulated = simulated_response(stiffness, 400.0, 10.0, friction=friction)
    added_predicted, added_simulated = (mass_spring_damper(one)[1] - 400.0 for one in (predicted, simulated))
    assert added_simulated > 50.0  # [N·s/m], so that percents mean something
    assert added_predicted == pytest.approx(added_simulated, rel=0.06)
    assert np.max(np.abs(predicted)) == pytest.approx(np.max(np.abs(simulated)), rel=0.05)


def test_hardening_stiffens_as_in_the_motion_itself() -> None:
    physics = damped(nut_alone(), 2000.0)
    stiffness = 1.0 / response(physics, 0.0, frequency=np.array([1e-3]))[0].real
    sigma = np.sqrt(np.mean(np.abs(response(physics, 10.0)) ** 2)) * 10.0
    cubic = 0.04 / (3.0 * sigma**2)  # stiffer by 4 % at the first guess
    predicted = response(add(physics, cubic_nut_stiffness=cubic), 10.0)
    simulated = simulated_response(stiffness, 2000.0, 10.0, cubic=cubic)
    stiffer_predicted, stiffer_simulated = (
        mass_spring_damper(one)[0] / stiffness - 1.0 for one in (predicted, simulated)
    )
    assert stiffer_simulated > 0.02
    assert stiffer_predicted == pytest.approx(stiffer_simulated, rel=0.06)


@pytest.mark.parametrize(("excitation", "level"), [(FORCE, 4.0), *((torque, 0.005) for torque in TORQUES)])
def test_only_friction_relative_to_the_level_counts(excitation, level) -> None:
    """Twice the friction at twice the level, and a quarter of β at twice the level, are the same motion scaled."""
    physics = physics_of(LUMPED)
    once = response(add(physics, guide_friction=2.0, cubic_nut_stiffness=4e12), level, excitation)
    twice = response(add(physics, guide_friction=4.0, cubic_nut_stiffness=1e12), 2.0 * level, excitation)
    np.testing.assert_allclose(once, twice, rtol=1e-6)
    for effect in ({"guide_friction": 2.0}, {"cubic_nut_stiffness": 4e12}):
        alone = response(add(physics, **effect), level, excitation)
        assert np.max(np.abs(alone / response(physics, level, excitation) - 1.0)) > 1e-3


def test_friction_satisfies_its_own_linearisation() -> None:
    """c_e σ_v = F √(2/π), with σ_v of the response that contains c_e, the excitation being flat over the lines."""
    physics, level, friction = physics_of(LUMPED), 10.0, 4.0
    with_friction = response(add(physics, guide_friction=friction), level)
    omega = 2.0 * np.pi * FREQUENCY
    damping = ((1.0 / with_friction - 1.0 / response(physics, level)) / (1j * omega)).real
    np.testing.assert_allclose(damping, damping[0], rtol=1e-6)  # a damper: one value at all lines
    power = np.trapezoid(np.abs(omega * with_friction) ** 2, FREQUENCY) / np.ptp(FREQUENCY)
    assert damping[0] * level * np.sqrt(power) == pytest.approx(friction * np.sqrt(2.0 / np.pi), rel=1e-6)


def test_small_signals_and_far_louder_ones_do_not_see_friction() -> None:
    physics = physics_of(LUMPED)
    rough = add(physics, guide_friction=5.0)
    np.testing.assert_array_equal(response(rough, 0.0), response(physics, 0.0))
    np.testing.assert_allclose(response(rough, 1e9), response(physics, 1e9), rtol=1e-6)


def test_friction_lowers_the_response_until_it_holds_the_table() -> None:
    """A force of σ rms moves a table with F √(2/π) < σ; near that the response goes to zero."""
    physics, level = physics_of(LUMPED), 8.0
    limit = level * np.sqrt(np.pi / 2.0)
    peaks = [
        np.max(np.abs(response(add(physics, guide_friction=share * limit), level)))
        for share in (0.0, 0.3, 0.6, 0.9, 0.999)
    ]
    assert np.all(np.diff(peaks) < 0.0)
    assert peaks[-1] < 0.02 * peaks[0]
    with pytest.raises(OutsideValidityError, match=r"guide_friction must lie below 10\.0265 N, .* got 10\.1 N"):
        response(add(physics, guide_friction=10.1), level)


def test_a_nut_that_softens_to_nothing_is_refused() -> None:
    with pytest.raises(OutsideValidityError, match="the nut softens to nothing"):
        response(add(physics_of(LUMPED), cubic_nut_stiffness=-1e15), 10.0)


def test_one_line_carries_the_whole_excitation() -> None:
    """Stepped sine: σ_v is that of the line."""
    physics, frequency = physics_of(LUMPED), np.array([150.0])
    omega = 2.0 * np.pi * frequency
    plain = response(physics, 10.0, frequency=frequency)
    rough = response(add(physics, guide_friction=4.0), 10.0, frequency=frequency)
    damping = ((1.0 / rough - 1.0 / plain) / (1j * omega)).real
    assert damping * 10.0 * omega * np.abs(rough) == pytest.approx(4.0 * np.sqrt(2.0 / np.pi), rel=1e-6)


def test_the_channel_that_is_watched_does_not_change_the_motion() -> None:
    """Angle and acceleration under one torque belong to one damper, that of the table's motion."""
    physics = add(physics_of(LUMPED), guide_friction=3.0)
    conditions, torque = replace(AT, excitation_level=0.3), ExcitationPoint.TORQUE_AT_MOTOR
    table, motor = (
        response_of(physics, case_of(LUMPED, FREQUENCY, conditions, torque, point))
        for point in (ResponsePoint.DISPLACEMENT_AT_TABLE, ResponsePoint.ANGLE_AT_MOTOR)
    )
    # the rotor alone: torque = −ω² J θ + i × force in the nut; the force moves the table: −ω² M x + jω c x
    omega, i = 2.0 * np.pi * FREQUENCY, physics.screw.transmission_ratio
    force = (1.0 + omega**2 * LUMPED.screw_inertia * motor) / i
    damping = ((force / table + omega**2 * MASS) / (1j * omega)).real
    np.testing.assert_allclose(damping, damping[0], rtol=1e-4)
    assert damping[0] > 10.0
