r"""Ask of the data alone whether an axis behaves as a ball screw axis at all: before any search, without a preload.

A ball screw makes a travel of lead/2π of an angle, and its own compliance is between the table and the bearings that
hold it. Of the first natural frequency,

.. math::

    \omega^{-2} = m' \left( c_0 + \frac{i^2 x}{G J'} + \left[ (c_b + s x)^{-1} + (c_f + s (L - x))^{-1} \right]^{-1}
    \right), \qquad \frac{1}{m'} = \frac{1}{m} + \frac{i^2}{J}, \quad s = \frac{1}{E S}

with the position x on a screw of the length L: whichever bearing carries the force, its torque at the nut twists the
screw as far as the motor. What a description is likely to be wrong in is free within wide bounds:
the bearing :math:`1/c_b` within five of its tolerances, a second bearing from none to a stiff one, whatever else yields
:math:`c_0`, and the mass. Where nothing within them comes near to how the frequency goes with the position, and it
stands still, goes the other way or smoothly goes otherwise in the data, that speaks against a screw.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.fitting.observations import FrequencyResponseObservation, ModalObservation
from monitor_core.models.extended import AxisPhysics, moving_mass
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, ResponsePoint, require_position

#: Of what a turn of the motor moves the table by, over the lead: a gear or a belt before a screw may make less of it.
_OTHER_TRAVEL = 3.0
#: What a channel may be off by as a whole, in another unit: m/s² as g, rad as degrees, turns or minutes, m as mm.
_UNITS = (9.80665, 180.0 / math.pi, 2.0 * math.pi, 10800.0 / math.pi, 1000.0)
_OF_A_UNIT = 1.15  # or within
#: A first frequency is known so well at the best, relative: positions err, and a mode is no single spring. [-]
_KNOWN = 0.005
#: χ² by which it stands still, or goes the other way, rather than as a screw makes it. Of 270 axes with a screw and
#: something large hidden in it, measured at five positions, the nearest is at 1, and at −14 unless the screw bends.
_RATHER = 10.0
#: χ² that no screw comes below where the frequency goes smoothly otherwise; of those axes 40 is the largest, and 146
#: of screws that bend.
_UNLIKE, _FEWEST_OTHERWISE = 300.0, 5
_LEAST_RISE, _ADEQUATE = 0.03, 4.0  # over the travel [-]; χ² per position of what the data do instead
_TOLERANCES, _USUAL_TOLERANCE = 5.0, 0.2  # of the bearing; where none is stated
_MASSES = np.geomspace(0.6, 1.7, 9)
_FAR = (0.0, 0.03, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0, 1.5, 3.0, 30.0)  # of the fixed bearing
_ELSEWHERE = np.r_[0.0, np.geomspace(0.1, 30.0, 40)]  # of what yields besides, as described: a misprint is of ten
_FEWEST_POSITIONS, _SAME_POSITION = 3, 2e-3  # [m]
_LOWEST_LINES, _NEAR_A_PEAK = 4, 3
_KNOWN_LINE, _RIGID = 8.0, 0.5  # |Y| over its standard deviation; of the frequency with the other end held, at most


class Objection(StrEnum):
    """What speaks against a ball screw axis."""

    TRAVEL = "other-travel-per-turn"
    STANDS = "frequency-stands-still"
    OTHER_WAY = "frequency-goes-the-other-way"
    OTHERWISE = "frequency-moves-otherwise"


@dataclass(frozen=True, slots=True)
class AgainstScrew:
    """What speaks against a ball screw axis, with what it was found from."""

    objection: Objection
    values: Mapping[str, float] = field(default_factory=dict)  # by names that end with their unit


Measured = Sequence[ModalObservation] | Sequence[FrequencyResponseObservation]


def against_screw(axis: AxisPhysics, tolerances: Mapping[str, float], measured: Measured) -> AgainstScrew | None:
    """Return what speaks most against a ball screw axis as described; None where nothing does.

    ``tolerances`` are those of the description, as standard deviations of a logarithm by names in files.

    Raises OutsideValidityError if a position is not on the screw that is described.
    """
    for each in measured:
        require_position(each.conditions.position, axis.screw.length)
    return _travel(axis, measured) or _along(axis, tolerances, measured)


def _travel(axis: AxisPhysics, measured: Measured) -> AgainstScrew | None:
    """Return whether a turn of the motor moves the table by another travel than any screw, gears included."""
    ratios = list(_travels_per_angle(axis, measured))
    if not ratios:
        return None
    found = float(np.median(ratios))
    off = abs(math.log(found / axis.screw.transmission_ratio))
    is_unit = any(abs(off - math.log(unit)) < math.log(_OF_A_UNIT) for unit in _UNITS)
    if off < math.log(_OTHER_TRAVEL) or is_unit:
        return None
    values = {"travel_per_turn_m": 2.0 * math.pi * found, "lead_m": axis.screw.lead}
    return AgainstScrew(Objection.TRAVEL, values)


_ACCELERATIONS = (ResponsePoint.ACCELERATION_AT_TABLE, ResponsePoint.ACCELERATION_AT_NUT)


def _travels_per_angle(axis: AxisPhysics, measured: Measured) -> Iterator[float]:
    r"""Yield travel over angle of the lowest lines that are known, where table and motor move as a rigid body.

    It is :math:`i/|1 - (f/f_c)^2|` of the table that a torque drives, with its frequency :math:`f_c` while the rotor is
    held, and :math:`i \, |1 - (f/f_c)^2|` where a force at the table drives the rotor, with that of the rotor.
    """
    found: dict[tuple[DriveConditions, ExcitationPoint], dict[ResponsePoint, FrequencyResponseObservation]] = {}
    for each in measured:
        if isinstance(each, FrequencyResponseObservation):
            found.setdefault((each.conditions, each.excitation), {})[each.response_point] = each
    for (conditions, excitation), at in found.items():
        angle = at.get(ResponsePoint.ANGLE_AT_MOTOR)
        for table in (at[point] for point in _ACCELERATIONS if point in at):
            if angle is None or not np.array_equal(angle.frequency, table.frequency):
                continue
            known = np.all([np.abs(of.response) > _KNOWN_LINE * of.standard_deviation for of in (angle, table)], axis=0)
            lowest = np.flatnonzero(known)[:_LOWEST_LINES]
            omega = 2.0 * np.pi * angle.frequency[lowest]
            if lowest.size == _LOWEST_LINES and omega[-1] < _RIGID * _other_end_held(axis, conditions, excitation):
                yield float(np.median(np.abs(table.response[lowest] / angle.response[lowest]) / omega**2))


def _other_end_held(axis: AxisPhysics, conditions: DriveConditions, excitation: ExcitationPoint) -> float:
    """Return the described natural frequency of what is not driven, table or rotor, the other held. [rad/s]."""
    mass = moving_mass(axis) + conditions.payload_mass
    if excitation is ExcitationPoint.FORCE_AT_TABLE:
        mass = _turning(axis) / axis.screw.transmission_ratio**2
    return 1.0 / math.sqrt(mass * float(_described_compliance(axis, np.array([conditions.position]))[0]))


def _along(axis: AxisPhysics, tolerances: Mapping[str, float], measured: Measured) -> AgainstScrew | None:
    """Return whether the first frequency stands still along the travel, goes the other way or smoothly otherwise."""
    position, ln_frequency, deviation = _first_frequencies(list(_lowest(measured)))
    if position.size < _FEWEST_POSITIONS:
        return None
    of_screw = math.inf
    for bearing, screws in _of_screws(axis, tolerances, position):
        away = (ln_frequency - screws) / deviation
        of_screw = min(of_screw, float(np.min(np.sum(away**2, axis=-1))) + bearing**2)
    as_described = _of_description(axis, position)
    values = {
        "frequency_hz": math.exp(float(np.mean(ln_frequency))),
        "lowest_m": float(position[0]),
        "highest_m": float(position[-1]),
        "change": math.expm1(float(ln_frequency[-1] - ln_frequency[0])),
        "described_change": math.expm1(float(as_described[-1] - as_described[0])),
    }
    smooth = (np.polyfit(position, ln_frequency, degree, w=1.0 / deviation) for degree in range(3))
    curves = [np.polyval(each, position) for each in smooth]
    level, line, bow = (float(np.sum(((ln_frequency - curve) / deviation) ** 2)) for curve in curves)
    adequate = _ADEQUATE * position.size
    if of_screw - level > _RATHER and level < adequate:
        return AgainstScrew(Objection.STANDS, values)
    if of_screw - line > _RATHER and line < adequate and curves[1][-1] - curves[1][0] > _LEAST_RISE:
        return AgainstScrew(Objection.OTHER_WAY, values)
    if of_screw > _UNLIKE and bow < adequate and position.size >= _FEWEST_OTHERWISE:
        return AgainstScrew(Objection.OTHERWISE, values)
    return None


def _of_screws(
    axis: AxisPhysics, tolerances: Mapping[str, float], position: FloatArray
) -> Iterator[tuple[float, FloatArray]]:
    """Yield ln of the first frequency of screw axes within wide bounds, shape (n_axes, n_positions).

    With them comes by how many of its tolerances the fixed bearing of these axes is another one.
    """
    joints, elsewhere = axis.joints, _ELSEWHERE * _elsewhere(axis)
    for bearing in np.linspace(-_TOLERANCES, _TOLERANCES, 11).tolist():
        factor = math.exp(bearing * tolerances.get("bearing_stiffness_n_per_m", _USUAL_TOLERANCE))
        near = 1.0 / (factor * joints.bearing_stiffness)
        far = (joints.far_bearing_stiffness + share * joints.bearing_stiffness for share in _FAR)
        along = np.array([_compliance(axis, position, near, stiffness) for stiffness in far])
        squares = _MASSES[:, None, None, None] * _mass(axis) * (along[:, None, :] + elsewhere[:, None])
        yield bearing, -0.5 * np.log(squares.reshape(-1, position.size)) - math.log(2.0 * math.pi)


def _elsewhere(axis: AxisPhysics) -> float:
    """Return the compliance of nut and bracket, as described. [m/N]."""
    return 1.0 / axis.joints.nut_stiffness + 1.0 / axis.joints.bracket_stiffness


def _of_description(axis: AxisPhysics, position: FloatArray) -> FloatArray:
    """Return ln of the first frequency as it goes along the screw that is described."""
    return np.asarray(-0.5 * np.log(_mass(axis) * _described_compliance(axis, position)) - math.log(2.0 * math.pi))


def _described_compliance(axis: AxisPhysics, position: FloatArray) -> FloatArray:
    """Return the compliance between rotor and table, as described. [m/N]."""
    joints = axis.joints
    return _elsewhere(axis) + _compliance(axis, position, 1.0 / joints.bearing_stiffness, joints.far_bearing_stiffness)


def _compliance(axis: AxisPhysics, position: FloatArray, near: float, far_stiffness: float) -> FloatArray:
    """Return the compliance of a screw and its bearings where the nut is. [m/N]."""
    screw = axis.screw
    torsion = screw.torsion_share * screw.transmission_ratio**2 / screw.torsional_rigidity * position
    to_near = near + position / screw.axial_rigidity
    if not far_stiffness:
        return to_near + torsion
    to_far = 1.0 / far_stiffness + (screw.length - position) / screw.axial_rigidity
    return np.asarray(1.0 / (1.0 / to_near + 1.0 / to_far) + torsion)


def _mass(axis: AxisPhysics) -> float:
    """Return what swings against all that turns. [kg]."""
    return 1.0 / (1.0 / moving_mass(axis) + axis.screw.transmission_ratio**2 / _turning(axis))


def _turning(axis: AxisPhysics) -> float:
    """Return the inertia of all that turns. [kg·m²]."""
    screw = axis.screw
    segments = screw.nut_segment_inertia + screw.motor_segment_inertia
    return axis.bodies.rotor_inertia + screw.inertia_per_length * screw.length + segments


def _first_frequencies(found: Sequence[tuple[DriveConditions, float]]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return positions, ln of the first frequency at each, and its standard deviation, each of shape (n_positions,).

    What else was set moves it alike at every position: levels of position and of all else add up in its logarithm.
    Where the two cannot be told apart, what was set most often else is alone looked at.
    """
    if not found:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    places = np.array([conditions.position for conditions, _ in found])
    levels = np.unique(np.round(places / _SAME_POSITION) * _SAME_POSITION)
    of_place = np.abs(places[:, None] - levels).argmin(axis=1)
    others = [
        (each.preload, each.payload_mass, round(each.temperature_deviation), each.excitation_level) for each, _ in found
    ]
    of_other = np.array([others.index(each) for each in others])
    other = np.unique(of_other, return_inverse=True)[1]
    usual = np.bincount(other).argmax()
    columns = np.hstack([np.eye(levels.size)[of_place], np.delete(np.eye(other.max() + 1)[other], usual, axis=1)])
    if np.linalg.matrix_rank(columns) < columns.shape[1]:
        return _first_frequencies([each for each, level in zip(found, other, strict=True) if level == usual])
    values = np.log([frequency for _, frequency in found])
    fitted = np.linalg.lstsq(columns, values, rcond=None)[0]
    left = float(np.sqrt(np.mean((values - columns @ fitted) ** 2)))
    several = np.bincount(of_place)
    return levels, fitted[: levels.size], np.hypot(_KNOWN, left / np.sqrt(several))


