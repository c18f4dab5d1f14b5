"""Natural frequencies and modes of the extended drive: against the families, against responses, against Table 2."""

import csv
import itertools
from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize

from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended import ExtendedModel, natural_frequencies, physics_of
from monitor_core.models.extended.closed_form import characteristic, entire_parts
from monitor_core.models.extended.conditions import axis_states, condition_arrays, end_masks
from monitor_core.models.extended.modes import FollowedModes, drive_modes
from monitor_core.models.extended.settings import axis_at
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd
from tests.models.extended_axes import FAMILIES, add, bundled, case_of, conditions_of, response_of, undamped
from tests.models.finite_elements import Assembly, Axis

SHARES = (0.1, 0.3, 0.5, 0.8)
motor_ends = pytest.mark.parametrize("motor_end", list(MotorEnd))


def elastic(modes):
    return np.array([(mode.frequency, mode.damping_ratio) for mode in modes if mode.frequency > 0.0])


# --- against the families --------------------------------------------------------------------------------------------


@pytest.mark.release
@motor_ends
@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("family", ["lumped", "receptance"])
def test_poles_are_those_of_the_family(family, share, motor_end) -> None:
    model = bundled(family)
    conditions = conditions_of(model.parameters, share, payload_mass=2.0)
    ours = ExtendedModel.of(model.parameters).natural_frequencies(conditions, motor_end)
    theirs = model.natural_frequencies(conditions, motor_end)
    n = min(len(elastic(ours)), len(elastic(theirs)))
    assert n == (1 if family == "lumped" else len(elastic(ours)))  # Eq. (7) of the lumped model answers to nothing
    assert len(ours) - len(elastic(ours)) == len(theirs) - len(elastic(theirs))
    np.testing.assert_allclose(elastic(ours)[:n], elastic(theirs)[:n], rtol=1e-9)


def test_poles_of_any_axis_are_those_of_its_family() -> None:
    """Thirty axes far from each other: none missed and none twice, however close parts of them resonate."""
    rng, model = np.random.default_rng(3), bundled("receptance")
    varied = (
        "table_mass", "screw_lead", "motor_inertia", "bearing_stiffness", "far_bearing_stiffness", "nut_stiffness",
        "coupling_stiffness", "screw_nut_segment_mass", "screw_nut_segment_inertia", "screw_motor_segment_inertia",
    )  # fmt: skip
    dampers = dict.fromkeys(("bearing_damping", "far_bearing_damping", "nut_damping", "coupling_damping"), 0.0)
    for n in range(30):
        changes = {name: getattr(model.parameters, name) * 10.0 ** rng.uniform(-1.3, 1.3) for name in varied}
        parameters = replace(model.parameters, **changes, **dampers, bracket_stiffness=10.0 ** rng.uniform(7.0, 9.0))
        conditions, motor_end = conditions_of(parameters, rng.uniform(0.05, 0.95)), list(MotorEnd)[n % 3]
        theirs = elastic(type(model)(parameters).natural_frequencies(conditions, motor_end))[:, 0]
        ours = ExtendedModel(parameters, physics_of(parameters), theirs[-1] * (1.0 + 1e-7))
        np.testing.assert_allclose(elastic(ours.natural_frequencies(conditions, motor_end))[:, 0], theirs, rtol=1e-9)


@motor_ends
def test_first_poles_of_transmission_lines_to_their_discretisation(motor_end) -> None:
    model = bundled("transmission-line")
    for share in SHARES:
        conditions = conditions_of(model.parameters, share)
        ours = elastic(ExtendedModel.of(model.parameters).natural_frequencies(conditions, motor_end))[0]
        theirs = elastic(model.natural_frequencies(conditions, motor_end))[0]
        assert ours[0] == pytest.approx(theirs[0], rel=2e-6)
        assert ours[1] == pytest.approx(theirs[1], rel=1e-5)


