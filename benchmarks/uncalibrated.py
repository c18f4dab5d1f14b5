"""How often a healthy axis is alarmed without a calibration, and how soon a loss is found compared with one.

``python -m benchmarks.uncalibrated [axes [seed [row …]]]``: so many axes for a year each on a learnt baseline, each
false alarm cleared. The stated rate is one a year. Then the delay of a sudden loss, beside that of charts that know the
law of position as nearly as Eq. (8) can have it. The machine is a screw between two ends with a mass on it, drawn anew
for each axis; it shares no formula with the product.
"""

import math
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import cache, partial

import numpy as np

from monitor_core.axis_state import AxisState, ChartedFeature, advance_feature
from monitor_core.recording import Conditions
from monitor_core.trend import DetectorDesign, DetectorSettings, LossDirection, design_detector, reset
from monitor_core.uncertainty import Estimate

START = datetime(2026, 1, 5, 6, tzinfo=UTC)
DAYS, BASELINE = 365, 20
#: Scatter of a session and of a measurement of 1/f², relative.
OF_DAY, OF_MEASUREMENT = 4e-4, 2e-4

Places = Callable[[np.random.Generator, int], list[float]]
#: Where the table is measured on a day, in shares of the travel.
ROWS: dict[str, Places] = {
    "three places a day": lambda rng, day: rng.uniform(0.1, 0.9, 3).tolist(),
    "two places a day": lambda rng, day: rng.uniform(0.1, 0.9, 2).tolist(),
    "the same three places": lambda rng, day: [0.2, 0.5, 0.8],
    "one place a day, anywhere": lambda rng, day: rng.uniform(0.1, 0.9, 1).tolist(),
    "two places in turns": lambda rng, day: [0.3 if day % 2 else 0.7],
}


@dataclass(frozen=True, slots=True)
class Machine:
    """A mass on a screw between an end that holds and one that holds less."""

    length: float  # [m]
    frequency: float  # of the mode with a rigid screw [Hz]
    of_screw: float  # largest share that the screw adds to 1/f²
    far_end: float  # share of the near end's compliance that the far one has, 1 where alike
    bends: float  # share of 1/f² that no square of the position has

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Machine":
        """Draw a machine."""
        return cls(
            rng.uniform(0.6, 2.0), rng.uniform(60.0, 250.0), rng.uniform(0.1, 0.6), rng.uniform(1.0, 3.0),
            rng.uniform(-3e-4, 3e-4),
        )  # fmt: skip

    def inverse_square(self, share: float) -> float:
        """Return 1/f² at a share of the travel [s²]."""
        springs = 1.0 / (0.25 + share) + self.far_end / (1.25 - share)
        relative = 1.0 + self.of_screw * 4.0 / springs / 3.0 + self.bends * math.sin(9.0 * share)
        return relative / self.frequency**2

    def nearest(self, share: float) -> float:
        """Return what the nearest square of the position says, as a calibration of many places would [s²]."""
        places = np.linspace(0.1, 0.9, 41)
        return float(np.polyval(np.polyfit(places, [self.inverse_square(x) for x in places], 2), share))


@cache
def limits() -> DetectorDesign:
    """Solve the limits."""
    return design_detector(DetectorSettings(loss=LossDirection.RISE))


@dataclass(slots=True)
class Axis:
    """An axis on its way, measured day by day."""

    row: str
    rng: np.random.Generator
    machine: Machine
    knows: bool = False  # the law of position, as nearly as Eq. (8) has it
    state: AxisState = field(default_factory=AxisState)

    @classmethod
    def drawn(cls, row: str, rng: np.random.Generator, *, knows: bool = False) -> "Axis":
        """Draw an axis."""
        return cls(row, rng, Machine.drawn(rng), knows)

    def measure(self, day: int, lost: float = 0.0) -> bool:
        """Measure on a day; return whether an alarm stands."""
        of_day = 1.0 + lost + OF_DAY * self.rng.standard_normal()
        for number, share in enumerate(ROWS[self.row](self.rng, day)):
            law = self.machine.inverse_square(share)
            value = law * (of_day + OF_MEASUREMENT * self.rng.standard_normal())
            place = Conditions(self.machine.length * share)
            if self.knows:
                value *= self.machine.inverse_square(0.5) / self.machine.nearest(share)
                place = Conditions(0.5 * self.machine.length)
            at = START + timedelta(days=day, minutes=10 * number)
            charted = ChartedFeature(at, Estimate(value, OF_MEASUREMENT * value), place)
            self.state = advance_feature(self.state, charted, calibration=None, design=limits())
        return self.state.detector.alarm is not None

    def clear(self) -> None:
        """Let somebody find the axis in order."""
        self.state = AxisState(reset(self.state.detector), law=self.state.law)


def alarms_of(row: str, seed: int, axis: int) -> tuple[int, float]:
    """Return the false alarms of an axis, and for how much of the year it was watched."""
    measured = Axis.drawn(row, np.random.default_rng([2031, seed, list(ROWS).index(row), axis]))
    alarms = watched = 0
    for day in range(DAYS + BASELINE):
        alarmed = measured.measure(day)
        watched += measured.state.detector.baseline is not None
        if alarmed:
            alarms += 1
            measured.clear()
    return alarms, watched / DAYS


def delay_of(row: str, loss: float, seed: int, axis: int, *, knows: bool) -> float:
    """Return after how many sessions a loss is alarmed that begins at day 40; NaN after a false alarm."""
    measured = Axis.drawn(row, np.random.default_rng([2032, seed, list(ROWS).index(row), axis]), knows=knows)
    for day in range(140):
        if measured.measure(day, loss if day >= 40 else 0.0):
            return day - 39.0 if day >= 40 else math.nan
    return 100.0


def main(arguments: list[str]) -> None:
    """Print both tables."""
    n_axes, seed = (int(a) for a in (arguments + ["220", "700"][len(arguments) :])[:2])
    wanted = arguments[2:] or list(ROWS)
    with ProcessPoolExecutor(2) as pool:
        print("healthy axis                 false alarms a year, stated 1, with 95 % interval; axis-years")
        for row in wanted:
            found = list(pool.map(partial(alarms_of, row, seed), range(n_axes), chunksize=5))
            counts, years = np.array([count for count, _ in found]), sum(share for _, share in found)
            spread = max(float(counts.var()) / max(float(counts.mean()), 1e-9), 1.0)
            half = 1.96 * math.sqrt(max(float(counts.sum()), 1.0) * spread) / years
            print(f"{row:28s}{counts.sum() / years:5.2f} ± {half:.2f}  {years:5.0f}", flush=True)
        print("\nloss of 2 and 4 standard deviations of a session: mean sessions to the alarm, and with the law known")
        for row in wanted:
            for size in (2.0, 4.0):
                delays = [
                    np.array(list(pool.map(partial(delay_of, row, size * OF_DAY, seed, knows=knows), range(60))))
                    for knows in (False, True)
                ]
                own, known = (float(np.nanmean(each)) for each in delays)
                print(f"{row:28s}{size:3.0f} σ  {own:5.1f}  {known:5.1f}  {own / known:5.2f} x", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
