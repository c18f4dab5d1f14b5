"""Slow down who guesses: count wrong tries by address and by name, each before what it says is looked at."""

import ipaddress
import threading
from collections import Counter, OrderedDict, defaultdict
from dataclasses import dataclass, field

#: So many may be wrong without a wait, as people are; then 1, 2, 4 … seconds, not more than this.
FREE_TRIES = 5
LONGEST_WAIT_S = 300.0
_MOST_DOUBLINGS = 20  # beyond the longest wait; of any number of tries the power would be no number any more
#: After so long without a wrong try an address is forgotten; of more addresses the one that was quiet longest.
FORGOTTEN_AFTER_S = 3600.0
MOST_ADDRESSES = 10_000
#: From wherever they come: so many tries at one name may be wrong (NIST SP 800-63B-4, section 3.2.2), then one more in
#: so long, as from one address.
FREE_TRIES_AT_A_NAME = 100
_NAME_FORGIVES_S = LONGEST_WAIT_S
#: Names share so many counts, those that nobody has among them, so that the memory is bounded and none is told apart.
_MOST_NAMES = 4096
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

    n_wrong: Counter[str | None] = field(default_factory=Counter)
    last_s: float = 0.0  # when the last one was counted

    def wait_s(self, at_s: float) -> float:
        n_above = self.n_wrong.total() - FREE_TRIES
        if n_above < 0:
            return 0.0
        wait_s = min(2.0 ** min(n_above, _MOST_DOUBLINGS), LONGEST_WAIT_S)
        return max(0.0, self.last_s + wait_s - at_s)


@dataclass(slots=True)
class _TriesAtName:
    """How many tries at a name count as wrong, from all addresses; one less after each time that it forgives."""

    n_wrong: float = 0.0
    at_s: float = 0.0

    def wait_s(self, at_s: float) -> float:
        self.n_wrong = max(0.0, self.n_wrong - (at_s - self.at_s) / _NAME_FORGIVES_S)
        self.at_s = at_s
        return max(0.0, (self.n_wrong - FREE_TRIES_AT_A_NAME + 1) * _NAME_FORGIVES_S)


class LoginThrottle:
    """Delays the tries of an address after wrong ones, whichever names they were at. Times are of one clock.

    A try counts as wrong from its beginning until it is known to be right: any number at once are counted, too. Others
    at other addresses do not wait for it, before very many of them have tried one name; then all wait that come from
    where nobody has logged in by it, since a network of IPv6 has more addresses than there are passwords.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._tries: OrderedDict[str, _Tries] = OrderedDict()  # by host; the one that came last is last
        self._at_names: defaultdict[int, _TriesAtName] = defaultdict(_TriesAtName)

    def is_crowded(self, name: str, *, at_s: float) -> bool:
        """Return whether those wait for a name who are not known where they come from."""
        with self._lock:
            return self._at_name(name).wait_s(at_s) > 0.0

    def _at_name(self, name: str | None) -> _TriesAtName:
        return _TriesAtName() if name is None else self._at_names[hash(name) % _MOST_NAMES]

    def begin(self, address: str, name: str | None, *, at_s: float, is_known: bool = False) -> float:
        """Count a try at a name and return 0; for one that comes too early return how long to wait [s].

        Who is known to have logged in by the name from the address waits for tries from there alone. A key has no name.
        """
        host = host_of(address)
        with self._lock:
            at_name = self._at_name(name)
            wait_for_name_s = at_name.wait_s(at_s)
            tries = self._tries.pop(host, None)
            if tries is None or at_s - tries.last_s > FORGOTTEN_AFTER_S:
                tries = _Tries()
            wait_s = max(tries.wait_s(at_s), 0.0 if is_known else wait_for_name_s)
            tries.n_wrong[name] += 0 if wait_s else 1
            at_name.n_wrong += 0 if wait_s else 1
            if not wait_s:
                tries.last_s = at_s
            self._tries[host] = tries
            while len(self._tries) > MOST_ADDRESSES:
                self._tries.popitem(last=False)
            return wait_s

    def right(self, address: str, name: str | None) -> None:
        """Forget the tries of an address at a name, after a right one; those at other names still count."""
        host = host_of(address)
        with self._lock:
            tries = self._tries.get(host)
            self._at_name(name).n_wrong -= 1.0
            if tries is not None:
                del tries.n_wrong[name]
                if not tries.n_wrong:
                    del self._tries[host]

    def withdraw(self, address: str, name: str) -> None:
        """Take back a try that could not be judged."""
        with self._lock:
            tries = self._tries.get(host_of(address))
            self._at_name(name).n_wrong -= 1.0
            if tries is not None and tries.n_wrong[name] > 0:
                tries.n_wrong[name] -= 1

    def unlock(self, name: str) -> None:
        """Forget all tries at a name, and all of every address that tried it or had to wait with it."""
        with self._lock:
            self._at_names.pop(hash(name) % _MOST_NAMES, None)
            for host in [host for host, tries in self._tries.items() if name in tries.n_wrong]:
                del self._tries[host]
