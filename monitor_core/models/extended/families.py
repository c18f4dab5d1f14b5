"""Convert the parameters of a family to the physics of the extended drive."""

from dataclasses import fields
from functools import cache

from monitor_core.errors import OutsideValidityError
from monitor_core.models.ball_screw import BallScrew
from monitor_core.models.extended.physics import AxisPhysics, BodyPhysics, JointPhysics, ScrewPhysics
from monitor_core.models.parameters import DriveParameters
from monitor_core.models.protocol import MotorEnd
from monitor_core.models.published.lumped import LumpedParameters


def physics_of(parameters: DriveParameters) -> AxisPhysics:
    """Return the physics of a model of one of the four families, nothing added.

    *Lumped* and *receptance*: the same responses to rounding. *Transmission line*: to its discretisation, about 1 ppm
    of a natural frequency. *Hybrid*: the same axis with a screw that deforms as it will and not as under a static load;
    the hybrid model's elastic mode lies higher, by up to 0.65 % with a free motor end, 0.15 % with a clamped one and
    3.4 % with a prescribed torque on the paper's axis. Other records raise ``OutsideValidityError``.
    """
    if not isinstance(parameters, BallScrew):
        raise OutsideValidityError(
            "the extended drive starts from lumped, hybrid, receptance or transmission-line parameters; "
            f"got {type(parameters).__name__}"
        )
    return AxisPhysics(
        screw=ScrewPhysics(**_stated(parameters, ScrewPhysics), **_with_table_and_motor(parameters)),
        joints=JointPhysics(**_stated(parameters, JointPhysics)),
        bodies=BodyPhysics(**_stated(parameters, BodyPhysics)),
    )


def paper_motor_end(parameters: DriveParameters) -> MotorEnd:
    """Return what holds the motor end in a family's model where no torque is given: clamped in the lumped one alone."""
    return MotorEnd.CLAMPED if isinstance(parameters, LumpedParameters) else MotorEnd.FREE


def _with_table_and_motor(parameters: DriveParameters) -> dict[str, float]:
    """Return where the lumped model has its screw: its mass with the table, its inertia with the motor end."""
    if not isinstance(parameters, LumpedParameters):
        return {}
    return {"axial_mass_share": 0.0, "torsional_inertia_share": 0.0, "far_end_held_share": 1.0}


def _stated(parameters: DriveParameters, record: type[ScrewPhysics | JointPhysics | BodyPhysics]) -> dict[str, float]:
    """Return the fields of a record that a family has."""
    return {name: getattr(parameters, own_name) for name, own_name in _names(type(parameters), record)}  # type: ignore[arg-type]  # a class has a hash, whatever its records have


@cache
def _names(
    family: type[DriveParameters], record: type[ScrewPhysics | JointPhysics | BodyPhysics]
) -> list[tuple[str, str]]:
    """Return the fields of a record and what a family calls them: the same, or with ``screw_`` before it."""
    of_family = dir(family)
    either = [(item.name, name) for item in fields(record) for name in (item.name, f"screw_{item.name}")]
    return [(name, own_name) for name, own_name in either if own_name in of_family]
