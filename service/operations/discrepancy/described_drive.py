"""A drive as its model file describes it, and measurements as that description can take them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

from monitor_core.effects import DRIVE_EFFECTS
from monitor_core.effects.effect import Effect
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.described_axis import DescribedDrive
from monitor_core.fitting.observations import FrequencyResponseObservation, ModalObservation
from monitor_core.models.extended import AxisPhysics
from monitor_core.recordings.model_file import DriveModelFile
from service.operations.discrepancy.augmented_model import with_corrected_parameters

_Observation = TypeVar("_Observation", ModalObservation, FrequencyResponseObservation)

_RATING = "dynamic_load_rating_n"


def described_drive(model: DriveModelFile, table: Sequence[Effect[AxisPhysics]] = DRIVE_EFFECTS) -> DescribedDrive:
    """Return a drive as its model file describes it.

    Raises
    ------
    OutsideValidityError, RecordingFormatError
        If parameters or effects of the file are not sound.
    """
    model.build(table)  # so that its effects are sound
    corrected = with_corrected_parameters(model)
    return DescribedDrive(corrected.build(table).parameters, corrected.uncertain, corrected.effects, table)


def at_the_preload_of_the_nut(observations: Sequence[_Observation], model: DriveModelFile) -> list[_Observation]:
    """Leave out a preload that all share where the nut does not follow it: its rigidity is that at this preload.

    Raises
    ------
    OutsideValidityError
        If the preload varies: a nut of one rigidity cannot follow it.
    """
    preloads = {one.conditions.preload for one in observations}
    if _RATING in model.parameters or preloads <= {None}:
        return list(observations)
    if len(preloads) > 1:
        listed = ", ".join("none stated" if one is None else f"{one:g} N" for one in sorted(preloads, key=_or_zero))
        raise OutsideValidityError(
            f"a model without {_RATING} has the nut rigidity of one preload; got measurements at {listed}: "
            "state the rating"
        )
    return [replace(one, conditions=replace(one.conditions, preload=None)) for one in observations]


def _or_zero(preload: float | None) -> float:
    return preload or 0.0
