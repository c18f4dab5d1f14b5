"""From what was measured of an axis and a model of it to what the model lacks, and to the model that has it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

from monitor_core.discrepancy.explain import explain_comparison
from monitor_core.discrepancy.explanation import Explanation, Outcome
from monitor_core.effects import DRIVE_EFFECTS, MOTION_EFFECTS, PREFIX
from monitor_core.effects.effect import Effect
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.comparison import Comparison
from monitor_core.fitting.conditions.settings import default_folds
from monitor_core.fitting.described_axis import DescribedAxis, DescribedDrive, DescribedRigidAxis
from monitor_core.fitting.learnt_form import learn_form_error
from monitor_core.fitting.observations import FrequencyResponseObservation, ModalObservation
from monitor_core.fitting.residuals.model_form import ModelFormError
from monitor_core.fitting.residuals.modes import compare_modes
from monitor_core.fitting.residuals.motion.comparison import MotionComparison
from monitor_core.fitting.residuals.responses import compare_responses
from monitor_core.models.extended import AxisPhysics, paper_motor_end
from monitor_core.models.motion import MotionPhysics
from monitor_core.models.protocol import DriveConditions
from monitor_core.motion import MotionRecord
from monitor_core.recordings.model_file import DriveModelFile, model_file_text
from service.operations.discrepancy.accelerometer import place_accelerometer
from service.operations.discrepancy.augmented_model import augmented_model, with_corrected_parameters
from service.operations.discrepancy.described_drive import at_the_preload_of_the_nut, described_drive

Physics = TypeVar("Physics")
Measured = tuple[ModalObservation, ...] | tuple[FrequencyResponseObservation, ...] | MotionRecord

#: Two positions closer than this are one: tables show tenths of a millimetre.
_SAME_POSITION = 1e-4  # [m]


@dataclass(frozen=True, slots=True, eq=False)
class ExplanationRequest:
    """What is asked: which model lacks what, by which measurements, judged on which of them."""

    baseline: DriveModelFile
    measured: Measured
    hold_out: tuple[float, ...] = ()  # positions; without any, as the data allow [m]
    effects: tuple[Effect[Any], ...] = ()  # of the user's own, beside those of the product
    healthy: tuple[tuple[FrequencyResponseObservation, ...], ...] = ()  # of machines of this type that lack nothing
    accelerometer: str | None = None  # where that of a session is; without it where the model fits better
    taken_as: tuple[str, ...] = ()  # what was settled while measuring, in sentences


@dataclass(frozen=True, slots=True, eq=False)
class _Compared(Generic[Physics]):
    """Measurements beside a described axis, and what it may lack."""

    given: DriveModelFile
    baseline: DriveModelFile  # the same, its own corrections of parameters among its parameters
    table: Sequence[Effect[Physics]]
    comparison: Comparison[Physics]
    subject: DescribedAxis[Physics]
    candidates: Sequence[Effect[Physics]]
    taken_as: tuple[str, ...] = ()  # what is not in the data and was settled first, in sentences

    def explain(self, progress: Callable[[str], None] | None) -> tuple[Explanation, str]:
        """Return the answer with the augmented model; with the one that was given where the cause is unknown."""
        found = explain_comparison(self.comparison, self.subject, self.candidates, progress=progress)
        exact = _taken_as_exact(self.given) if found.outcome is not Outcome.NONE else ()
        found = replace(found, assumptions=(*self.taken_as, *exact))
        if found.outcome is Outcome.UNKNOWN:
            return found, model_file_text(self.given)
        return found, model_file_text(augmented_model(self.baseline, found, self.table))

    def require_answer(self) -> None:
        """Ask the axis as described once; raises OutsideValidityError if it has none."""
        self.comparison.misfit(self.subject.physics({}))


def _taken_as_exact(given: DriveModelFile) -> tuple[str, ...]:
    """Say what was not free: the true cause may be there, and is then made up for by what is found."""
    exact = [name for name in given.parameters if name not in given.uncertain]
    if not exact:
        return ()
    return (f"Taken as exact, since [uncertain] does not list it: {', '.join(exact)}.",)


def explain_measurements(
    request: ExplanationRequest, progress: Callable[[str], None] | None = None
) -> tuple[Explanation, str]:
    """Find what a model lacks.

    Parameters
    ----------
    request : ExplanationRequest
    progress : callable, optional
        Told in a few words what is being done.

    Returns
    -------
    Explanation
    str
        The augmented model as TOML: parameters as refitted, effects of the file and those found.

    Raises
    ------
    NotIdentifiableError, OutsideValidityError, RecordingFormatError
        If measurements, model and what is to be held out do not go together; one sentence says why.
    """
    return _compared(request).explain(progress)


def require_explainable(request: ExplanationRequest) -> None:
    """Refuse at once what :func:`explain_measurements` would refuse; raises as it does."""
    _compared(request).require_answer()


def _compared(request: ExplanationRequest) -> _Compared[AxisPhysics] | _Compared[MotionPhysics]:
    if request.healthy:
        _require_responses(request.measured)
    if isinstance(request.measured, MotionRecord):
        return _motion_compared(request.measured, request)
    return _drive_compared(request.measured, request)


def _motion_compared(record: MotionRecord, request: ExplanationRequest) -> _Compared[MotionPhysics]:
    if request.hold_out:
        raise NotIdentifiableError(
            f"of a motion the second half is held out; got positions to hold out, {_listed(request.hold_out)}"
        )
    table = _with_own_effects(MOTION_EFFECTS, request)
    request.baseline.build_motion(table)  # so that its effects are sound
    baseline = with_corrected_parameters(request.baseline)
    stated = baseline.build_motion(table).parameters
    subject = DescribedRigidAxis(stated, baseline.uncertain, baseline.effects, table)
    return _Compared(
        request.baseline, baseline, table, MotionComparison.of(record, stated), subject, subject.candidates()
    )


def _drive_compared(
    measured: tuple[ModalObservation, ...] | tuple[FrequencyResponseObservation, ...], request: ExplanationRequest
) -> _Compared[AxisPhysics]:
    table = _with_own_effects(DRIVE_EFFECTS, request)
    subject = described_drive(request.baseline, table)
    baseline = with_corrected_parameters(request.baseline)
    peaks = at_the_preload_of_the_nut([one for one in measured if isinstance(one, ModalObservation)], baseline)
    responses = [one for one in measured if isinstance(one, FrequencyResponseObservation)]
    responses = at_the_preload_of_the_nut(responses, baseline)
    placed = place_accelerometer(responses, request.accelerometer, subject)
    lines = placed.observations
    folds = _folds([*(one.conditions for one in peaks), *(one.conditions for one in lines)], request.hold_out)
    end = paper_motor_end(subject.stated)
    form = _form_learnt(request, baseline, subject)
    comparison: Comparison[AxisPhysics] = (
        compare_responses(lines, held_out=folds, form=form, otherwise_held=end)
        if lines
        else compare_modes(peaks, end, held_out=folds)
    )
    return _Compared(
        request.baseline,
        baseline,
        table,
        comparison,
        subject,
        subject.candidates(),
        (*placed.sentences, *request.taken_as),
    )


def _require_responses(measured: Measured) -> None:
    several = () if isinstance(measured, MotionRecord) else measured
    if not any(isinstance(one, FrequencyResponseObservation) for one in several):
        got = "peaks" if several else "a motion"
        raise NotIdentifiableError(
            f"what a model is wrong in on healthy machines is learnt for frequency responses; got {got} to explain"
        )


def _form_learnt(
    request: ExplanationRequest, baseline: DriveModelFile, subject: DescribedDrive
) -> ModelFormError | None:
    """Learn from the healthy machines; the accelerometer of each is placed by itself."""
    if not request.healthy:
        return None
    machines = [at_the_preload_of_the_nut(machine, baseline) for machine in request.healthy]
    placed = [place_accelerometer(machine, request.accelerometer, subject).observations for machine in machines]
    return learn_form_error([(machine, subject) for machine in placed])


def _with_own_effects(product: Sequence[Effect[Physics]], request: ExplanationRequest) -> tuple[Effect[Physics], ...]:
    """Return the table with the user's own effects, which must be such that a model file can hold them."""
    known = {one.key for one in product}
    for effect in request.effects:
        if effect.key in known or effect.key.startswith(PREFIX):
            raise OutsideValidityError(
                f"an effect of a user's own needs a key that the product does not use; got {effect.key!r}"
            )
    # refuses names that could not be written: before the search, not after it
    model_file_text(replace(request.baseline, effects={one.key: one.null_values() for one in request.effects}))
    return (*product, *request.effects)


def _folds(conditions: Sequence[DriveConditions], hold_out: Sequence[float]) -> tuple[frozenset[DriveConditions], ...]:
    if not hold_out:
        return default_folds(conditions)
    measured = sorted({one.position for one in conditions})
    for position in hold_out:
        if not any(abs(position - one) < _SAME_POSITION for one in measured):
            raise NotIdentifiableError(
                f"a position to hold out must be a measured one, {_listed(measured)}; got {1e3 * position:g} mm"
            )
    fold = frozenset(
        one for one in conditions if any(abs(one.position - position) < _SAME_POSITION for position in hold_out)
    )
    if fold == frozenset(conditions):
        raise NotIdentifiableError(
            f"some of the measured positions must be left for the fit; got all of them to hold out, {_listed(measured)}"
        )
    return (fold,)


def _listed(positions: Sequence[float]) -> str:
    return f"{', '.join(f'{1e3 * one:g}' for one in positions)} mm"
