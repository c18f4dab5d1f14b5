r"""Trace a function of numbers line by line, so that its derivatives by all of them follow from one pass backwards.

What is computed from a :class:`Traced` value is one, too, and notes the values it was made of with its derivative by
each. By the chain rule, backwards,

.. math::

    \frac{\partial y}{\partial x} = \sum_{v\ \mathrm{from}\ x} \frac{\partial y}{\partial v}
    \frac{\partial v}{\partial x}

so that a result has its derivatives by all numbers for little more than what it costs itself (Griewank & Walther,
Evaluating Derivatives, 2008, chapter 3). Lines do not know each other: every derivative is one for each line. All
functions are analytic.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import NumberArray, reciprocal

_SMALL = 1e-3  # of a square of a phase, below which a series is exact to rounding
_next_number = itertools.count()

Partial = NumberArray | complex


class Traced:
    """A value at each line, and what it was made of."""

    __slots__ = ("number", "sources", "value")
    __array_priority__ = 1000.0

    def __init__(self, value: Any, sources: Sequence[tuple["Traced", Partial]] = ()) -> None:  # noqa: ANN401 numbers
        self.value, self.sources, self.number = value, tuple(sources), next(_next_number)

    def __bool__(self) -> bool:
        """Act, even where the value is null: it is about to move."""
        return True

    @property
    def ndim(self) -> int:
        """Number of dimensions of the value."""
        return int(np.ndim(self.value))

    def __add__(self, other: Any) -> "Traced":  # noqa: ANN401 numbers
        if isinstance(other, Traced):
            return Traced(self.value + other.value, ((self, 1.0), (other, 1.0)))
        return Traced(self.value + other, ((self, 1.0),))

    __radd__ = __add__

    def __neg__(self) -> "Traced":
        return Traced(-self.value, ((self, -1.0),))

    def __sub__(self, other: Any) -> "Traced":  # noqa: ANN401
        if isinstance(other, Traced):
            return Traced(self.value - other.value, ((self, 1.0), (other, -1.0)))
        return Traced(self.value - other, ((self, 1.0),))

    def __rsub__(self, other: Any) -> "Traced":  # noqa: ANN401
        return Traced(other - self.value, ((self, -1.0),))

    def __mul__(self, other: Any) -> "Traced":  # noqa: ANN401
        if isinstance(other, Traced):
            return Traced(self.value * other.value, ((self, other.value), (other, self.value)))
        return Traced(self.value * other, ((self, other),))

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> "Traced":  # noqa: ANN401
        return self.__mul__(1.0 / other)

    def __rtruediv__(self, other: Any) -> "Traced":  # noqa: ANN401
        inverse = reciprocal(self.value)
        return Traced(other * inverse, ((self, -other * (inverse * inverse)),))

    def __pow__(self, exponent: Any) -> "Traced":  # noqa: ANN401
        power = exponent.value if isinstance(exponent, Traced) else exponent
        value = self.value**power
        sources: list[tuple[Traced, Partial]] = [(self, power * self.value ** (power - 1.0))]
        if isinstance(exponent, Traced):
            sources.append((exponent, value * np.log(self.value)))
        return Traced(value, sources)

    def __rpow__(self, base: Any) -> "Traced":  # noqa: ANN401
        value = base**self.value
        return Traced(value, ((self, value * np.log(base)),))

    def __gt__(self, other: Any) -> npt.NDArray[np.bool_]:  # noqa: ANN401
        return np.asarray(self.value > value_of(other))

    def __lt__(self, other: Any) -> npt.NDArray[np.bool_]:  # noqa: ANN401
        return np.asarray(self.value < value_of(other))

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **_: Any) -> Any:  # noqa: ANN401 numpy's
        function = _FUNCTIONS.get(ufunc)
        return NotImplemented if function is None or method != "__call__" else function(*inputs)

    def __array_function__(self, function: Any, _: Any, inputs: Any, __: Any) -> Any:  # noqa: ANN401 numpy's
        if function is not np.where:
            return NotImplemented
        chosen, first, second = inputs
        pairs = ((first, np.where(chosen, 1.0, 0.0)), (second, np.where(chosen, 0.0, 1.0)))
        sources = [(value, partial) for value, partial in pairs if isinstance(value, Traced)]
        return Traced(np.where(chosen, value_of(first), value_of(second)), sources)


def value_of(number: Any) -> Any:  # noqa: ANN401 numbers
    """Return a number or an array without its trace."""
    return number.value if isinstance(number, Traced) else number


def derivatives(result: Traced, by: Sequence[Traced]) -> list[NumberArray | float]:
    """Return the derivatives of a result by some numbers, zero where it was not made of one."""
    passed: dict[int, Any] = {result.number: 1.0}
    for value in _backwards(result):
        here = passed[value.number]
        for source, partial in value.sources:
            is_same, before = isinstance(partial, float) and partial == 1.0, passed.get(source.number)
            share = here if is_same else here * partial
            if before is None:
                passed[source.number] = share
            elif is_same or np.shape(share) != np.shape(before) or np.result_type(share) != np.result_type(before):
                passed[source.number] = before + share
            else:
                passed[source.number] = np.add(before, share, out=share if np.ndim(share) else None)
    return [passed.get(number.number, 0.0) for number in by]


def _backwards(result: Traced) -> list[Traced]:
    """Return everything that a result was made of, each before what it was made of itself."""
    traced, waiting = {result.number: result}, [result]
    while waiting:
        for source, _ in waiting.pop().sources:
            if source.number not in traced:
                traced[source.number] = source
                waiting.append(source)
    return [traced[number] for number in sorted(traced, reverse=True)]


def cosine_of_square(square: Traced) -> Traced:
    r"""Return :math:`\cos\sqrt{p}`, of which the derivative is :math:`-\frac12 \mathrm{sinc}\sqrt{p}`."""
    phase = np.sqrt(square.value)
    return Traced(np.cos(phase), ((square, -0.5 * _sinc(phase)),))


def sinc_of_square(square: Traced) -> Traced:
    r"""Return :math:`\sin\sqrt{p}/\sqrt{p}`, of which the derivative is :math:`(\cos - \mathrm{sinc})/2p`."""
    phase = np.sqrt(square.value)
    sinc, small = _sinc(phase), np.abs(square.value) < _SMALL
    slope = np.where(
        small,
        -1.0 / 6.0 + square.value * (1.0 / 60.0 - square.value / 1680.0),
        0.5 * (np.cos(phase) - sinc) / np.where(small, 1.0, square.value),
    )
    return Traced(sinc, ((square, slope),))


def _sinc(phase: NumberArray) -> NumberArray:
    safe = np.where(phase == 0.0, 1e-20, phase)
    return np.asarray(np.sin(safe) / safe)


def _of_one(function: Callable[[Any], Any], slope: Callable[[Any, Any], Any]) -> Callable[[Traced], Traced]:
    def traced(argument: Traced) -> Traced:
        value = function(argument.value)
        return Traced(value, ((argument, slope(argument.value, value)),))

    return traced


def _maximum(first: Any, second: Any) -> Any:  # noqa: ANN401 numbers
    return np.where(np.asarray(value_of(first) > value_of(second)), first, second)


_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.add: lambda first, second: second + first if isinstance(second, Traced) else first + second,
    np.subtract: lambda first, second: second.__rsub__(first) if isinstance(second, Traced) else first - second,
    np.multiply: lambda first, second: second * first if isinstance(second, Traced) else first * second,
    np.true_divide: lambda first, second: second.__rtruediv__(first) if isinstance(second, Traced) else first / second,
    np.power: lambda first, second: second.__rpow__(first) if isinstance(second, Traced) else first**second,
    np.negative: lambda value: -value,
    np.greater: lambda first, second: value_of(first) > value_of(second),
    np.less: lambda first, second: value_of(first) < value_of(second),
    np.maximum: _maximum,
    np.cos: _of_one(np.cos, lambda x, _: -np.sin(x)),
    np.sin: _of_one(np.sin, lambda x, _: np.cos(x)),
    np.exp: _of_one(np.exp, lambda _, y: y),
    np.arctan: _of_one(np.arctan, lambda x, _: 1.0 / (1.0 + x * x)),
    np.sqrt: _of_one(np.sqrt, lambda _, y: 0.5 / y),
}
