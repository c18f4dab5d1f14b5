r"""What the contacts of the nut carry: the nut itself, its bracket, the table, and what hangs on nut and table.

The nut has the dynamic stiffness n/e before the bracket :math:`c_s`, the table z/d behind it, functions of ω without
poles. The models have n = 0 and d = e = 1: all that moves is one body behind the bracket. With a nut of mass
:math:`m_n`, which then is no part of the table, and absorbers of mass m, natural frequency :math:`\omega_a` and damping
ratio ζ whose driving-point stiffness is that of a mass on a spring and a damper,

.. math::

    \frac{n}{e} = -\omega^2 m_n + Z_a, \qquad \frac{z}{d} = Z + \omega^2 m_n + Z_a, \qquad
    Z_a = -\omega^2 m \frac{1 + 2j\zeta r}{1 - r^2 + 2j\zeta r}, \quad r = \frac{\omega}{\omega_a}

each with an absorber of its own. Where the contacts push against :math:`L/(e S)`, with

.. math:: S = d + c_s z, \qquad L = n S + e z

a travel a of the unloaded nut behind the compliance C' of everything before the bracket moves the nut by
:math:`a\,e S/N` and the table by :math:`a\,e d/N`, and takes the force :math:`a L/N`, with :math:`N = e S + C' L`.
A force at the table moves that by :math:`d [C' e + c_s (e + C' n)]/N`. (Den Hartog, Mechanical Vibrations, section 3.2,
for the absorber; the chain is two springs and two bodies.)
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from monitor_core.arrays import FloatArray, NumberArray, acts
from monitor_core.models.extended.physics import AddedPhysics, SecondAxis

_Function = NumberArray | float  # a plain number where it is that at every frequency


@dataclass(frozen=True, slots=True, eq=False)
class Carried:
    """The letters of the module's docstring, functions of ω without poles; shape (n_lines,) or ()."""

    bracket: NumberArray  # c_s of bracket and series compliance [m/N]
    table: NumberArray  # z [N/m]
    table_pole: _Function = 1.0  # d
    nut: _Function = 0.0  # n [N/m]
    nut_pole: _Function = 1.0  # e

    @property
    def is_table(self) -> bool:
        """Whether there is nothing but a table behind a bracket."""
        return isinstance(self.table_pole, float) and isinstance(self.nut, float)

    @property
    def swing(self) -> NumberArray:
        """S: zero where the table swings on its bracket, the nut held still."""
        swing: NumberArray = self.table_pole + self.bracket * self.table
        return swing

    @property
    def load(self) -> NumberArray:
        """L: zero where all that is carried would swing by itself, free of the contacts."""
        load: NumberArray = self.nut * self.swing + self.nut_pole * self.table
        return load

    def reached_through(self, compliance: NumberArray) -> "Reached":
        """Return how nut and table move behind a compliance C'."""
        d, e, swing, load = self.table_pole, self.nut_pole, self.swing, self.load
        reciprocal = 1.0 / (e * swing + compliance * load)
        per_force = d * (compliance * e + self.bracket * (e + compliance * self.nut)) * reciprocal
        return Reached(
            per_force, d * e * reciprocal, load * reciprocal, compliance * d * e * reciprocal, e * swing * reciprocal
        )

    def damped(self, damper: NumberArray) -> "Carried":
        """Return the same with one more damper between table and ground, jωc."""
        return replace(self, table=self.table + damper * self.table_pole)

    def with_nut_of(self, mass: float | FloatArray, omega: FloatArray) -> "Carried":
        """Return the same with a mass taken from the table to the nut."""
        inertia = omega * omega * mass
        return replace(self, table=self.table + inertia * self.table_pole, nut=self.nut - inertia * self.nut_pole)


@dataclass(frozen=True, slots=True, eq=False)
class Reached:
    """What is carried, behind a compliance; shape (n_lines,)."""

    table_per_force: NumberArray  # at the table [m/N]
    table_per_travel: NumberArray  # of the unloaded nut [-]
    stiffness: NumberArray  # force per travel of the unloaded nut [N/m]
    nut_per_force: NumberArray  # at the table [m/N]
    nut_per_travel: NumberArray  # [-]


