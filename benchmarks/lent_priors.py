"""How soon a young axis is alarmed with what its sisters lent, of whom it may be unlike.

``python -m benchmarks.lent_priors [axes [seed]]``: a step of two standard deviations after 40 sessions, alone and with
four sisters that scatter as the axis does, twice and four times as much. Every axis has the same values in each row.
"""

import math
import sys
from datetime import timedelta

import numpy as np

from benchmarks.false_alarms import START, limits
from monitor_core.arrays import FloatArray
from monitor_core.trend import DetectorState, Observation, Prior, learn_baseline, prior_from, reset, step
from monitor_core.trend.observation import sessions_of

SISTERS, OF_SISTER, BEFORE, WATCHED, STEP = 4, 120, 40, 60, 2.0


def measured(values: FloatArray) -> list[Observation]:
    """Return one measurement a day."""
    return [Observation(START + day * timedelta(days=1), float(value)) for day, value in enumerate(values)]


def lent(rng: np.random.Generator, scatter: float) -> Prior:
    """Return what sisters of such a scatter teach."""
    learnt = [learn_baseline(sessions_of(measured(scatter * rng.standard_normal(OF_SISTER)))) for _ in range(SISTERS)]
    return prior_from([belief for belief in learnt if belief is not None])


def delay_of(values: FloatArray, prior: Prior | None) -> float:
    """Return the sessions from the step to the alarm; infinite if there is none."""
    state = DetectorState(prior=prior)
    for session, observation in enumerate(measured(values)):
        state = step(state, observation, limits())
        if state.alarm is not None:
            if session >= BEFORE:
                return session - BEFORE + 1.0
            state = reset(state)
    return math.inf


def main(arguments: list[str]) -> None:
    """Print the delays."""
    axes, seed = (int(a) for a in (arguments + ["24", "1"][len(arguments) :])[:2])
    found: dict[str, list[float]] = {}
    for axis in range(axes):
        rng = np.random.default_rng([2038, seed, axis])
        values = rng.standard_normal(BEFORE + WATCHED) + STEP * (np.arange(BEFORE + WATCHED) >= BEFORE)
        priors = {f"sisters of {scatter:.0f} x the scatter": lent(rng, scatter) for scatter in (1.0, 2.0, 4.0)}
        for row, prior in ({"alone": None} | priors).items():
            found.setdefault(row, []).append(delay_of(values, prior))
    print(f"{axes} axes, sessions to the alarm: median, mean; missed within {WATCHED}; missed and found alone")
    alone = np.array(found["alone"])
    for row, delays in found.items():
        each = np.array(delays)
        seen = each[np.isfinite(each)]
        missed = np.isinf(each)
        lost = int((missed & np.isfinite(alone)).sum())
        print(f"{row:28s}{np.median(each):6.1f} {seen.mean():6.1f} {int(missed.sum()):6d} {lost:6d}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
