"""Friction and a hardening nut: the linearised drive against the motion itself, computed step by step."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
import scipy.special

from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended import AxisPhysics, physics_of, prepare_lines, responses
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


def simulated_response(stiffness, damping, level, *, friction=0.0, cubic=0.0, behind=0.0, n_runs=150):
    """Return H1 of a mass on its spring under random-phase excitation of flat lines, from its motion in time.

    Leapfrog, the damper taken at mid-step. Friction is a constraint: an impulse of at most F Δt, which may bring the
    mass to rest but not turn it. Behind the spring may stand another, of that compliance [m/N], that does not bend.
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
            deflection = position / (1.0 + behind * stiffness)
            for _ in range(3 if behind else 0):  # Newton: deflection + behind × force = position
                excess = deflection + behind * stiffness * deflection * (1.0 + cubic * deflection**2) - position
                deflection -= excess / (1.0 + behind * stiffness * (1.0 + 3.0 * cubic * deflection**2))
            spring = stiffness * deflection * (1.0 + cubic * deflection**2)
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


@pytest.mark.release
@pytest.mark.parametrize("friction", [1.0, 3.0])
def test_friction_damps_as_in_the_motion_itself(friction) -> None:
    """At 10 N rms. What the linearisation leaves out, a velocity that is not Gaussian, is a few percent of c_e."""
    physics = damped(undamped(physics_of(LUMPED)), 400.0)
    stiffness = 1.0 / response(physics, 0.0, frequency=np.array([1e-3]))[0].real
    predicted = response(add(physics, guide_friction=friction), 10.0)
    simulated = simulated_response(stiffness, 400.0, 10.0, friction=friction)
    added_predicted, added_simulated = (mass_spring_damper(frf)[1] - 400.0 for frf in (predicted, simulated))
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
        mass_spring_damper(frf)[0] / stiffness - 1.0 for frf in (predicted, simulated)
    )
    assert stiffer_simulated > 0.02
    assert stiffer_predicted == pytest.approx(stiffer_simulated, rel=0.06)


def own_hardening(stiffness, behind, damping, cubic, level) -> float:
    """Return the hardening that agrees with its own rms motion."""
    omega, hardening = 2.0 * np.pi * np.linspace(FREQUENCY[0], FREQUENCY[-1], 4001), 0.0
    for _ in range(60):
        whole = 1.0 / (1.0 / (stiffness * (1.0 + hardening)) + behind)
        deflection = whole / (whole - omega**2 * MASS + 1j * omega * damping) / (stiffness * (1.0 + hardening))
        hardening = 0.5 * (hardening + 3.0 * cubic * level**2 * np.mean(np.abs(deflection) ** 2))
    return float(hardening)


@pytest.mark.release
@pytest.mark.parametrize(("behind", "allowed", "missed"), [(0.0, 0.05, 0.3), (2.0, 0.035, 0.07)])
def test_a_lightly_damped_response_is_an_average_over_amplitudes(behind, allowed, missed) -> None:
    """The mean stiffness alone misses what hardening that moves a resonance by its width makes of it.

    Without and with a spring behind the nut, of twice its compliance.
    """
    stiffness, level = MASS * (2.0 * np.pi * 200.0) ** 2 * (1.0 + behind), 10.0
    damping = 2.0 * 0.02 * 2.0 * np.pi * 200.0 * MASS
    physics = damped(nut_alone(), damping)
    joints = replace(physics.joints, nut_stiffness=stiffness / 0.8)
    if behind:
        joints = replace(joints, bracket_stiffness=stiffness / behind)
    physics = replace(physics, joints=joints)
    in_nut = np.abs(response(physics, level)) / (1.0 + behind)
    cubic = 0.05 / (level**2 * np.mean(in_nut**2))
    predicted = response(add(physics, cubic_nut_stiffness=cubic), level)
    simulated = simulated_response(stiffness, damping, level, cubic=cubic, behind=behind / stiffness, n_runs=300)
    hardening = own_hardening(stiffness, behind / stiffness, damping, cubic, level)
    mean_alone = response(
        replace(physics, joints=replace(joints, nut_stiffness=stiffness * (1.0 + hardening) / 0.8)), 0.0
    )
    distances = [np.linalg.norm(frf - simulated) / np.linalg.norm(simulated) for frf in (predicted, mean_alone)]
    assert distances[0] < allowed
    assert distances[1] > missed


