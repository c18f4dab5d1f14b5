"""The extended drive: each family's own model where nothing is added, and what every added effect must obey."""

import itertools
import math
from dataclasses import fields, replace

import numpy as np
import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended import (
    AddedPhysics,
    BodyPhysics,
    JointPhysics,
    ScrewPhysics,
    physics_of,
    prepare_lines,
    responses,
)
from monitor_core.models.parameters import DriveParameters
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from tests.models.extended_axes import FAMILIES, TORQUES, add, bundled, case_of, conditions_of, response_of, undamped

BAND = np.geomspace(1.0, 2000.0, 300)
FORCE = ExcitationPoint.FORCE_AT_TABLE
TABLE, ACCELERATION, MOTOR = (
    ResponsePoint.DISPLACEMENT_AT_TABLE, ResponsePoint.ACCELERATION_AT_TABLE, ResponsePoint.ANGLE_AT_MOTOR
)  # fmt: skip
PAIRS = [(excitation, response) for excitation in ExcitationPoint for response in ResponsePoint]

#: Every effect at a size that shows, by what it needs to be seen; the other values belong to it.
EFFECTS = {
    "table_mass": {"table_mass": 1.0},
    "payload_error": {"payload_error": 1.0},
    "series_compliance": {"series_compliance": 1e-9},
    "nut_mass": {"nut_mass": 1.0},
    "table_absorber_mass": {
        "table_absorber_mass": 0.3, "table_absorber_frequency": 180.0, "table_absorber_damping_ratio": 0.05
    },
    "nut_absorber_mass": {
        "nut_absorber_mass": 0.3, "nut_absorber_frequency": 180.0, "nut_absorber_damping_ratio": 0.05
    },
    "rotor_absorber_inertia": {
        "rotor_absorber_inertia": 3e-5, "rotor_absorber_frequency": 180.0, "rotor_absorber_damping_ratio": 0.05
    },
    "screw_end_absorber_mass": {
        "screw_end_absorber_mass": 2.0, "screw_end_absorber_frequency": 180.0, "screw_end_absorber_damping_ratio": 0.05
    },
    "guide_stiffness": {"guide_stiffness": 1e6},
    "guide_friction": {"guide_friction": 1.0},
    "servo_stiffness": {"servo_stiffness": 1e-3},
    "base_compliance": {"base_compliance": 1e-9, "base_frequency": 90.0, "base_damping_ratio": 0.03},
    "preload_exponent_change": {"preload_exponent_change": 0.1},
    "thermal_preload": {"thermal_preload": 2.0},
    "thermal_stiffness": {"thermal_stiffness": -3e-4},
    "preload_change": {"preload_change": -40.0},
    "periodic_preload_cosine": {"periodic_preload_cosine": 0.1},
    "periodic_preload_sine": {"periodic_preload_sine": 0.1},
    "position_offset": {"position_offset": 0.01},
    "torque_delay": {"torque_delay": 1e-4},
    "response_delay": {"response_delay": 1e-4},
    "angle_delay": {"angle_delay": 1e-4},
    "response_ln_factor": {"response_ln_factor": -2.3},
    "torque_ln_factor": {"torque_ln_factor": 1.2},
    "mounting_inverse_square": {"mounting_inverse_square": 1e-8, "mounting_damping_ratio": 0.05},
    "cubic_nut_stiffness": {"cubic_nut_stiffness": 1e10},
    "second_mode_residue": {
        "second_mode_residue": 1e-3, "second_mode_frequency": 300.0, "second_mode_damping_ratio": 0.02
    },
}  # fmt: skip
#: An axis in which every effect acts: the nut follows the preload; payload, temperature and amplitude are stated.
LUMPED = bundled("lumped").parameters
EVERYTHING = DriveConditions(0.31, 200.0, payload_mass=3.0, temperature_deviation=12.0, excitation_level=0.5)


def everywhere(physics):
    """Return acceleration per torque at motor and screw, and angle per torque."""
    pairs = [(excitation, response) for excitation in TORQUES for response in (ACCELERATION, MOTOR)]
    return responses(physics, prepare_lines([case_of(LUMPED, BAND, EVERYTHING, *pair) for pair in pairs]))


# --- nothing added: the families -------------------------------------------------------------------------------------


