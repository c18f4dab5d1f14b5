r"""A screw axis as wave lines: what torque, force on the table and force in the nut find, line by line of frequency.

With s = jω a wave runs from the nut along the screw, in tension and in torsion, and comes back from bearing, coupling
or free end with what these reflect; its travel time is exact. Steel and joints lose the same share of their energy in
every cycle, by the one law that does so and is causal, a modulus that rises as a power of s [1]_; it has its stated
size at 100 Hz. Everything else loses by dashpots.

References
----------
.. [1] E. Kjartansson, Constant Q-wave propagation and attenuation, J. Geophys. Res. 84, 1979.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.hidden_effects.truth.axis import Axis, Setting

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Spectrum = ComplexArray | float  # 0.0 where there is none

STEEL_LOSS_FACTOR = 1e-3  # of the screw, 1/Q
REFERENCE_FREQUENCY = 100.0  # where moduli and stiffnesses are as stated [Hz]


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Frequencies, and how the stiffness of steel and joints varies over them; shape (n_lines,)."""

    s: ComplexArray  # jω [rad/s]
    steel: ComplexArray
    joints: ComplexArray


def lines_of(axis: Axis, frequency: FloatArray) -> Lines:
    """Return the lines of frequencies above zero."""
    s = 2j * math.pi * np.asarray(frequency, dtype=np.float64)
    h = axis.hidden
    joints = lossy(s, h.loss_factor) + 1j * h.constant_loss_factor
    return Lines(s, lossy(s, h.screw_loss_factor or STEEL_LOSS_FACTOR), joints)


def lossy(s: ComplexArray, loss_factor: float) -> ComplexArray:
    """Return the factor of a stiffness whose loss factor is the same at every frequency, of size 1 at 100 Hz."""
    return np.asarray((s / (2.0 * math.pi * REFERENCE_FREQUENCY)) ** (2.0 / math.pi * math.atan(loss_factor)))


@dataclass(frozen=True, slots=True, eq=False)
class HeldRod:
    """Dynamic stiffness of a rod between the nut and a spring at its end, on a body behind the spring."""

    at_nut: ComplexArray  # force at the nut per motion there, the body held
    across: ComplexArray | float  # force at one per motion of the other
    at_body: ComplexArray | float  # force on the body per motion of it, the nut held


def held_rod(s: ComplexArray, rigidity: ComplexArray, inertia: float, length: float, spring: Spectrum) -> HeldRod:
    """Return what a wave finds that leaves the nut and is reflected where the rod ends.

    Parameters
    ----------
    s : ndarray, shape (n_lines,)
        jω. [rad/s]
    rigidity : ndarray, shape (n_lines,)
        E S or G J. [N or N·m²]
    inertia : float
        Mass or moment of inertia per length. [kg/m or kg·m]
    length : float
        From the nut to the end. [m]
    spring : ndarray, shape (n_lines,), or float
        Between the end and the body; 0 for a free end. [N/m or N·m/rad]
    """
    wave_stiffness = s * np.sqrt(rigidity * inertia)  # force per motion of a wave that never comes back
    passage = np.exp(-s * np.sqrt(inertia / rigidity) * length)
    there_and_back = passage * passage
    reflection = (wave_stiffness - spring) / (wave_stiffness + spring)
    arriving = 1.0 + reflection * there_and_back
    at_nut = wave_stiffness * (1.0 - reflection * there_and_back) / arriving
    if isinstance(spring, float):
        return HeldRod(at_nut, 0.0, 0.0)
    end = wave_stiffness * (1.0 + there_and_back) / (1.0 - there_and_back)
    return HeldRod(at_nut, -spring * (1.0 + reflection) * passage / arriving, spring * end / (spring + end))


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """The axis at one setting, as torque, force on the table and force in the nut find it; shape (n_lines,)."""

    s: ComplexArray
    lever: ComplexArray  # travel of the unloaded nut per torque at the rotor [m/(N·m)]
    turning: ComplexArray  # angle of the rotor per torque while the nut is unloaded [rad/(N·m)]
    compliance: ComplexArray  # of everything between the nut's force and ground, the table apart [m/N]
    nut: ComplexArray  # its spring and damper [N/m]
    table: ComplexArray  # dynamic stiffness of table, guides and absorber [N/m]
    nut_body: Spectrum  # dynamic stiffness of what is between nut and bracket [N/m]
    bracket: ComplexArray  # behind it, a part of the compliance [m/N]
    riding: Spectrum  # motion of the structure under the table per torque [m/(N·m)]
    late: Spectrum  # of the recorded torque, what acts
    sensor: Spectrum  # what the accelerometer makes of an acceleration
    clock: Spectrum  # what the recorder makes of an angle

    def nut_force(self, torque: Spectrum, on_table: Spectrum = 0.0, in_nut: Spectrum = 0.0) -> ComplexArray:
        """Return the force through the nut under an acting torque, a force on the table and one beside the nut's."""
        drive = self.lever * torque + in_nut / self.nut
        if isinstance(self.nut_body, float):
            return np.asarray((self.table * drive - on_table) / (1.0 + self.compliance * self.table))
        felt = self.nut_body + 1.0 / (self.bracket + 1.0 / self.table)
        passed_on = on_table / (1.0 + self.bracket * self.table)
        return np.asarray((felt * drive - passed_on) / (1.0 + (self.compliance - self.bracket) * felt))

    def table_travel(self, torque: Spectrum, on_table: Spectrum = 0.0, in_nut: Spectrum = 0.0) -> ComplexArray:
        """Return the travel of the table, relative to what it rides on."""
        if not isinstance(self.nut_body, float):
            force = self.nut_force(torque, on_table, in_nut)
            drive = self.lever * torque + in_nut / self.nut
            at_nut = drive - (self.compliance - self.bracket) * force
            return np.asarray((force - self.nut_body * at_nut + on_table) / self.table)
        drive = self.lever * torque + in_nut / self.nut + self.compliance * on_table
        return np.asarray(drive / (1.0 + self.compliance * self.table))

    def deflection(self, torque: Spectrum, on_table: Spectrum = 0.0, in_nut: Spectrum = 0.0) -> ComplexArray:
        """Return the deflection of the nut."""
        return np.asarray((self.nut_force(torque, on_table, in_nut) - in_nut) / self.nut)

    def seen(self, recorded: Spectrum, on_table: Spectrum = 0.0, in_nut: Spectrum = 0.0) -> tuple[ComplexArray, ...]:
        """Return acceleration of the table as sensed and angle of the rotor under a recorded torque."""
        torque = self.late * recorded
        travel = self.table_travel(torque, on_table, in_nut) + self.riding * torque
        angle = self.turning * torque - self.lever * self.nut_force(torque, on_table, in_nut)
        return np.asarray(self.sensor * self.s**2 * travel), np.asarray(self.clock * angle)


