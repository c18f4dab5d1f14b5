r"""Evaluate the discretised drive in the z-domain: exactly what the time stepping does, at one complex frequency.

With :math:`z = e^{s \Delta t}` a line of m sections is a delay of m steps, and a trapezoidal stub sees the frequency

.. math::

    \sigma = \frac{2}{\Delta t} \frac{z - 1}{z + 1} = \frac{2}{\Delta t} \tanh \frac{s \Delta t}{2}

(bilinear transform) instead of s. Mobilities are velocity per force, or angular velocity per torque.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import ComplexArray
from monitor_core.models.ball_screw import nut_rigidity
from monitor_core.models.bracket import beyond_contacts, nut_from_table
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from monitor_core.models.published.transmission_line.grid import LineGrid, TransmissionLineParameters


class Mobilities(NamedTuple):
    """Mobilities of the parts of the drive, the nut being cut; all of shape (n_frequencies,)."""

    stub_frequency: ComplexArray  # σ [1/s]
    axial: ComplexArray  # of the axial line at the nut [m/(N·s)]
    torsional: ComplexArray  # of the torsional line at the nut, with what is at its ends [rad/(N·m·s)]
    nut: ComplexArray  # of the nut and what is in series with it [m/(N·s)]
    table: ComplexArray  # [m/(N·s)]
    motor_to_nut: ComplexArray  # rate at the nut per torque at the motor [rad/(N·m·s)]
    motor: ComplexArray  # rate at the motor per torque there [rad/(N·m·s)]
    line_poles: ComplexArray  # zero at the poles of the lines alone and nowhere infinite; times σ [1/s]


class AtMotorEnd(NamedTuple):
    """What rotor and coupling are to the torsional line; all of shape (n_frequencies,)."""

    impedance: ComplexArray  # that the end of the line meets [N·m·s/rad]
    share: ComplexArray  # rate of the rotor per rate of the end; by reciprocity, torque on a held end per torque [-]
    rotor: ComplexArray  # mobility of the rotor while the end of the line is held [rad/(N·m·s)]
    common: ComplexArray  # denominator of the impedance; zero where the rotor resonates on its coupling [-]


@dataclass(frozen=True, slots=True)
class Line:
    """One line between two impedances."""

    impedance: float
    sections: int
    time_step: float

    def from_left(self, s: ComplexArray, node: int, end: ComplexArray) -> ComplexArray:
        """Return cosh(s n Δt) + (end/Z) sinh(s n Δt), the velocity at a node where it is 1 at the end."""
        angle = s * (node * self.time_step)
        return np.asarray(np.cosh(angle) + end / self.impedance * np.sinh(angle))

    def pole_function(self, s: ComplexArray, left: ComplexArray, right: ComplexArray) -> ComplexArray:
        """Return what is zero at the poles of the line with both ends."""
        angle = s * (self.sections * self.time_step)
        a, b = left / self.impedance, right / self.impedance
        return np.asarray((1.0 + a * b) * np.sinh(angle) + (a + b) * np.cosh(angle))

    def at_place(
        self, s: ComplexArray, place: float, left: ComplexArray, right: ComplexArray
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the mobility of a junction split over two nodes, and from x = 0 to it, both times the pole function.

        From node to node it is that function's reciprocal times from_left(lower) from_right(higher)/Z.
        """
        j = int(place)
        b = place - j
        a = 1.0 - b
        l0, l1 = self.from_left(s, j, left), self.from_left(s, j + 1, left)
        r0, r1 = self.from_left(s, self.sections - j, right), self.from_left(s, self.sections - j - 1, right)
        own = a * a * l0 * r0 + 2.0 * a * b * l0 * r1 + b * b * l1 * r1
        return np.asarray(own / self.impedance), np.asarray((a * r0 + b * r1) / self.impedance)


