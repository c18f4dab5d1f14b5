"""Stop a search where time is up, whatever it is computing, without a word of it in the solver.

Every evaluation of a fit asks the described axis for its physics. There it is asked, too, whether time is up: the first
time that it is, the search is left; from then on the axis answers again, for what is made of the fits so far.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Generic

from monitor_core.effects.effect import Physics
from monitor_core.errors import MonitorCoreError
from monitor_core.fitting.axis import DescribedAxis


class TimeIsUpError(MonitorCoreError, RuntimeError):
    """A search was left before its end; what it had come to is in its workspace."""


class StoppableAxis(Generic[Physics]):
    """A described axis that leaves a search, once."""

    def __init__(self, axis: DescribedAxis[Physics], time_is_up: Callable[[], bool]) -> None:
        self._axis, self._time_is_up, self._may_stop = axis, time_is_up, False

    @contextmanager
    def stoppable(self) -> Iterator[None]:
        """Leave what is done meanwhile once time is up; what is made of a search that came to its end is not left."""
        self._may_stop = True
        try:
            yield
        finally:
            self._may_stop = False

    @property
    def uncertain(self) -> Mapping[str, float]:
        """As of the axis."""
        return self._axis.uncertain

    def physics(self, ln_ratios: Mapping[str, float]) -> Physics:
        """Return the axis with parameters moved, as the axis does; raises TimeIsUpError where it may stop, once."""
        if self._may_stop and self._time_is_up():
            self._may_stop = False
            raise TimeIsUpError("time was up before the search had come to its end")
        return self._axis.physics(ln_ratios)
