"""Slow down whoever guesses: each wrong try doubles the wait before the next."""

import threading
from collections import OrderedDict
from dataclasses import dataclass

#: So many may be wrong without a wait, as people are; then 1, 2, 4 … seconds, not more than this.
FREE_TRIES = 5
LONGEST_WAIT_S = 300.0
#: After so long without a wrong try it is forgotten.
_FORGOTTEN_AFTER_S = 3600.0
_MOST_NAMES = 10_000


@dataclass(slots=True)
class _Tries:
    n_wrong: int
    last_s: float


class Patience:
    """Counts wrong tries by what was tried: the name of a user, the address of a caller. Times are of one clock."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._tries: OrderedDict[str, _Tries] = OrderedDict()

    def wait_s(self, *names: str, at_s: float) -> float:
        """Return how long to wait before the next try of any of the names; 0: try now."""
        with self._lock:
            return max((self._wait(name, at_s) for name in names), default=0.0)

    def wrong(self, *names: str, at_s: float) -> None:
        """Note a wrong try."""
        with self._lock:
            for name in names:
                tries = self._tries.pop(name, None)
                known = 0 if tries is None or at_s - tries.last_s > _FORGOTTEN_AFTER_S else tries.n_wrong
                self._tries[name] = _Tries(known + 1, at_s)
            while len(self._tries) > _MOST_NAMES:
                self._tries.popitem(last=False)

    def right(self, *names: str) -> None:
        """Forget the wrong tries of who turned out to be right."""
        with self._lock:
            for name in names:
                self._tries.pop(name, None)

    def _wait(self, name: str, at_s: float) -> float:
        tries = self._tries.get(name)
        if tries is None or tries.n_wrong < FREE_TRIES or at_s - tries.last_s > _FORGOTTEN_AFTER_S:
            return 0.0
        return max(0.0, tries.last_s + min(2.0 ** (tries.n_wrong - FREE_TRIES), LONGEST_WAIT_S) - at_s)
