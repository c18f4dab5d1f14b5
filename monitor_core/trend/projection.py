"""Project a trend: where the next reading would lie if it went on as it does now."""

from dataclasses import dataclass

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError
from monitor_core.uncertainty import Estimate

#: Through fewer readings every line is a guess.
FEWEST_READINGS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Projection:
    """Readings as they would be at later moments; shape (n_moments,)."""

    value: FloatArray  # on the line, in the unit of the readings
    lower: FloatArray  # of the 95 % prediction interval of one reading
    upper: FloatArray
    slope: Estimate  # in the unit of the readings a day


def project(days: FloatArray, values: FloatArray, ahead: FloatArray) -> Projection:
    r"""Return the 95 % prediction interval of one more reading on the straight line through readings.

    .. math:: \hat y(t) \pm t_{0.975,\,n-2}\; s \sqrt{1 + \frac{1}{n} + \frac{(t - \bar t)^2}{\sum_i (t_i - \bar t)^2}}

    Eq. (1.4.11) of [1]_. It holds for readings that scatter independently about a line that goes on; that it does is an
    assumption, which is why the answer is called a projection.

    Parameters
    ----------
    days : ndarray, shape (n_readings,)
        When they were taken. [d]
    values : ndarray, shape (n_readings,)
        In any unit. [-]
    ahead : ndarray, shape (n_moments,)
        When readings are asked for, counted as ``days``. [d]

    Returns
    -------
    Projection
        Values, interval and slope. [-]

    Raises
    ------
    NotIdentifiableError
        If there are fewer than 8 readings, or all of one moment.

    References
    ----------
    .. [1] N. R. Draper, H. Smith, Applied Regression Analysis, 3rd ed., Wiley, 1998.
    """
    n = days.size
    if n < FEWEST_READINGS or np.ptp(days) == 0.0:
        raise NotIdentifiableError(
            f"a projection needs {FEWEST_READINGS} readings or more, of several moments; got {n}"
        )
    mean = float(days.mean())
    spread = float(np.sum((days - mean) ** 2))
    slope = float(np.sum((days - mean) * values)) / spread
    level = float(values.mean())
    scatter = float(np.sqrt(np.sum((values - level - slope * (days - mean)) ** 2) / (n - 2)))
    value = level + slope * (ahead - mean)
    reach = float(scipy.special.stdtrit(n - 2, 0.975)) * scatter * np.sqrt(1.0 + 1.0 / n + (ahead - mean) ** 2 / spread)
    return Projection(value, value - reach, value + reach, Estimate(slope, scatter / spread**0.5, float(n - 2)))
