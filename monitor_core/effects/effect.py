"""What a physical effect states of itself: a name, its physics, its parameters, and what it does to an axis.

An effect holds neither data nor fitting: it is added to a description of the axis, and several are added one after the
other. At the null values of its parameters it changes nothing.

Most effects change quantities of one record of the axis by one rule, each quantity by the value of one parameter:
``increasing("added", table_mass="mass_kg")``; the record ``""`` is the physics itself. What :func:`increasing` and the
functions after it return can be pickled, as a search in several processes needs.
"""

import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from typing import Any, Generic, TypeVar

from monitor_core.effects.sizes import MachineSizes, Reference
from monitor_core.errors import OutsideValidityError

#: What an effect is added to: the physics of an axis, or the forces of a rigid one in motion.
Physics = TypeVar("Physics")

#: What a quantity becomes, from what it is and the value of a parameter.
_Rule = Callable[[float, float], float]
_Change = Callable[[Any, Mapping[str, float]], Any]


def changed(physics: Physics, record: str, **values: float) -> Physics:
    """Return the physics of an axis with other values in one of its records, or in itself where that is ``""``."""
    physics_: Any = physics
    if not record:
        return replace(physics_, **values)  # type: ignore[no-any-return]
    return replace(physics_, **{record: replace(getattr(physics, record), **values)})  # type: ignore[no-any-return]


def increasing(record: str, **by: str) -> _Change:
    """Return the change that adds values to quantities."""
    return partial(_changed_by_rule, operator.add, record, by)


def setting(record: str, **to: str) -> _Change:
    """Return the change that puts values in place of quantities."""
    return partial(_changed_by_rule, _replaced, record, to)


def scaling(record: str, **by: str) -> _Change:
    """Return the change that multiplies quantities by e to the power of values."""
    return partial(_changed_by_rule, _scaled, record, by)


def growing(record: str, **by: str) -> _Change:
    """Return the change that makes quantities larger by values, relative to what they are."""
    return partial(_changed_by_rule, _grown, record, by)


def filling(record: str, **by: str) -> _Change:
    """Return the change that adds shares of what is missing to one."""
    return partial(_changed_by_rule, _filled, record, by)


def resonating(quantity: str, *, by: str) -> _Change:
    """Return the change that gives a drive a mode of its own, by the quantity that is its size, such as ``base_mass``.

    Its frequency and damping ratio are the parameters ``frequency_hz`` and ``damping_ratio``.
    """
    mode = quantity.rpartition("_")[0]
    names = {quantity: by, f"{mode}_frequency": "frequency_hz", f"{mode}_damping_ratio": "damping_ratio"}
    return setting("added", **names)


def having(record: str, quantity: str) -> Callable[[Any], bool]:
    """Return the condition that an axis states a quantity, and not as zero."""
    return partial(_has, record, quantity, True)


def lacking(record: str, quantity: str) -> Callable[[Any], bool]:
    """Return the condition that an axis has nothing of a quantity yet."""
    return partial(_has, record, quantity, False)


def _changed_by_rule(
    rule: _Rule, record: str, by: Mapping[str, str], physics: Physics, values: Mapping[str, float]
) -> Physics:
    part = getattr(physics, record) if record else physics
    return changed(physics, record, **{item: rule(getattr(part, item), values[name]) for item, name in by.items()})


def _replaced(_quantity: float, value: float) -> float:
    return value


def _scaled(quantity: float, value: float) -> float:
    return quantity * math.exp(value)


def _grown(quantity: float, value: float) -> float:
    return quantity * (1.0 + value)


def _filled(share: float, value: float) -> float:
    return share + value * (1.0 - share)


def _has(record: str, quantity: str, wanted: bool, physics: object) -> bool:
    return bool(getattr(getattr(physics, record) if record else physics, quantity)) is wanted


_KEY = re.compile(r"[a-z0-9-]+(:[a-z0-9_]+)?", re.ASCII)


def _always(_physics: object) -> bool:
    """Apply to every axis."""
    return True


class ConditionAxis(StrEnum):
    """What a test may vary, and what has to vary for some effects to be seen."""

    POSITION = "position"
    PRELOAD = "preload"
    PAYLOAD = "payload"
    TEMPERATURE = "temperature"
    LEVEL = "excitation level"
    FREQUENCY = "frequency"  # whole responses, not natural frequencies alone
    DIRECTION = "direction"
    RECORD = "record"  # a second one, of another motion


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """One quantity of an effect, by its name in files.

    A quantity that goes with another one, such as the frequency of an added mode with its residue, is without effect
    while that other one is null; its own null is then where a search begins.

    Range, scale and null are multiples of a size of the machine, so that one effect serves small and large axes:
    :meth:`sized` makes them values.
    """

    name: str  # ends with the unit, as in files: stiffness_n_per_m
    unit: str  # "-" where it has none
    lower: float  # smallest plausible value
    upper: float  # largest plausible value
    scale: float  # what a noticeable effect has: where a search looks first
    null: float = 0.0  # where the axis is unchanged
    beyond: bool = True  # whether a search looks beyond the plausible range, where no axis is but a stand-in may be
    reference: Reference = Reference.NONE  # of what the four numbers are multiples; NONE: they are values

    def __post_init__(self) -> None:
        if not (self.lower <= self.null <= self.upper and self.lower < self.upper):
            raise OutsideValidityError(
                f"{self.name} must be null within its plausible range; got {self.null} for {self.lower} to {self.upper}"
            )
        if not (self.scale and math.isfinite(self.scale) and self.lower <= self.null + self.scale <= self.upper):
            raise OutsideValidityError(
                f"the scale of {self.name} must lie within its range and not be 0; got {self.scale}"
            )

    def sized(self, sizes: MachineSizes) -> "EffectParameter":
        """Return the parameter with values for one machine; ``OutsideValidityError`` if that lacks the reference."""
        size = sizes.of(self.reference)
        return replace(
            self,
            lower=size * self.lower,
            upper=size * self.upper,
            scale=size * self.scale,
            null=size * self.null,
            reference=Reference.NONE,
        )


