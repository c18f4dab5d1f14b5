"""How often a healthy axis is alarmed, and how soon a loss is found, on axes whose days depend on each other.

``python -m benchmarks.false_alarms [axes [seed [row …]]]``: so many axes for three years on a learnt baseline in each
row, each false alarm cleared; then how long changes take; then how often the rate that is found on the history of an
axis (``OWN_RATE``) covers the true one, which is that of the year after. The stated rate is one a year. Values are in
standard deviations of a session; losses are positive. ``--ledger FILE`` appends what is found as lines and takes what
is there already from it, so that a run may be broken off and gone on with; ``--workers 1`` is one core; ``--arrays``
takes the charts of :mod:`benchmarks.many_charts` for the false alarms, which are the product's and ten times as fast.

Lubrications come twice: as they move the values alone, and as the product has them, whose windows hold the friction
torque. It rises by a quarter between lubrications and is known to 2 % in a session, as on the medium machine of
:mod:`tests.plant.shop` (1.8 %; 4.6 % on the heavy one).
"""

import argparse
import json
import math
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.many_charts import ManyCharts
from monitor_core.arrays import FloatArray
from monitor_core.trend import (
    DetectorDesign,
    DetectorSettings,
    DetectorState,
    LossDirection,
    Observation,
    design_detector,
    found_rate,
    reset,
    step,
)
from monitor_core.trend.bootstrap import ChartedSession, healthy_sessions
from monitor_core.trend.detector import closed_session

START = datetime(2026, 1, 5, 6, tzinfo=UTC)
DAYS = 365
YEARS = 3
YEAR = 365.25


def charted_sessions(
    observations: Sequence[Observation], design: DetectorDesign, start: DetectorState | None = None
) -> list[ChartedSession]:
    """Return what the charts make of a healthy history, in the order of its time; what raises an alarm is cleared."""
    state, closed = start or DetectorState(), []
    for observation in observations:
        before, state = state, step(state, observation, design)
        closed.append(closed_session(before, state))
        if state.alarm is not None:
            before, state = state, reset(state)
            closed.append(closed_session(before, state))
    closed.append(closed_session(state, DetectorState()))
    return healthy_sessions(item for item in closed if item is not None)


@dataclass(frozen=True, slots=True)
class Day:
    """What is measured on a day."""

    values: tuple[float, ...]
    temperature: float | None = None
    friction_torque: float | None = None
    lubricated: bool = False  # since the day before, by the log


History = Callable[[np.random.Generator, int], list[Day]]


def autoregression(rng: np.random.Generator, days: int, rho: float) -> FloatArray:
    """Return standard normal values of which each remembers the one before."""
    values = rng.standard_normal(days)
    for day in range(1, days):
        values[day] = rho * values[day - 1] + math.sqrt(1.0 - rho**2) * values[day]
    return values


def season(rng: np.random.Generator, days: int) -> FloatArray:
    """Return a sine of a year that begins anywhere."""
    return np.sin(2.0 * np.pi * (np.arange(days) / YEAR + rng.random()))


def saw_tooth(rng: np.random.Generator, days: int, period: int = 90) -> FloatArray:
    """Return what grows from 0 to 1 between lubrications."""
    return ((np.arange(days) + rng.integers(period)) % period) / period


def single(values: FloatArray) -> list[Day]:
    """One measurement a day."""
    return [Day((float(value),)) for value in values]


def repeated(rng: np.random.Generator, shared: FloatArray, count: int, within: float) -> list[Day]:
    """Several measurements of a day share it."""
    return [Day(tuple((day + within * rng.standard_normal(count)).tolist())) for day in shared]


def hours_apart(count: int) -> float:
    """Return how far the measurements of a day are apart: evenly over ten hours, or over the day."""
    return min(24.0 / count, 2.5)


def hourly(rng: np.random.Generator, days: int, count: int, rho: float = 0.95) -> list[Day]:
    """Measure so often a day what remembers the hour before."""
    values, last = np.empty((days, count)), 0.0
    for i, noise in np.ndenumerate(rng.standard_normal((days, count))):
        apart = hours_apart(count) if i[1] else 24.0 - (count - 1) * hours_apart(count)
        kept = rho**apart if i != (0, 0) else 0.0
        values[i] = last = kept * last + math.sqrt(1.0 - kept**2) * noise
    return [Day(tuple(day.tolist())) for day in values]


