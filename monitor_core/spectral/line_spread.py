"""Predict what Hann windows of a known excitation show of a response: a weighted sum over neighbouring lines."""

import numpy as np
import numpy.typing as npt
import scipy.fft

from monitor_core.arrays import ComplexArray, FloatArray, SampleArray
from monitor_core.errors import OutsideValidityError
from monitor_core.response import LineSpread

#: In halves of a line, the line itself first. Beyond one line a periodic Hann window lets whole ones through no more;
#: what the halves beyond the last would add is below 0.4 % of a peak three lines wide.
_STEPS = np.array([0, *(sign * step for step in (1, 2, *range(3, 16, 2)) for sign in (-1, 1))])


def line_spread(excitation: SampleArray, sample_rate: float, frequency: FloatArray) -> LineSpread:
    r"""Return what H1 over Hann windows of this excitation shows of any response to it.

    A short move within a window is weighed by the window where it is, and the ringing that follows it where that is, so
    that the estimate is not the response even without any noise: lower at a peak where moves lie in the second half of
    the window, higher where they lie in the first. With the un-windowed excitation X in halves of a line, its tapered
    lines :math:`X_w` and the transform W of the window,

    .. math::

        \bar H(f) = \sum_\nu w_\nu(f) H(f - \nu), \qquad
        w_\nu(f) \propto \sum_s X_{w,s}^*(f)\, W(\nu)\, X_s(f - \nu), \qquad \sum_\nu w_\nu = 1

    for an axis that was at rest before the window, or under the median of the excitation since long. Of an excitation
    that is flat around a line the weights are, in expectation, :math:`|W|^2`.

    ``excitation``: torque or force of the windows that were averaged [N·m or N], shape (n_windows, n_samples);
    ``sample_rate``: [Hz]; ``frequency``: lines of the estimate, whole multiples of 1/T [Hz], shape (n_lines,).
    Returned: what it says errs by some 0.4 % at a peak three lines wide between its half-power points, and by 1 %
    at one and a half; of a peak one line wide after a pulse late in the window, by 3 %. ``OutsideValidityError`` if
    a frequency is no line of these windows.

    Notes
    -----
    Halves of a line belong to a record that is continued by as many zeros, in which what still rings two windows after
    the beginning comes around to it: motion must have died away within a window after the last move.
    """
    n_samples = excitation.shape[1]
    resolution = sample_rate / n_samples
    line = np.rint(frequency / resolution).astype(np.intp)
    offset = np.abs(frequency - line * resolution)
    if np.max(offset, initial=0.0) > 1e-6 * resolution:
        raise OutsideValidityError(
            f"lines of these windows are whole multiples of {resolution:g} Hz; got {frequency[np.argmax(offset)]:g} Hz"
        )
    since_rest = excitation - np.median(excitation, axis=1, keepdims=True)
    halves = scipy.fft.fft(since_rest, 2 * n_samples, axis=1)
    tapered = (halves[:, 2 * line] - 0.5 * (halves[:, 2 * line - 2] + halves[:, 2 * line + 2])).conj()
    cross: ComplexArray = np.array([np.sum(tapered * halves[:, 2 * line + step], axis=0) for step in _STEPS])
    weights = _hann_between(-_STEPS, n_samples)[:, None] * cross
    return LineSpread(0.5 * resolution * _STEPS, weights / np.sum(weights, axis=0))


def _hann_between(steps: npt.NDArray[np.intp], n_samples: int) -> npt.NDArray[np.complex128]:
    """Return the transform of the periodic Hann window at halves of a line, shape (n_steps,)."""
    turns = np.arange(n_samples) / n_samples
    window = 1.0 - np.cos(2.0 * np.pi * turns)
    return np.asarray(np.exp(-1j * np.pi * np.outer(steps, turns)) @ window)
