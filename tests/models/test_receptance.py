"""Tian's drive against coupled matrices, finite elements and its own laws; the paper: ``test_receptance_published``."""

import itertools
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from monitor_core.errors import OutsideValidityError
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from monitor_core.models.published.receptance import ReceptanceModel, ReceptanceParameters
from monitor_core.models.published.receptance.closed_form import (
    entire_responses,
    position_terms,
    table_receptance,
    table_receptance_gradient,
)
from monitor_core.models.published.receptance.parameters import JOINT_NAMES
from monitor_core.models.rod import wave_number
from tests.authorities.receptance_matrices import drive_receptance
from tests.models.finite_elements import Assembly, Axis
from tests.models.rods import condensed_stiffness

FREQUENCY = np.linspace(5.0, 1000.0, 400)
OMEGA = 2 * np.pi * FREQUENCY
AT = DriveConditions(1.0)
#: Everything that the paper's axis does not have.
EXTRAS = {
    "bracket_stiffness": 3e8, "loss_factor": 0.05, "table_damping": 300.0, "motor_damping": 0.02,
    "nut_mass": 3.0, "coupling_inertia": 1e-4,
}  # fmt: skip


@pytest.fixture(scope="module")
def paper(published_data: Path) -> ReceptanceParameters:
    model = tomllib.loads((published_data.parent / "models" / "receptance.toml").read_text(encoding="utf-8"))
    assert model["family"] == "receptance"
    return ReceptanceParameters.from_file_names(model["parameters"], model["family"])


@pytest.fixture(scope="module")
def full(paper: ReceptanceParameters) -> ReceptanceParameters:
    return replace(paper, **EXTRAS)


def closed_form(parameters, omega=OMEGA, conditions=AT, motor_end=MotorEnd.FREE):
    return table_receptance(position_terms(parameters, omega, conditions, motor_end), parameters.joints(conditions))


def without_damping(parameters):
    names = (*JOINT_NAMES[4:], "table_damping", "motor_damping", "loss_factor")
    return replace(parameters, **dict.fromkeys(names, 0.0))


def axis_of(parameters, motor_end, payload=0.0):
    """Say the same axis in the words of the finite elements."""
    p = parameters
    return Axis(
        length=p.screw_length, diameter=p.screw_diameter, lead=p.screw_lead, youngs_modulus=p.youngs_modulus,
        shear_modulus=p.shear_modulus, density=p.density, table_mass=p.table_mass + p.nut_mass + payload,
        near_bearing=(p.bearing_stiffness, p.bearing_damping),
        far_bearing=(p.far_bearing_stiffness, p.far_bearing_damping),
        nut=(p.nut_stiffness, p.nut_damping),
        bracket_stiffness=p.bracket_stiffness if np.isfinite(p.bracket_stiffness) else None,
        coupling=None if motor_end is MotorEnd.PRESCRIBED else (p.coupling_stiffness, p.coupling_damping),
        rotor_inertia=p.motor_inertia + p.coupling_inertia if motor_end is MotorEnd.FREE else None,
        rotor_damping=p.motor_damping, table_damping=p.table_damping, nut_segment_mass=p.screw_nut_segment_mass,
        nut_segment_inertia=p.screw_nut_segment_inertia, motor_segment_inertia=p.screw_motor_segment_inertia,
        loss_factor=p.loss_factor,
    )  # fmt: skip


# --- authorities: the paper's matrices, finite elements


def test_closed_form_equals_coupled_matrices(paper, full, subtests):
    for motor_end, position in itertools.product(MotorEnd, [0.3, 0.6, 1.3, 1.9, 2.5]):
        with subtests.test(motor_end=motor_end, position=position):
            conditions = DriveConditions(position, payload_mass=25.0)
            for parameters in (paper, full):
                coupled = drive_receptance(parameters, OMEGA, conditions, motor_end)
                closed = closed_form(parameters, OMEGA, conditions, motor_end)
                np.testing.assert_allclose(closed, coupled[:, 0, 0], rtol=1e-10)


