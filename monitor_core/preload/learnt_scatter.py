"""Widen a coverage interval by the scatter that an axis has shown from session to session."""

import math

import numpy as np
import scipy

from monitor_core.uncertainty import Interval


def unexplained_scatter(learnt: float, budgeted: float) -> float:
    """Return what the scatter between sessions has on top of what the budget of a measurement allows for.

    Both are standard deviations of the preload feature [s²]. A smaller scatter narrows nothing: what has been the same
    since the calibration (a mounting, a home switch) does not show in it.
    """
    return math.sqrt(max(learnt**2 - budgeted**2, 0.0))


def widened(interval: Interval, preload: float, feature: float, unexplained: float) -> Interval:
    r"""Return the coverage interval of a preload with so much more scatter of its feature.

    In :math:`\theta = \mathrm{preload}^{-1/3} = g/k_3`, where the feature g acts linearly, each half grows from h to
    :math:`\sqrt{h^2 + (z\,s/k_3)^2}` with z the normal quantile of the level: a part of type A, known from many
    sessions, joins the budget (GUM, 5.1.2). Preloads are in newtons, feature and scatter s in s².
    """
    if unexplained <= 0.0:
        return interval
    theta = float(np.cbrt(1.0 / preload))
    reach = float(scipy.special.ndtri(0.5 * (1.0 + interval.level))) * unexplained * theta / feature
    most = math.inf if interval.lower == 0.0 else float(np.cbrt(1.0 / interval.lower))
    least = float(np.cbrt(1.0 / interval.upper))
    high, low = theta + math.hypot(most - theta, reach), theta - math.hypot(theta - least, reach)
    upper = math.inf if low <= 0.0 or least == 0.0 else low**-3.0
    return Interval(high**-3.0, upper, interval.kind, interval.level)
