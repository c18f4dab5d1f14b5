"""Discretise the drive: sections and time steps of its two lines, a whole number of steps to a wave in each.

Torsional and axial waves run at different speeds. The paper lets the axial line take several steps in one torsional
step; with the same step for both lines, and different numbers of sections, nothing has to be held in between.

The parameters of the model are here too, with the wave speeds that follow from them.
"""

import math
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.ball_screw import BallScrew, nut_rigidity
from monitor_core.models.parameters import DriveParameters
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.transmission_line.junctions import (
    STEEPEST,
    Bearing,
    Friction,
    Motor,
    Nut,
    SpeedLoop,
    Table,
    share_of_coupling,
)
from monitor_core.models.published.transmission_line.kernel import LineDrive, Lines


@dataclass(frozen=True, slots=True, kw_only=True)
class TransmissionLineParameters(BallScrew, DriveParameters):
    """Axis of a transmission-line model.

    The shaft twists with ``screw_diameter`` and stretches with ``screw_minor_diameter``: the figures of
    Moreno-Castaneda et al. (2005) follow from 40 mm in torsion and 34.1 mm axially. There is no loss factor: it has no
    counterpart in the time domain, for which this family is made; damping is viscous.
    """

    table_mass: float
    screw_length: float
    screw_diameter: float
    screw_minor_diameter: float
    screw_lead: float
    youngs_modulus: float
    shear_modulus: float
    density: float
    motor_inertia: float
    coupling_stiffness: float
    bearing_stiffness: float
    nut_stiffness: float
    coupling_inertia: float = 0.0
    far_bearing_stiffness: float = 0.0
    bracket_stiffness: float = math.inf
    dynamic_load_rating: float | None = None
    bearing_damping: float = 0.0
    far_bearing_damping: float = 0.0
    nut_damping: float = 0.0
    coupling_damping: float = 0.0
    table_damping: float = 0.0
    motor_damping: float = 0.0

    @property
    def stretched_diameter(self) -> float:
        """Diameter that carries the load, in metres."""
        return self.screw_minor_diameter

    @property
    def torsional_speed(self) -> float:
        """Speed of torsional waves √(G/ρ), Eq. (11), in metres per second."""
        return math.sqrt(self.shear_modulus / self.density)

    @property
    def axial_speed(self) -> float:
        """Speed of axial waves √(E/ρ), Eq. (13), in metres per second."""
        return math.sqrt(self.youngs_modulus / self.density)


#: With fewer sections the modes that are asked for come near half the sampling rate.
_FEWEST_SECTIONS = 12
#: A delay that misses a whole number of steps by rounding alone is that number.
_WHOLE = 1e-9


@dataclass(frozen=True, slots=True)
class LineGrid:
    """How the lines are divided. The static stiffness of a line is exact whatever its delay is rounded to.

    Impedances are Z = stiffness · delay, so a delay that is off by ε changes the mass of the line, not its stiffness,
    by 2ε. That is what the paper does in Eqs. (52)–(54), where it adjusts the density.
    """

    time_step: float  # of the torsional line and of all that is recorded [s]
    torsional_sections: int
    axial_sections: int
    axial_substeps: int = 1  # axial steps in one torsional step

    def __post_init__(self) -> None:
        if not (math.isfinite(self.time_step) and self.time_step > 0.0):
            raise OutsideValidityError(f"time_step must be positive; got {self.time_step} s")
        if min(self.torsional_sections, self.axial_sections) < _FEWEST_SECTIONS:
            raise OutsideValidityError(
                f"each line needs at least {_FEWEST_SECTIONS} sections; got {self.torsional_sections} torsional and "
                f"{self.axial_sections} axial"
            )
        if self.axial_substeps < 1:
            raise OutsideValidityError(f"axial_substeps must be at least 1; got {self.axial_substeps}")

    @property
    def axial_step(self) -> float:
        """Time in which an axial wave crosses one axial section, in seconds."""
        return self.time_step / self.axial_substeps

    def require_room(self, position: FloatArray, screw_length: float) -> None:
        """Refuse positions [m] that do not leave a section between the nut and the ends of the screw."""
        margin = screw_length / min(self.axial_sections, self.torsional_sections)
        if np.any(position < margin) or np.any(position > screw_length - margin):
            raise OutsideValidityError(
                f"position must lie on the screw, at least one section from the ends, within {margin:g} and "
                f"{screw_length - margin:g} m; got {np.min(position):g} to {np.max(position):g} m"
            )

    def torsional_impedance(self, parameters: TransmissionLineParameters) -> float:
        """Return Z_t = GJ · delay/length = ρ'J u', Eq. (12) as corrected, in N·m·s/rad."""
        delay = self.torsional_sections * self.time_step
        return parameters.torsional_rigidity * delay / parameters.screw_length

    def axial_impedance(self, parameters: TransmissionLineParameters) -> float:
        """Return Z_a = EA · delay/length = ρ'A u', Eq. (14), in N·s/m."""
        delay = self.axial_sections * self.axial_step
        return parameters.axial_rigidity * delay / parameters.screw_length


