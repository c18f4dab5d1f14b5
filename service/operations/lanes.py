"""One lane per axis: its windows are looked at one request after another, in order."""

import threading
from collections import defaultdict
from threading import Lock


class Lanes:
    """Locks by axis. They order work inside one process; the database keeps several processes apart."""

    def __init__(self) -> None:
        self._locks: defaultdict[str, Lock] = defaultdict(threading.Lock)
        self._guard = threading.Lock()

    def of(self, axis_id: str) -> Lock:
        """Return the lane of an axis, to be used in a ``with`` statement."""
        with self._guard:
            return self._locks[axis_id]
