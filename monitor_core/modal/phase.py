"""Calibrate polarity and delay between the channels, once for each axis."""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.response import ModalParameters


@dataclass(frozen=True, slots=True)
class PhaseReference:
    """How the response channel stands to the excitation channel."""

    polarity: int  # +1, or −1 if one channel is wired or mounted the other way round
    delay: float  # of the response behind the excitation [s]

    def __post_init__(self) -> None:
        if self.polarity not in (1, -1):
            raise OutsideValidityError(f"polarity must be +1 or -1; got {self.polarity}")

    def deviation(self, mode: ModalParameters) -> float:
        """Return the phase of the residue, corrected for polarity and delay, in radians.

        It is 0 for a torque and an acceleration at the two ends of a passive axis moving in phase.
        """
        turned = self.polarity * mode.residue * cmath.exp(2j * math.pi * mode.frequency.value * self.delay)
        return cmath.phase(turned)


def calibrate_phase(modes: Sequence[ModalParameters]) -> PhaseReference:
    r"""Find polarity and delay from modes known to be good.

    .. math:: \arg(\pm R_i) = -2\pi f_i \tau

    by least squares over the modes; of the two polarities the one with the smaller delay is taken, so that the delay
    stays below a quarter of a period.

    ``modes``: modes of the same axis and channels, e.g. of the calibration's measurements. Returned: polarity and
    delay. ``NotIdentifiableError`` if there is no mode, or the residues' phases cancel.

    Examples
    --------
    A mode at 100 Hz whose residue lags by a tenth of a turn: 1 ms.

    >>> from monitor_core.uncertainty import Estimate
    >>> lagging = ModalParameters(Estimate(100.0, 0.1), Estimate(0.01, 1e-4), 0.0, cmath.exp(-0.2j * math.pi))
    >>> reference = calibrate_phase([lagging])
    >>> reference.polarity, round(reference.delay, 12)
    (1, 0.001)
    """
    frequencies = np.array([mode.frequency.value for mode in modes])
    directions = np.array([mode.residue / abs(mode.residue) for mode in modes])
    mean = complex(directions.mean()) if directions.size else 0j
    if abs(mean) < 0.5:
        raise NotIdentifiableError(
            f"polarity needs residues of about one phase; got {len(modes)} of mean direction {abs(mean):.2f}"
        )
    polarity = 1 if mean.real >= 0.0 else -1
    # Phases about their mean, so that none of them wraps.
    phases = cmath.phase(polarity * mean) + np.angle(directions / (mean / abs(mean)))
    delay = -float(frequencies @ phases) / (2.0 * math.pi * float(frequencies @ frequencies))
    return PhaseReference(polarity, delay)
