"""Axes in every state that a page can begin with, made once by a real service and copied for tests.

Each axis is called by its state. What was measured of ``long`` was written as the service would have written it.
"""

from datetime import timedelta
from pathlib import Path
from zlib import crc32

import numpy as np

from monitor_core.recording import Window
from tests.service.conftest import START, Api, running_service, simulated_measurement
from tests.service.long_history import lengthen

#: Four windows a measurement, a baseline of eight sessions on eight days: an axis is learnt in a second.
CONFIGURATION = {"windows_per_measurement": 4, "silent_after_hours": 1e6, "baseline_size": 8, "baseline_days": 4}
HEALTHY, TOO_HIGH, WORN = 300.0, 310.0, 180.0
N_LONG = 12_000
#: No axis of this name is registered.
MISSING = "missing"
STATES = ("uncalibrated", "never-measured", "learning", "normal", "alert", "alarm", "acknowledged", "silent", "cleared")


def measurement(axis: str, number: int, preload: float = HEALTHY) -> list[Window]:
    """Windows of the measurement of a day."""
    rng = np.random.default_rng(crc32(f"{axis} {number}".encode()))
    started_at = START + timedelta(days=number)
    return simulated_measurement(rng, f"day-{number}", preload=preload, started_at=started_at, n_windows=4)


def measure(api: Api, axis: str, numbers: range, preload: float = HEALTHY) -> None:
    """Measure an axis on these days."""
    for number in numbers:
        api.accept(axis, measurement(axis, number, preload))


def learn(api: Api, axis: str) -> None:
    """Register an axis, calibrate it, and measure it until its baseline is learnt."""
    api.register(axis, **CONFIGURATION)
    api.calibrate(axis)
    measure(api, axis, range(9))


def _wear(api: Api, axis: str) -> int:
    """Measure a worn axis until it alarms, and return the number of the alarm."""
    measure(api, axis, range(9, 13), WORN)
    (alarm,) = api.http.get("/v1/alarms", params={"axis": axis}).json()["alarms"]
    return int(alarm["id"])


def say(api: Api, alarm: int, verb: str, comment: str) -> None:
    """Acknowledge or clear an alarm."""
    api.http.post(f"/v1/alarms/{alarm}/{verb}", json={"comment": comment}).raise_for_status()


def build(folder: Path) -> None:
    """Make the data folder of a service that knows an axis in each state."""
    with running_service(folder) as api:
        api.register("uncalibrated", **CONFIGURATION)
        api.register("never-measured", **CONFIGURATION)
        api.calibrate("never-measured")
        api.register("learning", **CONFIGURATION)
        api.calibrate("learning")
        measure(api, "learning", range(3))
        for axis in ("normal", "alert", "alarm", "acknowledged", "silent", "cleared", "long"):
            learn(api, axis)
        measure(api, "alert", range(9, 12), TOO_HIGH)
        _wear(api, "alarm")
        say(api, _wear(api, "acknowledged"), "acknowledge", "nut is ordered")
        say(api, _wear(api, "cleared"), "clear", "nut was tightened")
        api.register("silent", **CONFIGURATION | {"silent_after_hours": 1.0})
    lengthen(folder, "long", N_LONG, every=timedelta(hours=1))
