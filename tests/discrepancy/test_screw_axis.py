"""What is no ball screw axis is said to be none, without a preload; an axis that has a screw never is."""

import math
from dataclasses import replace

import numpy as np
import pytest

from monitor_core.discrepancy import Objection, Outcome, explain, require_explainable
from monitor_core.discrepancy.screw_axis import against_screw
from monitor_core.fitting.axis import AxisDescription, DescribedDrive
from monitor_core.fitting.observations import FrequencyResponseObservation, ModalObservation
from monitor_core.models.extended import ExtendedModel, physics_of
from monitor_core.models.families import build_model
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from monitor_core.recordings.model_file import parse_model
from service.documents.explanation import explanation_document
from service.report.verdict import headline, meaning
from tests.hidden_effects.cases import baseline_text, draw_case
from tests.hidden_effects.designs import DESIGNS
from tests.hidden_effects.frf_file import observations
from tests.hidden_effects.machines import CENTRE, MACHINES, jittered
from tests.hidden_effects.situations import Situation

TABLE, MOTOR = ResponsePoint.ACCELERATION_AT_TABLE, ResponsePoint.ANGLE_AT_MOTOR
TORQUE, FORCE = ExcitationPoint.TORQUE_AT_MOTOR, ExcitationPoint.FORCE_AT_TABLE
FREQUENCY = np.geomspace(15.0, 900.0, 110)
PLACES = sorted({setting.position for setting in DESIGNS["rich"](CENTRE, np.random.default_rng(1))})
LENGTH, MASS, INERTIA = CENTRE.parts.screw_length, CENTRE.moving_mass, CENTRE.parts.motor_inertia


def described(machine=CENTRE):
    file = parse_model(baseline_text(machine.parts, "receptance"), machine.name)
    return DescribedDrive(build_model(file.family, file.parameters).parameters, dict(file.uncertain), {})


def measured(stiffness_at, ratio, *, noise=0.003, held=0.0, frequency=FREQUENCY, excitation=TORQUE):
    """Return responses of two bodies, motor and table, coupled by a spring and a loss of 3 %; no preload is stated.

    ``stiffness_at`` a position couples them [N/m]; ``ratio`` is travel over angle of the motor [m/rad], and ``held`` a
    spring from the motor to ground [N/m].
    """
    rng, omega, found = np.random.default_rng(4), 2.0 * np.pi * frequency, []
    for place in PLACES:
        spring = stiffness_at(place) * (1.0 + 0.03j)
        motor = spring + held * (1.0 + 0.03j) - omega**2 * INERTIA / ratio**2
        table = spring - omega**2 * MASS
        determinant = motor * table - spring**2
        both = {TABLE: -(omega**2) * spring / determinant / ratio, MOTOR: table / determinant / ratio**2}
        if excitation is FORCE:
            both = {TABLE: -(omega**2) * motor / determinant, MOTOR: spring / determinant / ratio}
        for point, clean in both.items():
            scatter = rng.standard_normal(omega.size) + 1j * rng.standard_normal(omega.size)
            deviation = noise * np.abs(clean)
            found.append(
                FrequencyResponseObservation(
                    DriveConditions(place), frequency, clean + deviation * scatter, deviation, excitation, point,
                )
            )  # fmt: skip
    return found


def asked(found, drive=None):
    drive = drive or described()
    return against_screw(drive.physics({}), drive.uncertain, found)


LEAD_PER_ANGLE = CENTRE.parts.screw_lead / (2.0 * math.pi)
STIFFNESS = MASS * (2.0 * math.pi * 145.0) ** 2


def belt(place):
    """Both strands of a belt of 2.2 m between pulleys, 4 MN of tension stiffness."""
    return 4e6 * (1.0 / (place + 0.1) + 1.0 / (2.2 * 2.0 - place))


