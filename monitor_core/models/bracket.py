r"""Compute the response of an accelerometer on the nut's housing, before the bracket that carries the table.

Let C be the compliance of all that the force through the nut meets before the table, the bracket :math:`c_s` a part of
it; Z the dynamic stiffness of the table, u the travel of the unloaded nut per torque, so that

.. math:: H_{table,force} = \frac{C}{1 + C Z}, \qquad H_{table,torque} = \frac{u}{1 + C Z}

The models count the nut's mass with the table. Seen from its housing it has to be where it is:
:math:`\mu = -\omega^2 m_{nut}` before the bracket, :math:`Z' = Z - \mu` behind it. With :math:`C' = C - c_s`,

.. math::

    D = (1 + C' \mu)(1 + c_s Z') + C' Z', \qquad
    H_{nut,force} = \frac{C'}{D}, \qquad H_{nut,torque} = \frac{u (1 + c_s Z')}{D}

Where the table swings on its bracket by itself, :math:`1 + c_s Z' = 0`, a torque does not move the nut: an
antiresonance that follows bracket and table, and no preload.

The natural frequencies of the models and all other responses keep the nut's mass with the table: where a bracket is
stated and the nut has a mass, the peaks of an accelerometer on it differ from them, by 2.3 % on the machine of the
bundled sessions (1.3 of 21.8 kg). Where one of the two is absent nothing is moved, and the peaks are the natural
frequencies.
"""

import math
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import NumberArray, reciprocal


@dataclass(frozen=True, slots=True, eq=False)
class BeyondContacts:
    """What the contacts of the nut carry; shape (n_frequencies,) or ()."""

    nut: NumberArray  # μ [N/m]
    bracket: NumberArray | complex  # c_s [m/N]
    table: NumberArray  # Z' [N/m]


def beyond_contacts(
    s: NumberArray,  # jω, shape (n_frequencies,) [rad/s]
    *,
    table_mass: float,  # with all that moves with it but the nut [kg]
    nut_mass: float = 0.0,  # [kg]
    table_damping: float = 0.0,  # of the guides, to ground [N·s/m]
    bracket_stiffness: float = math.inf,  # [N/m]
    loss_factor: float = 0.0,  # of the bracket [-]
) -> BeyondContacts:
    """Return what the contacts of the nut carry."""
    return BeyondContacts(
        nut_mass * s**2, 1.0 / bracket_stiffness / (1.0 + 1j * loss_factor), table_mass * s**2 + table_damping * s
    )


def nut_receptances(
    compliance: NumberArray, unloaded_travel: NumberArray, beyond: BeyondContacts
) -> tuple[NumberArray, NumberArray]:
    """Return the displacement of the nut per force at the table [m/N] and per torque [m/(N·m)], from C and u."""
    before = compliance - beyond.bracket
    swinging = 1.0 + beyond.bracket * beyond.table
    closed = reciprocal(np.asarray((1.0 + before * beyond.nut) * swinging + before * beyond.table))
    return before * closed, unloaded_travel * swinging * closed


def nut_from_table(
    per_force: NumberArray, per_torque: NumberArray, beyond: BeyondContacts
) -> tuple[NumberArray, NumberArray]:
    """Return the same from the receptances of the table, with the same motor end and the nut's mass with the table."""
    loaded = 1.0 / (1.0 - (beyond.nut + beyond.table) * per_force)  # 1 + C Z
    return nut_receptances(per_force * loaded, per_torque * loaded, beyond)
