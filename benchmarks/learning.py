"""How often a healthy axis is said to fall while its baseline is learnt, and how often one that does.

``python -m benchmarks.learning [axes [seed [row …]]]``: so many axes in each row, from their first measurement until
the baseline is learnt. Then the same axes with a loss that goes on from the first day and reaches 13 % of the preload
in the twentieth session: how many are said to fall by then, and the median of the session. The rows of
:mod:`benchmarks.false_alarms` have a scatter of about one, of which 6.5 are taken for 13 %: 2 % of the preload. Those
of a machine are natural frequencies of the chain of :mod:`tests.plant` at five places, in the shop of
:mod:`tests.plant.shop` from any day of the year on, and scatter as :data:`SCATTER` of its preload does.

``python -m benchmarks.learning tests [axes [seed]]`` compares the rule with a Mann–Kendall test and with the t of the
regression on time, each looked at from the fifth session on, at the limits that let all of them say it of the same
share of healthy axes.
"""

import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import timedelta
from functools import cache, partial

import numpy as np

from benchmarks.false_alarms import ROWS as DAYS, START, Day, autoregression, limits, observations
from monitor_core.arrays import FloatArray
from monitor_core.trend import DetectorState, Observation, Prior, prior_from, step
from monitor_core.trend.learning import FEWEST, weigh_fall
from monitor_core.trend.observation import sessions_of
from tests.plant.chain import natural_frequency
from tests.plant.shop import MACHINES, ShopYear

N_SESSIONS = 20
LOSS = 0.13  # of the preload, reached in the last session
SIGMAS = 6.5  # what that is where values are in standard deviations of a session
SCATTER = 0.015  # of the preload, between sessions: 1.0 to 1.8 % in a shop (benchmarks.shop_year)

#: Scatter of sessions, of variance 1.
NOISE: dict[str, Callable[[np.random.Generator, int], FloatArray]] = {
    "normal": lambda rng, n: rng.standard_normal(n),
    "Student t3": lambda rng, n: rng.standard_t(3, n) / math.sqrt(3.0),
    "2 % outliers": lambda rng, n: rng.standard_normal(n) * np.where(rng.random(n) < 0.02, 6.0, 1.0) / 1.3,
    "skewed": lambda rng, n: rng.exponential(1.0, n) - 1.0,
    "AR(1) 0.5": lambda rng, n: autoregression(rng, n, 0.5),
}


