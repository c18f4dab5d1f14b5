"""Find the poles and normal modes of Tian's drive: all zeros of its characteristic function, each exactly once.

The discretised drive of ``chain`` says where they are; Newton's method on the exact
function, which has no poles of its own, says it to rounding.
"""

from collections.abc import Callable

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.parameters import scaled_damping
from monitor_core.models.poles import zeros_near
from monitor_core.models.protocol import DriveConditions, MotorEnd, NaturalFrequency, NormalModes
from monitor_core.models.published.receptance.chain import discretise, oscillating_poles, undamped_frequencies
from monitor_core.models.published.receptance.closed_form import EntireResponses, entire_responses, position_terms
from monitor_core.models.published.receptance.parameters import ReceptanceParameters

#: Rigid-body mode included.
N_MODES = 8
#: The discretised drive is better than this, so a pole that moves further is another one. Relative.
_LARGEST_MOVE = 1e-3
#: Steps in which damping is brought up to its value, so that each mode is followed to its own pole.
_DAMPING_STEPS = 40


def natural_frequencies(
    parameters: ReceptanceParameters, conditions: DriveConditions, motor_end: MotorEnd
) -> tuple[NaturalFrequency, ...]:
    """Return the first eight poles of the exact drive in order of frequency, rigid-body mode first.

    They are fewer where some do not oscillate. Poles that cannot be told apart raise ``OutsideValidityError``.
    """
    drive = discretise(parameters, conditions, motor_end)
    n_elastic = N_MODES - drive.free
    start = -1j * oscillating_poles(drive)[:n_elastic]
    if not start.size:
        raise OutsideValidityError("no mode of this drive oscillates: its joints are damped too strongly")
    omega = _refine(_characteristic(parameters, conditions, motor_end), start)
    if np.any(np.abs(omega - start) > _LARGEST_MOVE * np.abs(start)) or _coincide(omega):
        raise OutsideValidityError("the poles of this drive cannot be distinguished")
    omega = omega[np.argsort(np.abs(omega))]
    elastic = tuple(NaturalFrequency(float(abs(pole)) / (2.0 * np.pi), float(pole.imag / abs(pole))) for pole in omega)
    return (NaturalFrequency(0.0, 0.0), *elastic) if drive.free else elastic


def normal_modes(parameters: ReceptanceParameters, conditions: DriveConditions, motor_end: MotorEnd) -> NormalModes:
    r"""Return the first undamped modes, mass-normalised, each with the damping ratio of its own pole.

    The receptance between a and b is N_ab/Δ, so that near a natural frequency

    .. math::

        \phi_a \phi_b = -2 \omega_n \frac{N_{ab}(\omega_n)}{\Delta'(\omega_n)}

    The signs are such that the motor end turns forward. ``OutsideValidityError`` if a mode is damped so strongly that
    it does not oscillate.
    """
    undamped = scaled_damping(parameters, 0.0)
    drive = discretise(undamped, conditions, motor_end)
    start = undamped_frequencies(drive)[: N_MODES - drive.free]
    omega = _refine(_characteristic(undamped, conditions, motor_end), start.astype(np.complex128)).real
    if _coincide(omega.astype(np.complex128)):
        raise OutsideValidityError("two undamped natural frequencies coincide; their modes cannot be distinguished")
    angle, displacement = _shapes(undamped, conditions, motor_end, omega)
    ratio = _damping_ratios(parameters, conditions, motor_end, omega)
    if drive.free:
        rigid = 1.0 / np.sqrt(_turning_inertia(parameters, conditions, motor_end))
        omega, ratio, angle = np.r_[0.0, omega], np.r_[0.0, ratio], np.r_[rigid, angle]
        displacement = np.r_[parameters.transmission_ratio * rigid, displacement]
    return NormalModes(omega / (2.0 * np.pi), ratio, angle, displacement)


def _shapes(
    undamped: ReceptanceParameters, conditions: DriveConditions, motor_end: MotorEnd, omega: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return φ at the motor end and φ at the table."""
    receptances = _responses(undamped, conditions, motor_end, omega.astype(np.complex128))
    step = 1e-20 * omega  # the function is real on the axis: just off it, the imaginary part gives the exact slope
    near = _responses(undamped, conditions, motor_end, omega + 1j * step)
    factor = -2.0 * omega / (near.denominator.imag / step)
    table_table, table_motor = factor * receptances.table_per_force.real, factor * receptances.table_per_torque.real
    motor_motor = factor * receptances.angle_per_torque.real
    # of the two points, the one that moves more gives the mode its scale
    by_motor = motor_motor * undamped.transmission_ratio**2 > table_table
    scale = np.sqrt(np.maximum(np.where(by_motor, motor_motor, table_table), 0.0))
    other = np.divide(table_motor, scale, out=np.zeros_like(scale), where=scale > 0.0)
    forward = np.where(other < 0.0, -1.0, 1.0)
    return np.where(by_motor, scale, np.abs(other)), np.where(by_motor, other, forward * scale)


def _damping_ratios(
    parameters: ReceptanceParameters, conditions: DriveConditions, motor_end: MotorEnd, undamped_omega: FloatArray
) -> FloatArray:
    """Follow each undamped mode to its pole while the damping grows."""
    omega = undamped_omega.astype(np.complex128)
    for share in np.linspace(0.0, 1.0, _DAMPING_STEPS + 1)[1:]:
        damped = scaled_damping(parameters, float(share))
        omega = _refine(_characteristic(damped, conditions, motor_end), omega)
    if np.any(omega.real <= 1e-3 * np.abs(omega)) or _coincide(omega):
        raise OutsideValidityError(
            "a mode is damped so strongly that it does not oscillate; modal superposition does not hold for this drive"
        )
    return np.asarray(omega.imag / np.abs(omega))


def _turning_inertia(parameters: ReceptanceParameters, conditions: DriveConditions, motor_end: MotorEnd) -> float:
    """Return the inertia of the whole drive about the screw [kg·m²]."""
    polar = parameters.torsional_rigidity / parameters.shear_modulus  # J
    return (
        parameters.density * polar * parameters.screw_length
        + parameters.screw_nut_segment_inertia
        + parameters.screw_motor_segment_inertia
        + (parameters.rotor_inertia if motor_end is MotorEnd.FREE else 0.0)
        + parameters.transmission_ratio**2 * parameters.moving_mass(conditions.payload_mass)
    )


def _responses(
    parameters: ReceptanceParameters, conditions: DriveConditions, motor_end: MotorEnd, omega: ComplexArray
) -> EntireResponses:
    terms = position_terms(parameters, omega, conditions, motor_end)
    return entire_responses(terms, parameters.joints(conditions))


def _characteristic(
    parameters: ReceptanceParameters, conditions: DriveConditions, motor_end: MotorEnd
) -> Callable[[ComplexArray], ComplexArray]:
    return lambda omega: _responses(parameters, conditions, motor_end, omega).denominator


def _refine(function: Callable[[ComplexArray], ComplexArray], start: ComplexArray) -> ComplexArray:
    """Return the exact poles next to those of the discretised drive."""
    omega = zeros_near(function, start)
    if np.any(np.isnan(omega)):
        raise OutsideValidityError(
            "a pole of this drive could not be found; a mode is damped so strongly that it does not oscillate"
        )
    return omega


def _coincide(omega: ComplexArray) -> bool:
    apart = np.abs(omega[:, None] - omega[None, :])[np.triu_indices(omega.size, 1)]
    return bool(np.any(apart < 1e-9 * np.max(np.abs(omega))))
