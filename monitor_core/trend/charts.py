"""Step control charts as pure functions: EWMA, CUSUM, Shewhart.

Every chart takes the standardised residual of one measurement, counted **positive towards loss**, and its own previous
value, and gives its new value. Limits and run lengths are in :mod:`monitor_core.trend.run_length`.
"""

import math


def cusum_step(previous: float, residual: float, reference: float, largest_increment: float = math.inf) -> float:
    r"""Advance a one-sided cumulative sum, 0 at the start, by one measurement.

    .. math::

        S_i = \max(0,\; S_{i-1} + \min(z_i - k,\; c))

    Eq. (3) of [1]_ with the reference k, half the step, in standard deviations, for which the chart is tuned; the
    winsorising constant c is that of [2]_: an outlier may push the sum by c at most.

    References
    ----------
    .. [1] E. S. Page, Biometrika 41 (1954) 100–115.
    .. [2] D. M. Hawkins, "Robustification of cumulative sum charts by winsorization", J. Qual. Technol. 25 (1993).
    """
    return max(0.0, previous + min(residual - reference, largest_increment))


def ewma_step(previous: float, residual: float, weight: float) -> float:
    r"""Advance a two-sided exponentially weighted moving average, 0 at the start, by one measurement.

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
