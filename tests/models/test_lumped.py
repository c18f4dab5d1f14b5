"""The lumped model of Nguyen et al. (2018): Table 1 taken literally, closed forms, laws, limits."""

import csv
import tomllib
from dataclasses import astuple, replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from monitor_core.errors import OutsideValidityError
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from monitor_core.models.published.lumped import (
    LumpedModel,
    LumpedParameters,
    axial_stiffness,
    feature_coefficients,
    rotational_stiffness,
    shaft_axial_stiffness,
    shaft_torsional_stiffness,
)
from monitor_core.preload import PreloadFeatureCoefficients, preload_feature
from tests.conftest import PROJECT_ROOT

MODEL_FILE = PROJECT_ROOT / "replay_data" / "models" / "lumped.toml"
BUNDLED = LumpedParameters.from_file_names(tomllib.loads(MODEL_FILE.read_text("utf-8"))["parameters"], "lumped")
CORRECTED = replace(BUNDLED, loss_factor=0.0)  # the paper states no damping
LITERAL = replace(CORRECTED, bracket_stiffness=2.1e7)
LOSSY = replace(CORRECTED, loss_factor=0.05, table_damping=300.0)
RATIO = 0.006 / (2.0 * np.pi)
MOVING_MASS = 20.54 + 2.024 + 1.3
AT_500_MM = DriveConditions(0.5, preload=200.0)
POSITION, PRELOAD = st.floats(0.01, 0.96), st.floats(5.0, 400.0)


def axial_mode(parameters, position, preload, motor_end=None):
    modes = LumpedModel(parameters).natural_frequencies(DriveConditions(position, preload=preload), motor_end)
    return modes[0 if motor_end in {None, MotorEnd.CLAMPED} else 1].frequency


@pytest.fixture(scope="module")
def measured(published_data):
    with (published_data / "nguyen_table2.csv").open(newline="", encoding="utf-8") as stream:
        return [{name: float(cell) for name, cell in row.items()} for row in csv.DictReader(stream)]


def rms_misfit(parameters, measured):
    error = [
        axial_mode(parameters, row["position_mm"] * 1e-3, row["preload_n"]) - row["frequency_hz"] for row in measured
    ]
    return np.sqrt(np.mean(np.square(error)))


# --- the paper's numbers ---------------------------------------------------------------------------------------------


def test_model_file_is_table_1_with_ten_times_the_printed_bracket(published_data):
    with (published_data / "nguyen_table1.csv").open(newline="", encoding="utf-8") as stream:
        printed = {row["symbol"]: float(row["value"]) for row in csv.DictReader(stream)}
    p = CORRECTED
    assert p.dynamic_load_rating is not None
    read = {
        "m_table": p.table_mass, "m_screw": p.screw_mass, "m_nut": p.nut_mass, "J_s": p.screw_inertia,
        "L": p.screw_length, "E": p.youngs_modulus, "k_bracket": p.bracket_stiffness / 10.0, "K": p.nut_stiffness,
        "k_bearing": p.bearing_stiffness, "k_coupling": p.coupling_stiffness, "d_minor": p.screw_minor_diameter,
        "l": p.screw_lead, "0.1 C_d": 0.1 * p.dynamic_load_rating,
    }  # fmt: skip
    assert read == pytest.approx({symbol: printed[symbol] for symbol in read}, rel=1e-12)


def test_literal_table_1_gives_115_to_126_hertz():
    at_200_n = [axial_mode(LITERAL, x, 200.0) for x in (0.25, 0.5, 0.75)]
    assert at_200_n == pytest.approx([125.4, 120.7, 116.7], abs=0.05)
    assert axial_mode(LITERAL, 0.75, 50.0) == pytest.approx(115.0, abs=0.5)
    assert axial_mode(LITERAL, 0.25, 400.0) == pytest.approx(126.0, abs=0.5)


def test_misfit_to_table_2_with_the_printed_and_with_the_corrected_bracket(measured):
    assert rms_misfit(LITERAL, measured) == pytest.approx(63.3, abs=0.05)
    assert rms_misfit(CORRECTED, measured) == pytest.approx(9.6, abs=0.05)


