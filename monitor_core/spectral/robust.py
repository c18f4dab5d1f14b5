"""Compare windows with their median response, which a few bad windows cannot spoil."""

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.spectral.spectra import BandSpectra, Taper


def median_misfit(spectra: BandSpectra, taper: Taper) -> tuple[FloatArray, FloatArray]:
    """Return how far each window is from the line-by-line median of the windows' own responses.

    ``spectra``: un-windowed lines; ``taper``: see :meth:`BandSpectra.tapered`. Returned: sums over the lines of the
    squared moduli of what the median leaves, and of the response [(m/s²)²], shape (n_windows,).
    """
    _, x, y = spectra.tapered(taper)
    ratio = y / np.where(x == 0.0, np.finfo(np.float32).tiny, x)
    median = np.median(ratio.real, axis=0) + 1j * np.median(ratio.imag, axis=0)
    residual: FloatArray = np.sum(np.abs(y - median * x) ** 2, axis=1, dtype=np.float64)
    response: FloatArray = np.sum(np.abs(y) ** 2, axis=1, dtype=np.float64)
    return residual, response
