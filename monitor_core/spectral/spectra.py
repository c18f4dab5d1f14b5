"""Compute spectra of windows in a band, tapered in the frequency domain, and predict them for a known excitation.

Under a Hann window a spectrum is a weighted sum over neighbouring lines.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
import scipy

from monitor_core.arrays import ComplexArray, FloatArray, SampleArray
from monitor_core.errors import OutsideValidityError
from monitor_core.response import LineSpread
from monitor_core.spectral.motion import differenced, exact_derivative

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

    The excitation [N·m or N], shape (n_windows, n_samples), is that of the windows that were averaged; the frequencies
    [Hz], shape (n_lines,), are lines of the estimate, whole multiples of 1/T. ``OutsideValidityError`` if one is no
    line of these windows.

    What the result says errs by some 0.4 % at a peak three lines wide between its half-power points, and by 1 % at one
    and a half; of a peak one line wide after a pulse late in the window, by 3 %. Halves of a line belong to a record
    that is continued by as many zeros, in which what still rings two windows after the beginning comes around to it:
    motion must have died away within a window after the last move.
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


#: Raw lines keep the precision of the samples: float32 gives complex64.
SpectrumArray = npt.NDArray[np.complex64] | npt.NDArray[np.complex128]
Taper = Literal["hann", "rectangular"]
TAPERS: tuple[Taper, ...] = ("hann", "rectangular")

#: Of a line: a band edge meant to lie on a line must not miss it by rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class BandSpectra:
    """Un-windowed DFT lines of excitation and response, one row per window.

    The rectangular window is kept on purpose: the same lines serve the Hann-tapered average
    (:meth:`tapered`) and the transient-aware fit of :mod:`monitor_core.modal`, which needs lines whose noise is
    independent from one to the next.
    """

    frequency: FloatArray  # neighbouring lines, shape (n_frequencies,) [Hz]
    excitation: SpectrumArray  # shape (n_windows, n_frequencies) [unit of excitation]
    response: SpectrumArray  # shape (n_windows, n_frequencies) [m/s²]
    n_samples: int  # in each window
    sample_rate: float  # [Hz]
    derivatives: int = 0  # that were taken of what the sensor measures

    def __post_init__(self) -> None:
        expected = (self.excitation.shape[0], self.frequency.size)
        if self.excitation.shape != expected or self.response.shape != expected:
            raise OutsideValidityError(
                f"excitation and response must have shape (n_windows, {self.frequency.size}); "
                f"got {self.excitation.shape} and {self.response.shape}"
            )
        for array in (self.frequency, self.excitation, self.response):
            array.setflags(write=False)

    @property
    def n_windows(self) -> int:
        """Number of windows."""
        return int(self.excitation.shape[0])

    @property
    def resolution(self) -> float:
        """Distance of two lines in hertz."""
        return self.sample_rate / self.n_samples

    def within(self, low: float, high: float) -> "BandSpectra":
        """Return the lines from ``low`` to ``high`` in hertz, both included."""
        slack = _ROUNDING * self.resolution
        start, stop = np.searchsorted(self.frequency, [low - slack, high + slack])
        lines = slice(int(start), int(stop))
        return replace(
            self,
            frequency=self.frequency[lines],
            excitation=self.excitation[:, lines],
            response=self.response[:, lines],
        )

    def around(self, low: float, high: float) -> "BandSpectra":
        """Return the lines that :func:`band_spectra` keeps of this band in hertz, as far as they are here."""
        held = range(round(self.frequency[0] / self.resolution), round(self.frequency[-1] / self.resolution) + 1)
        first, last = _lines_around(low, high, self.resolution, self.n_samples)
        lines = slice(max(first - held.start, 0), last + 1 - held.start)
        return replace(
            self,
            frequency=self.frequency[lines],
            excitation=self.excitation[:, lines].copy(),
            response=self.response[:, lines].copy(),
        )

    def of_windows(self, kept: npt.NDArray[np.bool_]) -> "BandSpectra":
        """Return the windows for which ``kept`` is true, shape (n_windows,)."""
        return self if kept.all() else replace(self, excitation=self.excitation[kept], response=self.response[kept])

    def tapered(self, taper: Taper) -> tuple[FloatArray, SpectrumArray, SpectrumArray]:
        r"""Taper both channels after the transform.

        The periodic Hann window, times two, is

        .. math:: X_h(k) = X(k) - \tfrac12\,[X(k-1) + X(k+1)]

        and uses up the outermost line on either side. The rectangular one drops the same two lines. Hann is for what
        goes on across the ends of the window, rectangular for an impact that rings out inside it: a hit near an end is
        all but erased by Hann. Returned are the frequency [Hz], shape (n_frequencies − 2,), and excitation and
        response, shape (n_windows, n_frequencies − 2).
        """
        inner = self.frequency[1:-1]
        if taper == "rectangular":
            return inner, self.excitation[:, 1:-1], self.response[:, 1:-1]
        return inner, _hann(self.excitation), _hann(self.response)


def band_spectra(
    excitation: SampleArray, response: SampleArray, sample_rate: float, band: tuple[float, float]
) -> BandSpectra:
    """Transform windows of two channels and keep the lines of a band with one more on either side.

    One batched real FFT per channel, in the precision of the samples. The extra line is what the Hann taper in the
    frequency domain needs. The mean of each window is removed with the line at 0 Hz.

    Excitation [N·m or N] and response [m/s²] have the shape (n_windows, n_samples); rate and band are in hertz. The
    lines reach from one below to one above the band, as far as they exist. ``OutsideValidityError`` if the channels
    differ in shape, or the band holds no line between 0 Hz and half the sampling rate.

    Examples
    --------
    A cosine of amplitude 2 on line 3 of 16 samples has the line 2·16/2 there:

    >>> import numpy as np
    >>> cosine = 2.0 * np.cos(2 * np.pi * 3 * np.arange(16) / 16)[None, :]
    >>> spectra = band_spectra(cosine, cosine, 16.0, (2.0, 4.0))
    >>> spectra.frequency.tolist(), np.round(np.abs(spectra.response), 12).tolist()
    ([1.0, 2.0, 3.0, 4.0, 5.0], [[0.0, 0.0, 16.0, 0.0, 0.0]])
    """
    if excitation.ndim != 2 or excitation.shape != response.shape:
        raise OutsideValidityError(
            "excitation and response must be of one shape (n_windows, n_samples); "
            f"got {excitation.shape} and {response.shape}"
        )
    low, high = band
    n_samples = excitation.shape[1]
    resolution = sample_rate / n_samples
    first, last = _lines_around(low, high, resolution, n_samples)
    if not (0.0 <= low < high <= sample_rate / 2) or last - first < 2:
        raise OutsideValidityError(
            f"band must rise, hold a line of {resolution:g} Hz and lie between 0 and {sample_rate / 2:g} Hz; "
            f"got {low:g} to {high:g} Hz"
        )
    lines = slice(first, last + 1)
    # contiguous copies of the band, so that the rest of the transform is freed
    spectra = [np.ascontiguousarray(scipy.fft.rfft(channel, axis=1)[:, lines]) for channel in (excitation, response)]
    if first == 0:
        for spectrum in spectra:
            spectrum[:, 0] = 0.0
    return BandSpectra(np.arange(first, last + 1) * resolution, spectra[0], spectra[1], n_samples, sample_rate)


def motion_spectra(
    excitation: SampleArray,
    response: SampleArray,
    sample_rate: float,
    band: tuple[float, float],
    *,
    derivatives: int,
) -> BandSpectra:
    """Transform windows as :func:`band_spectra` does, the response differentiated so many times until it is in m/s².

    See :mod:`monitor_core.spectral.motion`.
    """
    spectra = band_spectra(excitation, differenced(response, sample_rate, derivatives), sample_rate, band)
    if derivatives == 0:
        return spectra
    exact = spectra.response * exact_derivative(spectra.frequency, sample_rate, derivatives)
    return replace(spectra, response=exact, derivatives=derivatives)


def _lines_around(low: float, high: float, resolution: float, n_samples: int) -> tuple[int, int]:
    """Return the numbers of the first and the last line of a band with one more on either side."""
    first = max(int(np.ceil(low / resolution - _ROUNDING)) - 1, 0)
    return first, min(int(np.floor(high / resolution + _ROUNDING)) + 1, n_samples // 2)


def _hann(lines: SpectrumArray) -> SpectrumArray:
    tapered = lines[:, :-2] + lines[:, 2:]
    tapered *= -0.5
    tapered += lines[:, 1:-1]
    return tapered