@pytest.mark.release
@pytest.mark.parametrize(("position", "n_near"), [(0.65, 15), (1.3, 30), (1.95, 45)])
def test_finite_elements_converge_on_the_closed_form(paper, position, n_near):
    # motor on; the difference over 12–1000 Hz against the largest receptance there. Below, where the screw is only a
    # mass, rounding of the finest mesh is as large as its error
    conditions = DriveConditions(position)
    frequency = np.r_[np.linspace(12.0, 60.0, 45), np.linspace(60.0, 1000.0, 60)]
    omega = 2 * np.pi * frequency
    exact = closed_form(paper, omega, conditions)
    responses = []
    for factor in (2, 4, 8):
        mesh = Assembly(axis_of(paper, MotorEnd.FREE), n_near * factor, (60 - n_near) * factor, position)
        responses.append(mesh.response(omega, mesh.table)[:, 0])
    errors = [np.max(np.abs(response - exact)) / np.max(np.abs(exact)) for response in responses]
    assert errors[1] < 1e-5  # 240 elements
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.05)
    # with the error of second order taken out they agree at every single frequency, resonances and zeros included
    extrapolated = (4.0 * responses[2] - responses[1]) / 3.0
    np.testing.assert_allclose(extrapolated, exact, rtol=1e-6)


@pytest.mark.release
@pytest.mark.parametrize("motor_end", MotorEnd)
def test_natural_frequencies_of_finite_elements_converge_on_the_exact_ones(paper, motor_end):
    undamped = without_damping(paper)
    exact = [mode.frequency for mode in ReceptanceModel(undamped).natural_frequencies(AT, motor_end)]
    elastic = [f for f in exact if 0.0 < f < 1000.0]
    errors = []
    for factor in (2, 4):
        mesh = Assembly(axis_of(undamped, motor_end), 46 * factor // 2, 74 * factor // 2, AT.position)
        found = mesh.modes(8)[0][-8 if motor_end is MotorEnd.CLAMPED else -7 :][: len(elastic)]
        errors.append(np.max(np.abs(found / elastic - 1.0)))
    assert errors[1] < 1e-5  # 240 elements
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)


@pytest.mark.release
@pytest.mark.parametrize(
    ("excitation", "motor_end"),
    [
        (ExcitationPoint.FORCE_AT_TABLE, MotorEnd.FREE),
        (ExcitationPoint.TORQUE_AT_MOTOR, MotorEnd.FREE),
        (ExcitationPoint.TORQUE_AT_SCREW, MotorEnd.PRESCRIBED),
    ],
)
def test_every_response_equals_that_of_finite_elements(full, excitation, motor_end):
    conditions = DriveConditions(1.0, payload_mass=12.0)
    frequency = np.linspace(5.0, 400.0, 40)
    responses = []
    for factor in (1, 2):
        mesh = Assembly(axis_of(full, motor_end, 12.0), 46 * factor, 74 * factor, 1.0)
        point = mesh.table if excitation is ExcitationPoint.FORCE_AT_TABLE else mesh.motor_end
        responses.append(mesh.response(2 * np.pi * frequency, point))
    table, motor = ((4.0 * responses[1] - responses[0]) / 3.0).T
    model = ReceptanceModel(full)
    for response, expected in (
        (ResponsePoint.DISPLACEMENT_AT_TABLE, table),
        (ResponsePoint.ACCELERATION_AT_TABLE, -((2 * np.pi * frequency) ** 2) * table),
        (ResponsePoint.ANGLE_AT_MOTOR, motor),
    ):
        found = model.frequency_response(frequency, conditions, excitation=excitation, response=response)
        np.testing.assert_allclose(found.response, expected, rtol=2e-6)


# --- gradient


@pytest.mark.parametrize("motor_end", MotorEnd)
def test_gradient_equals_central_differences(full, motor_end):
    terms, joints = position_terms(full, OMEGA, AT, motor_end), full.joints(AT)
    receptance, gradient = table_receptance_gradient(terms, joints)
    np.testing.assert_allclose(receptance, table_receptance(terms, joints), rtol=1e-13)
    assert gradient.shape == (8, OMEGA.size)
    for name, row in zip(JOINT_NAMES, gradient, strict=True):
        # a step of one share of the joint's stiffness, for a damping at 300 Hz: too small a one drowns in rounding
        stiffness = getattr(joints, name.replace("damping", "stiffness"))
        step = 2e-4 * stiffness / (1.0 if "stiffness" in name else 2 * np.pi * 300.0)
        value = getattr(joints, name)
        above, below = (table_receptance(terms, replace(joints, **{name: value + s})) for s in (step, -step))
        difference = (above - below) / (2.0 * step)
        np.testing.assert_allclose(row, difference, rtol=1e-6, atol=1e-6 * np.max(np.abs(row)))


