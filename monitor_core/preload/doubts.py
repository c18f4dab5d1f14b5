"""Find what speaks against a preload: witnesses of the same windows, or other places, that do not agree with it.

What differs by more than chance is a doubt, which stands with the number; what no loss of preload could do is a
contradiction, and the number is refused.

A residue that is not as calibrated has one of three causes. It is a reciprocal modal mass; the rigid-body line below
the mode is a reciprocal inertia, in which no stiffness is (:mod:`monitor_core.modal.channels`). By the ratio r of their
logarithmic deviations from what the calibration lets expect they are distinguished:

* another **mass** moves both as the payloads of the calibration did: r is the ratio of their two exponents;
* another **mounting** moves the residue alone: r = 0;
* another **gain** of a sensor moves both alike: r = 1.

A cause is ruled out where the two contradict its ratio by more than chance.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import scipy

from monitor_core.preload.calibration import Calibration
from monitor_core.preload.witnesses import Deviation, Setting, WitnessName, WitnessValues
from monitor_core.recording import Rejection, RejectionReason
from monitor_core.uncertainty import Estimate


class ResidueCause(StrEnum):
    """What may have moved the residue of a mode."""

    MASS = "mass"
    MOUNTING = "mounting"
    GAIN = "gain"


#: Normal deviate beyond which a ratio, or the mean of a session, is no chance: once in a hundred.
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
#: The floors are declared (GUM, type B): gains of sensors hold to some tenths of a percent, a damping to one or two
#: percent from day to day; friction follows lubrication and temperature, and is corrected for before it is doubted.
TOLERANCES = {
    WitnessName.RESIDUE: Tolerance(
        0.0015, 3.0, 0.0, 0.1, DoubtReason.MASS_OR_MOUNTING_CHANGED, RejectionReason.MOVED_MASS_MISMATCH,
        "another mass moves than is stated, the nut is mounted otherwise, or a sensor's gain has changed",
    ),
    # alone it doubts nothing, for friction at another speed moves it by 1.6 %: it tells what has moved the residue
    WitnessName.RIGID_LINE: Tolerance(
        0.0015, math.inf, 0.0, math.inf, DoubtReason.MOVED_MASS_CHANGED, RejectionReason.MOVED_MASS_MISMATCH,
        "another mass moves than is stated, or friction acts otherwise",
    ),
    WitnessName.DAMPING_RATIO: Tolerance(
        0.015, 3.3, 0.0, 0.4, DoubtReason.DAMPING_CHANGED, RejectionReason.DAMPING_MISMATCH,
        "a second mode, noise on the torque, or another mode than the calibrated one",
    ),
    WitnessName.EXCITATION_LEVEL: Tolerance(
        0.05, 3.3, 0.42, math.inf, DoubtReason.EXCITATION_CHANGED, RejectionReason.LITTLE_EXCITATION,
        "the moves are not those of the calibration; friction then acts otherwise",
    ),
    WitnessName.FRICTION_TORQUE: Tolerance(
        0.02, 3.3, 0.6, math.inf, DoubtReason.FRICTION_CHANGED, RejectionReason.OUTSIDE_CALIBRATION,
        "lubrication or guides are not as calibrated; what that does to the frequency is corrected in part only",
    ),
    WitnessName.NOISE_LEVEL: Tolerance(
        0.05, 3.3, 0.6, math.inf, DoubtReason.NOISE_CHANGED, RejectionReason.LOW_COHERENCE,
        "what no torque explains around the mode comes from friction in the guides, a shaking floor, or a channel",
    ),
}  # fmt: skip


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
        if abs(mean.score) > _CHANCE
        and abs(mean.logarithm) > TOLERANCES[name].least
        and math.isfinite(TOLERANCES[name].score)
    )


def _doubt(
    name: WitnessName, deviations: Mapping[WitnessName, Deviation], calibration: Calibration, *, before: str = ""
) -> Doubt:
    """Put a deviation into words; of a residue with what the rigid-body line says of it."""
    reason, sentence = TOLERANCES[name].doubt, before + _sentence(name, deviations[name])
    causes = causes_of_residue(deviations, calibration) if name is WitnessName.RESIDUE else None
    cause = "" if causes is None else in_words(causes, deviations[name])
    if causes == (ResidueCause.MASS,):
        reason = DoubtReason.MOVED_MASS_CHANGED
    return Doubt(reason, f"{sentence}; {cause}" if cause else sentence)


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


#: Positions closer than this are one place [m].
_ONE_PLACE = 0.02
#: Probability at which the places of an unchanged axis are said to disagree.
_DISAGREEMENT = 1e-3


@dataclass(frozen=True, slots=True)
class PlaceReading:
    """What the measurements of one session are compared by."""

    position: float  # [m]
    logarithm: float  # ln(preload) [-]
    standard_uncertainty: float  # of it, new in each measurement [-]


@dataclass(frozen=True, slots=True)
class Places:
    """The measurements of one session, as far as they came, summed up."""

    count: int = 0
    weight: float = 0.0  # sum of the reciprocal variances [-]
    mean: float = 0.0  # of ln(preload), weighted [-]
    chi_square: float = 0.0  # of the deviations from it [-]
    nearest: float = 0.0  # position from the fixed bearing [m]
    farthest: float = 0.0
    lowest: float = 0.0  # ln(preload) [-]
    highest: float = 0.0

    def with_reading(self, reading: PlaceReading) -> "Places":
        """Return the sums with one more measurement (weighted mean and squares: West, Comm. ACM 22 (1979) 532–535)."""
        x, y = reading.position, reading.logarithm
        if not reading.standard_uncertainty > 0.0:  # it states no uncertainty: nothing is compared with it
            return self
        own = reading.standard_uncertainty**-2.0
        weight = self.weight + own
        mean = self.mean + (y - self.mean) * own / weight
        first = self.count == 0
        return Places(
            self.count + 1,
            weight,
            mean,
            self.chi_square + own * (y - self.mean) * (y - mean),
            x if first else min(self.nearest, x),
            x if first else max(self.farthest, x),
            y if first else min(self.lowest, y),
            y if first else max(self.highest, y),
        )

    @property
    def disagreement(self) -> Doubt | None:
        """The doubt about a session whose places contradict each other.

        The scatter of ln(preload) about its mean is tested by χ² with the stated uncertainties; ``None`` where fewer
        than two places were measured or they agree.
        """
        if self.count < 2 or self.farthest - self.nearest < _ONE_PLACE:
            return None
        if float(scipy.special.chdtrc(self.count - 1, self.chi_square)) > _DISAGREEMENT:
            return None
        return Doubt(
            DoubtReason.PLACES_DISAGREE,
            f"the places of one session give {math.exp(self.lowest):.0f} to {math.exp(self.highest):.0f} N where their "
            f"uncertainties allow {100.0 * (self.weight / self.count) ** -0.5:.1f} %: are the positions right, and "
            "counted from the fixed bearing?",
        )


def places_disagree(readings: Sequence[PlaceReading]) -> Doubt | None:
    """Test whether the places of one session contradict each other; the preload of an axis is one."""
    places = Places()
    for reading in readings:
        places = places.with_reading(reading)
    return places.disagreement