#: How far the hybrid's elastic mode lies above that of its axis, at most: static shapes of the screw (Rayleigh).
HYBRID_TOO_HIGH = {MotorEnd.CLAMPED: 0.0016, MotorEnd.FREE: 0.0066, MotorEnd.PRESCRIBED: 0.034}


@motor_ends
def test_hybrid_is_too_high_by_its_reduction(motor_end) -> None:
    model = bundled("hybrid")
    for share in SHARES:
        conditions = conditions_of(model.parameters, share)
        ours = elastic(ExtendedModel.of(model.parameters).natural_frequencies(conditions, motor_end))[0, 0]
        theirs = elastic(model.natural_frequencies(conditions, motor_end))[0, 0]
        assert 0.0 < theirs / ours - 1.0 < HYBRID_TOO_HIGH[motor_end]


@motor_ends
@pytest.mark.parametrize("family", ["lumped", "receptance"])
def test_modes_are_those_of_the_family(family, motor_end) -> None:
    """Frequencies, and shapes up to the sign of a mode."""
    model = bundled(family)
    parameters = replace(model.parameters, loss_factor=0.0)  # with one, the families differ in what undamped means
    conditions = conditions_of(parameters)
    ours = ExtendedModel.of(parameters).normal_modes(conditions, motor_end)
    theirs = type(model)(parameters).normal_modes(conditions, motor_end)
    n = 1 if family == "lumped" and motor_end is MotorEnd.CLAMPED else min(len(ours.frequency), len(theirs.frequency))
    np.testing.assert_allclose(ours.frequency[:n], theirs.frequency[:n], rtol=1e-9)
    np.testing.assert_allclose(ours.damping_ratio[:n], theirs.damping_ratio[:n], rtol=1e-9)
    for name in ("angle_at_motor", "displacement_at_table"):
        np.testing.assert_allclose(np.abs(getattr(ours, name)[:n]), np.abs(getattr(theirs, name)[:n]), rtol=1e-6)
    relative = [(modes.angle_at_motor * modes.displacement_at_table)[:n] for modes in (ours, theirs)]
    assert np.all(relative[0] * relative[1] >= 0.0)


# --- against the responses -------------------------------------------------------------------------------------------

EXTRAS = {
    "nothing": {},
    "base": {"base_compliance": 3e-9, "base_frequency": 240.0},
    "base beside the screw": {"base_compliance": 1e-11, "base_frequency": 1035.5},
    "guides": {"guide_stiffness": 4e6},
    "servo": {"servo_stiffness": 40.0},
    "compliance": {"series_compliance": 2e-9},
    "nut": {"nut_mass": 1.3, "series_compliance": 4e-9},
    "hanging": {"table_absorber_mass": 0.8, "table_absorber_frequency": 170.0, "nut_absorber_mass": 0.2,
                "nut_absorber_frequency": 450.0, "series_compliance": 4e-9},
    "hanging behind a rigid bracket": {"table_absorber_mass": 0.8, "table_absorber_frequency": 170.0,
                                       "nut_absorber_mass": 0.2, "nut_absorber_frequency": 450.0},
    "all carried": {"nut_mass": 1.3, "table_absorber_mass": 0.8, "table_absorber_frequency": 170.0,
                    "nut_absorber_mass": 0.2, "nut_absorber_frequency": 450.0, "series_compliance": 4e-9,
                    "guide_stiffness": 4e6},
    "on the rotor": {"rotor_absorber_inertia": 2e-4, "rotor_absorber_frequency": 60.0},
    "at the end of the screw": {"screw_end_absorber_mass": 3.0, "screw_end_absorber_frequency": 400.0},
    "at every port": {"rotor_absorber_inertia": 2e-4, "rotor_absorber_frequency": 60.0, "screw_end_absorber_mass": 3.0,
                      "screw_end_absorber_frequency": 400.0, "base_compliance": 3e-9, "base_frequency": 240.0,
                      "table_absorber_mass": 0.8, "table_absorber_frequency": 170.0, "servo_stiffness": 40.0},
    "all": {"base_compliance": 3e-9, "base_frequency": 700.0, "guide_stiffness": 4e6, "servo_stiffness": 40.0,
            "series_compliance": 2e-9, "table_mass": 3.0},
}  # fmt: skip


