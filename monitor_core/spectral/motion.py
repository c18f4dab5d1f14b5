r"""Turn velocities and displacements into accelerations: differences in time, exact in frequency.

A motion over a window leaks, and :math:`\omega^2` lifts what leaks into the band. Differences in time see as little of
a steady motion as an accelerometer does, need no sample beyond the window, and have a transfer that is known,

.. math::

    \frac{x_{n+1} - 2 x_n + x_{n-1}}{T^2} \;\leftrightarrow\; -\frac{4}{T^2} \sin^2\frac{\omega T}{2},
    \qquad \frac{v_{n+1} - v_n}{T} \;\leftrightarrow\; \frac{e^{j\omega T} - 1}{T}

which is divided out on each line (Oppenheim & Schafer, Discrete-Time Signal Processing, section 4.4.2). The samples at
the ends that have no neighbour are taken for 0; what they should have been is a known shape on the lines,
:func:`end_shapes`, which a fit of windows takes out.
"""

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray, SampleArray


def differenced(samples: SampleArray, sample_rate: float, derivatives: int) -> SampleArray:
    """Differentiate windows in time; shapes (n_windows, n_samples), samples without a neighbour are 0.

    Of no derivative the samples are returned as they are. Differences are taken in double precision: of a position of
    half a metre single precision leaves 30 nm.
    """
    if derivatives == 0:
        return samples
    differences = np.zeros(samples.shape)
    # from the first sample on: only differences count, and their decimals
    x = samples.astype(np.float64) - samples[:, :1]
    if derivatives == 1:
        differences[:, :-1] = np.diff(x, axis=1) * sample_rate
    else:
        differences[:, 1:-1] = np.diff(x, 2, axis=1) * sample_rate**2
    return differences


def exact_derivative(frequency: FloatArray, sample_rate: float, derivatives: int) -> ComplexArray:
    """Return what the lines of differences are multiplied with to be those of a derivative, shape (n_frequencies,)."""
    half = np.pi * frequency / sample_rate  # ωT/2
    if derivatives == 0:
        return np.ones(frequency.shape, dtype=np.complex128)
    magnitude = 1.0 / np.sinc(half / np.pi)
    # a difference of two samples belongs to the middle between them
    exact = magnitude * np.exp(-1j * half) if derivatives == 1 else magnitude**2
    return exact.astype(np.complex128)


def end_shapes(frequency: FloatArray, sample_rate: float, derivatives: int) -> ComplexArray:
    """Return what the samples without a neighbour are on lines of whole multiples of 1/window, one row each."""
    last = np.exp(2j * np.pi * frequency / sample_rate)
    shapes = [np.ones_like(last), last] if derivatives == 2 else [last] * derivatives
    rows: ComplexArray = np.array(shapes, dtype=np.complex128).reshape(derivatives, frequency.size)
    return rows * exact_derivative(frequency, sample_rate, derivatives)
