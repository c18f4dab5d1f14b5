"""Find what speaks against a preload: witnesses of the same windows, or other places, that do not agree with it.

What differs by more than chance is a doubt, which stands with the number; what no loss of preload could do is a
contradiction, and the number is refused.

A residue that is not as calibrated has one of three causes. It is a reciprocal modal mass; the rigid-body line below
the mode is a reciprocal inertia, in which no stiffness is (:mod:`monitor_core.modal.channels`). By the ratio r of their
logarithmic deviations from what the calibration lets expect they are distinguished:

* another **mass** moves both as the payloads of the calibration did: r is the ratio of their two exponents;
* another **mounting** moves the residue alone: r = 0;
* another **gain** of a sensor moves both alike: r = 1.

A cause is ruled out where the two contradict its ratio by more than chance. A gain alone leaves the frequency, and so
the preload: it is doubted, however large, where the others are refused.

Doubts have a rate. Of healthy measurements :data:`FALSE_DOUBTS` are doubted for nothing, all tests together; each test
has an even share of it (Šidák, J. Am. Stat. Assoc. 62 (1967) 626–633), by the t of its degrees of freedom, with the
uncertainty of what is expected at this setting, that of the estimated preload included.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from statistics import NormalDist

import numpy as np
import scipy

from monitor_core.cross_checks import looks_like_unit
from monitor_core.preload.calibration import Calibration
from monitor_core.preload.witnesses import Deviation, Setting, WitnessName, WitnessValues
from monitor_core.recording import Doubt, DoubtReason, ExcitationQuantity, Rejection, RejectionReason
from monitor_core.uncertainty import Estimate


class ResidueCause(StrEnum):
    """What may have moved the residue of a mode."""

    MASS = "mass"
    MOUNTING = "mounting"
    GAIN = "gain"


#: Normal deviate beyond which a ratio is no chance: once in a hundred.
_CHANCE = 2.6
#: Of the inertia that a torque accelerates, what is carried at most: the screw and the motor turn (declared) [-].
_LARGEST_SHARE = 0.8
#: The same of what the other witnesses say for one sensor's gain and against the other's, twice a logarithm of odds.
_ONE_SENSOR = 4.0


def causes_of_residue(
    deviations: Mapping[WitnessName, Deviation], calibration: Calibration
) -> tuple[ResidueCause, ...] | None:
    """Return which causes residue and rigid-body line together leave, none or several of them.

    ``None`` where one of the two is not known, or no payloads have shown how both follow the mass: then a gain alone is
    told, for the table is no more than :data:`_LARGEST_SHARE` of what a torque moves.
    """
    residue, line = deviations.get(WitnessName.RESIDUE), deviations.get(WitnessName.RIGID_LINE)
    of_residue, of_line = (_exponent(calibration, name) for name in (WitnessName.RESIDUE, WitnessName.RIGID_LINE))
    if residue is None or line is None:
        return None
    if of_residue is None or of_line is None:
        like_gain = abs(_score(line, residue, 1.0)) < _CHANCE < abs(_score(line, residue, _LARGEST_SHARE))
        torque = calibration.excitation_quantity is ExcitationQuantity.TORQUE
        return (ResidueCause.GAIN,) if like_gain and torque else None
    ratios = {ResidueCause.MASS: of_line / of_residue, ResidueCause.MOUNTING: 0.0, ResidueCause.GAIN: 1.0}
    return tuple(cause for cause, ratio in ratios.items() if abs(_score(line, residue, ratio)) < _CHANCE)


def in_words(causes: tuple[ResidueCause, ...], residue: Deviation, gain: str = "a sensor's gain") -> str:
    """Say what the rigid-body line tells of a residue that is not as calibrated; empty where it rules out no mass."""
    if causes == (ResidueCause.MASS,):
        more = "more" if residue.logarithm < 0.0 else "less"
        return f"by the rigid-body line below the mode it is the moved mass: {more} than is stated"
    if causes and ResidueCause.MASS not in causes:
        in_words = {ResidueCause.MOUNTING: "the mounting, or what hides in the mode", ResidueCause.GAIN: gain}
        left = " or like ".join(in_words[cause] for cause in causes)
        return f"by the rigid-body line below the mode it looks like {left}, not like the moved mass"
    return ""


def _whose_gain(deviations: Mapping[WitnessName, Deviation]) -> str:
    """Say which sensor's gain makes a residue what it is, by the witnesses that one channel alone measures."""
    residue, odds = deviations[WitnessName.RESIDUE].logarithm, 0.0
    # a gain of the torque is that of the level and of the friction, and the residue's reciprocal
    for name, sign in (
        (WitnessName.EXCITATION_LEVEL, -1.0), (WitnessName.FRICTION_TORQUE, -1.0), (WitnessName.NOISE_LEVEL, 1.0)
    ):  # fmt: skip
        if name in deviations:
            d = deviations[name]
            speaks = d.logarithm**2 - (d.logarithm - sign * residue) ** 2
            odds += -sign * speaks / d.standard_uncertainty**2
    if abs(odds) < _ONE_SENSOR:
        return "the gain of a sensor"
    return "the gain of the torque" if odds > 0.0 else "the gain of the acceleration"


