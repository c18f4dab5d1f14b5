r"""Effects by which one quantity of a drive follows how the axis is set, by a law of few coefficients.

With x the variable, c the coefficients, and x̄ and X a reference and a scale that are part of the law, the quantity is
multiplied by

.. math::

    1 + c_1,\quad 1 + c_1 u,\quad 1 + c_1 u + c_2 u^2, \quad
    1 + c_1 \cos 2\pi\frac{x}{X} + c_2 \sin 2\pi\frac{x}{X}, \quad
    \left(\frac{x}{\bar x}\right)^{c_1}, \quad 1 + c_1 \frac{x}{x + c_2 X}, \quad
    \frac{1}{1 + c + c_1 \cos 2\pi\frac{x}{X} + c_2 \sin 2\pi\frac{x}{X}}, \quad
    1 + c_1 [x > \bar x], \quad 1 + c_1 e^{-u^2/2}, \quad \mathrm{erf} \frac{X}{\sqrt{2} c_1 x}, \qquad
    u = \frac{x - \bar x}{X}, \quad c = \sqrt{c_1^2 + c_2^2}

and a line between levels, 1 + c at each. Where a step lies is known to ± X alone. The error
function is what is left of the gain of a channel that is clipped at X/c₁, under a random signal of rms x (Bussgang, MIT
RLE Technical Report 216, 1952).

No physics stands behind such a law: it says what one would see, for an effect that no catalogue has.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from monitor_core.effects.effect import Effect, EffectParameter, changed
from monitor_core.errors import OutsideValidityError
from monitor_core.models.extended import AxisPhysics
from monitor_core.models.extended.physics import AxisSetting

#: What is left of a quantity at the least: less is no such axis. [-]
_LEAST_FACTOR = 0.02


class Variable(StrEnum):
    """What a quantity may vary with, by its name in files."""

    EXCITATION = "excitation"
    POSITION = "position"
    PRELOAD = "preload"
    PAYLOAD = "payload"
    TEMPERATURE = "temperature"
    ORDER = "order"  # of the measurements
    NOTHING = "nothing"  # it is another one at every setting alike

    def of(self, setting: AxisSetting) -> float:
        """Return its value at a setting, in SI units."""
        return 0.0 if self is Variable.NOTHING else float(getattr(setting, _FIELDS[self]))


_FIELDS = {
    Variable.EXCITATION: "excitation_level",
    Variable.POSITION: "position",
    Variable.PRELOAD: "preload",
    Variable.PAYLOAD: "payload_mass",
    Variable.TEMPERATURE: "temperature_deviation",
    Variable.ORDER: "order",
}


class Form(StrEnum):
    """The forms of a law."""

    CONSTANT = "constant"
    LINEAR = "linear"
    QUADRATIC = "quadratic"
    PERIODIC = "periodic"
    POWER = "power"
    SATURATING = "saturating"
    STEP = "step"
    DIP = "dip"  # or a hump
    CLIPPED = "clipped"
    LEVELS = "levels"
    YIELDING = "yielding"  # of a stiffness: as it is at one angle, softer at every other, as by a crack that opens


def _change(name: str) -> EffectParameter:
    return EffectParameter(name, "-", lower=-4.0, upper=4.0, scale=0.1, beyond=False)


def _softening(name: str) -> EffectParameter:
    return EffectParameter(name, "-", lower=-20.0, upper=20.0, scale=0.1, beyond=False)


_PARAMETERS: Mapping[Form, tuple[EffectParameter, ...]] = {
    **dict.fromkeys((Form.CONSTANT, Form.LINEAR, Form.STEP, Form.DIP), (_change("change"),)),
    Form.QUADRATIC: (_change("change"), _change("curvature")),
    Form.PERIODIC: (_change("cosine"), _change("sine")),
    Form.POWER: (_change("exponent"),),
    Form.SATURATING: (
        _change("change"),
        EffectParameter("half_at", "-", lower=0.02, upper=20.0, scale=0.1, null=1.0, beyond=False),
    ),
    Form.CLIPPED: (EffectParameter("scale_over_limit", "-", lower=0.0, upper=20.0, scale=0.1, beyond=False),),
    Form.YIELDING: (_softening("cosine"), _softening("sine")),
}


@dataclass(frozen=True, slots=True)
class Law:
    """What a quantity varies with, and by which form; coefficients are those of an effect."""

    variable: Variable
    form: Form
    reference: float  # x̄, in SI units of the variable
    scale: float  # X, likewise
    knots: tuple[float, ...] = ()  # levels of a law that has a value at each, rising

    def __post_init__(self) -> None:
        if not (math.isfinite(self.reference) and math.isfinite(self.scale) and self.scale > 0.0):
            raise OutsideValidityError(
                f"a law needs a finite reference and a positive scale; got {self.reference} and {self.scale}"
            )
        if self.form is Form.POWER and not self.reference > 0.0:
            raise OutsideValidityError(f"a power needs a positive reference; got {self.reference}")

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """The coefficients of the form."""
        if self.form is Form.LEVELS:
            return tuple(_change(f"change_{n}") for n in range(1, len(self.knots) + 1))
        return _PARAMETERS[self.form]

    def factor(self, x: float, coefficients: tuple[float, ...]) -> float:
        """Return what the quantity is multiplied by; ``OutsideValidityError`` where hardly anything would be left."""
        u = (x - self.reference) / self.scale
        match self.form:
            case Form.CONSTANT:
                factor = 1.0 + coefficients[0]
            case Form.LINEAR:
                factor = 1.0 + coefficients[0] * u
            case Form.QUADRATIC:
                factor = 1.0 + coefficients[0] * u + coefficients[1] * u * u
            case Form.PERIODIC:
                factor = self._wave(x, coefficients)
            case Form.POWER:
                factor = (x / self.reference) ** coefficients[0] if x > 0.0 else 1.0
            case Form.STEP:
                factor = 1.0 + coefficients[0] * (u > 0.0)
            case Form.DIP:
                factor = 1.0 + coefficients[0] * math.exp(-0.5 * u * u)
            case Form.CLIPPED:
                clipped = math.sqrt(2.0) * coefficients[0] * x
                factor = math.erf(self.scale / clipped) if clipped > 0.0 else 1.0
            case Form.LEVELS:
                factor = 1.0 + float(np.interp(x, self.knots, coefficients))
            case Form.SATURATING:
                factor = 1.0 + coefficients[0] * x / (x + coefficients[1] * self.scale)
            case Form.YIELDING:
                factor = 1.0 / (math.hypot(*coefficients) + self._wave(x, coefficients))
        if not factor >= _LEAST_FACTOR:
            raise OutsideValidityError(
                f"a quantity must keep {_LEAST_FACTOR} of itself; got {factor:.3g} at a {self.variable} of {x:g}"
            )
        return factor

    def _wave(self, x: float, coefficients: tuple[float, ...]) -> float:
        turn = 2.0 * math.pi * x / self.scale
        return 1.0 + coefficients[0] * math.cos(turn) + coefficients[1] * math.sin(turn)


@dataclass(frozen=True, slots=True)
class Variation:
    """The ``add`` of such an effect: which quantity of which record of a drive follows which law."""

    record: str
    quantity: str
    law: Law

    def __call__(self, axis: AxisPhysics, values: Mapping[str, float]) -> AxisPhysics:
        """Return the axis with the quantity following the law; at null values it is the same axis."""
        items = self.law.parameters
        if not any(values[item.name] for item in items if item.null == 0.0):
            return axis
        varied = _Varied(self, tuple(values[item.name] for item in items))
        return replace(axis, by_setting=(*axis.by_setting, varied))

    def is_of(self, axis: AxisPhysics) -> bool:
        """Return whether the axis has such a quantity."""
        return has_quantity(axis, self.record, self.quantity)


@dataclass(frozen=True, slots=True)
class _Varied:
    """An axis as it is at a setting, by a law and its coefficients."""

    variation: Variation
    coefficients: tuple[float, ...]

    def __call__(self, axis: AxisPhysics, setting: AxisSetting) -> AxisPhysics:
        variation, law = self.variation, self.variation.law
        factor = law.factor(law.variable.of(setting), self.coefficients)
        return multiplied(axis, variation.record, variation.quantity, factor)


#: Turns of the motor for one of the screw, by a belt or gear between them, where one is stated; of no record.
GEAR_RATIO = "gear_ratio"
#: What turns with the screw, and goes with the square of that ratio as the motor feels it.
_TURNING = {
    "screw": ("torsional_rigidity", "inertia_per_length", "nut_segment_inertia", "motor_segment_inertia"),
    "joints": ("coupling_stiffness", "coupling_damping"),
}
#: Gains of channels, of which the axis has the logarithm: of recorded over true response, and torque.
_LN_GAINS = {"response_ln_factor": 1.0, "torque_ln_factor": -1.0}


def has_quantity(axis: AxisPhysics, record: str, quantity: str) -> bool:
    """Return whether an axis has a quantity that can be multiplied: one neither zero nor infinite, a gain or gear."""
    if quantity == GEAR_RATIO:
        return True
    value = getattr(getattr(axis, record), quantity)
    return quantity in _LN_GAINS or (bool(value) and math.isfinite(value))


def multiplied(axis: AxisPhysics, record: str, quantity: str, factor: float) -> AxisPhysics:
    """Return the axis with a quantity of one of its records multiplied by a factor, or a gain with it.

    A torque is the smaller the more of it is recorded. ``OutsideValidityError`` if there is no such axis.
    """
    if quantity == GEAR_RATIO:
        for part, names in _TURNING.items():
            axis = changed(axis, part, **{name: getattr(getattr(axis, part), name) / factor**2 for name in names})
        return changed(axis, "screw", lead=axis.screw.lead / factor)
    value = getattr(getattr(axis, record), quantity)
    value = value + _LN_GAINS[quantity] * math.log(factor) if quantity in _LN_GAINS else value * factor
    return changed(axis, record, **{quantity: value})


def varying(record: str, quantity: str, law: Law, *, key: str = "", name: str = "") -> Effect[AxisPhysics]:
    """Return the effect by which a quantity of one of the records of a drive follows a law.

    >>> from monitor_core.effects import Form, Law, Variable, varying
    >>> softer = varying("joints", "nut_stiffness", Law(Variable.EXCITATION, Form.LINEAR, reference=0.15, scale=0.45))
    >>> softer.key
    'varying:joints_nut_stiffness_excitation_linear'
    """
    words, variation = quantity.replace("_", " "), Variation(record, quantity, law)
    what = f"The {words} varies with the {law.variable}"
    return Effect(
        key=key or f"varying:{record}_{quantity}_{law.variable}_{law.form}",
        name=name or (f"Another {words} than stated" if law.variable is Variable.NOTHING else what),
        physics=f"The {words} is another one at each {law.variable}, by a law of the form {law.form}.",
        source="no source: a law that describes what was measured",
        parameters=law.parameters,
        add=variation,
        applies=variation.is_of,
    )
