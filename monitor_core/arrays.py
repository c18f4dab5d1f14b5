"""Array types of the core, and the read-only copy that a frozen record keeps."""

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
