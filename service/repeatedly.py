"""Do something every so often in a thread of its own, until the service stops."""

import logging
import threading
from collections.abc import Callable

from service.errors import ServiceError

log = logging.getLogger(__name__)


class Repeatedly:
    """Does something at once and then after every pause. What fails is logged as waiting, and tried again."""

    def __init__(self, name: str, act: Callable[[], object], *, every_s: float, waits: str) -> None:
        self._act = act
        self._every_s = every_s
        self._waits = waits  # what waits where it fails
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def close(self) -> None:
        """Do it no more; what is under way is ended first."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()

    def _serve(self) -> None:
        while not self._stopping.is_set():
            try:
                self._act()
            except ServiceError as error:
                log.warning("%s waits: %s", self._waits, error)
            except Exception:  # the edge of this thread, which must live on
                log.exception("%s waits", self._waits)
            self._stopping.wait(self._every_s)
