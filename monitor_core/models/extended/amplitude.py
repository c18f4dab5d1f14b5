r"""Replace friction and a hardening nut by the linear drive that comes closest at a given excitation.

For a Gaussian motion the force :math:`F_c\,\mathrm{sign}(v)` is best replaced by a damper and :math:`k(1 + \beta
\delta^2)\delta` by a spring (least mean square error),

.. math::

    c_e = F_c \sqrt{\frac{2}{\pi}} \frac{1}{\sigma_v}, \qquad k_e = k (1 + h), \quad h = 3 \beta \sigma_\delta^2

(Roberts & Spanos, Random Vibration and Statistical Linearization, chapter 5). The rms values follow from the response
of the linear drive that contains both, to an excitation of the stated rms value that is flat over the lines of the
responses taken together and nothing outside them. An excitation level of 0 stands for small signals that friction does
not see.

The amplitude of a lightly damped resonance wanders, and with it the stiffness of a nut that hardens: a response is an
average over them. Where the square of the amplitude is s times its mean, the nut is as stiff as at the same excitation
with :math:`\beta s/2` in place of β. What is averaged counts s by :math:`s e^{-s}`; with the mean :math:`\bar h` and
the slope a of h(s) so weighted the lines see a hardening :math:`\bar h + j D`,

.. math::

    D = \cfrac{1 \cdot 2\, a^2}{j (h_p - \bar h - 2a) + 2 \gamma + \cfrac{2 \cdot 3\, a^2}
        {j (h_p - \bar h - 4a) + 4 \gamma + \cdots}}, \qquad \gamma = -\mathrm{Im}\, h_p

where the drive would resonate undamped at a hardening of :math:`h_p(\omega)`: the distance to the resonance and its
width. These are the moments of an oscillator under white noise whose stiffness follows s, in Laguerre polynomials of s,
of which the sum is known in closed form (Dykman & Krivoglaz, Phys. Status Solidi B 48 (1971) 497). The resonance at
hand is taken for the one that moves the nut. For each h stands :math:`h/(1 + \theta h)`, of which the stiffness of the
whole path is a linear function; θ is the share of everything but the nut in the compliance of the path, of which the
real part within 0 and 1 is taken. An excitation of one line, whose amplitude does not wander, is averaged all the same.

Compute the rms motion of table and nut under the stated excitation.

Velocity of the table and deflection of the nut are functions of two numbers: the damper c that stands for friction,
and the hardening h of the nut; see ``amplitude``.
"""

import contextlib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import FloatArray, NumberArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended.closed_form import Path, entire_parts
from monitor_core.models.extended.conditions import AxisStates
from monitor_core.models.extended.excitations import Excitations
from monitor_core.models.extended.lines import PreparedLines
from monitor_core.models.extended.physics import AxisPhysics

#: Terms of f_00 + c f_10 + h f_01 + c h f_11, a function of damper and hardening, by the two powers.
Bilinear = Mapping[tuple[int, int], NumberArray]


