r"""Model the spectra of windows: a rational response, the transient of each window, and persistent tones.

For window :math:`s`, with un-windowed DFT lines :math:`U_s, Y_s` at :math:`f_k`,

.. math::

    Y_s = \frac{B(f)}{A(f)}\,U_s + \frac{T_s(f)}{A(f)} + \sum_t c_{s,t} D(f - f_t) + E_s,\qquad
    A(f) = \prod_i (f_i^2 - f^2 + 2 j \zeta_i f_i f)

``A`` and ``B`` belong to the axis, ``T`` to the window (the ringing that was there when it began, less what is left
when it ends), ``D`` is the line shape of a sine that no excitation explains. A response that was differentiated lacks
samples at the ends of each window: their known shapes (:func:`~monitor_core.spectral.motion.end_shapes`) join ``T``.
Everything but the poles and the tone
frequencies is linear and is eliminated by projection.

The nonlinear ``parameters`` are, for each mode, natural frequency [Hz] and logarithm of the damping ratio; then the
frequencies of the tones [Hz], shape (n_nonlinear,). ``FitLines`` are the whitened lines of the fit band, a
``ModelOrder`` the numbers of modes and tones: so in all modules of this package.
"""

import math
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
import numpy.typing as npt
import scipy

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.spectral import BandSpectra
from monitor_core.spectral.motion import end_shapes


@dataclass(frozen=True, slots=True, eq=False)
class FitLines:
    """Lines of the fit band, each divided by the standard deviation of its noise (up to one common factor)."""

    frequency: FloatArray  # shape (n_frequencies,) [Hz]
    excitation: ComplexArray  # whitened, shape (n_windows, n_frequencies)
    response: ComplexArray  # whitened, shape (n_windows, n_frequencies)
    weight: FloatArray  # what both were multiplied with, shape (n_frequencies,)
    n_samples: int
    sample_rate: float  # [Hz]
    derivatives: int = 0  # that were taken of what the sensor measures

    @classmethod
    def of(cls, spectra: BandSpectra, low: float, high: float, weight: FloatArray | None = None) -> "FitLines":
        """Take the lines from ``low`` to ``high`` [Hz] in double precision; without weights the sensor's is the noise.

        The line at 0 Hz is left out: the mean of each window was removed with it, so it holds no measurement.
        """
        band = spectra.within(max(low, 0.5 * spectra.resolution), high)
        w = band.frequency[0] ** band.derivatives / band.frequency**band.derivatives if weight is None else weight
        excitation: ComplexArray = band.excitation.astype(np.complex128) * w
        response: ComplexArray = band.response.astype(np.complex128) * w
        return cls(band.frequency, excitation, response, w, band.n_samples, band.sample_rate, band.derivatives)

    def weighted(self, weight: FloatArray) -> "FitLines":
        """Return the same lines with other weights."""
        change = weight / self.weight
        return replace(self, excitation=self.excitation * change, response=self.response * change, weight=weight)

    def of_lines(self, kept: npt.NDArray[np.intp]) -> "FitLines":
        """Return the lines with these indices, of all windows."""
        x, y = self.excitation[:, kept], self.response[:, kept]
        return replace(self, frequency=self.frequency[kept], excitation=x, response=y, weight=self.weight[kept])

    @property
    def n_windows(self) -> int:
        """Number of windows."""
        return int(self.response.shape[0])

    @property
    def resolution(self) -> float:
        """Distance of two lines in hertz."""
        return self.sample_rate / self.n_samples

    @property
    def repeats(self) -> bool:
        """Whether all windows have one excitation, as periods do: then errors of the model repeat too."""
        common = self.excitation.mean(axis=0)
        power = float(np.vdot(self.excitation, self.excitation).real) / self.n_windows
        return self.n_windows > 1 and float(np.vdot(common, common).real) > _REPEATED * power


#: Windows that have this share of the power of their excitation in common have one excitation [-].
_REPEATED = 0.9