def test_terms_of_a_position_hold_no_joint(full):
    other = replace(full, **{name: 2.0 * getattr(full, name) for name in (*JOINT_NAMES, "bracket_stiffness")})
    first, second = position_terms(full, OMEGA, AT), position_terms(other, OMEGA, AT)
    np.testing.assert_array_equal(table_receptance(first, other.joints(AT)), table_receptance(second, other.joints(AT)))
    assert not np.allclose(table_receptance(first, full.joints(AT)), table_receptance(first, other.joints(AT)))


# --- laws


@settings(max_examples=25, deadline=None)
@given(
    position=st.floats(0.05, 2.55),
    scale=st.lists(st.floats(-1.0, 1.0), min_size=8, max_size=8),
    motor_end=st.sampled_from([MotorEnd.FREE, MotorEnd.PRESCRIBED]),
)
def test_drive_is_passive(full, position, scale, motor_end):
    # the power taken in, −ω/2 Im(Fᴴ H F), is not negative for any force and torque together
    drive = replace(full, **{n: getattr(full, n) * 10.0**s for n, s in zip(JOINT_NAMES, scale, strict=True)})
    conditions = DriveConditions(position)
    responses = entire_responses(position_terms(drive, OMEGA, conditions, motor_end), drive.joints(conditions))
    numerators = np.array(
        [
            [responses.table_per_force, responses.table_per_torque],
            [responses.table_per_torque, responses.angle_per_torque],
        ]
    )
    matrix = np.moveaxis(numerators / responses.denominator, -1, 0)
    size = np.sqrt(np.abs(np.einsum("fii->fi", matrix)))  # metres and radians side by side
    matrix = matrix / size[:, :, None] / size[:, None, :]
    assert np.linalg.eigvalsh(-(matrix - matrix.conj().swapaxes(1, 2)) / 2j).min() > -1e-7


def test_responses_are_reciprocal(full):
    # the two are computed from one formula; that it is right both ways the finite elements say
    mesh = Assembly(axis_of(full, MotorEnd.FREE), 46, 74, 1.0)
    omega = 2 * np.pi * np.array([10.0, 100.0, 500.0])
    angle_per_force = mesh.response(omega, mesh.table)[:, 1]
    np.testing.assert_allclose(angle_per_force, mesh.response(omega, mesh.motor_end)[:, 0], rtol=1e-8)
    coupled = drive_receptance(full, OMEGA, AT)
    np.testing.assert_allclose(coupled, coupled.swapaxes(1, 2), rtol=1e-8)


def test_at_rest_a_clamped_drive_is_its_springs_in_series(full):
    p, l = full, AT.position  # noqa: E741  the paper's letter
    near = 1.0 / (1.0 / p.bearing_stiffness + l / p.axial_rigidity)
    far = 1.0 / (1.0 / p.far_bearing_stiffness + (p.screw_length - l) / p.axial_rigidity)
    turning = 1.0 / p.coupling_stiffness + l / p.torsional_rigidity
    ratio = p.screw_lead / (2 * np.pi)
    springs = 1.0 / p.nut_stiffness + 1.0 / p.bracket_stiffness + 1.0 / (near + far) + ratio**2 * turning
    found = closed_form(without_damping(full), np.array([0.01]), AT, MotorEnd.CLAMPED)
    assert found.item() == pytest.approx(springs, rel=1e-5)


@pytest.mark.parametrize(("motor_end", "rotor"), [(MotorEnd.FREE, 1.0), (MotorEnd.PRESCRIBED, 0.0)])
def test_a_free_drive_is_a_mass_when_it_moves_slowly(full, motor_end, rotor):
    p = full
    screw = p.density * np.pi * p.screw_diameter**4 / 32 * p.screw_length
    inertia = screw + p.screw_nut_segment_inertia + p.screw_motor_segment_inertia
    inertia += rotor * (p.motor_inertia + p.coupling_inertia)
    mass = p.table_mass + p.nut_mass + inertia / (p.screw_lead / (2 * np.pi)) ** 2
    omega = np.array([0.05])
    found = closed_form(without_damping(full), omega, AT, motor_end)
    assert found.item() == pytest.approx(-1.0 / (mass * omega.item() ** 2), rel=1e-5)


