"""One explanation under trial: the axis with some effects, as a function of plain coordinates."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.effects import PREFIX
from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.fitting.described_axis import DescribedAxis

Physics = TypeVar("Physics")

#: How far beyond its plausible range the size of an effect is sought, in widths of that range: whoever finds it there
#: has found a stand-in for something else, which is worth knowing.
_BEYOND_PLAUSIBLE = 10.0


@dataclass(frozen=True, eq=False)
class Hypothesis(Generic[Physics]):
    """A subject with effects.

    Coordinates are ln-ratios of the uncertain parameters in their standard deviations, then the parameters of the
    effects from their null values in their scales.
    """

    subject: DescribedAxis[Physics]
    effects: tuple[Effect[Physics], ...] = ()

    @cached_property
    def uncertain(self) -> tuple[str, ...]:
        """Parameters that move within their tolerance; one that an effect calls wrong is not held by it."""
        wrong = {effect.key.removeprefix(PREFIX) for effect in self.effects if effect.key.startswith(PREFIX)}
        return tuple(name for name in self.subject.uncertain if name not in wrong)

    @cached_property
    def _deviations(self) -> FloatArray:
        return np.array([self.subject.uncertain[name] for name in self.uncertain])

    @cached_property
    def unknowns(self) -> tuple[tuple[Effect[Physics], EffectParameter], ...]:
        """The parameters of the effects, in order."""
        return tuple((effect, one) for effect in self.effects for one in effect.parameters)

    @property
    def n_uncertain(self) -> int:
        """How many coordinates have a prior."""
        return len(self.uncertain)

    @property
    def n_coordinates(self) -> int:
        """How many coordinates there are."""
        return len(self.uncertain) + len(self.unknowns)

    @property
    def null(self) -> FloatArray:
        """The subject as stated, without effects."""
        return np.zeros(self.n_coordinates)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Where the coordinates may lie."""
        limits = [searched_coordinates(effect, one) for effect, one in self.unknowns]
        lower = [-math.inf] * self.n_uncertain + [low for low, _ in limits]
        upper = [math.inf] * self.n_uncertain + [high for _, high in limits]
        return np.array(lower), np.array(upper)

    def ln_ratios(self, coordinates: FloatArray) -> dict[str, float]:
        """Return ln(moved/stated) of the uncertain parameters by name."""
        moved = coordinates[: self.n_uncertain] * self._deviations
        return dict(zip(self.uncertain, moved.tolist(), strict=True))

    def values(self, coordinates: FloatArray) -> dict[str, dict[str, float]]:
        """Return the values of the effects' parameters by key and name."""
        found: dict[str, dict[str, float]] = {effect.key: {} for effect in self.effects}
        for (effect, one), at in zip(self.unknowns, coordinates[self.n_uncertain :].tolist(), strict=True):
            found[effect.key][one.name] = one.null + one.scale * at
        return found

    def physics(self, coordinates: FloatArray) -> Physics:
        """Return the axis at these coordinates; raises OutsideValidityError where there is none."""
        values = self.values(coordinates)
        axis = self.subject.physics(self.ln_ratios(coordinates))
        for effect in self.effects:
            axis = effect.added_to(axis, values[effect.key])
        return axis

    def at_textbook_values(self, uncertain: FloatArray) -> FloatArray:
        """Return coordinates with all effects at their textbook values, those of uncertain parameters as given."""
        tail = [((effect.textbook or {})[one.name] - one.null) / one.scale for effect, one in self.unknowns]
        return np.concatenate([uncertain[: self.n_uncertain], tail])

    def with_effect(self, effect: Effect[Physics]) -> "Hypothesis[Physics]":
        """Return the hypothesis with one more effect."""
        return Hypothesis(self.subject, (*self.effects, effect))

    def without(self, key: str) -> "Hypothesis[Physics]":
        """Return the hypothesis without the effect of this key."""
        return Hypothesis(self.subject, tuple(effect for effect in self.effects if effect.key != key))

    def carried_over(self, other: "Hypothesis[Physics]", coordinates: FloatArray) -> FloatArray:
        """Return the coordinates of another hypothesis in this one; what that one lacks is null."""
        uncertain = dict(zip(other.uncertain, coordinates[: other.n_uncertain].tolist(), strict=True))
        effects = {
            (effect.key, one.name): at
            for (effect, one), at in zip(other.unknowns, coordinates[other.n_uncertain :].tolist(), strict=True)
        }
        ratios = other.ln_ratios(coordinates)
        for effect, one in self.unknowns:  # a parameter that is called wrong starts from where its tolerance let it go
            name = effect.key.removeprefix(PREFIX)
            if effect.key.startswith(PREFIX) and name in ratios:
                effects[effect.key, one.name] = ratios[name] / one.scale
        return np.array(
            [uncertain.get(name, 0.0) for name in self.uncertain]
            + [effects.get((effect.key, one.name), 0.0) for effect, one in self.unknowns]
        )


def is_size(one: EffectParameter) -> bool:
    """Tell a size, at whose null the effect is absent, from what only shapes an effect that is present."""
    return one.null == 0.0


def searched_range(effect: Effect[Physics], one: EffectParameter) -> tuple[float, float]:
    """Return where a parameter is sought: a size beyond its plausible range, too, but never of an impossible sign."""
    if not is_size(one) or one is not effect.parameters[0] or not one.beyond:
        return one.lower, one.upper
    width = one.upper - one.lower
    lower = one.lower if one.lower == one.null else one.lower - _BEYOND_PLAUSIBLE * width
    upper = one.upper if one.upper == one.null else one.upper + _BEYOND_PLAUSIBLE * width
    return lower, upper


def searched_coordinates(effect: Effect[Physics], one: EffectParameter) -> tuple[float, float]:
    """Return where the coordinate of a parameter is sought; the scale of one that can only be less is negative."""
    first, second = ((end - one.null) / one.scale for end in searched_range(effect, one))
    return min(first, second), max(first, second)
