"""Explain a discrepancy between a described axis and its measurements, and describe the axis with what was found.

The description has refitted parameters, and its own effects together with those found.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

from monitor_core.discrepancy.explain_comparison import explain_comparison
from monitor_core.discrepancy.explanation import Explanation, Gap, GapPair, NextStep, Outcome, StepKind
from monitor_core.discrepancy.screw_axis import AgainstScrew, against_screw
from monitor_core.effects import DRIVE_EFFECTS, MOTION_EFFECTS, PREFIX, Effect, EffectParameter, MachineSizes, Reference
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.accelerometer import place_accelerometer
from monitor_core.fitting.axis import AxisDescription, DescribedDrive, DescribedRigidAxis, at_preload_of_nut
from monitor_core.fitting.comparison import Comparison
from monitor_core.fitting.conditions.settings import SettingTolerances, default_folds
from monitor_core.fitting.learnt_form import learn_form_error
from monitor_core.fitting.machine_sizes import sizes_of_drive, sizes_of_motion
from monitor_core.fitting.observations import FrequencyResponseObservation, ModalObservation
from monitor_core.fitting.residuals.model_form import ModelFormError
from monitor_core.fitting.residuals.modes import compare_modes
from monitor_core.fitting.residuals.motion.comparison import MotionComparison
from monitor_core.fitting.residuals.responses import compare_responses
from monitor_core.models.extended import AxisPhysics, paper_motor_end
from monitor_core.models.motion import FAMILY as MOTION, MotionPhysics
from monitor_core.models.protocol import DriveConditions
from monitor_core.recording import MotionRecord

#: Parameters of effects that multiply what is there, and such that take a share of what is left; others add.
_FACTORS = frozenset(("relative_change", "gain_error"))
_SHARES_OF_THE_REST = frozenset(("share", "inertia_share"))


def augmented_model(
    baseline: AxisDescription, explanation: Explanation, table: Sequence[Effect[Any]]
) -> AxisDescription:
    """Return the model with what was found; ``table`` holds what the keys of effects mean."""
    parameters = {
        name: value * math.exp(explanation.ln_ratios.get(name, 0.0)) for name, value in baseline.parameters.items()
    }
    effects = {key: dict(values) for key, values in baseline.effects.items()}
    for key, values in explanation.added.items():
        effects[key] = _together(effects[key], values, _parameters(key, table)) if key in effects else dict(values)
    return replace(baseline, parameters=parameters, effects=effects)


def _parameters(key: str, table: Sequence[Effect[Any]]) -> dict[str, EffectParameter]:
    """Return what an effect may have; of two that share a key, all that either has."""
    return {parameter.name: parameter for effect in table if effect.key == key for parameter in effect.parameters}


def _together(
    present: Mapping[str, float], added: Mapping[str, float], parameters: Mapping[str, EffectParameter]
) -> dict[str, float]:
    """Return the values with which an effect, added once, does what it did when it was added twice."""
    both = {**present, **added}
    for name in present.keys() & added.keys():
        before, more = present[name], added[name]
        if name in _FACTORS:
            both[name] = (1.0 + before) * (1.0 + more) - 1.0
        elif name in _SHARES_OF_THE_REST:
            both[name] = 1.0 - (1.0 - before) * (1.0 - more)
        elif parameters[name].null == 0.0:
            both[name] = before + more
        # else it only shapes what was absent before, and is as it was found
    return both


Physics = TypeVar("Physics")
Measured = Sequence[ModalObservation] | Sequence[FrequencyResponseObservation] | MotionRecord

#: Two positions closer than this are one: tables show tenths of a millimetre.
_SAME_POSITION = 1e-4  # [m]


@dataclass(frozen=True, slots=True, eq=False)
class ExplainOptions:
    """What is asked besides: judged on which measurements, with which effects, beyond which healthy machines."""

    hold_out: tuple[float, ...] = ()  # positions; without any, as the data allow [m]
    effects: tuple[Effect[Any], ...] = ()  # of the user's own, besides those of the product
    healthy: tuple[tuple[FrequencyResponseObservation, ...], ...] = ()  # of machines of this type that lack nothing
    accelerometer: str | None = None  # where that of a session is; without it where the model fits better
    assumptions: tuple[str, ...] = ()  # what was settled while measuring, in sentences
    tolerances: SettingTolerances = field(default_factory=SettingTolerances)  # of what the measurements are tagged with


def explain(
    axis: AxisDescription,
    measured: Measured,
    options: ExplainOptions | None = None,
    *,
    progress: Callable[[str], None] | None = None,
    time_is_up: Callable[[], bool] | None = None,
) -> Explanation:
    """Find where measurements and a described axis differ, what the model lacks, and how far adding it closes the gap.

    A fit may adjust what stands in ``uncertain`` of the axis; ``progress`` is called with a few words on what is being
    done. Once ``time_is_up`` says so, the answer is what the search had come to: *partial* or *unknown*, with what was
    not tried in ``unfinished``; the model as it stands is fitted in any case. The explanation comes with the augmented
    description: parameters as refitted, effects of the axis and those found; where the cause is unknown, the
    description as given. ``NotIdentifiableError`` or ``OutsideValidityError`` if measurements, description and what is
    to be held out do not go together; one sentence says why.

    Examples
    --------
    Of responses that are those of the model itself, with noise, nothing is missing:

    >>> from pathlib import Path
    >>> import numpy as np
    >>> import monitor_core as mc
    >>> from monitor_core import recordings
    >>> axis = recordings.read_model_file(Path("replay_data/models/receptance.toml"))
    >>> rng, frequency = np.random.default_rng(1), np.arange(10.0, 200.0, 2.0)
    >>> points = {"excitation": mc.ExcitationPoint.FORCE_AT_TABLE, "response": mc.ResponsePoint.DISPLACEMENT_AT_TABLE}
    >>> measured = []
    >>> for x in (0.6, 1.2, 1.8):
    ...     exact = axis.build().frequency_response(frequency, mc.DriveConditions(x), **points).response
    ...     deviation = 0.003 * abs(exact)
    ...     noise = deviation * (rng.standard_normal(frequency.size) + 1j * rng.standard_normal(frequency.size))
    ...     measured.append(mc.FrequencyResponseObservation(mc.DriveConditions(x), frequency, exact + noise, deviation))
    >>> mc.explain(axis, measured).outcome
    <Outcome.NONE: 'none'>
    """
    options = options or ExplainOptions()
    if (against := _against_screw(axis, measured, options)) is not None:
        return replace(_NOTHING_ELSE, against_screw=against, augmented=axis)
    if progress is not None:
        progress("comparing with the model as stated")
    question = _question(axis, measured, options)
    explanation = explain_comparison(
        question.comparison,
        question.described,
        question.candidates,
        sizes=question.sizes,
        progress=progress,
        time_is_up=time_is_up,
    )
    # the true cause may be in what was not free, and is then made up for by what is found
    exact = tuple(name for name in axis.parameters if name not in axis.uncertain)
    augmented = axis
    if explanation.outcome is not Outcome.UNKNOWN:
        augmented = augmented_model(axis.with_corrected_parameters(), explanation, question.table)
    return replace(
        explanation,
        assumptions=question.assumptions,
        taken_as_exact=exact if explanation.outcome is not Outcome.NONE else (),
        augmented=augmented,
    )


def require_explainable(axis: AxisDescription, measured: Measured, options: ExplainOptions | None = None) -> None:
    """Refuse at once what :func:`explain` would refuse before it searches; raises as it does."""
    options = options or ExplainOptions()
    if _against_screw(axis, measured, options) is not None:
        return
    question = _question(axis, measured, options)
    question.comparison.misfit(question.described.physics({}))


_NO_GAP = GapPair(math.nan, math.nan)
#: Of data that are not of a ball screw axis, whose model says nothing of them.
_NOTHING_ELSE = Explanation(
    outcome=Outcome.UNKNOWN,
    effects=(),
    localisation=(),
    remainder=(),
    gap=Gap("sigma", math.nan, _NO_GAP, _NO_GAP),
    steps=(),
    candidates=(),
    pulls={},
    least_delta_bic=math.nan,
    next_steps=(NextStep(StepKind.SEE_DRIVE),),
    ln_ratios={},
    added={},
    panels=(),
)


def _against_screw(axis: AxisDescription, measured: Measured, options: ExplainOptions) -> AgainstScrew | None:
    """Return what speaks against a ball screw axis; of a motion, or a model of one, nothing does."""
    if isinstance(measured, MotionRecord) or axis.family == MOTION:
        return None
    drive = axis.drive(_with_own_effects(DRIVE_EFFECTS, options))
    return against_screw(drive.physics({}), drive.uncertain, measured)


@dataclass(frozen=True, slots=True, eq=False)
class _Question(Generic[Physics]):
    """Measurements and a described axis, ready to be compared, and what the axis may lack."""

    comparison: Comparison[Physics]
    described: Any  # DescribedAxis[Physics]
    table: Sequence[Effect[Physics]]
    sizes: MachineSizes  # of the axis as it was measured
    assumptions: tuple[str, ...] = ()  # what is not in the data and was settled first, in sentences

    @property
    def candidates(self) -> Sequence[Effect[Physics]]:
        candidates: Sequence[Effect[Physics]] = self.described.candidates(self.sizes)
        return candidates


def _question(
    axis: AxisDescription, measured: Measured, options: ExplainOptions
) -> _Question[AxisPhysics] | _Question[MotionPhysics]:
    if options.healthy:
        _require_responses(measured)
    if isinstance(measured, MotionRecord):
        return _motion_question(axis, measured, options)
    return _drive_question(axis, measured, options)


def _motion_question(axis: AxisDescription, record: MotionRecord, options: ExplainOptions) -> _Question[MotionPhysics]:
    if options.hold_out:
        raise NotIdentifiableError(
            f"of a motion the second half is held out; got positions to hold out, {_listed(options.hold_out)}"
        )
    table = _with_own_effects(MOTION_EFFECTS, options)
    described: DescribedRigidAxis = axis.rigid_axis(table)
    comparison = MotionComparison.of(record, described.stated)
    of_motion = {**sizes_of_motion(comparison).values, Reference.MOVING_MASS: described.stated.moving_mass}
    return _Question(comparison, described, table, MachineSizes(of_motion))


def _drive_question(
    axis: AxisDescription,
    measured: Sequence[ModalObservation] | Sequence[FrequencyResponseObservation],
    options: ExplainOptions,
) -> _Question[AxisPhysics]:
    table = _with_own_effects(DRIVE_EFFECTS, options)
    drive = axis.drive(table)
    peaks = at_preload_of_nut([each for each in measured if isinstance(each, ModalObservation)], axis)
    responses = at_preload_of_nut([each for each in measured if isinstance(each, FrequencyResponseObservation)], axis)
    placed = place_accelerometer(responses, options.accelerometer, drive)
    conditions = [*(peak.conditions for peak in peaks), *(lines.conditions for lines in placed.observations)]
    folds = _folds(conditions, options.hold_out)
    end, form = paper_motor_end(drive.stated), _form_learnt(axis, drive, options)
    comparison: Comparison[AxisPhysics] = (
        compare_responses(
            placed.observations, held_out=folds, tolerances=options.tolerances, form=form, otherwise_held=end
        )
        if placed.observations
        else compare_modes(peaks, end, held_out=folds, tolerances=options.tolerances)
    )
    sizes = sizes_of_drive(drive.physics({}), placed.observations or peaks)
    return _Question(comparison, drive, table, sizes, (*placed.sentences, *options.assumptions))


def _require_responses(measured: Measured) -> None:
    several = () if isinstance(measured, MotionRecord) else measured
    if not any(isinstance(each, FrequencyResponseObservation) for each in several):
        got = "peaks" if several else "a motion"
        raise NotIdentifiableError(
            f"what a model is wrong in on healthy machines is learnt for frequency responses; got {got} to explain"
        )


def _form_learnt(axis: AxisDescription, drive: DescribedDrive, options: ExplainOptions) -> ModelFormError | None:
    """Learn from the healthy machines; the accelerometer of each is placed by itself."""
    if not options.healthy:
        return None
    machines = [at_preload_of_nut(machine, axis) for machine in options.healthy]
    placed = [place_accelerometer(machine, options.accelerometer, drive).observations for machine in machines]
    return learn_form_error([(machine, drive) for machine in placed])


def _with_own_effects(product: Sequence[Effect[Physics]], options: ExplainOptions) -> tuple[Effect[Physics], ...]:
    """Return the table with the user's own effects, which need keys of their own."""
    known = {effect.key for effect in product}
    for effect in options.effects:
        if effect.key in known or effect.key.startswith(PREFIX):
            raise OutsideValidityError(
                f"an effect of a user's own needs a key that the product does not use; got {effect.key!r}"
            )
    return (*product, *options.effects)


def _folds(conditions: Sequence[DriveConditions], hold_out: Sequence[float]) -> tuple[frozenset[DriveConditions], ...]:
    if not hold_out:
        return default_folds(conditions)
    measured = sorted({each.position for each in conditions})
    for wanted in hold_out:
        if not any(abs(wanted - position) < _SAME_POSITION for position in measured):
            raise NotIdentifiableError(
                f"a position to hold out must be a measured one, {_listed(measured)}; got {1e3 * wanted:g} mm"
            )
    fold = frozenset(
        each for each in conditions if any(abs(each.position - wanted) < _SAME_POSITION for wanted in hold_out)
    )
    if fold == frozenset(conditions):
        raise NotIdentifiableError(
            f"some of the measured positions must be left for the fit; got all of them to hold out, {_listed(measured)}"
        )
    return (fold,)


def _listed(positions: Sequence[float]) -> str:
    return f"{', '.join(f'{1e3 * position:g}' for position in positions)} mm"
