"""Answer as a drive model: a published family, its parameters as physics of the drive, and the effects."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cache

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray, NumberArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.ball_screw import BallScrew
from monitor_core.models.extended.closed_form import entire_parts, path_of, receptances_of, second_table_per_force
from monitor_core.models.extended.conditions import axis_states, condition_arrays, end_masks
from monitor_core.models.extended.lines import ResponseCase, prepare_lines
from monitor_core.models.extended.modes import drive_modes, has_rigid_body_mode, natural_frequencies, with_damping
from monitor_core.models.extended.physics import AxisPhysics, BodyPhysics, JointPhysics, ScrewPhysics
from monitor_core.models.extended.responses import responses
from monitor_core.models.extended.settings import axis_at
from monitor_core.models.parameters import DriveParameters
from monitor_core.models.poles import circles_around
from monitor_core.models.protocol import (
    DriveConditions,
    DriveModel,
    ExcitationPoint,
    MotorEnd,
    NaturalFrequency,
    NormalModes,
    ResponsePoint,
    motor_end_of,
    quantity_of,
    require_frequencies,
)
from monitor_core.models.published.lumped import LumpedParameters
from monitor_core.response import FrequencyResponse


def physics_of(parameters: DriveParameters) -> AxisPhysics:
    """Return the physics of a model of one of the four families, nothing added.

    *Lumped* and *receptance*: the same responses to rounding. *Transmission line*: to its discretisation, 1 ppm of the
    first natural frequency where E/G = (8/5)², up to 8.5 ppm for other steels. *Hybrid*: the same axis with a screw
    that deforms as it will and not as under a static load; the hybrid model's elastic mode lies higher, by up to 0.65 %
    with a free motor end, 0.15 % with a clamped one and 3.4 % with a prescribed torque on the paper's axis. Other
    records raise ``OutsideValidityError``.
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