@pytest.mark.release
@pytest.mark.parametrize("extra", EXTRAS)
def test_natural_frequencies_are_those_of_finite_elements(extra) -> None:
    """The matrices of Tian's axis, with springs and a base put in as parts; none missed and none twice."""
    parameters = bundled("receptance").parameters
    model = ExtendedModel(parameters, add(undamped(physics_of(parameters)), **EXTRAS[extra]), 1500.0)
    position = 0.37 * parameters.screw_length
    ours = elastic(model.natural_frequencies(DriveConditions(position), MotorEnd.FREE))[:, 0]
    theirs, _ = assembled(parameters, position, **EXTRAS[extra]).modes(12)
    theirs = theirs[theirs > 0.1]
    np.testing.assert_allclose(ours, theirs[theirs < 1500.0], rtol=3e-4)  # 2e-4 of it is the length of the elements


def assembled(
    p, position, *, base_compliance=0.0, base_frequency=1.0, guide_stiffness=0.0, servo_stiffness=0.0,
    series_compliance=0.0, table_mass=0.0, nut_mass=0.0, table_absorber_mass=0.0, table_absorber_frequency=1.0,
    table_absorber_damping_ratio=0.0, nut_absorber_mass=0.0, nut_absorber_frequency=1.0, nut_absorber_damping_ratio=0.0,
    rotor_absorber_inertia=0.0, rotor_absorber_frequency=1.0, rotor_absorber_damping_ratio=0.0,
    screw_end_absorber_mass=0.0, screw_end_absorber_frequency=1.0, screw_end_absorber_damping_ratio=0.0,
):  # fmt: skip
    """Return finite elements of the axis; the base, under both bearings, is the elements' point that nobody is at."""
    n_near, n_far = 90, 150
    axis = Axis(
        length=p.screw_length, diameter=p.screw_diameter, lead=p.screw_lead, youngs_modulus=p.youngs_modulus,
        shear_modulus=p.shear_modulus, density=p.density, table_mass=p.table_mass + table_mass - nut_mass,
        near_bearing=(0.0, 0.0), far_bearing=(0.0, 0.0), nut=(0.0, 0.0),
        coupling=(p.coupling_stiffness, 0.0), rotor_inertia=p.motor_inertia,
        nut_segment_mass=p.screw_nut_segment_mass, nut_segment_inertia=p.screw_nut_segment_inertia,
        motor_segment_inertia=p.screw_motor_segment_inertia,
    )  # fmt: skip
    parts = Assembly(axis, n_near, n_far, position)
    moved = {parts.table: 1.0, n_near: -1.0, parts.turn + n_near: -p.screw_lead / (2.0 * np.pi)}
    on_base = {}
    if base_compliance:
        base = parts.nut
        parts.spring({base: 1.0}, 1.0 / base_compliance, 0.0)
        parts.mass[base, base] += 1.0 / base_compliance / (2.0 * np.pi * base_frequency) ** 2
        on_base = {base: -1.0}
    parts.spring({0: 1.0} | on_base, p.bearing_stiffness, 0.0)
    parts.spring({n_near + n_far: 1.0} | on_base, p.far_bearing_stiffness, 0.0)
    nut = parts.table
    if (nut_mass or nut_absorber_mass) and series_compliance:
        nut = parts.body(nut_mass or 1e-6, parts.table, 1.0 / series_compliance, 0.0)
        parts.spring(moved | {parts.table: 0.0, nut: 1.0}, p.nut_stiffness, 0.0)
    else:
        parts.spring(moved, 1.0 / (1.0 / p.nut_stiffness + series_compliance), 0.0)
    for place, mass, frequency, ratio in (
        (parts.table, table_absorber_mass, table_absorber_frequency, table_absorber_damping_ratio),
        (nut, nut_absorber_mass, nut_absorber_frequency, nut_absorber_damping_ratio),
        (parts.rotor, rotor_absorber_inertia, rotor_absorber_frequency, rotor_absorber_damping_ratio),
        (n_near + n_far, screw_end_absorber_mass, screw_end_absorber_frequency, screw_end_absorber_damping_ratio),
    ):
        if mass:
            omega = 2.0 * np.pi * frequency
            parts.body(mass, place, mass * omega**2, 2.0 * ratio * mass * omega)
    parts.spring({parts.table: 1.0}, guide_stiffness, 0.0)
    parts.spring({parts.rotor: 1.0}, servo_stiffness, 0.0)
    return parts


