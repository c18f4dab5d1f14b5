"""Hold of each axis between two requests what is known, so that it is read and checked once, and its lane.

In its lane the windows of an axis are looked at one request after another, in order.
"""

import threading
from weakref import WeakValueDictionary

from sqlalchemy import Connection

from monitor_core.preload import Calibration
from service.json_types import JsonObject
from service.operations.monitoring.axis_configuration import AxisConfiguration, load_configuration
from service.store.calibrations import CalibrationsInForce
from service.store.intake import AxisRecord


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


#: Of axes; then all are forgotten, and those that send are read again.
MOST_KNOWN = 5000


class KnownAxes:
    """Remembers the configuration and the calibration of each axis for as long as its row says the same."""

    def __init__(self) -> None:
        self._calibrations = CalibrationsInForce()
        self._configurations: dict[str, tuple[JsonObject, AxisConfiguration]] = {}

    def calibration_of(self, connection: Connection, axis: AxisRecord) -> Calibration | None:
        """Return the calibration in force on an axis."""
        return self._calibrations.of(connection, axis)

    def configuration_of(self, axis: AxisRecord) -> AxisConfiguration:
        """Return the configuration of an axis; raises DocumentDamagedError if it cannot be read."""
        known = self._configurations.get(axis.id)
        if known is None or known[0] != axis.configuration:
            known = axis.configuration, load_configuration(axis.configuration)
            if len(self._configurations) >= MOST_KNOWN:
                self._configurations.clear()
            self._configurations[axis.id] = known
        return known[1]