@dataclass(frozen=True, slots=True, eq=False)
class _Square:
    """The square of the magnitude of a bilinear function at the points: a polynomial in c and h with real factors."""

    powers: tuple[tuple[int, int], ...]  # of c and h in each term
    factors: FloatArray  # shape (n_terms, n_points)

    @classmethod
    def of(cls, excitations: Excitations, function: Bilinear) -> "_Square":
        """Return the square of a function that is known at the knots."""
        terms = dict(zip(function, _at_points(excitations, tuple(function.values())), strict=True))
        found: dict[tuple[int, int], FloatArray] = {}
        for (first, value), (second, other) in itertools.combinations_with_replacement(terms.items(), 2):
            powers = first[0] + second[0], first[1] + second[1]
            product = (1.0 if first == second else 2.0) * (value[0] * other[0] + value[1] * other[1])
            found[powers] = found[powers] + product if powers in found else product
        return cls(tuple(found), np.array(list(found.values())))

    def at(self, excitations: Excitations, damping: FloatArray, hardening: FloatArray) -> FloatArray:
        """Return the square and c and h times its derivatives by them, of shape (3, n_points)."""
        monomials = np.array([damping**i * hardening**j for i, j in self.powers])
        degrees = np.array([(1, i, j) for i, j in self.powers])
        rows = np.ascontiguousarray((degrees.T[:, :, None] * monomials).transpose(2, 0, 1))
        found = np.empty((3, self.factors.shape[1]))
        ends = [*excitations.first_point[1:].tolist(), self.factors.shape[1]]
        for of_excitation, start, end in zip(rows, excitations.first_point.tolist(), ends, strict=True):
            np.matmul(of_excitation, self.factors[:, start:end], out=found[:, start:end])
        return found


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Velocity of the table and deflection of the nut as functions of damper c and hardening h, at the points.

    Only terms and motions of effects that are there.
    """

    excitations: Excitations
    level: FloatArray  # rms of each excitation, shape (n_excitations,)
    characteristic: Bilinear  # at the knots
    numerators: tuple[Bilinear, ...]  # at the knots, of jωx where there is friction, of δ where the nut hardens
    _squares: tuple[_Square, ...] = field(init=False)

    def __post_init__(self) -> None:
        squares = (_Square.of(self.excitations, function) for function in (self.characteristic, *self.numerators))
        object.__setattr__(self, "_squares", tuple(squares))

    def rms(self, damping: FloatArray, hardening: FloatArray) -> FloatArray:
        """Return σ_v [m/s] and σ_δ [m], a row for each numerator, shape (n_numerators, n_excitations)."""
        return self.rms_and_slopes(damping, hardening)[0]

    def rms_and_slopes(self, damping: FloatArray, hardening: FloatArray) -> tuple[FloatArray, FloatArray]:
        r"""Return the rms and :math:`\partial \ln\sigma/\partial \ln` of c and h, (n_numerators, 2, n_excitations)."""
        excitations = self.excitations
        (below, *numerators) = (square.at(excitations, damping, hardening) for square in self._squares)
        share = excitations.weight / below[0]
        slope_below = below[1:] / below[0]
        rms, slopes = [], []
        for above in numerators:
            above[1:] -= above[0] * slope_below
            power, *by_both = np.add.reduceat(share * above, excitations.first_point, axis=1)
            rms.append(self.level * np.sqrt(power))
            slopes.append(0.5 * np.array(by_both) / power)
        return np.array(rms), np.array(slopes)


def motion_at(physics: AxisPhysics, lines: PreparedLines, states: AxisStates) -> Motion:
    """Return the motion in the effects that are there: evaluated at the knots, carried to the points."""
    excitations, added = lines.excitations, physics.added
    case = excitations.case[excitations.of_knot]
    characteristic, *motions = _functions(physics.at(case), excitations, states.at(case))
    acting = bool(added.guide_friction), bool(added.cubic_nut_stiffness)
    functions = [
        {powers: term for powers, term in function.items() if np.all(np.array(powers) <= acting)}
        for function in (characteristic, *itertools.compress(motions, acting))
    ]
    level = lines.conditions.excitation_level[excitations.case]
    return Motion(excitations, level, functions[0], tuple(functions[1:]))


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


def nut_spring(physics: AxisPhysics, omega: FloatArray, nut: NumberArray) -> NumberArray:
    """Return what of the nut's κ is its spring, which hardens, with its loss; the rest is the damper. [N/m]."""
    return np.asarray(nut - 1j * omega * physics.joints.nut_damping)