def network_of(axis: Axis, setting: Setting, lines: Lines) -> Network:
    """Return the linear axis at one setting."""
    p, h, s = axis.parts_at(setting), axis.hidden, lines.s
    lead_ratio = p.screw_lead / (2.0 * math.pi)
    lever, turning, torsion = _torsion(axis, setting, lines)
    nut = nut_stiffness(axis, setting) * lines.joints + s * p.nut_damping
    series = (1.0 / p.bracket_stiffness + h.series_compliance) / lines.joints
    bent: Spectrum = 0.0
    for mode in axis.bending(position_of(axis, setting)):
        bent = bent + mode.at_nut**2 / _on_spring(s, mode.mass, mode.omega / (2.0 * math.pi), mode.damping_ratio)
    structure: Spectrum = 0.0
    if h.structure_residue:
        structure = 1.0 / (
            lead_ratio * _on_spring(s, 1.0 / h.structure_residue, h.structure_frequency, h.structure_damping_ratio)
        )
    sensor: Spectrum = 1.0
    if math.isfinite(h.mounting_frequency):
        spring = _spring_of(s, 1.0, h.mounting_frequency, h.mounting_damping_ratio)
        sensor = spring / (spring + s**2)
    nut_body: Spectrum = 0.0
    if h.nut_mass_before_bracket or h.nut_absorber_mass:
        nut_body = s**2 * h.nut_mass_before_bracket + _hanging(
            s, h.nut_absorber_mass, h.nut_absorber_frequency, h.nut_absorber_damping_ratio
        )
    return Network(
        s=s,
        lever=lever,
        turning=turning,
        compliance=1.0 / nut + series + 1.0 / _tension(axis, setting, lines) + lead_ratio**2 / torsion + bent,
        nut=nut,
        table=_table(axis, setting, s),
        nut_body=nut_body,
        bracket=series,
        riding=structure,
        late=np.exp(-s * h.torque_delay),
        sensor=sensor * np.exp(-s * h.response_delay) if h.response_delay else sensor,
        clock=np.exp(-s * h.angle_delay) if h.angle_delay else 1.0,
    )


def position_of(axis: Axis, setting: Setting) -> float:
    """Return where the nut truly is. [m]."""
    position = setting.position + axis.hidden.position_offset
    if not 0.0 < position < axis.parts.screw_length:
        raise ValueError(f"the nut must be on the screw, within 0 and {axis.parts.screw_length} m; got {position} m")
    return position


def nut_stiffness(axis: Axis, setting: Setting) -> float:
    """Return the stiffness of the nut for small deflections under what is left of the preload. [N/m]."""
    p, h = axis.parts_at(setting), axis.hidden
    turn = 2.0 * math.pi * setting.position / p.screw_lead
    preload = setting.preload + h.thermal_preload * setting.temperature_deviation
    preload *= 1.0 + h.periodic_preload * math.cos(turn - h.periodic_phase)
    preload *= 1.0 - h.preload_drift * setting.order
    if not preload > 0.0:
        raise ValueError(f"some preload must be left at every setting; got {preload} N")
    return 0.8 * p.nut_rigidity * (preload / p.rated_preload) ** (1.0 / 3.0 + h.preload_exponent_change)