@dataclass(frozen=True, slots=True)
class ModelOrder:
    """How many modes and tones, and the polynomial degrees that go with them."""

    n_modes: int
    n_tones: int = 0
    response_modes: int | None = None  # degree of B as for so many modes; by default those of the model
    transient_modes: int | None = None  # degree of T as for so many modes; by default those of the model

    @property
    def n_response_terms(self) -> int:
        """Complex coefficients of B: two per mode and one for what lies outside the band."""
        return 2 * (self.response_modes or self.n_modes) + 1

    @property
    def n_transient_terms(self) -> int:
        """Complex coefficients of T, of each window: a system of order 2 n leaves a polynomial of degree 2 n − 1."""
        return 2 * (self.transient_modes or self.n_modes)

    @property
    def n_nonlinear(self) -> int:
        """Frequency and damping of each mode, and the frequency of each tone."""
        return 2 * self.n_modes + self.n_tones

    def n_parameters(self, n_windows: int) -> int:
        """Count the real parameters, those of the windows included."""
        per_window = 2 * (self.n_transient_terms + self.n_tones)
        return self.n_nonlinear + 2 * self.n_response_terms + per_window * n_windows


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """What the model is made of at given poles and tone frequencies, on given lines."""

    response_terms: ComplexArray  # gʲ/A for B, for the whitened excitation, shape (n_response_terms, n_frequencies)
    tone_shapes: ComplexArray  # shape (n_tones, n_frequencies)
    nuisance: ComplexArray  # orthonormal basis of the per-window terms, shape (n_frequencies, n_nuisance)
    triangle: ComplexArray  # R of its QR in the upper triangle, shape (n_nuisance, n_nuisance)

    def annul(self, lines: ComplexArray) -> ComplexArray:
        """Project the per-window terms out of lines, shape (..., n_frequencies)."""
        projected: ComplexArray = lines - (lines @ self.nuisance.conj()) @ self.nuisance.T
        return projected

    def tone_amplitudes(self, lines: ComplexArray) -> ComplexArray:
        """Return the windows' tone amplitudes in lines without forced response, shape (n_tones, n_windows)."""
        amplitudes = scipy.linalg.solve_triangular(self.triangle, (lines @ self.nuisance.conj()).T)
        tones: ComplexArray = amplitudes[amplitudes.shape[0] - self.tone_shapes.shape[0] :]
        return tones


@dataclass(frozen=True, slots=True, eq=False)
class Projection:
    """The best fit at given poles: what is left, and how it changes with the poles."""

    residual: ComplexArray  # shape (n_windows, n_frequencies)
    jacobian: ComplexArray  # Kaufman's, shape (n_nonlinear, n_windows, n_frequencies)
    response_coefficients: ComplexArray  # of B in the normalised frequency [Hz² × response unit]

    @property
    def cost(self) -> float:
        """Sum of squared moduli of the residual."""
        return float(np.vdot(self.residual, self.residual).real)


def normalised_frequency(frequency: FloatArray | float, lines: FloatArray) -> FloatArray:
    """Map the band of ``lines`` onto −1…1, where powers up to the fourth stay well conditioned."""
    centre, half_width = 0.5 * (lines[0] + lines[-1]), 0.5 * (lines[-1] - lines[0])
    normalised: FloatArray = (np.asarray(frequency, dtype=np.float64) - centre) / half_width
    return normalised


def pole_factor(frequency: FloatArray | float, natural_frequency: float, damping_ratio: float) -> ComplexArray:
    """Return f_n² − f² + 2jζ f_n f, in hertz squared."""
    f = np.asarray(frequency, dtype=np.float64)
    return natural_frequency**2 - f**2 + 2j * damping_ratio * natural_frequency * f


def tone_shape(frequency: FloatArray, tone: FloatArray | float, n_samples: int, sample_rate: float) -> ComplexArray:
    """Return the DFT lines of a unit complex sine (Dirichlet kernel), divided by the number of samples."""
    d = (tone - frequency) / sample_rate
    shape: ComplexArray = np.exp(1j * np.pi * d * (n_samples - 1)) * np.sinc(d * n_samples) / np.sinc(d)
    return shape


def poles_of(parameters: FloatArray, order: ModelOrder) -> FloatArray:
    """Return natural frequency [Hz] and damping ratio [-] of each mode, shape (n_modes, 2)."""
    poles = parameters[: 2 * order.n_modes].reshape(-1, 2).copy()
    poles[:, 1] = np.exp(poles[:, 1])
    return poles


