"""Four predictions of one axis: laws that each obeys, and how far reductions part from the distributed drive."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.models.families import FAMILIES
from monitor_core.models.frequency_law import frequency_law
from monitor_core.models.protocol import (
    DriveConditions,
    DriveModel,
    ExcitationPoint,
    MotorEnd,
    NaturalFrequency,
    ResponsePoint,
)
from monitor_core.models.published.hybrid import HybridModel, HybridParameters
from monitor_core.models.published.lumped import LumpedModel, LumpedParameters
from monitor_core.models.published.receptance import ReceptanceModel, ReceptanceParameters
from monitor_core.models.published.transmission_line import TransmissionLineModel, TransmissionLineParameters
from tests.models.extended_axes import bundled

DIAMETER, LENGTH, DENSITY = 0.025, 0.9, 7850.0
AREA, POLAR = math.pi * DIAMETER**2 / 4.0, math.pi * DIAMETER**4 / 32.0
NUT, COUPLING = 2.0e8, 2000.0  # rigidity of the nut; of the coupling
SHARED = {"table_mass": 40.0, "screw_length": LENGTH, "screw_lead": 0.01, "youngs_modulus": 2.06e11,
          "shear_modulus": 7.95e10, "bearing_stiffness": 1.2e8, "coupling_stiffness": COUPLING,
          "motor_inertia": 5e-4}  # fmt: skip
CONDITIONS = DriveConditions(0.4)


def one_axis(**changes: float) -> dict[str, DriveModel]:
    """Return the same axis in each family, undamped; what a family does not know is left out of it."""
    shared = SHARED | changes
    nut = shared.pop("nut_stiffness", NUT)
    steel = shared | {"screw_diameter": DIAMETER, "density": DENSITY}
    mass = DENSITY * AREA * LENGTH
    return {
        "lumped": LumpedModel(
            LumpedParameters(
                **shared, nut_stiffness=nut, screw_minor_diameter=DIAMETER, nut_mass=1e-9, screw_mass=mass,
                screw_inertia=DENSITY * POLAR * LENGTH,
            )
        ),
        "hybrid": HybridModel(HybridParameters(**steel, nut_stiffness=nut)),
        "receptance": ReceptanceModel(ReceptanceParameters(**steel, nut_stiffness=nut)),
        "transmission-line": TransmissionLineModel(
            TransmissionLineParameters(**steel, nut_stiffness=nut, screw_minor_diameter=DIAMETER)
        ),
    }  # fmt: skip


def somewhere(model: DriveModel, **changes: float) -> DriveConditions:
    """Return conditions on the screw, with a preload where the nut follows one."""
    rating = getattr(model.parameters, "dynamic_load_rating", None)
    preload = None if rating is None else 0.05 * rating
    return DriveConditions(0.4 * model.parameters.screw_length, preload, **changes)  # type: ignore[attr-defined]


def first_elastic(model: DriveModel, conditions: DriveConditions, motor_end: MotorEnd) -> float:
    return next(mode.frequency for mode in model.natural_frequencies(conditions, motor_end) if mode.frequency > 1.0)


def receptance(model: DriveModel, frequency, conditions, excitation, response=ResponsePoint.DISPLACEMENT_AT_TABLE):
    return model.frequency_response(
        np.atleast_1d(frequency).astype(float), conditions, excitation=excitation, response=response
    ).response


families = pytest.mark.parametrize("family", [item.name for item in FAMILIES])
bands = pytest.mark.parametrize("frequency", [np.geomspace(1.0, 2000.0, 300)])


# Not the lumped one, whose paper clamps the motor under a force at the table: there is no angle to compare.
@pytest.mark.parametrize("family", [item.name for item in FAMILIES if item.name != "lumped"])
@bands
def test_reciprocity(family: str, frequency) -> None:
    """A torque at the rotor moves the table as a force at the table turns the rotor (Maxwell, Betti)."""
    model = bundled(family)
    conditions = somewhere(model)
    there = receptance(model, frequency, conditions, ExcitationPoint.TORQUE_AT_MOTOR)
    back = receptance(model, frequency, conditions, ExcitationPoint.FORCE_AT_TABLE, ResponsePoint.ANGLE_AT_MOTOR)
    np.testing.assert_allclose(there, back, rtol=1e-8, atol=1e-10 * np.abs(there).max())


@families
@bands
def test_passivity(family: str, frequency) -> None:
    """No frequency takes energy out of a drive: the driving-point receptances lag."""
    model = bundled(family)
    conditions = somewhere(model)
    at_table = receptance(model, frequency, conditions, ExcitationPoint.FORCE_AT_TABLE)
    at_motor = receptance(model, frequency, conditions, ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.ANGLE_AT_MOTOR)
    for driving_point in (at_table, at_motor):
        assert np.all(driving_point.imag <= 1e-9 * np.abs(driving_point))


@families
def test_acceleration_is_displacement_differentiated_twice(family: str) -> None:
    model, frequency = bundled(family), np.array([20.0, 150.0])
    arguments = (frequency, somewhere(model), ExcitationPoint.TORQUE_AT_SCREW)
    acceleration = receptance(model, *arguments, ResponsePoint.ACCELERATION_AT_TABLE)
    displacement = receptance(model, *arguments)
    # in discrete time a derivative is (2/Δt) tan(ωΔt/2), not ω
    tolerance = 1e-5 if family == "transmission-line" else 1e-12
    np.testing.assert_allclose(acceleration, -((2.0 * np.pi * frequency) ** 2) * displacement, rtol=tolerance)


@families
def test_payload_lowers_and_stiffer_nut_raises_the_first_mode(family: str) -> None:
    model = one_axis()[family]
    stiffer = one_axis(nut_stiffness=1.5 * NUT)[family]
    for motor_end in MotorEnd:
        bare = first_elastic(model, CONDITIONS, motor_end)
        assert first_elastic(model, DriveConditions(0.4, payload_mass=10.0), motor_end) < bare
        assert first_elastic(stiffer, CONDITIONS, motor_end) > bare


@families
def test_free_drive_moves_as_a_rigid_body_when_slow(family: str) -> None:
    """Far below the first mode a torque T moves the table by T i/(J + i² M) /(−ω²)."""
    model, frequency = one_axis()[family], 0.5
    i = SHARED["screw_lead"] / (2.0 * np.pi)
    inertia = SHARED["motor_inertia"] + DENSITY * POLAR * LENGTH
    # the lumped model counts the screw's mass with the table, the others hold it in its bearing
    mass = SHARED["table_mass"] + (DENSITY * AREA * LENGTH if family == "lumped" else 0.0)
    rigid = i / (inertia + i**2 * mass) / -((2.0 * np.pi * frequency) ** 2)
    (moved,) = receptance(model, frequency, CONDITIONS, ExcitationPoint.TORQUE_AT_MOTOR)
    assert moved.real == pytest.approx(rigid, rel=2e-4)


@families
def test_rigid_joints_leave_the_screw(family: str) -> None:
    """A stiffness that goes to infinity matters first, and then no more: the next factor of ten moves nothing."""
    for joint in ("bearing_stiffness", "coupling_stiffness", "nut_stiffness"):
        value = {"nut_stiffness": NUT}.get(joint, SHARED.get(joint, 0.0))
        stiff, stiffer = (
            first_elastic(one_axis(**{joint: factor * value})[family], CONDITIONS, MotorEnd.CLAMPED)
            for factor in (1e5, 1e6)
        )
        assert stiffer == pytest.approx(stiff, rel=3e-5)
        assert stiff > 1.003 * first_elastic(one_axis()[family], CONDITIONS, MotorEnd.CLAMPED)


#: How far f1 of a reduction lies from the distributed drive on this axis, lowest and highest, by motor end: what
#: docs/reference/equations.md states. Lumped: the whole screw moves with the table (too low), and Eq. (3) holds its far
#: end in torsion. Hybrid: static shapes of the screw, never too low (Rayleigh). Transmission lines: delays of whole
#: steps.
REDUCTION_ERRORS = {
    ("lumped", MotorEnd.CLAMPED): (-0.015, 0.0),
    ("lumped", MotorEnd.FREE): (-0.04, 0.0),
    ("lumped", MotorEnd.PRESCRIBED): (-0.01, 0.0),
    ("hybrid", MotorEnd.CLAMPED): (0.0, 0.003),
    ("hybrid", MotorEnd.FREE): (0.0, 0.003),
    ("hybrid", MotorEnd.PRESCRIBED): (0.0, 0.01),
    ("transmission-line", MotorEnd.CLAMPED): (-5e-6, 5e-6),
    ("transmission-line", MotorEnd.FREE): (-5e-6, 5e-6),
    ("transmission-line", MotorEnd.PRESCRIBED): (-5e-6, 5e-6),
}


def test_first_mode_of_one_axis_agrees_to_the_reduction_error(subtests: pytest.Subtests) -> None:
    for (family, motor_end), position in itertools.product(REDUCTION_ERRORS, [0.15, 0.4, 0.7]):
        with subtests.test(family=family, motor_end=motor_end):
            models = one_axis()
            exact = first_elastic(models["receptance"], DriveConditions(position), motor_end)
            reduced = first_elastic(models[family], DriveConditions(position), motor_end)
            lowest, highest = REDUCTION_ERRORS[family, motor_end]
            assert lowest <= reduced / exact - 1.0 <= highest


@pytest.mark.parametrize("motor_end", [MotorEnd.CLAMPED, MotorEnd.FREE])  # else nothing would turn at the motor end
@pytest.mark.parametrize("position", [0.15, 0.4, 0.7])
def test_hybrid_and_receptance_meet_where_the_screw_has_no_mass(motor_end: MotorEnd, position: float) -> None:
    """Without inertia the screw deforms as if at rest, which is all that the hybrid model assumes."""
    shared = SHARED | {"screw_diameter": DIAMETER, "density": 1e-3, "nut_stiffness": NUT, "bracket_stiffness": 3e8}
    hybrid, receptance_ = HybridModel(HybridParameters(**shared)), ReceptanceModel(ReceptanceParameters(**shared))
    conditions = DriveConditions(position, payload_mass=7.0)
    assert first_elastic(hybrid, conditions, motor_end) == pytest.approx(
        first_elastic(receptance_, conditions, motor_end), rel=1e-6
    )


@families
def test_off_the_screw_is_refused(family: str) -> None:
    model = bundled(family)
    for position in (0.0, -0.1, 10.0):
        with pytest.raises(OutsideValidityError, match="position must lie on the screw"):
            model.natural_frequencies(replace(somewhere(model), position=position))


def test_a_frequency_law_is_refused_without_a_range_or_an_elastic_mode() -> None:
    class Rigid(HybridModel):
        def natural_frequencies(
            self, conditions: DriveConditions, motor_end: MotorEnd | None = None
        ) -> tuple[NaturalFrequency, ...]:
            return (NaturalFrequency(0.0, 0.0),)

    drive = one_axis()["hybrid"]
    for between in ((0.3, 0.3), (0.4, 0.3)):
        with pytest.raises(OutsideValidityError, match="from a lower to a higher value; got"):
            frequency_law(drive, DriveConditions, between, 2)
    rigid = Rigid(HybridParameters(**SHARED, nut_stiffness=NUT, screw_diameter=DIAMETER, density=DENSITY))
    with pytest.raises(OutsideValidityError, match="with an elastic mode; got"):
        frequency_law(rigid, DriveConditions, (0.3, 0.4), 2)