@cache
def responses(name: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return 1/f² of a machine, mean of five places, over ln P/P₀ and temperature [s²]."""
    machine = MACHINES[name]
    places, lost = np.array(machine.positions(5)), np.linspace(-0.2, 0.05, 6)
    temperatures = np.array([5.0, 20.0, 35.0])
    preload = machine.healthy * np.exp(lost)
    frequency = natural_frequency(
        places[:, None, None], preload[None, :, None], 0.0, temperatures[None, None, :], axis=machine.plant.axis
    )
    return lost, temperatures, np.asarray((frequency**-2.0).mean(axis=0))


def machine_days(
    rng: np.random.Generator, count: int, loss: float, *, name: str, noise: str, thermometer: bool
) -> list[Day]:
    """Draw the first days of a machine in a shop, of which nobody has calibrated the frequency."""
    lost, temperatures, inverse = responses(name)
    first = int(rng.integers(365 - count))
    air, structure = (each[first : first + count] for each in ShopYear().air(rng, 365))
    told = np.round(air + rng.standard_normal(), 1)
    gone = np.log1p(-loss * np.arange(count) / (N_SESSIONS - 1)) + SCATTER * NOISE[noise](rng, count)
    # at each temperature over the preload, then between temperatures
    rows = np.stack([np.interp(gone, lost, inverse[:, i]) for i in range(len(temperatures))])
    values = [float(np.interp(structure[day], temperatures, rows[:, day])) for day in range(count)]
    return [Day((value,), float(t) if thermometer else None) for value, t in zip(values, told, strict=True)]


def in_sigmas(rng: np.random.Generator, count: int, loss: float, *, row: str) -> list[Day]:
    """Draw the first days of an axis of another benchmark."""
    lost = loss / LOSS * SIGMAS * np.arange(count) / (N_SESSIONS - 1)
    days = DAYS[row](rng, count)
    return [
        replace(day, values=tuple(value + float(more) for value in day.values))
        for day, more in zip(days, lost, strict=True)
    ]


Row = Callable[[np.random.Generator, int, float], list[Day]]
OF_SIGMAS = (
    "independent", "Student t3", "2 % outliers", "AR(1) 0.3", "AR(1) 0.5", "AR(1) 0.7", "season ± 2", "shop",
    "lubrication, 2 up", "lubrication, 2 up, torque", "shop, conditions stated", "shop, 5 a day",
    "hourly 0.95, 5 a day", "hourly 0.95, 24 a day", "friction of guides", "friction of guides, untold",
)  # fmt: skip
ROWS: dict[str, Row] = {
    **{row: partial(in_sigmas, row=row) for row in OF_SIGMAS},
    **{
        f"{name}, {noise}, {'thermometer' if told else 'no thermometer'}": partial(
            machine_days, name=name, noise=noise, thermometer=told
        )
        for name in MACHINES
        for noise in NOISE
        for told in (True, False)
    },
}
#: Rows whose axes have had three sisters for as many days before.
WITH_SISTERS = ("shop, conditions stated", "hourly 0.95, 5 a day", "medium, normal, thermometer")
DAYS_OF_SISTERS, SISTERS = 60, ", sisters"


def lent(row: str, rng: np.random.Generator) -> Prior:
    """Return what three healthy axes of a row teach."""
    beliefs = []
    for _ in range(3):
        state = DetectorState()
        for observation in observations(ROWS[row](rng, DAYS_OF_SISTERS, 0.0)):
            state = step(state, observation, limits())
        beliefs += [] if state.learnt is None else [state.learnt]
    return prior_from(beliefs)


def said_at(row: str, loss: float, seed: int, axis: int, *, sisters: bool = False) -> float:
    """Return the session in which an axis is said to fall while it is learnt; infinite if it never is."""
    rng = np.random.default_rng([2036, seed, list(ROWS).index(row), axis])
    state = DetectorState(prior=lent(row, rng) if sisters else None)
    for observation in first_sessions(ROWS[row](rng, N_SESSIONS + 4, loss)):
        state = step(state, observation, limits())
        if state.alarm is not None:
            return float(len(state.learning) + 1)
        if state.baseline is not None:
            break
    return math.inf


def first_sessions(days: list[Day]) -> Iterator[Observation]:
    """Yield the measurements of the sessions that make a baseline."""
    began, count = START - timedelta(days=1), 0
    for observation in observations(days):
        if observation.at - began >= timedelta(hours=20):
            began, count = observation.at, count + 1
        if count > N_SESSIONS:
            return
        yield observation


def compare(n_axes: int, seed: int) -> None:
    """Print the share of falling axes that each test finds by the twentieth session, at equal false shares."""
    print("said by session 20 of 6.5 σ, 4.5 σ, at the limit that 5 % of healthy axes pass:")
    for row in ("independent", "AR(1) 0.5", "hourly 0.95, 5 a day", "shop"):
        found = {}
        for loss in (0.0, LOSS, LOSS * 4.5 / SIGMAS):
            drawn = [np.random.default_rng([2037, seed, axis]) for axis in range(n_axes)]
            found[loss] = np.array([_statistics(ROWS[row](rng, N_SESSIONS + 4, loss)) for rng in drawn])
        limit = np.quantile(found[0.0], 0.95, axis=0)
        shares = [np.mean(found[loss] > limit, axis=0) for loss in list(found)[1:]]
        for i, name in enumerate(("evidence", "Mann-Kendall", "regression t")):
            at_all = f"{shares[0][i]:6.1%} {shares[1][i]:6.1%}  limit {limit[i]:5.2f}"
            print(f"{row:24s} {name:14s} {at_all}", flush=True)


def _statistics(days: list[Day]) -> tuple[float, float, float]:
    """Return the largest of ln B, of the z of Mann and Kendall, and of the t of the regression, over all looks."""
    sessions = sessions_of(list(first_sessions(days)))
    values = np.array([session.value for session in sessions])
    each = []
    for n in range(FEWEST, len(values) + 1):
        fall = weigh_fall(sessions[:n], Prior(), towards_loss=1.0)
        x, y = np.arange(n) - 0.5 * (n - 1), values[:n] - values[:n].mean()
        slope = float(x @ y / (x @ x))
        t = slope * math.sqrt(float(x @ x) * (n - 2) / max(float(((y - slope * x) ** 2).sum()), 1e-300))
        s = float(np.sign(values[None, :n] - values[:n, None])[np.triu_indices(n, 1)].sum())
        z = (s - math.copysign(min(1.0, abs(s)), s)) / math.sqrt(n * (n - 1) * (2 * n + 5) / 18.0)
        each.append((-math.inf if fall is None else fall.log_evidence, z, t))
    best = np.max(each, axis=0)
    return float(best[0]), float(best[1]), float(best[2])


def main(arguments: list[str]) -> None:
    """Print one of both tables."""
    if arguments[:1] == ["tests"]:
        n_axes, seed = (int(a) for a in (arguments + ["400", "1"][len(arguments) - 1 :])[1:3])
        compare(n_axes, seed)
        return
    n_axes, seed = (int(a) for a in (arguments + ["200", "1"][len(arguments) :])[:2])
    print("                                       healthy, ± 95 %   with a loss of 13 %: by session 20, median")
    for row in arguments[2:] or [*ROWS, *(row + SISTERS for row in WITH_SISTERS)]:
        drawn = partial(said_at, row.removesuffix(SISTERS), sisters=row.endswith(SISTERS))
        healthy, falling = (
            np.array([drawn(loss=loss, seed=seed, axis=axis) for axis in range(n_axes)]) for loss in (0.0, LOSS)
        )
        false, said = np.mean(np.isfinite(healthy)), np.mean(falling <= N_SESSIONS)
        half = 1.96 * math.sqrt(max(false * (1.0 - false), 1.0 / n_axes) / n_axes)
        print(f"{row:40s}{false:6.1%} ± {half:.1%}   {said:6.1%}  {np.median(falling):4.0f}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
