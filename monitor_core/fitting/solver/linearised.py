"""Linearise a comparison around the condition errors that are likely there."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.effects.effect import Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import Comparison
from monitor_core.fitting.conditions.condition_errors import Whitening, whitening
from monitor_core.fitting.hypothesis import Hypothesis

Answer = TypeVar("Answer")

_LIKELY = 3.0  # standard deviations: a condition error that seems larger is another misfit, and taken as linear


@dataclass(frozen=True, eq=False)
class Linearised(Generic[Physics]):
    """A comparison around likely condition errors, in which its misfit is linear.

    With the errors e that the settings are taken to have, and the change S of the misfit by them, the misfit of a
    setting with unknown errors is that at e less S e; whitening then finds whatever errors are most likely.
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
    """Linearise a comparison around condition errors of shape (n_settings, n_errors)."""
    shifted = comparison.shifted(errors)
    misfit = shifted.misfit(physics)
    whitened_by = whitening(
        deviation, shifted.condition_errors(physics, misfit), comparison.layout.setting, comparison.layout.common
    )
    offset = -whitened_by.share_of(errors)
    return Linearised(shifted, errors, whitened_by, offset, misfit + offset)


def linearise_at_likely_errors(
    comparison: Comparison[Physics],
    hypothesis: Hypothesis[Physics],
    errors: FloatArray,
    deviation: FloatArray,
    coordinates: FloatArray,
) -> Linearised[Physics]:
    """Linearise a comparison around the errors that are likely at coordinates, sought from other errors.

    Errors that stayed where they were likely before would let a search run far along what they almost make up for: the
    nut's stiffness, say, against a preload that was wrong in all settings alike.
    """
    physics = hypothesis.physics(coordinates)
    resolved = _answer_at(partial(comparison.resolved, physics), errors)
    linearised_at = partial(linearise, resolved, physics, deviation=deviation)
    around = _answer_at(linearised_at, errors)
    likely = np.clip(around.whitened_by.errors(around.here), -_LIKELY, _LIKELY)
    return _answer_at(linearised_at, likely)


def _answer_at(ask: Callable[[FloatArray], Answer], errors: FloatArray) -> Answer:
    """Return the answer with condition errors, or without them where the model has no answer at those."""
    try:
        return ask(errors)
    except OutsideValidityError:
        return ask(np.zeros_like(errors))