@pytest.mark.parametrize(
    ("found", "objection"),
    [
        (measured(lambda _: STIFFNESS, 0.02), Objection.TRAVEL),  # a rack on a pinion of 40 mm
        (measured(belt, 0.025), Objection.TRAVEL),
        (measured(belt, 0.025, excitation=FORCE), Objection.TRAVEL),
        (measured(lambda _: STIFFNESS, LEAD_PER_ANGLE), Objection.STANDS),  # a linear motor, told by turns of a lead
        (measured(lambda x: STIFFNESS * (0.8 + 0.4 * x / LENGTH), LEAD_PER_ANGLE), Objection.OTHER_WAY),
        (measured(lambda x: STIFFNESS * math.exp(-2.5 * x / LENGTH), LEAD_PER_ANGLE), Objection.OTHERWISE),
    ],
)
def test_what_is_no_screw_is_told_by_what_speaks_against_one(found, objection) -> None:
    assert asked(found).objection is objection
    without_motor = [each for each in found if each.response_point is TABLE]
    assert objection is Objection.TRAVEL or asked(without_motor).objection is objection


def test_a_table_of_one_mode_is_enough_and_one_of_several_says_nothing() -> None:
    table = [ModalObservation(DriveConditions(place), 145.0) for place in PLACES]
    assert asked(table).objection is Objection.STANDS
    assert asked(table + [replace(each, frequency=300.0) for each in table]) is None


@pytest.mark.parametrize("factor", [9.80665, 180.0 / math.pi, 1e-3])
def test_another_unit_of_a_channel_is_no_other_travel(factor) -> None:
    found = [
        replace(each, response=factor * each.response, standard_deviation=factor * each.standard_deviation)
        if each.response_point is TABLE
        else each
        for each in measured(lambda _: STIFFNESS, LEAD_PER_ANGLE)
    ]
    assert asked(found).objection is Objection.STANDS


@pytest.mark.parametrize("ratio", [0.5, 0.7, 1.5, 2.0])
def test_a_gear_before_a_screw_is_no_other_travel(ratio) -> None:
    found = asked(measured(lambda _: STIFFNESS, LEAD_PER_ANGLE / ratio))
    assert found.objection is Objection.STANDS


def screw(place):
    """Return the stiffness of the described screw in series with what else yields."""
    parts = CENTRE.parts
    rigidity = parts.youngs_modulus * math.pi / 4.0 * parts.screw_diameter**2
    yields = 1.0 / parts.bearing_stiffness + 1.0 / CENTRE.nut_rigidity + 1.0 / parts.bracket_stiffness
    return 1.0 / (place / rigidity + yields)


def changed_at(found, point, change):
    """Return responses of which those at a point are others."""
    return [change(each) if each.response_point is point else each for each in found]


def noisy_at_first(observation):
    """Return a response whose ten lowest lines are noise of three times what is there."""
    size = np.where(np.arange(observation.frequency.size) < 10, 3.0 * np.abs(observation.response), 0.0)
    deviation = np.maximum(observation.standard_deviation, size)
    return replace(observation, response=observation.response + size, standard_deviation=deviation)


@pytest.mark.parametrize(("excitation", "lowest"), [(TORQUE, 260.0), (FORCE, 66.0)])
def test_travel_is_that_of_lines_where_table_and_motor_move_as_a_rigid_body(excitation, lowest) -> None:
    """The table would swing at 145 Hz with the motor held, the motor at some 80 Hz with the table held."""
    above = np.geomspace(lowest, 900.0, 110)
    assert asked(measured(screw, LEAD_PER_ANGLE, frequency=above, excitation=excitation)) is None


def test_travel_is_not_told_of_lines_that_are_noise() -> None:
    found = changed_at(measured(screw, LEAD_PER_ANGLE), TABLE, noisy_at_first)
    assert asked(found) is None


def test_travel_is_not_told_of_two_excitations() -> None:
    """By a hammer at the table the acceleration is per newton, and the angle by the motor per newton metre."""
    found = changed_at(
        measured(screw, LEAD_PER_ANGLE), TABLE,
        lambda each: replace(
            each, excitation=FORCE, response=LEAD_PER_ANGLE * each.response,
            standard_deviation=LEAD_PER_ANGLE * each.standard_deviation,
        ),
    )  # fmt: skip
    assert asked(found) is None


@pytest.mark.parametrize(("dead", "objection"), [(TABLE, None), (MOTOR, Objection.STANDS)])
def test_a_dead_channel_says_nothing(dead, objection) -> None:
    found = changed_at(
        measured(lambda _: STIFFNESS, LEAD_PER_ANGLE), dead,
        lambda each: replace(each, response=np.zeros_like(each.response)),
    )  # fmt: skip
    answer = asked(found)
    assert (answer and answer.objection) is objection