def test_the_undamped_response_is_largest_at_the_natural_frequencies(subtests: pytest.Subtests) -> None:
    """Ten times as close to a pole, ten times the response."""
    for extra, family in itertools.product(EXTRAS, FAMILIES):
        with subtests.test(extra=extra, family=family):
            parameters = bundled(family).parameters
            physics = add(undamped(physics_of(parameters)), **EXTRAS[extra])
            conditions = conditions_of(parameters, 0.37)
            modes = ExtendedModel(parameters, physics, 1500.0).natural_frequencies(conditions, MotorEnd.FREE)
            held = any(name in EXTRAS[extra] for name in ("guide_stiffness", "servo_stiffness"))
            assert (modes[0].frequency == 0.0) == (not held)
            for mode in elastic(modes):
                case = case_of(
                    parameters, mode[0] * (1.0 + np.array([1e-10, 1e-9])), conditions, ExcitationPoint.FORCE_AT_TABLE
                )
                nearer, near = np.abs(response_of(physics, replace(case, motor_end=MotorEnd.FREE)))
                assert nearer == pytest.approx(10.0 * near, rel=0.01)


def test_a_nut_in_a_node_loses_no_mode() -> None:
    """Equal bearings, table in the middle: the screw's odd half waves move the nut, the even ones do not."""
    parameters = replace(bundled("receptance").parameters, screw_nut_segment_mass=0.0)
    same = undamped(physics_of(parameters), bearing_stiffness=4e7, far_bearing_stiffness=4e7)
    middle = 0.5 * parameters.screw_length
    at, beside = (
        elastic(ExtendedModel(parameters, same, 2500.0).natural_frequencies(DriveConditions(x), MotorEnd.CLAMPED))[:, 0]
        for x in (middle, middle + 1e-4)
    )
    assert len(at) == len(beside)
    np.testing.assert_allclose(at, beside, rtol=1e-4)


def test_modes_superpose_to_the_response() -> None:
    parameters = bundled("transmission-line").parameters
    physics = add(undamped(physics_of(parameters)), base_compliance=1e-9, base_frequency=300.0)
    conditions, frequency = conditions_of(parameters), np.array([40.0, 90.0, 200.0])
    modes = ExtendedModel(parameters, physics, 20_000.0).normal_modes(conditions, MotorEnd.FREE)
    case = case_of(parameters, frequency, conditions, ExcitationPoint.TORQUE_AT_MOTOR)
    shapes = modes.angle_at_motor * modes.displacement_at_table
    square = (2.0 * np.pi * modes.frequency) ** 2 - (2.0 * np.pi * frequency[:, None]) ** 2
    np.testing.assert_allclose(np.sum(shapes / square, axis=1), response_of(physics, case).real, rtol=1e-3)


# --- followed from one axis to another -------------------------------------------------------------------------------

