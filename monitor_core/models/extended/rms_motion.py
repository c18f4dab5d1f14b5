"""Compute the rms motion of table and nut under the stated excitation.

Velocity of the table and deflection of the nut are functions of two numbers: the damper c that stands for friction,
and the hardening h of the nut; see ``amplitude``.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray, NumberArray
from monitor_core.models.extended.closed_form import entire_parts
from monitor_core.models.extended.conditions import AxisStates
from monitor_core.models.extended.excitations import Excitations
from monitor_core.models.extended.lines import PreparedLines
from monitor_core.models.extended.physics import AxisPhysics

#: Terms of f_00 + c f_10 + h f_01 + c h f_11, a function of damper and hardening, by the two powers.
Bilinear = Mapping[tuple[int, int], NumberArray]
#: The same between the knots: real and imaginary part are rows, shape (2, n_points).
Pointwise = Mapping[tuple[int, int], FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Velocity of the table and deflection of the nut as functions of damper c and hardening h, at the points.

    Only terms and motions of effects that are there.
    """

    excitations: Excitations
    level: FloatArray  # rms of each excitation, shape (n_excitations,)
    characteristic: Pointwise
    numerators: tuple[Pointwise, ...]  # of jωx where there is friction, of δ where the nut hardens

    def rms(self, damping: FloatArray, hardening: FloatArray) -> FloatArray:
        """Return σ_v [m/s] and σ_δ [m], a row for each numerator, shape (n_numerators, n_excitations)."""
        factors = {
            (i, j): (damping**i * hardening**j)[self.excitations.of_point] for i, j in self.characteristic if i or j
        }
        power = self.excitations.weight / _square(self.characteristic, factors)
        squares = [
            np.add.reduceat(power * _square(numerator, factors), self.excitations.first_point)
            for numerator in self.numerators
        ]
        return np.asarray(self.level * np.sqrt(squares))


def motion_at(physics: AxisPhysics, lines: PreparedLines, states: AxisStates) -> Motion:
    """Return the motion in the effects that are there: evaluated at the knots, carried to the points."""
    excitations, added = lines.excitations, physics.added
    characteristic, *motions = _functions(physics, excitations, states.at(excitations.case[excitations.of_knot]))
    acting = bool(added.guide_friction), bool(added.cubic_nut_stiffness)
    functions = [
        {
            powers: _at_points(excitations, term)
            for powers, term in function.items()
            if np.all(np.array(powers) <= acting)
        }
        for function in (characteristic, *itertools.compress(motions, acting))
    ]
    level = lines.conditions.excitation_level[excitations.case]
    return Motion(excitations, level, functions[0], tuple(functions[1:]))


def _functions(physics: AxisPhysics, excitations: Excitations, states: AxisStates) -> tuple[Bilinear, ...]:
    r"""Return Δ, jωxΔ and δΔ at the knots.

    With the letters of ``closed_form``, P = A T and C = 1/κ + Q/P,

    .. math::

        \Delta = \kappa P + Z (P + \kappa Q), \quad
        x = \frac{\kappa u P}{\Delta},\; \delta = \frac{Z u P}{\Delta} \text{ per torque}, \quad
        x = \frac{P + \kappa Q}{\Delta},\; \delta = \frac{P}{\Delta} \text{ per force}

    where the damper adds jωc to Z and hardening adds hk to κ.
    """
    parts = entire_parts(physics, excitations.omega, states, excitations.ends)
    p = parts.axial * parts.torsion
    q = parts.axial_yield * parts.torsion + parts.turning * parts.axial + parts.bracket * p
    damper, spring = 1j * excitations.omega, nut_spring(physics, excitations.omega, parts.nut)
    by_torque, lever = excitations.by_torque, parts.torque_lever * parts.axial
    behind_table = p + parts.nut * q
    characteristic = {
        (0, 0): parts.nut * p + parts.table * behind_table,
        (1, 0): damper * behind_table,
        (0, 1): spring * (p + parts.table * q),
        (1, 1): damper * spring * q,
    }
    velocity = {
        (0, 0): damper * np.where(by_torque, parts.nut * lever, behind_table),
        (0, 1): damper * spring * np.where(by_torque, lever, q),
    }
    deflection = {
        (0, 0): np.where(by_torque, parts.table * lever, p),
        (1, 0): np.where(by_torque, damper * lever, 0.0),
    }
    return characteristic, velocity, deflection


def _at_points(excitations: Excitations, at_knots: NumberArray) -> FloatArray:
    """Return real and imaginary part between the knots, (2, n_points)."""
    return np.array([excitations.interpolation @ part for part in (at_knots.real, at_knots.imag)])


def nut_spring(physics: AxisPhysics, omega: FloatArray, nut: NumberArray) -> NumberArray:
    """Return what of the nut's κ is its spring, which hardens, with its loss; the rest is the damper. [N/m]."""
    return np.asarray(nut - 1j * omega * physics.joints.nut_damping)


def _square(function: Pointwise, factors: Mapping[tuple[int, int], FloatArray]) -> FloatArray:
    """Return the square of the magnitude, (n_points,), given the products of powers."""
    value = function[0, 0]
    for powers, factor in factors.items():
        if powers in function:
            value = value + factor * function[powers]
    square: FloatArray = np.sum(value * value, axis=0)
    return square
