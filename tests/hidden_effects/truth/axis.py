"""What the two plants are told of an axis: its parts, the mechanisms hidden in it, and how it is set. SI units."""

import math
from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True, kw_only=True)
class Parts:
    """The axis as its maker would describe it, and the value each part really has.

    Dampers are the mechanism of loss; ``nut_rigidity`` is K of the catalogue: the nut has 0.8 K (P/P_rated)^(1/3).
    """

    screw_length: float = 0.971
    screw_diameter: float = 0.0186
    screw_lead: float = 0.006
    youngs_modulus: float = 206e9
    shear_modulus: float = 79.2e9
    density: float = 7850.0
    table_mass: float = 20.54
    nut_mass: float = 1.3  # moves with the table
    motor_inertia: float = 1.6e-4
    coupling_inertia: float = 2e-5  # turns with the motor
    bearing_stiffness: float = 100e6
    far_bearing_stiffness: float = 0.0
    bracket_stiffness: float = 2.1e8  # in series with the nut
    nut_rigidity: float = 470e6
    rated_preload: float = 400.0  # a tenth of the dynamic load rating
    coupling_stiffness: float = 849.0
    bearing_damping: float = 3e3
    far_bearing_damping: float = 0.0
    nut_damping: float = 6e3  # beside the nut alone
    coupling_damping: float = 0.05
    table_damping: float = 150.0
    motor_damping: float = 2e-3


