"""What is known of axes between two requests, so that it is read and checked once and not for each window."""

from sqlalchemy import Connection

from monitor_core.preload import Calibration
from service.json_types import JsonObject
from service.operations.monitoring.axis_configuration import AxisConfiguration, load_configuration
from service.store.calibrations import CalibrationsInForce
from service.store.intake import AxisRecord

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