def _lowest(measured: Measured) -> Iterator[tuple[DriveConditions, float]]:
    """Yield the first frequency of each measurement: of a table of one mode, or the largest peak of an acceleration.

    Which of several modes is that of the table on its screw no table says.
    """
    peaks = [each for each in measured if isinstance(each, ModalObservation)]
    if len({each.conditions for each in peaks}) == len(peaks):
        yield from ((each.conditions, each.frequency) for each in peaks)
    for each in measured:
        if isinstance(each, ModalObservation):
            continue
        if each.response_point in _ACCELERATIONS and (peak := _largest_peak(each.frequency, each.response)):
            yield each.conditions, peak


def _largest_peak(frequency: FloatArray, response: ComplexArray) -> float | None:
    r"""Return the frequency of the largest peak, of one mode and a residue fitted to the lines about it.

    :math:`H = (a + b \omega^2)/(\omega_0^2 - \omega^2 + j c \omega)` is linear in its unknowns once multiplied out
    (Levy, IRE Trans. Autom. Control 4 (1959) 37).
    """
    size = np.abs(response)
    peaks = np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:])) + 1
    if not peaks.size:
        return None
    peak = int(peaks[np.argmax(size[peaks])])
    near = slice(max(peak - _NEAR_A_PEAK, 0), peak + _NEAR_A_PEAK + 1)
    of_peak, value = frequency[near] / frequency[peak], response[near] / size[peak]
    terms = np.stack([-value, -1j * of_peak * value, np.ones_like(value), of_peak**2 + 0j])
    real = np.vstack([terms[:2].real.T, terms[:2].imag.T])
    zeros = np.zeros_like(of_peak)
    residue = [np.r_[each.real, zeros] for each in terms[2:]] + [np.r_[zeros, each.real] for each in terms[2:]]
    target = -(of_peak**2) * value
    found = np.linalg.lstsq(np.column_stack([real, *residue]), np.r_[target.real, target.imag], rcond=None)[0]
    return float(frequency[peak] * math.sqrt(found[0])) if found[0] > 0.0 else float(frequency[peak])