ENERGIES, WEIGHTS = scipy.special.roots_genlaguerre(2, 1.0)


def seen_through_amplitudes(hardenings, resonant, others=0.0):
    r"""Return the hardening that lines see, of those at ENERGIES, shape (2,), by the closed form for one resonance.

    Dykman and Krivoglaz: the motion after a push is e^{γt}/ψ², ψ = cosh bt + (γ − ja) sinh(bt)/b, b² = γ² − 2jγa.
    """
    bent = hardenings / (1.0 + others * hardenings)
    mean, slope = np.tensordot(WEIGHTS, bent, 1), np.tensordot(WEIGHTS * (ENERGIES - 2.0), bent, 1) / 2.0
    resonant = resonant / (1.0 + others * resonant)
    width = -resonant.imag
    root = np.sqrt(width**2 - 2j * width * slope)
    share = (width - 1j * slope) / root
    n, ratio = np.arange(1, 200)[:, None], -(1.0 - share) / (1.0 + share)
    poles = 1j * (resonant.real - mean + 2.0 * slope) - width + 2.0 * root * n
    response = np.sum(4.0 * n * ratio ** (n - 1) / (1.0 + share) ** 2 / poles, axis=0)
    seen = resonant + 1j / response
    return seen / (1.0 - others * seen)


def test_the_average_over_amplitudes_is_that_of_the_closed_form() -> None:
    level, stiffness = 10.0, MASS * (2.0 * np.pi * 200.0) ** 2
    damping = 2.0 * 0.02 * 2.0 * np.pi * 200.0 * MASS
    physics = damped(nut_alone(), damping)
    cubic = 0.01 / (level**2 * np.mean(np.abs(response(physics, level)) ** 2))
    hardenings = np.array([own_hardening(stiffness, 0.0, damping, cubic * s / 2.0, level) for s in ENERGIES])
    omega = 2.0 * np.pi * FREQUENCY
    resonant = (omega**2 * MASS - 1j * omega * damping) / stiffness - 1.0
    seen = seen_through_amplitudes(hardenings[:, None], resonant)
    assert np.max(np.abs(seen - WEIGHTS @ hardenings)) > 0.1 * WEIGHTS @ hardenings
    answered = response(add(physics, cubic_nut_stiffness=cubic), level)
    np.testing.assert_allclose(answered, 1.0 / (stiffness * (seen - resonant)), rtol=1e-3)


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


# --- rms values of the motion, whatever lines a response has ----------------------------------------------------------

RECEPTANCE = bundled("receptance").parameters
#: As many measurements have them: 7 Hz apart at 200 Hz, where half the power of a resonance lies within 6 Hz.
FEW_LINES = np.geomspace(24.0, 1475.0, 120)
DENSE = np.geomspace(24.0, 1475.0, 40_001)
MOTOR, TABLE = ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.DISPLACEMENT_AT_TABLE


def soft_nut() -> AxisPhysics:
    """Return an axis whose nut yields more than its screw, with a damping ratio of no mode below 0.5 %."""
    physics = physics_of(RECEPTANCE)
    bodies = replace(physics.bodies, motor_damping=0.05)
    joints = replace(physics.joints, nut_stiffness=3e7, coupling_stiffness=2000.0, coupling_damping=0.3)
    return replace(physics, joints=replace(joints, loss_factor=0.01), bodies=bodies)


def hardened(physics: AxisPhysics, hardening: float) -> AxisPhysics:
    return replace(
        physics, joints=replace(physics.joints, nut_stiffness=physics.joints.nut_stiffness * (1.0 + hardening))
    )


def linear_motion(physics: AxisPhysics, excitation, level: float) -> tuple[float, float]:
    """Return σ_v and σ_δ of an axis without friction, on dense lines, from its displacement and Newton's law alone."""
    omega = 2.0 * np.pi * DENSE
    table = response_of(physics, case_of(RECEPTANCE, DENSE, DriveConditions(0.52), excitation))
    mass = physics.bodies.table_mass + physics.bodies.nut_mass
    force = (1j * omega * physics.bodies.table_damping - omega**2 * mass) * table - (excitation is FORCE)
    joints = physics.joints
    nut = joints.nut_stiffness * (1.0 + 1j * joints.loss_factor) + 1j * omega * joints.nut_damping
    power = (np.trapezoid(np.abs(spectrum) ** 2, DENSE) / np.ptp(DENSE) for spectrum in (omega * table, force / nut))
    velocity, deflection = (level * np.sqrt(mean_square) for mean_square in power)
    return velocity, deflection