BENDING = {"compliance": 2e-9, "frequency": 60.0}
JOINTS = ("bearing_stiffness", "far_bearing_stiffness", "nut_stiffness", "coupling_stiffness", "bracket_stiffness")


def drawn(rng, family, decades):
    """Return an axis with joints that are nothing, or rigid, or in between, and one thing or another beside them."""
    physics = undamped(physics_of(bundled(family).parameters))
    joints = {
        name: stiffness * 10.0 ** rng.uniform(-decades, decades)
        for name in JOINTS
        if np.isfinite(stiffness := getattr(physics.joints, name))
    }
    extra = EXTRAS[rng.choice(list(EXTRAS))]
    bending = replace(physics.bending, **BENDING) if rng.random() < 0.4 else physics.bending
    return replace(add(undamped(physics, **joints), **extra), bending=bending)


def softer_with_level(physics, setting):
    """Return the axis with a nut that follows the excitation."""
    nut = physics.joints.nut_stiffness * (1.0 - 0.3 * setting.excitation_level)
    return replace(physics, joints=replace(physics.joints, nut_stiffness=nut))


@pytest.mark.parametrize("decades", [0.3, 6.0])
@pytest.mark.parametrize("family", FAMILIES)
def test_modes_that_are_followed_are_those_that_are_sought(family, decades) -> None:
    """However far an axis is from the one before: each mode once, and a change of sign at each of them."""
    rng, followed = np.random.default_rng([FAMILIES.index(family), int(100 * decades)]), FollowedModes()
    parameters = bundled(family).parameters
    for number in range(5):
        conditions = [conditions_of(parameters, share, excitation_level=rng.random()) for share in rng.random(3)]
        ends, physics = list(MotorEnd), drawn(rng, family, decades)
        if number % 4 == 3:
            physics = replace(physics, by_setting=(softer_with_level,))
        modes, alone = (
            modes_of(physics, conditions, ends, 10.0 ** rng.uniform(2.2, 3.5) if number == 0 else 1500.0)
            for modes_of in (followed.of, drive_modes)
        )
        if number == 0:
            continue
        np.testing.assert_array_equal(modes.condition, alone.condition)
        np.testing.assert_allclose(modes.undamped_omega, alone.undamped_omega, rtol=1e-9)
        for here, omega in enumerate(modes.of_each(3)):
            axis = axis_at(physics, condition_arrays(conditions).setting(here)) if physics.by_setting else physics
            between = np.sqrt(np.r_[1e-5 * omega[:1], omega] * np.r_[omega, 2.0 * np.pi * 1500.0])
            states = axis_states(axis, condition_arrays([conditions[here]])).at(np.zeros(between.size, dtype=np.intp))
            masks = end_masks([ends[here]]).at(np.zeros(between.size, dtype=np.intp))
            sign = np.sign(np.real(characteristic(entire_parts(axis, between, states, masks))))
            np.testing.assert_array_equal(sign[1:], -sign[:-1])


def test_many_conditions_at_once_are_each_alone() -> None:
    parameters = bundled("receptance").parameters
    model = ExtendedModel.of(parameters)
    conditions = [DriveConditions(x, payload_mass=m) for x, m in ((0.3, 0.0), (1.2, 40.0), (2.2, 7.0))]
    together = natural_frequencies(model.physics, conditions, list(MotorEnd), model.highest_frequency)
    for setting, motor_end, modes in zip(conditions, MotorEnd, together, strict=True):
        np.testing.assert_allclose(elastic(modes), elastic(model.natural_frequencies(setting, motor_end)), rtol=1e-9)


@pytest.mark.parametrize("table_damping", [1e5, 1e6, 1e8])
def test_poles_are_followed_through_strong_damping(table_damping) -> None:
    """A damper that at last holds the table: each mode goes to its own of the modes of the axis so held."""
    model = bundled("receptance")
    parameters = replace(model.parameters, table_damping=table_damping)
    conditions = conditions_of(parameters)
    ours = ExtendedModel.of(parameters).natural_frequencies(conditions)
    theirs = type(model)(parameters).natural_frequencies(conditions)
    np.testing.assert_allclose(elastic(ours), elastic(theirs), rtol=1e-9)


