"""The time stepping: rings against the plain loop, energy, dry friction, and a nut that moves."""

from dataclasses import replace

import numpy as np
import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.transmission_line import (
    DriveFriction,
    SpeedControl,
    StribeckFriction,
    TransmissionLineModel,
    common_step_grid,
    simulate_drive,
    synchronised_grid,
)
from monitor_core.models.published.transmission_line.junctions import TableState
from monitor_core.models.published.transmission_line.kernel import (
    LineState,
    advance,
    compiled_stepper,
    compiler_installed,
)
from tests.models.line_reference import (
    HEAVY,
    UNDAMPED,
    as_arrays,
    drive_on,
    empty_outputs,
    empty_rings,
    inputs_of,
    plain_loop,
    pole_of_matrix,
    series_compliance,
    shaft,
    step_matrix,
    stored_energy,
)

needs_compiler = pytest.mark.skipif(not compiler_installed(), reason="numba is not installed (extra `compiled`)")
STRIBECK = DriveFriction(guides=StribeckFriction(coulomb=20.0, static=30.0, stribeck_velocity=1e-3))
TURNING = StribeckFriction(coulomb=0.1, static=0.2, stribeck_velocity=0.1)
EVERYWHERE = replace(STRIBECK, nut=TURNING, bearing=TURNING, far_bearing=TURNING)


def moving_run(grid, n, motor_end=MotorEnd.FREE):
    """Torque, force and commanded speed of noise on a nut that travels over many nodes."""
    rng = np.random.default_rng(3)
    parameters = shaft(bracket_stiffness=9e8)
    control = SpeedControl(0.5, 0.02, 1e-4, 1e-4) if motor_end is MotorEnd.FREE else None
    drive, *_ = drive_on(grid, parameters, motor_end=motor_end, friction=EVERYWHERE, control=control)
    share = (0.4 + 0.2 * np.arange(n) / n) / parameters.screw_length
    places = share * grid.axial_sections, share * grid.torsional_sections
    return drive, inputs_of(
        5.0 * rng.standard_normal(n), *places, 100.0 * rng.standard_normal(n), rng.standard_normal(n)
    )


GRIDS = {"common step": common_step_grid(shaft(), 40), "synchronised": synchronised_grid(shaft(), 1e-5)}


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
@pytest.mark.parametrize("motor_end", [MotorEnd.FREE, MotorEnd.PRESCRIBED])
def test_rings_equal_the_plain_loop_bitwise(grid, motor_end):
    n = 1500
    drive, inputs = moving_run(grid, n, motor_end)
    outputs = empty_outputs(n)
    advance(drive, LineState(), empty_rings(drive), inputs, outputs)
    reference, _ = plain_loop(drive, inputs)
    for ring, loop in zip(outputs, reference, strict=True):
        assert np.any(ring)
        np.testing.assert_array_equal(ring, loop)


@pytest.mark.release
@needs_compiler
@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS.keys())
def test_compiled_steps_equal_python_s_bitwise(grid):
    n = 4000
    drive, inputs = moving_run(grid, n)
    outputs, compiled = empty_outputs(n), as_arrays(empty_outputs(n))
    advance(drive, LineState(), empty_rings(drive), inputs, outputs)
    compiled_stepper()(drive, LineState(), as_arrays(empty_rings(drive)), as_arrays(inputs), compiled)
    for python, machine in zip(outputs, compiled, strict=True):
        assert np.any(machine)
        np.testing.assert_array_equal(machine, python)


# --- energy --------------------------------------------------------------------------------------------------------

STRUCK = LineState(table=TableState(velocity=0.1))


