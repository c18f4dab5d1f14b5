r"""Distinguish another moved mass from another mounting or gain, where the residue of the mode is not as calibrated.

The residue is a reciprocal modal mass; the rigid-body line below the mode is a reciprocal inertia, in which no
stiffness is (:mod:`monitor_core.modal.rigid_line`). By the ratio r of their logarithmic deviations from what the
calibration lets expect they distinguish three causes:

* another **mass** moves both as the payloads of the calibration did: r is the ratio of their two exponents;
* another **mounting** moves the residue alone: r = 0;
* another **gain** of a sensor moves both alike: r = 1.

A cause is ruled out where the two contradict its ratio by more than chance.
"""

import math
from collections.abc import Mapping
from enum import StrEnum

from monitor_core.preload.calibration import Calibration
from monitor_core.preload.witnesses import Deviation, WitnessName


class ResidueCause(StrEnum):
    """What may have moved the residue of a mode."""

    MASS = "mass"
    MOUNTING = "mounting"
    GAIN = "gain"


#: Normal deviate beyond which a ratio is no chance: once in a hundred.
_CHANCE = 2.6


_IN_WORDS = {
    ResidueCause.MASS: "the moved mass",
    ResidueCause.MOUNTING: "the mounting, or what hides in the mode",
    ResidueCause.GAIN: "a sensor's gain",
}


def causes_of_residue(
    deviations: Mapping[WitnessName, Deviation], calibration: Calibration
) -> tuple[ResidueCause, ...] | None:
    """Return which causes residue and rigid-body line together leave, none or several of them.

    ``None`` where one of the two is not known, or no payloads have shown how both follow the mass.
    """
    residue, line = deviations.get(WitnessName.RESIDUE), deviations.get(WitnessName.RIGID_LINE)
    of_residue, of_line = (_exponent(calibration, name) for name in (WitnessName.RESIDUE, WitnessName.RIGID_LINE))
    if residue is None or line is None or of_residue is None or of_line is None:
        return None
    ratios = {ResidueCause.MASS: of_line / of_residue, ResidueCause.MOUNTING: 0.0, ResidueCause.GAIN: 1.0}
    return tuple(cause for cause, ratio in ratios.items() if abs(_score(line, residue, ratio)) < _CHANCE)


def in_words(causes: tuple[ResidueCause, ...], residue: Deviation) -> str:
    """Say what the rigid-body line tells of a residue that is not as calibrated; empty where it rules out no mass."""
    if causes == (ResidueCause.MASS,):
        more = "more" if residue.logarithm < 0.0 else "less"
        return f"by the rigid-body line below the mode it is the moved mass: {more} than is stated"
    if causes and ResidueCause.MASS not in causes:
        left = " or ".join(_IN_WORDS[cause] for cause in causes)
        return f"by the rigid-body line below the mode it is not the moved mass but {left}"
    return ""


def _exponent(calibration: Calibration, name: WitnessName) -> float | None:
    """Return how a witness falls with the moved mass; ``None`` where the calibration has not seen it fall."""
    witness = calibration.witness(name)
    exponent = None if witness is None else witness.payload_exponent
    return None if exponent is None or exponent >= 0.0 else exponent


def _score(line: Deviation, residue: Deviation, ratio: float) -> float:
    """Return by how many standard deviations the line contradicts a ratio to the residue."""
    uncertainty = math.hypot(line.standard_uncertainty, ratio * residue.standard_uncertainty)
    return (line.logarithm - ratio * residue.logarithm) / uncertainty
