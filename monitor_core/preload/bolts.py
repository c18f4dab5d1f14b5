r"""Set a preload on purpose: the torque of the bolts that press two nuts apart.

Of the double nut of Nguyen et al. (2018) bolts bear on the flange of the other nut, and share the preload P:

.. math:: T = \lambda F d, \qquad F = P / n

Eq. (9), which is printed without the d that its text explains. λ is the nut factor of textbooks (Shigley, Table 8–15):
0.2 of a dry bolt, .12 to .3 by surface and lubricant; a torque wrench knows a preload no better than that.
"""

from dataclasses import dataclass
from typing import Final

from monitor_core.errors import OutsideValidityError

#: λ of Eq. (9) "in most of the cases" [-].
USUAL_TORQUE_FACTOR: Final = 0.2


@dataclass(frozen=True, slots=True)
class PositioningBolts:
    """The bolts that a preload is set with."""

    diameter: float  # nominal, outside of the thread [m]
    count: int = 2  # they share the preload
    torque_factor: float = USUAL_TORQUE_FACTOR  # λ [-]

    def __post_init__(self) -> None:
        if not (self.diameter > 0.0 and self.count >= 1 and self.torque_factor > 0.0):
            raise OutsideValidityError(
                "bolts must have a diameter above 0 m, a torque factor above 0 and be one at least; got "
                f"{self.diameter:g} m, {self.torque_factor:g} and {self.count}"
            )

    def torque(self, preload: float) -> float:
        """Return the torque at each bolt for a preload [N]: Eq. (9) of Nguyen et al. (2018) [N·m].

        Examples
        --------
        Two bolts M4 for 100 N; the paper has ten times that (``docs/reference/errata.md``):

        >>> round(PositioningBolts(0.004).torque(100.0), 3)
        0.04
        """
        return self.torque_factor * preload / self.count * self.diameter
