"""Step control charts, and choose their limits for a wanted false-alarm rate by their average run lengths.

Every chart takes the standardised residual of one session, counted **positive towards loss**, and its own previous
value, and gives its new value. The run lengths take the true distribution of the residual as the chart sees it,
N(shift, scale²). ``shift`` and ``scale`` [-] may be arrays of any shape: on an *estimated* baseline even a healthy axis
shows a shift and a scale other than 1, different ones for each baseline. They are the measurements up to and including
the signal [-], at most 1e12, in that shape. A limit that is not positive raises ``OutsideValidityError``.

The residuals that the charts are fed with have what the baseline does not know in them already: on a healthy axis they
are standard normal and independent (:mod:`monitor_core.trend.belief`), and the run lengths of the tables hold.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import timedelta
from enum import StrEnum
from typing import overload

import numpy as np
import numpy.typing as npt
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError

#: No axis lives longer. A run ends by itself with the reciprocal of this as its probability per measurement, without
#: which the linear system of a chart that never signals would be singular.
_LONGEST = 1e12


@overload
def cusum_step(previous: float, residual: float, reference: float, largest_increment: float = math.inf) -> float: ...
@overload
def cusum_step(
    previous: FloatArray, residual: FloatArray, reference: FloatArray, largest_increment: float = math.inf
) -> FloatArray: ...
def cusum_step(
    previous: float | FloatArray,
    residual: float | FloatArray,
    reference: float | FloatArray,
    largest_increment: float = math.inf,
) -> float | FloatArray:
    r"""Advance a one-sided cumulative sum, 0 at the start, by one session; in arrays one of many axes.

    .. math::

        S_i = \max(0,\; S_{i-1} + \min(z_i - k,\; c))

    Eq. (3) of [1]_ with the reference k, half the step, in standard deviations, for which the chart is tuned; the
    winsorising constant c is that of [2]_: an outlier may push the sum by c at most.

    References
    ----------
    .. [1] E. S. Page, Biometrika 41 (1954) 100–115.
    .. [2] D. M. Hawkins, "Robustification of cumulative sum charts by winsorization", J. Qual. Technol. 25 (1993).
    """
    if isinstance(residual, np.ndarray):
        return np.asarray(np.maximum(previous + np.minimum(residual - reference, largest_increment), 0.0))
    return max(float(previous) + min(residual - float(reference), largest_increment), 0.0)


def ewma_step(previous: float, residual: float, weight: float) -> float:
    r"""Advance a two-sided exponentially weighted moving average, 0 at the start, by one session.

    .. math::

        v_i = (1 - \lambda)\, v_{i-1} + \lambda z_i

    Eq. (1) of [1]_, with the weight λ of the newest measurement. In the long run it scatters with standard deviation
    :math:`\sqrt{\lambda / (2 - \lambda)}`.

    References
    ----------
    .. [1] S. W. Roberts, Technometrics 1 (1959) 239–250.
    """
    return (1.0 - weight) * previous + weight * residual


def winsorise(residual: float, largest: float) -> float:
    """Limit the magnitude of a residual, so that one outlier cannot fill a chart."""
    return max(-largest, min(residual, largest))


def cusum_run_length(
    limit: float,
    *,
    reference: float,
    shift: npt.ArrayLike = 0.0,
    scale: npt.ArrayLike = 1.0,
    largest_increment: float = math.inf,
    confirmed_limit: float = math.inf,
    n_cells: int = 80,
) -> FloatArray:
    r"""Return the average run length of the one-sided CUSUM, from an empty chart to a value above its limit.

    Markov chain of [1]_: [0, h] in cells of width w = 2h/(2n − 1), the first of which is half a cell around zero. With
    a second rule, by which two residuals in a row beyond a limit signal as well, the chain also remembers whether the
    last residual was beyond. With the transitions P₀ of a residual within and P₁ of one beyond, the mean lengths a
    after one within and b after one beyond are

    .. math:: a = 1 + P_0 a + P_1 b, \qquad b = 1 + P_0 a

    with h the limit and k the reference. The largest increment is the winsorising constant of
    :func:`cusum_step`; the confirmed limit, the Shewhart limit of the second rule, is
    infinite without it. The error falls with the square of the number of cells; 80 give 0.1 % at k = 0.5, h = 5.

    Examples
    --------
    Table 3 of [2]_, one side, k = 0.5, h = 4: 335.4

    >>> round(float(cusum_run_length(4.0, reference=0.5)))
    335

    References
    ----------
    .. [1] D. Brook, D. A. Evans, Biometrika 59 (1972) 539–549.
    .. [2] J. M. Lucas, R. B. Crosier, Technometrics 24 (1982) 199–205.
    """
    _require_positive(limit)
    width = 2.0 * limit / (2 * n_cells - 1)
    edge: FloatArray = np.arange(-n_cells, n_cells, dtype=np.float64) + 0.5  # of the cells travelled in one step
    cumulative = _normal_cdf(edge * width + reference, shift, scale)
    below = _normal_cdf(np.array([confirmed_limit]), shift, scale)
    # a whole number of cells, rounded down: two increments of half the limit fill the chart, but do not exceed it
    atom = edge > (math.floor(largest_increment / width) if math.isfinite(largest_increment) else math.inf)
    within = np.where(atom, below, np.minimum(cumulative, below))
    beyond = np.where(atom, 1.0, cumulative) - within

    p0, p1 = _from_cell_to_cell(within), _from_cell_to_cell(beyond)
    ones = np.ones((*p0.shape[:-1], 1))
    return _first_passage(p0 + p1 @ p0, ones + p1 @ ones, start_cell=0)


def _from_cell_to_cell(cumulative: FloatArray) -> FloatArray:
    """Turn P(cells travelled ≤ edge), shape (..., 2n), into P(from cell, to cell), shape (..., n, n)."""
    n_cells = cumulative.shape[-1] // 2
    cell = np.arange(n_cells)
    travelled = cell[None, :] - cell[:, None] + n_cells
    probability = np.asarray(cumulative[..., travelled] - cumulative[..., travelled - 1])
    probability[..., 0] = cumulative[..., travelled[:, 0]]  # everything below the first cell is held at zero
    return probability


def ewma_run_length(
    limit: float,
    *,
    weight: float,
    shift: npt.ArrayLike = 0.0,
    scale: npt.ArrayLike = 1.0,
    largest_residual: float = math.inf,
    n_cells: int = 81,
) -> FloatArray:
    r"""Return the average run length of an EWMA from zero to beyond its limit.

    Markov chain of [1]_ on [−c, c], where :math:`c = L \sqrt{\lambda/(2-\lambda)}` is the limit of the average itself
    and λ the weight. Residuals are winsorised at the largest magnitude. The number of cells is odd, so that zero is the
    middle of one; 81 give 0.6 % at λ = 0.1, ARL 500.

    Examples
    --------
    Table 3 of [1]_, λ = 0.1, L = 2.814: 500

    >>> round(float(ewma_run_length(2.814 * math.sqrt(0.1 / 1.9), weight=0.1, n_cells=321)), -1)
    500.0

    References
    ----------
    .. [1] J. M. Lucas, M. S. Saccucci, Technometrics 32 (1990) 1–12.
    """
    _require_positive(limit)
    width = 2.0 * limit / n_cells
    start_cell = n_cells // 2
    centre: FloatArray = (np.arange(n_cells, dtype=np.float64) - start_cell) * width
    half = 0.5 * width

    def cdf_of_next(edge: FloatArray) -> FloatArray:
        residual = (edge[None, :] - (1.0 - weight) * centre[:, None]) / weight
        probability = _normal_cdf(residual, shift, scale)
        probability[..., residual >= largest_residual] = 1.0
        probability[..., residual < -largest_residual] = 0.0
        return probability

    transition = cdf_of_next(centre + half) - cdf_of_next(centre - half)
    return _first_passage(transition, np.ones((*transition.shape[:-1], 1)), start_cell)


def shewhart_run_length(
    limit: float,
    *,
    shift: npt.ArrayLike = 0.0,
    scale: npt.ArrayLike = 1.0,
    consecutive: int = 1,
    two_sided: bool = False,
) -> FloatArray:
    r"""Return the average run length of a Shewhart chart that signals after consecutive residuals beyond the limit.

    .. math:: \mathrm{ARL} = \frac{1 - p^r}{(1 - p)\, p^r}

    Mean waiting time for a run of r successes, section XIII.7 of [1]_; 1/p for r = 1. The limit is in standard
    deviations, r the number of consecutive residuals; two-sided, those beyond the limit on either side count.

    Examples
    --------
    The three-sigma chart:

    >>> round(float(shewhart_run_length(3.0, two_sided=True)), 1)
    370.4

    References
    ----------
    .. [1] W. Feller, An Introduction to Probability Theory and Its Applications, vol. 1, 3rd ed., Wiley, 1968.
    """
    shift, scale = np.asarray(shift, dtype=np.float64), np.asarray(scale, dtype=np.float64)
    p = scipy.special.ndtr((shift - limit) / scale)
    if two_sided:
        p = p + scipy.special.ndtr((-limit - shift) / scale)
    # (1 − pʳ)/(1 − p) = 1 + p + … + pʳ⁻¹ also holds at p = 1
    partial_sum = sum((p**i for i in range(1, consecutive)), start=np.ones_like(p))
    return np.asarray(partial_sum / np.maximum(p**consecutive, 1.0 / _LONGEST))


def _normal_cdf(points: FloatArray, shift: npt.ArrayLike, scale: npt.ArrayLike) -> FloatArray:
    """Return P(residual ≤ point), shape (*distributions, *points)."""
    shift, scale = np.broadcast_arrays(np.asarray(shift, dtype=np.float64), np.asarray(scale, dtype=np.float64))
    expand = (...,) + (None,) * points.ndim
    return np.asarray(scipy.special.ndtr((points - shift[expand]) / scale[expand]))


def _first_passage(transition: FloatArray, duration: FloatArray, start_cell: int) -> FloatArray:
    """Return the mean time until the chain leaves its cells; ``duration`` is of a stay, shape (..., n_cells, 1)."""
    surviving = (1.0 - 1.0 / _LONGEST) * transition
    return np.asarray(np.linalg.solve(np.eye(transition.shape[-1]) - surviving, duration)[..., start_cell, 0])


def _require_positive(limit: float) -> None:
    if not limit > 0.0:
        raise OutsideValidityError(f"limit must be positive; got {limit}")


#: Most sessions that a year is expected to have: one a day. Measured round the clock there are more.
SESSIONS_PER_YEAR = 365.0
#: Rates that limits are sought for [1/year]: from one false alarm a year of a million axes, beyond which the tails that
#: the tables rest on are nobody's, to one in every session.
LEAST_RATE, MOST_RATE = 1e-6, SESSIONS_PER_YEAR
#: Measurements of a year: an axis that is measured less than once has no baseline in its life; one a second at most.
LEAST_MEASUREMENTS, MOST_MEASUREMENTS = 1.0, 3.2e7
#: Sessions of a baseline: the scatter of fewer is not known, and more than some three years of them are never learnt.
LEAST_BASELINE, MOST_BASELINE = 3, 1000
#: Reference of the CUSUM: a quarter finds slow wear soonest.
CUSUM_REFERENCE = 0.25
#: EWMA weight: remembers about the last ten sessions.
EWMA_WEIGHT = 0.2
#: Two standard deviations of the EWMA: less is no hint, however many alerts are allowed.
LOWEST_EWMA_LIMIT = 2.0 * math.sqrt(EWMA_WEIGHT / (2.0 - EWMA_WEIGHT))
#: An alert lasts about so many sessions, until the average has forgotten what raised it.
ALERT_DURATION = 10.0
#: Share of the false alarms that the Shewhart rule would cause if it were alone.
SHEWHART_SHARE = 0.1
#: Share of the false alarms that are left to the weighing of all sessions together: so many are none of the other two.
EVIDENCE_SHARE = 0.1
#: By how much the limits grow with twice the sessions between two false alarms: over a factor of eight, either way of a
#: year of days, that holds a rate to 3 %.
CUSUM_PER_DOUBLING, SHEWHART_PER_DOUBLING = 1.33, 0.145
#: The same of the alerts; they are counted so that it errs towards fewer where sessions are rare.
EWMA_PER_DOUBLING = 0.1
#: Sessions between two false alarms, below which the limits are not lowered any more where sessions are rarer.
FEWEST_BETWEEN = 45.0
#: The Shewhart rule waits for the next session to confirm.
SHEWHART_CONSECUTIVE = 2


class LossDirection(StrEnum):
    """Which way the trended quantity goes when preload is lost."""

    FALL = "fall"  #: preload in newtons, friction torque, natural frequency
    RISE = "rise"  #: the preload feature of Nguyen's Eq. (8)


@dataclass(frozen=True, slots=True)
class DetectorSettings:
    """What the owner of an axis decides.

    The false-alarm rate is the expected number in a year of a healthy axis. Measurements within
    :data:`monitor_core.trend.observation.SESSION` are one session. How many a year there will be is a first guess, in
    place of which the axis itself soon tells. The baseline needs so many sessions and such a span; it goes on learning
    as long as nothing speaks against it. The rate of alerts is an upper estimate.
    """

    false_alarms_per_year: float = 1.0
    false_alerts_per_year: float = 4.0
    measurements_per_year: float = 365.0
    baseline_size: int = 20
    baseline_span: timedelta = timedelta(days=14)
    loss: LossDirection = LossDirection.FALL

    def __post_init__(self) -> None:
        for name in ("false_alarms_per_year", "false_alerts_per_year", "measurements_per_year"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise OutsideValidityError(f"{name} must be positive and finite; got {getattr(self, name)}")
        if not LEAST_BASELINE <= self.baseline_size <= MOST_BASELINE:
            raise OutsideValidityError(
                f"baseline_size must be {LEAST_BASELINE} to {MOST_BASELINE}; got {self.baseline_size}"
            )

    @property
    def sessions_per_year(self) -> float:
        """Sessions that are expected."""
        return min(self.measurements_per_year, SESSIONS_PER_YEAR)


@dataclass(frozen=True, slots=True)
class DetectorDesign:
    """Limits that meet the settings. Solved once, and brought to the sessions a year that an axis truly has."""

    settings: DetectorSettings
    cusum_reference: float  # where the baseline is known for certain
    cusum_limit: float
    shewhart_limit: float
    ewma_limit: float
    evidence_limit: float  # of ln R, see :mod:`monitor_core.trend.lasting_loss`
    pace: float | None = None  # sessions a year that the limits are for; None: those that the settings expect

    @property
    def sessions_per_year(self) -> float:
        """Sessions that the rates are counted over."""
        return self.settings.sessions_per_year if self.pace is None else self.pace

    def at_pace(self, sessions_per_year: float) -> "DetectorDesign":
        """Return the limits for so many sessions a year.

        Below :data:`FEWEST_BETWEEN` they stay, which is fewer false alarms than stated.
        """
        fewest = min(FEWEST_BETWEEN * self.settings.false_alarms_per_year, self.sessions_per_year)
        ratio = max(sessions_per_year, fewest) / self.sessions_per_year
        if ratio == 1.0:
            return self
        doublings = math.log2(ratio)
        return replace(
            self,
            pace=ratio * self.sessions_per_year,
            cusum_limit=self.cusum_limit + doublings * CUSUM_PER_DOUBLING,
            shewhart_limit=self.shewhart_limit + doublings * SHEWHART_PER_DOUBLING,
            ewma_limit=max(self.ewma_limit + doublings * EWMA_PER_DOUBLING, LOWEST_EWMA_LIMIT),
            evidence_limit=self.evidence_limit + math.log(ratio),
        )

    @property
    def largest_increment(self) -> float:
        """Most that one session may add to the CUSUM: half its limit, so that no outlier alarms alone."""
        return 0.5 * self.cusum_limit

    @property
    def largest_residual(self) -> float:
        """Magnitude above which a residual counts as this much, in CUSUM and EWMA."""
        return self.cusum_reference + self.largest_increment


def design_detector(settings: DetectorSettings) -> DetectorDesign:
    """Solve the limits of CUSUM, Shewhart rule and EWMA, and that of all sessions together, from the wanted rates.

    Alarm: the CUSUM beyond its limit, or :data:`SHEWHART_CONSECUTIVE` residuals in a row beyond the Shewhart limit,
    which alone would cause :data:`SHEWHART_SHARE` of the rate; both together cause all of it but
    :data:`EVIDENCE_SHARE`. Or the evidence of :mod:`monitor_core.trend.lasting_loss` beyond as many sessions as lie
    between two false alarms: by itself it alarms no oftener than stated, and mostly where the others do.

    Alert: the EWMA beyond its limit on either side, because a rise of preload is no loss but tells that something has
    changed.

    ``OutsideValidityError`` if the settings lie outside the range that limits are sought for, or the wanted number of
    false alarms is so large that no limit gives it.
    """
    _require_sought(settings)
    n_sessions = settings.sessions_per_year

    def shewhart_alarms(limit: float) -> float:
        return n_sessions / float(shewhart_run_length(limit, consecutive=SHEWHART_CONSECUTIVE))

    shewhart_limit = _solve(shewhart_alarms, settings.false_alarms_per_year, SHEWHART_SHARE)

    def all_alarms(limit: float) -> float:
        run_length = cusum_run_length(
            limit, reference=CUSUM_REFERENCE, largest_increment=0.5 * limit, confirmed_limit=shewhart_limit
        )
        return n_sessions / float(run_length)

    cusum_limit = _solve(all_alarms, settings.false_alarms_per_year, 1.0 - EVIDENCE_SHARE)
    evidence_limit = math.log(n_sessions / settings.false_alarms_per_year)
    design = DetectorDesign(settings, CUSUM_REFERENCE, cusum_limit, shewhart_limit, LOWEST_EWMA_LIMIT, evidence_limit)

    def alerts(limit: float) -> float:
        run_length = ewma_run_length(limit, weight=EWMA_WEIGHT, largest_residual=design.largest_residual)
        return n_sessions / (float(run_length) + ALERT_DURATION)

    if alerts(LOWEST_EWMA_LIMIT) <= settings.false_alerts_per_year:
        return design
    return replace(design, ewma_limit=_solve(alerts, settings.false_alerts_per_year))


def _require_sought(settings: DetectorSettings) -> None:
    # not a law of the settings: limits that an earlier program solved for others are gone on with
    for name, least, most in (
        ("false_alarms_per_year", LEAST_RATE, MOST_RATE),
        ("false_alerts_per_year", LEAST_RATE, MOST_RATE),
        ("measurements_per_year", LEAST_MEASUREMENTS, MOST_MEASUREMENTS),
    ):
        if not least <= getattr(settings, name) <= most:
            raise OutsideValidityError(f"{name} must be {least:g} to {most:g}; got {getattr(settings, name)}")


#: Limits that are tried, from the middle down and up [standard deviations]. At the smallest rate, one session in
#: 3.65e8, the limit of the CUSUM is 35.
_LOWER_LIMITS = tuple(0.5 * 0.5**i for i in range(9))
_UPPER_LIMITS = tuple(1.5**i for i in range(12))


def _solve(expected_number: Callable[[float], float], rate: float, share: float = 1.0) -> float:
    """Find the limit at which a falling expectation meets this share of the rate."""
    wanted = share * rate
    lower = next((limit for limit in _LOWER_LIMITS if expected_number(limit) >= wanted), None)
    if lower is None:
        raise OutsideValidityError(f"no limit gives as many as {rate:g} false alarms in a year; ask for fewer")
    upper = next((limit for limit in _UPPER_LIMITS if expected_number(limit) <= wanted), None)
    if upper is None:
        raise OutsideValidityError(f"no limit gives as few as {rate:g} false alarms in a year; ask for more")
    if upper > 1.0:
        lower = upper / 1.5
    # the logarithm is nearly straight in the limit; an expectation of exactly 0 lies far below every wanted number
    return float(
        scipy.optimize.brentq(lambda x: math.log(max(expected_number(x), 1e-300) / wanted), lower, upper, xtol=1e-3)
    )


@dataclass(frozen=True, slots=True)
class DetectionDelay:
    """Average run length of the charts after a sudden loss, from empty charts to the alarm."""

    sessions: float  # [-]
    days: float  # at the sessions a year of the design


def detection_delay(design: DetectorDesign, shift: float) -> DetectionDelay:
    r"""Return how long a loss stays unnoticed on average, by the run lengths that the limits were solved with.

    The chain of :func:`cusum_run_length` with the Shewhart rule, at a residual
    N(shift, 1). It holds for sessions that are independent of each other and a baseline that is known; where
    neighbouring sessions resemble each other it takes longer. What all sessions together say comes on top, and may
    alarm earlier.

    Parameters
    ----------
    design : DetectorDesign
        Limits of the charts.
    shift : float
        The loss in standard deviations of what is predicted of a healthy session, not negative. [-]

    Returns
    -------
    DetectionDelay
        Sessions up to and including the one that alarms, and the days that they take.

    Raises
    ------
    OutsideValidityError
        If the shift is negative.

    Examples
    --------
    A loss of no size is alarmed as often as a healthy axis is falsely by these two, nine times of ten alarms:

    >>> from monitor_core.trend import DetectorSettings, design_detector
    >>> design = design_detector(DetectorSettings(false_alarms_per_year=1.0))
    >>> round(detection_delay(design, 0.0).days)
    406
    """
    if not shift >= 0.0:
        raise OutsideValidityError(f"shift must not be negative; got {shift}")
    run_length = cusum_run_length(
        design.cusum_limit,
        reference=design.cusum_reference,
        shift=shift,
        largest_increment=design.largest_increment,
        confirmed_limit=design.shewhart_limit,
    )
    sessions = float(run_length)
    return DetectionDelay(sessions, sessions * SESSIONS_PER_YEAR / design.sessions_per_year)
