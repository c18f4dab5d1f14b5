"""Transient-aware maximum-likelihood fit of one or two modes, with covariance."""

import math
from dataclasses import dataclass

import numpy as np
import scipy.stats

from monitor_core.arrays import FloatArray
from monitor_core.modal.model import ModelOrder, basis_of, cost_at, normalised_frequency, pole_factor
from monitor_core.modal.starts import start_one_mode, start_two_modes
from monitor_core.modal.tones import strongest_tone
from monitor_core.modal.variable_projection import Solution, degrees_of_freedom, minimise
from monitor_core.recording import Rejection, RejectionReason
from monitor_core.response import ModalParameters
from monitor_core.spectral import BandSpectra
from monitor_core.uncertainty import Estimate

_LEAST_HALF_WIDTH = 20.0  # [Hz]
_LEAST_HALF_POWER_BANDWIDTHS = 4.0
_LEAST_LINES = 10  # on either side
_MAXIMUM_TONES = 2
_SCREENING_PROBABILITY = 0.01
_PASSES = 3


@dataclass(frozen=True, slots=True, eq=False)
class ModeFit:
    """Modes of one fit, the one asked for first, and what the fit leaves of each window."""

    modes: tuple[ModalParameters, ...]
    tones: tuple[float, ...]  # persistent sines removed [Hz]
    formal_covariance: FloatArray  # of (f, ζ) of the first mode, from the noise left [Hz², Hz, 1]
    between_window_covariance: FloatArray | None  # the same from the windows' own scatter; None for one window
    band: tuple[float, float]  # [Hz]
    solution: Solution  # poles and polynomial that explain a window, see window_misfit

    @property
    def noise_variance(self) -> float:
        """Variance of the complex noise of one line. [(m/s²)²]"""
        return self.solution.noise_variance


def window_misfit(fit: ModeFit, spectra: BandSpectra) -> tuple[FloatArray, FloatArray]:
    """Return what a fit leaves of windows, be they among those it was made from or not.

    Each window keeps its own transient and tone amplitudes; poles and B are those of the fit.

    Parameters
    ----------
    fit : ModeFit
        Modes of the axis.
    spectra : BandSpectra
        Un-windowed lines over at least the band of the fit.

    Returns
    -------
    tuple of ndarray, shape (n_windows,)
        Sums of squared moduli of the residual and of the response in the band of the fit. [(m/s²)²]
    """
    lines = _in_double_precision(spectra.within(*fit.band))
    basis = basis_of(lines, fit.solution.parameters, fit.solution.order)
    forced = (fit.solution.projection.response_coefficients @ basis.response_terms) * lines.excitation
    residual = basis.annul(lines.response - forced)
    return np.sum(np.abs(residual) ** 2, axis=1), np.sum(np.abs(lines.response) ** 2, axis=1)


