"""Define the answer of the discrepancy workflow: records and numbers, which the service puts into sentences."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from monitor_core.arrays import FloatArray, Shown, read_only
from monitor_core.discrepancy.screw_axis import AgainstScrew
from monitor_core.effects import ConditionAxis, Effect, Law, Variable
from monitor_core.effects.units import RecordedUnit
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.axis import AxisDescription
from monitor_core.fitting.conditions.groups import Extent
from monitor_core.shown import Panel
from monitor_core.uncertainty import Estimate, plus_minus


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
class MisfitPlace:
    """Which part of the data a misfit is in: all that is in every one of the extents."""

    extents: tuple[Extent, ...] = ()  # none: everywhere
    changing_with: tuple[ConditionAxis, ...] = ()  # what its size goes with, where it is everywhere


@dataclass(frozen=True, slots=True)
class Misfit:
    """A place where data and model differ."""

    place: MisfitPlace
    size: float  # rms over the place, in standard deviations
    kind: MisfitKind
    p_value: float  # of the test that found it, corrected for the number of tests


@dataclass(frozen=True, slots=True, eq=False)
class MisfitMap:
    """Root-mean-square misfit by a condition and frequency band, of the baseline and of the augmented model."""

    over: ConditionAxis | None  # the condition of the rows; None: one row of everything
    rows: tuple[Extent, ...]
    columns: tuple[Extent, ...]  # bands, modes or settings
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
    aliases: tuple[str, ...] = ()  # keys of effects that are the same finding: they leave the same residuals
    #: The lowest and highest frequency that it would have at single settings, where its own wanders [Hz]
    wanders_between: tuple[float, float] | None = None
    recorded_unit: RecordedUnit | None = None  # of an effect that is another unit of a channel

    @property
    def plausible(self) -> bool:
        """Whether it may be what is missing: every parameter is within its range."""
        return all(parameter.plausible for parameter in self.parameters.values())


@dataclass(frozen=True, slots=True)
class DescribedAlternative:
    """What the data do not distinguish from what was described."""

    place: str
    parameter: str = ""  # empty: something that swings there
    varies_with: Variable | None = None  # None: no law holds of either


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
    alternatives: tuple[DescribedAlternative, ...]
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
    """Effects that were accepted at once, most often a single one, and what they left."""

    effects: tuple[str, ...]
    gap: GapPair


class UntestedReason(StrEnum):
    """Why nothing can be said of an effect."""

    NOT_VARIED = "not-varied"  # a condition is the same in all data
    NO_ANSWER = "no-answer"  # the model has none with the effect
    BELOW_NOISE = "below-noise"  # no value within its range would be seen
    WITHOUT_TRACE = "without-trace"  # nothing that was measured moves with it
    TIME_UP = "time-up"  # before it was tried


@dataclass(frozen=True, slots=True)
class Untested:
    """Why an effect could not be tested."""

    reason: UntestedReason
    not_varied: tuple[ConditionAxis, ...] = ()  # that it needs varied


@dataclass(frozen=True, slots=True)
class Candidate:
    """An effect that was considered besides what was found."""

    key: str
    delta_bic: float  # in the place of what was found, or else in addition to it; NaN where untestable
    held_out: float  # gain of log-likelihood on held-out data in the place of what was found; else NaN
    detection_limit: float | None  # value of its first parameter that would be seen, in its unit
    unit: str
    untested: Untested | None = None  # None: it was tested
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


class StepKind(StrEnum):
    """What there is to measure or to check next."""

    OTHER_CONDITIONS = "measure-under-other-conditions"
    LOOK_AT_PARTS = "look-at-the-parts"
    RESPONSES_TO_DISTINGUISH = "measure-responses-to-distinguish"
    REPEAT_IN_RANDOM_ORDER = "repeat-in-random-order"
    THREE_LEVELS = "measure-at-three-levels"
    MORE_POSITIONS = "measure-more-positions"
    KNOWN_MASS = "measure-with-a-known-mass"
    VARY = "vary"
    TWO_SETTINGS = "repeat-two-settings"
    TAP_SCREW = "tap-the-screw"
    HOLD_PART = "hold-a-part"
    REPEAT_NOW = "repeat-now"
    CHECK_PART = "check-a-part"
    SEE_DRIVE = "see-what-drives"
    WITHIN_TURN = "measure-within-a-turn"  # of what varies about its mean
    WITHIN_TURN_OF_STATED = "measure-within-a-turn-of-stated"  # of what is as stated at one angle
    BETWEEN_LEVELS = "measure-between-levels"
    LOWER_LEVEL = "measure-at-a-lower-level"
    REPEAT_FIRST = "repeat-the-first"
    CHECK_TAG = "check-a-tag"
    READ_TAGS = "read-tags-again"
    SECOND_ACCELEROMETER = "put-a-second-accelerometer"
    FINER_POSITIONS = "measure-finer-positions"
    MORE_PRELOADS = "measure-more-preloads"
    WEIGH_PAYLOAD = "weigh-the-payload"
    COLD_AGAIN = "measure-warm-and-cold-again"
    MORE_LEVELS = "measure-more-levels"
    ANOTHER_SENSOR = "measure-with-another-sensor"
    OTHER_SPEEDS = "repeat-at-other-speeds"
    MOVE_KNOWN_MASS = "move-a-known-mass"


@dataclass(frozen=True, slots=True)
class StepEffect:
    """An effect that a step is for, with its size or with how far it would be from the first one."""

    key: str
    amount: float = math.nan
    unit: str = ""  # "sigma" of a distance


@dataclass(frozen=True, slots=True)
class NextStep:
    """One thing to measure or check next; which of the fields it has depends on its kind."""

    kind: StepKind
    condition: ConditionAxis | None = None  # to be varied, or that the levels are of
    quantity: str = ""  # a parameter by its name in files, a channel, or a kind of error of settings
    place: str = ""  # of the drive
    settings: tuple[str, ...] = ()  # to be measured or checked, as the data name them
    effects: tuple[StepEffect, ...] = ()  # that it distinguishes, the one found first, or that it shows
    values: Mapping[str, float] = field(default_factory=dict)  # by names that end with their unit
    #: Levels of the condition, and what the description multiplies the quantity by there; those to measure come first
    expected: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Unfinished:
    """A search that was left when its time was up."""

    doing: str  # in the words of its progress
    untried: tuple[str, ...] = ()  # keys of the effects that no fit had tried; none once a search has ended


@dataclass(frozen=True, slots=True, eq=False)
class Explanation(Shown):
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
    next_steps: tuple[NextStep, ...]
    ln_ratios: Mapping[str, float]  # ln(refitted/stated) of the parameters of the model file, by names in files
    added: Mapping[str, Mapping[str, float]]  # effects of the augmented model, by key and name
    panels: tuple[Panel, ...]
    maps: tuple[MisfitMap, ...] = ()  # one for each condition that varies; one of everything where none does
    #: Gap on the fitted data before and after: an effect may close that of one channel, and leave another one's.
    gap_by_channel: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    #: Of the declared parameters, before anything was added: what they would have to be off by in its place [-]
    pulls_before: Mapping[str, float] = field(default_factory=dict)
    #: Taken out before anything was explained, worst first.
    records: tuple[WrongRecord, ...] = ()
    #: What is not in the data and was assumed before anything was compared, in the sentences of who assumed it.
    assumptions: tuple[str, ...] = ()
    #: Parameters of the model file that were taken as exact, by their names in it.
    taken_as_exact: tuple[str, ...] = ()
    unfinished: Unfinished | None = None  # where time was up before the search had come to its end
    #: What was found of a cause that has no name; where the outcome is not *described*, without form.
    described: tuple[Described, ...] = ()
    #: What speaks against a ball screw axis; then nothing else was asked of the data.
    against_screw: AgainstScrew | None = None
    #: The description with what was found; None where a comparison was explained, of which there is no description.
    augmented: AxisDescription | None = None

    def __repr__(self) -> str:
        """Return it in some lines: the outcome, how far the gap was closed, and what was found."""
        before, after, unit = self.gap.before, self.gap.after, self.gap.unit
        held_out = not math.isnan(after.held_out)
        sizes = (before.held_out, after.held_out) if held_out else (before.fit, after.fit)
        of_what = "on what was held out" if held_out else "on what was fitted"
        lines = [
            f"Explanation: {self.outcome}; gap {sizes[0]:.3g} {unit} before, {sizes[1]:.3g} {unit} after, {of_what}; "
            f"noise floor {self.gap.noise_floor:.3g} {unit}"
        ]
        for effect in self.effects:
            lines.append(f"  {' or '.join((effect.key, *effect.equivalent_to))}")
            for name, found in effect.parameters.items():
                size = plus_minus(found.estimate.value, found.estimate.standard_uncertainty)
                lines.append(f"    {name} = {size} {found.unit}")
        return "\n".join(lines)

    def _panels(self) -> Sequence[Panel]:
        return self.panels

    def _columns(self) -> Mapping[str, Sequence[object]]:
        rows = [(effect.key, name, found) for effect in self.effects for name, found in effect.parameters.items()]
        found = [parameter for _, _, parameter in rows]
        return {
            "effect": [key for key, _, _ in rows],
            "parameter": [name for _, name, _ in rows],
            "value": [each.estimate.value for each in found],
            "standard_uncertainty": [each.estimate.standard_uncertainty for each in found],
            "lower_95": [each.interval_95[0] for each in found],
            "upper_95": [each.interval_95[1] for each in found],
            "unit": [each.unit for each in found],
            "plausible": [each.plausible for each in found],
        }
