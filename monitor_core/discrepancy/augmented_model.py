"""Make the description of an axis after an explanation: refitted parameters, its own effects with those found."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from monitor_core.discrepancy.explanation import Explanation
from monitor_core.effects import Effect, EffectParameter
from monitor_core.fitting.description import AxisDescription

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
    for key, found in explanation.added.items():
        effects[key] = _together(effects[key], found, _parameters(key, table)) if key in effects else dict(found)
    return replace(baseline, parameters=parameters, effects=effects)


def _parameters(key: str, table: Sequence[Effect[Any]]) -> dict[str, EffectParameter]:
    """Return what an effect may have; of two that share a key, all that either has."""
    return {parameter.name: parameter for effect in table if effect.key == key for parameter in effect.parameters}


def _together(
    present: Mapping[str, float], found: Mapping[str, float], parameters: Mapping[str, EffectParameter]
) -> dict[str, float]:
    """Return the values with which an effect, added once, does what it did when it was added twice."""
    both = {**present, **found}
    for name in present.keys() & found.keys():
        before, more = present[name], found[name]
        if name in _FACTORS:
            both[name] = (1.0 + before) * (1.0 + more) - 1.0
        elif name in _SHARES_OF_THE_REST:
            both[name] = 1.0 - (1.0 - before) * (1.0 - more)
        elif parameters[name].null == 0.0:
            both[name] = before + more
        # else it only shapes what was absent before, and is as it was found
    return both