def basis_of(lines: FitLines, parameters: FloatArray, order: ModelOrder) -> Basis:
    """Build the linear terms of the model; ``parameters`` as in the module's text."""
    f = lines.frequency
    poles = [pole_factor(f, *pole) for pole in poles_of(parameters, order)]
    a = reduce(np.multiply, poles, np.ones(f.size, dtype=np.complex128))
    powers = np.empty((max(order.n_response_terms, order.n_transient_terms), f.size), dtype=np.complex128)
    powers[0], powers[1:] = 1.0 / a, normalised_frequency(f, f)
    np.multiply.accumulate(powers, axis=0, out=powers)
    tones = parameters[2 * order.n_modes :]
    transient = lines.weight * powers[: order.n_transient_terms]
    shapes = np.empty((0, f.size), dtype=np.complex128)
    if lines.derivatives:
        ends = lines.weight * end_shapes(f, lines.sample_rate, lines.derivatives)
        transient = np.concatenate([transient, ends])
    if tones.size:
        shapes = lines.weight * tone_shape(f, tones[:, None], lines.n_samples, lines.sample_rate)
        transient = np.concatenate([transient, shapes])
    nuisance, triangle = _orthonormal(transient.T)
    return Basis(powers[: order.n_response_terms], shapes, nuisance, triangle)