def synchronised_grid(parameters: TransmissionLineParameters, time_step: float, n_a: int = 8, n_t: int = 5) -> LineGrid:
    r"""Divide the lines as the paper does: n_t axial sections in a torsional one, n_a axial steps in a torsional one.

    .. math::

        m = \lfloor l / (u_t t_t) \rfloor, \qquad m_a = n_t m, \qquad t_a = t_t / n_a

    Eqs. (40), (41), (44), (50) and (51) of Moreno-Castaneda et al. (2005). Torsional values are held during the axial
    steps.

    Eqs. (42) and (56) print :math:`t_a = (n_t/n_a) t_t`. That is the time of an axial wave over a *torsional* section;
    an axial section is n_t times shorter. ``time_step`` is :math:`t_t` [s], n_a/n_t the ratio of the speeds
    :math:`u_a/u_t`; 8/5 is the smallest that steel allows. Too few sections in a line raise ``OutsideValidityError``.

    Examples
    --------
    Eqs. (50) and (51) of Moreno-Castaneda et al. (2005), the paper's shaft at 1 µs: 421 and 2105 sections (the other
    parameters do not matter).

    >>> shaft = TransmissionLineParameters(
    ...     screw_length=1.346, screw_diameter=0.040, screw_minor_diameter=0.0341, shear_modulus=80e9,
    ...     youngs_modulus=204.8e9, density=7850.0, table_mass=1.0, screw_lead=0.01, motor_inertia=1.0,
    ...     coupling_stiffness=1.0, bearing_stiffness=1.0, nut_stiffness=1.0,
    ... )
    >>> grid = synchronised_grid(shaft, 1e-6)
    >>> grid.torsional_sections, grid.axial_sections
    (421, 2105)
    """
    if not (math.isfinite(time_step) and time_step > 0.0):
        raise OutsideValidityError(f"time_step must be positive; got {time_step} s")
    sections = math.floor(parameters.screw_length / (parameters.torsional_speed * time_step) * (1.0 + _WHOLE))
    return LineGrid(time_step, sections, n_t * sections, n_a)


def common_step_grid(parameters: TransmissionLineParameters, torsional_sections: int) -> LineGrid:
    """Divide the torsional line into so many sections and give the axial line the same step.

    The torsional delay is exact, the axial one is rounded to whole steps; where u_a/u_t = n_a/n_t and the number is a
    multiple of n_a, both are exact.
    """
    delay = parameters.screw_length / parameters.torsional_speed
    axial_sections = _axial_sections(parameters, torsional_sections)
    return LineGrid(delay / torsional_sections, torsional_sections, round(axial_sections))


def closest_common_step_grid(parameters: TransmissionLineParameters, least_torsional_sections: int) -> LineGrid:
    """Return the common-step grid with n to 2n torsional sections that rounds the axial delay least."""
    if least_torsional_sections < _FEWEST_SECTIONS:
        raise OutsideValidityError(
            f"least_torsional_sections must be at least {_FEWEST_SECTIONS}; got {least_torsional_sections}"
        )

    def rounding(sections: int) -> float:
        exact = _axial_sections(parameters, sections)
        return abs(round(exact) / exact - 1.0)

    candidates = range(least_torsional_sections, 2 * least_torsional_sections + 1)
    return common_step_grid(parameters, min(candidates, key=rounding))


def _axial_sections(parameters: TransmissionLineParameters, torsional_sections: int) -> float:
    """Return the sections that an axial wave crosses in the time of a torsional wave along the screw, not rounded."""
    return torsional_sections * parameters.torsional_speed / parameters.axial_speed


@dataclass(frozen=True, slots=True)
class StribeckFriction:
    """Dry friction at one place: Coulomb friction, and a static one that fades as it moves (Stribeck).

    In N and m/s, or where something turns in N·m and rad/s.
    """

    coulomb: float
    static: float
    stribeck_velocity: float = 0.0  # where half of what the static one adds has gone

    def __post_init__(self) -> None:
        if not 0.0 <= self.coulomb <= self.static < math.inf:
            raise OutsideValidityError(
                f"coulomb friction must not be negative nor exceed the static one; got {self.coulomb} and {self.static}"
            )
        fades = self.static > self.coulomb
        if not math.isfinite(self.stribeck_velocity) or self.stribeck_velocity < 0.0 or (
            fades and self.stribeck_velocity == 0.0
        ):  # fmt: skip
            raise OutsideValidityError(
                "stribeck_velocity must be positive where the static friction exceeds coulomb friction; "
                f"got {self.stribeck_velocity}"
            )


