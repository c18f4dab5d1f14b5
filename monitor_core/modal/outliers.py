"""Windows that do not belong: a bad impact among good ones."""

import numpy as np

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.spectral import BandSpectra, Taper

#: A window is outlying if it leaves this many times the median misfit, both in absolute terms (or it would do no harm)
#: and relative to its own response (or it is merely a strong one). Three times in amplitude: among 30 windows of the
#: 12 simulated cells of the estimator study none comes near.
_OUTLYING = 9.0


def outlying(residual: FloatArray, response: FloatArray) -> BoolArray:
    """Tell which windows leave far more unexplained than their fellows.

    Parameters
    ----------
    residual : ndarray, shape (n_windows,)
        What is left of each window, sum of squared moduli. [(m/s²)²]
    response : ndarray, shape (n_windows,)
        Its response, sum of squared moduli. [(m/s²)²]

    Returns
    -------
    ndarray of bool, shape (n_windows,)
        True for a window to be refused.
    """
    share = residual / np.maximum(response, np.finfo(np.float64).tiny)
    flagged: BoolArray = (residual > _OUTLYING * np.median(residual)) & (share > _OUTLYING * np.median(share))
    return flagged


def suspected(spectra: BandSpectra, taper: Taper) -> BoolArray:
    """Tell which windows disagree with the line-by-line median of the windows' own responses.

    A first look that bad windows cannot spoil as long as they are fewer than half. It does not know about ringing from
    before the window, so what it suspects is judged again by the fit made without it.

    Parameters
    ----------
    spectra : BandSpectra
        Un-windowed lines of the search band.
    taper : {"hann", "rectangular"}
        Taper in use.

    Returns
    -------
    ndarray of bool, shape (n_windows,)
        True for a window to be left out at first.
    """
    _, x, y = spectra.tapered(taper)
    ratio = y / np.where(x == 0.0, np.finfo(np.float64).tiny, x)
    median = np.median(ratio.real, axis=0) + 1j * np.median(ratio.imag, axis=0)
    return outlying(np.sum(np.abs(y - median * x) ** 2, axis=1), np.sum(np.abs(y) ** 2, axis=1))