def test_with_nothing_added_it_is_the_family(subtests: pytest.Subtests) -> None:
    for (excitation, response), family in itertools.product(PAIRS, ["lumped", "receptance"]):
        with subtests.test(excitation=excitation, response=response):
            model = bundled(family)
            if family == "lumped" and (excitation, response) == (FORCE, MOTOR):
                case = case_of(model.parameters, BAND, EVERYTHING, excitation, response)
                with pytest.raises(OutsideValidityError, match="clamped for this excitation"):
                    prepare_lines([case])
                return
            damped = replace(model.parameters, loss_factor=0.04, table_damping=90.0)
            if family == "receptance":
                damped = replace(damped, bracket_stiffness=3e8, motor_damping=0.01, nut_mass=2.0, coupling_inertia=1e-4)
            for share in (0.1, 0.45, 0.8):
                conditions = conditions_of(damped, share, payload_mass=4.0)
                theirs = type(model)(damped).frequency_response(
                    BAND, conditions, excitation=excitation, response=response
                )
                ours = response_of(physics_of(damped), case_of(damped, BAND, conditions, excitation, response))
                np.testing.assert_allclose(ours, theirs.response, rtol=1e-9)


def test_transmission_line_to_its_discretisation(subtests: pytest.Subtests) -> None:
    """Its stubs turn a frequency by (ωΔt)²/12; beside resonances and zeros 1 ppm of frequency is a few of response."""
    for excitation, response in PAIRS:
        with subtests.test(excitation=excitation, response=response):
            model = bundled("transmission-line")
            conditions, frequency = conditions_of(model.parameters), np.array([20.0, 60.0, 100.0])
            theirs = model.frequency_response(frequency, conditions, excitation=excitation, response=response)
            ours = response_of(
                physics_of(model.parameters), case_of(model.parameters, frequency, conditions, excitation, response)
            )
            np.testing.assert_allclose(ours, theirs.response, rtol=1e-5)


def test_hybrid_is_met_where_the_screw_deforms_as_if_at_rest(subtests: pytest.Subtests) -> None:
    """Without density the screw has no other shape; all else of the family must have been carried over."""
    for excitation, response in PAIRS:
        with subtests.test(excitation=excitation, response=response):
            model = bundled("hybrid")
            light = replace(
                model.parameters, density=1e-3, bracket_stiffness=2e8, table_damping=50.0, dynamic_load_rating=9e3
            )
            conditions, frequency = conditions_of(light, payload_mass=2.0), np.geomspace(1.0, 400.0, 60)
            theirs = type(model)(light).frequency_response(
                frequency, conditions, excitation=excitation, response=response
            )
            ours = response_of(physics_of(light), case_of(light, frequency, conditions, excitation, response))
            np.testing.assert_allclose(ours, theirs.response, rtol=2e-5)


@pytest.mark.parametrize("motor_end", [MotorEnd.FREE, MotorEnd.PRESCRIBED])
def test_mass_and_inertia_are_kept_however_they_are_spread(motor_end) -> None:
    """Slowly, the drive is one rigid body: i/(J + i² M)/(−ω²), the axially held screw's mass not in M."""
    excitation = TORQUES[motor_end is MotorEnd.FREE]
    physics = physics_of(LUMPED)
    i, total = physics.screw.transmission_ratio, LUMPED.screw_inertia
    for share in (0.0, 0.3, 1.0):
        screw = replace(physics.screw, axial_mass_share=share, torsional_inertia_share=share)
        (moved,) = response_of(replace(physics, screw=screw), case_of(LUMPED, [0.01], EVERYTHING, excitation))
        mass = LUMPED.table_mass + LUMPED.nut_mass + 3.0 + (1.0 - share) * LUMPED.screw_mass
        expected = -i / (total + i**2 * mass) / (0.02 * np.pi) ** 2
        assert moved.real == pytest.approx(expected, rel=1e-6)


def test_a_screw_rigid_in_torsion_turns_as_one() -> None:
    """With no torsional compliance it does not matter where along the screw its inertia sits."""
    physics = physics_of(LUMPED)
    rigid = replace(physics.screw, torsion_share=0.0, torsional_inertia_share=0.0)
    spread = replace(rigid, torsional_inertia_share=1.0)
    at = (LUMPED, BAND, EVERYTHING, ExcitationPoint.TORQUE_AT_SCREW)
    np.testing.assert_allclose(
        response_of(replace(physics, screw=rigid), case_of(*at)),
        response_of(replace(physics, screw=spread), case_of(*at)),
        rtol=1e-12,
    )


