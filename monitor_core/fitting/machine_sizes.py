"""Sizes of a described axis as it was measured, of which the ranges of effects are multiples."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from monitor_core.effects.sizes import MachineSizes, drive_sizes, motion_sizes
from monitor_core.fitting.observations import FrequencyResponseObservation, ModalObservation
from monitor_core.fitting.residuals.motion.comparison import MotionComparison
from monitor_core.models.extended import AxisPhysics, ScrewPhysics, moving_mass
from monitor_core.models.extended.conditions import condition_arrays, nut_rigidities
from monitor_core.models.protocol import DriveConditions, ExcitationPoint

#: Where nothing is stated. Nuts are set to 3 to 10 % of their dynamic load rating (catalogues; 10 % is the most). One
#: without a rating is preloaded as strongly as it is excited, or so that it yields by so much of the lead. [-]
_PRELOAD_OF_RATING = 0.055
_DEFLECTION_OF_LEAD = 1.2e-4
#: A payload that would be easy to put on the table, of the moving mass. [-]
_EASY_PAYLOAD = 0.27


def sizes_of_drive(
    axis: AxisPhysics, observations: Sequence[ModalObservation] | Sequence[FrequencyResponseObservation]
) -> MachineSizes:
    """Return the sizes of a drive from its description, and from the conditions under which it was measured.

    Preload and excitation are the median of those that were measured, the payload is the least. What was not stated is
    what is usual for such a machine: then nothing that was measured depends on it.
    """
    conditions = [observation.conditions for observation in observations]
    mass, ratio, screw = moving_mass(axis), axis.screw.transmission_ratio, axis.screw
    forces = _excitation_forces(observations, ratio)
    preload = _usual_preload(axis, conditions, forces)
    nut = _nut_rigidity(axis, preload)
    stiffness = _axial_stiffness(axis, nut)
    payloads = [stated.payload_mass for stated in conditions if stated.payload_mass > 0.0]
    of_screw = screw.inertia_per_length * screw.length + screw.nut_segment_inertia + screw.motor_segment_inertia
    return drive_sizes(
        moving_mass=mass,
        axial_stiffness=stiffness,
        bearing_stiffness=axis.joints.bearing_stiffness,
        nut_rigidity=nut,
        turning_inertia=axis.bodies.rotor_inertia + of_screw + mass * ratio**2,
        length=screw.length,
        preload=preload,
        payload=min(payloads, default=_EASY_PAYLOAD * mass),
        excitation_force=_median(forces, otherwise=preload),
        bending_frequency=_bending_frequency(screw),
    )


def _bending_frequency(screw: ScrewPhysics) -> float:
    r"""Return :math:`(\pi/2 L^2) \sqrt{EI/\rho S}`, with :math:`I/S = J'/2m'` of a round screw. [Hz]."""
    of_section = screw.axial_rigidity * screw.inertia_per_length / (2.0 * screw.mass_per_length**2)
    return float(np.pi / (2.0 * screw.length**2) * np.sqrt(of_section))


def sizes_of_motion(comparison: MotionComparison) -> MachineSizes:
    """Return the sizes of a motion from its record: of the values that are compared, without standstill."""
    velocity = comparison.sampling.values(comparison.motion.velocity)
    force, speed = (float(np.sqrt(np.mean(values**2))) for values in (comparison.force, velocity))
    change = float(np.std(comparison.force)) or force  # a force that never changes has no other size
    return motion_sizes(force=force, change=change, velocity=speed, cutoff=comparison.sampling.cutoff)


def _usual_preload(axis: AxisPhysics, conditions: Sequence[DriveConditions], forces: Sequence[float]) -> float:
    rating = axis.joints.dynamic_load_rating
    if rating is not None:
        return _median([stated.preload or 0.0 for stated in conditions], otherwise=_PRELOAD_OF_RATING * rating)
    return _median(forces, otherwise=_DEFLECTION_OF_LEAD * axis.screw.lead * axis.joints.nut_stiffness)


def _nut_rigidity(axis: AxisPhysics, preload: float) -> float:
    """Return the rigidity of the nut as stated, before any effect, under a preload. [N/m]."""
    joints = axis.joints
    usual = DriveConditions(0.5 * axis.screw.length, preload if joints.dynamic_load_rating is not None else None)
    plain = replace(axis, added=type(axis.added)())
    return float(nut_rigidities(plain, condition_arrays([usual]))[0])


def _axial_stiffness(axis: AxisPhysics, nut_rigidity: float) -> float:
    """Return the stiffness from the table to ground, the table in the middle of the screw. [N/m]."""
    joints, half = axis.joints, 0.5 * axis.screw.length / axis.screw.axial_rigidity
    screw = 1.0 / (1.0 / joints.bearing_stiffness + half)
    if joints.far_bearing_stiffness > 0.0:
        screw += 1.0 / (1.0 / joints.far_bearing_stiffness + half)
    return 1.0 / (1.0 / screw + 1.0 / nut_rigidity + 1.0 / joints.bracket_stiffness)


def _excitation_forces(
    observations: Sequence[ModalObservation] | Sequence[FrequencyResponseObservation], ratio: float
) -> list[float]:
    """Return the level of each response as an axial force. [N]."""
    return [
        observation.conditions.excitation_level
        / (1.0 if observation.excitation is ExcitationPoint.FORCE_AT_TABLE else ratio)
        for observation in observations
        if isinstance(observation, FrequencyResponseObservation)
    ]


def _median(values: Sequence[float], *, otherwise: float) -> float:
    """Return the median of what is stated, that is not 0."""
    stated = [value for value in values if value > 0.0]
    return float(np.median(stated)) if stated else otherwise