@dataclass(frozen=True, slots=True)
class DiscreteDrive:
    """A drive on a grid with a common step."""

    parameters: TransmissionLineParameters
    grid: LineGrid
    conditions: DriveConditions
    motor_end: MotorEnd

    @property
    def axial_line(self) -> Line:
        """The screw in tension."""
        return Line(self.grid.axial_impedance(self.parameters), self.grid.axial_sections, self.grid.time_step)

    @property
    def torsional_line(self) -> Line:
        """The screw in torsion."""
        return Line(self.grid.torsional_impedance(self.parameters), self.grid.torsional_sections, self.grid.time_step)

    def stub_frequency(self, s: ComplexArray) -> ComplexArray:
        """Return σ. [1/s]."""
        return np.asarray(2.0 / self.grid.time_step * np.tanh(0.5 * self.grid.time_step * s))

    def bearings(self, sigma: ComplexArray, damping: float = 1.0) -> tuple[ComplexArray, ComplexArray]:
        """Return the impedances at x = 0 and at the far end; ``damping`` scales all dampers. [N·s/m]."""
        p = self.parameters
        return (
            p.bearing_stiffness / sigma + damping * p.bearing_damping,
            p.far_bearing_stiffness / sigma + damping * p.far_bearing_damping,
        )

    def at_motor_end(self, sigma: ComplexArray, damping: float = 1.0) -> AtMotorEnd:
        """Return what rotor and coupling are to the torsional line; ``damping`` scales all dampers."""
        p = self.parameters
        zeros, ones = np.zeros_like(sigma), np.ones_like(sigma)
        if self.motor_end is MotorEnd.PRESCRIBED:
            return AtMotorEnd(zeros, ones, zeros, ones)
        coupling = np.asarray(p.coupling_stiffness / sigma + damping * p.coupling_damping)
        if self.motor_end is MotorEnd.CLAMPED:
            return AtMotorEnd(coupling, zeros, zeros, ones)
        rotor = p.rotor_inertia * sigma + damping * p.motor_damping
        common = 1.0 + rotor / coupling
        return AtMotorEnd(*(np.asarray(x) for x in (rotor / common, 1.0 / common, 1.0 / (coupling + rotor), common)))

    def mobilities(self, s: npt.ArrayLike, damping: float = 1.0) -> Mobilities:
        """Return all mobilities at complex frequencies s, shape (n_frequencies,). [1/s]."""
        p, grid, axial, torsional = self.parameters, self.grid, self.axial_line, self.torsional_line
        s = np.asarray(s, dtype=np.complex128)
        sigma = self.stub_frequency(s)
        share = self.conditions.position / p.screw_length
        axial_place, torsional_place = share * grid.axial_sections, share * grid.torsional_sections

        ends = self.bearings(sigma, damping)
        axial_poles = axial.pole_function(s, *ends)
        axial_own, _ = axial.at_place(s, axial_place, *ends)

        end = self.at_motor_end(sigma, damping)
        free = np.zeros_like(sigma)
        torsional_poles = torsional.pole_function(s, end.impedance, free)
        torsional_own, to_nut = torsional.at_place(s, torsional_place, end.impedance, free)
        at_end = torsional.from_left(s, torsional.sections, free) / (torsional.impedance * torsional_poles)

        stiffness = nut_rigidity(p.nut_stiffness, self.conditions.preload, p.dynamic_load_rating)
        compliance = 1.0 / p.bracket_stiffness + self._compliance_of_the_split(axial_place, torsional_place)
        return Mobilities(
            stub_frequency=sigma,
            axial=np.asarray(axial_own / axial_poles),
            torsional=np.asarray(torsional_own / torsional_poles),
            nut=np.asarray(1.0 / (stiffness / sigma + damping * p.nut_damping) + sigma * compliance),
            table=np.asarray(1.0 / ((p.table_mass + self.conditions.payload_mass) * sigma + damping * p.table_damping)),
            motor_to_nut=np.asarray(to_nut / torsional_poles * end.share),
            motor=np.asarray(end.rotor + end.share**2 * at_end),
            line_poles=np.asarray(axial_poles * torsional_poles * end.common * sigma),
        )

    def _compliance_of_the_split(self, axial_place: float, torsional_place: float) -> float:
        """Return a(1 − a)[Δx_a/EA + i² Δx_t/GJ]: what the junction of two nodes leaves out. [m/N]."""
        p, grid = self.parameters, self.grid
        a, t = axial_place % 1.0, torsional_place % 1.0
        axial = a * (1.0 - a) * p.screw_length / (grid.axial_sections * p.axial_rigidity)
        torsional = t * (1.0 - t) * p.screw_length / (grid.torsional_sections * p.torsional_rigidity)
        return axial + p.transmission_ratio**2 * torsional


def loop_mobility(parts: Mobilities, transmission: float) -> ComplexArray:
    """Return the sum of all mobilities that the force in the nut meets; it is zero at the poles. [m/(N·s)]."""
    return np.asarray(parts.axial + transmission**2 * parts.torsional + parts.nut + parts.table)


def response_at(
    drive: DiscreteDrive,
    s: npt.ArrayLike,
    excitation: ExcitationPoint,
    response: ResponsePoint,
    damping: float = 1.0,
) -> ComplexArray:
    """Return the response at complex frequencies s with the motor end that the drive has, shape (n_frequencies,)."""
    i = drive.parameters.transmission_ratio
    parts = drive.mobilities(s, damping)
    loop = loop_mobility(parts, i)
    # The nut transmits the velocity of the loop over the loop's mobility; what it transmits moves both sides.
    across = i * parts.motor_to_nut * parts.table / loop
    if response is ResponsePoint.ANGLE_AT_MOTOR:
        own = parts.motor - (i * parts.motor_to_nut) ** 2 / loop
        rate = across if excitation is ExcitationPoint.FORCE_AT_TABLE else own
    else:
        own = parts.table * (loop - parts.table) / loop
        if response is ResponsePoint.ACCELERATION_AT_NUT:
            own, across = _rates_of_nut(drive, own, across, parts.stub_frequency, damping)
        rate = own if excitation is ExcitationPoint.FORCE_AT_TABLE else across
    if response.is_acceleration:
        return np.asarray(rate * parts.stub_frequency)
    return np.asarray(rate / parts.stub_frequency)


def _rates_of_nut(
    drive: DiscreteDrive, own: ComplexArray, across: ComplexArray, sigma: ComplexArray, damping: float
) -> tuple[ComplexArray, ComplexArray]:
    """Return the velocity of the nut per force at the table and per torque, from those of the table."""
    p = drive.parameters
    beyond = beyond_contacts(
        sigma,
        table_mass=p.table_mass + drive.conditions.payload_mass,
        table_damping=damping * p.table_damping,
        bracket_stiffness=p.bracket_stiffness,
    )
    per_force, per_torque = nut_from_table(own / sigma, across / sigma, beyond)
    return np.asarray(sigma * per_force), np.asarray(sigma * per_torque)