def _orthonormal(columns: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return Q and, in the upper triangle, R: LAPACK's own, for what NumPy does around it takes longer at this size."""
    reflectors, scales, *_ = scipy.linalg.lapack.zgeqrf(columns)
    return scipy.linalg.lapack.zungqr(reflectors, scales)[0], reflectors[: columns.shape[1]]


def project(lines: FitLines, parameters: FloatArray, order: ModelOrder) -> Projection:
    r"""Solve for everything linear at given poles and tone frequencies.

    The per-window terms share one basis; its QR is taken once and projected out of response and excitation terms
    alike. What is left is one small least-squares problem for B over all windows. The Jacobian of the remaining
    non-linear problem is Kaufman's: the projected derivative of the model at constant linear coefficients, and for a
    pole that derivative is :math:`-(\partial A/\partial\theta)/A` times what the fitted model says of forced response
    and transient.
    """
    basis = basis_of(lines, parameters, order)
    forced = _solve_response(lines, basis)
    derivatives = _derivatives(lines, parameters, order, basis, forced)
    flat = basis.annul(derivatives).reshape(order.n_nonlinear, -1)
    columns = forced.columns
    flat -= _solve_gram(forced.gram, columns.conj() @ flat.T).T @ columns
    return Projection(forced.residual, flat.reshape(derivatives.shape), forced.coefficients)


def response_coefficients(
    lines: FitLines, parameters: FloatArray, order: ModelOrder
) -> tuple[ComplexArray, ComplexArray]:
    """Return B in the normalised frequency at given poles, and the inverse of the products of its terms."""
    forced = _solve_response(lines, basis_of(lines, parameters, order))
    return forced.coefficients, _solve_gram(forced.gram, np.eye(forced.coefficients.size, dtype=np.complex128))


def cost_at(lines: FitLines, parameters: FloatArray, order: ModelOrder) -> float:
    """Return the cost of :func:`project` alone, for the comparison of starts; infinite where B is not determined."""
    try:
        residual = _solve_response(lines, basis_of(lines, parameters, order)).residual
    except np.linalg.LinAlgError:
        return math.inf
    return float(np.vdot(residual, residual).real)


def nested_costs(lines: FitLines, parameters: FloatArray, plain: ModelOrder, richer: ModelOrder) -> tuple[float, float]:
    """Return the costs at given poles with B of a model and with B of a richer one, whose terms the windows have.

    With the Cholesky factor R of the products of all terms, :math:`|(R b)_i|^2` is what term i brings beyond those
    before it.
    """
    forced = _solve_response(lines, basis_of(lines, parameters, richer))
    brought = (np.triu(forced.gram) @ forced.coefficients)[plain.n_response_terms :]
    cost = float(np.vdot(forced.residual, forced.residual).real)
    return cost + float(np.vdot(brought, brought).real), cost


def forced_cost(lines: FitLines, parameters: FloatArray, order: ModelOrder, nuisance: Basis) -> float:
    """Return the cost at given poles when the terms of the windows are those of another model."""
    basis = replace(basis_of(lines, parameters, order), nuisance=nuisance.nuisance, triangle=nuisance.triangle)
    residual = _solve_response(lines, basis).residual
    return float(np.vdot(residual, residual).real)


def overdispersion(lines: FitLines, parameters: FloatArray, plain: ModelOrder, richer: ModelOrder) -> float:
    """Return how much more the windows scatter than the noise of single lines says, at least 1.

    Friction acts at a moment, so its noise is alike at neighbouring lines, and a test that counts every line as a
    witness must be divided by this factor (quasi-likelihood). It is read from the scatter between windows of the very
    terms that the richer model adds, which has B of a higher degree. A single window cannot tell and gives 1.
    """
    if lines.n_windows < 2:
        return 1.0
    columns = _solve_response(lines, basis_of(lines, parameters, richer)).columns
    fitted = _solve_response(lines, basis_of(lines, parameters, replace(plain, transient_modes=richer.transient_modes)))
    n_plain = plain.n_response_terms
    orthonormal = np.linalg.qr(columns.T)[0][:, n_plain:]
    scores = (orthonormal.conj() * fitted.residual.reshape(-1, 1)).reshape(lines.n_windows, -1, orthonormal.shape[1])
    per_window = scores.sum(axis=1)
    variance = lines.n_windows * float(np.mean(np.var(per_window, axis=0, ddof=1)))
    expected = float(np.vdot(fitted.residual, fitted.residual).real) / fitted.residual.size
    return max(1.0, variance / expected)


@dataclass(frozen=True, slots=True, eq=False)
class _ForcedResponse:
    coefficients: ComplexArray  # of B
    columns: ComplexArray  # projected terms of B over all windows, shape (n_response_terms, n_windows · n_frequencies)
    gram: ComplexArray  # upper Cholesky factor of their products
    residual: ComplexArray  # shape (n_windows, n_frequencies)


def _solve_response(lines: FitLines, basis: Basis) -> _ForcedResponse:
    """Solve for B over all windows, with the per-window terms projected out."""
    n_terms = basis.response_terms.shape[0]
    stacked = np.empty((n_terms + 1, *lines.response.shape), dtype=np.complex128)
    np.multiply(basis.response_terms[:, None, :], lines.excitation, out=stacked[:-1])
    stacked[-1] = lines.response
    annulled = basis.annul(stacked).reshape(n_terms + 1, -1)
    columns, target = annulled[:-1], annulled[-1]
    products = columns.conj() @ annulled.T
    gram = _factor_gram(products[:, :-1])
    b = _solve_gram(gram, products[:, -1])
    return _ForcedResponse(b, columns, gram, (target - b @ columns).reshape(lines.response.shape))


def _factor_gram(products: ComplexArray) -> ComplexArray:
    """Return the upper Cholesky factor: LAPACK's own, for what SciPy does around it takes longer at this size."""
    if not np.isfinite(products).all():
        raise ValueError("the terms of the response must be finite")
    factor, info = scipy.linalg.lapack.zpotrf(products, lower=False, clean=False)
    if info:
        raise np.linalg.LinAlgError("the terms of the response are not independent")
    return np.asarray(factor)


def _solve_gram(factor: ComplexArray, right: ComplexArray) -> ComplexArray:
    return np.asarray(scipy.linalg.lapack.zpotrs(factor, right, lower=False)[0])


def _derivatives(
    lines: FitLines,
    parameters: FloatArray,
    order: ModelOrder,
    basis: Basis,
    response: _ForcedResponse,
) -> ComplexArray:
    """Return minus the derivatives of the fitted model at constant linear coefficients."""
    f = lines.frequency
    fitted = lines.response - response.residual
    derivatives = np.empty((order.n_nonlinear, *fitted.shape), dtype=np.complex128)
    tones = parameters[2 * order.n_modes :]
    if tones.size:
        forced = (response.coefficients @ basis.response_terms) * lines.excitation
        amplitudes = basis.tone_amplitudes(lines.response - forced)
        fitted = fitted - amplitudes.T @ basis.tone_shapes
        step = 1e-4 * lines.resolution
        for i, (tone, amplitude) in enumerate(zip(tones, amplitudes, strict=True)):
            above, below = (tone_shape(f, tone + h, lines.n_samples, lines.sample_rate) for h in (step, -step))
            derivatives[2 * order.n_modes + i] = -np.outer(amplitude, lines.weight * (above - below) / (2.0 * step))
    for i, (fn, zeta) in enumerate(poles_of(parameters, order)):
        factor = pole_factor(f, fn, zeta)
        derivatives[2 * i] = (2.0 * fn + 2j * zeta * f) / factor * fitted
        derivatives[2 * i + 1] = 2j * zeta * fn * f / factor * fitted
    return derivatives
