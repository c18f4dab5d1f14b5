"""Slow down who guesses: count wrong tries by address and name, each before what it says is looked at."""

import ipaddress
import threading
from collections import Counter, OrderedDict
from dataclasses import dataclass, field

#: So many may be wrong without a wait, as people are; then 1, 2, 4 … seconds, not more than this.
FREE_TRIES = 5
LONGEST_WAIT_S = 300.0
_MOST_DOUBLINGS = 20  # beyond the longest wait; of any number of tries the power would be no number any more
#: After so long without a wrong try an address is forgotten; of more addresses the one that was quiet longest.
FORGOTTEN_AFTER_S = 3600.0
MOST_ADDRESSES = 10_000
#: Whoever has one address of IPv6 has all that share so many bits with it.
_BITS_OF_A_HOST = 64


def host_of(address: str) -> str:
    """Return what is counted as one: an address of IPv4, or the network that a host of IPv6 may choose its own from.

    Examples
    --------
    >>> host_of("2001:db8:1:2:aaaa::1"), host_of("::ffff:192.0.2.7")
    ('2001:db8:1:2::/64', '192.0.2.7')
    """
    try:
        parsed = ipaddress.ip_address(address)
    except ValueError:
        return address[:45]  # as long as an address can be
    if isinstance(parsed, ipaddress.IPv4Address):
        return str(parsed)
    if parsed.ipv4_mapped is not None:
        return str(parsed.ipv4_mapped)
    return str(ipaddress.ip_network((int(parsed), _BITS_OF_A_HOST), strict=False))


@dataclass(slots=True)
class _Tries:
    """What came from one address: how many tries at each name count as wrong; 0: it only had to wait."""

    n_wrong: Counter[str] = field(default_factory=Counter)
    last_s: float = 0.0  # when the last one was counted

    def wait_s(self, at_s: float) -> float:
        n_above = self.n_wrong.total() - FREE_TRIES
        if n_above < 0:
            return 0.0
        wait_s = min(2.0 ** min(n_above, _MOST_DOUBLINGS), LONGEST_WAIT_S)
        return max(0.0, self.last_s + wait_s - at_s)


class LoginThrottle:
    """Delays the tries of an address after wrong ones, whichever names they were at. Times are of one clock.

    A try counts as wrong from its beginning until it is known to be right: any number at once are counted, too. Others
    at other addresses never wait for it.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._tries: OrderedDict[str, _Tries] = OrderedDict()  # by host; the one that came last is last

    def begin(self, address: str, name: str, *, at_s: float) -> float:
        """Count a try at a name and return 0; for one that comes too early return how long to wait [s]."""
        host = host_of(address)
        with self._lock:
            tries = self._tries.pop(host, None)
            if tries is None or at_s - tries.last_s > FORGOTTEN_AFTER_S:
                tries = _Tries()
            wait_s = tries.wait_s(at_s)
            tries.n_wrong[name] += 0 if wait_s else 1
            if not wait_s:
                tries.last_s = at_s
            self._tries[host] = tries
            while len(self._tries) > MOST_ADDRESSES:
                self._tries.popitem(last=False)
            return wait_s

    def right(self, address: str, name: str) -> None:
        """Forget the tries of an address at a name, after a right one; those at other names still count."""
        host = host_of(address)
        with self._lock:
            tries = self._tries.get(host)
            if tries is not None:
                del tries.n_wrong[name]
                if not tries.n_wrong:
                    del self._tries[host]

    def withdraw(self, address: str, name: str) -> None:
        """Take back a try that could not be judged."""
        with self._lock:
            tries = self._tries.get(host_of(address))
            if tries is not None and tries.n_wrong[name] > 0:
                tries.n_wrong[name] -= 1

    def unlock(self, name: str) -> None:
        """Forget all tries of every address that tried a name, or had to wait with it."""
        with self._lock:
            for host in [host for host, tries in self._tries.items() if name in tries.n_wrong]:
                del self._tries[host]
