"""Alarms of an axis in a shop, healthy and wearing, on the independent plant.

``python -m benchmarks.shop_wear [axes [first seed [days]]]``, a minute an axis and 120 days: the machines of
:mod:`tests.plant.shop`, each calibrated once, live in the shop of :mod:`benchmarks.shop_year`, five places a day. Every
measurement goes the way of the product, from window to chart; an alarm is cleared, as a person does. First healthy
axes: false alarms a year, in a shop that mounts the nut anew every month, which changes its stiffness by 0.3 %, and in
one that does not. Then axes that are healthy for 60 days and lose 0.5 N a day from then on, where nothing is mounted
anew: the newtons that are lost on the day of the first alarm.
"""

import math
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np

from benchmarks.honest_intervals import SETTINGS
from monitor_core.axis_state import AxisState, advance
from monitor_core.session import calibrate_session, judge_session
from monitor_core.trend import DetectorSettings, LossDirection, design_detector, reset
from tests.plant.shop import MACHINES, ShopYear, calibration_session, shop_year

HEALTHY, BASELINE = 60, 20  # days
NEWTONS_A_DAY = 0.5
MEASUREMENTS_A_DAY = 5


def alarms(name: str, days: int, newtons_a_day: float, year: ShopYear, seed: int) -> list[int]:
    """Return the days on which an axis is alarmed that loses preload after the healthy days."""
    machine = MACHINES[name]
    calibration = calibrate_session(calibration_session(machine, np.random.default_rng([2034, seed])), SETTINGS)
    settings = DetectorSettings(measurements_per_year=365.0 * MEASUREMENTS_A_DAY, loss=LossDirection.RISE)
    design, state, found = design_detector(settings), AxisState(), list[int]()
    lost = newtons_a_day * np.maximum(np.arange(days) - HEALTHY, 0.0)
    for day, recorded in enumerate(shop_year(machine, np.random.default_rng([2035, seed]), days, year, lost)):
        for measured in judge_session(recorded.session, SETTINGS, calibration):
            at = recorded.session.windows_of(measured.name)[0].started_at
            state = advance(state, measured.outcome, at, calibration=calibration, design=design)
            if state.detector.alarm is not None:
                found.append(day)
                state = AxisState(reset(state.detector), state.baseline_conditions)
    return found


def main(arguments: list[str]) -> None:
    """Print false alarms of healthy axes and losses of wearing ones, of each machine."""
    axes, seed, days = (int(a) for a in (arguments + ["10", "800", "120"][len(arguments) :])[:3])
    with ProcessPoolExecutor(2) as pool:
        for name in MACHINES:
            for said, year in (("mounted anew", ShopYear()), ("left alone", ShopYear(mounting=0.0))):
                found = list(pool.map(partial(alarms, name, days, 0.0, year), range(seed, seed + axes)))
                years = axes * (days - BASELINE) / 365.0
                count = sum(map(len, found))
                half = 1.96 * math.sqrt(max(count, 1)) / years
                print(
                    f"{name:8s} healthy, {said:13s} {count / years:4.1f} ± {half:.1f} false alarms a year", flush=True
                )
            wearing = partial(alarms, name, HEALTHY + 60, NEWTONS_A_DAY, ShopYear(mounting=0.0))
            first = [
                next((d for d in found if d > HEALTHY), math.inf)
                for found in pool.map(wearing, range(seed, seed + axes))
            ]
            lost = NEWTONS_A_DAY * (np.sort(first) - HEALTHY)
            print(f"{name:8s} {NEWTONS_A_DAY:g} N a day: alarmed after {lost.tolist()} N", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
