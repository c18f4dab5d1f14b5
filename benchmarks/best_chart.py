r"""What a chart can do at best that knows of an axis what the product's charts know before its first session.

``python -m benchmarks.best_chart [axes [seed]]``, some three minutes on one core. None of the charts of the product:
after each session the evidence for a step towards loss on any day so far, everything that is not known integrated out
(Shiryaev 1963; Roberts 1966; for its optimality Pollak, Ann. Stat. 13 (1985) 206–227):

.. math:: R_t = \sum_{\tau \le t}
    \frac{\sum_r w_r\, p(y_{1 \ldots t} \mid r, d > 0 \text{ since } \tau)}{\sum_r w_r\, p(y_{1 \ldots t} \mid r)}

over the structures r of :mod:`monitor_core.trend.belief` with their weights, its season, an open level, a scatter of
one degree of freedom, and a step d of some three standard deviations of a session. It keeps every session and forgets
nothing. For the rows its limit is that at which an independent axis has 0.7 alarms a year, the fewest that are asked:
no row can then have fewer without it. For the delays it is given also the 1.2 a year that are the most that are asked.
Rows and changes are those of :mod:`benchmarks.false_alarms`.
"""

import math
import sys

import numpy as np
from scipy import special

from benchmarks.false_alarms import CHANGES, DAYS, ROWS, YEAR, History
from monitor_core.arrays import FloatArray
from monitor_core.trend.belief import STRUCTURES, Prior, Structure

BASELINE = 20  # sessions before the first look
WATCHED = 200  # sessions after a change
#: Prior standard deviations in those of a session: of the level, of a step, and of the scatter a rough value.
LEVEL, STEP, SCATTER = 100.0, 3.0, 0.8
FEWEST_ALARMS, MOST_ALARMS = 0.7, 1.2  # a year
OF_HEALTHY = ("independent", "AR(1) 0.3", "AR(1) 0.5", "AR(1) 0.7", "season ± 2",
              "lubrication, 1 up", "lubrication, 2 up", "lubrication, 1 down", "shop",
              "friction of guides, untold")  # fmt: skip
OF_CHANGES = ("1 σ step", "2 σ step", "2 σ step in the shop")


def square_root(structure: Structure, sessions: int) -> FloatArray:
    """Return the lower square root of the covariance of a healthy axis, in units of its variance σ²."""
    day = np.arange(sessions)
    angle = 2.0 * np.pi * day / YEAR
    apart = np.abs(day[:, None] - day)
    covariance = structure.share * structure.correlation**apart + (1.0 - structure.share) * np.eye(sessions) + LEVEL**2
    deviations = Prior().deviations
    for column, deviation in ((1.0 - np.cos(angle), deviations[0]), (np.sin(angle), deviations[1])):
        covariance += deviation**2 * np.outer(column, column)
    return np.asarray(np.linalg.cholesky(covariance + 1e-9 * np.eye(sessions)))


def evidence(values: FloatArray) -> FloatArray:
    r"""Return :math:`\ln R_t` of each axis after each session, shape (axes, sessions) as the values."""
    axes, sessions = values.shape
    values = values - values[:, :1]
    count = np.arange(1, sessions + 1)
    shape = Prior().degrees_of_freedom / 2.0
    start = shape * SCATTER**2
    roots = [square_root(structure, sessions) for structure in STRUCTURES]
    white = [np.linalg.solve(root, values.T).T for root in roots]
    squares = [np.cumsum(w**2, axis=1) for w in white]
    volume = [np.cumsum(np.log(np.diag(root))) for root in roots]
    weight = [math.log(structure.weight) for structure in STRUCTURES]
    healthy = special.logsumexp([
        weight[r] - volume[r] - (shape + count / 2.0) * np.log(start + squares[r] / 2.0) for r in range(len(roots))
    ], axis=0)  # fmt: skip
    total = np.full((axes, sessions), -np.inf)
    for since in range(BASELINE, sessions):
        step, n, stepped = (np.arange(sessions) >= since) * 1.0, count[since:], []
        for r, root in enumerate(roots):
            column = np.linalg.solve(root, step)[since:]
            information = np.cumsum(column**2) + STEP**-2
            with_step = np.cumsum(white[r][:, since:] * column, axis=1)
            rate = start + (squares[r][:, since:] - with_step**2 / information) / 2.0
            upwards = with_step / np.sqrt(information * rate / (shape + n / 2.0))
            stepped.append(
                weight[r] - volume[r][since:] - (shape + n / 2.0) * np.log(rate)
                - 0.5 * np.log(STEP**2 * information) + math.log(2.0) + special.log_ndtr(upwards)
            )  # fmt: skip
        total[:, since:] = np.logaddexp(total[:, since:], special.logsumexp(stepped, axis=0) - healthy[:, since:])
    return total


def drawn(history: History, rng: np.random.Generator, axes: int, sessions: int) -> FloatArray:
    """Draw the values of so many axes of one measurement a day."""
    return np.array([[day.values[0] for day in history(rng, sessions)] for _ in range(axes)])


def main(arguments: list[str]) -> None:
    """Print both tables."""
    axes, seed = (int(a) for a in (arguments + ["100", "500"][len(arguments) :])[:2])
    limit = lower_limit = math.nan
    print("healthy axis          alarms a year, where an independent one has 0.7")
    for number, row in enumerate(OF_HEALTHY):
        rng = np.random.default_rng([2032, seed, number])
        highest = evidence(drawn(ROWS[row], rng, axes, BASELINE + DAYS))[:, BASELINE:].max(axis=1)
        if row == "independent":
            limit = float(np.quantile(highest, math.exp(-FEWEST_ALARMS)))
            lower_limit = float(np.quantile(highest, math.exp(-MOST_ALARMS)))
        quiet = float(np.mean(highest <= limit))
        half = 1.96 * math.sqrt((1.0 - quiet) / (quiet * axes))  # of −ln(quiet), by the delta method
        print(f"{row:22s}{abs(math.log(quiet)):5.2f} ± {half:.2f}", flush=True)
    print(f"\nchange after a baseline of  days: median; not within {WATCHED} days; the same with 1.2 alarms a year")
    for number, change in enumerate(OF_CHANGES):
        row, shape = CHANGES[change]
        for after in (BASELINE, 100):
            rng = np.random.default_rng([2033, seed, number, after])
            values = drawn(ROWS[row], rng, axes, after + WATCHED) + shape(np.arange(after + WATCHED) - after)
            found = evidence(values)
            said = []
            for beyond in (found > limit, found > lower_limit):
                seen = beyond[~beyond[:, :after].any(axis=1), after:]
                delay = np.where(seen.any(axis=1), seen.argmax(axis=1) + 1.0, math.inf)
                said.append(f"{np.median(delay):6.0f}  {np.mean(np.isinf(delay)):6.1%}")
            print(f"{change:26s}{after:4d} d {'  '.join(said)}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
