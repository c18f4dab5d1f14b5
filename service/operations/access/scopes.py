"""What a caller may do, and who it is."""

from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from service.store.access import ADMINISTRATOR


class Scope(StrEnum):
    """One kind of thing that may be done. No scope holds another, except that administrators have all."""

    WINDOWS_WRITE = "windows:write"
    TRENDS_READ = "trends:read"
    CALIBRATIONS_WRITE = "calibrations:write"
    ALARMS_ACK = "alarms:ack"
    REPLAYS_RUN = "replays:run"
    ADMIN = "admin"


EVERYTHING = frozenset(Scope)
_READING = frozenset({Scope.TRENDS_READ})
_OPERATING = _READING | {Scope.ALARMS_ACK, Scope.REPLAYS_RUN}

#: What people may do, by their role.
ROLES = MappingProxyType(
    {
        "viewer": _READING,
        "operator": _OPERATING,
        "engineer": _OPERATING | {Scope.WINDOWS_WRITE, Scope.CALIBRATIONS_WRITE},
        ADMINISTRATOR: EVERYTHING,
    }
)


@dataclass(frozen=True, slots=True)
class Caller:
    """Who asks, and what of it is allowed."""

    name: str  # as the log of changes has it: "user anna", "key 3 (press line)"
    scopes: frozenset[Scope]
    axes: frozenset[str] | None = None  # None: all
    user: str | None = None  # who is logged in, in a browser
    is_anyone: bool = False  # nobody has to say who it is: nothing is closed yet

    @property
    def signature(self) -> str:
        """Who it is, for what people read."""
        return self.user or self.name


#: Before there is an administrator, on this machine.
ANYONE = Caller("anyone on this machine", EVERYTHING, is_anyone=True)
