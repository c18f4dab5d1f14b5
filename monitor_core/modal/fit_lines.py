"""Records of a fit: the whitened lines of its band, and the order of its model."""

from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.spectral import BandSpectra


@dataclass(frozen=True, slots=True, eq=False)
class FitLines:
    """Lines of the fit band, each divided by the standard deviation of its noise (up to one common factor)."""

    frequency: FloatArray  # shape (n_frequencies,) [Hz]
    excitation: ComplexArray  # whitened, shape (n_windows, n_frequencies)
    response: ComplexArray  # whitened, shape (n_windows, n_frequencies)
    weight: FloatArray  # what both were multiplied with, shape (n_frequencies,)
    n_samples: int
    sample_rate: float  # [Hz]

    @classmethod
    def of(cls, spectra: BandSpectra, low: float, high: float, weight: FloatArray | None = None) -> "FitLines":
        """Take the lines from ``low`` to ``high`` [Hz] in double precision; without weights the noise is white."""
        band = spectra.within(low, high)
        w = np.ones(band.frequency.size) if weight is None else weight
        excitation: ComplexArray = band.excitation.astype(np.complex128) * w
        response: ComplexArray = band.response.astype(np.complex128) * w
        return cls(band.frequency, excitation, response, w, band.n_samples, band.sample_rate)

    def weighted(self, weight: FloatArray) -> "FitLines":
        """Return the same lines with other weights."""
        change = weight / self.weight
        return FitLines(
            self.frequency, self.excitation * change, self.response * change, weight, self.n_samples, self.sample_rate
        )

    @property
    def n_windows(self) -> int:
        """Number of windows."""
        return int(self.response.shape[0])

    @property
    def resolution(self) -> float:
        """Distance of two lines in hertz."""
        return self.sample_rate / self.n_samples


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