def test_an_unknown_family_is_refused() -> None:
    with pytest.raises(OutsideValidityError, match="starts from lumped, hybrid, receptance or transmission-line"):
        physics_of(DriveParameters())


# --- every effect ----------------------------------------------------------------------------------------------------


def test_every_effect_is_under_test() -> None:
    covered = {name for values in EFFECTS.values() for name in values}
    assert covered == {item.name for item in fields(AddedPhysics)}


def test_an_effect_is_absent_at_its_null_value_whatever_belongs_to_it(subtests: pytest.Subtests) -> None:
    for effect, case in EFFECTS.items():
        with subtests.test(effect=effect):
            null = AddedPhysics.__dataclass_fields__[effect].default
            absent = everywhere(add(physics_of(LUMPED), **case | {effect: null}))
            np.testing.assert_allclose(absent, everywhere(physics_of(LUMPED)), rtol=1e-12)


def test_an_effect_fades_into_its_null_value(subtests: pytest.Subtests) -> None:
    """No jump on the way: a millionth of a value that shows does (almost) nothing, and the value itself shows."""
    for effect, case in EFFECTS.items():
        with subtests.test(effect=effect):
            physics, size = physics_of(LUMPED), case[effect]
            plain = everywhere(physics)
            full, faint = (
                np.max(np.abs(everywhere(add(physics, **case | {effect: scale * size})) / plain - 1.0))
                for scale in (1.0, 1e-6)
            )
            assert full > 1e-4
            # the damping of a mounting grows with the square root of its inverse square
            assert faint < (1e-3 if effect == "mounting_inverse_square" else 1e-5) * max(full, 1.0)


def test_what_is_not_finite_is_refused(subtests: pytest.Subtests) -> None:
    for value, effect in itertools.product([math.nan, math.inf], EFFECTS):
        refused = pytest.raises(OutsideValidityError, match=f"{effect} must be finite")
        with subtests.test(value=value, effect=effect), refused:
            AddedPhysics(**{effect: value})


#: Effects of the channels are no part of the axis; two effects act on a preload that only one family's axis follows.
OF_THE_CHANNELS = {
    "torque_delay", "response_delay", "angle_delay", "response_ln_factor", "torque_ln_factor",
    "mounting_inverse_square",
}  # fmt: skip
OF_THE_AXIS = [name for name in EFFECTS if name not in OF_THE_CHANNELS]
ON_THE_PRELOAD = {"preload_exponent_change", "thermal_preload", "preload_change"}


def test_passivity_and_reciprocity_with_every_effect(subtests: pytest.Subtests) -> None:
    """Driving points take energy at every frequency; table per torque is angle per force (Maxwell, Betti)."""
    for family, effect in [
        (family, name)
        for family in FAMILIES
        for name in OF_THE_AXIS
        if family == "lumped" or name not in ON_THE_PRELOAD
    ]:
        with subtests.test(family=family, effect=effect):
            assert_passive_and_reciprocal(family, effect)


def assert_passive_and_reciprocal(family, effect) -> None:
    parameters, motor = bundled(family).parameters, ExcitationPoint.TORQUE_AT_MOTOR
    physics = add(physics_of(parameters), **EFFECTS[effect])

    def of_a_free_rotor(excitation, response, level=0.0):
        conditions = conditions_of(parameters, payload_mass=1.0, temperature_deviation=5.0, excitation_level=level)
        case = case_of(parameters, BAND, conditions, excitation, response)
        return response_of(physics, replace(case, motor_end=MotorEnd.FREE))

    for driving_point in (of_a_free_rotor(FORCE, TABLE, 2.0), of_a_free_rotor(motor, MOTOR, 2.0)):
        assert np.all(driving_point.imag <= 1e-9 * np.abs(driving_point))
    if effect != "second_mode_residue":  # stated for the table alone: no share of the angle
        np.testing.assert_allclose(of_a_free_rotor(motor, TABLE), of_a_free_rotor(FORCE, MOTOR), rtol=1e-9)