def test_damped_beyond_oscillation_is_refused() -> None:
    parameters = replace(bundled("lumped").parameters, table_damping=1e8)
    with pytest.raises(OutsideValidityError, match=r"the mode near .* Hz is damped so strongly that it ceases"):
        ExtendedModel.of(parameters).natural_frequencies(conditions_of(parameters))
    with pytest.raises(OutsideValidityError, match="highest_frequency must be positive"):
        ExtendedModel(parameters, physics_of(parameters), 0.0).natural_frequencies(conditions_of(parameters))


# --- against Table 2 of Nguyen et al. (2018) -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def misfit(published_data):
    """Return the rms distance of an axis' first natural frequencies from the 18 measured ones. [Hz]."""
    with (published_data / "nguyen_table2.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    conditions = [DriveConditions(float(row["position_mm"]) * 1e-3, float(row["preload_n"])) for row in rows]
    measured = np.array([float(row["frequency_hz"]) for row in rows])

    def rms(physics):
        modes = natural_frequencies(physics, conditions, [MotorEnd.CLAMPED] * len(rows), 400.0)
        return float(np.sqrt(np.mean((np.array([of_setting[0].frequency for of_setting in modes]) - measured) ** 2)))

    return rms


PRINTED = undamped(physics_of(bundled("lumped").parameters), bracket_stiffness=2.1e7)


def test_misfit_as_printed(misfit) -> None:
    assert misfit(PRINTED) == pytest.approx(63.30, abs=0.02)


@pytest.mark.parametrize(
    ("change", "bounds", "value", "left"),
    [
        (lambda k: undamped(PRINTED, bracket_stiffness=k), (7.0, 10.0), 1.48e8, 7.27),
        (lambda k: add(PRINTED, guide_stiffness=k), (5.0, 9.0), 1.8e7, 6.02),
    ],
    ids=["bracket", "guides"],
)
def test_misfit_with_one_stiffness_fitted(misfit, change, bounds, value, left) -> None:
    """The best additional stiffness and what it leaves, as an independent calculation of the paper's data gave them."""
    found = scipy.optimize.minimize_scalar(lambda k: misfit(change(10.0**k)), bounds=bounds, method="bounded")
    assert 10.0**found.x == pytest.approx(value, rel=0.01)
    assert found.fun == pytest.approx(left, abs=0.01)


def test_misfit_with_bracket_and_far_bearing_fitted(misfit) -> None:
    found = scipy.optimize.minimize(
        lambda k: misfit(undamped(PRINTED, bracket_stiffness=10.0 ** k[0], far_bearing_stiffness=10.0 ** k[1])),
        [8.0, 7.0], method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-4},
    )  # fmt: skip
    assert 10.0 ** found.x[1] == pytest.approx(2.1e7, rel=0.02)
    assert found.fun == pytest.approx(3.70, abs=0.01)


@pytest.mark.parametrize(
    "added",
    [
        {"guide_friction": 3.0},
        {"cubic_nut_stiffness": 1e8},
        {"torque_delay": 1e-4},
        {"response_delay": 1e-4},
        {"angle_delay": 1e-4},
        {"mounting_inverse_square": 1e-8},
        {"second_mode_residue": 0.1, "second_mode_frequency": 400.0},
    ],
)
def test_what_no_mode_holds_is_not_left_out_of_modes_in_silence(added) -> None:
    model = ExtendedModel.of(bundled("hybrid").parameters)
    changed = replace(model, physics=add(model.physics, **added))
    with pytest.raises(OutsideValidityError, match=f"normal modes cannot include {next(iter(added))}"):
        changed.normal_modes(DriveConditions(0.3))
