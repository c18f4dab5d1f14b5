"""Velocity loop, friction at each place and recorded forces of the transmission lines, against closed forms."""

import numpy as np
import pytest
from scipy import optimize, signal

from monitor_core.errors import OutsideValidityError
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from monitor_core.models.published.transmission_line import (
    DriveFriction,
    SpeedControl,
    StribeckFriction,
    common_step_grid,
    simulate_drive,
)
from monitor_core.models.published.transmission_line.junctions import Friction, dry_friction
from monitor_core.models.published.transmission_line.mobility import DiscreteDrive, response_at
from tests.models.line_reference import HEAVY, shaft

HERE = DriveConditions(0.6)
#: Joints that lose much, a table and a motor that lose nothing: the rigid drive is inertia alone.
LOSSY_JOINTS = HEAVY | {"table_damping": 0.0, "motor_damping": 0.0}


def inertia_of(p):
    """Return rotor, screw and table about the axis of the motor."""
    screw = p.density * p.screw_length * np.pi * p.screw_diameter**4 / 32.0
    return p.rotor_inertia + screw + p.transmission_ratio**2 * p.table_mass


def test_speed_and_torque_follow_the_characteristic_polynomial_of_the_rigid_drive():
    # J τ s³ + J s² + K s + K/T_i, at 5 Hz and less: the first mode at 133 Hz bends it by a thousandth.
    p = shaft(**LOSSY_JOINTS)
    grid, inertia = common_step_grid(p, 20), inertia_of(p)
    gain, integral, lag = 30.0 * inertia, 0.2, 5e-3
    control = SpeedControl(gain, integral, lag, grid.time_step)
    n = round(0.4 / grid.time_step)
    run = simulate_drive(p, grid, HERE, np.zeros(n), control=control, speed=np.ones(n))
    time = np.arange(n) * grid.time_step
    characteristic = [inertia * lag, inertia, gain, gain / integral]
    _, angle = signal.step((np.array([gain, gain / integral]), np.append(characteristic, 0.0)), T=time)
    _, torque = signal.step((inertia * np.array([gain, gain / integral, 0.0]), characteristic), T=time)
    assert np.max(np.abs(run.angle_at_motor - angle)) < 2e-3 * np.max(angle)
    assert np.max(np.abs(run.motor_torque - torque)) < 0.01 * np.max(torque)


def test_a_run_in_the_loop_is_the_transform_of_controller_current_and_drive():
    p = shaft(**HEAVY)
    grid = common_step_grid(p, 20)
    control = SpeedControl(2.0, 0.01, 1e-4, grid.time_step)
    n = round(0.6 / grid.time_step)
    commanded = np.zeros(n)
    commanded[0] = 1.0
    run = simulate_drive(p, grid, HERE, np.zeros(n), control=control, speed=commanded)
    assert np.max(np.abs(run.motor_torque[-100:])) < 1e-10
    frequency = np.fft.rfftfreq(n, grid.time_step)[1:400]
    after = np.exp(-2j * np.pi * frequency * grid.time_step)  # a step later
    drive = DiscreteDrive(p, grid, HERE, MotorEnd.FREE)
    angle_per_torque = response_at(
        drive, 2j * np.pi * frequency, ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ANGLE_AT_MOTOR
    )
    controller = 2.0 * (1.0 + grid.time_step / 0.01 / (1.0 - after))
    followed = 1.0 - np.exp(-grid.time_step / 1e-4)
    current = followed / (1.0 - (1.0 - followed) * after)
    speed_per_torque = after * (1.0 - after) / grid.time_step * angle_per_torque  # of the encoder, a step old
    expected = controller * current / (1.0 + controller * current * speed_per_torque)
    np.testing.assert_allclose(np.fft.rfft(run.motor_torque)[1:400], expected, rtol=1e-6)


#: All Coulomb, each told from the others.
RUBBING = DriveFriction(
    guides=StribeckFriction(90.0, 90.0),
    nut=StribeckFriction(0.3, 0.3),
    bearing=StribeckFriction(0.2, 0.2),
    far_bearing=StribeckFriction(0.1, 0.1),
)