@dataclass(frozen=True, slots=True)
class Effect(Generic[Physics]):
    """A physical effect that a model of an axis may lack."""

    key: str  # in files, lower case with dashes
    name: str  # what a person reads
    physics: str  # one or two sentences: what happens, and how it shows
    source: str  # where the formula comes from
    parameters: tuple[EffectParameter, ...]  # the first is a size, null at 0
    add: Callable[[Physics, Mapping[str, float]], Physics]  # values by the names of the parameters
    needs: frozenset[ConditionAxis] = frozenset()  # what has to vary, or the effect is not seen as such
    applies: Callable[[Physics], bool] = _always  # whether the axis has what it acts on
    textbook: Mapping[str, float] | None = None  # values at which it is plain physics that a simpler model leaves out
    #: Size that every axis may have of it and no description states: less of it is nothing that a model lacks.
    ordinary: float = 0.0
    #: Less of it is not this effect but another, and is left to that.
    least: float = 0.0
    #: Relative standard uncertainty of its size by what the formula leaves out. Those that differ from the default
    #: are what sizes found on simulated machines err by beyond their scatter, as benchmarks/hidden_effects.py lists it.
    form_share: float = 0.02

    def __post_init__(self) -> None:
        if not _KEY.fullmatch(self.key):
            raise OutsideValidityError(
                f"the key of an effect must be of lower-case letters, digits and dashes; got {self.key!r}"
            )
        names = [parameter.name for parameter in self.parameters]
        if not names or len(set(names)) < len(names):
            raise OutsideValidityError(
                f"the effect {self.key} needs parameters with different names; got {', '.join(names) or 'none'}"
            )
        if self.parameters[0].null != 0.0:
            raise OutsideValidityError(
                f"the first parameter of the effect {self.key} is its size and must be null at 0; "
                f"got {self.parameters[0].null} of {names[0]}"
            )

    def added_to(self, physics: Physics, values: Mapping[str, float]) -> Physics:
        """Return the axis with the effect.

        Values beyond the plausible range are taken: whether to believe them is for whoever fitted them.
        ``OutsideValidityError`` if a value is missing, not of this effect or not finite, if no axis could have it, or
        if the effect does not apply to this axis.
        """
        expected = [parameter.name for parameter in self.parameters]
        if set(values) != set(expected):
            raise OutsideValidityError(
                f"the effect {self.key} has the parameters {', '.join(expected)}; got {', '.join(values) or 'none'}"
            )
        for parameter in self.parameters:
            if not math.isfinite(values[parameter.name]):
                raise OutsideValidityError(
                    f"the effect {self.key}: {parameter.name} must be finite; "
                    f"got {values[parameter.name]} {parameter.unit}"
                )
        if not self.applies(physics):
            raise OutsideValidityError(
                f"the effect {self.key} does not apply: this axis lacks what it acts on, or has the effect already"
            )
        try:
            return self.add(physics, values)
        except OutsideValidityError as error:
            raise OutsideValidityError(f"the effect {self.key}: {error}") from error

    @property
    def frequency(self) -> EffectParameter | None:
        """The parameter that is a frequency of its own, such as that of an added mode, None where there is none."""
        in_hertz = (parameter for parameter in self.parameters if parameter.unit == "Hz")
        return next((parameter for parameter in in_hertz if parameter.name.startswith("frequency")), None)

    @property
    def is_sized(self) -> bool:
        """Whether the numbers of its parameters are values, and not multiples of what a machine has."""
        return all(parameter.reference is Reference.NONE for parameter in self.parameters)

    def sized(self, sizes: MachineSizes) -> "Effect[Physics]":
        """Return the effect with ranges and scales for one machine."""
        return replace(self, parameters=tuple(parameter.sized(sizes) for parameter in self.parameters))

    def null_values(self) -> dict[str, float]:
        """Return the values at which nothing is changed."""
        return {parameter.name: parameter.null for parameter in self.parameters}


def sized_for(effects: Iterable[Effect[Physics]], sizes: MachineSizes) -> tuple[Effect[Physics], ...]:
    """Return effects with ranges and scales for one machine."""
    return tuple(effect.sized(sizes) for effect in effects)
