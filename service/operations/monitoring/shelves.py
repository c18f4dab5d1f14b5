"""Bring alarms back whose shelf has ended: an event of each, which receivers are told of like any other."""

from service.clock import now
from service.operations.monitoring.alarm_changes import bring_back
from service.repeatedly import Repeatedly
from service.store import alarms
from service.store.database import Database

#: How often it is looked whether a shelf has ended.
LOOKED_EVERY_S = 2.0


class Shelves:
    """Looks for shelves that have ended, as long as the service runs; of several services, one brings an alarm back."""

    def __init__(self, database: Database) -> None:
        self._database = database
        waits = "an alarm whose shelf has ended"
        self._looking = Repeatedly("shelves", self.end, every_s=LOOKED_EVERY_S, waits=waits)

    def start(self) -> None:
        """Begin to look, first for what ended while no service ran."""
        self._looking.start()

    def close(self) -> None:
        """Look no more."""
        self._looking.close()

    def end(self) -> int:
        """Bring back every alarm whose shelf has ended, and return how many."""
        with self._database.read() as session:
            if not alarms.has_ended_shelves(session, now()):
                return 0
        with self._database.write() as session:
            ended = alarms.take_ended_shelves(session, now())
            for row in ended:
                bring_back(session, row)
        return len(ended)