def fit_modes(
    spectra: BandSpectra, *, frequency: float, damping_ratio: float, maximum_modes: int = 2
) -> ModeFit | Rejection:
    r"""Fit natural frequency and damping with all that rings, drifts or hums taken into account.

    Maximum likelihood for white noise on the response: with the un-windowed lines :math:`U_s, Y_s` of every window,

    .. math:: \min \sum_s \Bigl\| Y_s - \frac{B}{A} U_s - \frac{T_s}{A} \Bigr\|^2,\qquad
        A(f) = \prod_i (f_i^2 - f^2 + 2 j \zeta_i f_i f)

    over poles in ``A``, one polynomial ``B`` of degree 2 n for the axis and one ``T`` of degree 2 n − 1 for each
    window. The polynomials are projected out (variable projection [1]_ with Kaufman's Jacobian); Levenberg–Marquardt
    finds the poles. The band is ± 20 Hz, or ± 4 half-power bandwidths, or ± 10 lines, whichever is widest. A sine
    that no excitation explains joins the terms of the windows, its frequency the poles. A second mode is tried where
    the first leaves something that the excitation explains, and kept if the Bayesian information criterion says so.

    Parameters
    ----------
    spectra : BandSpectra
        Un-windowed lines of a band wide enough for the fit.
    frequency : float
        Where to start, e.g. a candidate peak. [Hz]
    damping_ratio : float
        Where to start; a factor of three off does no harm. [-]
    maximum_modes : int
        1 or 2.

    Returns
    -------
    ModeFit or Rejection
        ``FIT_FAILED`` if there are too few lines or no optimum near the start.

    Notes
    -----
    The formal covariance :math:`\tfrac12\sigma^2 (\mathrm{Re}\,J^H J)^{-1}` is right if the noise is white and on the
    response alone. Noise on the torque makes it too small; the scatter of the windows' own pulls on the estimate
    (sandwich covariance) does not rest on that. The larger of the two is stated.

    References
    ----------
    .. [1] G. Golub, V. Pereyra, Separable nonlinear least squares: the variable projection method and its
       applications, Inverse Problems 19 (2003) R1-R26.
    """
    start = (frequency, damping_ratio)
    for _ in range(_PASSES):
        half_width = _half_width(*start, spectra.resolution)
        lines = _in_double_precision(spectra.within(start[0] - half_width, start[0] + half_width))
        solution = _likeliest(lines, start, maximum_modes)
        if solution is None:
            return Rejection(
                RejectionReason.FIT_FAILED,
                f"no maximum of the likelihood near {frequency:.6g} Hz in {lines.frequency.size} lines "
                f"of {lines.n_windows} windows",
            )
        fit = _mode_fit(lines, solution, frequency)
        start = (fit.modes[0].frequency.value, fit.modes[0].damping_ratio.value)
        # The band follows the damping found, if the start had it wrong by more than a quarter.
        if 0.8 < _half_width(*start, spectra.resolution) / half_width < 1.25:
            break
    return fit


def _half_width(frequency: float, damping_ratio: float, resolution: float) -> float:
    half_power_bandwidth = 2.0 * damping_ratio * frequency
    return max(_LEAST_HALF_WIDTH, _LEAST_HALF_POWER_BANDWIDTHS * half_power_bandwidth, _LEAST_LINES * resolution)


def _in_double_precision(spectra: BandSpectra) -> BandSpectra:
    return BandSpectra(
        spectra.frequency,
        spectra.excitation.astype(np.complex128),
        spectra.response.astype(np.complex128),
        spectra.n_samples,
        spectra.sample_rate,
    )


def _likeliest(lines: BandSpectra, start: tuple[float, float], maximum_modes: int) -> Solution | None:
    """Choose between one and two modes, each with the tones it needs."""
    if degrees_of_freedom(lines, ModelOrder(1)) <= 0:
        return None
    one_mode = minimise(lines, start_one_mode(lines, *start), ModelOrder(1))
    if one_mode is None:
        return None
    one_mode = _with_tones(lines, one_mode)
    if maximum_modes < 2 or not _leaves_response(lines, one_mode):
        return one_mode
    two_modes = _fit_two_modes(lines, one_mode)
    if two_modes is None or not _second_mode_preferred(lines, one_mode, two_modes):
        return one_mode
    return two_modes


def _with_tones(lines: BandSpectra, solution: Solution) -> Solution:
    """Add significant sines one at a time and fit everything again."""
    for _ in range(_MAXIMUM_TONES):
        tone = strongest_tone(lines, solution)
        if tone is None:
            break
        order = ModelOrder(solution.order.n_modes, solution.order.n_tones + 1)
        more = minimise(lines, np.append(solution.parameters, tone), order)
        if more is None or more.bic > solution.bic:
            break
        solution = more
    return solution


def _leaves_response(lines: BandSpectra, one_mode: Solution) -> bool:
    """Tell whether a richer B at the same pole explains significantly more (F-test); cheap, nothing is searched."""
    plain = ModelOrder(1, one_mode.order.n_tones, transient_modes=2)
    richer = ModelOrder(1, one_mode.order.n_tones, response_modes=2, transient_modes=2)
    dof = degrees_of_freedom(lines, richer)
    n_more = 2 * (richer.n_response_terms - plain.n_response_terms)
    if dof <= 0:
        return False
    cost, richer_cost = (cost_at(lines, one_mode.parameters, order) for order in (plain, richer))
    ratio = (cost - richer_cost) / n_more / (richer_cost / dof)
    return bool(ratio > scipy.stats.f.isf(_SCREENING_PROBABILITY, n_more, dof))