@pytest.mark.release
@needs_compiler
@pytest.mark.parametrize("sections", [40, 424])  # steps of 10.5 and 1 µs
def test_energy_is_conserved_to_1e_10_over_a_million_steps_of_the_common_step(sections):
    parameters = shaft(bracket_stiffness=9e8, **UNDAMPED)
    drive, *places = drive_on(common_step_grid(parameters, sections), parameters, position=0.613)
    compliance = series_compliance(drive, *places)
    step, rings, state = compiled_stepper(), as_arrays(empty_rings(drive)), STRUCK
    n = 100_000
    inputs, outputs = as_arrays(inputs_of(np.zeros(n), *places)), as_arrays(empty_outputs(n))
    energy = [stored_energy(drive, parameters, rings, state, compliance)]
    for _ in range(10):
        state = step(drive, state, rings, inputs, outputs)
        energy.append(stored_energy(drive, parameters, rings, state, compliance))
    assert energy[0] == pytest.approx(0.5 * 300.0 * 0.1**2, rel=1e-12)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-10)


def energy_after_each_step(drive, parameters, places, n, state=STRUCK):
    step, rings = advance, empty_rings(drive)
    compliance = series_compliance(drive, *places)
    inputs, outputs = inputs_of([0.0], *places), empty_outputs(1)
    energy = [stored_energy(drive, parameters, rings, state, compliance)]
    for _ in range(n):
        state = step(drive, state, rings, inputs, outputs)
        energy.append(stored_energy(drive, parameters, rings, state, compliance))
    return np.array(energy)


def test_energy_is_conserved_step_by_step_with_the_common_step():
    parameters = shaft(bracket_stiffness=9e8, **UNDAMPED)
    drive, *places = drive_on(common_step_grid(parameters, 40), parameters, position=0.613)
    energy = energy_after_each_step(drive, parameters, places, 2000)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-12)


def test_the_paper_s_hold_loses_a_little_and_never_gains():
    parameters = shaft(bracket_stiffness=9e8, **UNDAMPED)
    drive, *places = drive_on(synchronised_grid(parameters, 1e-5), parameters, position=0.613)
    energy = energy_after_each_step(drive, parameters, places, 2000)
    assert np.max(np.diff(energy)) <= 1e-14 * energy[0]
    assert 1e-9 < 1.0 - energy[-1] / energy[0] < 1e-3


@pytest.mark.release
@needs_compiler
def test_the_paper_s_hold_at_1_microsecond_loses_less_than_a_millionth_in_200_000_steps():
    parameters = shaft(bracket_stiffness=9e8, **UNDAMPED)
    drive, *places = drive_on(synchronised_grid(parameters, 1e-6), parameters, position=0.613)
    compliance = series_compliance(drive, *places)
    step, rings, state = compiled_stepper(), as_arrays(empty_rings(drive)), STRUCK
    inputs, outputs = as_arrays(inputs_of(np.zeros(20_000), *places)), as_arrays(empty_outputs(20_000))
    energy = [stored_energy(drive, parameters, rings, state, compliance)]
    for _ in range(10):
        state = step(drive, state, rings, inputs, outputs)
        energy.append(stored_energy(drive, parameters, rings, state, compliance))
    assert np.all(np.diff(energy) < 0.0)
    assert 1.0 - energy[-1] / energy[0] < 1e-6


@pytest.mark.parametrize("nut", [StribeckFriction(0.0, 0.0), TURNING], ids=["none at the nut", "everywhere"])
def test_energy_never_grows_with_friction(nut):
    parameters, friction = shaft(bracket_stiffness=9e8, **UNDAMPED), replace(EVERYWHERE, nut=nut)
    drive, *places = drive_on(common_step_grid(parameters, 40), parameters, position=0.613, friction=friction)
    energy = energy_after_each_step(drive, parameters, places, 4000, LineState(table=TableState(velocity=2e-3)))
    # a nut that rubs knows its load from the last step: what it gives back by that is nothing beside what it takes
    gained = np.sum(np.maximum(np.diff(energy), 0.0))
    assert gained <= (1e-4 if nut.static else 1e-10) * (energy[0] - energy[-1])
    assert energy[-1] < 0.9 * energy[0]


# --- dry friction --------------------------------------------------------------------------------------------------