_N_BENDING, _BENDING_RATIO = 4, 0.01
#: What becomes softer in a warm machine.
_OF_WARMTH = (
    "youngs_modulus", "shear_modulus", "bearing_stiffness", "far_bearing_stiffness", "bracket_stiffness",
    "nut_rigidity", "coupling_stiffness",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Hidden:
    """Mechanisms that the maker's description lacks; absent at their defaults."""

    # of the catalogue
    added_mass: float = 0.0  # rigidly on the table [kg]
    payload_error: float = 0.0  # true payload less the stated one, wherever one is stated [kg]
    series_compliance: float = 0.0  # one more spring between nut and table [m/N]
    far_bearing_stiffness: float = 0.0  # a second bearing the description does not mention [N/m]
    axial_modulus_factor: float = 1.0  # of the stiffness of the screw in tension alone
    torsional_compliance_share: float = 0.0  # the screw twists so much more than G J gives [-]
    loss_factor: float = 0.0  # of all joints, as a chain of Maxwell elements that is flat over the band [-]
    guide_friction: float = 0.0  # Coulomb friction of the guides, solved in time [N]
    guide_stiffness: float = 0.0  # table to ground [N/m]
    preload_exponent_change: float = 0.0  # nut ∝ P^(1/3 + change), unchanged at the rated preload [-]
    thermal_preload: float = 0.0  # preload per temperature deviation [N/K]
    thermal_stiffness: float = 0.0  # relative change of every modulus and spring per temperature deviation [1/K]
    periodic_preload: float = 0.0  # preload varies by this share over each lead of the position tag [-]
    periodic_phase: float = 0.0  # [rad]: preload (1 + share cos(2πx/lead − phase))
    position_offset: float = 0.0  # true position less the stated one [m]
    torque_delay: float = 0.0  # the torque acts so much later than it is recorded [s]
    mounting_frequency: float = math.inf  # of the accelerometer on its mounting [Hz]
    mounting_damping_ratio: float = 0.05
    base_compliance: float = 0.0  # of a base that takes the reaction of both bearings [m/N]
    base_frequency: float = 60.0  # its mass follows from compliance and frequency [Hz]
    base_damping_ratio: float = 0.02
    servo_stiffness: float = 0.0  # rotor to ground [N·m/rad]
    cubic_nut_stiffness: float = 0.0  # β in nut force = k(1 + βδ²)δ, solved in time [1/m²]
    structure_residue: float = 0.0  # a structure that the drive's force moves and the table rides on [1/kg]
    structure_frequency: float = 300.0  # [Hz]
    structure_damping_ratio: float = 0.02
    absorber_mass: float = 0.0  # a mass on a spring on the table [kg]
    absorber_frequency: float = 300.0  # [Hz]
    absorber_damping_ratio: float = 0.02
    nut_absorber_mass: float = 0.0  # one that hangs on the nut, before the bracket [kg]
    nut_absorber_frequency: float = 300.0  # [Hz]
    nut_absorber_damping_ratio: float = 0.02
    nut_mass_before_bracket: float = 0.0  # of the moving mass, what sits between nut and bracket [kg]
    screw_loss_factor: float = 0.0  # of the whole screw; 0: what steel loses anyway, as each plant has it [-]
    #: Of all joints, with a stiffness that is the same at all frequencies: no motion in time has it, lines do.
    constant_loss_factor: float = 0.0  # [-]
    motor_damping: float = 0.0  # of the rotor, beyond what is described [N·m·s/rad]
    response_delay: float = 0.0  # by which the accelerometer is recorded late [s]
    angle_delay: float = 0.0  # by which the angle of the rotor is recorded late [s]
    # not in the catalogue
    absorber_frequency_slope: float = 0.0  # its frequency changes with the position of the table, relative per m [1/m]
    nut_softening: float = 0.0  # the nut loses this share of its stiffness where it is deflected much, solved in time
    nut_softening_deflection: float = 1e-7  # rms deflection scale at which half of it is lost [m]
    preload_drift: float = 0.0  # share of the preload lost from the first setting to the last [-]
    nut_backlash: float = 0.0  # half of the way over which the nut has no force, solved in time [m]
    nut_contact_loss: float = 0.0  # the nut loses this share of its stiffness where one side lifts off [-]
    nut_contact_deflection: float = 1e-7  # at which it does [m]
    #: The force of the nut acts so far beside the screw, which bends between supports that let it turn. [m]
    bend_eccentricity: float = 0.0
    coupling_crack: float = 0.0  # the coupling yields more, by so many times, where a crack opens, once a turn [-]
    wear: float = 0.0  # share of its preload that the nut lacks about a place of the screw [-]
    wear_at: float = 0.5  # of the length of the screw [-]
    wear_width: float = 0.05  # standard deviation of a bell, likewise; infinite: all beyond the place is worn alike [-]
    torque_limit: float = math.inf  # which the drive gives at the most, whatever is recorded [N·m]
    pitch_error: float = 0.0  # the travel per angle goes by this share with the position, one wave along it [-]
    pitch_waves: float = 1.0  # waves along the screw [-]
    belt_ratio: float = 1.0  # angle of the motor over angle of the screw, by a belt in the place of the coupling [-]
    belt_stiffness_share: float = 1.0  # of the coupling that is described [-]
    lost_mass: float = 0.0  # what the table carries less at the end of the test than at its beginning [kg]
    lost_at: float = math.nan  # share of the test after which it is lost at once; NaN: it goes steadily [-]
    rotor_absorber_inertia: float = 0.0  # what turns on a spring of its own behind the rotor [kg·m²]
    rotor_absorber_frequency: float = 300.0  # [Hz]
    rotor_absorber_damping_ratio: float = 0.02
    screw_end_absorber_mass: float = 0.0  # a mass on a spring at the far end of the screw, along it [kg]
    screw_end_absorber_frequency: float = 300.0  # [Hz]
    screw_end_absorber_damping_ratio: float = 0.02
    coupling_crack_phase: float = 0.0  # [rad]: compliance (1 + crack (1 + cos(2πx/lead − phase))/2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """How the axis is really set for one measurement."""

    position: float  # of the table from the fixed bearing, before any hidden offset [m]
    preload: float  # before any hidden change [N]
    payload: float = 0.0  # as stated [kg]
    temperature_deviation: float = 0.0  # [K]
    excitation_rms: float = 0.05  # of the torque at the motor [N·m]
    order: float = 0.0  # 0 for the first measurement of the test, 1 for the last


@dataclass(frozen=True, slots=True)
class Bending:
    """A mode in which the screw bends."""

    mass: float  # [kg]
    omega: float  # [rad/s]
    damping_ratio: float  # [-]
    at_nut: float  # travel of the nut along the screw per deflection of the mode [-]


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """A machine: the parts it really has and what is hidden in it."""

    parts: Parts
    hidden: Hidden = Hidden()

    def parts_at(self, setting: Setting) -> Parts:
        """Return the parts as warm as they are at a setting."""
        factor = 1.0 + self.hidden.thermal_stiffness * setting.temperature_deviation
        warm = replace(self.parts, **{name: factor * getattr(self.parts, name) for name in _OF_WARMTH})
        turn = 2.0 * math.pi * setting.position / warm.screw_lead - self.hidden.coupling_crack_phase
        opened = 0.5 * self.hidden.coupling_crack * (1.0 + math.cos(turn))
        wave = math.sin(2.0 * math.pi * self.hidden.pitch_waves * setting.position / warm.screw_length)
        coupling = self.hidden.belt_stiffness_share * warm.coupling_stiffness / (1.0 + opened)
        lead = warm.screw_lead * (1.0 + self.hidden.pitch_error * wave)
        return replace(warm, coupling_stiffness=coupling, screw_lead=lead)

    def worn(self, setting: Setting) -> float:
        """Return what is left of the preload where the screw is worn. [-]."""
        hidden = self.hidden
        away = setting.position / self.parts.screw_length - hidden.wear_at
        if math.isinf(hidden.wear_width):
            return 1.0 - hidden.wear * (away > 0.0)
        return 1.0 - hidden.wear * math.exp(-0.5 * (away / hidden.wear_width) ** 2)

    def lost(self, setting: Setting) -> float:
        """Return what the table carries less than at the first setting. [kg]."""
        share = setting.order if math.isnan(self.hidden.lost_at) else float(setting.order > self.hidden.lost_at)
        return self.hidden.lost_mass * share

    def bending(self, position: float) -> tuple[Bending, ...]:
        r"""Return the modes in which the screw bends under a nut that pulls beside it; none without eccentricity.

        A beam on two supports that let it turn: :math:`\omega_n = (n\pi/L)^2 \sqrt{EI/\rho S}`, modal mass half of that
        of the screw, slope at the nut :math:`(n\pi/L) \cos(n\pi x/L)`.
        """
        if not self.hidden.bend_eccentricity:
            return ()
        parts = self.parts
        area, second = math.pi / 4.0 * parts.screw_diameter**2, math.pi / 64.0 * parts.screw_diameter**4
        of_length = math.sqrt(parts.youngs_modulus * second / (parts.density * area))
        mass = 0.5 * parts.density * area * parts.screw_length
        waves = [number * math.pi / parts.screw_length for number in range(1, _N_BENDING + 1)]
        eccentricity = self.hidden.bend_eccentricity
        return tuple(
            Bending(mass, wave**2 * of_length, _BENDING_RATIO, eccentricity * wave * math.cos(wave * position))
            for wave in waves
        )
