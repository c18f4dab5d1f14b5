"""What Hann windows of a known excitation show of a response: a weighted sum of it beside each line."""

import numpy as np
import numpy.typing as npt
import scipy.fft

from monitor_core.arrays import ComplexArray, FloatArray, SampleArray
from monitor_core.errors import OutsideValidityError
from monitor_core.response import LineSpread

#: In halves of a line, to either side: with so many the peak of a mode 3 lines wide is shown to 0.2 %, with 8 to 1 %.
_HALF_LINES = 16


def line_spread(excitation: SampleArray, sample_rate: float, frequency: FloatArray) -> LineSpread:
    r"""Return what H1 over Hann windows of this excitation shows of any response to it.

    A short move within a window is weighed by the window where it is, and the ringing that follows it where that is, so
    that the estimate is not the response even without any noise: lower at a peak where moves lie in the second half of
    the window, higher where they lie in the first. With the un-windowed excitation X in halves of a line, its tapered
    lines :math:`X_w` and the transform W of the window,

    .. math:: \bar H(f) = \sum_\nu \frac{\sum_s X_{w,s}^*(f)\, W(\nu)\, X_s(f - \nu)}{\sum_s |X_{w,s}(f)|^2} H(f - \nu)

    for an axis that was at rest before the window, or under the median of the excitation since long. Halves of a line
    belong to a record that is continued by as many zeros: an impulse response may last twice a window, and no longer.
    Of an excitation that is flat around a line the weights are, in expectation, :math:`|W|^2`.

    Parameters
    ----------
    excitation : ndarray, shape (n_windows, n_samples)
        Torque or force of the windows that were averaged. [N·m or N]
    sample_rate : float
        [Hz]
    frequency : ndarray, shape (n_lines,)
        Lines of the estimate, whole multiples of 1/T. [Hz]

    Returns
    -------
    LineSpread
        With weights that sum to one: of a constant response an estimate is that constant.

    Raises
    ------
    OutsideValidityError
        If a frequency is no line of these windows.
    """
    n_samples = excitation.shape[1]
    resolution = sample_rate / n_samples
    line = np.rint(frequency / resolution).astype(np.intp)
    if not np.allclose(frequency, line * resolution, rtol=0.0, atol=1e-6 * resolution):
        raise OutsideValidityError(f"lines of these windows are whole multiples of {resolution:g} Hz; got others")
    since_rest = excitation - np.median(excitation, axis=1, keepdims=True)
    halves = scipy.fft.fft(since_rest, 2 * n_samples, axis=1)
    tapered = (halves[:, 2 * line] - 0.5 * (halves[:, 2 * line - 2] + halves[:, 2 * line + 2])).conj()
    steps = np.array([0, *(sign * step for step in range(1, _HALF_LINES + 1) for sign in (-1, 1))])
    cross: ComplexArray = np.array([np.sum(tapered * halves[:, 2 * line + step], axis=0) for step in steps])
    weights = _hann_between(-steps, n_samples)[:, None] * cross
    return LineSpread(0.5 * resolution * steps, weights / np.sum(weights, axis=0))


def _hann_between(steps: npt.NDArray[np.intp], n_samples: int) -> npt.NDArray[np.complex128]:
    """Return the transform of the periodic Hann window at halves of a line, shape (n_steps,)."""
    turns = np.arange(n_samples) / n_samples
    window = 1.0 - np.cos(2.0 * np.pi * turns)
    return np.asarray(np.exp(-1j * np.pi * np.outer(steps, turns)) @ window)