def test_a_sliding_table_stops_after_the_distance_that_coulomb_friction_allows():
    # A nut of 1 mN/m holds nothing: s = v²/(2 F/m), t = v m/F, and then the table stays where it is.
    parameters = shaft(nut_stiffness=1e-3, **UNDAMPED)
    friction = DriveFriction(StribeckFriction(50.0, 50.0))
    drive, *places = drive_on(common_step_grid(parameters, 20), parameters, friction=friction)
    v, deceleration = 5e-3, 50.0 / 300.0
    n = round(1.5 * v / deceleration / (2 * drive.table.half_step))
    outputs = empty_outputs(n)
    advance(
        drive,
        LineState(table=TableState(velocity=v, force=-50.0)),
        empty_rings(drive),
        inputs_of(np.zeros(n), *places),
        outputs,
    )
    stopped = v**2 / (2 * deceleration)
    assert outputs.displacement[-1] == pytest.approx(stopped, rel=1e-3)
    assert outputs.displacement[-1] == outputs.displacement[-500]
    assert outputs.acceleration[-1] == 0.0
    assert outputs.acceleration[n // 3] == pytest.approx(-deceleration, rel=1e-3)


@pytest.mark.parametrize(("push", "moves"), [(29.0, False), (31.0, True)])
def test_a_table_sticks_up_to_the_static_force(push, moves):
    parameters, n = shaft(), 3000
    motion = simulate_drive(
        parameters, common_step_grid(parameters, 40), DriveConditions(0.6), np.zeros(n),
        motor_end=MotorEnd.CLAMPED, force_at_table=np.full(n, push), friction=STRIBECK,
    )  # fmt: skip
    assert bool(np.any(motion.displacement_at_table)) is moves
    assert bool(np.any(motion.acceleration_at_table)) is moves


def test_friction_fades_from_the_static_to_the_coulomb_force():
    # A table that nothing holds slows down by F(v)/m, F = 20 N + 10 N/(1 + (v/1 mm/s)²): 25 N at 1 mm/s.
    parameters = shaft(nut_stiffness=1e-3, **UNDAMPED)
    grid = common_step_grid(parameters, 20)
    drive, *places = drive_on(grid, parameters, friction=STRIBECK)
    n = round(0.08 / grid.time_step)
    outputs = empty_outputs(n)
    start = LineState(table=TableState(velocity=5e-3, force=-20.0))
    advance(drive, start, empty_rings(drive), inputs_of(np.zeros(n), *places), outputs)
    velocity = np.gradient(np.array(outputs.displacement), grid.time_step)
    sliding = velocity > 1e-5
    assert np.min(velocity[sliding]) < 2e-5
    force = -300.0 * np.array(outputs.acceleration)
    np.testing.assert_allclose(
        force[sliding][2:-2], (20.0 + 10.0 / (1.0 + (velocity / 1e-3) ** 2))[sliding][2:-2], rtol=1e-3
    )


def test_friction_that_cannot_be_is_refused():
    with pytest.raises(OutsideValidityError, match="exceed the static one"):
        StribeckFriction(30.0, 20.0, 1e-3)
    with pytest.raises(OutsideValidityError, match="stribeck_velocity must be positive"):
        StribeckFriction(20.0, 30.0)


# --- a nut that moves ----------------------------------------------------------------------------------------------


def noise_of_travel(sections, rounded):
    """RMS and peak acceleration of a table pressed with 30 N on a nut that travels at 0.1 m/s, motor clamped."""
    parameters = shaft(table_damping=1e5)
    grid = common_step_grid(parameters, sections)
    drive, *_ = drive_on(grid, parameters, motor_end=MotorEnd.CLAMPED)
    n, settle = round(1.0 / grid.time_step), round(0.4 / grid.time_step)
    time = np.arange(n) * grid.time_step
    force = 15.0 * (1.0 - np.cos(np.pi * np.minimum(time / 0.1, 1.0)))
    share = (0.5 + 0.1 * time) / parameters.screw_length
    places = share * grid.axial_sections, share * grid.torsional_sections
    if rounded:
        places = tuple(np.round(place) for place in places)
    inputs, outputs = inputs_of(np.zeros(n), *places, force=force), empty_outputs(n)
    if compiler_installed():
        inputs, outputs, rings, step = (
            as_arrays(inputs),
            as_arrays(outputs),
            as_arrays(empty_rings(drive)),
            compiled_stepper(),
        )
    else:
        rings, step = empty_rings(drive), advance
    step(drive, LineState(), rings, inputs, outputs)
    acceleration = np.array(outputs.acceleration)[settle:]
    return np.sqrt(np.mean(acceleration**2)), np.max(np.abs(acceleration))


def test_a_split_junction_is_more_than_fifty_times_quieter_than_one_that_jumps():
    jump, split = noise_of_travel(40, rounded=True), noise_of_travel(40, rounded=False)
    assert jump[0] > 50.0 * split[0]
    assert jump[1] > 50.0 * split[1]


def test_the_compliance_of_the_split_junction_removes_its_stiffening():
    # The nut halfway between two nodes of both lines, against a nut on nodes of a grid twice as fine.
    parameters = shaft(**UNDAMPED)
    grid = common_step_grid(parameters, 40)
    position = 20.5 / 40 * parameters.screw_length
    drive, axial_place, torsional_place = drive_on(grid, parameters, position=position)
    assert torsional_place % 1.0 == pytest.approx(0.5)
    fine, *fine_places = drive_on(common_step_grid(parameters, 80), parameters, position=position)
    exact = pole_of_matrix(step_matrix(fine, *fine_places), 0.5 * grid.time_step, 133.5).imag

    def pole(drive):
        return pole_of_matrix(step_matrix(drive, axial_place, torsional_place), grid.time_step, 133.5).imag

    stiff = drive._replace(axial_cell_compliance=0.0, torsional_cell_compliance=0.0)
    assert pole(drive) == pytest.approx(exact, rel=5e-6)
    assert pole(stiff) > exact * (1.0 + 500e-6)


@pytest.mark.parametrize("position", [0.2, 0.6, 0.6437])
def test_static_limit_with_a_clamped_motor_is_the_sum_of_the_compliances(position):
    p = shaft(bracket_stiffness=9e8, **(HEAVY | {"table_damping": 1e6}))
    model = TransmissionLineModel(p, least_torsional_sections=20)
    n = round(0.2 / model.grid.time_step)
    run = simulate_drive(
        p, model.grid, DriveConditions(position), np.zeros(n), motor_end=MotorEnd.CLAMPED,
        force_at_table=np.full(n, 100.0),
    )  # fmt: skip
    ea, gj, rest = p.axial_rigidity, p.torsional_rigidity, p.screw_length - position
    screw = 1.0 / (1.0 / (1.0 / 5e8 + position / ea) + 1.0 / (1.0 / 2e8 + rest / ea))
    torsion = p.transmission_ratio**2 * (1.0 / 2e4 + position / gj)
    compliance = screw + torsion + 1.0 / 6e8 + 1.0 / 9e8
    assert run.displacement_at_table[-1] == pytest.approx(100.0 * compliance, rel=1e-9)


def test_nut_rigidity_follows_the_preload_by_its_cube_root():
    model = TransmissionLineModel(shaft(dynamic_load_rating=60e3, nut_stiffness=6e8))
    stated = shaft(nut_stiffness=0.8 * 6e8 * (750.0 / 6000.0) ** (1 / 3))
    with_preload = model.natural_frequencies(DriveConditions(0.6, preload=750.0))
    assert with_preload == TransmissionLineModel(stated).natural_frequencies(DriveConditions(0.6))
    run = [
        simulate_drive(p, model.grid, conditions, np.ones(50)).acceleration_at_table
        for p, conditions in ((model.parameters, DriveConditions(0.6, preload=750.0)), (stated, DriveConditions(0.6)))
    ]
    np.testing.assert_array_equal(*run)
