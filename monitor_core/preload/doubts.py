"""Say what speaks against a preload: witnesses of the same windows that are not as the calibration lets expect.

What differs by more than chance is a doubt, which stands with the number; what no loss of preload could do is a
contradiction, and the number is refused.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from monitor_core.preload.calibration import Calibration
from monitor_core.preload.moved_mass import ResidueCause, causes_of_residue, in_words
from monitor_core.preload.witnesses import Deviation, Setting, WitnessName, WitnessValues
from monitor_core.recording import Rejection, RejectionReason
from monitor_core.uncertainty import Estimate


class DoubtReason(StrEnum):
    """What speaks against a number that is given all the same."""

    DAMPING_CHANGED = "damping-changed"
    MASS_OR_MOUNTING_CHANGED = "mass-or-mounting-changed"
    MOVED_MASS_CHANGED = "moved-mass-changed"
    FRICTION_CHANGED = "friction-changed"
    EXCITATION_CHANGED = "excitation-changed"
    NOISE_CHANGED = "noise-changed"
    SECOND_MODE = "second-mode"
    PLACES_DISAGREE = "places-disagree"
    PRELOAD_RISEN = "preload-risen"


@dataclass(frozen=True, slots=True)
class Doubt:
    """A reason not to rely on a number, in words."""

    reason: DoubtReason
    detail: str  # what was expected, what was got, with units


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How far a witness may be from its expectation."""

    floor: float  # what days differ by that one session does not show, relative standard deviation [-]
    score: float  # normal deviate beyond which the difference is no chance [-]
    least: float  # relative difference below which it does not matter [-]
    contradiction: float  # relative difference that refuses the number [-]
    doubt: DoubtReason
    rejection: RejectionReason
    meaning: str


#: The same for a preload above all that were ever set.
_RISEN = 3.3
#: Normal deviate beyond which the mean of a session is no chance: once in a hundred sessions.
SESSION_SCORE = 2.6
#: The floors are declared (GUM, type B): gains of sensors hold to some tenths of a percent, a damping to one or two
#: percent from day to day; friction follows lubrication and temperature, and is corrected for before it is doubted.
TOLERANCES = {
    WitnessName.RESIDUE: Tolerance(
        0.0015,
        3.0,
        0.0,
        0.1,
        DoubtReason.MASS_OR_MOUNTING_CHANGED,
        RejectionReason.MOVED_MASS_MISMATCH,
        "another mass moves than is stated, the nut is mounted otherwise, or a sensor's gain has changed",
    ),
    # alone it doubts nothing, for friction at another speed moves it by 1.6 %: it tells what has moved the residue
    WitnessName.RIGID_LINE: Tolerance(
        0.0015,
        math.inf,
        0.0,
        math.inf,
        DoubtReason.MOVED_MASS_CHANGED,
        RejectionReason.MOVED_MASS_MISMATCH,
        "another mass moves than is stated, or friction acts otherwise",
    ),
    WitnessName.DAMPING_RATIO: Tolerance(
        0.015,
        3.3,
        0.0,
        0.4,
        DoubtReason.DAMPING_CHANGED,
        RejectionReason.DAMPING_MISMATCH,
        "a second mode, noise on the torque, or another mode than the calibrated one",
    ),
    WitnessName.EXCITATION_LEVEL: Tolerance(
        0.05,
        3.3,
        0.42,
        math.inf,
        DoubtReason.EXCITATION_CHANGED,
        RejectionReason.LITTLE_EXCITATION,
        "the moves are not those of the calibration; friction then acts otherwise",
    ),
    WitnessName.FRICTION_TORQUE: Tolerance(
        0.02,
        3.3,
        0.6,
        math.inf,
        DoubtReason.FRICTION_CHANGED,
        RejectionReason.OUTSIDE_CALIBRATION,
        "lubrication or guides are not as calibrated; what that does to the frequency is corrected in part only",
    ),
    WitnessName.NOISE_LEVEL: Tolerance(
        0.05,
        3.3,
        0.6,
        math.inf,
        DoubtReason.NOISE_CHANGED,
        RejectionReason.LOW_COHERENCE,
        "what no torque explains around the mode comes from friction in the guides, a shaking floor, or a channel",
    ),
}


