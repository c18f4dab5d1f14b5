"""Compute the rms motion of table and nut under the stated excitation, and how it follows the drive.

Velocity of the table and deflection of the nut are functions of two numbers: the damper c that stands for friction,
and the hardening h of the nut; see :mod:`.amplitude`.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import ComplexArray, FloatArray, NumberArray
from monitor_core.models.extended.closed_form import entire_parts
from monitor_core.models.extended.conditions import AxisStates
from monitor_core.models.extended.lines import Excitations, PreparedLines
from monitor_core.models.extended.physics import AxisPhysics

#: Terms of f_00 + c f_10 + h f_01 + c h f_11, a function of damper and hardening, by the two powers.
Bilinear = Mapping[tuple[int, int], NumberArray]


@dataclass(frozen=True, slots=True, eq=False)
class _Square:
    """The square of the magnitude of a bilinear function at the points: a polynomial in c and h with real factors."""

    powers: tuple[tuple[int, int], ...]  # of c and h in each term
    factors: FloatArray  # at the points of each excitation, shape (n_excitations, n_terms, n_points of one)

    @classmethod
    def of(cls, excitations: Excitations, function: Bilinear) -> "_Square":
        """Return the square of a function that is known at the knots."""
        terms = dict(zip(function, _at_points(excitations, tuple(function.values())), strict=True))
        products: dict[tuple[int, int], FloatArray] = {}
        for (first, value), (second, other) in itertools.combinations_with_replacement(terms.items(), 2):
            powers = first[0] + second[0], first[1] + second[1]
            product = (1.0 if first == second else 2.0) * (value[0] * other[0] + value[1] * other[1])
            products[powers] = products[powers] + product if powers in products else product
        factors = np.array(list(products.values())).reshape(len(products), excitations.size, -1)
        return cls(tuple(products), factors.transpose(1, 0, 2))

    def at(self, damping: FloatArray, hardening: FloatArray, by: Sequence[int]) -> FloatArray:
        """Return the square and how it goes with ln c (0) or ln h (1), (n_excitations, 1 + n_by, n_points of one)."""
        powers = np.array(self.powers)
        monomials = damping[:, None] ** powers[:, 0] * hardening[:, None] ** powers[:, 1]
        degrees = np.vstack([np.ones(len(powers)), powers.T[list(by)]])
        return np.asarray(np.matmul(degrees * monomials[:, None], self.factors))


@dataclass(frozen=True, eq=False)
class Motion:
    """Velocity of the table and deflection of the nut as functions of damper c and hardening h, at the points.

    Only terms and motions of effects that are there.
    """

    excitations: Excitations
    level: FloatArray  # rms of each excitation, shape (n_excitations,)
    acting: tuple[int, ...]  # 0 where there is friction, 1 where the nut hardens
    characteristic: Bilinear  # at the knots
    numerators: tuple[Bilinear, ...]  # at the knots, of jωx where there is friction, of δ where the nut hardens

    @cached_property
    def _squares(self) -> tuple[_Square, ...]:
        return tuple(_Square.of(self.excitations, function) for function in (self.characteristic, *self.numerators))

    def at_knots(self, damping: FloatArray, hardening: FloatArray) -> ComplexArray:
        """Return characteristic and numerators, (1 + n_numerators, n_knots), at c and h of each excitation."""
        c, h = damping[self.excitations.of_knot], hardening[self.excitations.of_knot]
        both = {(0, 0): np.ones_like(c), (1, 0): c, (0, 1): h, (1, 1): c * h}
        values = np.zeros((1 + len(self.numerators), c.size), dtype=np.complex128)
        for row, function in enumerate((self.characteristic, *self.numerators)):
            for powers, term in function.items():
                values[row] += both[powers] * term
        return values

    def rms(self, damping: FloatArray, hardening: FloatArray) -> FloatArray:
        """Return σ_v [m/s] and σ_δ [m], a row for each numerator, shape (n_numerators, n_excitations)."""
        return self._rms_and_slopes(damping, hardening, ())[0]

    def rms_and_slopes(self, damping: FloatArray, hardening: FloatArray) -> tuple[FloatArray, FloatArray]:
        r"""Return the rms and :math:`\partial \ln\sigma/\partial \ln` of what acts of c and h.

        The shapes are (n_numerators, n_excitations) and (n_numerators, n_acting, n_excitations).
        """
        return self._rms_and_slopes(damping, hardening, self.acting)

    def _rms_and_slopes(
        self, damping: FloatArray, hardening: FloatArray, by: Sequence[int]
    ) -> tuple[FloatArray, FloatArray]:
        (below, *numerators) = (square.at(damping, hardening, by) for square in self._squares)
        share = self.excitations.weight.reshape(self.excitations.size, -1) / below[:, 0]
        slope_below = below[:, 1:] / below[:, :1]
        rms, slopes = [], []
        for above in numerators:
            above[:, 1:] -= above[:, :1] * slope_below
            sums = np.matmul(above, share[:, :, None])[..., 0].T
            rms.append(self.level * np.sqrt(sums[0]))
            slopes.append(0.5 * sums[1:] / sums[0])
        return np.array(rms), np.array(slopes)


def motion_at(physics: AxisPhysics, lines: PreparedLines, states: AxisStates) -> Motion:
    """Return the motion in the effects that are there: evaluated at the knots, carried to the points."""
    excitations, added = lines.excitations, physics.added
    case = excitations.case[excitations.of_knot]
    characteristic, *motions = _functions(physics.at(case), excitations, states.at(case))
    acting = bool(added.guide_friction), bool(added.cubic_nut_stiffness)
    indices = tuple(np.flatnonzero(acting).tolist())
    functions = [
        {powers: term for powers, term in function.items() if np.all(np.array(powers) <= acting)}
        for function in (characteristic, *itertools.compress(motions, acting))
    ]
    level = lines.conditions.excitation_level[excitations.case]
    return Motion(excitations, level, indices, functions[0], tuple(functions[1:]))


def _functions(physics: AxisPhysics, excitations: Excitations, states: AxisStates) -> tuple[Bilinear, ...]:
    r"""Return Δ, jωxΔ and δΔ at the knots.

    With the letters of ``closed_form`` and ``carried``, P = A T and C' = 1/κ + Q/P,

    .. math::

        \Delta = \kappa e S P + L (P + \kappa Q), \quad
        x = \frac{\kappa d e u P}{\Delta},\; \delta = \frac{L u P}{\Delta} \text{ per torque}, \quad
        x = \frac{d [(P + \kappa Q)(e + c_s n) + \kappa c_s e P]}{\Delta},\; \delta = \frac{d e P}{\Delta}
        \text{ per force}

    where the damper adds jωcd to z, :math:`c_s d` and :math:`e + c_s n` times as much to S and L, and hardening adds hk
    to κ.
    """
    parts = entire_parts(physics, excitations.omega, states, excitations.ends, excitations.memory)
    carried = parts.carried
    d, e, swing, load = carried.table_pole, carried.nut_pole, carried.swing, carried.load
    p = parts.axial * parts.torsion
    q = parts.axial_yield * parts.torsion + parts.turning * parts.axial
    damper, spring = 1j * excitations.omega, nut_spring(physics, excitations.omega, parts.nut)
    by_torque, lever = excitations.by_torque, d * e * parts.torque_lever * parts.axial
    swung, loaded = carried.bracket * e, e + carried.bracket * carried.nut  # S and L per z
    behind_nut = p + parts.nut * q
    behind_table, behind_table_per_nut = swung * parts.nut * p + loaded * behind_nut, swung * p + loaded * q
    characteristic = {
        (0, 0): parts.nut * e * swing * p + load * behind_nut,
        (1, 0): damper * d * behind_table,
        (0, 1): spring * (e * swing * p + load * q),
        (1, 1): damper * spring * d * behind_table_per_nut,
    }
    velocity = {
        (0, 0): damper * np.where(by_torque, parts.nut * lever, d * behind_table),
        (0, 1): damper * spring * np.where(by_torque, lever, d * behind_table_per_nut),
    }
    unloaded = parts.torque_lever * parts.axial
    deflection = {
        (0, 0): np.where(by_torque, load * unloaded, d * e * p),
        (1, 0): np.where(by_torque, damper * d * loaded * unloaded, 0.0),
    }
    return characteristic, velocity, deflection


def _at_points(excitations: Excitations, at_knots: Sequence[NumberArray]) -> FloatArray:
    """Return real and imaginary part of functions between the knots, (n_functions, 2, n_points)."""
    parts = np.stack([part for function in at_knots for part in (function.real, function.imag)], axis=-1)
    return np.ascontiguousarray((excitations.interpolation @ parts).T).reshape(len(at_knots), 2, -1)


def _complex_at_points(excitations: Excitations, at_knots: ComplexArray) -> ComplexArray:
    """Return functions between the knots, (n_functions, n_points)."""
    values = _at_points(excitations, tuple(at_knots))
    return np.asarray(values[:, 0] + 1j * values[:, 1])


def _to_knots(excitations: Excitations, at_points: ComplexArray) -> ComplexArray:
    """Return what values at the points, (n_points,), weigh at the knots that they are interpolated from, (n_knots,)."""
    return np.asarray(
        (excitations.interpolation.T @ at_points.view(np.float64).reshape(-1, 2)).view(np.complex128)[:, 0]
    )


def nut_spring(physics: AxisPhysics, omega: FloatArray, nut: NumberArray) -> NumberArray:
    """Return what of the nut's κ is its spring, which hardens, with its loss; the rest is the damper. [N/m]."""
    return np.asarray(nut - 1j * omega * physics.joints.nut_damping)