def test_joints_without_yield_are_no_joints(paper):
    p, l = paper, AT.position  # noqa: E741
    axial, torsional = (wave_number(OMEGA, modulus, p.density) for modulus in (p.youngs_modulus, p.shear_modulus))
    rest, ratio = p.screw_length - l, p.screw_lead / (2 * np.pi)
    table = -(OMEGA**2) * p.table_mass
    rotor = -(OMEGA**2) * (p.motor_inertia + p.screw_motor_segment_inertia)  # turning with the screw
    d_near = p.axial_rigidity * axial / np.tan(axial * l)  # bearing without yield
    d_far = condensed_stiffness(
        p.axial_rigidity, axial, rest, p.far_bearing_stiffness + 1j * OMEGA * p.far_bearing_damping
    )
    d_turn = condensed_stiffness(p.torsional_rigidity, torsional, l, rotor)
    d_turn = d_turn + condensed_stiffness(p.torsional_rigidity, torsional, rest, np.zeros_like(OMEGA))
    d_axial = d_near + d_far - OMEGA**2 * p.screw_nut_segment_mass
    compliance = 1.0 / d_axial + ratio**2 / (d_turn - OMEGA**2 * p.screw_nut_segment_inertia)  # nut without yield
    stiff = replace(p, bearing_stiffness=1e18, nut_stiffness=1e18, coupling_stiffness=1e14)
    np.testing.assert_allclose(closed_form(stiff), 1.0 / (1.0 / compliance + table), rtol=1e-6)


def test_without_inertia_of_the_screw_two_bodies_are_left(paper):
    p = replace(
        without_damping(paper), density=1e-6, screw_nut_segment_mass=0.0, screw_nut_segment_inertia=0.0,
        screw_motor_segment_inertia=0.0,
    )  # fmt: skip
    l, ratio = AT.position, p.screw_lead / (2 * np.pi)  # noqa: E741
    near = 1.0 / (1.0 / p.bearing_stiffness + l / p.axial_rigidity)
    far = 1.0 / (1.0 / p.far_bearing_stiffness + (p.screw_length - l) / p.axial_rigidity)
    turning = 1.0 / p.coupling_stiffness + l / p.torsional_rigidity
    k = 1.0 / (1.0 / p.nut_stiffness + 1.0 / (near + far) + ratio**2 * turning)
    # rotor and table with one spring between i θ and x
    stiffness = k * np.array([[ratio**2, -ratio], [-ratio, 1.0]])
    omega = 2 * np.pi * np.linspace(1.0, 60.0, 50)
    exact = np.linalg.inv(stiffness - omega[:, None, None] ** 2 * np.diag([p.motor_inertia, p.table_mass]))
    model, frequency = ReceptanceModel(p), omega / (2 * np.pi)
    for excitation, response, (i, j) in (
        (ExcitationPoint.FORCE_AT_TABLE, ResponsePoint.DISPLACEMENT_AT_TABLE, (1, 1)),
        (ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.DISPLACEMENT_AT_TABLE, (1, 0)),
        (ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ANGLE_AT_MOTOR, (0, 0)),
    ):
        found = model.frequency_response(frequency, AT, excitation=excitation, response=response)
        np.testing.assert_allclose(found.response, exact[:, i, j], rtol=1e-6)
    frequencies = model.natural_frequencies(AT)
    first = np.sqrt(k * (1.0 / p.table_mass + ratio**2 / p.motor_inertia)) / (2 * np.pi)
    assert frequencies[1].frequency == pytest.approx(first, rel=1e-7)


def test_payload_rides_on_the_table(paper):
    loaded = closed_form(paper, conditions=DriveConditions(1.0, payload_mass=80.0))
    heavier = closed_form(replace(paper, table_mass=paper.table_mass + 80.0))
    np.testing.assert_array_equal(loaded, heavier)


def test_nut_follows_the_preload_only_with_a_load_rating(paper):
    rated = replace(paper, dynamic_load_rating=40_000.0)
    preload = DriveConditions(1.0, preload=500.0)
    rigidity = 0.8 * paper.nut_stiffness * (500.0 / 4000.0) ** (1 / 3)
    np.testing.assert_allclose(
        closed_form(rated, conditions=preload), closed_form(replace(paper, nut_stiffness=rigidity))
    )
    with pytest.raises(OutsideValidityError, match="state the preload"):
        closed_form(rated)


