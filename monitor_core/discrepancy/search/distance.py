"""Judge how far a fit is from the data, and what can be relied upon at that distance.

The gap is measured in noise floors: at 1 nothing is left to find, below ``_ONE_MINIMUM`` a fit has not ended in a false
minimum, beyond ``_FAR`` nothing makes up by chance for what is missing. Where misfits are small the model is nearly
linear in what may be added, and screening foretells what refits find.
"""

import numpy as np

from monitor_core.effects.effect import Physics
from monitor_core.fitting.conditions.groups import has_lines
from monitor_core.fitting.solver.hypothesis_fit import Fitted

_ONE_MINIMUM, _FAR = 1.5, 10.0  # gaps, in floors
_SMALL_MISFIT, _ALMOST_ALL = 0.15, 0.98  # a misfit that this share of the values stays within


def gap(fitted: Fitted[Physics]) -> float:
    """Return the gap on the fitted values, in floors of the data."""
    return fitted.gap / fitted.comparison.noise_floor


def is_near(fitted: Fitted[Physics]) -> bool:
    """Return whether screening foretells what refits find."""
    return float(np.quantile(np.abs(fitted.misfit[fitted.fitted]), _ALMOST_ALL)) < _SMALL_MISFIT


def is_far(fitted: Fitted[Physics]) -> bool:
    """Return whether nothing makes up by chance for what this fit is without."""
    return gap(fitted) > _FAR


def screening_misleads(fitted: Fitted[Physics]) -> bool:
    """Return whether screening predicts much less than refits gain: for frequencies of modes, far from the data."""
    return not has_lines(fitted.comparison.layout) and is_far(fitted)


def may_be_elsewhere(fitted: Fitted[Physics]) -> bool:
    """Return whether so much is left that a better minimum may lie elsewhere."""
    return gap(fitted) >= _ONE_MINIMUM


def has_one_minimum(fitted: Fitted[Physics]) -> bool:
    """Return whether a fit that improves is the best one: false minima come from phases, far from the data."""
    phases = np.any(np.isfinite(fitted.comparison.layout.period))
    return not phases or not may_be_elsewhere(fitted)
