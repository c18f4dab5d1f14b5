"""Fit one or two modes by maximum likelihood, transients included, and return them with covariance.

The covariance comes from the residual noise and from the scatter between windows.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.modal.model import FitLines, basis_of, normalised_frequency, pole_factor
from monitor_core.modal.selection import leaves_response, likeliest_model, rival_of, stands_out
from monitor_core.modal.variable_projection import Solution, degrees_of_freedom, solution_at
from monitor_core.recording import Rejection, RejectionReason
from monitor_core.response import ModalParameters
from monitor_core.spectral import BandSpectra
from monitor_core.uncertainty import Estimate


def formal_covariance(solution: Solution) -> FloatArray:
    r"""Return :math:`\tfrac12\sigma^2(\mathrm{Re}\,J^H J)^{-1}`, right if the whitened noise is white.

    Of natural frequency [Hz] and damping ratio [-] of each mode, and of the tone frequencies [Hz].
    """
    covariance: FloatArray = 0.5 * solution.noise_variance * _inverse(solution)
    return covariance


def _shared(lines: FitLines, solution: Solution) -> float:
    """Return by what the variance of the mean residual exceeds that of independent windows, 0 at least.

    Windows of one excitation share what distorts their response (friction, play), and n of them know the mode no better
    than one does. Their own scatter does not show it (Pintelon & Schoukens, System Identification, 2nd ed., chapter 4).
    """
    if not lines.repeats:
        return 0.0
    residual = solution.projection.residual
    common = residual.mean(axis=0)
    power = float(np.vdot(residual, residual).real) / lines.n_windows
    return max(0.0, lines.n_windows * float(np.vdot(common, common).real) / power - 1.0)


def between_window_covariance(solution: Solution) -> FloatArray | None:
    r"""Return the covariance that the scatter of the windows' pulls implies (sandwich).

    .. math:: N^{-1}\Bigl(\tfrac{n}{n-1}\sum_s g_s g_s^T\Bigr) N^{-1},\qquad
        N = \mathrm{Re}\,J^H J,\quad g_s = \mathrm{Re}\,J_s^H R_s

    It needs no law of the noise, only that one window's does not know the other's. ``None`` for one window; else in the
    order of :func:`formal_covariance`.
    """
    pulls = _pulls(solution)
    n_windows = pulls.shape[1]
    if n_windows < 2:
        return None
    inverse = _inverse(solution)
    covariance: FloatArray = inverse @ (pulls @ pulls.T) @ inverse * n_windows / (n_windows - 1)
    return covariance


def _pulls(solution: Solution) -> FloatArray:
    """Return the gradient that each window contributes, shape (n_nonlinear, n_windows)."""
    projection = solution.projection
    pulls: FloatArray = np.einsum("pwf,wf->pw", projection.jacobian.conj(), projection.residual).real
    return pulls / _to_ratio(solution)[:, None]


def _inverse(solution: Solution) -> FloatArray:
    to_ratio = _to_ratio(solution)
    inverse: FloatArray = np.linalg.inv(solution.normal_matrix) * np.outer(to_ratio, to_ratio)
    return inverse


def _to_ratio(solution: Solution) -> FloatArray:
    """Return dζ/d ln ζ = ζ at the places of the damping parameters, 1 elsewhere."""
    to_ratio = np.ones(solution.order.n_nonlinear)
    to_ratio[1 : 2 * solution.order.n_modes : 2] = solution.modes[:, 1]
    return to_ratio


#: How far the fit reaches on either side of the mode, whichever is widest. The first tells a weakly damped mode from
#: its surroundings, and ends where the search band does; the others a fit needs.
_LEAST_HALF_WIDTH = 0.1  # of the frequency [-]
_LEAST_HALF_POWER_BANDWIDTHS = 4.0
LEAST_LINES = 10
_PASSES = 3


@dataclass(frozen=True, slots=True, eq=False)
class ModeFit:
    """Modes of one fit, the one asked for first, and what the fit leaves of each window."""

    modes: tuple[ModalParameters, ...]
    tones: tuple[float, ...]  # persistent sines removed [Hz]
    formal_covariance: FloatArray  # of (f, ζ) of the first mode, from the noise left [Hz², Hz, 1]
    between_window_covariance: FloatArray | None  # the same from the windows' own scatter; None for one window
    band: tuple[float, float]  # [Hz]
    weight: FloatArray  # of the lines in the band: one over the noise, 1 at the least noisy [-]
    solution: Solution  # poles and polynomial that explain a window, see window_misfit
    leaves_response: bool  # whether the excitation explains more than one mode does, where no more were asked for
    distortion: float  # standard uncertainty of the frequency by what windows of one excitation share, or 0 [Hz]
    warnings: tuple[str, ...] = ()

    @property
    def random_uncertainty(self) -> float:
        """Of that of the first frequency, what is new in each measurement: no error of the model [Hz]."""
        between = self.between_window_covariance
        variance = float(self.formal_covariance[0, 0])
        return math.sqrt(variance if between is None else max(variance, float(between[0, 0])))


def window_misfit(fit: ModeFit, spectra: BandSpectra) -> tuple[FloatArray, FloatArray]:
    """Return what a fit leaves of windows, whether it was made from them or not, and what they hold in its band.

    Each window keeps its own transient and tone amplitudes; poles and B are those of the fit. Both are sums of squared
    moduli, weighted as in the fit, shape (n_windows,) [(m/s²)²]. The lines must cover the band of the fit.
    """
    lines = FitLines.of(spectra, *fit.band, fit.weight)
    basis = basis_of(lines, fit.solution.parameters, fit.solution.order)
    forced = (fit.solution.projection.response_coefficients @ basis.response_terms) * lines.excitation
    residual = basis.annul(lines.response - forced)
    return np.sum(np.abs(residual) ** 2, axis=1), np.sum(np.abs(lines.response) ** 2, axis=1)


def fit_modes(
    spectra: BandSpectra,
    *,
    frequency: float,
    damping_ratio: float,
    maximum_modes: int = 2,
    band: tuple[float, float] = (0.0, math.inf),
) -> ModeFit | Rejection:
    r"""Fit natural frequency and damping with all that rings, drifts or hums taken into account.

    Maximum likelihood for noise on the response: with the un-windowed lines :math:`U_s, Y_s` of every window,

    .. math:: \min \sum_s \Bigl\| \frac{1}{\sigma} \Bigl(Y_s - \frac{B}{A} U_s - \frac{T_s}{A}\Bigr) \Bigr\|^2,
        \qquad A(f) = \prod_i (f_i^2 - f^2 + 2 j \zeta_i f_i f)

    over poles in ``A``, one polynomial ``B`` of degree 2 n for the axis and one ``T`` of degree 2 n − 1 for each
    window. The polynomials are projected out (variable projection [1]_ with Kaufman's Jacobian); Levenberg–Marquardt
    finds the poles. The noise :math:`\sigma(f)` is taken from the residual of a first fit with white noise
    (:func:`~monitor_core.modal.selection.noise_weight`). The fit reaches ± 4 half-power bandwidths or ± 10 lines,
    whichever is wider, and within the search ``band`` [Hz] at least a tenth of the frequency. A sine that no excitation
    explains joins the terms of the windows, its frequency the poles. A second mode is tried where the first leaves
    something that the excitation explains, and kept if the (quasi-)Bayesian information criterion says so.

    The un-windowed lines are those of a band wide enough for the fit, which starts at the given frequency [Hz], e.g. a
    candidate peak, and damping ratio, where a factor of three off does no harm. At most one or two modes are fitted.
    ``FIT_FAILED`` is the rejection if there are too few lines or no optimum near the start, ``NO_PEAK_IN_BAND`` if
    neither the response to the excitation nor what the windows ring is explained better with the mode than chance does.

    The formal covariance :math:`\tfrac12 (\mathrm{Re}\,J^H J)^{-1}` of the whitened problem is right if the noise is on
    the response alone. Noise on the torque makes it too small; the scatter of the windows' own pulls on the estimate
    (sandwich covariance) does not rest on that. Of frequency and of damping the larger of the two variances is stated,
    each decided for itself, with the correlation of that covariance which gives the frequency's.

    What a richer response would move the mode by joins the uncertainty: it may be an error of the model, and the data
    cannot tell a small one from chance (pretests do not help [2]_). Not where one mode is asked for: what that errs by,
    it erred by in the calibration that asks for it.

    A fit that ends before the width above does, because the lines do, is a warning in the result.

    References
    ----------
    .. [1] G. Golub, V. Pereyra, Separable nonlinear least squares: the variable projection method and its
       applications, Inverse Problems 19 (2003) R1-R26.
    .. [2] H. Leeb, B. M. Pötscher, Model selection and inference: facts and fiction, Econometric
       Theory 21 (2005) 21-59.
    """
    start = (frequency, damping_ratio)
    for _ in range(_PASSES):
        low, high = _reach(*start, spectra.resolution, band)
        lines = FitLines.of(spectra, low, high)
        likeliest = likeliest_model(lines, *start, maximum_modes)
        if likeliest is None:
            return Rejection(
                RejectionReason.FIT_FAILED,
                f"no maximum of the likelihood near {frequency:.6g} Hz in {lines.frequency.size} lines "
                f"of {lines.n_windows} windows",
            )
        lines, solution = likeliest
        fit = _mode_fit(lines, solution, frequency, maximum_modes, _warn_of_cut(lines, low, high))
        if maximum_modes > 1 and low < 0.0:
            fit = _widened_by_rival(lines, solution, fit)
        start = (fit.modes[0].frequency.value, fit.modes[0].damping_ratio.value)
        # The lines follow the damping found, if the start had it wrong by more than a quarter.
        next_low, next_high = _reach(*start, spectra.resolution, band)
        if 0.8 < (next_high - next_low) / (high - low) < 1.25:
            break
    gain, by_chance = stands_out(lines, solution, _place_of(fit.modes[0], solution))
    if gain < by_chance:
        return Rejection(
            RejectionReason.NO_PEAK_IN_BAND,
            f"the peak at {fit.modes[0].frequency.value:.6g} Hz must stand above the noise: a mode there must raise "
            f"twice the log likelihood by {by_chance:.3g}; got {gain:.3g}",
        )
    return fit if maximum_modes < 2 else _widened_by_richer_response(lines, solution, fit)


def _place_of(mode: ModalParameters, solution: Solution) -> int:
    return int(np.argmin(np.abs(solution.modes[:, 0] - mode.frequency.value)))


def _widened_by_rival(lines: FitLines, solution: Solution, fit: ModeFit) -> ModeFit:
    """Add to the uncertainty of a mode whose lines end at 0 Hz what a second one, left out, would move it by."""
    rival = rival_of(lines, solution)
    if rival is None:
        return fit
    mode = fit.modes[0]
    nearest = rival.modes[np.argmin(np.abs(rival.modes[:, 0] - mode.frequency.value))]
    moved = nearest - [mode.frequency.value, mode.damping_ratio.value]
    widened = replace(
        mode,
        frequency=_widened(mode.frequency, float(moved[0])),
        damping_ratio=_widened(mode.damping_ratio, float(moved[1])),
    )
    warning = (
        f"the lines end at 0 Hz, and do not tell whether there is a second mode: it would move the frequency by "
        f"{moved[0]:+.2g} Hz, which joins its uncertainty"
    )
    return replace(fit, modes=(widened, *fit.modes[1:]), warnings=(*fit.warnings, warning))


def _widened(estimate: Estimate, by: float) -> Estimate:
    return replace(estimate, standard_uncertainty=math.hypot(estimate.standard_uncertainty, by))


def _widened_by_richer_response(lines: FitLines, solution: Solution, fit: ModeFit) -> ModeFit:
    r"""Add to the uncertainty of a mode what a response ``B`` of two degrees more would move it by.

    It stands for modes beyond those of the model. The move is the first step of Gauss and Newton with it,

    .. math:: \Delta = N^{-1} g - N_\mathrm{richer}^{-1} g_\mathrm{richer}

    No test decides whether it is added: of an error as large as chance none can tell, and it would still be there.
    Neither is taken off what chance alone moves; then an error of one to two standard uncertainties would often seem
    to be none. The price, where the model holds: the variance that is stated is on average that of the richer response
    (Hausman, Econometrica 46 (1978) 1251-1271); the middle interval is 7 to 18 % too wide.
    """
    mode, order = fit.modes[0], solution.order
    richer = replace(order, response_modes=(order.response_modes or order.n_modes) + 1)
    if degrees_of_freedom(lines, richer) <= 0:
        return fit
    first = 2 * _place_of(mode, solution)
    try:
        of_richer = solution_at(lines, solution.parameters, richer)
        steps = [_inverse(at) @ _pulls(at).sum(axis=1) for at in (solution, of_richer)]
    except np.linalg.LinAlgError:  # an excitation that does not tell so many terms apart
        return fit
    moved = (steps[0] - steps[1])[first : first + 2]
    widened = replace(
        mode,
        frequency=_widened(mode.frequency, float(moved[0])),
        damping_ratio=_widened(mode.damping_ratio, float(moved[1])),
    )
    return replace(fit, modes=(widened, *fit.modes[1:]))


def _reach(frequency: float, damping_ratio: float, resolution: float, band: tuple[float, float]) -> tuple[float, float]:
    """Return from where to where the fit of a mode reaches [Hz]."""
    needed = max(_LEAST_HALF_POWER_BANDWIDTHS * 2.0 * damping_ratio * frequency, LEAST_LINES * resolution)
    wanted = max(needed, _LEAST_HALF_WIDTH * frequency)
    low, high = max(frequency - wanted, band[0]), min(frequency + wanted, band[1])
    return min(low, frequency - needed), max(high, frequency + needed)


def _warn_of_cut(lines: FitLines, low: float, high: float) -> tuple[str, ...]:
    """Say where the lines end before the fit does that the damping asks for."""
    first, last = float(lines.frequency[0]), float(lines.frequency[-1])
    if first - lines.resolution <= low and high <= last + lines.resolution:
        return ()
    return (f"the fit reaches from {first:.4g} to {last:.4g} Hz only; {low:.4g} to {high:.4g} Hz were wanted",)


def _mode_fit(
    lines: FitLines, solution: Solution, asked: float, maximum_modes: int, warnings: tuple[str, ...]
) -> ModeFit:
    """Put the mode that makes the peak asked for first and attach the covariances."""
    formal, between = formal_covariance(solution), between_window_covariance(solution)
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
        weight=lines.weight,
        solution=solution,
        distortion=math.sqrt(_shared(lines, solution) * float(formal[first][0, 0])),
        leaves_response=maximum_modes < 2 and leaves_response(lines, solution, enough_before=True),
        warnings=warnings,
    )


def _modal_parameters(
    lines: FitLines, solution: Solution, mode: int, formal: FloatArray, between: FloatArray | None
) -> ModalParameters:
    i, j = 2 * mode, 2 * mode + 1

    def larger_of(k: int) -> tuple[FloatArray, float]:
        if between is not None and between[k, k] > formal[k, k]:
            return between, float(solution.projection.residual.shape[0] - 1)
        return formal, float(solution.degrees_of_freedom)

    (of_frequency, frequency_dof), (of_damping, damping_dof) = larger_of(i), larger_of(j)
    fn, zeta = solution.modes[mode]
    others = np.prod([pole_factor(fn, *other) for k, other in enumerate(solution.modes) if k != mode])
    b = np.polynomial.polynomial.polyval(
        normalised_frequency(fn, lines.frequency), solution.projection.response_coefficients
    )
    return ModalParameters(
        frequency=Estimate(float(fn), math.sqrt(of_frequency[i, i]), frequency_dof),
        damping_ratio=Estimate(float(zeta), math.sqrt(of_damping[j, j]), damping_dof),
        # the correlation of one source, whatever the other one's scale: the matrix stays positive definite
        frequency_damping_covariance=float(of_frequency[i, j] * math.sqrt(of_damping[j, j] / of_frequency[j, j])),
        residue=complex(-b / others),
    )