# --- poles and modes


def zeros_inside(parameters, conditions, motor_end, highest):
    """Count the zeros of the characteristic function by its turns along a contour around the poles (Cauchy)."""
    low, high, below, above = 2 * np.pi * 1.0, 2 * np.pi * highest, -200.0, 0.5 * 2 * np.pi * highest
    corners = [low + 1j * below, high + 1j * below, high + 1j * above, low + 1j * above, low + 1j * below]
    contour = np.concatenate([np.linspace(a, b, 6001) for a, b in itertools.pairwise(corners)])
    terms = position_terms(parameters, contour, conditions, motor_end)
    phase = np.unwrap(np.angle(entire_responses(terms, parameters.joints(conditions)).denominator))
    assert np.max(np.abs(np.diff(phase))) < 1.0  # sampled densely enough
    return round((phase[-1] - phase[0]) / (2 * np.pi))


@pytest.mark.release
@pytest.mark.parametrize("motor_end", MotorEnd)
@pytest.mark.parametrize("position", [0.02, 0.6, 1.3, 2.2])
def test_no_pole_is_missed_and_none_found_twice(paper, full, position, motor_end):
    conditions = DriveConditions(position)
    for parameters in (paper, full):
        found = [m.frequency for m in ReceptanceModel(parameters).natural_frequencies(conditions, motor_end)]
        assert len(found) == 8
        assert found == sorted(found)
        elastic = [f for f in found if f > 0.0]
        assert len(elastic) == (8 if motor_end is MotorEnd.CLAMPED else 7)
        between = 0.5 * (elastic[-2] + elastic[-1])
        assert zeros_inside(parameters, conditions, motor_end, between) == len(elastic) - 1


def test_poles_are_zeros_of_the_inverse_receptance(full):
    for mode in ReceptanceModel(full).natural_frequencies(AT)[1:]:
        omega_n, zeta = 2 * np.pi * mode.frequency, mode.damping_ratio
        pole = omega_n * (np.sqrt(1.0 - zeta**2) + 1j * zeta)
        at, beside = closed_form(full, np.array([pole, pole * (1 + 1e-4)]))
        assert abs(at) > 1e4 * abs(beside)


@pytest.mark.parametrize("bracket", [np.inf, 3e8])
def test_a_strong_nut_damper_is_no_obstacle(paper, bracket):
    strong = replace(
        paper, nut_damping=2.25e5, coupling_stiffness=5.53e3, coupling_damping=3.5, bracket_stiffness=bracket
    )
    modes = ReceptanceModel(strong).natural_frequencies(AT)[1:]
    assert max(mode.damping_ratio for mode in modes) > 0.3
    highest = 0.5 * (modes[-2].frequency + modes[-1].frequency)
    poles = [m.frequency * (np.sqrt(1.0 - m.damping_ratio**2) + 1j * m.damping_ratio) for m in modes[:-1]]
    inside = [pole for pole in poles if pole.imag < 0.5 * highest]
    assert zeros_inside(strong, AT, MotorEnd.FREE, highest) == len(inside) >= 5


@pytest.mark.parametrize("motor_end", MotorEnd)
def test_modal_superposition_is_the_undamped_response(full, motor_end):
    undamped = without_damping(full)
    model = ReceptanceModel(undamped)
    modes = model.normal_modes(AT, motor_end)
    frequency = np.array([3.0, 17.0, 60.0, 140.0])
    omega = 2 * np.pi * frequency
    denominator = (2 * np.pi * modes.frequency[:, None]) ** 2 - omega**2
    table, motor = modes.displacement_at_table, modes.angle_at_motor

    def superposed(a, b):
        return np.sum((a * b)[:, None] / denominator, axis=0)

    def residual(exact, a, b):
        """Compare but for what the modes beyond the last give, nearly the same at all low frequencies."""
        left = exact - superposed(a, b)
        return np.ptp(left) / np.max(np.abs(exact))

    terms = position_terms(undamped, omega, AT, motor_end)
    exact = entire_responses(terms, undamped.joints(AT))
    assert residual((exact.table_per_force / exact.denominator).real, table, table) < 1e-4
    if motor_end is MotorEnd.CLAMPED:
        assert not motor.any()
        return
    assert residual((exact.table_per_torque / exact.denominator).real, table, motor) < 1e-4
    assert residual((exact.angle_per_torque / exact.denominator).real, motor, motor) < 1e-4


