r"""Find the poles and modes of the discretised drive.

Without damping the loop mobility is jB(ω), and B rises between its poles (Foster's reactance theorem). So there is
exactly one natural frequency between two neighbouring poles of the lines alone, and these follow from a phase that
rises with frequency: none can be missed or counted twice. Damping is then increased step by step; the closer two
poles come, the smaller the step, so that each keeps to its own path.
"""

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.poles import circles_around
from monitor_core.models.protocol import ExcitationPoint, MotorEnd, NaturalFrequency, NormalModes, ResponsePoint
from monitor_core.models.published.transmission_line.mobility import DiscreteDrive, Line, loop_mobility, response_at

#: Modes are given up to this half-wave of the free screw in torsion. [-]
_HALF_WAVES = 4
#: Relative distance from which a natural frequency is distinguished from a pole of a line alone. [-]
_APART = 1e-9
_BISECTIONS = 80
#: Largest step of the damping, and the smallest before a pole is given up, as shares of the dampers.
_LARGEST_DEGREE, _SMALLEST_DEGREE = 2.0**-3, 2.0**-20
#: Steps until the whole damping is there; drives that oscillate take less than 150.
_MOST_STEPS = 1000
#: Largest move of a pole in a step, as a share of its distance to the nearest other; a pole that changes paths moves
#: by all of it.
_FOLLOWED = 0.1
_SECANTS = 50
_TORQUE, _FORCE = ExcitationPoint.TORQUE_AT_MOTOR, ExcitationPoint.FORCE_AT_TABLE
_MOTOR, _TABLE = ResponsePoint.ANGLE_AT_MOTOR, ResponsePoint.DISPLACEMENT_AT_TABLE


def natural_frequencies(drive: DiscreteDrive) -> tuple[NaturalFrequency, ...]:
    """Return the poles up to the fourth half-wave of the screw in torsion, rigid-body mode first."""
    rigid = () if drive.motor_end is MotorEnd.CLAMPED else (NaturalFrequency(0.0, 0.0),)
    poles = damped_poles(drive, *undamped_omega(drive))
    order = np.argsort(np.abs(poles))
    return rigid + tuple(
        NaturalFrequency(float(abs(s)) / (2.0 * math.pi), float(max(-s.real, 0.0) / abs(s))) for s in poles[order]
    )


def normal_modes(drive: DiscreteDrive) -> NormalModes:
    """Return the undamped modes up to the fourth half-wave of the screw in torsion, shapes from residues."""
    omega, beyond = undamped_omega(drive)
    poles = damped_poles(drive, omega, beyond)
    table = np.sqrt(np.maximum(_residue(drive, omega, _FORCE, _TABLE), 0.0))
    motor = np.sqrt(np.maximum(_residue(drive, omega, _TORQUE, _MOTOR), 0.0))
    rigid_table, rigid_motor = _rigid_body_mode(drive)
    return NormalModes(
        frequency=np.concatenate([np.zeros(len(rigid_table)), omega / (2.0 * math.pi)]),
        damping_ratio=np.concatenate([np.zeros(len(rigid_table)), np.maximum(-poles.real, 0.0) / np.abs(poles)]),
        angle_at_motor=np.concatenate([rigid_motor, np.copysign(motor, _residue(drive, omega, _TORQUE, _TABLE))]),
        displacement_at_table=np.concatenate([rigid_table, table]),
    )


def _residue(
    drive: DiscreteDrive, omega: FloatArray, excitation: ExcitationPoint, response: ResponsePoint
) -> FloatArray:
    r"""Return φ_a φ_b of the receptance Σ φ_a φ_b/(ω_n² + s²), its mean over a circle around each pole."""
    offset = circles_around(omega)
    s = 1j * omega[:, None] + offset
    receptance = response_at(drive, s.ravel(), excitation, response, damping=0.0).reshape(s.shape)
    return np.asarray(np.mean(receptance * offset * (s + 1j * omega[:, None]), axis=1).real)


def undamped_omega(drive: DiscreteDrive) -> tuple[FloatArray, FloatArray]:
    """Return the natural frequencies without damping, rising, in rad/s, and beyond them those of one half-wave more."""
    half_wave = math.pi / (drive.torsional_line.sections * drive.grid.time_step)
    alone = np.sort(np.concatenate([_axial_poles(drive), _torsional_poles(drive)]))
    alone = alone[: np.searchsorted(alone, (_HALF_WAVES + 1) * half_wave) + 1]
    low = np.concatenate([[_APART * alone[0]], alone[:-1] * (1.0 + _APART)])
    high = np.maximum(alone * (1.0 - _APART), low)

    def characteristic(omega: FloatArray) -> FloatArray:
        parts = drive.mobilities(1j * omega, damping=0.0)
        value = parts.line_poles * loop_mobility(parts, drive.parameters.transmission_ratio)
        return np.asarray(value.real)  # three imaginary factors of the poles, and an imaginary mobility

    at_low, at_high = characteristic(low), characteristic(high)
    roots = _bisect(lambda omega: characteristic(omega) * np.sign(at_high), low, high)
    # No change of sign: the nut lies in a node of that line's mode, which then is a mode of the drive as it stands.
    nearer = np.where(np.abs(at_low) < np.abs(at_high), low, high)
    roots = np.sort(np.where(at_low * at_high < 0.0, roots, nearer))
    given, beyond = np.searchsorted(roots, np.array([_HALF_WAVES, _HALF_WAVES + 1]) * half_wave, side="right")
    return roots[:given], roots[given:beyond]