def test_the_torque_of_the_nut_twists_the_screw_whichever_bearing_carries_the_force() -> None:
    """Under a payload so heavy that nothing else has mass, the model's first frequency goes as is said of it."""
    file = parse_model(baseline_text(CENTRE.parts, "receptance"), "centre")
    parameters = build_model(file.family, file.parameters).parameters
    physics = physics_of(parameters)
    joints = replace(physics.joints, far_bearing_stiffness=physics.joints.bearing_stiffness, coupling_stiffness=1e9)
    joints = replace(joints, dynamic_load_rating=None)  # no preload is stated
    physics = replace(physics, screw=replace(physics.screw, lead=0.04), joints=joints)
    ends = [DriveConditions(place, payload_mass=1e5) for place in (PLACES[0], PLACES[-1])]
    model = ExtendedModel(parameters, physics, highest_frequency=200.0)
    first, last = (modes[0].frequency for modes in model.natural_frequencies_under(ends, MotorEnd.CLAMPED))
    rising = [ModalObservation(DriveConditions(place), 145.0 * (1.0 + place)) for place in PLACES]
    answer = against_screw(physics, {}, rising)
    assert answer.values["described_change"] == pytest.approx(last / first - 1.0, rel=0.01)


@pytest.mark.parametrize(
    "at_each",
    [
        [{"temperature_deviation": 0.05 * index} for index in range(len(PLACES))],
        [{"payload_mass": 30.0 if index == 1 else 0.0} for index in range(len(PLACES))],
    ],
    ids=["warming", "a payload at one position alone"],
)
def test_what_else_differs_with_the_position_does_not_hide_that_a_frequency_stands_still(at_each) -> None:
    table = [
        ModalObservation(DriveConditions(place, **also), 145.0) for place, also in zip(PLACES, at_each, strict=True)
    ]
    assert asked(table).objection is Objection.STANDS


def test_it_is_said_before_a_preload_is_asked_for() -> None:
    """The description has a load rating, and no measurement states a preload, which any comparison would ask for."""
    file = parse_model(baseline_text(CENTRE.parts, "receptance"), "centre")
    axis = AxisDescription(file.family, file.parameters, dict(file.uncertain))
    found = measured(lambda _: STIFFNESS, LEAD_PER_ANGLE)
    require_explainable(axis, found)
    answer = explain(axis, found)
    assert (answer.outcome, answer.augmented) == (Outcome.UNKNOWN, axis)
    assert headline(answer).startswith("This does not behave as a ball screw axis: its first natural frequency, ")
    assert "stays where it is from 118 to 1176 mm" in headline(answer)
    assert meaning(answer).startswith("No screw: ")
    document = explanation_document(answer, "")
    assert document["against_screw"]["objection"] == "frequency-stands-still"
    assert document["against_screw"]["sentence"] == headline(answer)
    assert document["next_measurement"].startswith("look at what drives the table")


def said_of(machine, design, kind, size, seed):
    """Return what is said of an axis with a screw, of finite elements."""
    drawn = jittered(machine, np.random.default_rng([seed, 1]))
    case = draw_case(kind, size, 0.003, seed, situation=Situation(machine=drawn, design=design))
    file = parse_model(case.baseline, "a case")
    drive = DescribedDrive(build_model(file.family, file.parameters).parameters, dict(file.uncertain), {})
    return asked(observations(case), drive)


def test_a_healthy_screw_is_one() -> None:
    assert said_of(CENTRE, "poor", "none", "medium", 11) is None


@pytest.mark.release
@pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.name)
@pytest.mark.parametrize(
    "kind",
    [
        "none",
        "far-bearing-stiffness",
        "series-compliance",
        "outside:local-wear",
        "outside:belt",
        "outside:screw-bending",
    ],
)
def test_a_screw_with_anything_hidden_in_it_is_one(machine, kind) -> None:
    """A second bearing and a soft bracket let the frequency move least; wear at a place, and a gear, are no law."""
    assert said_of(machine, "usual", kind, "large", 21) is None
