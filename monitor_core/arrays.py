"""Array types of the core, the read-only copy that a frozen record keeps, how it is shown, and complex arithmetic."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from monitor_core.shown import Panel

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


class Shown:
    """What a record gives a person at a notebook: a picture, a table, and itself in a cell.

    It says which panels and columns it has; how these are drawn (:mod:`monitor_core.shown`) is imported when asked for.
    """

    __slots__ = ()

    def plot(self, figure: "Figure | None" = None) -> "Figure":
        """Draw it with matplotlib, into a figure of pyplot if none is given."""
        from monitor_core.shown import plot  # noqa: PLC0415  # few ask

        return plot(self._panels(), figure)

    def to_frame(self) -> Any:  # noqa: ANN401 - pandas has no types
        """Return its numbers as a ``pandas.DataFrame``; columns are named with their units."""
        from monitor_core.shown import to_frame  # noqa: PLC0415  # few ask

        return to_frame(self._columns())

    def _repr_html_(self) -> str:
        from monitor_core.shown import as_html  # noqa: PLC0415  # notebooks alone ask

        return as_html(repr(self), self._panels())

    def _panels(self) -> "Sequence[Panel]":
        raise NotImplementedError

    def _columns(self) -> Mapping[str, Sequence[Any] | FloatArray]:
        raise NotImplementedError


def acts(value: float | NumberArray) -> bool:
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