def _tension(axis: Axis, setting: Setting, lines: Lines) -> ComplexArray:
    """Return the stiffness of the screw at the nut: both lengths with their bearings, on a base that may yield."""
    p, h, s = axis.parts_at(setting), axis.hidden, lines.s
    area = math.pi / 4.0 * p.screw_diameter**2
    rigidity = p.youngs_modulus * h.axial_modulus_factor * area * lines.steel
    position = position_of(axis, setting)
    far = p.far_bearing_stiffness + h.far_bearing_stiffness
    bearings = (
        p.bearing_stiffness * lines.joints + s * p.bearing_damping,
        far * lines.joints + s * p.far_bearing_damping,
    )
    at_end = _hanging(s, h.screw_end_absorber_mass, h.screw_end_absorber_frequency, h.screw_end_absorber_damping_ratio)
    if h.screw_end_absorber_mass and h.base_compliance:
        raise ValueError("here nothing hangs on the end of a screw whose bearings stand on a base that yields")
    lengths = position, p.screw_length - position
    bearings = bearings[0], bearings[1] + at_end
    rods = [held_rod(s, rigidity, p.density * area, *end) for end in zip(lengths, bearings, strict=True)]
    at_nut = rods[0].at_nut + rods[1].at_nut
    if not h.base_compliance:
        return at_nut
    mass = 1.0 / (h.base_compliance * (2.0 * math.pi * h.base_frequency) ** 2)
    base = _on_spring(s, mass, h.base_frequency, h.base_damping_ratio)
    across = rods[0].across + rods[1].across
    return np.asarray(at_nut - across**2 / (base + rods[0].at_body + rods[1].at_body))


def _torsion(axis: Axis, setting: Setting, lines: Lines) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return lever and turning of the unloaded nut, and the torsional stiffness at the nut, the rotor taking part."""
    p, h, s = axis.parts_at(setting), axis.hidden, lines.s
    polar = math.pi / 32.0 * p.screw_diameter**4
    rigidity = p.shear_modulus * polar / (1.0 + h.torsional_compliance_share) * lines.steel
    position = position_of(axis, setting)
    coupling = p.coupling_stiffness * lines.joints + s * p.coupling_damping
    near = held_rod(s, rigidity, p.density * polar, position, coupling)
    far = held_rod(s, rigidity, p.density * polar, p.screw_length - position, 0.0)
    rotor = s**2 * (p.motor_inertia + p.coupling_inertia) + s * (p.motor_damping + h.motor_damping)
    rotor = rotor + h.servo_stiffness + near.at_body
    rotor = rotor + _hanging(s, h.rotor_absorber_inertia, h.rotor_absorber_frequency, h.rotor_absorber_damping_ratio)
    free_screw = near.at_nut + far.at_nut
    at_nut = free_screw - near.across**2 / rotor
    unloaded = -near.across / (rotor * at_nut)  # angle at the nut per torque
    lever = p.screw_lead / (2.0 * math.pi) * unloaded
    return np.asarray(lever), np.asarray(free_screw / (rotor * at_nut)), np.asarray(at_nut)


def _table(axis: Axis, setting: Setting, s: ComplexArray) -> ComplexArray:
    p, h = axis.parts, axis.hidden
    mass = p.table_mass + p.nut_mass + h.added_mass + setting.payload + (h.payload_error if setting.payload else 0.0)
    mass -= h.nut_mass_before_bracket
    table = s**2 * mass + s * p.table_damping + h.guide_stiffness
    if h.absorber_mass:
        from_middle = position_of(axis, setting) - 0.5 * p.screw_length
        frequency = h.absorber_frequency * (1.0 + h.absorber_frequency_slope * from_middle)
        table = table + _hanging(s, h.absorber_mass, frequency, h.absorber_damping_ratio)
    return np.asarray(table)


def _hanging(s: ComplexArray, mass: float, frequency: float, damping_ratio: float) -> Spectrum:
    """Return the dynamic stiffness of a mass behind its spring and damper, as what it hangs on finds it."""
    if not mass:
        return 0.0
    spring = _spring_of(s, mass, frequency, damping_ratio)
    inertia = s**2 * mass
    return np.asarray(inertia * spring / (inertia + spring))


def _spring_of(s: ComplexArray, mass: float, frequency: float, damping_ratio: float) -> ComplexArray:
    """Return spring and damper that hold a mass at a natural frequency."""
    omega = 2.0 * math.pi * frequency
    return np.asarray(mass * (omega**2 + 2.0 * damping_ratio * omega * s))


def _on_spring(s: ComplexArray, mass: float, frequency: float, damping_ratio: float) -> ComplexArray:
    """Return the dynamic stiffness of a mass on its spring and damper."""
    return np.asarray(_spring_of(s, mass, frequency, damping_ratio) + s**2 * mass)
