"""Parameters of Tian's drive, and the joints among them."""

import math
from dataclasses import dataclass, fields

from monitor_core.models.ball_screw import BallScrew, nut_rigidity
from monitor_core.models.parameters import DriveParameters
from monitor_core.models.protocol import DriveConditions

#: Joint parameters in the order of Eq. (25), as the rows of a gradient.
JOINT_NAMES = (
    "bearing_stiffness", "far_bearing_stiffness", "nut_stiffness", "coupling_stiffness",
    "bearing_damping", "far_bearing_damping", "nut_damping", "coupling_damping",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class JointParameters:
    """The joints, Eq. (25): what is identified, the order of the fields included.

    ``nut_stiffness`` is the rigidity of the nut under its preload; the bracket is in series with nut and nut damper.
    """

    bearing_stiffness: float  # k_al [N/m]
    far_bearing_stiffness: float  # k_ar [N/m]
    nut_stiffness: float  # k_n [N/m]
    coupling_stiffness: float  # k_m [N·m/rad]
    bearing_damping: float = 0.0  # c_al [N·s/m]
    far_bearing_damping: float = 0.0  # c_ar [N·s/m]
    nut_damping: float = 0.0  # c_n [N·s/m]
    coupling_damping: float = 0.0  # c_m [N·m·s/rad]
    bracket_stiffness: float = math.inf  # [N/m]
    loss_factor: float = 0.0  # of all springs [-]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReceptanceParameters(BallScrew, DriveParameters):
    """Parameters of Tian's drive: Table A, Table 3 and what an axis may have besides.

    Symbols of the paper: segments A and B are the screw on either side of the nut, F the rigid piece inside the nut,
    H the rigid piece at the coupling. The nut's mass moves with the table.
    """

    table_mass: float  # m_b [kg]
    screw_length: float  # L [m]
    screw_diameter: float  # d [m]
    screw_lead: float  # h [m]
    youngs_modulus: float  # E [Pa]
    shear_modulus: float  # G [Pa]
    density: float  # ρ [kg/m³]
    motor_inertia: float  # J_m [kg·m²]
    bearing_stiffness: float  # k_al [N/m]
    nut_stiffness: float  # k_n, or the catalogue's K where a load rating is stated [N/m]
    coupling_stiffness: float  # k_m [N·m/rad]
    far_bearing_stiffness: float = 0.0  # k_ar [N/m]
    bracket_stiffness: float = math.inf  # [N/m]
    dynamic_load_rating: float | None = None  # C_d [N]
    nut_mass: float = 0.0  # [kg]
    screw_nut_segment_mass: float = 0.0  # m_s [kg]
    screw_nut_segment_inertia: float = 0.0  # J_s [kg·m²]
    screw_motor_segment_inertia: float = 0.0  # J_j = J_sH [kg·m²]
    coupling_inertia: float = 0.0  # with the rotor [kg·m²]
    bearing_damping: float = 0.0  # c_al [N·s/m]
    far_bearing_damping: float = 0.0  # c_ar [N·s/m]
    nut_damping: float = 0.0  # c_n [N·s/m]
    coupling_damping: float = 0.0  # c_m [N·m·s/rad]
    table_damping: float = 0.0  # to ground [N·s/m]
    motor_damping: float = 0.0  # to ground [N·m·s/rad]
    loss_factor: float = 0.0  # of the joints' springs [-]

    def moving_mass(self, payload_mass: float) -> float:
        """Return what moves with the table under a payload. [kg]."""
        return self.table_mass + self.nut_mass + payload_mass

    def joints(self, conditions: DriveConditions) -> JointParameters:
        """Return the joints under the conditions: the nut's rigidity follows the preload where a rating is stated."""
        same = {item.name: getattr(self, item.name) for item in fields(JointParameters)}
        nut = nut_rigidity(self.nut_stiffness, conditions.preload, self.dynamic_load_rating)
        return JointParameters(**same | {"nut_stiffness": nut})
