"""State by how much two measurements of an unchanged axis differ, and move measurements by such errors."""

from dataclasses import dataclass, replace

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.change.cells import Side
from monitor_core.effects.thermal import MODULUS_PER_KELVIN

#: Errors that the cells of a position share, in the order of their columns.
CELL_ERRORS = ("position", "preload", "temperature", "gain", "delay")


@dataclass(frozen=True, slots=True)
class ChangeTolerances:
    """By how much two measurements of an unchanged axis differ, and what a model adds; standard deviations."""

    position: float = 0.2e-3  # homing, mounting of the encoder [m]
    preload_share: float = 0.005  # from day to day [-]
    temperature: float = 0.6  # sensor against screw, and what lubrication does to the stiffness alike [K]
    gain_share: float = 0.003  # [-]
    delay: float = 0.5e-6  # of one channel against the other, and what lubrication does to the phase alike [s]
    relative: float = 0.002  # σ_0: lubrication, leakage of the spectra [-]
    share_of_change: float = 0.05  # ε [-]
    form: float = 0.02  # of a model against one time alone, relative [-]


def moved(side: Side, errors: FloatArray, tolerances: ChangeTolerances) -> Side:
    r"""Return one time with its positions, preloads, temperatures, gains and delays moved by errors.

    ``errors`` are in standard deviations, shape (n_positions, n_errors). Where all stiffness softens by one share,
    accelerations are those of the cold axis at a higher frequency:

    .. math::

        A_{\vartheta}(\omega) = A\!\left( \omega / \sqrt{1 + \alpha \vartheta} \right), \qquad
        A(\omega) = -\omega^2 (K - \omega^2 M)^{-1}

    so that each position can have its own temperature, while an axis has a single one.
    """
    lines = side.lines
    position, preload, temperature, gain, delay = errors[side.position_of_case].T
    conditions = replace(
        lines.conditions,
        position=lines.conditions.position + tolerances.position * position,
        preload=lines.conditions.preload * (1.0 + tolerances.preload_share * preload),
    )
    raised = 1.0 / np.sqrt(1.0 + MODULUS_PER_KELVIN * tolerances.temperature * temperature)
    drive = replace(lines.drive, omega=lines.drive.omega * raised[lines.drive.case])
    of_channels = (tolerances.gain_share * gain)[lines.case] - 1j * lines.omega * (tolerances.delay * delay)[lines.case]
    return replace(
        side,
        lines=replace(lines, conditions=conditions, omega=lines.omega * raised[lines.case], drive=drive),
        measured=side.measured - of_channels,
    )