def balanced(physics: AxisPhysics, excitation, level: float, friction: float, cubic: float) -> tuple[float, float]:
    """Return damper and hardening of the linear axis that agrees with its own motion."""

    def values(unknown) -> tuple[float, float]:
        return np.exp(unknown[0]) * bool(friction), np.exp(unknown[1]) * bool(cubic)

    def imbalance(unknown):
        damping, hardening = values(unknown)
        linear = hardened(damped(physics, physics.bodies.table_damping + damping), hardening)
        velocity, deflection = linear_motion(linear, excitation, level)
        return [
            unknown[0] - np.log(friction * np.sqrt(2.0 / np.pi) / velocity) if friction else unknown[0],
            unknown[1] - np.log(3.0 * cubic * deflection**2) if cubic else unknown[1],
        ]

    found = scipy.optimize.root(imbalance, [5.0, -1.0], tol=1e-10)
    assert found.success
    return values(found.x)


def through_amplitudes(physics: AxisPhysics, excitation, level: float, friction: float, cubic: float):
    """Return the response on few lines, from those of linear axes and Newton's law for the table alone."""
    pairs = [balanced(physics, excitation, level, friction, cubic * s / 2.0) for s in (ENERGIES if cubic else [2.0])]
    dampers, hardenings = np.array(pairs).T
    linear = damped(physics, physics.bodies.table_damping + (WEIGHTS @ dampers if cubic else dampers[0]))
    force, moved = (
        response_of(linear, case_of(RECEPTANCE, FEW_LINES, DriveConditions(0.52), point))
        for point in (FORCE, excitation)
    )
    if not cubic:
        return moved
    omega, joints, bodies = 2.0 * np.pi * FEW_LINES, physics.joints, physics.bodies
    table = 1j * omega * linear.bodies.table_damping - omega**2 * (bodies.table_mass + bodies.nut_mass)
    spring = joints.nut_stiffness * (1.0 + 1j * joints.loss_factor)
    nut, compliance = spring + 1j * omega * joints.nut_damping, 1.0 / (1.0 / force - table)
    beside = compliance - 1.0 / nut
    resonant = (-table / (1.0 + beside * table) - nut) / spring
    others = np.clip((beside / compliance).real, 0.0, 1.0)
    seen = 1.0 / (nut + spring * seen_through_amplitudes(hardenings[:, None], resonant, others)) + beside
    if excitation is FORCE:
        return seen / (1.0 + seen * table)
    return moved * (1.0 + compliance * table) / (1.0 + seen * table)


@pytest.mark.release
@pytest.mark.parametrize("excitation", [MOTOR, FORCE])
@pytest.mark.parametrize(
    ("friction_share", "cubic_share"), [(0.1, 0.0), (0.7, 0.0), (0.0, 0.1), (0.0, 10.0), (0.3, 1.0)]
)
def test_the_axis_agrees_with_its_own_motion(excitation, friction_share, cubic_share) -> None:
    """Against the same equations on 40 000 lines: few lines are enough. Shares are of 30 kN·s/m and of β σ_δ²."""
    physics, level = soft_nut(), 1.0
    velocity, deflection = linear_motion(physics, excitation, level)
    friction, cubic = friction_share * velocity * 3e4, cubic_share / deflection**2
    case = case_of(RECEPTANCE, FEW_LINES, DriveConditions(0.52, excitation_level=level), excitation)
    answered = response_of(add(physics, guide_friction=friction, cubic_nut_stiffness=cubic), case)
    expected = through_amplitudes(physics, excitation, level, friction, cubic)
    assert np.max(np.abs(response_of(physics, case) / expected - 1.0)) > 0.05
    np.testing.assert_allclose(answered, expected, rtol=2e-3)


