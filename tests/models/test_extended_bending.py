"""A screw that bends under a nut that pulls beside it: beam elements, the static beam, power, modes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from monitor_core.effects import Reference
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.machine_sizes import sizes_of_drive
from monitor_core.models.extended import ExtendedModel, ScrewBending, natural_frequencies, physics_of
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from tests.models.extended_axes import add, bundled, case_of, response_of, undamped
from tests.models.test_extended_modes import assembled

PARAMETERS = bundled("receptance").parameters
LENGTH, DIAMETER = PARAMETERS.screw_length, PARAMETERS.screw_diameter
RIGIDITY = PARAMETERS.youngs_modulus * math.pi * DIAMETER**4 / 64.0
PER_LENGTH = PARAMETERS.density * math.pi * DIAMETER**2 / 4.0
FIRST = math.pi / (2.0 * LENGTH**2) * math.sqrt(RIGIDITY / PER_LENGTH)  # [Hz]
BESIDE = 0.02  # [m]
FIRST_COMPLIANCE = 2.0 * BESIDE**2 * LENGTH / (math.pi**2 * RIGIDITY)
FORCE, TORQUE = ExcitationPoint.FORCE_AT_TABLE, ExcitationPoint.TORQUE_AT_MOTOR
TABLE, ANGLE = ResponsePoint.DISPLACEMENT_AT_TABLE, ResponsePoint.ANGLE_AT_MOTOR
SHARES = (0.12, 0.37, 0.5, 0.83)


def bent(share, **changes):
    """Return the undamped axis with the nut so far beside the screw: what is beyond five modes is a spring."""
    static = BESIDE**2 * LENGTH / (3.0 * RIGIDITY) * (1.0 - 3.0 * share + 3.0 * share**2)
    waves = sum(math.cos(n * math.pi * share) ** 2 / n**2 for n in range(1, 6))
    plain = add(undamped(physics_of(PARAMETERS)), series_compliance=static - FIRST_COMPLIANCE * waves)
    return replace(plain, bending=ScrewBending(compliance=FIRST_COMPLIANCE, frequency=FIRST, **changes))


def beam(share, n_elements=240):
    """Return finite elements of the axis and of a beam of cubic elements on two supports that let it turn."""
    parts = assembled(PARAMETERS, share * LENGTH)
    n_near, nut = 90, 90
    first = parts.size
    parts.size += 2 * (n_elements + 1)
    for matrix in (parts.mass, parts.damping, parts.screw, parts.springs):
        matrix.resize((parts.size, parts.size))
    at = round(share * n_elements)
    lengths = [share * LENGTH / at] * at + [(1.0 - share) * LENGTH / (n_elements - at)] * (n_elements - at)
    for k, h in enumerate(lengths):
        nodes = np.ix_(range(first + 2 * k, first + 2 * k + 4), range(first + 2 * k, first + 2 * k + 4))
        parts.screw[nodes] += RIGIDITY / h**3 * np.array(
            [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
             [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]
        )  # fmt: skip
        parts.mass[nodes] += PER_LENGTH * h / 420.0 * np.array(
            [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
             [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]]
        )  # fmt: skip
    for end in (first, first + 2 * n_elements):
        parts.spring({end: 1.0}, 1e13, 0.0)
    ratio = PARAMETERS.screw_lead / (2.0 * math.pi)
    rigid = {parts.table: 1.0, nut: -1.0, parts.turn + n_near: -ratio}
    parts.spring(rigid, -PARAMETERS.nut_stiffness, 0.0)  # in its place the one whose deflection the slope takes part in
    parts.spring(rigid | {first + 2 * at + 1: -BESIDE}, PARAMETERS.nut_stiffness, 0.0)
    return parts


@pytest.mark.release
@pytest.mark.parametrize("share", SHARES)
def test_responses_are_those_of_a_beam_in_finite_elements(share) -> None:
    elements, frequency = beam(share), np.geomspace(0.4 * FIRST, 8.0 * FIRST, 60)
    case = case_of(PARAMETERS, frequency, DriveConditions(share * LENGTH), TORQUE, TABLE)
    ours = response_of(bent(share), replace(case, motor_end=MotorEnd.FREE)).real
    theirs = elements.response(2.0 * np.pi * frequency, elements.rotor)[:, 0].real
    plain = response_of(undamped(physics_of(PARAMETERS)), replace(case, motor_end=MotorEnd.FREE)).real
    assert np.max(np.abs(plain / theirs - 1.0)) > 0.3
    np.testing.assert_allclose(ours, theirs, rtol=3e-3)


@pytest.mark.release
@pytest.mark.parametrize("share", SHARES)
def test_natural_frequencies_are_those_of_a_beam_in_finite_elements(share) -> None:
    model = ExtendedModel(PARAMETERS, bent(share), 20.0 * FIRST)
    found = model.natural_frequencies(DriveConditions(share * LENGTH), MotorEnd.FREE)
    ours = [mode.frequency for mode in found if mode.frequency > 0.0]
    theirs, _ = beam(share).modes(20)
    theirs = theirs[theirs > 0.1]
    np.testing.assert_allclose(ours, theirs[theirs < 20.0 * FIRST], rtol=2e-3)


def test_the_frequency_that_a_machine_is_told_is_that_of_the_beam() -> None:
    sizes = sizes_of_drive(physics_of(PARAMETERS), [])
    assert sizes.of(Reference.BENDING_FREQUENCY) == pytest.approx(FIRST, rel=1e-9)


def test_bending_takes_power_at_every_frequency_and_gives_none() -> None:
    """With a damper in the bent screw alone, what a torque brings is what that takes: never less than nothing."""
    damped = bent(0.3, damping_ratio=0.03)
    frequency = np.geomspace(0.2 * FIRST, 40.0 * FIRST, 400)
    case = case_of(PARAMETERS, frequency, DriveConditions(0.3 * LENGTH), TORQUE, ANGLE)
    angle = response_of(damped, replace(case, motor_end=MotorEnd.FREE))
    brought = (1j * frequency * angle).real
    assert np.all(brought > 0.0)


def test_damping_of_the_bent_screw_is_followed_to_the_poles() -> None:
    """At a pole the undamped response has no bound; of a light drive the first mode of bending keeps its own ratio."""
    little = replace(bent(0.3, damping_ratio=0.02), added=physics_of(PARAMETERS).added)
    little = replace(little, bending=replace(little.bending, compliance=1e-4 * FIRST_COMPLIANCE))
    (modes,) = natural_frequencies(little, [DriveConditions(0.3 * LENGTH)], [MotorEnd.FREE], 3.0 * FIRST)
    first = min(modes, key=lambda mode: abs(mode.frequency - FIRST))
    assert first.frequency == pytest.approx(FIRST, rel=1e-3)
    assert first.damping_ratio == pytest.approx(0.02, rel=1e-2)


def test_modes_superpose_to_the_response() -> None:
    frequency = np.array([0.5, 2.2, 6.0, 12.5]) * FIRST
    conditions = DriveConditions(0.37 * LENGTH)
    modes = ExtendedModel(PARAMETERS, bent(0.37), 20_000.0).normal_modes(conditions, MotorEnd.FREE)
    case = case_of(PARAMETERS, frequency, conditions, TORQUE, TABLE)
    shapes = modes.angle_at_motor * modes.displacement_at_table
    square = (2.0 * np.pi * modes.frequency) ** 2 - (2.0 * np.pi * frequency[:, None]) ** 2
    response = response_of(bent(0.37), replace(case, motor_end=MotorEnd.FREE)).real
    np.testing.assert_allclose(np.sum(shapes / square, axis=1), response, rtol=2e-3)


def test_warmth_moves_the_bent_screw_as_it_does_all_springs() -> None:
    """Softer by the square of a factor, everything elastic resonates lower by that factor."""
    warm = add(bent(0.3), thermal_stiffness=-1e-2, series_compliance=0.0)
    modes = [
        natural_frequencies(warm, [DriveConditions(0.3 * LENGTH, temperature_deviation=by)], [MotorEnd.FREE], 900.0)[0]
        for by in (0.0, 10.0)
    ]
    cold, hot = ([mode.frequency for mode in found if mode.frequency > 0.0] for found in modes)
    np.testing.assert_allclose(hot[: len(cold)], math.sqrt(0.9) * np.array(cold), rtol=1e-6)


@pytest.mark.parametrize(
    "changes",
    [{"frequency": 0.0}, {"compliance": -1e-9}, {"damping_ratio": -0.1}, {"share_3": -0.1}, {"share_2": math.nan}],
)
def test_no_screw_bends_so(changes) -> None:
    with pytest.raises(OutsideValidityError, match=next(iter(changes))):
        ScrewBending(**changes)
