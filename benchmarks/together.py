"""Find how often several numbers of healthy axes, watched together, raise false alarms, against the rate of that chart.

``python -m benchmarks.together 50 4 indep own c95``: axes of two years, seed, rows. In ``c95`` both numbers follow a
cause that nobody measures, an autoregression of 0.95 from day to day, each with noise of half its size beside it. In
``four`` there are four numbers as a calibrated axis has them: of one it is not known which way it goes.
"""

import math
import sys
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from monitor_core.trend.joint import JOINT_SHARE, SESSIONS_PER_NUMBER
from monitor_core.trend.joint_filter import (
    begin,
    correlation_of,
    design_row,
    judge,
    learn,
    log_evidence,
    log_sum,
    none_weighed,
    thinned,
    weigh,
)

Array = npt.NDArray[np.float64]
_DAYS = 750
_SIGNS = {2: (-1.0, -1.0), 4: (-1.0, -1.0, 1.0, 0.0)}


def _autoregression(correlation: float, n_axes: int, rng: np.random.Generator) -> Array:
    errors = rng.normal(size=(n_axes, _DAYS))
    for day in range(1, _DAYS):
        errors[:, day] = correlation * errors[:, day - 1] + math.sqrt(1.0 - correlation**2) * errors[:, day]
    return errors


def _independent(n_axes: int, rng: np.random.Generator) -> Array:
    return rng.normal(size=(n_axes, _DAYS, 2))


def _four(n_axes: int, rng: np.random.Generator) -> Array:
    both = np.stack([_autoregression(0.3, n_axes, rng) for _ in range(4)], axis=-1)
    return np.asarray(np.einsum("anj,aij->ani", both, rng.normal(size=(n_axes, 4, 4))))


def _correlated(n_axes: int, rng: np.random.Generator) -> Array:
    both = np.stack([_autoregression(0.6, n_axes, rng) for _ in range(2)], axis=-1)
    return np.asarray(np.einsum("anj,aij->ani", both, rng.normal(size=(n_axes, 2, 2))))


def _each_its_own(n_axes: int, rng: np.random.Generator) -> Array:
    return np.stack([_autoregression(correlation, n_axes, rng) for correlation in (0.0, 0.9)], axis=-1)


def _common(correlation: float) -> Callable[[int, np.random.Generator], Array]:
    def drawn(n_axes: int, rng: np.random.Generator) -> Array:
        return _autoregression(correlation, n_axes, rng)[..., None] + 0.5 * rng.normal(size=(n_axes, _DAYS, 2))

    return drawn


ROWS = {
    "indep": _independent, "ar6": _correlated, "own": _each_its_own, "c8": _common(0.8), "c95": _common(0.95),
    "four": _four,
}  # fmt: skip


def evidence_of_histories(values: Array, n_baseline: int, limit: float, signs: tuple[float, ...] = ()) -> Array:
    """Return ln R of many axes, (n_axes, n_sessions, p), a session a day, all numbers known; NaN where none is judged.

    The baseline is learnt, its mean and scatter the units. What alarms goes on being learnt: only what comes until
    then is what :func:`monitor_core.trend.joint.joint_step` says.
    """
    n_axes, n_sessions, p = values.shape
    baseline = values[:, :n_baseline]
    values = (values - baseline.mean(axis=1)[:, None]) / baseline.std(axis=1, ddof=1)[:, None]
    signs = signs or (0.0,) * p
    bank = begin(correlation_of(values[:, :n_baseline]), signs)
    weighed, known = none_weighed(bank.series.shape[-2], (n_axes,)), np.ones(p, dtype=bool)
    found = np.full((n_axes, n_sessions), np.nan)
    for session in range(n_sessions):
        days = float(session > 0)
        judged = judge(bank, design_row(session / 365.25), days, values[:, session], known)
        bank = learn(judged)
        if session < n_baseline:
            continue
        weighed = weigh(weighed, judged, days, signs, limit=limit, learns=True)
        each = log_sum(log_evidence(weighed, judged, signs))
        if weighed.age.shape[-1] > 1:
            found[:, session] = log_sum((each + weighed.merged)[:, :-1])
        weighed, _ = thinned(weighed, each)
    return found


def main() -> None:
    """Print alarms found, alarms that the rate lets expect until they come, and their ratio."""
    n_axes, seed = int(sys.argv[1]), int(sys.argv[2])
    limit = math.log(365.0 / JOINT_SHARE)
    for row in sys.argv[3:]:
        values = ROWS[row](n_axes, np.random.default_rng([seed, sum(map(ord, row)), 2]))
        baseline = SESSIONS_PER_NUMBER * values.shape[-1]
        alarmed = evidence_of_histories(values, baseline, limit, _SIGNS[values.shape[-1]]) > limit
        found = alarmed.any(axis=1)
        first = np.where(found, alarmed.argmax(axis=1), _DAYS)
        expected = float((first - baseline).sum()) * JOINT_SHARE / 365.0
        n = int(found.sum())
        print(f"{row}: {n} alarms, {expected:.1f} expected, {n / expected:.2f} ± {math.sqrt(max(n, 1)) / expected:.2f}")


if __name__ == "__main__":
    main()