@pytest.mark.release
def test_normal_modes_have_the_mass_of_finite_elements(full):
    # φ of each mode from the eigenvectors of the elements
    undamped = without_damping(replace(full, bracket_stiffness=np.inf))
    mesh = Assembly(axis_of(undamped, MotorEnd.FREE), 92, 148, 1.0)
    modes = ReceptanceModel(undamped).normal_modes(AT)
    values, vectors = mesh.modes(8)
    for k in range(1, 5):
        assert modes.frequency[k] == pytest.approx(values[k], rel=1e-5)
        table, motor = vectors[k]
        assert modes.displacement_at_table[k] * np.sign(motor) == pytest.approx(table, rel=1e-3)
        assert modes.angle_at_motor[k] == pytest.approx(abs(motor), rel=1e-3)


def test_damping_ratio_of_a_mode_is_that_of_its_pole(paper):
    model = ReceptanceModel(paper)
    for position in (0.6, 1.3, 2.0):
        poles, modes = (
            model.natural_frequencies(DriveConditions(position)),
            model.normal_modes(DriveConditions(position)),
        )
        np.testing.assert_allclose(modes.damping_ratio, [p.damping_ratio for p in poles], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(modes.frequency, [p.frequency for p in poles], rtol=2e-3)


# --- answers and refusals


@pytest.mark.parametrize(
    ("excitation", "response", "quantity"),
    [
        (ExcitationPoint.FORCE_AT_TABLE, ResponsePoint.DISPLACEMENT_AT_TABLE, "receptance"),
        (ExcitationPoint.TORQUE_AT_SCREW, ResponsePoint.ACCELERATION_AT_TABLE, "torque_accelerance"),
        (ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ANGLE_AT_MOTOR, "rotational_receptance"),
    ],
)
def test_responses_are_named(paper, excitation, response, quantity):
    found = ReceptanceModel(paper).frequency_response(FREQUENCY, AT, excitation=excitation, response=response)
    assert found.quantity == quantity
    np.testing.assert_array_equal(found.frequency, FREQUENCY)


@pytest.mark.parametrize("position", [0.0, 2.6, -0.1])
def test_a_position_off_the_screw_is_refused(paper, position):
    model = ReceptanceModel(paper)
    with pytest.raises(OutsideValidityError, match="position must lie on the screw"):
        model.natural_frequencies(DriveConditions(position))
    with pytest.raises(OutsideValidityError, match="position must lie on the screw"):
        drive_receptance(paper, OMEGA, DriveConditions(position))


def test_matrices_need_a_piece_of_screw_inside_the_nut(paper):
    with pytest.raises(OutsideValidityError, match="screw_nut_segment_mass_kg"):
        drive_receptance(replace(paper, screw_nut_segment_mass=0.0), OMEGA, AT)


def test_modal_superposition_is_refused_where_a_mode_does_not_oscillate(paper):
    stuck = replace(paper, coupling_stiffness=1.0, coupling_damping=5.0)
    with pytest.raises(OutsideValidityError, match="does not oscillate"):
        ReceptanceModel(stuck).normal_modes(AT)


def test_parameters_survive_the_file(full):
    assert ReceptanceParameters.from_file_names(full.to_file_names(), "receptance") == full


@pytest.mark.release
@pytest.mark.parametrize("motor_end", MotorEnd)
@pytest.mark.parametrize("loss_factor", [0.001, 0.03, 0.1])
def test_a_loss_factor_alone_does_not_make_a_mode_of_the_rigid_body(paper, motor_end, loss_factor):
    """Its speed is a pole at zero, which rounding puts anywhere: it was followed as the first mode, and refused."""
    model = ReceptanceModel(replace(paper, loss_factor=loss_factor))
    for position in np.linspace(0.1, 2.5, 25):
        modes = model.natural_frequencies(DriveConditions(position), motor_end)
        assert len(modes) == 8
        assert sum(mode.frequency == 0.0 for mode in modes) == (motor_end is not MotorEnd.CLAMPED)
