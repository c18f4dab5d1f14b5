"""Leave out one position at a time and predict its readings from the others: how far a calibration carries."""

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.errors import NotIdentifiableError
from monitor_core.preload.calibration import PositionError
from monitor_core.preload.readings import ReadingColumns, position_groups
from monitor_core.preload.regression import weighted_least_squares


def leave_one_position_out(
    columns: ReadingColumns, unloaded: BoolArray, weight: FloatArray, design: FloatArray
) -> tuple[PositionError, ...]:
    """Fit the unloaded readings without one position, and predict that one."""
    position, preload, y = columns.position[unloaded], columns.preload[unloaded], columns.inverse_square[unloaded]
    x, w, slope = design[unloaded], weight[unloaded], columns.slope[unloaded]
    groups = position_groups(position)
    if len(groups) < 4:
        return ()
    errors = []
    for out in groups:
        kept = np.setdiff1d(np.arange(position.size), out)
        if np.unique(preload[kept]).size < 2 or kept.size <= x.shape[1]:
            continue
        try:
            beta = weighted_least_squares(x[kept], y[kept], w[kept]).parameters.values
        except NotIdentifiableError:  # an influence quantity that was varied at that position only
            continue
        miss = y[out] - x[out] @ beta
        theta = np.cbrt(1.0 / preload[out]) + miss / beta[2]
        preload_error = theta**-3.0 - preload[out] if np.all(theta > 0.0) else None
        errors.append(
            PositionError(
                position=float(position[out].mean()),
                frequency_error_rms=float(np.sqrt(np.mean((miss / slope[out]) ** 2))),
                preload_error_rms=None if preload_error is None else float(np.sqrt(np.mean(preload_error**2))),
            )
        )
    return tuple(errors)