@pytest.mark.parametrize("speed", [20.0, -20.0])
def test_a_speed_is_held_without_error_and_its_torque_is_the_friction_of_all_places(speed):
    # Work of the motor over an angle: each Coulomb torque times it, and the guides' force times the travel.
    p = shaft(**LOSSY_JOINTS)
    grid, i = common_step_grid(p, 20), p.transmission_ratio
    n = round(0.5 / grid.time_step)
    control = SpeedControl(1.5, 0.02, 3e-4, 1e-4)
    run = simulate_drive(p, grid, HERE, np.zeros(n), control=control, speed=np.full(n, speed), friction=RUBBING)
    late = slice(-2000, None)
    turned, sign = np.diff(run.angle_at_motor[late]), np.sign(speed)
    assert turned == pytest.approx(speed * grid.time_step, rel=1e-5)
    assert np.diff(run.displacement_at_table[late]) == pytest.approx(i * speed * grid.time_step, rel=1e-5)
    assert run.motor_torque[late] == pytest.approx(sign * (0.6 + 90.0 * i), rel=1e-3)
    assert run.screw_torque[late] == pytest.approx(sign * (0.6 + 90.0 * i), rel=1e-3)
    assert run.nut_torque[late] == pytest.approx(sign * (0.3 + 90.0 * i), rel=1e-3)
    work = np.sum(run.motor_torque[late][1:] * turned)
    assert work == pytest.approx((0.6 + 90.0 * i) * abs(run.angle_at_motor[-1] - run.angle_at_motor[-2000]), rel=1e-4)


@pytest.mark.parametrize("place", ["nut", "bearing", "far_bearing"])
@pytest.mark.parametrize(("torque", "turns"), [(0.95, False), (1.05, True)])
def test_each_friction_holds_the_screw_up_to_its_static_torque(place, torque, turns):
    p = shaft(**LOSSY_JOINTS)
    grid = common_step_grid(p, 20)
    friction = DriveFriction(**{place: StribeckFriction(0.5, 1.0, 0.06)})
    n = round(0.2 / grid.time_step)
    slowly = torque * np.minimum(np.arange(n) / (0.5 * n), 1.0)  # no overshoot that breaks it loose
    run = simulate_drive(p, grid, HERE, slowly, friction=friction)
    assert bool(abs(run.angle_at_motor[-1]) > 1e-3) is turns


def test_forces_on_the_mountings_and_torque_at_the_nut_are_those_of_statics():
    # F = F_fb + F_rb, shared by the compliances of both sides; T = F lead/2π at the nut and behind the coupling.
    p = shaft(**HEAVY)
    grid = common_step_grid(p, 20)
    n = round(0.3 / grid.time_step)
    force = np.full(n, 1000.0)
    run = simulate_drive(p, grid, HERE, np.zeros(n), motor_end=MotorEnd.CLAMPED, force_at_table=force)
    near = 1.0 / (1.0 / p.bearing_stiffness + 0.6 / p.axial_rigidity)
    far = 1.0 / (1.0 / p.far_bearing_stiffness + (p.screw_length - 0.6) / p.axial_rigidity)
    assert run.bearing_force[-1] == pytest.approx(1000.0 * near / (near + far), rel=1e-6)
    assert run.far_bearing_force[-1] == pytest.approx(1000.0 * far / (near + far), rel=1e-6)
    assert run.nut_torque[-1] == pytest.approx(-1000.0 * p.transmission_ratio, rel=1e-6)
    assert run.screw_torque[-1] == pytest.approx(-1000.0 * p.transmission_ratio, rel=1e-6)


