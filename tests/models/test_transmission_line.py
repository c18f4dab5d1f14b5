"""The transmission-line model: what it answers is what its time stepping does, and what the continuous drive does."""

import math

import numpy as np
import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from monitor_core.models.published.transmission_line import (
    TransmissionLineModel,
    simulate_drive,
    synchronised_grid,
)
from monitor_core.models.published.transmission_line.mobility import DiscreteDrive, response_at
from tests.models.line_reference import (
    HEAVY,
    UNDAMPED,
    continuous_frequency,
    drive_on,
    dynamic_stiffness,
    pole_of_matrix,
    shaft,
    step_matrix,
)

HERE = DriveConditions(position=0.6)


def respond(model, frequency, excitation, response, conditions=HERE):
    return model.frequency_response(np.atleast_1d(frequency), conditions, excitation=excitation, response=response)


# --- the continuous drive ------------------------------------------------------------------------------------------


@pytest.mark.release
def test_coupled_drive_with_the_paper_s_synchronisation_is_within_1_ppm_of_the_continuous_one():
    # t_a = t_t/8 = 0.125 µs, 421 and 2105 sections, the density of Eq. (54); all eight modes up to 4.4 kHz.
    p = shaft(density=80e9 / (1.346 / 421e-6) ** 2, **UNDAMPED)
    grid = synchronised_grid(p, 1e-6)
    assert (grid.torsional_sections, grid.axial_sections) == (421, 2105)
    matrix = step_matrix(*drive_on(grid, p))
    modes = TransmissionLineModel(p).natural_frequencies(HERE)[1:]
    assert len(modes) == 8
    for mode in modes:
        exact = continuous_frequency(p, HERE.position, mode.frequency)
        pole = pole_of_matrix(matrix, 1e-6, exact)
        assert pole.imag / (2 * math.pi) == pytest.approx(exact, rel=1e-6)
        assert -1e-6 * abs(pole) < pole.real < 0.0  # the hold loses a little and never gains


@pytest.mark.parametrize("position", [0.15, 0.6, 0.6731, 1.2])
def test_natural_frequencies_are_those_of_the_continuous_drive(position):
    # The stubs see tan(ωh)/h for ω: (ωh)²/3 is 1 ppm at 133 Hz and a step of 4 µs, and 1100 ppm at 4.4 kHz.
    p = shaft(**UNDAMPED)
    model = TransmissionLineModel(p)
    half_step = 0.5 * model.grid.time_step
    for mode in model.natural_frequencies(DriveConditions(position))[1:]:
        warp = (2 * math.pi * mode.frequency * half_step) ** 2 / 3
        exact = continuous_frequency(p, position, mode.frequency)
        assert mode.frequency == pytest.approx(exact, rel=warp + 5e-6)
        assert mode.damping_ratio < 1e-12


def test_first_mode_is_within_1_ppm_where_both_delays_are_whole_and_within_9_for_any_steel():
    """With E/G = (8/5)² both waves cross the screw in whole steps; else the axial delay is rounded to the nearest.

    (215.5, 77.75) is the worst of 825 steels, 200 to 216 and 77 to 83 GPa; the others are what handbooks state.
    """
    steels = [(204.8, 80.0), (200.0, 77.0), (205.0, 79.3), (206.0, 79.4), (210.0, 80.8), (210.0, 81.0), (215.5, 77.75)]
    off = []
    for youngs_modulus, shear_modulus in steels:
        p = shaft(youngs_modulus=youngs_modulus * 1e9, shear_modulus=shear_modulus * 1e9, **UNDAMPED)
        first = TransmissionLineModel(p).natural_frequencies(HERE)[1].frequency
        off.append(abs(1e6 * (first / continuous_frequency(p, HERE.position, first) - 1.0)))
    assert off[0] < 1.0
    assert 8.0 < off[-1] < 8.6
    assert max(off) == off[-1]


@pytest.mark.release
def test_no_mode_is_missed():
    # Between zero and 4.5 kHz the determinant of the continuous drive changes sign at modes and at the poles of its
    # elements; what is left after those are taken out is the number of modes.
    p = shaft(**UNDAMPED)
    modes = [mode.frequency for mode in TransmissionLineModel(p).natural_frequencies(HERE)[1:]]
    frequency = np.linspace(5.0, 4600.0, 40_000)
    sign = np.array([np.linalg.slogdet(dynamic_stiffness(p, 0.6, 2 * np.pi * f))[0] for f in frequency])
    changes = frequency[1:][sign[1:] != sign[:-1]]
    of_elements = [
        n * speed / (2 * length)
        for speed in (p.axial_speed, p.torsional_speed)
        for length in (0.6, p.screw_length - 0.6)
        for n in range(1, 6)
    ]
    expected = sorted(modes + [f for f in of_elements if f < 4600.0])
    np.testing.assert_allclose(changes, expected, rtol=2e-3)


