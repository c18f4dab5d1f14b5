"""Judge a coherence that :mod:`monitor_core.spectral.frf` estimated: its bias, significance and random errors.

``n_averages`` is everywhere the number of independent averages [-]; fewer than two raise ``OutsideValidityError``.
"""

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.spectral.spectra import Taper


def coherence_bias(coherence: FloatArray | float, n_averages: float) -> FloatArray:
    r"""Return how much too high an estimated coherence is on average.

    .. math:: b[\hat\gamma^2] \approx \frac{1}{n}\,(1-\gamma^2)^2\,\Bigl(1 + \frac{2\gamma^2}{n}\Bigr)

    Carter, Knapp and Nuttall [1]_, Eq. (5), where γ² is the true ordinary coherence.

    Examples
    --------
    Two unrelated channels, ten averages: exactly 1/n.

    >>> float(coherence_bias(0.0, 10))
    0.1

    References
    ----------
    .. [1] G. C. Carter, C. H. Knapp, A. H. Nuttall, Estimation of the magnitude-squared coherence function via
       overlapped fast Fourier transform processing, IEEE Trans. Audio Electroacoust. 21 (1973) 337-344.
    """
    n = _at_least_two(n_averages)
    g = np.asarray(coherence, dtype=np.float64)
    return (1.0 - g) ** 2 * (1.0 + 2.0 * g / n) / n


def significance_level(n_averages: float, *, false_alarm_probability: float = 0.05) -> float:
    r"""Return the coherence that two unrelated channels exceed with a given probability.

    .. math:: \gamma^2_\alpha = 1 - \alpha^{1/(n-1)}

    Exact for Gaussian channels, [1]_ Eq. (9); α is the false-alarm probability.

    Examples
    --------
    >>> round(significance_level(15), 3)
    0.193

    References
    ----------
    .. [1] G. C. Carter, Coherence and time delay estimation, Proc. IEEE 75 (1987) 236-255.
    """
    return float(1.0 - false_alarm_probability ** (1.0 / (_at_least_two(n_averages) - 1.0)))


def random_error(coherence: FloatArray | float, n_averages: float) -> FloatArray:
    r"""Return the relative random error of an H1 magnitude, which is also the standard deviation of its phase.

    .. math::

        \varepsilon[|\hat H|] = \frac{\sqrt{1-\gamma^2}}{|\gamma|\sqrt{2n}},\qquad
        \sigma[\hat\varphi] \approx \varepsilon[|\hat H|]

    Bendat and Piersol [1]_, Eqs. (9.90) and (9.91), first order, good while it is below about 0.2, for an ordinary
    coherence γ² above 0; as the deviation of the phase it is in radians.

    Examples
    --------
    >>> round(float(random_error(0.8, 50)), 3)
    0.05

    References
    ----------
    .. [1] J. S. Bendat, A. G. Piersol, Random Data, 4th ed., Wiley, 2010.
    """
    g = np.asarray(coherence, dtype=np.float64)
    return np.sqrt((1.0 - g) / (2.0 * _at_least_two(n_averages) * g))


def effective_averages(n_windows: int, overlap: float = 0.0, *, taper: Taper = "hann") -> float:
    r"""Return how many independent averages a number of overlapped, tapered windows is worth.

    .. math:: n_e = \frac{n}{1 + 2\sum_{i\ge 1} (1 - i/n)\,\rho_i},\qquad
        \rho_i = \Bigl[\frac{\int w(t)\,w(t + i(1-o)T)\,dt}{\int w^2\,dt}\Bigr]^2

    Welch [1]_, for a white record. Separate windows are worth their number, overlapped ones less. The overlap o is the
    share of a window w that the next one repeats; ``OutsideValidityError`` if it does not lie from 0 to below 1.

    Examples
    --------
    Half-overlapped Hann, the classical ρ₁ = 1/36:

    >>> round(effective_averages(30, 0.5), 2)
    28.47

    References
    ----------
    .. [1] P. D. Welch, The use of fast Fourier transform for the estimation of power spectra, IEEE Trans. Audio
       Electroacoust. 15 (1967) 70-73.
    """
    if not 0.0 <= overlap < 1.0:
        raise OutsideValidityError(f"overlap must lie from 0 to below 1; got {overlap}")
    shift = 1.0 - overlap
    t = (np.arange(4096) + 0.5) / 4096
    energy = float(np.mean(_window(t, taper) ** 2))
    denominator = 1.0
    for i in range(1, n_windows):
        if i * shift >= 1.0:
            break
        product = float(np.mean(_window(t, taper) * _window(t + i * shift, taper)))
        denominator += 2.0 * (1.0 - i / n_windows) * (product / energy) ** 2
    return n_windows / denominator


def band_average(frequency: FloatArray, coherence: FloatArray, band: tuple[float, float]) -> float:
    """Return the mean ordinary coherence over a band [Hz], or at its nearest line if it is narrower than a line.

    Lines [Hz] and coherence have the shape (n_frequencies,).
    """
    inside = (frequency >= band[0]) & (frequency <= band[1])
    if not inside.any():
        inside[np.argmin(np.abs(frequency - 0.5 * (band[0] + band[1])))] = True
    return float(np.mean(coherence[inside]))


def _window(t: FloatArray, taper: Taper) -> FloatArray:
    shape = 0.5 - 0.5 * np.cos(2.0 * np.pi * t) if taper == "hann" else np.ones_like(t)
    return np.where(t < 1.0, shape, 0.0)


def _at_least_two(n_averages: float) -> float:
    if not n_averages >= 2.0:
        raise OutsideValidityError(f"coherence needs at least 2 averages; got {n_averages:g}")
    return float(n_averages)
