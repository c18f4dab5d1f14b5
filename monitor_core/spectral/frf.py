"""Estimate frequency response and ordinary coherence from averaged spectra.

Windows are compared with their median response, which a few bad windows cannot spoil.
"""

from dataclasses import dataclass
from typing import Literal, assert_never

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.response import FrequencyResponse
from monitor_core.spectral.spectra import TAPERS, BandSpectra, Taper


def median_misfit(spectra: BandSpectra, taper: Taper) -> tuple[FloatArray, FloatArray]:
    """Return how far each window is from the line-by-line median of the windows' own responses.

    The two arrays, shape (n_windows,), are sums over the un-windowed lines, after :meth:`BandSpectra.tapered`, of the
    squared moduli of what the median leaves, and of the response, in (m/s²)².
    """
    _, x, y = spectra.tapered(taper)
    ratio = y / np.where(x == 0.0, np.finfo(np.float32).tiny, x)
    median = np.median(ratio.view(ratio.real.dtype), axis=0).view(ratio.dtype)  # of both parts, each for itself
    residual: FloatArray = np.sum(np.abs(y - median * x) ** 2, axis=1, dtype=np.float64)
    response: FloatArray = np.sum(np.abs(y) ** 2, axis=1, dtype=np.float64)
    return residual, response


#: Of the mean power of the lines: what single precision leaves of a line that was not driven lies below.
_LEAST_POWER = 1e-14
Estimator = Literal["H1", "H2", "Hv"]


@dataclass(frozen=True, slots=True, eq=False)
class CrossSpectra:
    """Sums over windows of tapered auto- and cross-powers; the scale common to all three is arbitrary."""

    frequency: FloatArray  # shape (n_frequencies,) [Hz]
    excitation_power: FloatArray  # Σ |X|², shape (n_frequencies,)
    response_power: FloatArray  # Σ |Y|², shape (n_frequencies,)
    cross_power: ComplexArray  # Σ X* Y, shape (n_frequencies,)
    n_windows: int
    taper: Taper = "hann"

    @property
    def n_averages(self) -> float:
        """Independent averages: windows of separate moves share nothing, so each is worth one.

        Of overlapped ones see :func:`monitor_core.spectral.coherence.effective_averages`.
        """
        return float(self.n_windows)

    def __add__(self, other: "CrossSpectra") -> "CrossSpectra":
        """Add the windows of another sum over the same lines."""
        if self.taper != other.taper or not np.array_equal(self.frequency, other.frequency):
            raise OutsideValidityError("sums must be over the same lines, of the same taper")
        return CrossSpectra(
            self.frequency,
            self.excitation_power + other.excitation_power,
            self.response_power + other.response_power,
            self.cross_power + other.cross_power,
            self.n_windows + other.n_windows,
            self.taper,
        )


def cross_spectra(spectra: BandSpectra, *, taper: Taper = "hann") -> CrossSpectra:
    """Sum the tapered powers of windows.

    Window by window (``cross_spectra(first) + cross_spectra(second)``) or all at once give the same numbers, because
    the sums are in double precision whatever the samples were. The taper (see :meth:`BandSpectra.tapered`) uses up the
    outermost two of the raw lines.
    """
    frequency, x, y = spectra.tapered(taper)
    return CrossSpectra(
        frequency,
        np.sum(x.real**2 + x.imag**2, axis=0, dtype=np.float64),
        np.sum(y.real**2 + y.imag**2, axis=0, dtype=np.float64),
        np.sum(x.conj() * y, axis=0, dtype=np.complex128),
        spectra.n_windows,
        taper,
    )


def estimate_frf(cross: CrossSpectra, *, estimator: Estimator = "H1", quantity: str) -> FrequencyResponse:
    r"""Estimate the frequency response and the ordinary coherence.

    .. math::

        H_1 = \frac{S_{xy}}{S_{xx}},\quad H_2 = \frac{S_{yy}}{S_{yx}},\quad
        H_v = \frac{S_{xy}}{|S_{xy}|}\sqrt{\frac{S_{yy}}{S_{xx}}},\quad
        \gamma^2 = \frac{|S_{xy}|^2}{S_{xx} S_{yy}}

    [1]_, sections 6.1 and 9.2. :math:`H_1` is unbiased under noise on the response, :math:`H_2` under noise on the
    excitation, :math:`H_v` (total least squares, both noises alike after scaling) lies between them. The quantity says
    what the ratio is, e.g. ``"torque_accelerance"``. Of a single average the coherence is ``None``: it is 1 whatever
    the data and must not be judged. A line at which a channel has no power but its rounding, as between those of
    a commanded multisine, says nothing and is left out. ``OutsideValidityError`` if all are so.

    References
    ----------
    .. [1] J. S. Bendat, A. G. Piersol, Random Data, 4th ed., Wiley, 2010.
    """
    sxx, sxy = cross.excitation_power, cross.cross_power
    has_power = (sxx > _LEAST_POWER * np.mean(sxx)) & (np.abs(sxy) > 0.0)
    if not has_power.any():
        raise OutsideValidityError("both channels must have power at a line of the band; got none")
    sxx, syy, sxy = sxx[has_power], cross.response_power[has_power], sxy[has_power]
    match estimator:
        case "H1":
            response = sxy / sxx
        case "H2":
            response = syy / sxy.conj()
        case "Hv":
            response = sxy / np.abs(sxy) * np.sqrt(syy / sxx)
        case _:
            assert_never(estimator)
    judged = cross.n_averages > 1.0
    # Schwarz holds up to rounding; a coherence of 1 + 1e-16 would make square roots of 1 − γ² fail.
    coherence = np.minimum(np.abs(sxy) ** 2 / (sxx * syy), 1.0) if judged else None
    return FrequencyResponse(cross.frequency[has_power], response, quantity, coherence, cross.n_averages)


def least_leaking_taper(spectra: BandSpectra) -> Taper:
    """Choose the taper that leaves the higher mean coherence over the un-windowed lines of a band.

    What a window cuts off (ringing across its ends under a rectangular taper) and what a taper erases (an impact near
    an end under Hann) both lower the coherence; nothing about a taper raises it. With a single window there is nothing
    to compare, and Hann is taken.
    """
    return max(TAPERS, key=lambda taper: mean_coherence(spectra, taper)) if spectra.n_windows > 1 else "hann"


def mean_coherence(spectra: BandSpectra, taper: Taper) -> float:
    """Return the mean coherence over all lines but the outermost two; meaningless for a single window."""
    cross = cross_spectra(spectra, taper=taper)
    powers = cross.excitation_power * cross.response_power
    return float(np.mean(np.abs(cross.cross_power) ** 2 / np.maximum(powers, np.finfo(np.float64).tiny)))