# --- the time stepping ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("motor_end", list(MotorEnd))
@pytest.mark.parametrize("position", [0.6, 0.31])
def test_poles_are_the_eigenvalues_of_one_step(motor_end, position):
    p = shaft(bracket_stiffness=9e8)
    model = TransmissionLineModel(p, least_torsional_sections=40)
    matrix = step_matrix(*drive_on(model.grid, p, position, motor_end))
    modes = model.natural_frequencies(DriveConditions(position), motor_end)
    elastic = [mode for mode in modes if mode.frequency > 0.0]
    assert len(modes) - len(elastic) == (0 if motor_end is MotorEnd.CLAMPED else 1)
    assert [mode.frequency for mode in modes] == sorted(mode.frequency for mode in modes)
    eigenvalues = np.linalg.eigvals(matrix.toarray())
    poles = np.log(eigenvalues[np.abs(eigenvalues) > 0.1] + 0j) / model.grid.time_step
    for mode in elastic:
        s = 2 * np.pi * mode.frequency * (-mode.damping_ratio + 1j * math.sqrt(1.0 - mode.damping_ratio**2))
        assert np.min(np.abs(poles - s)) < 1e-8 * abs(s)


#: Joints and masses within a factor of two of the bundled axis: two of its poles pass each other as damping grows.
CLOSE_POLES = [
    {"table_mass": 230.0, "motor_inertia": 8.6e-3, "coupling_inertia": 4.2e-4, "coupling_stiffness": 3.0e4,
     "bearing_stiffness": 3.5e8, "far_bearing_stiffness": 1.9e8, "nut_stiffness": 5.7e8},
    {"table_mass": 370.0, "motor_inertia": 5.6e-3, "coupling_inertia": 5.0e-4, "coupling_stiffness": 2.4e4,
     "bearing_stiffness": 3.2e8, "far_bearing_stiffness": 2.0e8, "nut_stiffness": 5.8e8},
    {"table_mass": 270.0, "motor_inertia": 7.7e-3, "coupling_inertia": 3.1e-4, "coupling_stiffness": 1.7e4,
     "bearing_stiffness": 2.6e8, "far_bearing_stiffness": 1.1e8, "nut_stiffness": 4.1e8},
]  # fmt: skip
#: Here the highest pole given used to be that of the mode above it, which has less damping.
HIGHEST_POLE = {
    "table_mass": 982.0, "motor_inertia": 7.44e-4, "coupling_inertia": 3.99e-3, "coupling_stiffness": 5214.0,
    "bearing_stiffness": 4.523e8, "far_bearing_stiffness": 1.389e9, "nut_stiffness": 1.928e8,
    "bearing_damping": 1425.0, "far_bearing_damping": 18720.0, "nut_damping": 64396.0, "coupling_damping": 0.58,
    "table_damping": 265.0, "motor_damping": 0.0162,
}  # fmt: skip


@pytest.mark.parametrize("changes", CLOSE_POLES)
def test_poles_that_pass_each_other_fell_onto_one_path_and_were_refused(changes):
    p = shaft(**changes)
    model = TransmissionLineModel(p)
    matrix = step_matrix(*drive_on(model.grid, p))
    modes = model.natural_frequencies(HERE)[1:]
    poles = np.array([2j * np.pi * m.frequency * np.exp(1j * math.asin(m.damping_ratio)) for m in modes])
    apart = np.abs(poles[:, None] - poles) + np.diag(np.abs(poles))
    assert apart.min() > 1.0
    for s in poles:
        assert pole_of_matrix(matrix, model.grid.time_step, s / (2j * np.pi)) == pytest.approx(s, rel=1e-7)


@pytest.mark.release
def test_the_highest_pole_was_exchanged_for_that_of_a_mode_beyond():
    """The damping ratio of a mode rises as its dampers grow; that of the mode beyond is 0.7 %."""
    ratios = []
    for share in np.linspace(0.0, 1.0, 11):
        changes = {name: value * (share if name in UNDAMPED else 1.0) for name, value in HIGHEST_POLE.items()}
        ratios.append(TransmissionLineModel(shaft(**changes)).natural_frequencies(HERE)[-1].damping_ratio)
    assert np.all(np.diff(ratios) > 0.015)