def test_literal_coefficients_need_the_shear_modulus_of_steel():
    """−130, 2094, 1846, 5530 (× 1e-8) by G = E/2.6; all of them by 79.23 to 79.51 GPa only."""

    def rounded(shear_modulus):
        return [round(k * 1e8) for k in astuple(feature_coefficients(replace(LITERAL, shear_modulus=shear_modulus)))]

    assert rounded(206e9 / 2.6) == [-130, 2094, 1846, 5530]
    assert rounded(79.23e9) == rounded(79.51e9) == [-130, 2094, 1846, 5530]
    assert rounded(79.22e9)[1] == 2095
    assert rounded(79.52e9)[0] == -129
    assert rounded(80e9)[:2] == [-129, 2093]


def test_rotational_mode_is_eq_7_and_does_not_know_the_preload():
    G, d, x = 79.23e9, 0.0172, 0.5
    shaft = np.pi * 0.971 * d**4 * G / (32.0 * x * (0.971 - x))
    expected = np.sqrt(1.0 / (1.0 / shaft + 1.0 / 849.0) / 1.169e-4) / (2.0 * np.pi)
    for preload in (50.0, 400.0):
        modes = LumpedModel(CORRECTED).natural_frequencies(DriveConditions(x, preload=preload))
        assert modes[1].frequency == pytest.approx(expected, rel=1e-12)
    assert expected == pytest.approx(376.0, abs=0.5)


# --- closed forms ----------------------------------------------------------------------------------------------------


@given(position=POSITION, preload=PRELOAD, payload=st.floats(0.0, 100.0))
def test_coefficients_leave_the_preload_alone_in_the_feature(position, preload, payload):
    """Eq. (8) in closed form against Eqs. (1)–(6) through the pole: the feature of each prediction is its preload's."""
    conditions = DriveConditions(position, preload=preload, payload_mass=payload)
    frequency = LumpedModel(CORRECTED).natural_frequencies(conditions)[0].frequency
    k = feature_coefficients(CORRECTED, payload)
    feature = preload_feature(frequency, position, PreloadFeatureCoefficients(*astuple(k)))
    assert feature == pytest.approx(k.k3 * preload ** (-1.0 / 3.0), rel=1e-9)


def test_clamped_receptance_at_the_table_has_the_pole_of_eq_6():
    """1/(k(1 + jη_e) + jω c_t − ω² Σm), with the compliances of Eq. (4) added by hand."""
    eta, frequency = 0.05, np.linspace(1.0, 600.0, 200)
    nut = 0.8 * 470e6 * (200.0 / 400.0) ** (1.0 / 3.0)
    shaft = 0.5 * 4.0 / (np.pi * 0.0172**2 * 206e9)
    torsion = RATIO**2 * 32.0 * 0.5 * 0.471 / (np.pi * 0.971 * 0.0172**4 * 79.23e9)
    joints = 1.0 / 100e6 + 1.0 / 2.1e8 + 1.0 / nut + RATIO**2 / 849.0
    k, omega = 1.0 / (shaft + torsion + joints / (1.0 + 1j * eta)), 2.0 * np.pi * frequency
    answer = LumpedModel(LOSSY).frequency_response(
        frequency, AT_500_MM, excitation=ExcitationPoint.FORCE_AT_TABLE, response=ResponsePoint.DISPLACEMENT_AT_TABLE
    )
    assert answer.response == pytest.approx(1.0 / (k + 300j * omega - MOVING_MASS * omega**2), rel=1e-11)
    undamped = axial_mode(CORRECTED, 0.5, 200.0)
    assert undamped == pytest.approx(np.sqrt(1.0 / (shaft + torsion + joints) / MOVING_MASS) / (2.0 * np.pi), rel=1e-12)


