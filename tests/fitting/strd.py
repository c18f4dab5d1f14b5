"""Certified non-linear regressions: NIST Statistical Reference Datasets (StRD), all 27, as problems for a fit.

Data, starts and certified values are those of the files at https://www.itl.nist.gov/div898/strd/nls/nls_main.shtml
(work of the United States Government, in the public domain), written here as tables. They are certified to eleven
digits; the standard deviations rest on the residual variance s².
"""

import csv
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import FloatArray

_FOLDER = Path(__file__).resolve().parent / "strd"
_Values = npt.NDArray[np.complex128]
_Model = Callable[[_Values, FloatArray], _Values]


def _gauss(b: _Values, x: FloatArray) -> _Values:
    return (
        b[0] * np.exp(-b[1] * x)
        + b[2] * np.exp(-((x - b[3]) ** 2) / b[4] ** 2)
        + b[5] * np.exp(-((x - b[6]) ** 2) / b[7] ** 2)
    )


def _lanczos(b: _Values, x: FloatArray) -> _Values:
    return b[0] * np.exp(-b[1] * x) + b[2] * np.exp(-b[3] * x) + b[4] * np.exp(-b[5] * x)


def _cubic_over_cubic(b: _Values, x: FloatArray) -> _Values:
    return (b[0] + b[1] * x + b[2] * x**2 + b[3] * x**3) / (1 + b[4] * x + b[5] * x**2 + b[6] * x**3)


def _enso(b: _Values, x: FloatArray) -> _Values:
    turn = 2 * np.pi * x
    return (
        b[0] + b[1] * np.cos(turn / 12) + b[2] * np.sin(turn / 12)
        + b[4] * np.cos(turn / b[3]) + b[5] * np.sin(turn / b[3])
        + b[7] * np.cos(turn / b[6]) + b[8] * np.sin(turn / b[6])
    )  # fmt: skip


#: As the files print them; in Nelson the response is the logarithm and x has two columns.
MODELS: dict[str, _Model] = {
    "Bennett5": lambda b, x: b[0] * (b[1] + x) ** (-1 / b[2]),
    "BoxBOD": lambda b, x: b[0] * (1 - np.exp(-b[1] * x)),
    "Chwirut1": lambda b, x: np.exp(-b[0] * x) / (b[1] + b[2] * x),
    "Chwirut2": lambda b, x: np.exp(-b[0] * x) / (b[1] + b[2] * x),
    "DanWood": lambda b, x: b[0] * x ** b[1],
    "ENSO": _enso,
    "Eckerle4": lambda b, x: b[0] / b[1] * np.exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    "Gauss1": _gauss,
    "Gauss2": _gauss,
    "Gauss3": _gauss,
    "Hahn1": _cubic_over_cubic,
    "Kirby2": lambda b, x: (b[0] + b[1] * x + b[2] * x**2) / (1 + b[3] * x + b[4] * x**2),
    "Lanczos1": _lanczos,
    "Lanczos2": _lanczos,
    "Lanczos3": _lanczos,
    "MGH09": lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    "MGH10": lambda b, x: b[0] * np.exp(b[1] / (x + b[2])),
    "MGH17": lambda b, x: b[0] + b[1] * np.exp(-x * b[3]) + b[2] * np.exp(-x * b[4]),
    "Misra1a": lambda b, x: b[0] * (1 - np.exp(-b[1] * x)),
    "Misra1b": lambda b, x: b[0] * (1 - (1 + b[1] * x / 2) ** -2),
    "Misra1c": lambda b, x: b[0] * (1 - (1 + 2 * b[1] * x) ** -0.5),
    "Misra1d": lambda b, x: b[0] * b[1] * x / (1 + b[1] * x),
    "Nelson": lambda b, x: b[0] - b[1] * x[:, 0] * np.exp(-b[2] * x[:, 1]),
    "Rat42": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)),
    "Rat43": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)) ** (1 / b[3]),
    "Roszman1": lambda b, x: b[0] - b[1] * x - np.arctan(b[2] / (x - b[3])) / np.pi,
    "Thurber": _cubic_over_cubic,
}


@dataclass(frozen=True)
class Regression:
    """One data set as a problem whose uncertainties are not stated."""

    name: str
    response: FloatArray
    predictor: FloatArray

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"b{i + 1}" for i in range(len(certified(self.name).values)))

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        # A power of a negative number is no real prediction: without the real argument it would be silently complex.
        with np.errstate(all="ignore"):
            return MODELS[self.name](np.asarray(coordinates, dtype=np.float64), self.predictor) - self.response

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        """Complex step: every model is analytic, so the derivative is good to the last digit."""
        steps = coordinates + 1e-40j * np.eye(coordinates.size)
        with np.errstate(all="ignore"):
            return np.column_stack([MODELS[self.name](b, self.predictor).imag / 1e-40 for b in steps])


@dataclass(frozen=True)
class Certified:
    difficulty: str
    starts: tuple[FloatArray, FloatArray]
    values: FloatArray
    standard_deviations: FloatArray
    residual_sum_of_squares: float
    residual_standard_deviation: float
    degrees_of_freedom: int


@cache
def certified(name: str) -> Certified:
    rows = [row for row in _rows("certified") if row["data_set"] == name]
    (total,) = [row for row in _rows("totals") if row["data_set"] == name]

    def column(key: str) -> FloatArray:
        return np.array([float(row[key]) for row in rows])

    return Certified(
        rows[0]["difficulty"],
        (column("start_1"), column("start_2")),
        column("certified_value"),
        column("certified_standard_deviation"),
        float(total["residual_sum_of_squares"]),
        float(total["residual_standard_deviation"]),
        int(total["degrees_of_freedom"]),
    )


@cache
def regression(name: str) -> Regression:
    rows = [row for row in _rows("data") if row["data_set"] == name]
    y = np.array([float(row["y"]) for row in rows])
    x1 = np.array([float(row["x1"]) for row in rows])
    if name == "Nelson":
        return Regression(name, np.log(y), np.column_stack([x1, [float(row["x2"]) for row in rows]]))
    return Regression(name, y, x1)


@cache
def _rows(table: str) -> tuple[dict[str, str], ...]:
    with (_FOLDER / f"{table}.csv").open(newline="") as file:
        return tuple(csv.DictReader(file))


def agreed_digits(computed: FloatArray, expected: FloatArray) -> float:
    """Return the log relative error −log₁₀|c − e|/|e| of the worst value, at most 11 (what is certified)."""
    error = float(np.max(np.abs(computed - expected) / np.abs(expected)))
    return 11.0 if error < 1e-11 else -float(np.log10(error))
