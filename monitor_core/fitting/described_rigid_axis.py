"""The rigid axis that a motion is compared with: what its description leaves to be adjusted, and by how much."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

from monitor_core.effects import MOTION_EFFECTS, with_motion_effects, wrong_motion_parameters
from monitor_core.effects.effect import Effect
from monitor_core.models.motion import MotionModel, MotionParameters, MotionPhysics
from monitor_core.models.parameters import name_in_file


@dataclass(frozen=True, eq=False)
class MotionSubject:
    """A rigid axis, with the effects its file already has."""

    stated: MotionParameters
    uncertain: Mapping[str, float]
    present: Mapping[str, Mapping[str, float]]  # effects of the file
    table: Sequence[Effect[MotionPhysics]] = MOTION_EFFECTS

    def physics(self, ln_ratios: Mapping[str, float]) -> MotionPhysics:
        """Return the axis with these parameters moved."""
        return with_motion_effects(MotionModel.of(self.parameters(ln_ratios)), self.present, self.table).physics

    def parameters(self, ln_ratios: Mapping[str, float]) -> MotionParameters:
        """Return the stated parameters with some of them moved."""
        names = {name_in_file(item.name): item.name for item in fields(self.stated)}
        return replace(
            self.stated,
            **{names[name]: getattr(self.stated, names[name]) * math.exp(ratio) for name, ratio in ln_ratios.items()},
        )

    def candidates(self) -> tuple[Effect[MotionPhysics], ...]:
        """Return what this axis may lack: every effect of the table, and every stated parameter being wrong."""
        return (*self.table, *wrong_motion_parameters(self.stated))
