"""Estimate frequency response and ordinary coherence from averaged spectra.

Windows are compared with their median response, which a few bad windows cannot spoil. In a control loop a reference
takes off what the loop does (:func:`joint_input_output`).
"""

from dataclasses import dataclass, replace
from typing import Literal, assert_never

import numpy as np

from monitor_core.arrays import BoolArray, ComplexArray, FloatArray, SampleArray
from monitor_core.errors import OutsideValidityError
from monitor_core.response import FrequencyResponse
from monitor_core.spectral.motion import differenced
from monitor_core.spectral.spectra import TAPERS, BandSpectra, Taper, band_spectra


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


#: A window is outlying if it leaves this many times the median misfit, both in absolute terms (or it would do no harm)
#: and relative to its own response (or it is merely a strong one): three times in amplitude.
_OUTLYING = 9.0


def outlying(residual: FloatArray, response: FloatArray, *, least_share: float = 0.0) -> BoolArray:
    """Tell which windows leave far more unexplained than the others, shape (n_windows,): they do not belong.

    ``residual`` and ``response`` are sums of squared moduli of what is left of each window and of its response
    [(m/s²)²]. Windows of which less than ``least_share`` is left are never outlying.
    """
    share = residual / np.maximum(response, np.finfo(np.float64).tiny)
    least = max(_OUTLYING * float(np.median(share)), least_share)
    flagged: BoolArray = (residual > _OUTLYING * np.median(residual)) & (share > least)
    return flagged


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


#: A position that is commanded leaks into all lines, its second difference does not; others lose nothing by it.
_DIFFERENCES = 2


def joint_input_output(spectra: BandSpectra, reference: SampleArray, band: tuple[float, float]) -> BandSpectra:
    r"""Return spectra whose H1 is the response in a control loop, by a reference that the control was told.

    The torque of a drive answers what disturbs its axis: friction, cogging, cutting. Then
    :math:`H_1 = S_{uy}/S_{uu}` lies between the response that is looked for and one of the controller, with a good
    coherence all the same. What is common with a reference r from outside of the loop is free of that [1]_:

    .. math:: \hat H = \frac{S_{ry}}{S_{ru}}

    H1 takes such a value of the part of the excitation that follows the reference, and of the response less what the
    rest of the excitation makes of it,

    .. math:: u' = \Bigl(\frac{S_{ru}}{S_{rr}}\Bigr)_{-s}\, r, \qquad y' = y - \hat H\,(u - u'), \qquad
        \hat H = \frac{S_{u'y}}{S_{u'u}}

    and what these leave, :math:`y' - \hat H u' = y - \hat H u`, is what the axis does without its drive, not what the
    loop leaves of it: coherence, random error and a fit of modes hold as in an open loop, as those of an instrumental
    variable [2]_. How the excitation of a window s follows is taken from the others: its own disturbance would else
    lend 1/n of the bias of H1 to the mean of n windows [3]_.

    The spectra are those of :func:`~monitor_core.spectral.motion_spectra` in a band [Hz]; the reference, in any unit,
    has the samples of the windows, shape (n_windows, n_samples). A line at which it has no power says nothing: there u'
    is 0. So it is in a window whose reference is :func:`outlying` against the excitation, as after a sample that was
    lost: it cannot be followed, would outweigh the other windows and be coherent with itself.

    References
    ----------
    .. [1] P. E. Wellstead, Non-parametric methods of system identification, Automatica 17 (1981) 55-69.
    .. [2] T. Söderström, P. Stoica, System Identification, Prentice Hall, 1989, chapter 8.
    .. [3] J. D. Angrist, G. W. Imbens, A. B. Krueger, Jackknife instrumental variables estimation, J. Appl.
       Econometrics 14 (1999) 57-67.
    """
    steps = differenced(reference, spectra.sample_rate, _DIFFERENCES)
    r = band_spectra(steps, steps, spectra.sample_rate, band).excitation
    r, x, y = (lines.astype(np.complex128) for lines in (r, spectra.excitation, spectra.response))
    lost = outlying(np.sum(np.abs(r) ** 2, axis=1), np.sum(np.abs(x) ** 2, axis=1))
    r = np.where(lost[:, np.newaxis], 0.0, r)
    power, common = np.abs(r) ** 2, r.conj() * x
    power_of_others, common_of_others = power.sum(axis=0) - power, common.sum(axis=0) - common
    has_power = np.all(power_of_others > _LEAST_POWER * np.mean(power_of_others), axis=0)
    follows = np.where(has_power, common_of_others / np.where(has_power, power_of_others, 1.0), 0.0) * r
    to_excitation, to_response = (np.sum(follows.conj() * of, axis=0) for of in (x, y))
    response = to_response / np.where(to_excitation == 0.0, 1.0, to_excitation)
    return replace(spectra, excitation=follows, response=y - response * (x - follows))