_NONE = StribeckFriction(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class DriveFriction:
    """Dry friction of a drive, one law at each of its places; Table 1 has the bearings and the nut."""

    guides: StribeckFriction = _NONE  # [N]
    nut: StribeckFriction = _NONE  # between screw and nut [N·m]
    bearing: StribeckFriction = _NONE  # at the motor end of the screw [N·m]
    far_bearing: StribeckFriction = _NONE  # [N·m]


SMOOTH = DriveFriction()


@dataclass(frozen=True, slots=True)
class SpeedControl:
    """Velocity loop of the drive: a sampled PI controller, and a current that lags behind (section 5, Fig. 9)."""

    proportional_gain: float  # [N·m·s/rad]
    integral_time: float  # [s]
    current_lag: float  # time constant of the first order; 0: none [s]
    sampling_time: float  # [s]

    def __post_init__(self) -> None:
        for name in ("proportional_gain", "integral_time", "sampling_time"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise OutsideValidityError(f"{name} of the speed loop must be positive; got {value}")
        if not 0.0 <= self.current_lag < math.inf:
            raise OutsideValidityError(f"current_lag must not be negative; got {self.current_lag} s")

    def on(self, step: float) -> SpeedLoop:
        """Return the loop in steps of the lines [s], to the next whole number of which its sampling time is put.

        ``OutsideValidityError`` if it samples more often than the lines step.
        """
        if self.sampling_time < step * (1.0 - _WHOLE):
            raise OutsideValidityError(
                f"sampling_time of the speed loop must not be below the step of the lines, {step:g} s; "
                f"got {self.sampling_time:g} s"
            )
        every = round(self.sampling_time / step)
        followed = 1.0 if self.current_lag == 0.0 else -math.expm1(-step / self.current_lag)
        period = every * step
        return SpeedLoop(self.proportional_gain, period / self.integral_time, every, period, followed)


#: The motor is driven by the stated torque alone.
_OPEN = SpeedLoop(0.0, 0.0, 1, 1.0, 0.0)


def discretise(
    parameters: TransmissionLineParameters,
    grid: LineGrid,
    conditions: DriveConditions,
    motor_end: MotorEnd,
    friction: DriveFriction = SMOOTH,
    *,
    control: SpeedControl | None = None,
) -> LineDrive:
    """Return the discretised drive: lines as delays, everything else as trapezoidal stubs.

    ``OutsideValidityError`` if a friction fades so fast that what drives a place allows several speeds.
    """
    h = 0.5 * grid.axial_step
    z = grid.axial_impedance(parameters)
    nut_stiffness = nut_rigidity(parameters.nut_stiffness, conditions.preload, parameters.dynamic_load_rating)
    i = parameters.transmission_ratio
    length = parameters.screw_length
    moving_mass = parameters.table_mass + conditions.payload_mass
    torsional = grid.torsional_impedance(parameters)
    motor = _motor(parameters, grid, motor_end, _dry(friction.bearing))
    for place, unit, impedance in (
        ("guides", "m/s", moving_mass / h + parameters.table_damping),
        ("nut", "rad/s", 2.0 * torsional),  # on a node; more between two
        ("bearing", "rad/s", torsional / (1.0 - share_of_coupling(motor))),
        ("far_bearing", "rad/s", torsional),
    ):
        rubs: StribeckFriction = getattr(friction, place)
        least = STEEPEST * (rubs.static - rubs.coulomb) / impedance
        if rubs.stribeck_velocity < least:
            raise OutsideValidityError(
                f"stribeck_velocity of the friction at {place} must be at least {least:.4g} {unit} on these lines, or "
                f"several speeds obey it at once; got {rubs.stribeck_velocity:g} {unit}"
            )
    return LineDrive(
        lines=Lines(grid.axial_sections, grid.torsional_sections, z, torsional, i),
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
            friction=_dry(friction.guides),
        ),
        motor=motor,
        loop=_OPEN if control is None else control.on(grid.time_step),
        nut_friction=_dry(friction.nut),
        far_bearing_friction=_dry(friction.far_bearing),
    )


def _dry(friction: StribeckFriction) -> Friction:
    return Friction(friction.coulomb, friction.static, friction.stribeck_velocity)


def _bearing(stiffness: float, damping: float, half_step: float, impedance: float) -> Bearing:
    resistance = stiffness * half_step + damping
    share = impedance / (impedance + resistance)
    return Bearing(half_step, resistance / (impedance + resistance), stiffness * share, impedance)


def _motor(parameters: TransmissionLineParameters, grid: LineGrid, motor_end: MotorEnd, friction: Friction) -> Motor:
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
        friction=friction,
    )