def carried_by_contacts(
    added: AddedPhysics, omega: NumberArray, bracket: NumberArray, table: NumberArray, table_pole: _Function = 1.0
) -> Carried:
    """Return what the contacts carry, given bracket and table of a drive without nut mass and absorbers."""
    if not (acts(added.nut_mass) or acts(added.table_absorber_mass) or acts(added.nut_absorber_mass)):
        return Carried(bracket, table, table_pole)
    squared = omega * omega
    e: NumberArray = 1.0 + 0.0 * squared
    d: NumberArray = table_pole * e
    z, n = table + squared * added.nut_mass * d, -squared * added.nut_mass
    if acts(added.table_absorber_mass):
        own, load = absorber(
            omega, added.table_absorber_mass, added.table_absorber_frequency, added.table_absorber_damping_ratio
        )
        z, d = z * own + load * d, d * own
    if acts(added.nut_absorber_mass):
        e, load = absorber(
            omega, added.nut_absorber_mass, added.nut_absorber_frequency, added.nut_absorber_damping_ratio
        )
        n = n * e + load
    return Carried(bracket, z, d, n, e)


@dataclass(frozen=True, slots=True, eq=False)
class SlidingBody:
    r"""The table of the lower of two axes, sliding and yawing, with what the upper one adds across its own direction.

    Of its dynamic stiffness B, 2 x 2 in travel and yaw, of the arm p of its own nut and the arm w of the upper screw,

    .. math:: \beta = \det B, \quad P = p^T \mathrm{adj}B\,p, \quad W = w^T \mathrm{adj}B\,w, \quad
              V = w^T \mathrm{adj}B\,p, \quad X = (p \times w)^2

    With the stiffness n/d of the upper axis at its base, the lower nut meets :math:`(\beta d + W n)/(P d + X n)`; with
    n/d that of the lower drive at its nut, the upper axis stands on :math:`(\beta d + P n)/(W d + X n)`. (The
    determinant of B with two terms of rank one, written out.)
    """

    determinant: NumberArray  # β
    at_nut: _Function  # P
    at_base: _Function  # W
    across: _Function  # V
    twist: float  # X

    def met_by_nut(self, n: NumberArray, d: NumberArray) -> tuple[NumberArray, NumberArray]:
        """Return numerator and denominator of what the lower nut meets, given those of the upper axis at its base."""
        return self.determinant * d + self.at_base * n, self.at_nut * d + self.twist * n

    def met_by_base(self, n: NumberArray, d: NumberArray) -> tuple[NumberArray, NumberArray]:
        """Return those of what the upper axis stands on, given those of the lower drive at its nut."""
        return self.determinant * d + self.at_nut * n, self.at_base * d + self.twist * n


def sliding_body(
    second: SecondAxis, omega: NumberArray, table: NumberArray, moments: tuple[NumberArray, NumberArray, NumberArray]
) -> SlidingBody:
    """Return the lower table, given its own dynamic stiffness and mass, first and second moment of what slides on it.

    The moments are along the upper screw, about the centre of the guides.
    """
    cosine, sine = second.direction_cosine, math.sqrt(1.0 - second.direction_cosine**2)
    mass, first, square = moments
    squared = omega * omega
    travel = table - squared * sine**2 * mass
    if math.isinf(second.yaw_stiffness):
        return SlidingBody(travel, 1.0, cosine**2, cosine, 0.0)
    mixed = squared * sine * first
    damper = 1j * second.yaw_damping * omega if second.yaw_damping else 0.0
    yaw: NumberArray = second.yaw_stiffness + damper - squared * (second.yaw_inertia + square)
    e, a = -second.lower_offset, -second.upper_offset
    return SlidingBody(
        travel * yaw - mixed * mixed,
        yaw - 2.0 * e * mixed + e * e * travel,
        cosine**2 * yaw - 2.0 * cosine * a * mixed + a * a * travel,
        cosine * yaw - (cosine * e + a) * mixed + a * e * travel,
        (a - cosine * e) ** 2,
    )


def absorber(
    omega: NumberArray, mass: float, frequency: float, damping_ratio: float
) -> tuple[NumberArray, NumberArray]:
    """Return 1 − r² + 2jζr and −ω² m (1 + 2jζr): over the first, the second is Z_a of the module's docstring.

    Of what turns, with an inertia [kg·m²] in place of the mass, it is in N·m/rad.
    """
    ratio = omega / (2.0 * np.pi * frequency)
    damper = 2j * damping_ratio * ratio if acts(damping_ratio) else 0.0
    return 1.0 - ratio * ratio + damper, -omega * omega * mass * (1.0 + damper)