# --- closed forms ----------------------------------------------------------------------------------------------------

SLOW = [1e-3]  # [Hz]


def static_compliance(physics, conditions=EVERYTHING):
    (value,) = response_of(physics, case_of(LUMPED, SLOW, conditions, FORCE))
    return value.real


def test_series_compliance_and_base_add_to_the_static_compliance() -> None:
    physics = undamped(physics_of(LUMPED))
    plain = static_compliance(physics)
    assert static_compliance(add(physics, series_compliance=3e-9)) == pytest.approx(plain + 3e-9, rel=1e-9)
    with_base = add(physics, base_compliance=2e-9, base_frequency=40.0)
    assert static_compliance(with_base) == pytest.approx(plain + 2e-9, rel=1e-9)


def test_guide_stiffness_lies_beside_the_drive() -> None:
    physics = undamped(physics_of(LUMPED))
    expected = 1.0 / (1.0 / static_compliance(physics) + 5e6)
    assert static_compliance(add(physics, guide_stiffness=5e6)) == pytest.approx(expected, rel=1e-9)


def test_far_bearing_holds_the_rest_of_the_screw() -> None:
    """Two springs at the nut: x/ES with the bearing, (L − x)/ES with the far one."""
    physics = undamped(physics_of(LUMPED))
    x, length, rigidity = EVERYTHING.position, physics.screw.length, physics.screw.axial_rigidity
    near = x / rigidity + 1.0 / physics.joints.bearing_stiffness
    far = (length - x) / rigidity + 1.0 / 3e7
    expected = static_compliance(physics) - near + 1.0 / (1.0 / near + 1.0 / far)
    assert static_compliance(undamped(physics, far_bearing_stiffness=3e7)) == pytest.approx(expected, rel=1e-9)


def test_servo_is_felt_at_the_table_through_the_lead() -> None:
    """A free rotor held by k_s adds i²/k_s to the compliance of a clamped one."""
    parameters = bundled("hybrid").parameters
    physics = undamped(physics_of(parameters))
    conditions, i = conditions_of(parameters), physics.screw.transmission_ratio
    case = case_of(parameters, SLOW, conditions, FORCE, TABLE)
    (held,) = responses(add(physics, servo_stiffness=50.0), prepare_lines([case]))
    (clamped,) = responses(physics, prepare_lines([replace(case, motor_end=MotorEnd.CLAMPED)]))
    assert held.real == pytest.approx(clamped.real + i**2 / 50.0, rel=1e-7)


def test_base_moves_as_a_mass_on_its_spring() -> None:
    """A table on a spring on a sprung mass of 1/(c ω_b²): two degrees of freedom solved as such."""
    physics = undamped(physics_of(LUMPED))
    spring = 1.0 / static_compliance(physics)
    compliance, base_frequency, frequency = 4e-9, 150.0, np.array([50.0, 140.0, 210.0])
    mass = LUMPED.table_mass + LUMPED.nut_mass + LUMPED.screw_mass + 3.0
    base = 1.0 / compliance / (2.0 * np.pi * base_frequency) ** 2
    ours = response_of(
        add(physics, base_compliance=compliance, base_frequency=base_frequency),
        case_of(LUMPED, frequency, EVERYTHING, FORCE),
    )
    for f, value in zip(frequency, ours, strict=True):
        stiffness = np.array([[spring, -spring], [-spring, spring + 1.0 / compliance]])
        dynamic = stiffness - (2.0 * np.pi * f) ** 2 * np.diag([mass, base])
        assert value.real == pytest.approx(np.linalg.solve(dynamic, [1.0, 0.0])[0], rel=1e-7)


def test_a_wrong_payload_shows_only_where_one_is_stated() -> None:
    physics = physics_of(LUMPED)
    heavier = add(physics, payload_error=0.8)
    bare, loaded = (replace(EVERYTHING, payload_mass=mass) for mass in (0.0, 5.0))
    at = (LUMPED, BAND)
    np.testing.assert_array_equal(
        response_of(heavier, case_of(*at, bare, FORCE)), response_of(physics, case_of(*at, bare, FORCE))
    )
    expected = response_of(physics, case_of(*at, replace(EVERYTHING, payload_mass=5.8), FORCE))
    np.testing.assert_allclose(response_of(heavier, case_of(*at, loaded, FORCE)), expected, rtol=1e-12)


