"""Bring alarms back whose shelf has ended: an event of each, which receivers are told of like any other."""

import logging
import threading

from service.clock import now
from service.errors import ServiceError
from service.operations.monitoring.alarm_changes import bring_back
from service.store import alarms
from service.store.database import Database

log = logging.getLogger(__name__)

#: How often it is looked whether a shelf has ended.
LOOKED_EVERY_S = 2.0


class Shelves:
    """Looks for shelves that have ended, as long as the service runs; of several services, one brings an alarm back."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="shelves", daemon=True)

    def start(self) -> None:
        """Begin to look, first for what ended while no service ran."""
        self._thread.start()

    def close(self) -> None:
        """Look no more."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()

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

    def _serve(self) -> None:
        while not self._stopping.is_set():
            try:
                self.end()
            except ServiceError as error:
                log.warning("an alarm whose shelf has ended waits: %s", error)
            except Exception:  # the edge of this thread, which must live on
                log.exception("an alarm whose shelf has ended waits")
            self._stopping.wait(LOOKED_EVERY_S)
