"""Discretise a drive for time stepping, from its parameters and the sections of its lines."""

import math
from dataclasses import dataclass

from monitor_core.errors import OutsideValidityError
from monitor_core.models.nut import nut_rigidity
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.transmission_line.grid import LineGrid
from monitor_core.models.published.transmission_line.junctions import Bearing, Motor, Nut, Table
from monitor_core.models.published.transmission_line.kernel import LineDrive, Lines
from monitor_core.models.published.transmission_line.parameters import TransmissionLineParameters


@dataclass(frozen=True, slots=True)
class StribeckFriction:
    """Dry friction of the guides: Coulomb friction, and a static force that fades as the table moves (Stribeck)."""

    coulomb_force: float  # [N]
    static_force: float  # [N]
    stribeck_velocity: float = 0.0  # where half of what the static force adds has gone [m/s]

    def __post_init__(self) -> None:
        if not 0.0 <= self.coulomb_force <= self.static_force < math.inf:
            raise OutsideValidityError(
                "coulomb_force must not be negative nor exceed static_force; "
                f"got {self.coulomb_force} N and {self.static_force} N"
            )
        fades = self.static_force > self.coulomb_force
        if not math.isfinite(self.stribeck_velocity) or self.stribeck_velocity < 0.0 or (
            fades and self.stribeck_velocity == 0.0
        ):  # fmt: skip
            raise OutsideValidityError(
                "stribeck_velocity must be positive where static_force exceeds coulomb_force; "
                f"got {self.stribeck_velocity} m/s"
            )


#: Guides without dry friction.
SMOOTH_GUIDES = StribeckFriction(0.0, 0.0)


def discretise(
    parameters: TransmissionLineParameters,
    grid: LineGrid,
    conditions: DriveConditions,
    motor_end: MotorEnd,
    friction: StribeckFriction,
) -> LineDrive:
    """Return the discretised drive: lines as delays, everything else as trapezoidal stubs."""
    h = 0.5 * grid.axial_step
    z = grid.axial_impedance(parameters)
    nut_stiffness = nut_rigidity(parameters.nut_stiffness, conditions.preload, parameters.dynamic_load_rating)
    i = parameters.transmission_ratio
    length = parameters.screw_length
    moving_mass = parameters.table_mass + conditions.payload_mass
    return LineDrive(
        lines=Lines(grid.axial_sections, grid.torsional_sections, z, grid.torsional_impedance(parameters), i),
        axial_substeps=grid.axial_substeps,
        moving_mass=moving_mass,
        bracket_compliance=1.0 / parameters.bracket_stiffness,
        axial_cell_compliance=length / (grid.axial_sections * parameters.axial_rigidity),
        torsional_cell_compliance=i**2 * length / (grid.torsional_sections * parameters.torsional_rigidity),
        bearing=_bearing(parameters.bearing_stiffness, parameters.bearing_damping, h, z),
        far_bearing=_bearing(parameters.far_bearing_stiffness, parameters.far_bearing_damping, h, z),
        nut=Nut(h, nut_stiffness, nut_stiffness * h + parameters.nut_damping),
        table=Table(
            half_step=h,
            mass_impedance=moving_mass / h,
            viscous_friction=parameters.table_damping,
            coulomb_force=friction.coulomb_force,
            static_force=friction.static_force,
            stribeck_velocity=friction.stribeck_velocity,
        ),
        motor=_motor(parameters, grid, motor_end),
    )


def _bearing(stiffness: float, damping: float, half_step: float, impedance: float) -> Bearing:
    resistance = stiffness * half_step + damping
    share = impedance / (impedance + resistance)
    return Bearing(half_step, resistance / (impedance + resistance), stiffness * share, impedance)


def _motor(parameters: TransmissionLineParameters, grid: LineGrid, motor_end: MotorEnd) -> Motor:
    h = 0.5 * grid.time_step
    turns = motor_end is MotorEnd.FREE
    inertia_impedance = parameters.rotor_inertia / h
    return Motor(
        half_step=h,
        prescribed=motor_end is MotorEnd.PRESCRIBED,
        inertia_impedance=inertia_impedance if turns else 0.0,
        admittance=1.0 / (inertia_impedance + parameters.motor_damping) if turns else 0.0,
        viscous_friction=parameters.motor_damping,
        coupling_stiffness=parameters.coupling_stiffness,
        coupling_resistance=parameters.coupling_stiffness * h + parameters.coupling_damping,
        impedance=grid.torsional_impedance(parameters),
    )
