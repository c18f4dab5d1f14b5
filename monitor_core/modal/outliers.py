"""Windows that do not belong: a bad impact among good ones."""

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray

#: A window is outlying if it leaves this many times the median misfit, both in absolute terms (or it would do no harm)
#: and relative to its own response (or it is merely a strong one): three times in amplitude.
_OUTLYING = 9.0


def outlying(residual: FloatArray, response: FloatArray, *, least_share: float = 0.0) -> BoolArray:
    """Tell which windows leave far more unexplained than their fellows.

    Parameters
    ----------
    residual : ndarray, shape (n_windows,)
        What is left of each window, sum of squared moduli. [(m/s²)²]
    response : ndarray, shape (n_windows,)
        Its response, sum of squared moduli. [(m/s²)²]
    least_share : float
        Windows of which less than this share is left are never outlying. [-]

    Returns
    -------
    ndarray of bool, shape (n_windows,)
        True for a window to be refused.
    """
    share = residual / np.maximum(response, np.finfo(np.float64).tiny)
    least = max(_OUTLYING * float(np.median(share)), least_share)
    flagged: BoolArray = (residual > _OUTLYING * np.median(residual)) & (share > least)
    return flagged
