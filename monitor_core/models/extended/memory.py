"""Remember what the screw answers on fixed lines, so that a search computes anew only what has changed.

A search asks for the same lines thousands of times and moves one parameter at a time: the stiffness of a nut changes
neither the screw in tension nor in torsion. What a function has read of the physics is noted while it computes; its
answer holds as long as all of that is the same, whatever else has changed. So no list of what depends on what has to be
kept, and an effect that is new in a function is read there like the rest.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, is_dataclass
from operator import attrgetter
from typing import Any, Generic, TypeVar, cast

import numpy as np

Answer = TypeVar("Answer")

#: Answers of each function, and lines of all of them together: a long session does not fill the memory of the machine.
_MOST_ANSWERS, _MOST_LINES = 8, 1_000_000


@dataclass(frozen=True, slots=True, eq=False)
class _Known(Generic[Answer]):
    """An answer, and what was read for it of the record and given beside it: numbers, and what needs a closer look."""

    read_numbers: Callable[[object], Any] | None
    numbers: Any
    read_arrays: tuple[tuple[Callable[[object], Any], Any], ...]
    arguments: tuple[Any, ...]
    answer: Answer

    @classmethod
    def of(cls, reads: dict[str, object], arguments: tuple[Any, ...], answer: Answer) -> "_Known[Answer]":
        arrays = tuple((attrgetter(name), value) for name, value in reads.items() if isinstance(value, np.ndarray))
        names = [name for name, value in reads.items() if not isinstance(value, np.ndarray)]
        numbers = attrgetter(*names) if names else None
        values = tuple(reads[name] for name in names)
        return cls(numbers, values[0] if len(values) == 1 else values, arrays, arguments, answer)

    def holds(self, record: object, arguments: tuple[Any, ...]) -> bool:
        """Return whether all of it is the same now."""
        try:
            if self.read_numbers is not None and self.read_numbers(record) != self.numbers:
                return False
        except ValueError:  # an array stands where there was a number
            return False
        if not all(map(_same, self.arguments, arguments)):
            return False
        return all(_same(value, read(record)) for read, value in self.read_arrays)


class _Watched:
    """A record whose fields are noted as they are read."""

    def __init__(self, record: object, reads: dict[str, object], before: str = "") -> None:
        self._record, self._reads, self._before = record, reads, before

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 whatever the record has
        value = getattr(self._record, name)
        if is_dataclass(value):
            return _Watched(value, self._reads, f"{self._before}{name}.")
        if callable(value):
            raise TypeError(f"what {name}() reads of a record cannot be noted; read its fields")
        self._reads[self._before + name] = value
        return value


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """Answers of some functions on lines that stay the same; they are not to be written to."""

    n_lines: int
    _known: dict[Callable[..., Any], tuple[_Known[Any], ...]] = field(default_factory=dict, init=False)

    def __reduce__(self) -> tuple[type["Memory"], tuple[int]]:
        """Leave the answers behind where lines go to another process."""
        return Memory, (self.n_lines,)

    def recall(self, function: Callable[..., Answer], first: object, *others: Any) -> Answer:  # noqa: ANN401
        """Return the answer of a function to what it is given, always in as many arguments.

        Of a record that comes first, what is read counts; numbers and arrays count by what they hold, all else by being
        the same.
        """
        record, arguments = (first, others) if is_dataclass(first) else (None, (first, *others))
        entries = self._known.get(function, ())
        for entry in entries:
            if entry.holds(record, arguments):
                if entry is not entries[0]:
                    self._keep(function, entry, tuple(other for other in entries if other is not entry))
                return cast(Answer, entry.answer)
        reads: dict[str, object] = {}
        answer = function(*arguments) if record is None else function(_Watched(record, reads), *arguments)
        self._keep(function, _Known.of(reads, arguments, answer), entries)
        return answer

    def _keep(self, function: Callable[..., Any], first: _Known[Any], others: tuple[_Known[Any], ...]) -> None:
        most = min(_MOST_ANSWERS, max(1, _MOST_LINES // max(self.n_lines, 1)))
        self._known[function] = (first, *others)[:most]


def recall(memory: Memory | None, function: Callable[..., Answer], first: object, *others: Any) -> Answer:  # noqa: ANN401
    """Return the answer of a function, from a memory where there is one."""
    return function(first, *others) if memory is None else memory.recall(function, first, *others)


def _same(value: object, other: object) -> bool:
    if value is other:
        return True
    if isinstance(value, np.ndarray):
        return isinstance(other, np.ndarray) and value.shape == other.shape and bool((value == other).all())
    if isinstance(value, tuple):
        return isinstance(other, tuple) and len(value) == len(other) and all(map(_same, value, other))
    return isinstance(value, float) and isinstance(other, float) and value == other
