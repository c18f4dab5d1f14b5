"""Find the false-alarm rate that the axis' own healthy history gives, to compare with the one that was stated.

The stated rate holds for residuals that are independent and standard normal. Those of the axis itself, resampled in
blocks of a fortnight, keep whatever dependence and whatever tails they have. CUSUM and Shewhart rule are run over them;
what all sessions together say of a loss that lasts cannot be taken from blocks, and is counted with its share.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.trend.charts import EVIDENCE_SHARE, DetectorDesign, cusum_step
from monitor_core.trend.detector import ClosedSession
from monitor_core.uncertainty import Interval, IntervalKind

#: Sessions of a block: what lasts no longer is kept.
BLOCK = 14
#: Of fewer sessions nothing is said.
FEWEST_SESSIONS = 5 * BLOCK
#: Histories that could as well have been, and years that each is watched for.
_HISTORIES, _YEARS = 200, 40
_DAYS = 365


@dataclass(frozen=True, slots=True)
class ChartedSession:
    """What the charts made of a session."""

    residual: float  # in standard deviations, positive towards loss
    reference: float  # of the CUSUM


@dataclass(frozen=True, slots=True)
class FoundRate:
    """False alarms a year that an axis' own history gives."""

    rate: float
    interval: Interval
    n_sessions: int


def healthy_sessions(closed: Iterable[ClosedSession]) -> list[ChartedSession]:
    """Return those sessions of a healthy history that the charts have judged."""
    return [
        ChartedSession(item.residual, item.reference)
        for item in closed
        if item.residual is not None and item.reference is not None
    ]


def found_rate(
    sessions: Sequence[ChartedSession], design: DetectorDesign, rng: "np.random.Generator", level: float = 0.95
) -> FoundRate | None:
    """Count the alarms of years that are put together from blocks of a healthy history (circular block bootstrap).

    The interval is that of the rate: whole histories are resampled, too (Politis & Romano, in: Exploring the Limits of
    Bootstrap, Wiley, 1992; for charts: Chatterjee & Qiu, Ann. Appl. Stat. 3 (2009) 349–369). Alarms are rare: what a
    history has no trace of, no resampling shows, so that it is no narrower than the interval of Jeffreys for as many
    alarms in as long a time (Brown, Cai & DasGupta, Stat. Sci. 16 (2001) 101–133). ``None`` if the history is shorter
    than :data:`FEWEST_SESSIONS` sessions.
    """
    n = len(sessions)
    if n < FEWEST_SESSIONS:
        return None
    residual = np.array([session.residual for session in sessions])
    reference = np.array([session.reference for session in sessions])
    blocks = (np.arange(n)[:, None] + np.arange(BLOCK)) % n
    per_year = design.sessions_per_year / _DAYS

    def rates(starts: FloatArray, years: int) -> FloatArray:
        """Return the alarms a year of histories, given where their blocks start, shape (n_histories, n_blocks)."""
        chosen = rng.integers(starts.shape[1], size=(starts.shape[0], years, -(-_DAYS // BLOCK)))
        first = np.take_along_axis(starts[:, None, :].astype(np.intp), chosen, axis=2)
        which = blocks[first].reshape(starts.shape[0], years, -1)[..., :_DAYS]
        of_charts = _alarms(residual[which], reference[which], design).mean(axis=1) * per_year
        return np.asarray(of_charts + EVIDENCE_SHARE * design.settings.false_alarms_per_year)

    rate = float(rates(np.arange(n, dtype=np.float64)[None, :], _HISTORIES * 10)[0])
    drawn = rng.integers(n, size=(_HISTORIES, n // BLOCK)).astype(np.float64)
    ends = np.array([0.5 * (1.0 - level), 0.5 * (1.0 + level)])
    resampled = np.quantile(rates(drawn, _YEARS), ends)
    years = n / design.sessions_per_year
    rare = scipy.special.gammaincinv(rate * years + 0.5, ends) / years
    low, high = float(min(resampled[0], rare[0], rate)), float(max(resampled[1], rare[1], rate))
    interval = Interval(low, high, IntervalKind.CONFIDENCE, level)
    return FoundRate(rate, interval, n)


def _alarms(residual: FloatArray, reference: FloatArray, design: DetectorDesign) -> FloatArray:
    """Return how often CUSUM and Shewhart rule alarm along the last axis, each alarm cleared."""
    cusum = np.zeros(residual.shape[:-1])
    beyond_before = np.zeros(residual.shape[:-1], dtype=bool)
    count = np.zeros(residual.shape[:-1])
    for day in range(residual.shape[-1]):
        z = residual[..., day]
        cusum = cusum_step(cusum, z, reference[..., day], design.largest_increment)
        beyond = z > design.shewhart_limit
        alarmed = (cusum > design.cusum_limit) | (beyond & beyond_before)
        count += alarmed
        cusum[alarmed] = 0.0
        beyond_before = beyond & ~alarmed
    return count