def shop(rng: np.random.Generator, days: int) -> FloatArray:
    """Draw what follows the day before, the season and the lubrication, with white noise."""
    return (
        0.6 * autoregression(rng, days, 0.5) + 0.8 * season(rng, days)
        + saw_tooth(rng, days) + 0.5 * rng.standard_normal(days)
    )  # fmt: skip


def with_friction(rng: np.random.Generator, days: int, *, told: bool) -> list[Day]:
    """Draw guides as in :mod:`tests.plant.shop`: 15 % from day to day, a quarter more until a lubrication."""
    friction = 0.15 * autoregression(rng, days, 0.9) + 0.25 * saw_tooth(rng, days)
    values = -4.0 * friction + 0.5 * autoregression(rng, days, 0.5) + 0.7 * rng.standard_normal(days)
    torque = friction_torque(rng, 4.0 * friction)
    return [Day((float(v),), None, float(t) if told else None) for v, t in zip(values, torque, strict=True)]


def friction_torque(rng: np.random.Generator, friction: FloatArray, known_to: float = 0.02) -> FloatArray:
    """Return the torque as it is measured, a quarter higher before a lubrication than after it [N·m]."""
    return (0.1 + 0.025 * friction) * (1.0 + known_to * rng.standard_normal(len(friction)))


def lubricated(rng: np.random.Generator, days: int, size: float, known_to: float = 0.02) -> list[Day]:
    """Draw what grows between lubrications with the friction torque, which is measured, and white noise."""
    friction = saw_tooth(rng, days)
    values = rng.standard_normal(days) + size * friction
    torque = friction_torque(rng, friction, known_to)
    return [Day((float(v),), None, float(t)) for v, t in zip(values, torque, strict=True)]