@given(position=POSITION, payload=st.floats(0.0, 100.0))
def test_ends_that_turn_have_the_frequency_of_two_bodies_on_a_spring(position, payload):
    """ω² = k_ax (i²/J + 1/Σm)."""
    p = replace(CORRECTED, motor_inertia=2e-4, coupling_inertia=3e-5)
    conditions = DriveConditions(position, preload=200.0, payload_mass=payload)
    for motor_end, inertia in ((MotorEnd.FREE, 2e-4 + 3e-5 + 1.169e-4), (MotorEnd.PRESCRIBED, 1.169e-4)):
        k = axial_stiffness(p, conditions, coupling=motor_end is MotorEnd.FREE).real
        omega = np.sqrt(k * (RATIO**2 / inertia + 1.0 / (MOVING_MASS + payload)))
        rigid, elastic = LumpedModel(p).natural_frequencies(conditions, motor_end)
        assert rigid.frequency == 0.0
        assert elastic.frequency == pytest.approx(omega / (2.0 * np.pi), rel=1e-10)


def test_damping_ratio_of_the_axial_mode_adds_friction_and_half_the_loss_factor():
    """ζ = η_e/2 + c/(2 m ω) to first order; the rest is of third."""
    mode = LumpedModel(LOSSY).natural_frequencies(AT_500_MM)[0]
    k = axial_stiffness(LOSSY, AT_500_MM)
    expected = 0.5 * k.imag / k.real + 300.0 / (2.0 * MOVING_MASS * 2.0 * np.pi * mode.frequency)
    assert mode.damping_ratio == pytest.approx(expected, rel=1e-3)


# --- laws ------------------------------------------------------------------------------------------------------------


@given(position=POSITION, preload=st.floats(5.0, 390.0))
def test_frequency_rises_with_preload_and_falls_with_payload(position, preload):
    assert axial_mode(CORRECTED, position, preload + 10.0) > axial_mode(CORRECTED, position, preload)
    loaded, empty = (
        LumpedModel(CORRECTED).natural_frequencies(DriveConditions(position, preload=preload, payload_mass=m))[0]
        for m in (1.0, 0.0)
    )
    # f ∝ 1/√Σm
    assert loaded.frequency / empty.frequency == pytest.approx((MOVING_MASS / (MOVING_MASS + 1.0)) ** 0.5, rel=1e-10)


@pytest.mark.parametrize("end", [MotorEnd.FREE, MotorEnd.PRESCRIBED])
def test_torque_to_table_equals_force_to_motor_angle(end):
    """The force at the table finds a clamped end in this family; so the other way is solved for here."""
    frequency = np.linspace(1.0, 500.0, 80)
    omega = 2.0 * np.pi * frequency
    torque = ExcitationPoint.TORQUE_AT_MOTOR if end is MotorEnd.FREE else ExcitationPoint.TORQUE_AT_SCREW
    forward = LumpedModel(LOSSY).frequency_response(
        frequency, AT_500_MM, excitation=torque, response=ResponsePoint.DISPLACEMENT_AT_TABLE
    )
    # a unit force at the table, nothing on the motor: J θ̈ + i (i θ − x) k = 0 and Σm ẍ + c ẋ − (i θ − x) k = 1
    k = axial_stiffness(LOSSY, AT_500_MM, coupling=end is MotorEnd.FREE)
    table, motor = k + 300j * omega - MOVING_MASS * omega**2, RATIO**2 * k - 1.169e-4 * omega**2
    angle = RATIO * k / (table * motor - (RATIO * k) ** 2)
    assert forward.response == pytest.approx(angle, rel=1e-10)


@given(frequency=st.floats(0.1, 5000.0), position=POSITION, loss_factor=st.floats(0.0, 0.3))
def test_driving_points_only_take_energy(frequency, position, loss_factor):
    model, at = LumpedModel(replace(LOSSY, loss_factor=loss_factor)), np.array([frequency])
    for excitation, response in (
        (ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ANGLE_AT_MOTOR),
        (ExcitationPoint.TORQUE_AT_SCREW, ResponsePoint.ANGLE_AT_MOTOR),
        (ExcitationPoint.FORCE_AT_TABLE, ResponsePoint.DISPLACEMENT_AT_TABLE),
    ):
        conditions = DriveConditions(position, preload=100.0)
        answer = model.frequency_response(at, conditions, excitation=excitation, response=response)
        assert answer.response[0].imag <= 1e-12 * abs(answer.response[0])


