"""Compute the state of an axis under many conditions: position, moving mass, rigidity of the nut."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import BoolArray, FloatArray, acts
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended.physics import AxisPhysics, AxisSetting
from monitor_core.models.protocol import DriveConditions, MotorEnd

#: The true preload may exceed a stated 10 % of the rating; it is searched up to this factor of it. [-]
_BEYOND_RATED = 1.2


@dataclass(frozen=True, slots=True, eq=False)
class ConditionArrays:
    """Conditions side by side; all of shape (n_conditions,)."""

    position: FloatArray  # as stated [m]
    preload: FloatArray  # 0 where none is stated [N]
    preload_stated: BoolArray
    payload_mass: FloatArray  # [kg]
    temperature_deviation: FloatArray  # [K]
    excitation_level: FloatArray  # [N·m or N]
    order: FloatArray  # share of the measurements that came before; 0 where nothing is known of it [-]

    def at(self, cases: npt.NDArray[np.intp]) -> "ConditionArrays":
        """Return the conditions of some cases."""
        return ConditionArrays(*(getattr(self, item.name)[cases] for item in fields(self)))

    def setting(self, case: int) -> AxisSetting:
        """Return how the axis is set in one case."""
        return AxisSetting(**{item.name: float(getattr(self, item.name)[case]) for item in fields(AxisSetting)})


@dataclass(frozen=True, slots=True, eq=False)
class AxisStates:
    """What follows from the physics of the axis; of shape (n_conditions,), or (n_lines,) after :meth:`at`."""

    position: FloatArray  # of the table from the fixed bearing [m]
    moving_mass: FloatArray  # of table, nut, payload on it and what of the screw moves with them [kg]
    payload_mass: FloatArray  # on the table of a second axis that this one carries; else 0, it is on this one's [kg]
    nut_stiffness: FloatArray  # rigidity under the preload, at the reference temperature [N/m]
    softening: FloatArray  # springs and screw over what they are at the reference temperature; () where 1 [-]

    def at(self, index: npt.NDArray[np.intp]) -> "AxisStates":
        """Return the states repeated for lines that belong to the conditions of this index."""
        softening = self.softening[index] if self.softening.ndim else self.softening
        masses = self.moving_mass[index], self.payload_mass[index]
        return AxisStates(self.position[index], *masses, self.nut_stiffness[index], softening)


@dataclass(frozen=True, slots=True, eq=False)
class EndMasks:
    """Which of the three holds the motor end: one of them is 1, the others 0; of shape (n_lines,)."""

    prescribed: FloatArray
    clamped: FloatArray
    free: FloatArray

    def at(self, index: npt.NDArray[np.intp]) -> "EndMasks":
        """Return the masks repeated for lines that belong to the motor ends of this index."""
        return EndMasks(self.prescribed[index], self.clamped[index], self.free[index])


def condition_arrays(conditions: Sequence[DriveConditions]) -> ConditionArrays:
    """Put conditions side by side."""
    return ConditionArrays(
        position=np.array([stated.position for stated in conditions]),
        preload=np.array([stated.preload or 0.0 for stated in conditions]),
        preload_stated=np.array([stated.preload is not None for stated in conditions], dtype=np.bool_),
        payload_mass=np.array([stated.payload_mass for stated in conditions]),
        temperature_deviation=np.array([stated.temperature_deviation for stated in conditions]),
        excitation_level=np.array([stated.excitation_level for stated in conditions]),
        order=np.zeros(len(conditions)),
    )


def end_masks(motor_ends: Sequence[MotorEnd]) -> EndMasks:
    """Return the masks of motor ends."""
    return EndMasks(
        *(
            np.array([end is kind for end in motor_ends], dtype=np.float64)
            for kind in (MotorEnd.PRESCRIBED, MotorEnd.CLAMPED, MotorEnd.FREE)
        )
    )


def axis_states(physics: AxisPhysics, conditions: ConditionArrays) -> AxisStates:
    """Return position, moving mass and nut rigidity under all conditions.

    ``OutsideValidityError`` if a position is not on the screw, a moving mass or the stiffness that warmth leaves is not
    positive, or preload and load rating do not go together.
    """
    screw, bodies, added = physics.screw, physics.bodies, physics.added
    position = conditions.position + added.position_offset
    if not np.all((position > 0.0) & (position < screw.length)):
        off = position[np.argmax(np.abs(position - 0.5 * screw.length))]
        raise OutsideValidityError(
            f"position must lie on the screw, within 0 and {np.max(screw.length)} m; got {off} m"
        )
    with_table = (1.0 - screw.axial_mass_share) * screw.mass_per_length * screw.length
    payload = conditions.payload_mass + np.where(conditions.payload_mass > 0.0, added.payload_error, 0.0)
    above = 0.0 * payload  # followed through slopes as the payload is
    if physics.second is not None and physics.second.carried:
        payload, above = above, payload
    moving_mass = bodies.table_mass + bodies.nut_mass + with_table + added.table_mass + payload
    if not np.all(moving_mass > 0.0):
        raise OutsideValidityError(f"the moving mass must be positive; got {np.min(moving_mass):g} kg")
    if not np.all(moving_mass > added.nut_mass):
        raise OutsideValidityError(
            f"nut_mass must be less than all that moves, {np.min(moving_mass):g} kg; got {np.max(added.nut_mass):g} kg"
        )
    softening = np.array(1.0)
    if acts(added.thermal_stiffness):
        softening = softening + added.thermal_stiffness * conditions.temperature_deviation
    if not np.all(softening > 0.0):
        raise OutsideValidityError(
            f"springs must keep some stiffness at every temperature; got {np.min(softening):g} times the stated one"
        )
    return AxisStates(position, moving_mass, above, nut_rigidities(physics, conditions), softening)


def nut_rigidities(physics: AxisPhysics, conditions: ConditionArrays) -> FloatArray:
    r"""Return the rigidity of the nut under all conditions in newtons per metre, shape (n_conditions,).

    .. math::

        k_{nut} = 0.8 K \left( \frac{P_e}{0.1\,C_d} \right)^{1/3 + \delta}, \qquad
        P_e = (P + \Delta P + k_\vartheta \Delta\vartheta)
        \left( 1 + a \cos\frac{2\pi x}{l} + b \sin\frac{2\pi x}{l} \right)

    Eq. (1) of Nguyen et al. (2018) with the preload that exponent, temperature and lead make of the stated one. A nut
    without load rating has the stated rigidity; a preload that varies over the lead varies it as the cube root.

    ``OutsideValidityError`` if a preload and a load rating do not go together, the stated preload exceeds 10 % of the
    rating, nothing is left of the preload, or exponent or temperature act on a preload that is not stated.
    """
    joints, added = physics.joints, physics.added
    turn = 2.0 * np.pi / physics.screw.lead * conditions.position
    over_lead = 1.0 + added.periodic_preload_cosine * np.cos(turn) + added.periodic_preload_sine * np.sin(turn)
    if not np.all(over_lead > 0.0):
        raise OutsideValidityError(
            f"the preload must stay positive over the lead; got {np.min(over_lead):g} times the stated preload"
        )
    exponent = 1.0 / 3.0 + added.preload_exponent_change
    rating = joints.dynamic_load_rating
    if rating is None:
        if np.any(conditions.preload_stated):
            raise OutsideValidityError(
                "a preload has no effect on an axis without dynamic_load_rating; state the rating"
            )
        if acts(added.preload_exponent_change) or acts(added.preload_change) or acts(added.thermal_preload):
            raise OutsideValidityError(
                "preload_exponent_change, preload_change and thermal_preload act on the preload; "
                "state dynamic_load_rating and preload"
            )
        as_stated: FloatArray = joints.nut_stiffness * over_lead**exponent
        return as_stated
    if not np.all(conditions.preload_stated):
        raise OutsideValidityError("the nut rigidity of this axis follows the preload; state the preload")
    rated = 0.1 * rating
    highest = float(np.max(conditions.preload))
    if highest > rated * _BEYOND_RATED:
        raise OutsideValidityError(
            f"preload must not exceed 10 % of the dynamic load rating, {rated:g} N; got {highest:g} N"
        )
    preload = conditions.preload + added.preload_change + added.thermal_preload * conditions.temperature_deviation
    if not np.all(preload > 0.0):
        raise OutsideValidityError(f"the preload must stay positive at every temperature; got {np.min(preload):g} N")
    of_preload: FloatArray = 0.8 * joints.nut_stiffness * (preload * over_lead / rated) ** exponent
    return of_preload