#: What is added to responses, but is no property of a mode: see :class:`AddedPhysics`.
_NOT_IN_MODES = (
    "guide_friction", "cubic_nut_stiffness", "torque_delay", "response_delay", "angle_delay",
    "response_ln_factor", "torque_ln_factor",
    "mounting_inverse_square", "second_mode_residue",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class ExtendedModel:
    """A drive of one of the families with effects that the family does not have.

    With ``physics_of(parameters)`` it is that family's model, see there how closely. Modes are given up to
    ``highest_frequency``. The rotational mode of Eq. (7) of Nguyen et al. (2018), which moves neither table nor motor,
    is not among them. Friction and hardening of the nut see an excitation that is flat over the frequencies of a
    response; ``OutsideValidityError`` also if friction holds the table.
    """

    parameters: DriveParameters  # of the family
    physics: AxisPhysics
    highest_frequency: float = 2000.0  # [Hz]

    @classmethod
    def of(cls, parameters: DriveParameters) -> "ExtendedModel":
        """Return the family's own model in extended form."""
        return cls(parameters, physics_of(parameters))

    def frequency_response(
        self,
        frequency: FloatArray,
        conditions: DriveConditions,
        *,
        excitation: ExcitationPoint,
        response: ResponsePoint,
    ) -> FrequencyResponse:
        """Return the response at rising frequencies [Hz]; a force at the table finds the motor end as in the paper."""
        frequency = require_frequencies(frequency)
        motor_end = motor_end_of(excitation, otherwise=paper_motor_end(self.parameters))
        lines = prepare_lines([ResponseCase(frequency, conditions, excitation, response, motor_end)])
        return FrequencyResponse(frequency, responses(self.physics, lines), quantity_of(excitation, response))

    def second_table_per_force(self, frequency: FloatArray, conditions: DriveConditions) -> ComplexArray:
        """Return how far the table of a second axis that this one carries goes per force at this table [m/N]."""
        omega = 2.0 * np.pi * require_frequencies(frequency)
        line = np.zeros(omega.size, dtype=np.intp)
        states = axis_states(self.physics, condition_arrays([conditions])).at(line)
        ends = end_masks([paper_motor_end(self.parameters)]).at(line)
        return np.asarray(second_table_per_force(self.physics, omega, states, ends), dtype=np.complex128)

    def natural_frequencies(
        self, conditions: DriveConditions, motor_end: MotorEnd | None = None
    ) -> tuple[NaturalFrequency, ...]:
        """Return the poles for small signals in order of frequency; ``None`` stands for the paper's motor end."""
        return self.natural_frequencies_under([conditions], motor_end)[0]

    def natural_frequencies_under(
        self, conditions: Sequence[DriveConditions], motor_end: MotorEnd | None = None
    ) -> tuple[tuple[NaturalFrequency, ...], ...]:
        """Return the same under several conditions, in hardly more time than under one."""
        ends = [motor_end or paper_motor_end(self.parameters)] * len(conditions)
        return natural_frequencies(self.physics, conditions, ends, self.highest_frequency)

    def normal_modes(self, conditions: DriveConditions, motor_end: MotorEnd | None = None) -> NormalModes:
        """Return the undamped modes for small signals; nothing of ``_NOT_IN_MODES`` must have been added."""
        excluded = [name for name in _NOT_IN_MODES if getattr(self.physics.added, name)]
        excluded += ["a second axis"] if self.physics.second is not None else []
        if excluded:
            raise OutsideValidityError(
                f"normal modes cannot include {excluded[0]}; use the frequency response, or leave that effect out"
            )
        if self.physics.by_setting:
            here = axis_at(self.physics, condition_arrays([conditions]).setting(0))
            return replace(self, physics=here).normal_modes(conditions, motor_end)
        end = motor_end or paper_motor_end(self.parameters)
        modes = drive_modes(self.physics, [conditions], [end], self.highest_frequency)
        table, motor, across = self._residues(modes.undamped_omega, conditions, end)
        rigid_table, rigid_motor = self._rigid_body(conditions, end)
        none = np.zeros(rigid_table.size)
        return NormalModes(
            np.r_[none, modes.undamped_omega / (2.0 * math.pi)],
            np.r_[none, (0.0 - modes.pole.real) / np.abs(modes.pole)],
            np.r_[rigid_motor, np.copysign(np.sqrt(np.maximum(motor, 0.0)), across)],
            np.r_[rigid_table, np.sqrt(np.maximum(table, 0.0))],
        )

    def _residues(
        self, omega: FloatArray, conditions: DriveConditions, end: MotorEnd
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        r"""Return φ_a φ_b of table, motor end and both: means of :math:`(\omega_n^2 - \omega^2) H` around each pole."""
        offset = circles_around(omega)
        around = np.asarray(omega[:, None] + offset, dtype=np.complex128)
        line = np.zeros(around.size, dtype=np.intp)
        physics = with_damping(self.physics, 0.0)
        states = axis_states(physics, condition_arrays([conditions]))
        parts = entire_parts(physics, around.ravel(), states.at(line), end_masks([end]).at(line))
        receptances = receptances_of(path_of(parts))

        def mean(receptance: NumberArray) -> FloatArray:
            weighted = receptance.reshape(around.shape) * -offset * (around + omega[:, None])
            return np.asarray(np.mean(weighted, axis=1).real)

        return mean(receptances.table_per_force), mean(receptances.angle_per_torque), mean(receptances.table_per_torque)

    def _rigid_body(self, conditions: DriveConditions, end: MotorEnd) -> tuple[FloatArray, FloatArray]:
        """Return φ of table and motor end where the whole drive can turn, arrays of one element; else of none."""
        if not has_rigid_body_mode(self.physics, end):
            return np.zeros(0), np.zeros(0)
        screw, i = self.physics.screw, self.physics.screw.transmission_ratio
        added = self.physics.added
        mass = axis_states(self.physics, condition_arrays([conditions])).moving_mass
        mass = mass + added.table_absorber_mass + added.nut_absorber_mass
        rotor = self.physics.bodies.rotor_inertia + added.rotor_absorber_inertia if end is MotorEnd.FREE else 0.0
        turning = screw.inertia_per_length * screw.length + screw.nut_segment_inertia + screw.motor_segment_inertia
        scale = 1.0 / np.sqrt(turning + rotor + i**2 * mass)
        return i * scale, scale


def elastic_frequencies(
    model: DriveModel, conditions: Sequence[DriveConditions], motor_end: MotorEnd | None = None
) -> list[FloatArray]:
    """Return the natural frequencies above zero under each of the conditions, rising, shape (n_modes,) each [Hz]."""
    if isinstance(model, ExtendedModel):
        modes_of_each = model.natural_frequencies_under(conditions, motor_end)
    else:
        modes_of_each = tuple(model.natural_frequencies(stated, motor_end) for stated in conditions)
    return [np.array([mode.frequency for mode in modes if mode.frequency > 0.0]) for modes in modes_of_each]
