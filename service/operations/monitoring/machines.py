"""Machines own axes: each with its axes, and how the worst of them stands."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

from service.operations.monitoring.trend import AxisStatus

#: Worst first; an axis nobody can judge comes before one that is well.
SEVERITY = ("alarm", "alert", "unknown", "learning", "normal")


@dataclass(frozen=True, slots=True)
class Machine:
    """A machine, with its axes in order of name."""

    name: str
    place: str | None
    axes: tuple[AxisStatus, ...]

    @property
    def state(self) -> str:
        """How the worst of its axes stands."""
        return min((axis.state for axis in self.axes), key=SEVERITY.index)


def machines_of(axes: Iterable[AxisStatus]) -> list[Machine]:
    """Return the machines that axes are of, in order of name; one of the same name elsewhere is another one."""
    owned: dict[tuple[str, str], list[AxisStatus]] = defaultdict(list)
    for axis in axes:
        configuration = axis.configuration
        if configuration.machine is not None:
            owned[configuration.machine, configuration.machine_place or ""].append(axis)
    return [Machine(name, place or None, tuple(found)) for (name, place), found in sorted(owned.items())]
