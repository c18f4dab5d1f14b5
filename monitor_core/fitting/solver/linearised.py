"""A comparison around likely errors of its settings, in which its misfit is linear."""

from dataclasses import dataclass
from typing import Generic, TypeVar

from monitor_core.arrays import FloatArray
from monitor_core.fitting.comparison import Comparison
from monitor_core.fitting.conditions.condition_errors import Whitening, whitening

Physics = TypeVar("Physics")


@dataclass(frozen=True, eq=False)
class Linearised(Generic[Physics]):
    """A comparison around likely errors of its settings, in which its misfit is linear.

    With the errors e that settings are taken to have, and the change S of the misfit by them, the misfit of a setting
    whose errors were not known is that at e less S e; whitening then finds whatever errors are most likely.
    """

    comparison: Comparison[Physics]  # shifted by the errors
    errors: FloatArray  # e, shape (n_settings, n_errors)
    whitened_by: Whitening
    offset: FloatArray  # −S e, shape (n_values,)
    here: FloatArray  # misfit of the physics around which it was linearised, shape (n_values,)

    def misfit(self, physics: Physics) -> FloatArray:
        """Return the misfit, shape (n_values,)."""
        return self.comparison.misfit(physics) + self.offset

    def residuals(self, physics: Physics) -> FloatArray:
        """Return independent residuals, standard normal where the physics is right, shape (n_values,)."""
        return self.whitened_by(self.misfit(physics))


def linearise(
    comparison: Comparison[Physics], physics: Physics, errors: FloatArray, deviation: FloatArray
) -> Linearised[Physics]:
    """Linearise a comparison around errors of its settings, shape (n_settings, n_errors)."""
    shifted = comparison.shifted(errors)
    misfit = shifted.misfit(physics)
    whitened_by = whitening(
        deviation, shifted.setting_errors(physics, misfit), comparison.layout.setting, comparison.layout.common
    )
    offset = -whitened_by.share_of(errors)
    return Linearised(shifted, errors, whitened_by, offset, misfit + offset)
