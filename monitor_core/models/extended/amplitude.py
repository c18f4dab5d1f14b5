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
"""

import contextlib
import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import ComplexArray, FloatArray, NumberArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended.closed_form import Path
from monitor_core.models.extended.conditions import AxisStates
from monitor_core.models.extended.lines import PreparedLines
from monitor_core.models.extended.physics import AxisPhysics
from monitor_core.models.extended.rms_motion import Motion, RmsSlopes, motion_at, nut_spring

_GAUSSIAN = np.sqrt(2.0 / np.pi)
#: Powers of the rms velocity and deflection that c and h go with.
_EXPONENTS = np.array([-1.0, 2.0])
#: Newton's method: longest step, one that leads next to where it began, and one whose square is nothing.
_LONGEST, _NEXT, _SETTLED = 2.0, 0.03, 1e-4
_ITERATIONS = 60
#: A balance is sought from first order where the drive at the knots changes by no more than this, and is taken from it
#: where both logarithms hardly do.
_ALIKE, _LINEAR = 0.02, 3e-4
_KEPT = 3  # balances that were found last
#: Nodes s and weights of Gauss's rule for averages over s exp(−s): exact for mean and slope of a parabola.
_ENERGIES = 3.0 + np.sqrt(3.0) * np.array([-1.0, 1.0])
_WEIGHTS = 0.5 - np.array([-1.0, 1.0]) / np.sqrt(12.0)
#: Of the continued fraction: off by 4e-7, 6e-4 and 2 % of the peak where a is 2, 5 and 10 times γ. Half of them are off
#: by less than 1e-6 where a is at most 0.4 times the distance to the resonance at any line.
_MOMENTS, _CALM = 12, 0.4


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
    energies, weights = (_ENERGIES, _WEIGHTS) if cubic else (np.array([2.0]), np.ones(1))
    balances = [_balanced(motion, friction, cubic, float(energy)) for energy in energies]
    # cases of small signals, numbered −1, find the zero behind the last excitation
    rows = np.pad(np.array(balances), ((0, 0), (0, 0), (0, 1)))[..., lines.excitations.of_case[lines.drive.case]]
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
    off, loss, square = distance.real, -distance.imag, slope**2
    width = np.maximum(loss, 0.0)
    calm = bool(np.all(square <= _CALM**2 * (off**2 + loss**2)))
    # by real and imaginary parts: a division of complex arrays takes several times as long
    real, imaginary = np.zeros_like(mean), np.zeros_like(mean)
    for n in range(_MOMENTS // 2 if calm else _MOMENTS, 0, -1):
        real += loss + 2 * n * width
        imaginary += off - 2 * n * slope
        share = n * (n + 1) * square / (real**2 + imaginary**2)
        real, imaginary = share * real, -share * imaginary
    seen = mean - imaginary + 1j * real
    return np.asarray(seen / (1.0 - others * seen))


def _balanced(motion: Motion, friction: float, cubic: float, energy: float) -> FloatArray:
    """Return rows c and h that agree with their own motion, (2, n_excitations), at s = ``energy`` (2: the rms motion).

    A derivative asks for axes that hardly differ: those follow linearly from one that was found for these excitations.
    Others are sought from the last one where that is next to them, and otherwise from the linear motion.
    """
    balance = _Balance(motion, np.array([friction * _GAUSSIAN, 1.5 * energy * cubic]))
    kind, known = (*np.sign(balance.wanted).tolist(), energy), motion.excitations.balances
    before = known.get(kind, ())
    nearest = None
    for last in before:
        step = last.step_to(balance)
        if step is not None and np.max(np.abs(step)) <= _LINEAR:
            known[kind] = (last, *(other for other in before if other is not last))
            return balance.rows(last.logarithms + step)
        if step is not None and nearest is None:
            nearest = last.logarithms + step
    balanced = None
    if before:
        with contextlib.suppress(OutsideValidityError):
            balanced = balance.sought_from(before[0].logarithms if nearest is None else nearest, longest=_NEXT)
    if balanced is None:
        if friction and not cubic:
            _require_sliding(motion, friction)
        balanced = balance.sought_from(balance.linear())
    if balanced is None:
        raise OutsideValidityError(
            f"no motion of the axis agrees with its own linearisation (guide_friction {friction:g} N, "
            f"cubic_nut_stiffness {cubic:g} 1/m²); lower one of them"
        )
    known[kind] = (balanced, *before[: _KEPT - 1])
    return balanced.rows


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
        return np.array(self.motion.acting)

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

    def sought_from(self, start: FloatArray, longest: float = math.inf) -> "_Found | None":
        """Return the balance, None if there is none or a step to it would be longer than that."""
        logarithms = start
        with contextlib.suppress(np.linalg.LinAlgError):  # nowhere to go: as good as no answer
            for _ in range(_ITERATIONS):
                rms, slopes = self.motion.rms_and_slopes(*self.rows(logarithms))
                step = self.step_that_takes(self._left_by(logarithms, rms), slopes)
                step = np.clip(step, -_LONGEST, _LONGEST)
                logarithms, length = logarithms + step, float(np.max(np.abs(step)))
                if length < _SETTLED:
                    return _Found.of(self, logarithms, slopes)
                if length > longest:
                    return None
        return None

    def step_that_takes(self, off: FloatArray, slopes: FloatArray) -> FloatArray:
        """Return the step of the logarithms that takes away by how much they are too large, as the motion follows."""
        acting = self.acting
        jacobian = np.eye(acting.size)[:, :, None] - _EXPONENTS[acting, None, None] * slopes
        return np.asarray(-np.linalg.solve(np.moveaxis(jacobian, 2, 0), off.T[..., None])[..., 0].T)

    def _left_by(self, logarithms: FloatArray, rms: FloatArray) -> FloatArray:
        """Return by how much logarithms are larger than their motion asks for."""
        acting = self.acting
        constant = np.log(np.abs(self.wanted[acting, None]))
        return np.asarray(logarithms - constant - _EXPONENTS[acting, None] * np.log(rms))


@dataclass(slots=True, eq=False)
class _Found:
    """A balance that was found, and how it moves with the drive."""

    wanted: FloatArray
    level: FloatArray
    logarithms: FloatArray
    rows: FloatArray
    by_own: FloatArray  # slopes of ln σ by ln c and ln h, of those that are there
    at_knots: ComplexArray
    by_drive: RmsSlopes | None = None  # known once it was asked for

    @classmethod
    def of(cls, balance: _Balance, logarithms: FloatArray, slopes: FloatArray) -> "_Found":
        """Return a balance at its logarithms; raises OutsideValidityError of a nut without any stiffness."""
        motion, rows = balance.motion, balance.rows(logarithms)
        return cls(balance.wanted, motion.level, logarithms, rows, slopes, motion.at_knots(*rows))

    def step_to(self, other: _Balance) -> FloatArray | None:
        """Return the step of the logarithms to another balance, to first order; None where the drive differs much."""
        motion, acting = other.motion, other.acting
        change = motion.at_knots(*self.rows) - self.at_knots
        if not np.all(np.abs(change) <= _ALIKE * np.abs(self.at_knots)):
            return None
        if self.by_drive is None:
            self.by_drive = RmsSlopes.at(motion.excitations, self.at_knots)
        rising = self.by_drive.along(change) + np.log(motion.level / self.level)
        wanted = np.log(other.wanted[acting] / self.wanted[acting])
        try:
            return other.step_that_takes(-wanted[:, None] - _EXPONENTS[acting, None] * rising, self.by_own)
        except np.linalg.LinAlgError:  # it leads nowhere from here
            return None


def _require_sliding(motion: Motion, friction: float) -> None:
    """Refuse friction that the excitation cannot overcome: c σ_v never exceeds the rms force on a table held still."""
    held = replace(motion, characteristic={(0, 0): motion.characteristic[1, 0]})
    weakest = float(np.min(held.rms(*np.zeros((2, motion.level.size))))) / _GAUSSIAN
    if friction >= weakest:
        raise OutsideValidityError(
            f"guide_friction must lie below {weakest:g} N, beyond which it holds the table at the stated excitation; "
            f"got {friction:g} N"
        )