def test_a_resonance_between_the_lines_is_not_missed(subtests: pytest.Subtests) -> None:
    """One oscillator under a flat spectrum of unit variance: ∫|jωH|² df = 1/(4 c M); the tails outside are 0.06 %."""
    for natural_frequency, damping_ratio in itertools.product([171.0, 172.1, 173.3, 200.0, 420.0], [0.005, 0.02]):
        with subtests.test(natural_frequency=natural_frequency, damping_ratio=damping_ratio):
            physics, omega = nut_alone(), 2.0 * np.pi * natural_frequency
            joints = replace(physics.joints, nut_stiffness=MASS * omega**2 / 0.8)
            damping = 2.0 * damping_ratio * omega * MASS
            physics = damped(replace(physics, joints=joints), damping)
            frequency = np.geomspace(10.0, 4000.0, 60)  # a tenth apart
            friction = 1e-4  # [N]; that little damps as if the motion did not know of it
            with_friction = response(add(physics, guide_friction=friction), 10.0, frequency=frequency)
            added = (
                (1.0 / with_friction - 1.0 / response(physics, 10.0, frequency=frequency)) / (2j * np.pi * frequency)
            ).real
            velocity = 10.0 * np.sqrt(1.0 / (4.0 * damping * MASS * np.ptp(frequency)))
            assert np.median(added) == pytest.approx(friction * np.sqrt(2.0 / np.pi) / velocity, rel=0.01)


def test_lines_inside_the_band_do_not_change_the_motion() -> None:
    physics = add(physics_of(LUMPED), guide_friction=4.0, cubic_nut_stiffness=1e13)
    few, many = np.array([120.0, 200.0, 280.0]), np.arange(120.0, 281.0, 1.0)
    np.testing.assert_allclose(
        response(physics, 10.0, frequency=few), response(physics, 10.0, frequency=many)[[0, 80, 160]], rtol=1e-9
    )


@pytest.mark.parametrize("effect", ["guide_friction", "cubic_nut_stiffness"])
@pytest.mark.parametrize("size", [0.03, 0.3, 1.0])
def test_the_response_changes_smoothly(effect, size) -> None:
    """Slopes over steps of 1e-5 and of 1e-3, in the effect and in the mass of the table, are the same."""
    physics, level = soft_nut(), 1.0
    velocity, deflection = linear_motion(physics, MOTOR, level)
    value = size * {"guide_friction": 3e4 * velocity, "cubic_nut_stiffness": 10.0 / deflection**2}[effect]
    case = case_of(RECEPTANCE, FEW_LINES, DriveConditions(0.52, excitation_level=level), MOTOR)

    def with_effect(factor: float):
        return response_of(add(physics, **{effect: value * factor}), case)

    def with_mass(factor: float):
        return response_of(add(physics, **{effect: value}, table_mass=20.0 * (factor - 1.0)), case)

    for answer in (with_effect, with_mass):
        fine, coarse = (np.log(answer(1.0 + e) / answer(1.0 - e)) / (2.0 * e) for e in (1e-5, 1e-3))
        assert np.linalg.norm(fine - coarse) < 2e-3 * np.linalg.norm(coarse)


def test_what_was_asked_before_does_not_change_the_answer() -> None:
    """Axes near and far from each other, with friction, a nut that hardens or softens, or both, on the same lines."""
    physics, level, rng = soft_nut(), 1.0, np.random.default_rng(5)
    velocity, deflection = linear_motion(physics, MOTOR, level)
    case = case_of(RECEPTANCE, FEW_LINES, DriveConditions(0.52, excitation_level=level), MOTOR)
    lines = prepare_lines([case])
    for _ in range(40):
        friction = rng.choice([0.0, 0.3]) * 3e4 * velocity * 10.0 ** rng.choice([-4.0, -1.0, 0.0])
        cubic = rng.choice([-0.02, 0.0, 3.0]) * 10.0 ** rng.choice([-4.0, -1.0, 0.0]) / deflection**2
        for nearer in (1.0, 1.0 + 1e-4, 1.01, 0.99):
            axis = add(physics, guide_friction=friction * nearer, cubic_nut_stiffness=cubic * nearer)
            np.testing.assert_allclose(responses(axis, lines), response_of(axis, case), rtol=1e-7)


