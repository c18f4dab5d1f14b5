"""Define the answer of the discrepancy workflow."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from monitor_core.arrays import FloatArray, read_only
from monitor_core.effects import Effect, Law
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.axis import AxisDescription
from monitor_core.fitting.comparison import Panel
from monitor_core.uncertainty import Estimate


class Outcome(StrEnum):
    """Whether a missing effect was found, and how surely."""

    NAMED = "named"  # the effects explain the gap and hold on data not used to choose them
    EQUIVALENT = "equivalent"  # the data cannot distinguish two or more effects
    PARTIAL = "partial"  # named, with a remainder that nothing explains
    NONE = "none"  # the baseline already agrees to the noise
    DESCRIBED = "described"  # nothing in the catalogue, but where it sits and how it behaves holds on held-out data
    UNKNOWN = "unknown"  # there is a gap, and nothing in the catalogue explains it


class MisfitKind(StrEnum):
    """What a misfit looks like."""

    STIFFNESS = "stiffness"
    MASS = "mass"
    DAMPING = "damping"
    DELAY = "delay"
    EXTRA_MODE = "extra mode"
    AMPLITUDE = "amplitude-dependent"
    HYSTERESIS = "hysteretic"
    UNCLEAR = "unclear"


@dataclass(frozen=True, slots=True)
class Misfit:
    """A place where data and model differ."""

    where: str  # "position_mm 500..850, band 150..200 Hz"
    size: float  # rms over the place, in standard deviations
    kind: MisfitKind
    p_value: float  # of the test that found it, corrected for the number of tests


@dataclass(frozen=True, slots=True, eq=False)
class MisfitMap:
    """Root-mean-square misfit by a condition and frequency band, of the baseline and of the augmented model."""

    title: str
    rows: tuple[str, ...]  # values of the condition
    columns: tuple[str, ...]  # bands
    before: FloatArray  # in standard deviations; NaN where there are no data, shape (n_rows, n_columns) [-]
    after: FloatArray  # likewise [-]

    def __post_init__(self) -> None:
        object.__setattr__(self, "before", read_only(self.before))
        object.__setattr__(self, "after", read_only(self.after))
        expected = (len(self.rows), len(self.columns))
        if self.before.shape != expected or self.after.shape != expected:
            raise OutsideValidityError(
                f"both arrays of a misfit map must have the shape {expected} of its rows and columns; "
                f"got {self.before.shape} and {self.after.shape}"
            )


@dataclass(frozen=True, slots=True)
class FoundParameter:
    """A parameter of a found effect."""

    estimate: Estimate
    unit: str
    interval_95: tuple[float, float]
    plausible: bool  # whether the value lies within its plausible range
    at_end: bool = False  # whether it stands at an end of the range that it is sought in


@dataclass(frozen=True, slots=True)
class FoundEffect:
    """An effect that explains the gap, alone or as the first of a class that the data cannot distinguish."""

    key: str
    name: str
    physics: str
    parameters: Mapping[str, FoundParameter]
    equivalent_to: tuple[str, ...]  # keys, best first; empty: named
    delta_bic: float  # BIC without it less BIC with it
    held_out_log_likelihood_gain: float
    remarks: tuple[str, ...] = ()  # "a stand-in for something else: …"
    stands_in_for: str = ""  # key of an effect that such data cannot test and that would explain more

    @property
    def plausible(self) -> bool:
        """Whether it may be what is missing: nothing would explain more, and every parameter is within its range."""
        return not self.stands_in_for and all(parameter.plausible for parameter in self.parameters.values())


@dataclass(frozen=True, slots=True)
class Described:
    """Something that no effect of the catalogue is: where it sits, and what varies there by which law, or swings there.

    Without a law it is something that swings by itself, the same at every setting; or else a parameter that has a value
    of its own at each setting, in no form that was tried.
    """

    place: str  # table | nut | screw | screw end | bearing | motor | base | sensor
    parameter: str  # which varies, by its name in files; "impedance" of what swings and does not vary
    law: Law | None  # what it is multiplied by
    parameters: Mapping[str, FoundParameter]  # coefficients of the law, or of what swings
    effects: tuple[Effect[Any], ...]  # that say the same, to be kept as effects of the user's own; without form none
    alternatives: tuple[str, ...]  # what the data do not distinguish from it, with what it varies with
    share: float  # of what a free variation of the parameter would explain, the law explains [-]
    delta_bic: float  # BIC without it less BIC with it
    held_out_log_likelihood_gain: float
    frequency_hz: float | None = None  # of what swings there on a spring, at the reference of the law
    mass_kg: float | None = None  # of that
    inertia_kg_m2: float | None = None  # of that, where it turns
    #: Without form: what the parameter is multiplied by at each setting that was fitted, by its name [-]
    factors: Mapping[str, float] = field(default_factory=dict)

    @property
    def has_no_form(self) -> bool:
        """Whether no law holds: that something is there is then all that can be said."""
        return bool(self.factors)


@dataclass(frozen=True, slots=True)
class GapPair:
    """A gap on the data that were fitted and on the data that were not."""

    fit: float
    held_out: float  # NaN where nothing could be held out


@dataclass(frozen=True, slots=True)
class Gap:
    """How far model and measurement are apart."""

    unit: str  # sigma | Hz | %
    noise_floor: float
    before: GapPair
    after: GapPair


@dataclass(frozen=True, slots=True)
class Step:
    """An accepted effect, and what it left."""

    effect: str
    gap: GapPair


@dataclass(frozen=True, slots=True)
class Candidate:
    """An effect that was considered besides what was found."""

    key: str
    delta_bic: float  # in the place of what was found, or else in addition to it; NaN where untestable
    held_out: float  # gain of log-likelihood on held-out data in the place of what was found; else NaN
    detection_limit: float | None  # value of its first parameter that would be seen, in its unit
    unit: str
    untestable_because: str | None = None
    substitution_for: str | None = None  # key of the found effect in whose place it was refitted; None: in addition


class RecordFault(StrEnum):
    """What is wrong with a record."""

    POSITION = "position-tag"
    PRELOAD = "preload-tag"
    PAYLOAD = "payload-tag"
    TEMPERATURE = "temperature-tag"
    GAIN = "gain"
    OUTLIER = "outlier"  # wrong, and by no tag or gain alone


@dataclass(frozen=True, slots=True)
class WrongRecord:
    """A record that does not go with the others; nothing was explained by it.

    What is stated and found is in ``unit``: mm, N, kg, K, or 1 for a gain; of an outlier both are NaN.
    """

    number: int  # of the setting, from 1 in the order of the data
    observations: tuple[int, ...]  # of this setting, from 0 in the order of the data
    setting: str  # "500 mm, 220 N"
    fault: RecordFault
    delta_bic: float  # for what is wrong, less the price of having looked at all records
    misfit: float  # rms of the record as stated, in standard deviations
    stated: float = math.nan
    found: float = math.nan
    standard_uncertainty: float = math.nan  # of what is found
    unit: str = "1"


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """The whole answer."""

    outcome: Outcome
    effects: tuple[FoundEffect, ...]
    localisation: tuple[Misfit, ...]  # before anything was added
    remainder: tuple[Misfit, ...]  # after
    gap: Gap
    steps: tuple[Step, ...]
    candidates: tuple[Candidate, ...]
    pulls: Mapping[str, float]  # spread over settings by kind of error; of each declared parameter [-]
    least_delta_bic: float  # that one more effect would have needed [-]
    next_measurement: str
    ln_ratios: Mapping[str, float]  # ln(refitted/stated) of the parameters of the model file, by names in files
    added: Mapping[str, Mapping[str, float]]  # effects of the augmented model, by key and name
    panels: tuple[Panel, ...]
    maps: tuple[MisfitMap, ...] = ()  # one for each condition that varies; one of everything where none does
    #: Gap on the fitted data before and after: an effect may close that of one channel, and leave another one's.
    gap_by_channel: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    #: Of the declared parameters, before anything was added: what they would have to be off by in its place [-]
    pulls_before: Mapping[str, float] = field(default_factory=dict)
    #: Keys of effects that help, but by less than a quarter of what is left, and may be a part of it; in no model.
    hidden_in_remainder: tuple[str, ...] = ()
    #: Taken out before anything was explained, worst first.
    records: tuple[WrongRecord, ...] = ()
    #: What is not in the data and was assumed before anything was compared, in sentences.
    assumptions: tuple[str, ...] = ()
    #: Where time was up before the search had come to its end: what was being done and what was not tried, a sentence.
    unfinished: str = ""
    #: What was found of a cause that has no name; where the outcome is not *described*, without form.
    described: tuple[Described, ...] = ()
    #: The description with what was found; None where a comparison was explained, of which there is no description.
    augmented: AxisDescription | None = None