def deviations_of(values: WitnessValues, setting: Setting, calibration: Calibration) -> dict[WitnessName, Deviation]:
    """Compare the witnesses of a measurement with the calibration at its conditions and its estimated preload."""
    return {
        name: witness.deviation(values[name], setting, floor=tolerance.floor)
        for name, tolerance in TOLERANCES.items()
        if name in values and (witness := calibration.witness(name)) is not None
    }


def contradiction(deviations: dict[WitnessName, Deviation]) -> Rejection | None:
    """Return the first witness that no preload explains, as a refusal."""
    for name, deviation in deviations.items():
        tolerance = TOLERANCES[name]
        if abs(deviation.logarithm) > tolerance.contradiction and abs(deviation.score) > tolerance.score:
            return Rejection(tolerance.rejection, _sentence(name, deviation))
    return None


def doubts_of(deviations: Mapping[WitnessName, Deviation], calibration: Calibration) -> tuple[Doubt, ...]:
    """Return a doubt for each witness that differs by more than chance and by more than does not matter."""
    return tuple(
        _doubt(name, deviations, calibration)
        for name, deviation in deviations.items()
        if abs(deviation.score) > TOLERANCES[name].score and abs(deviation.logarithm) > TOLERANCES[name].least
    )


def of_whole_session(
    measured: Sequence[Mapping[WitnessName, Deviation]], calibration: Calibration
) -> tuple[Doubt, ...]:
    """Return what the measurements of one session say together, where each alone would pass for chance.

    Their own scatter averages out; what days differ by, and the error of the expectation, are common to them.
    """
    means: dict[WitnessName, Deviation] = {}
    counts: dict[WitnessName, int] = {}
    for name in TOLERANCES:
        deviations = [deviation[name] for deviation in measured if name in deviation]
        witness = calibration.witness(name)
        if len(deviations) < 2 or witness is None:
            continue
        common = np.mean([d.standard_uncertainty**2 for d in deviations]) - witness.scatter**2
        counts[name] = len(deviations)
        means[name] = Deviation(
            float(np.mean([d.logarithm for d in deviations])),
            math.sqrt(float(common) + witness.scatter**2 / len(deviations)),
            witness.coefficients.degrees_of_freedom,
        )
    return tuple(
        _doubt(name, means, calibration, before=f"over {counts[name]} measurements of the session ")
        for name, mean in means.items()
        if abs(mean.score) > SESSION_SCORE
        and abs(mean.logarithm) > TOLERANCES[name].least
        and math.isfinite(TOLERANCES[name].score)
    )


def _doubt(
    name: WitnessName, deviations: Mapping[WitnessName, Deviation], calibration: Calibration, *, before: str = ""
) -> Doubt:
    """Put a deviation into words; of a residue with what the rigid-body line says of it."""
    reason, sentence = TOLERANCES[name].doubt, before + _sentence(name, deviations[name])
    causes = causes_of_residue(deviations, calibration) if name is WitnessName.RESIDUE else None
    said = "" if causes is None else in_words(causes, deviations[name])
    if causes == (ResidueCause.MASS,):
        reason = DoubtReason.MOVED_MASS_CHANGED
    return Doubt(reason, f"{sentence}; {said}" if said else sentence)


def preload_risen(preload: Estimate, highest: float) -> Doubt | None:
    r"""Doubt a preload above the highest that was ever set, by more than chance: no axis tightens itself.

    Both as :math:`\theta = \mathrm{preload}^{-1/3}` [N^(-1/3)], which falls as the preload rises.
    """
    score = (highest - preload.value) / max(preload.standard_uncertainty, 1e-300)
    if score < _RISEN:
        return None
    return Doubt(
        DoubtReason.PRELOAD_RISEN,
        f"{preload.value**-3.0:.0f} N is above the {highest**-3.0:.0f} N that were ever set, by {score:.1f} standard "
        "deviations: nothing tightens a nut by itself; a place, a payload or a mounting is not as stated",
    )


def _sentence(name: WitnessName, deviation: Deviation) -> str:
    percent = 100.0 * math.expm1(deviation.logarithm)
    return (
        f"the {name.replace('-', ' ')} is {percent:+.1f} % from what the calibration lets expect, "
        f"{abs(deviation.score):.1f} standard deviations: {TOLERANCES[name].meaning}"
    )