def nut_compliance(physics, conditions):
    """Return 1/k_nut from the difference to an axis whose nut is ten times as stiff."""
    stiff = undamped(physics, nut_stiffness=10.0 * physics.joints.nut_stiffness)
    return (static_compliance(physics, conditions) - static_compliance(stiff, conditions)) / 0.9


def test_nut_follows_exponent_temperature_and_lead() -> None:
    """Rigidity 0.8 K (P/(0.1 C_d))^(1/3 + δ), Eq. (1) of Nguyen et al. (2018), with P as the effects make it."""
    physics, x, lead = undamped(physics_of(LUMPED)), EVERYTHING.position, LUMPED.screw_lead
    for added, preload, exponent in (
        ({}, 200.0, 1.0 / 3.0),
        ({"preload_exponent_change": 0.2}, 200.0, 1.0 / 3.0 + 0.2),
        ({"thermal_preload": 3.0}, 236.0, 1.0 / 3.0),
        ({"periodic_preload_cosine": 0.2}, 200.0 * (1.0 + 0.2 * math.cos(2.0 * math.pi * x / lead)), 1.0 / 3.0),
        ({"periodic_preload_sine": 0.2}, 200.0 * (1.0 + 0.2 * math.sin(2.0 * math.pi * x / lead)), 1.0 / 3.0),
    ):
        expected = 0.8 * 470e6 * (preload / 400.0) ** exponent
        assert nut_compliance(add(physics, **added), EVERYTHING) == pytest.approx(1.0 / expected, rel=1e-7)


def test_offset_moves_the_table_and_delay_and_mounting_act_on_the_channels() -> None:
    physics = physics_of(LUMPED)
    at = (LUMPED, BAND)
    shifted = response_of(add(physics, position_offset=0.02), case_of(*at, EVERYTHING, FORCE))
    there = replace(EVERYTHING, position=EVERYTHING.position + 0.02)
    np.testing.assert_allclose(shifted, response_of(physics, case_of(*at, there, FORCE)), rtol=1e-12)
    torque = (*at, EVERYTHING, ExcitationPoint.TORQUE_AT_SCREW)
    plain = response_of(physics, case_of(*torque, ACCELERATION))
    late = response_of(add(physics, torque_delay=2e-4), case_of(*torque, ACCELERATION))
    np.testing.assert_allclose(np.angle(late / plain * np.exp(2j * np.pi * BAND * 2e-4)), 0.0, atol=1e-9)
    mounted = add(physics, mounting_inverse_square=(2.0 * np.pi * 3000.0) ** -2, mounting_damping_ratio=0.05)
    spring_and_damper = 3000.0**2 + 2j * 0.05 * 3000.0 * BAND
    transmitted = spring_and_damper / (spring_and_damper - BAND**2)
    np.testing.assert_allclose(response_of(mounted, case_of(*torque, ACCELERATION)) / plain, transmitted, rtol=1e-12)
    np.testing.assert_array_equal(
        response_of(mounted, case_of(*torque, MOTOR)), response_of(physics, case_of(*torque, MOTOR))
    )


def test_second_mode_is_one_modal_term() -> None:
    physics, frequency = physics_of(LUMPED), np.array([300.0])
    second = add(physics, second_mode_residue=0.02, second_mode_frequency=300.0, second_mode_damping_ratio=0.03)
    at_resonance = 0.02 / (2j * 0.03 * (600.0 * np.pi) ** 2)
    for excitation, lever in ((FORCE, 1.0), (ExcitationPoint.TORQUE_AT_SCREW, physics.screw.transmission_ratio)):
        at = (LUMPED, frequency, EVERYTHING, excitation)
        np.testing.assert_allclose(
            response_of(second, case_of(*at)) - response_of(physics, case_of(*at)), at_resonance / lever, rtol=1e-9
        )


# --- many at once, and refusals --------------------------------------------------------------------------------------


