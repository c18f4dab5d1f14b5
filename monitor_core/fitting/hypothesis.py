"""State a hypothesis: a described axis with some effects, as a function of plain coordinates."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Generic

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.effects import PREFIX
from monitor_core.effects.effect import Effect, EffectParameter, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.axis import DescribedAxis
from monitor_core.fitting.problem import FreeParameter, Linear, Prior, stated_priors

#: How far beyond its plausible range the size of an effect is sought, in widths of that range: an effect
#: that is found there is a stand-in for something else, which is worth knowing.
_BEYOND_PLAUSIBLE = 10.0


@dataclass(frozen=True, eq=False)
class Hypothesis(Generic[Physics]):
    """A described axis with effects.

    Coordinates are ln-ratios of the uncertain parameters in their standard deviations, then the parameters of the
    effects from their null values in their scales.
    """

    axis: DescribedAxis[Physics]
    effects: tuple[Effect[Physics], ...] = ()

    def __post_init__(self) -> None:
        for effect in self.effects:
            if not effect.is_sized:
                raise OutsideValidityError(
                    f"an effect must be sized for a machine before it is fitted; got {effect.key} in multiples"
                )

    @cached_property
    def uncertain(self) -> tuple[str, ...]:
        """Parameters that move within their tolerance; one that an effect calls wrong is not held by it."""
        wrong = {effect.key.removeprefix(PREFIX) for effect in self.effects if effect.key.startswith(PREFIX)}
        return tuple(name for name in self.axis.uncertain if name not in wrong)

    @cached_property
    def coordinates(self) -> tuple[FreeParameter, ...]:
        """What the fit moves: ln-ratios of the uncertain parameters, then the parameters of the effects."""
        return (
            *(FreeParameter(name, Linear(0.0, self.axis.uncertain[name]), Prior(0.0, 1.0)) for name in self.uncertain),
            *(
                FreeParameter(f"{effect.key} {parameter.name}", Linear(parameter.null, parameter.scale))
                for effect, parameter in self.unknowns
            ),
        )

    @cached_property
    def priors(self) -> FloatArray:
        """Estimates and standard uncertainties of the coordinates, shape (2, n_coordinates)."""
        return stated_priors(self.coordinates)

    @cached_property
    def unknowns(self) -> tuple[tuple[Effect[Physics], EffectParameter], ...]:
        """The parameters of the effects, in order."""
        return tuple((effect, parameter) for effect in self.effects for parameter in effect.parameters)

    @property
    def keys(self) -> frozenset[str]:
        """The keys of the effects."""
        return frozenset(effect.key for effect in self.effects)

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
        """The axis as stated, without effects."""
        return np.zeros(self.n_coordinates)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Where the coordinates may lie."""
        limits = [searched_coordinates(effect, parameter) for effect, parameter in self.unknowns]
        lower = [-math.inf] * self.n_uncertain + [low for low, _ in limits]
        upper = [math.inf] * self.n_uncertain + [high for _, high in limits]
        return np.array(lower), np.array(upper)

    def ln_ratios(self, coordinates: FloatArray) -> dict[str, float]:
        """Return ln(moved/stated) of the uncertain parameters by name."""
        return dict(zip(self.uncertain, self._values(coordinates)[: self.n_uncertain], strict=True))

    def values(self, coordinates: FloatArray) -> dict[str, dict[str, float]]:
        """Return the values of the effects' parameters by key and name."""
        by_key: dict[str, dict[str, float]] = {effect.key: {} for effect in self.effects}
        for (effect, parameter), value in zip(
            self.unknowns, self._values(coordinates)[self.n_uncertain :], strict=True
        ):
            by_key[effect.key][parameter.name] = value
        return by_key

    def physics(self, coordinates: FloatArray) -> Physics:
        """Return the axis at these coordinates; raises OutsideValidityError where there is none."""
        values = self.values(coordinates)
        physics = self.axis.physics(self.ln_ratios(coordinates))
        for effect in self.effects:
            physics = effect.added_to(physics, values[effect.key])
        return physics

    def at_textbook_values(self, uncertain: FloatArray) -> FloatArray:
        """Return coordinates with all effects at their textbook values, those of uncertain parameters as given."""
        tail = zip(self.coordinates[self.n_uncertain :], self.unknowns, strict=True)
        textbook = [
            free.transform.coordinate((effect.textbook or {})[unknown.name]) for free, (effect, unknown) in tail
        ]
        return np.concatenate([uncertain[: self.n_uncertain], textbook])

    def with_effect(self, effect: Effect[Physics]) -> "Hypothesis[Physics]":
        """Return the hypothesis with one more effect."""
        return Hypothesis(self.axis, (*self.effects, effect))

    def without(self, key: str) -> "Hypothesis[Physics]":
        """Return the hypothesis without the effect of this key."""
        return Hypothesis(self.axis, tuple(effect for effect in self.effects if effect.key != key))

    def carried_over(self, other: "Hypothesis[Physics]", coordinates: FloatArray) -> FloatArray:
        """Return the coordinates of another hypothesis in this one; what that one lacks is null."""
        uncertain = dict(zip(other.uncertain, coordinates[: other.n_uncertain].tolist(), strict=True))
        effects = {
            (effect.key, parameter.name): coordinate
            for (effect, parameter), coordinate in zip(
                other.unknowns, coordinates[other.n_uncertain :].tolist(), strict=True
            )
        }
        ratios = other.ln_ratios(coordinates)
        for (
            effect,
            parameter,
        ) in self.unknowns:  # a parameter that is called wrong starts from where its tolerance let it go
            name = effect.key.removeprefix(PREFIX)
            if effect.key.startswith(PREFIX) and name in ratios:
                effects[effect.key, parameter.name] = ratios[name] / parameter.scale
        return np.array(
            [uncertain.get(name, 0.0) for name in self.uncertain]
            + [effects.get((effect.key, parameter.name), 0.0) for effect, parameter in self.unknowns]
        )

    def _values(self, coordinates: FloatArray) -> list[float]:
        pairs = zip(self.coordinates, coordinates.tolist(), strict=True)
        return [parameter.transform.value(x) for parameter, x in pairs]


def is_size(parameter: EffectParameter) -> bool:
    """Tell a size, at whose null the effect is absent, from what only shapes an effect that is present."""
    return parameter.null == 0.0


def searched_range(effect: Effect[Physics], parameter: EffectParameter) -> tuple[float, float]:
    """Return where a parameter is sought: a size beyond its plausible range, too, but never of an impossible sign."""
    if not is_size(parameter) or parameter is not effect.parameters[0] or not parameter.beyond:
        return parameter.lower, parameter.upper
    width = parameter.upper - parameter.lower
    lower = parameter.lower if parameter.lower == parameter.null else parameter.lower - _BEYOND_PLAUSIBLE * width
    upper = parameter.upper if parameter.upper == parameter.null else parameter.upper + _BEYOND_PLAUSIBLE * width
    return lower, upper


def searched_coordinates(effect: Effect[Physics], parameter: EffectParameter) -> tuple[float, float]:
    """Return where the coordinate of a parameter is sought; the scale of one that can only be less is negative."""
    first, second = ((end - parameter.null) / parameter.scale for end in searched_range(effect, parameter))
    return min(first, second), max(first, second)