def test_338_hertz_are_none_of_the_shaft_and_follow_from_nothing_that_the_paper_gives():
    # Fig. 9. Held at one end and free at the other, in torsion, is the lowest that the shaft alone can do.
    p = shaft()
    assert p.torsional_speed / (4.0 * p.screw_length) == pytest.approx(593.0, abs=1.0)
    assert p.axial_speed / (4.0 * p.screw_length) > p.torsional_speed / (4.0 * p.screw_length) > 338.0

    def main_frequency(table_mass):
        axis = shaft(table_mass=table_mass)
        grid = common_step_grid(axis, 20)
        n = round(0.5 / grid.time_step)
        struck = np.zeros(n)
        struck[: round(1e-4 / grid.time_step)] = 1.0
        control = SpeedControl(0.5, 0.02, 3e-4, 1e-4)
        run = simulate_drive(axis, grid, HERE, np.zeros(n), control=control, speed=struck)
        spectrum = np.abs(np.fft.rfft(np.diff(run.angle_at_motor)))
        frequency = np.fft.rfftfreq(n - 1, grid.time_step)
        tops, found = signal.find_peaks(np.log(spectrum[frequency < 1000.0]), prominence=0.1)
        return frequency[tops[np.argmax(found["prominences"])]]

    light, heavy = main_frequency(30.0), main_frequency(600.0)
    assert light > 338.0 > heavy


def test_what_no_loop_and_no_friction_can_be_is_refused():
    p = shaft()
    grid = common_step_grid(p, 20)
    with pytest.raises(OutsideValidityError, match="integral_time of the speed loop must be positive"):
        SpeedControl(1.0, 0.0, 0.0, 1e-4)
    with pytest.raises(OutsideValidityError, match="current_lag must not be negative"):
        SpeedControl(1.0, 1.0, -1.0, 1e-4)
    control = SpeedControl(1.0, 1.0, 0.0, 1e-4)
    with pytest.raises(OutsideValidityError, match="a motor that turns freely; got clamped"):
        simulate_drive(p, grid, HERE, np.zeros(9), control=control, motor_end=MotorEnd.CLAMPED)
    with pytest.raises(OutsideValidityError, match="sampling_time of the speed loop must not be below the step"):
        simulate_drive(p, grid, HERE, np.zeros(9), control=SpeedControl(1.0, 1.0, 0.0, 0.9 * grid.time_step))
    with pytest.raises(OutsideValidityError, match="got a speed without control"):
        simulate_drive(p, grid, HERE, np.zeros(9), speed=np.ones(9))


def test_friction_that_turns_obeys_its_law_on_screws_of_all_thicknesses():
    rng = np.random.default_rng(0)
    slopes = np.empty(2000)
    for k in range(slopes.size):
        while True:
            impedance = np.sqrt(80e9 * 7850.0) * np.pi * rng.uniform(0.012, 0.040) ** 4 / 32.0
            coulomb, fades = rng.uniform(0.02, 0.5), rng.uniform(0.0, 0.5)
            rubs = Friction(coulomb, coulomb + fades, np.exp(rng.uniform(np.log(0.05), np.log(1.3))))
            x = np.linspace(0.0, 3.0, 3001)
            slopes[k] = np.max(2.0 * x / (1.0 + x**2) ** 2) * fades / (rubs.stribeck_velocity * impedance)
            if slopes[k] < 1.0:
                break
        driving = rubs.static * (1.0 + np.exp(rng.uniform(np.log(1e-6), np.log(100.0))))

        def surplus(v, driving=driving, rubs=rubs, impedance=impedance, fades=fades):
            return driving - impedance * v - rubs.coulomb - fades / (1.0 + (v / rubs.stribeck_velocity) ** 2)

        v = optimize.brentq(surplus, 0.0, driving / impedance, xtol=1e-15, rtol=1e-14)
        friction = dry_friction(rubs, driving, impedance)
        assert friction == pytest.approx(driving - impedance * v, rel=1e-9)
        assert dry_friction(rubs, -driving, impedance) == -friction
    assert np.max(slopes) > 0.99


@pytest.mark.parametrize("place", ["guides", "nut", "bearing", "far_bearing"])
def test_friction_that_allows_several_speeds_at_once_is_refused(place):
    p = shaft(screw_diameter=0.012, screw_minor_diameter=0.010)
    grid = common_step_grid(p, 20)
    simulate_drive(p, grid, HERE, np.zeros(2), friction=DriveFriction(**{place: StribeckFriction(0.1, 0.2, 1.3)}))
    fast = DriveFriction(**{place: StribeckFriction(0.1, 0.2, 1e-9)})
    with pytest.raises(OutsideValidityError, match=f"stribeck_velocity of the friction at {place} must be at least"):
        simulate_drive(p, grid, HERE, np.zeros(2), friction=fast)