def _exponent(calibration: Calibration, name: WitnessName) -> float | None:
    """Return how a witness falls with the moved mass; ``None`` where the calibration has not seen it fall."""
    witness = calibration.witness(name)
    exponent = None if witness is None else witness.payload_exponent
    return None if exponent is None or exponent >= 0.0 else exponent


def _score(line: Deviation, residue: Deviation, ratio: float) -> float:
    """Return by how many standard deviations the line contradicts a ratio to the residue."""
    uncertainty = math.hypot(line.standard_uncertainty, ratio * residue.standard_uncertainty)
    return (line.logarithm - ratio * residue.logarithm) / uncertainty


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How far a witness may be from its expectation."""

    floor: float  # what days differ by that one session does not show, relative standard deviation [-]
    least: float  # relative difference below which it does not matter [-]
    contradiction: float  # relative difference that refuses the number [-]
    doubt: DoubtReason | None  # None: alone it doubts nothing
    rejection: RejectionReason
    meaning: str


#: The floors are declared (GUM, type B): gains of sensors hold to some tenths of a percent, a damping to one or two
#: percent from day to day; friction follows lubrication and temperature, and is corrected for before it is doubted.
TOLERANCES = {
    WitnessName.RESIDUE: Tolerance(
        0.0015, 0.0, 0.1, DoubtReason.MASS_OR_MOUNTING_CHANGED, RejectionReason.MOVED_MASS_MISMATCH,
        "another mass moves than is stated, the nut is mounted otherwise, or a sensor's gain has changed",
    ),
    # alone it doubts nothing, for friction at another speed moves it by 1.6 %: it tells what has moved the residue
    WitnessName.RIGID_LINE: Tolerance(
        0.0015, 0.0, math.inf, None, RejectionReason.MOVED_MASS_MISMATCH,
        "another mass moves than is stated, or friction acts otherwise",
    ),
    WitnessName.DAMPING_RATIO: Tolerance(
        0.015, 0.0, 0.4, DoubtReason.DAMPING_CHANGED, RejectionReason.DAMPING_MISMATCH,
        "a second mode, noise on the torque, or another mode than the calibrated one",
    ),
    WitnessName.EXCITATION_LEVEL: Tolerance(
        0.05, 0.42, math.inf, DoubtReason.EXCITATION_CHANGED, RejectionReason.LITTLE_EXCITATION,
        "the moves are not those of the calibration; friction then acts otherwise",
    ),
    WitnessName.FRICTION_TORQUE: Tolerance(
        0.02, 0.6, math.inf, DoubtReason.FRICTION_CHANGED, RejectionReason.OUTSIDE_CALIBRATION,
        "lubrication or guides are not as calibrated; what that does to the frequency is corrected in part only",
    ),
    WitnessName.NOISE_LEVEL: Tolerance(
        0.05, 0.6, math.inf, DoubtReason.NOISE_CHANGED, RejectionReason.LOW_COHERENCE,
        "what no torque explains around the mode comes from friction in the guides, a shaking floor, or a channel",
    ),
}  # fmt: skip

#: Share of healthy measurements that are doubted for nothing, by all tests together.
FALSE_DOUBTS = 0.05
#: What is tested of a measurement: each witness that doubts, by itself and over its session, a rise, and the places. A
#: second mode is asked for once in a hundred thousand (:mod:`monitor_core.modal.selection`).
N_TESTS = 2 * sum(tolerance.doubt is not None for tolerance in TOLERANCES.values()) + 2
#: Of each test: the probability at which it doubts, and the normal deviate beyond which it does, on two sides or one.
TEST_LEVEL = 1.0 - (1.0 - FALSE_DOUBTS) ** (1.0 / N_TESTS)
_DEVIATE = -NormalDist().inv_cdf(TEST_LEVEL / 2.0)
_DEVIATE_ONE_SIDED = -NormalDist().inv_cdf(TEST_LEVEL)


def deviations_of(values: WitnessValues, setting: Setting, calibration: Calibration) -> dict[WitnessName, Deviation]:
    """Compare the witnesses of a measurement with the calibration at its conditions and its estimated preload."""
    return {
        name: witness.deviation(values[name], setting, floor=tolerance.floor)
        for name, tolerance in TOLERANCES.items()
        if name in values and (witness := calibration.witness(name)) is not None
    }


def at_uncertain_preload(
    deviations: Mapping[WitnessName, Deviation], setting: Setting, calibration: Calibration, relative: float
) -> dict[WitnessName, Deviation]:
    """Return deviations with what the standard uncertainty of the estimated preload, relative, makes of each."""
    return {
        name: deviation.with_uncertainty(witness.slope_in_preload(setting) * relative)
        for name, deviation in deviations.items()
        if (witness := calibration.witness(name)) is not None
    }


def contradiction(deviations: Mapping[WitnessName, Deviation], calibration: Calibration) -> Rejection | None:
    """Return the first witness that no preload explains, as a refusal; a gain alone, which leaves it, is none."""
    for name, deviation in deviations.items():
        tolerance = TOLERANCES[name]
        if abs(deviation.logarithm) > tolerance.contradiction and abs(deviation.score) > _DEVIATE:
            if name is WitnessName.RESIDUE and causes_of_residue(deviations, calibration) == (ResidueCause.GAIN,):
                continue
            return Rejection(tolerance.rejection, _sentence(name, deviation))
    return None


def doubts_of(deviations: Mapping[WitnessName, Deviation], calibration: Calibration) -> tuple[Doubt, ...]:
    """Return a doubt for each witness that differs by more than chance and by more than does not matter."""
    return tuple(
        _doubt(name, reason, deviations, calibration)
        for name, deviation in deviations.items()
        if (reason := _spoken_for(name, deviation)) is not None
    )


def _spoken_for(name: WitnessName, deviation: Deviation) -> DoubtReason | None:
    """Return what a deviation doubts the number for, if it is no chance and matters."""
    tolerance = TOLERANCES[name]
    speaks = abs(deviation.score) > _DEVIATE and abs(deviation.logarithm) > tolerance.least
    return tolerance.doubt if speaks else None


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
        _doubt(name, reason, means, calibration, before=f"over {counts[name]} measurements of the session ")
        for name, mean in means.items()
        if (reason := _spoken_for(name, mean)) is not None
    )


def _doubt(
    name: WitnessName,
    reason: DoubtReason,
    deviations: Mapping[WitnessName, Deviation],
    calibration: Calibration,
    *,
    before: str = "",
) -> Doubt:
    """Put a deviation into words; of a residue with what the rigid-body line says of it."""
    sentence = before + _sentence(name, deviations[name])
    causes = causes_of_residue(deviations, calibration) if name is WitnessName.RESIDUE else None
    cause = "" if causes is None else in_words(causes, deviations[name], _whose_gain(deviations))
    if causes is not None and len(causes) == 1:
        reason = _REASON_OF.get(causes[0], reason)
    return Doubt(reason, f"{sentence}; {cause}" if cause else sentence)


_REASON_OF = {
    ResidueCause.MASS: DoubtReason.MOVED_MASS_CHANGED,
    ResidueCause.GAIN: DoubtReason.GAIN_CHANGED,
}


def preload_risen(preload: Estimate, highest: float) -> Doubt | None:
    r"""Doubt a preload above the highest that was ever set, by more than chance: no axis tightens itself.

    Both as :math:`\theta = \mathrm{preload}^{-1/3}` [N^(-1/3)], which falls as the preload rises.
    """
    uncertainty = max(preload.standard_uncertainty, 1e-300)
    above = Deviation(highest - preload.value, uncertainty, preload.degrees_of_freedom)
    if above.score < _DEVIATE_ONE_SIDED:
        return None
    return Doubt(
        DoubtReason.PRELOAD_RISEN,
        f"{preload.value**-3.0:.0f} N is above the {highest**-3.0:.0f} N that were ever set, by {above.score:.1f} "
        "standard deviations: nothing tightens a nut by itself; a place, a payload or a mounting is not as stated",
    )


def _sentence(name: WitnessName, deviation: Deviation) -> str:
    percent = 100.0 * math.expm1(deviation.logarithm)
    unit = looks_like_unit(math.exp(deviation.logarithm), deviation.standard_uncertainty)
    like = "" if unit is None else f", which looks like {unit}"
    return (
        f"the {name.replace('-', ' ')} is {percent:+.1f} % from what the calibration lets expect, "
        f"{abs(deviation.score):.1f} standard deviations{like}: {TOLERANCES[name].meaning}"
    )


#: Positions closer than this are one place [m].
ONE_PLACE = 0.02


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
    def agrees(self) -> bool:
        """Whether what was measured may be one preload, by χ² with the stated uncertainties."""
        return self.count < 2 or float(scipy.special.chdtrc(self.count - 1, self.chi_square)) > TEST_LEVEL

    @property
    def disagreement(self) -> Doubt | None:
        """The doubt about a session whose places contradict each other.

        The scatter of ln(preload) about its mean is tested by χ² with the stated uncertainties; ``None`` where fewer
        than two places were measured or they agree.
        """
        if self.agrees or self.farthest - self.nearest < ONE_PLACE:
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