@pytest.mark.parametrize("seed", range(6))
def test_any_drive_has_the_modes_of_its_step_and_no_others(seed):
    rng = np.random.default_rng(seed)

    def between(low, high):
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    p = shaft(
        table_mass=between(5, 2000), motor_inertia=between(1e-5, 1), coupling_stiffness=between(1e2, 1e6),
        bearing_stiffness=between(1e6, 1e10), far_bearing_stiffness=between(1e6, 1e10) * (seed % 2),
        nut_stiffness=between(1e7, 1e10), screw_lead=between(0.002, 0.06), screw_length=between(0.3, 3.0), **UNDAMPED,
    )  # fmt: skip
    position, end = p.screw_length * rng.uniform(0.06, 0.94), list(MotorEnd)[seed % 3]
    model = TransmissionLineModel(p, least_torsional_sections=30)
    modes = [m.frequency for m in model.natural_frequencies(DriveConditions(position), end) if m.frequency > 0.0]
    eigenvalues = np.linalg.eigvals(step_matrix(*drive_on(model.grid, p, position, end)).toarray())
    angle = np.log(eigenvalues[np.abs(eigenvalues) > 0.5] + 0j).imag
    frequency = np.sort(angle) / (2 * np.pi * model.grid.time_step)
    highest = 4 * 0.5 * p.torsional_speed / p.screw_length  # the fourth half-wave
    np.testing.assert_allclose(modes, frequency[(frequency > 0.5) & (frequency < highest * (1 - 1e-9))], rtol=1e-6)