def damped_poles(drive: DiscreteDrive, omega: FloatArray, beyond: FloatArray) -> ComplexArray:
    """Follow the poles from jω while all dampers grow from nothing to what they are, in 1/s.

    Those ``beyond`` are followed as long as they can be, so that none of the others takes their place.
    """
    s = np.asarray(1j * np.concatenate([omega, beyond]), dtype=np.complex128)
    damping, degree = 0.0, _LARGEST_DEGREE
    for _ in range(_MOST_STEPS):
        if damping >= 1.0:
            return s[: omega.size]
        degree = min(degree, 1.0 - damping)
        after = _secant(drive, s, damping + degree)
        room = np.minimum(_nearest(s)[0], _nearest(after)[0])
        if np.all(np.abs(after - s) <= _FOLLOWED * room):  # not where it is nan
            s, damping, degree = after, damping + degree, min(2.0 * degree, _LARGEST_DEGREE)
        elif degree > _SMALLEST_DEGREE:
            degree *= 0.5
        elif s.size > omega.size:
            s = s[: omega.size]
        else:
            break
    raise OutsideValidityError(_where_it_was_lost(s, damping))


def _nearest(s: ComplexArray) -> tuple[FloatArray, npt.NDArray[np.intp]]:
    """Return the distance of each pole to the nearest other, and which; with itself, to its conjugate, 0 once real."""
    distance = np.abs(s[:, None] - s[None, :])
    np.fill_diagonal(distance, 2.0 * s.imag)
    return distance.min(axis=1), distance.argmin(axis=1)


def _where_it_was_lost(s: ComplexArray, damping: float) -> str:
    """Say which poles were about to meet when so much of the damping was applied."""
    distance, other = _nearest(s)
    n = int(np.argmin(distance / np.abs(s)))
    near, and_near = (np.abs(s[[n, other[n]]]) / (2.0 * math.pi)).tolist()
    if n == other[n]:
        return (
            f"the mode near {near:.6g} Hz is damped so strongly that it no longer oscillates from {damping:.3%} of its "
            "damping on; this model needs underdamped modes"
        )
    return (
        f"the modes near {near:.6g} and {and_near:.6g} Hz meet at {damping:.3%} of their damping, from where on it is "
        "not known which is which; change the damping a little"
    )


def _secant(drive: DiscreteDrive, s: ComplexArray, damping: float) -> ComplexArray:
    """Return the zeros of the characteristic function next to s, nan where none is found."""

    def characteristic(s: ComplexArray) -> ComplexArray:
        parts = drive.mobilities(s, damping)
        return np.asarray(parts.line_poles * loop_mobility(parts, drive.parameters.transmission_ratio))

    before, s = s, np.asarray(s * (1.0 + 1e-6j), dtype=np.complex128)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a step that is too long may lead anywhere
        value_before, value = characteristic(before), characteristic(s)
        for _ in range(_SECANTS):
            difference = value - value_before
            moving = (difference != 0.0) & (np.abs(s - before) > 1e-14 * np.abs(s))
            if not np.any(moving):
                return s
            slope = np.where(moving, difference, 1.0)
            step = np.where(moving, value * (s - before) / slope, 0.0)
            before, value_before = s, value
            s = np.asarray(s - step, dtype=np.complex128)
            value = characteristic(s)
    return np.where(moving, np.nan, s)


def _axial_poles(drive: DiscreteDrive) -> FloatArray:
    """Return the axial natural frequencies of the screw in its bearings, without the nut."""
    return _poles_of_line(drive.axial_line, lambda s: drive.bearings(drive.stub_frequency(s), 0.0), first=0)


def _torsional_poles(drive: DiscreteDrive) -> FloatArray:
    """Return the torsional natural frequencies of the screw and its motor end, without the nut."""

    def ends(s: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        motor_end = drive.at_motor_end(drive.stub_frequency(s), 0.0).impedance
        return motor_end, np.zeros_like(motor_end)

    return _poles_of_line(drive.torsional_line, ends, first=1 if drive.motor_end is MotorEnd.PRESCRIBED else 0)


def _poles_of_line(
    line: Line, ends: Callable[[ComplexArray], tuple[ComplexArray, ComplexArray]], first: int
) -> FloatArray:
    """Solve ωT − φ₀ − φ₁ = nπ, where an end of impedance −jX turns the phase by φ = arctan(X/Z), 0 to π."""
    delay = line.sections * line.time_step
    order = np.arange(first, _HALF_WAVES + 2, dtype=np.float64)

    def phase(omega: FloatArray) -> FloatArray:
        turned = [
            np.arctan(-end.imag / line.impedance) % math.pi for end in ends(np.asarray(1j * omega, dtype=np.complex128))
        ]
        return np.asarray(omega * delay - turned[0] - turned[1] - order * math.pi)

    return _bisect(phase, np.full(len(order), 1e-9 / delay), (order + 2.0) * math.pi / delay)


def _bisect(function: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray) -> FloatArray:
    """Return where each of the functions turns from negative to positive."""
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        above = function(middle) > 0.0
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return np.asarray(0.5 * (low + high))


def _rigid_body_mode(drive: DiscreteDrive) -> tuple[FloatArray, FloatArray]:
    """Return φ of table and motor where the whole drive can turn, arrays of one element; else of none."""
    if drive.motor_end is MotorEnd.CLAMPED:
        return np.zeros(0), np.zeros(0)
    p, line, i = drive.parameters, drive.torsional_line, drive.parameters.transmission_ratio
    inertia = line.impedance * line.sections * line.time_step + i**2 * (p.table_mass + drive.conditions.payload_mass)
    if drive.motor_end is MotorEnd.FREE:
        inertia += p.rotor_inertia
    return np.array([i]) / math.sqrt(inertia), np.array([1.0]) / math.sqrt(inertia)