@dataclass(frozen=True, slots=True, eq=False)
class RmsSlopes:
    r"""How the logarithms of the rms motion follow what the drive answers at the knots.

    With Δ and the numerators N interpolated to the points, and shares w of the power,

    .. math::

        \sigma^2 \propto \sum_p w \frac{|N|^2}{|\Delta|^2}, \qquad d \ln \sigma = \frac{1}{\sigma^2}
        \mathrm{Re} \sum_p w \left( \frac{\bar N}{|\Delta|^2} dN - \frac{|N|^2 \bar\Delta}{|\Delta|^4} d\Delta \right)

    in which the sum over points is carried to the knots once, whatever then moves.
    """

    by_numerator: ComplexArray  # shape (n_numerators, n_knots)
    by_characteristic: ComplexArray  # of each numerator, shape (n_numerators, n_knots)
    first_knot: npt.NDArray[np.intp]  # of each excitation

    @classmethod
    def at(cls, excitations: Excitations, at_knots: ComplexArray) -> "RmsSlopes":
        """Return the slopes where characteristic and numerators are known at the knots, (1 + n_numerators, n_knots)."""
        below, *above = _complex_at_points(excitations, at_knots)
        inverse = 1.0 / (below.real**2 + below.imag**2)
        by_numerator, by_characteristic = [], []
        for numerator in above:
            of_point = excitations.weight * (numerator.real**2 + numerator.imag**2) * inverse
            power = np.sum(of_point.reshape(excitations.size, -1), axis=1)
            share = inverse / power[excitations.of_point]
            by_numerator.append(_to_knots(excitations, excitations.weight * share * numerator.conj()))
            by_characteristic.append(_to_knots(excitations, -of_point * share * below.conj()))
        first_knot = np.searchsorted(excitations.of_knot, np.arange(excitations.size))
        return cls(np.array(by_numerator), np.array(by_characteristic), first_knot)

    def along(self, change: ComplexArray) -> FloatArray:
        """Return how ln σ of each numerator and excitation changes with small changes at the knots."""
        of_knots = self.by_numerator * change[1:] + self.by_characteristic * change[0]
        return np.asarray(np.add.reduceat(of_knots.real, self.first_knot, axis=1))