def test_static_limit_of_the_clamped_drive_is_its_compliance():
    answer = LumpedModel(CORRECTED).frequency_response(
        np.array([1e-3]),
        AT_500_MM,
        excitation=ExcitationPoint.FORCE_AT_TABLE,
        response=ResponsePoint.DISPLACEMENT_AT_TABLE,
    )
    k = (2.0 * np.pi * axial_mode(CORRECTED, 0.5, 200.0)) ** 2 * MOVING_MASS
    assert answer.response == pytest.approx(1.0 / k, rel=1e-9)


@pytest.mark.parametrize(
    ("excitation", "turning"), [(ExcitationPoint.TORQUE_AT_MOTOR, 5e-4), (ExcitationPoint.TORQUE_AT_SCREW, 0.0)]
)
def test_slowly_driven_it_moves_as_one_body(excitation, turning):
    """x/T → i / (−ω² (J + i² Σm))."""
    p, at = replace(CORRECTED, motor_inertia=5e-4), np.array([0.01])
    answer = LumpedModel(p).frequency_response(
        at, AT_500_MM, excitation=excitation, response=ResponsePoint.DISPLACEMENT_AT_TABLE
    )
    inertia = turning + 1.169e-4 + RATIO**2 * MOVING_MASS
    assert answer.response == pytest.approx(-RATIO / ((2.0 * np.pi * at) ** 2 * inertia), rel=1e-6)


@pytest.mark.parametrize("motor_end", list(MotorEnd))
def test_modal_superposition_gives_the_response(motor_end):
    excitation = {
        MotorEnd.CLAMPED: ExcitationPoint.FORCE_AT_TABLE,
        MotorEnd.FREE: ExcitationPoint.TORQUE_AT_MOTOR,
        MotorEnd.PRESCRIBED: ExcitationPoint.TORQUE_AT_SCREW,
    }[motor_end]
    model, frequency = LumpedModel(CORRECTED), np.linspace(5.0, 600.0, 90)
    modes = model.normal_modes(AT_500_MM, motor_end)
    driven = modes.displacement_at_table if motor_end is MotorEnd.CLAMPED else modes.angle_at_motor
    omega, omega_n = 2.0 * np.pi * frequency[:, None], 2.0 * np.pi * modes.frequency
    summed = np.sum(driven * modes.displacement_at_table / (omega_n**2 - omega**2), axis=1)
    answer = model.frequency_response(
        frequency, AT_500_MM, excitation=excitation, response=ResponsePoint.DISPLACEMENT_AT_TABLE
    )
    assert answer.response == pytest.approx(summed, rel=1e-9)
    assert np.all(modes.damping_ratio == 0.0)


def test_normal_modes_are_those_of_the_natural_frequencies():
    for motor_end in MotorEnd:
        natural = LumpedModel(LOSSY).natural_frequencies(AT_500_MM, motor_end)
        modes = LumpedModel(LOSSY).normal_modes(AT_500_MM, motor_end)
        assert modes.damping_ratio == pytest.approx([mode.damping_ratio for mode in natural], rel=1e-9)
        # |s| of a lossy spring is (1 + η²)^(1/4) above the undamped frequency
        assert modes.frequency == pytest.approx([mode.frequency for mode in natural], rel=0.05**2 / 4.0, abs=1e-9)
        # a clamped motor does not move in any mode
        assert np.any(modes.angle_at_motor) == (motor_end is not MotorEnd.CLAMPED)


def test_eq_7_has_no_share_in_any_response():
    modes = LumpedModel(CORRECTED).normal_modes(AT_500_MM)
    assert modes.displacement_at_table[0] == pytest.approx(MOVING_MASS**-0.5, rel=1e-12)
    assert modes.displacement_at_table[1] == 0.0


# --- limits in which models meet -------------------------------------------------------------------------------------


def test_rigid_joints_leave_the_springs_of_the_screw():
    p = replace(
        LOSSY, bearing_stiffness=1e30, bracket_stiffness=1e30, nut_stiffness=1e30, coupling_stiffness=1e30
    )  # the loss goes with the joints
    compliance = 1.0 / shaft_axial_stiffness(p, 0.5) + RATIO**2 / shaft_torsional_stiffness(p, 0.5)
    assert axial_stiffness(p, AT_500_MM) == pytest.approx(1.0 / compliance, rel=1e-12)
    unstated = replace(p, bracket_stiffness=float("inf"))
    assert axial_stiffness(unstated, AT_500_MM) == pytest.approx(1.0 / compliance, rel=1e-12)


