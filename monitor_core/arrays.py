"""Array types of the core, the read-only copy that a frozen record keeps, and complex arithmetic that is used often."""

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
BoolArray = npt.NDArray[np.bool_]
#: Responses are real where nothing damps.
NumberArray = npt.NDArray[np.inexact[Any]]
#: Raw samples keep the precision in which they were recorded.
SampleArray = npt.NDArray[np.float32] | npt.NDArray[np.float64]


def read_only(values: npt.ArrayLike) -> FloatArray:
    """Return a float64 copy that cannot be written to."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def read_only_complex(values: npt.ArrayLike) -> ComplexArray:
    """Return a complex128 copy that cannot be written to."""
    array = np.array(values, dtype=np.complex128)
    array.setflags(write=False)
    return array


def acts(value: float | FloatArray) -> bool:
    """Return whether a quantity is there: a number that is not null, or an array of such numbers."""
    return isinstance(value, np.ndarray) or bool(value)


def reciprocal(values: NumberArray) -> NumberArray:
    """Return 1/z to a few units in the last place, eight times as fast as numpy's division of complex numbers.

    The square of no value must overflow or vanish: magnitudes lie within 1e-150 and 1e150.
    """
    if not (isinstance(values, np.ndarray) and np.iscomplexobj(values)):
        real: NumberArray = 1.0 / values
        return real
    return np.asarray(np.conj(values) * (1.0 / (values.real * values.real + values.imag * values.imag)))


def logarithm(values: ComplexArray) -> ComplexArray:
    """Return ln z to a few units in the last place of 1, four times as fast as numpy's; magnitudes as above."""
    logarithms = np.empty(values.shape, dtype=np.complex128)
    logarithms.real = 0.5 * np.log(values.real * values.real + values.imag * values.imag)
    logarithms.imag = np.arctan2(values.imag, values.real)
    return logarithms


def read_only_samples(values: npt.ArrayLike) -> SampleArray:
    """Return the samples as they are (float32 or float64; anything else becomes float64), write-protected.

    Waveforms are large: an array that is already protected and owned by nobody else is not copied.
    """
    array = np.asarray(values)
    if array.dtype not in (np.dtype(np.float32), np.dtype(np.float64)):
        array = array.astype(np.float64)
    if array.flags.writeable:
        array = array.copy()
        array.setflags(write=False)
    return array