_GAUSSIAN = np.sqrt(2.0 / np.pi)
#: Powers of the rms velocity and deflection that c and h go with.
_EXPONENTS = np.array([-1.0, 2.0])
#: Newton's method: longest step, one that leads next to where it began, and one whose square is nothing.
_LONGEST, _NEXT, _SETTLED = 2.0, 0.03, 1e-5
_ITERATIONS = 60
#: Nodes s and weights of Gauss's rule for averages over s exp(−s): exact for mean and slope of a parabola.
_ENERGIES = 3.0 + np.sqrt(3.0) * np.array([-1.0, 1.0])
_WEIGHTS = 0.5 - np.array([-1.0, 1.0]) / np.sqrt(12.0)
#: Of the continued fraction: off by 4e-7, 6e-4 and 2 % of the peak where a is 2, 5 and 10 times γ.
_MOMENTS = 12


def linearise(path: Path, physics: AxisPhysics, lines: PreparedLines, states: AxisStates) -> Path:
    """Return the path with the damper that stands for friction and the spring that stands for a hardening nut.

    Where both effects are absent it is the same path. ``OutsideValidityError`` if friction holds the table at the
    stated excitation, a softening nut has no stiffness left at an amplitude that is averaged over (β counts 2.4 fold
    there), or no motion agrees with its own linearisation.
    """
    friction, cubic = physics.added.guide_friction, physics.added.cubic_nut_stiffness
    if not (lines.excitations.size and (friction or cubic)):
        return path
    motion = motion_at(physics, lines, states)
    if friction and not cubic:
        _require_sliding(motion, friction)
    energies, weights = (_ENERGIES, _WEIGHTS) if cubic else (np.array([2.0]), np.ones(1))
    found = [_balanced(motion, friction, cubic, float(energy)) for energy in energies]
    # cases of small signals, numbered −1, find the zero behind the last excitation
    rows = np.pad(np.array(found), ((0, 0), (0, 0), (0, 1)))[..., lines.excitations.of_case[lines.drive.case]]
    damping, hardening = np.moveaxis(rows, 1, 0)
    carried = path.carried.damped(1j * lines.drive.omega * (weights @ damping))
    if not cubic:
        return replace(path, carried=carried)
    spring = nut_spring(physics.at(lines.drive.case), lines.drive.omega, path.nut)
    # stiffness of the nut at which all of the path gives way
    resonant = -carried.load / (carried.nut_pole * carried.swing + path.before_bracket * carried.load)
    others = np.clip((path.beside_nut / path.compliance).real, 0.0, 1.0)
    seen = _averaged(hardening, (resonant - path.nut) / spring, others)
    return replace(path, carried=carried, nut=path.nut + seen * spring)


def _averaged(hardening: FloatArray, resonant: NumberArray, others: FloatArray) -> NumberArray:
    """Return the hardening that lines see, from that at both energies, (2, n_lines), h_p and θ, (n_lines,)."""
    stiffer = hardening / (1.0 + others * hardening)
    mean = _WEIGHTS @ stiffer
    slope = 0.5 * (_WEIGHTS * (_ENERGIES - 2.0)) @ stiffer
    distance = resonant / (1.0 + others * resonant) - mean
    width = np.maximum(-distance.imag, 0.0)
    rest: NumberArray = np.zeros(mean.shape, dtype=np.complex128)
    for n in range(_MOMENTS, 0, -1):
        rest = n * (n + 1) * slope**2 / (1j * (distance - 2 * n * slope) + 2 * n * width + rest)
    seen = mean + 1j * rest
    return np.asarray(seen / (1.0 - others * seen))


def _balanced(motion: Motion, friction: float, cubic: float, energy: float) -> FloatArray:
    """Return rows c and h that agree with their own motion, (2, n_excitations), at s = ``energy`` (2: the rms motion).

    They are sought from those found last for these excitations where those are next to them, for a derivative asks for
    axes that hardly differ; otherwise from the linear motion.
    """
    balance = _Balance(motion, np.array([friction * _GAUSSIAN, 1.5 * energy * cubic]))
    kind, known = (*np.sign(balance.wanted).tolist(), energy), motion.excitations.balances
    found = None
    if kind in known:
        with contextlib.suppress(OutsideValidityError):
            found = balance.sought_from(known[kind], longest=_NEXT)
    if found is None:
        found = balance.sought_from(balance.linear())
    if found is None:
        raise OutsideValidityError(
            f"no motion of the axis agrees with its own linearisation (guide_friction {friction:g} N, "
            f"cubic_nut_stiffness {cubic:g} 1/m²); lower one of them"
        )
    known[kind] = found
    return balance.rows(found)


