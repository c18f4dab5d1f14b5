"""The FRF kernel beside scipy and pyFRF: two channels of 20 000 samples, Hann, all in one run.

``python -m benchmarks.frf_kernel`` prints milliseconds per window and factors. Ratios are what counts: each variant
runs in turn, round after round, and the median round is reported, so a busy machine slows all of them alike.
"""

import statistics
import time
import warnings
from collections.abc import Callable

import numpy as np
import scipy.signal

from monitor_core.spectral import band_spectra, cross_spectra, estimate_frf

N_WINDOWS, N_SAMPLES, RATE = 30, 20_000, 10_000.0
BAND = (100.0, 300.0)
ROUNDS = 15

Kernel = Callable[[np.ndarray, np.ndarray], np.ndarray]


def ours(excitation, response):
    """Return H1 over the band from all windows at once."""
    return estimate_frf(cross_spectra(band_spectra(excitation, response, RATE, BAND)), quantity="accelerance").response


def ours_streaming(excitation, response):
    """Return H1 over the band, window after window."""
    total = cross_spectra(band_spectra(excitation[:1], response[:1], RATE, BAND))
    for i in range(1, len(excitation)):
        total = total + cross_spectra(band_spectra(excitation[i : i + 1], response[i : i + 1], RATE, BAND))
    return estimate_frf(total, quantity="accelerance").response


def scipys(excitation, response):
    """Return H1 over the band from csd and two welch per window, averaged."""
    settings = {"fs": RATE, "window": "hann", "nperseg": N_SAMPLES, "noverlap": 0}
    sxy = sxx = syy = 0.0
    frequency = np.empty(0)
    for x, y in zip(excitation, response, strict=True):
        frequency, cross_spectrum = scipy.signal.csd(x, y, **settings)
        sxy = sxy + cross_spectrum
        sxx = sxx + scipy.signal.welch(x, **settings)[1]
        syy = syy + scipy.signal.welch(y, **settings)[1]
    band = (frequency >= BAND[0]) & (frequency <= BAND[1])
    return (sxy / sxx)[band]


def pyfrfs_batch(excitation, response):
    """Return H1 over the band from pyFRF, which is given all windows at once."""
    from pyFRF import FRF  # noqa: PLC0415  an optional peer, extra `bench`

    return _band_of(FRF(int(RATE), exc=excitation, resp=response, window="hann", fft_len=N_SAMPLES))


def pyfrfs_streaming(excitation, response):
    """Return H1 over the band from pyFRF, window after window."""
    from pyFRF import FRF  # noqa: PLC0415

    frf = FRF(int(RATE), window="hann", fft_len=N_SAMPLES)
    for x, y in zip(excitation, response, strict=True):
        frf.add_data(x, y)
    return _band_of(frf)


def _band_of(frf):
    frequency = frf.get_f_axis()
    band = (frequency >= BAND[0]) & (frequency <= BAND[1])
    return np.asarray(frf.get_FRF(frf_estimator="H1", frf_form="accelerance")).ravel()[band]


def windows(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return white excitation and the noisy response of a mode, shape (n_windows, n_samples)."""
    excitation = rng.standard_normal((N_WINDOWS, N_SAMPLES))
    b, a, _ = scipy.signal.cont2discrete(([1.0, 0, 0], [1, 44.0, 1.21e6]), 1.0 / RATE)
    response = scipy.signal.lfilter(b.ravel(), a, excitation, axis=1)
    return excitation, response + 0.1 * rng.standard_normal(response.shape)


def measure(rounds: int = ROUNDS) -> dict[str, float]:
    """Return the time of each variant in milliseconds per window: the median over rounds."""
    kernels: dict[str, Kernel] = {
        "scipy csd + 2 x welch": scipys,
        "pyFRF batch": pyfrfs_batch,
        "pyFRF streaming": pyfrfs_streaming,
        "this kernel, float64": ours,
        "this kernel, float64, window by window": ours_streaming,
        "this kernel, float32": ours,
    }
    excitation, response = windows(np.random.default_rng(0))
    single = (excitation.astype(np.float32), response.astype(np.float32))
    elapsed: dict[str, list[float]] = {name: [] for name in kernels}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in range(rounds + 1):
            for name, kernel in kernels.items():
                pair = single if "float32" in name else (excitation, response)
                start = time.perf_counter()
                kernel(*pair)
                elapsed[name].append((time.perf_counter() - start) / N_WINDOWS * 1e3)
    return {name: statistics.median(times[1:]) for name, times in elapsed.items()}


def main() -> None:
    """Print the table."""
    reference = scipys(*windows(np.random.default_rng(0)))
    for name, kernel in (("this kernel", ours), ("pyFRF batch", pyfrfs_batch), ("pyFRF streaming", pyfrfs_streaming)):
        difference = np.max(np.abs(kernel(*windows(np.random.default_rng(0))) / reference - 1.0))
        print(f"H1 of {name} against scipy's: largest relative difference {difference:.1e}")
    times = measure()
    slowest = times["scipy csd + 2 x welch"]
    for name, milliseconds in times.items():
        print(f"{name:40s} {milliseconds:7.3f} ms per window   factor {slowest / milliseconds:5.1f}")


if __name__ == "__main__":
    main()