def test_many_cases_at_once_are_each_alone() -> None:
    """Motor ends, points, positions, payloads and levels mixed; what is flat must not leak from case to case."""
    parameters = bundled("receptance").parameters
    physics = add(physics_of(parameters), guide_friction=5.0, torque_delay=1e-4, mounting_inverse_square=1e-8)
    levels = (*(0.0, 2.0, 2.0, 2.0) * 2, 0.0, 20.0, 20.0, 20.0)  # [N·m] and [N]
    cases = [
        case_of(
            parameters, np.linspace(5.0 + n, 300.0, 20 + n),
            DriveConditions(0.15 * (n + 1), payload_mass=float(n), excitation_level=level), excitation, response,
        )
        for n, ((excitation, response), level) in enumerate(zip(PAIRS, levels, strict=True))
    ]  # fmt: skip
    together = responses(physics, prepare_lines(cases))
    alone = [responses(physics, prepare_lines([case])) for case in cases]
    np.testing.assert_allclose(together, np.concatenate(alone), rtol=1e-7)


@pytest.mark.parametrize(
    ("added", "conditions", "message"),
    [
        ({"position_offset": 0.7}, EVERYTHING, r"position must lie on the screw, within 0 and 0\.971 m; got 1\.01 m"),
        ({"table_mass": -30.0}, EVERYTHING, r"moving mass must be positive; got -3\.136 kg"),
        ({"thermal_preload": -20.0}, EVERYTHING, r"preload must stay positive at every temperature; got -40 N"),
        ({"periodic_preload_cosine": 1.5}, replace(EVERYTHING, position=0.303), "stay positive over the lead"),
        ({}, replace(EVERYTHING, preload=None), "state the preload"),
        ({}, replace(EVERYTHING, preload=500.0), "must not exceed 10 % of the dynamic load rating, 400 N; got 500 N"),
    ],
)
def test_physics_that_does_not_go_with_the_conditions_is_refused(added, conditions, message) -> None:
    with pytest.raises(OutsideValidityError, match=message):
        response_of(add(physics_of(LUMPED), **added), case_of(LUMPED, BAND, conditions, FORCE))


def test_preload_and_rating_go_together() -> None:
    parameters = bundled("receptance").parameters
    at = (parameters, BAND)
    with pytest.raises(OutsideValidityError, match="without dynamic_load_rating"):
        response_of(physics_of(parameters), case_of(*at, DriveConditions(0.5, 100.0), FORCE))
    for effect in ("preload_exponent_change", "thermal_preload"):
        with pytest.raises(OutsideValidityError, match="state dynamic_load_rating and preload"):
            response_of(add(physics_of(parameters), **{effect: 0.1}), case_of(*at, DriveConditions(0.5), FORCE))


def test_lines_that_make_no_sense_are_refused() -> None:
    case = case_of(LUMPED, BAND, EVERYTHING, FORCE, TABLE)
    with pytest.raises(OutsideValidityError, match="at least one case"):
        prepare_lines([])
    with pytest.raises(OutsideValidityError, match="must rise"):
        prepare_lines([replace(case, frequency=BAND[::-1])])
    with pytest.raises(OutsideValidityError, match="a torque-at-screw needs a prescribed motor end; got clamped"):
        prepare_lines([replace(case, excitation=ExcitationPoint.TORQUE_AT_SCREW)])


@pytest.mark.parametrize(
    ("record", "values", "message"),
    [
        (ScrewPhysics, {"axial_mass_share": 1.2}, r"axial_mass_share must lie within 0 and 1; got 1\.2"),
        (ScrewPhysics, {"torsion_share": -0.1}, r"torsion_share must be finite and not negative; got -0\.1"),
        (JointPhysics, {"bracket_stiffness": 0.0}, r"bracket_stiffness must be positive; got 0\.0 N/m"),
        (JointPhysics, {"dynamic_load_rating": -1.0}, "dynamic_load_rating must be positive and finite"),
        (BodyPhysics, {"table_mass": 0.0}, "table_mass must be positive and finite"),
        (AddedPhysics, {"second_mode_residue": 1.0}, "second_mode_frequency must be positive"),
        (AddedPhysics, {"base_frequency": 0.0}, r"base_frequency must be positive; got 0\.0 Hz"),
    ],
)
def test_impossible_values_are_refused(record, values, message) -> None:
    physics = physics_of(LUMPED)
    good = {ScrewPhysics: physics.screw, JointPhysics: physics.joints, BodyPhysics: physics.bodies}.get(
        record, physics.added
    )
    with pytest.raises(OutsideValidityError, match=message):
        replace(good, **values)