@dataclass(frozen=True, slots=True, eq=False)
class _Balance:
    """Damper and hardening that agree with the motion they lead to, by Newton's method on their logarithms.

    In these both sides are nearly straight lines. That of c σ_v rises ever more slowly with c, that of h/σ_δ² with −h
    of a nut that softens and ever faster with h of one that hardens: from the linear motion no step leads too far.
    """

    motion: Motion
    wanted: FloatArray  # c σ_v and h/σ_δ², 0 of what is not there

    @property
    def acting(self) -> npt.NDArray[np.intp]:
        """Which of them are there; logarithms have shape (n_acting, n_excitations)."""
        return np.flatnonzero(self.wanted)

    def rows(self, logarithms: FloatArray) -> FloatArray:
        """Return c and h, shape (2, n_excitations); raises OutsideValidityError of a nut without any stiffness."""
        rows, acting = np.zeros((2, self.motion.level.size)), self.acting
        rows[acting] = np.sign(self.wanted[acting, None]) * np.exp(logarithms)
        if np.any(rows[1] <= -1.0):
            raise OutsideValidityError("the nut softens to nothing at the stated excitation; raise cubic_nut_stiffness")
        return rows

    def linear(self) -> FloatArray:
        """Return the logarithms that the motion without both leads to."""
        rms = self.motion.rms(*np.zeros((2, self.motion.level.size)))
        return -self._left_by(np.zeros_like(rms), rms)

    def sought_from(self, start: FloatArray, longest: float = math.inf) -> FloatArray | None:
        """Return the logarithms, None if there are none or a step to them would be longer than that."""
        logarithms = start
        with contextlib.suppress(np.linalg.LinAlgError):  # nowhere to go: as good as no answer
            for _ in range(_ITERATIONS):
                step = self._step(logarithms)
                logarithms, length = logarithms + step, float(np.max(np.abs(step)))
                if length < _SETTLED:
                    return logarithms
                if length > longest:
                    return None
        return None

    def _step(self, logarithms: FloatArray) -> FloatArray:
        acting = self.acting
        rms, slopes = self.motion.rms_and_slopes(*self.rows(logarithms))
        jacobian = np.eye(acting.size)[:, :, None] - _EXPONENTS[acting, None, None] * slopes[:, acting]
        off = self._left_by(logarithms, rms)
        step = -np.linalg.solve(np.moveaxis(jacobian, 2, 0), off.T[..., None])[..., 0].T
        return np.asarray(np.clip(step, -_LONGEST, _LONGEST))

    def _left_by(self, logarithms: FloatArray, rms: FloatArray) -> FloatArray:
        """Return by how much logarithms are larger than their motion asks for."""
        acting = self.acting
        constant = np.log(np.abs(self.wanted[acting, None]))
        return np.asarray(logarithms - constant - _EXPONENTS[acting, None] * np.log(rms))


def _require_sliding(motion: Motion, friction: float) -> None:
    """Refuse friction that the excitation cannot overcome: c σ_v never exceeds the rms force on a table held still."""
    held = replace(motion, characteristic={(0, 0): motion.characteristic[1, 0]})
    weakest = float(np.min(held.rms(*np.zeros((2, motion.level.size))))) / _GAUSSIAN
    if friction >= weakest:
        raise OutsideValidityError(
            f"guide_friction must lie below {weakest:g} N, beyond which it holds the table at the stated excitation; "
            f"got {friction:g} N"
        )