def greased(rng: np.random.Generator, days: int, *, torque: bool = False, log: bool = False) -> list[Day]:
    """Draw fresh grease: friction 30 % higher at once, and a level that differs by one from grease to grease."""
    since = (np.arange(days) + rng.integers(90)) % 90
    levels = rng.standard_normal(days // 90 + 2)[np.cumsum(since == 0)] / math.sqrt(2.0)
    values = rng.standard_normal(days) + levels
    friction = 0.1 * (1.0 + 0.3 * np.exp(-since / 30.0)) * (1.0 + 0.02 * rng.standard_normal(days))
    return [
        Day((float(v),), None, float(f) if torque else None, lubricated=bool(log and s == 0))
        for v, f, s in zip(values, friction, since, strict=True)
    ]


def stated_shop(rng: np.random.Generator, days: int, season_size: float, lubrication: float) -> list[Day]:
    """Draw a shop whose temperature and friction torque are measured."""
    air, friction = season(rng, days), saw_tooth(rng, days)
    values = (
        0.6 * autoregression(rng, days, 0.5) + season_size * air
        + lubrication * friction + 0.5 * rng.standard_normal(days)
    )  # fmt: skip
    temperature = 22.0 + 8.0 * air + 0.5 * rng.standard_normal(days)
    torque = friction_torque(rng, friction)
    return [Day((float(v),), float(t), float(d)) for v, t, d in zip(values, temperature, torque, strict=True)]


ROWS: dict[str, History] = {
    "independent": lambda rng, days: single(rng.standard_normal(days)),
    "Student t3": lambda rng, days: single(rng.standard_t(3, days)),
    "2 % outliers": lambda rng, days: single(rng.standard_normal(days) * np.where(rng.random(days) < 0.02, 8.0, 1.0)),
    "AR(1) 0.1": lambda rng, days: single(autoregression(rng, days, 0.1)),
    "AR(1) 0.3": lambda rng, days: single(autoregression(rng, days, 0.3)),
    "AR(1) 0.5": lambda rng, days: single(autoregression(rng, days, 0.5)),
    "AR(1) 0.7": lambda rng, days: single(autoregression(rng, days, 0.7)),
    "season ± 2": lambda rng, days: single(rng.standard_normal(days) + 2.0 * season(rng, days)),
    "lubrication, 1 up": lambda rng, days: single(rng.standard_normal(days) + saw_tooth(rng, days)),
    "lubrication, 2 up": lambda rng, days: single(rng.standard_normal(days) + 2.0 * saw_tooth(rng, days)),
    "lubrication, 1 down": lambda rng, days: single(rng.standard_normal(days) - saw_tooth(rng, days)),
    "shop": lambda rng, days: single(shop(rng, days)),
    "shop, conditions stated": lambda rng, days: stated_shop(rng, days, 1.6, -2.0),
    "5 a day": lambda rng, days: repeated(rng, rng.standard_normal(days), 5, 1.0),
    "24 a day": lambda rng, days: repeated(rng, rng.standard_normal(days), 24, 1.0),
    "lubrication, 1 up, torque": lambda rng, days: lubricated(rng, days, 1.0),
    "lubrication, 2 up, torque": lambda rng, days: lubricated(rng, days, 2.0),
    "lubrication, 1 down, torque": lambda rng, days: lubricated(rng, days, -1.0),
    "same, torque to 5 %": lambda rng, days: lubricated(rng, days, -1.0, 0.05),
    "shop as above, stated": lambda rng, days: stated_shop(rng, days, 0.8, 1.0),
    "independent, 5 a day": lambda rng, days: repeated(rng, np.zeros(days), 5, 1.0),
    "independent, 24 a day": lambda rng, days: repeated(rng, np.zeros(days), 24, 1.0),
    "shop, 5 a day": lambda rng, days: repeated(rng, shop(rng, days), 5, 0.5),
    "shop, 24 a day": lambda rng, days: repeated(rng, shop(rng, days), 24, 0.5),
    "hourly 0.95": lambda rng, days: hourly(rng, days, 1),
    "hourly 0.95, 5 a day": lambda rng, days: hourly(rng, days, 5),
    "hourly 0.95, 24 a day": lambda rng, days: hourly(rng, days, 24),
    "friction of guides": lambda rng, days: with_friction(rng, days, told=True),
    "friction of guides, untold": lambda rng, days: with_friction(rng, days, told=False),
    "fresh grease, torque measured": lambda rng, days: greased(rng, days, torque=True),
    "fresh grease, logged": lambda rng, days: greased(rng, days, log=True),
    "fresh grease, untold": greased,
}
#: Asks for the last table.
OWN_RATE = "own rate"
CHANGES: dict[str, tuple[str, Callable[[FloatArray], FloatArray]]] = {
    "1 σ step": ("independent", lambda day: 1.0 * (day >= 0)),
    "2 σ step": ("independent", lambda day: 2.0 * (day >= 0)),
    "4 σ step": ("independent", lambda day: 4.0 * (day >= 0)),
    "wear 1/7 σ a day": ("independent", lambda day: np.maximum(day + 1.0, 0.0) / 7.0),
    "2 σ step in the shop": ("shop", lambda day: 2.0 * (day >= 0)),
    "wear 0.15 σ a day in the shop": ("shop", lambda day: 0.15 * np.maximum(day + 1.0, 0.0)),
    "2 σ step in the shop, stated": ("shop as above, stated", lambda day: 2.0 * (day >= 0)),
    # of 300 N, whose sessions scatter by 1 %
    "wear 0.5 N a day": ("independent", lambda day: np.maximum(day + 1.0, 0.0) * 0.5 / 3.0),
    "wear 0.5 N a day in the shop": ("shop", lambda day: np.maximum(day + 1.0, 0.0) * 0.5 / 3.0),
}


@cache
def limits() -> DetectorDesign:
    """Solve the limits: the default ones, for the axis tells how often its sessions come."""
    return design_detector(DetectorSettings(loss=LossDirection.RISE))


def observations(days: list[Day]) -> list[Observation]:
    """Return the measurements of the days with their times."""
    found = []
    for number, day in enumerate(days):
        apart = timedelta(hours=hours_apart(len(day.values)))
        for i, value in enumerate(day.values):
            at = START + timedelta(days=number) + i * apart
            found.append(
                Observation(
                    at, value, temperature=day.temperature, friction_torque=day.friction_torque,
                    lubricated=day.lubricated and i == 0,
                )
            )  # fmt: skip
    return found


def alarms_of(row: str, seed: int, axis: int, years: int = 1) -> list[tuple[int, float]]:
    """Return the false alarms of an axis in each year of its life, and for how much of the year it was watched."""
    rng = np.random.default_rng([2028, seed, list(ROWS).index(row), axis])
    solved, start = limits(), START + timedelta(days=20)
    state, alarms, watched = DetectorState(), [0] * years, [set[int]() for _ in range(years)]
    for observation in observations(ROWS[row](rng, years * DAYS + 20)):
        state = step(state, observation, solved)
        day = (observation.at - start).days
        year = min(max(day, 0) // DAYS, years - 1)
        if state.baseline is not None:
            watched[year].add(day)
        if state.alarm is not None:
            alarms[year] += 1
            state = reset(state)
    return [(count, len(days) / DAYS) for count, days in zip(alarms, watched, strict=True)]


def alarms_of_many(row: str, seed: int, years: int, axes: list[int]) -> list[list[tuple[int, float]]]:
    """Return what :func:`alarms_of` does, of many axes at once."""
    lives = []
    for axis in axes:
        rng = np.random.default_rng([2028, seed, list(ROWS).index(row), axis])
        lives.append([
            (number * 86400.0 + i * hours_apart(len(day.values)) * 3600.0, value, *unless_stated(day), day.lubricated)
            for number, day in enumerate(ROWS[row](rng, years * DAYS + 20)) for i, value in enumerate(day.values)
        ])  # fmt: skip
    measured = np.array(lives).transpose(2, 1, 0)  # time, value, temperature, friction, log; measurement; axis
    charts = ManyCharts(len(axes), limits())
    alarms, watched = np.zeros((years, len(axes)), dtype=int), np.zeros((years * DAYS + 20, len(axes)), dtype=bool)
    for at, *rest in zip(*measured, strict=True):
        day = int(at[0] // 86400.0)
        before = charts.watching.copy()
        alarmed = charts.step(at[0], *rest)
        watched[day] |= charts.watching | (alarmed & before)
        alarms[min(max(day - 20, 0) // DAYS, years - 1)] += alarmed
    of_year = watched.astype(int)
    of_year[20] += of_year[:20].sum(axis=0)  # the days that were watched before the first year begins are of it
    shares = of_year[20:].reshape(years, DAYS, len(axes)).sum(axis=1) / DAYS
    return [list(zip(alarms[:, i].tolist(), shares[:, i].tolist(), strict=True)) for i in range(len(axes))]


def unless_stated(day: Day) -> tuple[float, float]:
    """Return temperature and friction torque; not a number where they are not stated."""
    return (
        math.nan if day.temperature is None else day.temperature,
        math.nan if day.friction_torque is None else day.friction_torque,
    )


def rate_of(found: list[list[tuple[int, float]]]) -> tuple[float, float, float]:
    """Return alarms a year of many axes, half of the 95 % interval, and axis-years."""
    counts = np.array([sum(count for count, _ in axis) for axis in found])
    years = sum(share for axis in found for _, share in axis)
    spread = max(float(counts.var()) / max(float(counts.mean()), 1e-9), 1.0)
    return float(counts.sum()) / years, 1.96 * math.sqrt(max(float(counts.sum()), 1.0) * spread) / years, years


def found_on_history(row: str, seed: int, axis: int) -> tuple[float, float, float, int]:
    """Return the rate that is found on a year of an axis with its interval, and its alarms in the year after."""
    rng, solved = np.random.default_rng([2030, seed, list(ROWS).index(row), axis]), limits()
    measured = observations(ROWS[row](rng, 2 * DAYS + 20))
    end_of_first = START + timedelta(days=DAYS + 20)
    first = [observation for observation in measured if observation.at < end_of_first]
    found = found_rate(charted_sessions(first, solved), solved, np.random.default_rng(axis))
    assert found is not None
    state, alarms = DetectorState(), 0
    for observation in measured:
        state = step(state, observation, solved)
        if state.alarm is not None:
            alarms += observation.at >= end_of_first
            state = reset(state)
    return found.rate, found.interval.lower, found.interval.upper, alarms


def delay_of(change: str, after: int, seed: int, axis: int) -> float:
    """Return how many days after a change the alarm comes; infinite if not within 200, NaN if it was not watched."""
    row, shape = CHANGES[change]
    rng = np.random.default_rng([2029, seed, list(CHANGES).index(change), after, axis])
    days = ROWS[row](rng, after + 200)
    lost = shape(np.arange(after + 200.0) - after)
    changed = [replace(day, values=(day.values[0] + float(lost[i]),)) for i, day in enumerate(days)]
    state, solved = DetectorState(), limits()
    for number, observation in enumerate(observations(changed)):
        if number == after and state.baseline is None:
            return math.nan
        state = step(state, observation, solved)
        if state.alarm is not None:
            if number >= after:
                return number - after + 1.0
            state = reset(state)
    return math.inf


class Ledger:
    """What was found of each axis, in lines: what is there is not found again."""

    def __init__(self, path: Path | None, workers: int) -> None:
        """Read what is there; without a path nothing is kept."""
        self.path, self.workers = path, workers
        lines = path.read_text("utf-8").splitlines() if path is not None and path.exists() else []
        self.found: dict[str, Any] = dict(json.loads(line) for line in lines)

    def of_axes(self, function: Callable[[list[int]], list[Any]], name: str, n_axes: int, together: int) -> list[Any]:
        """Return what a function finds of each axis, of so many at once; the name tells all else it depends on."""
        keys = [f"{name}, axis {axis}" for axis in range(n_axes)]
        missing = [axis for axis, key in enumerate(keys) if key not in self.found]
        parts = [missing[i : i + together] for i in range(0, len(missing), together)]
        with ExitStack() as stack:
            pool = stack.enter_context(ProcessPoolExecutor(self.workers)) if self.workers > 1 else None
            results = map(function, parts) if pool is None else pool.map(function, parts)
            for part, result in zip(parts, results, strict=True):
                new = {keys[axis]: of_axis for axis, of_axis in zip(part, result, strict=True)}
                self.found |= new
                if self.path is not None:
                    with self.path.open("a", encoding="utf-8") as file:
                        file.writelines(f"{json.dumps(line)}\n" for line in new.items())
        return [self.found[key] for key in keys]


def each(function: Callable[[int], Any], axes: list[int]) -> list[Any]:
    """Return what is found of axes one by one."""
    return [function(axis) for axis in axes]


def main(arguments: list[str]) -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description="false alarms of healthy axes, and delays")
    parser.add_argument("axes", type=int, nargs="?", default=300)
    parser.add_argument("seed", type=int, nargs="?", default=500)
    parser.add_argument("rows", nargs="*", default=[*ROWS, *CHANGES, OWN_RATE])
    parser.add_argument("--years", type=int, default=YEARS)
    parser.add_argument("--ledger", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--arrays", action="store_true")
    options = parser.parse_args(arguments)
    n_axes, seed, wanted, years = options.axes, options.seed, options.rows, options.years
    ledger = Ledger(options.ledger, options.workers)
    print("healthy axis                 false alarms a year, stated 1, with 95 % interval, in the years of its life:")
    print(f"{'':29s}{''.join(f'year {year + 1:<10d}' for year in range(years))}all         axis-years")
    for row in [row for row in ROWS if row in wanted]:
        alone = partial(each, partial(alarms_of, row, seed, years=years))
        function, together = (partial(alarms_of_many, row, seed, years), 100) if options.arrays else (alone, 5)
        found = ledger.of_axes(function, f"{row}, seed {seed}, {years} years", n_axes, together)
        by_year = [rate_of([axis[year : year + 1] for axis in found]) for year in range(years)]
        said = "  ".join(f"{rate:5.2f} ± {half:.2f}" for rate, half, _ in (*by_year, rate_of(found)))
        print(f"{row:28s}{said}  {rate_of(found)[2]:5.0f}", flush=True)
    print("\nchange after a baseline of  days: median, mean, nine of ten; not within 200 days")
    for change, after in [(change, after) for change in CHANGES for after in (20, 100) if change in wanted]:
        name = f"{change} after {after}, seed {seed}"
        delays = np.array(ledger.of_axes(partial(each, partial(delay_of, change, after, seed)), name, n_axes, 5))
        seen = delays[~np.isnan(delays)]
        alarmed = seen[np.isfinite(seen)]
        late = float(np.quantile(seen, 0.9, method="higher"))
        print(
            f"{change:31s}{after:4d} d  {np.median(seen):5.0f} {alarmed.mean():6.1f} "
            f"{late:5.0f}  {np.mean(np.isinf(seen)):6.1%}",
            flush=True,
        )
    if OWN_RATE in wanted:
        print("\nfound on the history of each axis: median, covers the rate of the year after")
        for row in [row for row in ROWS if row in wanted or wanted == [OWN_RATE]]:
            name = f"own rate, {row}, seed {seed}"
            own = np.array(ledger.of_axes(partial(each, partial(found_on_history, row, seed)), name, n_axes, 5))
            truth = own[:, 3].mean()
            covered = np.mean((own[:, 1] <= truth) & (truth <= own[:, 2]))
            print(f"{row:28s}{np.median(own[:, 0]):5.2f}  {truth:5.2f}  {covered:6.1%}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
