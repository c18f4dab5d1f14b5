"""Records of an axis for all families; every extra has a null value at which it is absent.

What the families disagree about is a number here: how much of the screw's mass and inertia is spread along it, how much
its torsion gives. What none of them has stands in :class:`AddedPhysics` and is absent at its default.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import acts
from monitor_core.errors import OutsideValidityError
from monitor_core.models.parameters import transmission_ratio
from monitor_core.models.published.receptance.parameters import JointParameters


@dataclass(frozen=True, slots=True, kw_only=True)
class ScrewPhysics:
    """A uniform rod in tension and in torsion, with Tian's rigid pieces at the nut and at the coupling."""

    length: float  # [m]
    lead: float  # [m]
    axial_rigidity: float  # E S [N]
    mass_per_length: float  # [kg/m]
    torsional_rigidity: float  # G J [N·m²]
    inertia_per_length: float  # [kg·m]
    axial_mass_share: float = 1.0  # of the mass that is spread along the rod; the rest moves with the table [-]
    torsional_inertia_share: float = 1.0  # of the inertia that is spread; the rest turns with the motor end [-]
    torsion_share: float = 1.0  # factor of the torsional compliance; 0: rigid in torsion [-]
    far_end_held_share: float = 0.0  # 1: torsional compliance times (L − x)/L, Eq. (3) of Nguyen et al. (2018)
    nut_segment_mass: float = 0.0  # rigid piece inside the nut [kg]
    nut_segment_inertia: float = 0.0  # [kg·m²]
    motor_segment_inertia: float = 0.0  # rigid piece at the coupling [kg·m²]
    causal_loss_factor: float = 0.0  # of its steel, in tension and torsion, with the stiffening it implies [-]

    def __post_init__(self) -> None:
        _require_positive(
            self, "length", "lead", "axial_rigidity", "mass_per_length", "torsional_rigidity", "inertia_per_length"
        )
        _require_not_negative(
            self, "torsion_share", "nut_segment_mass", "nut_segment_inertia", "motor_segment_inertia",
            "causal_loss_factor",
        )  # fmt: skip
        for name in ("axial_mass_share", "torsional_inertia_share", "far_end_held_share"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise OutsideValidityError(f"{name} must lie within 0 and 1; got {getattr(self, name)}")

    @property
    def transmission_ratio(self) -> float:
        """Travel per angle, i = lead/2π [m/rad]."""
        return transmission_ratio(self.lead)


@dataclass(frozen=True, slots=True, kw_only=True)
class JointPhysics(JointParameters):
    """Springs and dampers between screw, table, motor and ground.

    With a load rating ``nut_stiffness`` is the K of the catalogue; the loss factors are of all springs of this record.
    """

    far_bearing_stiffness: float = 0.0  # [N/m]
    dynamic_load_rating: float | None = None  # C_d; with it the nut follows the preload [N]
    causal_loss_factor: float = 0.0  # in addition to the loss factor, with the stiffening it implies [-]

    def __post_init__(self) -> None:
        _require_positive(self, "bearing_stiffness", "nut_stiffness", "coupling_stiffness")
        _require_not_negative(
            self, "far_bearing_stiffness", "bearing_damping", "far_bearing_damping", "nut_damping", "coupling_damping",
            "loss_factor", "causal_loss_factor",
        )  # fmt: skip
        if not self.bracket_stiffness > 0.0:
            raise OutsideValidityError(f"bracket_stiffness must be positive; got {self.bracket_stiffness} N/m")
        if self.dynamic_load_rating is not None:
            _require_positive(self, "dynamic_load_rating")


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyPhysics:
    """Rigid bodies, and their dampers to ground."""

    table_mass: float  # [kg]
    nut_mass: float = 0.0  # moves with the table [kg]
    rotor_inertia: float = 0.0  # motor and coupling [kg·m²]
    table_damping: float = 0.0  # [N·s/m]
    motor_damping: float = 0.0  # [N·m·s/rad]

    def __post_init__(self) -> None:
        _require_positive(self, "table_mass")
        _require_not_negative(self, "nut_mass", "rotor_inertia", "table_damping", "motor_damping")


#: Where something may hang on a spring, and what it has there.
_ABSORBERS = {"table": "mass", "nut": "mass", "rotor": "inertia", "screw_end": "mass"}


@dataclass(frozen=True, slots=True, kw_only=True)
class AddedPhysics:
    """What none of the published models has; every default is the value at which it is absent.

    A value that goes with another (frequency and damping ratio of the base, of the mounting, of the second mode, of an
    absorber) is without effect while that other one is null.
    """

    table_mass: float = 0.0  # on the table, unknown to the model [kg]
    nut_mass: float = 0.0  # of what moves with the table, what sits between contacts and bracket [kg]
    table_absorber_mass: float = 0.0  # of a mass on a spring that hangs on the table [kg]
    table_absorber_frequency: float = 0.0  # with the table held still [Hz]
    table_absorber_damping_ratio: float = 0.0  # [-]
    nut_absorber_mass: float = 0.0  # the same on the nut, before the bracket [kg]
    nut_absorber_frequency: float = 0.0  # [Hz]
    nut_absorber_damping_ratio: float = 0.0  # [-]
    rotor_absorber_inertia: float = 0.0  # of what turns on a spring of its own behind the rotor [kg·m²]
    rotor_absorber_frequency: float = 0.0  # with the rotor held still [Hz]
    rotor_absorber_damping_ratio: float = 0.0  # [-]
    screw_end_absorber_mass: float = 0.0  # of a mass on a spring at the far end of the screw, along it [kg]
    screw_end_absorber_frequency: float = 0.0  # with the end held still [Hz]
    screw_end_absorber_damping_ratio: float = 0.0  # [-]
    payload_error: float = 0.0  # true payload less the stated one, wherever one is stated [kg]
    series_compliance: float = 0.0  # in the force path, with the loss factor of the joints [m/N]
    guide_stiffness: float = 0.0  # table to ground [N/m]
    guide_friction: float = 0.0  # Coulomb friction F_c of the guides [N]
    servo_stiffness: float = 0.0  # rotor to ground, where the rotor takes part [N·m/rad]
    base_compliance: float = 0.0  # of what the reaction of the force path pushes [m/N]
    base_frequency: float = math.inf  # of its mass on that spring; infinite: massless [Hz]
    base_damping_ratio: float = 0.0  # [-]
    preload_exponent_change: float = 0.0  # δ in rigidity ∝ preload^(1/3 + δ), K unchanged at 0.1 C_d [-]
    preload_change: float = 0.0  # true preload less the stated one, wherever one is stated [N]
    thermal_preload: float = 0.0  # preload per temperature deviation [N/K]
    thermal_stiffness: float = 0.0  # relative change of all springs and of the screw per temperature deviation [1/K]
    periodic_preload_cosine: float = 0.0  # relative amplitude over one lead, cos 2πx/lead of the stated position [-]
    periodic_preload_sine: float = 0.0  # [-]
    position_offset: float = 0.0  # true position less the stated one [m]
    torque_delay: float = 0.0  # by which a torque acts later than it is recorded [s]
    response_delay: float = 0.0  # by which what table or nut do is recorded later than it is done [s]
    angle_delay: float = 0.0  # the same of the angle of the motor [s]
    response_ln_factor: float = 0.0  # ln of recorded over true response of table or nut, by another unit [-]
    torque_ln_factor: float = 0.0  # ln of recorded over true torque, by another unit [-]
    mounting_inverse_square: float = 0.0  # 1/(2πf)² of the accelerometer on its mounting [s²]
    mounting_damping_ratio: float = 0.0  # [-]
    cubic_nut_stiffness: float = 0.0  # β in nut force = k(1 + β δ²) δ [1/m²]
    second_mode_residue: float = 0.0  # φ² of one more mode, driven and seen at the table [1/kg]
    second_mode_frequency: float = 0.0  # [Hz]
    second_mode_damping_ratio: float = 0.0  # [-]

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if not math.isfinite(value) and name != "base_frequency":
                raise OutsideValidityError(f"{name} must be finite; got {value}")
        _require_not_negative(
            self, "guide_friction", "base_compliance", "base_damping_ratio", "mounting_inverse_square",
            "mounting_damping_ratio", "second_mode_damping_ratio", "nut_mass", "table_absorber_mass",
            "table_absorber_damping_ratio", "nut_absorber_mass", "nut_absorber_damping_ratio", "rotor_absorber_inertia",
            "rotor_absorber_damping_ratio", "screw_end_absorber_mass", "screw_end_absorber_damping_ratio",
        )  # fmt: skip
        for place, body in _ABSORBERS.items():
            frequency = getattr(self, f"{place}_absorber_frequency")
            if getattr(self, f"{place}_absorber_{body}") and not frequency > 0.0:
                raise OutsideValidityError(
                    f"{place}_absorber_frequency must be positive where the absorber has a {body}; got {frequency} Hz"
                )
        if not self.base_frequency > 0.0:
            raise OutsideValidityError(f"base_frequency must be positive; got {self.base_frequency} Hz")
        if self.second_mode_residue and not self.second_mode_frequency > 0.0:
            raise OutsideValidityError(
                f"second_mode_frequency must be positive where the mode has a residue; got {self.second_mode_frequency}"
                " Hz"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class ScrewBending:
    """How a screw bends under the force in the nut; without compliance it does not, and nothing else here counts.

    :mod:`monitor_core.models.extended.bending` says what the nut then gives way by.
    """

    compliance: float = 0.0  # of the first mode, along the screw, where the nut moves it most [m/N]
    frequency: float = 1.0  # of the first mode [Hz]
    damping_ratio: float = 0.0  # of every mode [-]
    #: Compliances of the modes that follow, of that of the first; a moment has 1/n², a force across the screw 1/n⁴. [-]
    share_2: float = 1.0 / 4.0
    share_3: float = 1.0 / 9.0
    share_4: float = 1.0 / 16.0
    share_5: float = 1.0 / 25.0

    def __post_init__(self) -> None:
        _require_positive(self, "frequency")
        _require_not_negative(self, "compliance", "damping_ratio", "share_2", "share_3", "share_4", "share_5")

    @property
    def shares(self) -> tuple[float, ...]:
        """Compliances of all modes, of that of the first. [-]."""
        return 1.0, self.share_2, self.share_3, self.share_4, self.share_5


@dataclass(frozen=True, slots=True, kw_only=True)
class SecondAxis:
    """The other axis of two that are stacked, its motor free to turn: it stands on this one's table, or this on its.

    The table of the lower one slides on its guides and, where they yield, yaws about their centre: the table of the
    upper one, which it carries along and across, is then the farther out the farther it is driven. A payload is on the
    upper table, whichever axis is described. Lateral offsets of screws count to the left of their directions, that of
    the upper one being to the left of the lower one's.
    """

    physics: "AxisPhysics"
    carried: bool  # it is the upper one
    position: float  # of its table from its fixed bearing [m]
    direction_cosine: float = 1.0  # of the angle between both axes; 1: parallel, 0: at right angles [-]
    yaw_stiffness: float = math.inf  # of the guides of the lower one [N·m/rad]
    yaw_damping: float = 0.0  # [N·m·s/rad]
    yaw_inertia: float = 0.0  # of the lower table with what it carries that does not slide, about that centre [kg·m²]
    lower_offset: float = 0.0  # of the lower screw from that centre [m]
    upper_offset: float = 0.0  # of the upper screw [m]
    upper_centre: float = 0.0  # position of the upper table at which it is over that centre [m]

    def __post_init__(self) -> None:
        if not 0.0 < self.position < self.physics.screw.length:
            raise OutsideValidityError(
                f"position must lie on the screw, within 0 and {self.physics.screw.length} m; got {self.position} m"
            )
        _require_not_negative(self, "direction_cosine", "yaw_damping", "yaw_inertia")
        if self.direction_cosine > 1.0:
            raise OutsideValidityError(f"direction_cosine must lie within 0 and 1; got {self.direction_cosine}")
        if math.isfinite(self.yaw_stiffness):
            _require_positive(self, "yaw_stiffness", "yaw_inertia")

    @property
    def is_alone(self) -> bool:
        """Whether neither axis moves the other: at right angles on guides that do not yield."""
        return self.direction_cosine == 0.0 and math.isinf(self.yaw_stiffness)


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisSetting:
    """How an axis is set while it is measured, as far as its physics may depend on it."""

    position: float  # of the table from the fixed bearing [m]
    preload: float = 0.0  # 0 where none is stated [N]
    payload_mass: float = 0.0  # [kg]
    temperature_deviation: float = 0.0  # [K]
    excitation_level: float = 0.0  # [N·m or N]
    order: float = 0.0  # share of the measurements that came before, 0 for the first to 1 for the last [-]


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisPhysics:
    """An axis: its screw, its joints, its bodies, and what is added to them."""

    screw: ScrewPhysics
    joints: JointPhysics
    bodies: BodyPhysics
    added: AddedPhysics = field(default_factory=AddedPhysics)
    bending: ScrewBending = field(default_factory=ScrewBending)
    second: SecondAxis | None = None
    #: What depends on how the axis is set, in order: each returns the axis as it is there.
    by_setting: "tuple[Callable[[AxisPhysics, AxisSetting], AxisPhysics], ...]" = ()

    def __post_init__(self) -> None:
        if self.second is None:
            return
        upper = self.second.physics if self.second.carried else self
        to_ground = upper.bodies.table_damping, upper.added.guide_stiffness, upper.added.guide_friction
        if any(map(acts, to_ground)) or (upper is self and acts(self.added.base_compliance)):
            raise OutsideValidityError(
                "an axis that stands on another one must have no table damping, guide stiffness, guide friction or "
                "base compliance, which act to the ground"
            )

    def at(self, index: npt.NDArray[np.intp]) -> "AxisPhysics":
        """Return the axis repeated for lines that belong to the conditions of this index: it is the same in all."""
        del index
        return self


Physics = TypeVar("Physics")


@dataclass(frozen=True, slots=True, eq=False)
class Move(Generic[Physics]):
    """The axes behind and ahead of another one on a way that it may go, and how far they are apart on it."""

    behind: Physics
    ahead: Physics
    distance: float


def moving_mass(axis: AxisPhysics) -> float:
    """Return the mass of table and nut with what is added to the table, without payload and screw, in kilograms."""
    return axis.bodies.table_mass + axis.bodies.nut_mass + axis.added.table_mass


def _require_positive(record: object, *names: str) -> None:
    for name in names:
        if not (math.isfinite(value := getattr(record, name)) and value > 0.0):
            raise OutsideValidityError(f"{name} must be positive and finite; got {value}")


def _require_not_negative(record: object, *names: str) -> None:
    for name in names:
        if not (math.isfinite(value := getattr(record, name)) and value >= 0.0):
            raise OutsideValidityError(f"{name} must be finite and not negative; got {value}")