def test_without_motor_inertia_free_and_prescribed_differ_by_the_coupling_alone():
    """Table 1 as it stands: the coupling's compliance, 3.7 % of the rest, is in the one spring and not in the other."""
    free, prescribed = (axial_mode(CORRECTED, 0.5, 200.0, end) for end in (MotorEnd.FREE, MotorEnd.PRESCRIBED))
    share = RATIO**2 / 849.0 * axial_stiffness(CORRECTED, AT_500_MM, coupling=False).real
    assert (prescribed / free) ** 2 - 1.0 == pytest.approx(share, rel=1e-9)
    assert share == pytest.approx(0.037, abs=5e-4)
    rigid = replace(CORRECTED, coupling_stiffness=1e18)
    free, prescribed = (axial_mode(rigid, 0.5, 200.0, end) for end in (MotorEnd.FREE, MotorEnd.PRESCRIBED))
    assert free == pytest.approx(prescribed, rel=1e-12)


def test_heavy_motor_is_a_clamped_end():
    heavy = replace(CORRECTED, motor_inertia=1e9)
    assert axial_mode(heavy, 0.5, 200.0, MotorEnd.FREE) == pytest.approx(axial_mode(CORRECTED, 0.5, 200.0), rel=1e-9)


def test_motor_ends_stand_in_order():
    """The lighter what turns at the end, the higher the mode: clamped, free, prescribed."""
    p = replace(CORRECTED, motor_inertia=2e-4)
    clamped, free, prescribed = (
        axial_mode(p, 0.5, 200.0, end) for end in (MotorEnd.CLAMPED, MotorEnd.FREE, MotorEnd.PRESCRIBED)
    )
    assert clamped < free < prescribed


def test_eq_3_holds_the_far_end_of_the_screw():
    """Springs of both sides of the nut side by side; with the free far end only the motor's side would count."""
    polar = np.pi * CORRECTED.screw_minor_diameter**4 / 32.0
    motor_side, far_side = CORRECTED.shear_modulus * polar / 0.75, CORRECTED.shear_modulus * polar / 0.221
    assert shaft_torsional_stiffness(CORRECTED, 0.75) == pytest.approx(motor_side + far_side, rel=1e-12)
    added = RATIO**2 * (1.0 / motor_side - 1.0 / (motor_side + far_side))
    k = axial_stiffness(CORRECTED, DriveConditions(0.75, preload=200.0)).real
    assert (1.0 + added * k) ** 0.5 - 1.0 == pytest.approx(0.011, abs=5e-4)


def test_rotational_stiffness_without_coupling_is_that_of_the_shaft():
    assert rotational_stiffness(LOSSY, 0.3, coupling=False) == pytest.approx(shaft_torsional_stiffness(LOSSY, 0.3))


# --- refusals --------------------------------------------------------------------------------------------------------


def test_angle_of_a_clamped_motor_is_refused():
    with pytest.raises(OutsideValidityError, match="clamped"):
        LumpedModel(CORRECTED).frequency_response(
            np.array([100.0]),
            AT_500_MM,
            excitation=ExcitationPoint.FORCE_AT_TABLE,
            response=ResponsePoint.ANGLE_AT_MOTOR,
        )


def test_coefficients_need_a_nut_that_follows_the_preload():
    with pytest.raises(OutsideValidityError, match="dynamic_load_rating_n"):
        feature_coefficients(replace(CORRECTED, dynamic_load_rating=None))


@pytest.mark.parametrize(
    ("conditions", "match"),
    [
        (DriveConditions(0.971, preload=200.0), "on the screw"),
        (DriveConditions(0.5), "state the preload"),
        (DriveConditions(0.5, preload=401.0), "10 % of the dynamic load rating"),
    ],
)
def test_conditions_outside_the_sources_range_are_refused(conditions, match):
    with pytest.raises(OutsideValidityError, match=match):
        LumpedModel(CORRECTED).natural_frequencies(conditions)