@pytest.mark.release
@pytest.mark.parametrize("excitation", list(ExcitationPoint))
def test_response_is_the_transform_of_a_run(excitation):
    # A run from rest, weighted with e^(−αt) so that its end no longer counts, is the response at s = α + jω.
    p = shaft(bracket_stiffness=9e8)
    model = TransmissionLineModel(p, least_torsional_sections=20)
    grid = model.grid
    n, alpha = round(0.3 / grid.time_step), 120.0
    pulse, none = np.zeros(n), np.zeros(n)
    pulse[0] = 1.0
    torque, force = (none, pulse) if excitation is ExcitationPoint.FORCE_AT_TABLE else (pulse, none)
    end = MotorEnd.PRESCRIBED if excitation is ExcitationPoint.TORQUE_AT_SCREW else MotorEnd.FREE
    run = simulate_drive(p, grid, HERE, torque, motor_end=end, force_at_table=force)

    lines = np.arange(0, n // 2, 37)
    s = alpha + 2j * np.pi * lines / (n * grid.time_step)
    weight = np.exp(-alpha * grid.time_step * np.arange(n))
    drive = DiscreteDrive(p, grid, HERE, end)
    for response, recorded in (
        (ResponsePoint.ACCELERATION_AT_TABLE, run.acceleration_at_table),
        (ResponsePoint.DISPLACEMENT_AT_TABLE, run.displacement_at_table),
        (ResponsePoint.ANGLE_AT_MOTOR, run.angle_at_motor),
    ):
        transform = np.fft.fft(weight * recorded)[lines]
        modelled = response_at(drive, s, excitation, response)
        np.testing.assert_allclose(transform, modelled, rtol=1e-8, atol=1e-9 * np.max(np.abs(modelled)))


@pytest.mark.release
def test_a_drive_that_comes_to_rest_shows_its_response_in_the_transform_of_its_acceleration():
    p = shaft(**HEAVY)
    model = TransmissionLineModel(p, least_torsional_sections=20)
    n = round(0.5 / model.grid.time_step)
    pulse = np.zeros(n)
    pulse[0] = 1.0
    run = simulate_drive(p, model.grid, HERE, pulse)
    lines = np.arange(1, n // 4, 37)
    modelled = respond(
        model, lines / (n * model.grid.time_step), ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ACCELERATION_AT_TABLE
    ).response
    transform = np.fft.fft(run.acceleration_at_table)[lines]
    np.testing.assert_allclose(transform, modelled, rtol=1e-8, atol=1e-9 * np.max(np.abs(modelled)))


def test_modes_are_the_residues_of_the_response():
    # Close to an undamped pole the receptance between a and b is φ_a φ_b/(ω_n² − ω²).
    p = shaft(**UNDAMPED)
    model = TransmissionLineModel(p)
    for end, torque in (
        (MotorEnd.FREE, ExcitationPoint.TORQUE_AT_MOTOR), (MotorEnd.PRESCRIBED, ExcitationPoint.TORQUE_AT_SCREW),
    ):  # fmt: skip
        modes = model.normal_modes(HERE, end)
        assert modes.frequency[0] == 0.0
        for f, angle, table in zip(
            modes.frequency[1:], modes.angle_at_motor[1:], modes.displacement_at_table[1:], strict=True
        ):
            near = f * (1.0 + np.array([-1e-7, 1e-7]))
            denominator = (2 * np.pi) ** 2 * (f**2 - near**2)
            pairs = [
                (respond(model, near, torque, ResponsePoint.ANGLE_AT_MOTOR), angle * angle),
                (respond(model, near, torque, ResponsePoint.DISPLACEMENT_AT_TABLE), angle * table),
            ]
            if end is MotorEnd.FREE:  # a force at the table finds the motor free
                force = ExcitationPoint.FORCE_AT_TABLE
                pairs.append((respond(model, near, force, ResponsePoint.DISPLACEMENT_AT_TABLE), table * table))
            for response, product in pairs:
                residue = np.mean((response.response * denominator).real)
                assert residue == pytest.approx(product, rel=1e-4)


def test_modes_sum_to_the_response():
    # What modal superposition is for; the modes above 4.5 kHz leave a small static share.
    p = shaft(coupling_damping=0.2, bearing_damping=1e3, far_bearing_damping=500.0, nut_damping=2e3)
    model = TransmissionLineModel(p)
    modes = model.normal_modes(HERE)
    omega = 2 * np.pi * np.linspace(100.0, 500.0, 81)
    omega_n = 2 * np.pi * modes.frequency[:, None]
    denominator = omega_n**2 - omega**2 + 2j * modes.damping_ratio[:, None] * omega_n * omega
    summed = np.sum((modes.angle_at_motor * modes.displacement_at_table)[:, None] / denominator, axis=0)
    direct = respond(
        model, omega / (2 * np.pi), ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.DISPLACEMENT_AT_TABLE
    ).response
    assert np.max(np.abs(summed - direct)) < 0.02 * np.max(np.abs(direct))


def test_a_nut_in_the_middle_of_a_symmetric_screw_finds_the_modes_that_do_not_move_it():
    # Equal bearings, nut in the middle: every other axial mode of the screw has its node there, at Zω tan ωT/2 = −k.
    p = shaft(far_bearing_stiffness=5e8, **UNDAMPED)
    middle = 0.5 * p.screw_length
    modes = TransmissionLineModel(p).normal_modes(DriveConditions(middle))
    still = np.abs(modes.displacement_at_table) < 1e-6 * np.max(np.abs(modes.displacement_at_table))
    assert np.count_nonzero(still) >= 1
    z, delay = p.axial_rigidity / p.axial_speed, p.screw_length / p.axial_speed
    omega = 2 * np.pi * modes.frequency[still]
    # half a screw, held in the middle, on its bearing: Zω cot(ωT/2) + k = 0
    np.testing.assert_allclose(z * omega / np.tan(omega * delay / 2), -5e8, rtol=2e-3)


# --- laws ----------------------------------------------------------------------------------------------------------


def test_reciprocity():
    model = TransmissionLineModel(shaft(bracket_stiffness=9e8))
    frequency = np.geomspace(1.0, 5e3, 60)
    there = respond(model, frequency, ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.DISPLACEMENT_AT_TABLE)
    back = respond(model, frequency, ExcitationPoint.FORCE_AT_TABLE, ResponsePoint.ANGLE_AT_MOTOR)
    np.testing.assert_allclose(there.response, back.response, rtol=1e-10)


@pytest.mark.parametrize(
    ("excitation", "response"),
    [
        (ExcitationPoint.FORCE_AT_TABLE, ResponsePoint.DISPLACEMENT_AT_TABLE),
        (ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ANGLE_AT_MOTOR),
        (ExcitationPoint.TORQUE_AT_SCREW, ResponsePoint.ANGLE_AT_MOTOR),
    ],
)
def test_passivity(excitation, response):
    # A receptance at the place of its own excitation never leads: Im ≤ 0, up to half the sampling rate.
    for position in (0.1, 0.6, 1.1):
        model = TransmissionLineModel(shaft())
        frequency = np.linspace(1.0, 0.999 * 0.5 / model.grid.time_step, 5000)
        own = respond(model, frequency, excitation, response, DriveConditions(position)).response
        assert np.all(own.imag <= 1e-12 * np.abs(own))


def test_rigid_body_limit_of_a_free_drive():
    p = shaft(**UNDAMPED)
    model = TransmissionLineModel(p)
    i, screw = p.transmission_ratio, p.density * math.pi * 0.04**4 / 32 * p.screw_length
    conditions = DriveConditions(0.6, payload_mass=50.0)
    for excitation, inertia in (
        (ExcitationPoint.TORQUE_AT_MOTOR, 6.5e-3 + screw), (ExcitationPoint.TORQUE_AT_SCREW, screw),
    ):  # fmt: skip
        slow = respond(model, 0.05, excitation, ResponsePoint.ACCELERATION_AT_TABLE, conditions).response[0]
        assert slow == pytest.approx(i / (inertia + i**2 * 350.0), rel=1e-6)
        modes = model.normal_modes(conditions, MotorEnd.FREE if inertia > screw else MotorEnd.PRESCRIBED)
        assert modes.angle_at_motor[0] * modes.displacement_at_table[0] == pytest.approx(slow.real, rel=1e-6)


def first(p, motor_end=MotorEnd.CLAMPED):
    modes = TransmissionLineModel(p).natural_frequencies(HERE, motor_end)
    return next(mode.frequency for mode in modes if mode.frequency > 0.0)


@pytest.mark.parametrize("joint", ["bearing_stiffness", "far_bearing_stiffness", "nut_stiffness", "coupling_stiffness"])
def test_a_joint_that_stiffens_converges_from_below(joint):
    stiff = [first(shaft(**({joint: k} | UNDAMPED))) for k in (1e9, 1e11, 1e13, 1e15)]
    assert stiff == sorted(stiff)
    assert stiff[3] == pytest.approx(stiff[2], rel=1e-4)
    assert stiff[3] == pytest.approx(continuous_clamped(shaft(**({joint: 1e15} | UNDAMPED)), stiff[3]), rel=5e-6)


def continuous_clamped(p, near):
    """Return the natural frequency of the continuous drive with the rotor held, by an enormous inertia."""
    held = {name: getattr(p, name) for name in type(p).__dataclass_fields__} | {"motor_inertia": 1e12}
    return continuous_frequency(type(p)(**held), HERE.position, near)


def test_a_bracket_that_is_not_stated_is_rigid():
    assert first(shaft(bracket_stiffness=1e17)) == pytest.approx(first(shaft()), rel=1e-8)


def test_a_screw_without_mass_or_compliance_leaves_the_joints_in_series():
    p = shaft(
        youngs_modulus=204.8e15, shear_modulus=80e15, density=1e-3, far_bearing_stiffness=0.0, bracket_stiffness=9e8,
        **UNDAMPED,
    )  # fmt: skip
    compliance = 1 / 5e8 + 1 / 6e8 + 1 / 9e8 + p.transmission_ratio**2 / 2e4
    assert first(p) == pytest.approx(math.sqrt(1 / (compliance * 300.0)) / (2 * math.pi), rel=1e-5)


# --- conditions and refusals ---------------------------------------------------------------------------------------


def test_payload_counts_as_table():
    heavy = TransmissionLineModel(shaft(table_mass=340.0)).natural_frequencies(HERE)
    assert TransmissionLineModel(shaft()).natural_frequencies(DriveConditions(0.6, payload_mass=40.0)) == heavy


def test_quantities_are_named():
    named = respond(
        TransmissionLineModel(shaft()), 100.0, ExcitationPoint.TORQUE_AT_SCREW, ResponsePoint.ACCELERATION_AT_TABLE
    )
    assert named.quantity == "torque_accelerance"


def test_what_lies_outside_is_refused():
    p = shaft()
    model = TransmissionLineModel(p)
    with pytest.raises(OutsideValidityError, match="position must lie on the screw"):
        model.natural_frequencies(DriveConditions(1.4))
    with pytest.raises(OutsideValidityError, match="one section from the ends"):
        model.natural_frequencies(DriveConditions(0.005))
    with pytest.raises(OutsideValidityError, match="half the sampling rate"):
        respond(model, 2e5, ExcitationPoint.FORCE_AT_TABLE, ResponsePoint.ACCELERATION_AT_TABLE)
    with pytest.raises(OutsideValidityError, match="takes no torque"):
        simulate_drive(p, model.grid, HERE, np.ones(10), motor_end=MotorEnd.CLAMPED)
    with pytest.raises(OutsideValidityError, match="length of the torque"):
        simulate_drive(p, model.grid, HERE, np.ones(10), position=np.full(9, 0.6))
    with pytest.raises(OutsideValidityError, match="torque must be finite"):
        simulate_drive(p, model.grid, HERE, np.array([0.0, np.nan]))
    with pytest.raises(OutsideValidityError, match="at least one section"):
        simulate_drive(p, model.grid, HERE, np.zeros(2), position=np.array([0.6, 1.345]))
    with pytest.raises(OutsideValidityError, match="damped so strongly"):
        TransmissionLineModel(shaft(table_damping=1e6, motor_damping=1e4)).natural_frequencies(HERE)
