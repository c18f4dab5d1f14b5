"""How many newtons a wearing axis has lost in a shop when it is alarmed, on the independent plant.

``python -m benchmarks.shop_wear [axes [first seed [newtons a day]]]``, a minute an axis: both machines of
:mod:`tests.plant.shop`, each calibrated once, live in the shop of :mod:`benchmarks.shop_year`, five places a day. They
are healthy for 60 days and lose 0.5 N a day from then on. Every measurement goes the way of the product, from window to
chart. Printed are the newtons that are lost on the day of the alarm; a false alarm before is cleared, as a person does.
"""

import math
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np

from benchmarks.honest_intervals import SETTINGS
from monitor_core.pipeline import AxisState, advance
from monitor_core.session import calibrate_session, judge_session
from monitor_core.trend import DetectorSettings, LossDirection, design_detector, reset
from tests.plant.shop import MACHINES, calibration_session, shop_year

HEALTHY, WATCHED = 60, 60  # days
MEASUREMENTS_A_DAY = 5


def lost_at_alarm(name: str, newtons_a_day: float, seed: int) -> tuple[float, int]:
    """Return the newtons that an axis has lost when it is alarmed, infinite if it is not; and its false alarms."""
    machine = MACHINES[name]
    calibration = calibrate_session(calibration_session(machine, np.random.default_rng([2034, seed])), SETTINGS)
    settings = DetectorSettings(measurements_per_year=365.0 * MEASUREMENTS_A_DAY, loss=LossDirection.RISE)
    design, state, false_alarms = design_detector(settings), AxisState(), 0
    lost = newtons_a_day * np.maximum(np.arange(HEALTHY + WATCHED) - HEALTHY, 0.0)
    for day, recorded in enumerate(
        shop_year(machine, np.random.default_rng([2035, seed]), HEALTHY + WATCHED, lost=lost)
    ):
        for measured in judge_session(recorded.session, SETTINGS, calibration):
            at = recorded.session.windows_of(measured.name)[0].started_at
            state = advance(state, measured.outcome, at, calibration=calibration, design=design)
        if state.detector.alarm is not None and day >= HEALTHY:
            return float(lost[day]), false_alarms
        if state.detector.alarm is not None:
            false_alarms, state = false_alarms + 1, AxisState(reset(state.detector), state.baseline_conditions)
    return math.inf, false_alarms


def main(arguments: list[str]) -> None:
    """Print what was lost at the alarm, of each machine."""
    axes, seed = (int(a) for a in (arguments + ["10", "800"][len(arguments) :])[:2])
    newtons_a_day = float(arguments[2]) if len(arguments) > 2 else 0.5
    print(f"{newtons_a_day:g} N a day after {HEALTHY} healthy days: newtons lost at the alarm")
    with ProcessPoolExecutor(2) as pool:
        for name in MACHINES:
            found = list(pool.map(partial(lost_at_alarm, name, newtons_a_day), range(seed, seed + axes)))
            lost = np.sort([newtons for newtons, _ in found])
            print(
                f"{name:8s} median {np.median(lost):.1f}, at most {lost[-1]:.1f}: {lost.tolist()}; "
                f"false alarms in {HEALTHY} days: {sum(count for _, count in found)} of {axes} axes",
                flush=True,
            )


if __name__ == "__main__":
    main(sys.argv[1:])