def _fit_two_modes(lines: BandSpectra, one_mode: Solution) -> Solution | None:
    order = ModelOrder(2)
    if degrees_of_freedom(lines, order) <= 0:
        return None
    starts = start_two_modes(lines, one_mode.parameters[:2])
    found = [solution for start in starts if (solution := minimise(lines, start, order)) is not None]
    if not found:
        return None
    return _with_tones(lines, min(found, key=lambda solution: solution.projection.cost))


def _second_mode_preferred(lines: BandSpectra, one_mode: Solution, two_modes: Solution) -> bool:
    """Compare by BIC, with the same transient terms in both: those of the windows must not decide about the axis."""
    order = ModelOrder(1, one_mode.order.n_tones, transient_modes=2)
    alternative = minimise(lines, one_mode.parameters, order)
    return alternative is None or two_modes.bic < alternative.bic


def _mode_fit(lines: BandSpectra, solution: Solution, asked: float) -> ModeFit:
    """Put the mode that makes the peak asked for first and attach the covariances."""
    formal, between = _covariances(solution)
    modes = [_modal_parameters(lines, solution, i, formal, between) for i in range(solution.order.n_modes)]
    share = [abs(mode.residue / pole_factor(asked, *pole)) for mode, pole in zip(modes, solution.modes, strict=True)]
    ranked = sorted(range(len(modes)), key=lambda i: -share[i])
    first = np.ix_(*2 * [[2 * ranked[0], 2 * ranked[0] + 1]])
    return ModeFit(
        modes=tuple(modes[i] for i in ranked),
        tones=tuple(float(tone) for tone in solution.tones),
        formal_covariance=formal[first],
        between_window_covariance=None if between is None else between[first],
        band=(float(lines.frequency[0]), float(lines.frequency[-1])),
        solution=solution,
    )


def _covariances(solution: Solution) -> tuple[FloatArray, FloatArray | None]:
    """Return formal and between-window covariance of frequencies and damping ratios (ln ζ turned into ζ)."""
    to_ratio = np.ones(solution.order.n_nonlinear)
    to_ratio[1 : 2 * solution.order.n_modes : 2] = solution.modes[:, 1]
    inverse = np.linalg.inv(solution.normal_matrix) * np.outer(to_ratio, to_ratio)
    formal: FloatArray = 0.5 * solution.noise_variance * inverse
    residual = solution.projection.residual
    n_windows = residual.shape[0]
    if n_windows < 2:
        return formal, None
    pulls = np.einsum("pwf,wf->pw", solution.projection.jacobian.conj(), residual).real / to_ratio[:, None]
    between: FloatArray = inverse @ (pulls @ pulls.T) @ inverse * n_windows / (n_windows - 1)
    return formal, between


def _modal_parameters(
    lines: BandSpectra, solution: Solution, mode: int, formal: FloatArray, between: FloatArray | None
) -> ModalParameters:
    i, j = 2 * mode, 2 * mode + 1
    covariance, dof = formal, float(solution.degrees_of_freedom)
    if between is not None and between[i, i] > formal[i, i]:
        covariance, dof = between, float(solution.projection.residual.shape[0] - 1)
    fn, zeta = solution.modes[mode]
    others = np.prod([pole_factor(fn, *other) for k, other in enumerate(solution.modes) if k != mode])
    b = np.polynomial.polynomial.polyval(
        normalised_frequency(fn, lines.frequency), solution.projection.response_coefficients
    )
    return ModalParameters(
        frequency=Estimate(float(fn), math.sqrt(covariance[i, i]), dof),
        damping_ratio=Estimate(float(zeta), math.sqrt(covariance[j, j]), dof),
        frequency_damping_covariance=float(covariance[i, j]),
        residue=complex(-b / others),
    )