@pytest.mark.parametrize(
    "excited",
    [pytest.param(FEW_LINES, id="a band", marks=pytest.mark.release), pytest.param(FEW_LINES[:1], id="one line")],
)
def test_neighbours_that_were_asked_before_do_not_change_the_answer(excited) -> None:
    """Other masses, positions and levels on the same lines, near and far: as on lines that were asked nothing yet."""
    physics, level, rng = soft_nut(), 1.0, np.random.default_rng(6)
    velocity, deflection = linear_motion(physics, MOTOR, level)
    axis = add(physics, guide_friction=3e3 * velocity, cubic_nut_stiffness=1.0 / deflection**2)
    cases = [
        case_of(RECEPTANCE, excited, DriveConditions(at, excitation_level=level * factor), MOTOR)
        for at, factor in ((0.2, 1.0), (0.52, 2.0), (0.8, 1.0))
    ]
    lines = prepare_lines(cases)
    for _ in range(60):
        move = 10.0 ** rng.choice([-5.0, -4.0, -3.0, -1.0]) * rng.standard_normal(3)
        moved = replace(
            lines.conditions,
            position=lines.conditions.position * (1.0 + 0.1 * move[0]),
            excitation_level=lines.conditions.excitation_level * (1.0 + 0.1 * move[1]),
        )
        there, fresh = replace(lines, conditions=moved), replace(prepare_lines(cases), conditions=moved)
        heavier = add(axis, table_mass=2.0 * move[2])
        np.testing.assert_allclose(responses(heavier, there), responses(heavier, fresh), rtol=1e-6)


def test_any_hardening_has_an_answer() -> None:
    """The more, the larger β: a nut ten decades stiffer, as read off the compliance that force and table meet.

    What wanders takes energy from the motion and never gives any.
    """
    physics, level = soft_nut(), 1.0
    _, deflection = linear_motion(physics, FORCE, level)
    case = case_of(RECEPTANCE, FEW_LINES, DriveConditions(0.52, excitation_level=level), FORCE)
    omega, joints = 2.0 * np.pi * case.frequency, physics.joints
    spring = joints.nut_stiffness * (1.0 + 1j * joints.loss_factor)
    nut = spring + 1j * omega * joints.nut_damping

    def compliance(cubic: float):
        return 1.0 / (1.0 / response_of(add(physics, cubic_nut_stiffness=cubic), case) + omega**2 * 272.0)

    hardening = []
    for cubic in np.geomspace(1e-3, 1e7, 41) / deflection**2:
        harder = 1.0 / (1.0 / nut + compliance(cubic) - compliance(0.0))
        share = (harder - nut) / spring
        assert np.all(share.imag > 0.0)
        hardening.append(share.real)
    assert np.all(np.diff(hardening, axis=0) > 0.0)
    np.testing.assert_allclose(hardening[0], 3e-3, rtol=0.02)
    assert np.all(hardening[-1] > 100.0)


def test_channels_taken_together_have_one_motion() -> None:
    """Of a channel that was noisy at high frequency fewer lines are left; the excitation was the same."""
    physics = add(physics_of(RECEPTANCE), guide_friction=100.0)
    conditions = DriveConditions(0.52, excitation_level=2.0)
    table = case_of(RECEPTANCE, FEW_LINES, conditions, MOTOR)
    motor = case_of(RECEPTANCE, FEW_LINES[:70], conditions, MOTOR, ResponsePoint.ANGLE_AT_MOTOR)
    whole = replace(motor, frequency=FEW_LINES)
    together = responses(physics, prepare_lines([table, motor]))
    np.testing.assert_allclose(together[: FEW_LINES.size], response_of(physics, table), rtol=1e-9)
    np.testing.assert_allclose(together[FEW_LINES.size :], response_of(physics, whole)[:70], rtol=1e-9)
    alone = response_of(physics, motor)
    assert np.max(np.abs(together[FEW_LINES.size :] / alone - 1.0)) > 0.01


def test_lines_stepped_through_one_by_one_have_a_motion_each() -> None:
    physics, conditions = add(physics_of(RECEPTANCE), guide_friction=0.01), DriveConditions(0.52, excitation_level=1.0)
    cases = [case_of(RECEPTANCE, np.array([f]), conditions, MOTOR) for f in (300.0, 60.0, 90.0)]
    np.testing.assert_allclose(
        responses(physics, prepare_lines(cases)),
        np.concatenate([response_of(physics, case) for case in cases]),
        rtol=1e-9,
    )


# --- limits -----------------------------------------------------------------------------------------------------------


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
