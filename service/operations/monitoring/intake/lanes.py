"""One lane per axis: its windows are looked at one request after another, in order."""

import threading
from weakref import WeakValueDictionary


class Lanes:
    """Locks by axis. They order work inside one process; the database keeps several processes apart."""

    def __init__(self) -> None:
        # Weak: a lane lives as long as somebody is in it or waits for it, so names nobody registered leave nothing.
        self._locks: WeakValueDictionary[str, threading.Lock] = WeakValueDictionary()
        self._guard = threading.Lock()

    def of(self, axis_id: str) -> threading.Lock:
        """Return the lane of an axis, to be used in a ``with`` statement."""
        with self._guard:
            lane = self._locks.get(axis_id)
            if lane is None:
                lane = self._locks[axis_id] = threading.Lock()
            return lane
