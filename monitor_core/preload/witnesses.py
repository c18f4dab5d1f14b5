r"""Compare what windows hold besides the frequency with what the calibration lets expect of it.

The damping ratio, the residue, the friction torque and the level of the excitation come from the same windows as the
frequency. A calibration has seen each of them at known conditions,

.. math:: \ln w = b_0 + b_1 x + b_2 x^2 + b_3 \ln P + b_4 \ln^2 P + b_5 \ln(1 + \mu\,\Delta m) + b_6\,\Delta T

with those terms that its settings determine, so that a later one that lies elsewhere tells of something that the
frequency alone would pass off as preload. The residue of an accelerance is a reciprocal modal mass: it knows what moves
and how firmly it is mounted (ISO 7626-1). No source gives the regression; it is that of :mod:`numpy` on logarithms,
with the prediction interval of any textbook.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.uncertainty import VectorEstimate, beyond_others, enlargement


class WitnessName(StrEnum):
    """What is compared with the calibration, in SI units."""

    DAMPING_RATIO = "damping-ratio"  #: of the mode [-]
    RESIDUE = "residue"  #: magnitude of the mode's residue [m/(N·s²) or m/(N·m·s²)]
    RIGID_LINE = "rigid-line"  #: :func:`monitor_core.modal.channels.rigid_line` [m/(N·s²) or m/(N·m·s²)]
    FRICTION_TORQUE = "friction-torque"  #: :func:`monitor_core.preload.drag_torque.friction_torque` [N·m]
    NOISE_LEVEL = "noise-level"  #: rms per root hertz of what no torque explains around the mode [m/(s²·√Hz)]
    EXCITATION_LEVEL = "excitation-level"  #: rms per root hertz around the mode [N·m/√Hz or N/√Hz]


#: Witnesses of one measurement by name.
WitnessValues = Mapping[WitnessName, float]


@dataclass(frozen=True, slots=True)
class Setting:
    """The conditions that a witness follows."""

    position: float  # [m]
    preload: float  # [N]
    payload_factor: float = 1.0  # 1 + µ·Δm [-]
    temperature_excess: float = 0.0  # [K]


#: The terms of the regression by name, in the order in which they are given up where readings are few.
TERMS = ("constant", "position", "preload", "payload", "temperature", "position_squared", "preload_squared")
#: Standard deviation over the readings, beyond what the terms before it explain, from which a term is determined.
_DISTINCT = {
    "position": 0.01,  # [m]
    "preload": 0.05,
    "payload": 0.01,
    "temperature": 1.0,  # [K]
    "position_squared": 1e-3,  # [m²]
    "preload_squared": 0.05,
}
#: Of what a payload does to a witness, standard uncertainty by the power law that it is taken to follow (declared): few
#: payloads are calibrated, and between them the mode changes its shape.
_PAYLOAD_LAW = 0.02
#: Residual degrees of freedom below which a calibration does not tell what is usual.
_FEWEST_DEGREES_OF_FREEDOM = 5


def _terms_of(setting: Setting) -> dict[str, float]:
    preload = math.log(setting.preload)
    return {
        "constant": 1.0,
        "position": setting.position,
        "position_squared": setting.position**2,
        "preload": preload,
        "preload_squared": preload**2,
        "payload": math.log(setting.payload_factor),
        "temperature": setting.temperature_excess,
    }


@dataclass(frozen=True, slots=True)
class Deviation:
    """How a witness differs from what the calibration lets expect."""

    logarithm: float  # ln(value / expected) [-]
    standard_uncertainty: float  # of it: of one measurement, and of the expectation [-]
    degrees_of_freedom: float

    def with_uncertainty(self, more: float) -> "Deviation":
        """Return the deviation with one more independent standard uncertainty of its logarithm [-]."""
        return replace(self, standard_uncertainty=math.hypot(self.standard_uncertainty, more))

    @property
    def score(self) -> float:
        """The deviation as a normal deviate: the quantile that is as improbable [-]."""
        t = self.logarithm / self.standard_uncertainty
        # from the nearer tail, or what is far out would round to infinity
        tail = float(scipy.special.stdtr(self.degrees_of_freedom, -abs(t)))
        return math.copysign(-float(scipy.special.ndtri(max(tail, 1e-300))), t)


@dataclass(frozen=True, slots=True, eq=False)
class Witness:
    """A quantity of the windows and how it follows the conditions of the calibration."""

    name: WitnessName
    terms: tuple[str, ...]  # of the regression, some of position, preload, payload, temperature, their squares
    coefficients: VectorEstimate  # of ln(value) over the terms, covariance from the residuals [1 / unit of the term]
    scatter: float  # of ln(value) from one measurement of the calibration to the next [-]

    def expected(self, setting: Setting) -> float:
        """Return the value that the calibration lets expect, in the unit of the witness."""
        return math.exp(float(self._row(setting) @ self.coefficients.values))

    def deviation(self, value: float, setting: Setting, *, floor: float = 0.0) -> Deviation:
        """Compare a value with the expected one; a scatter below ``floor`` is not believed for other days [-]."""
        row = self._row(setting)
        of_payload = _PAYLOAD_LAW * (self.payload_exponent or 0.0) * math.log(setting.payload_factor)
        variance = self.scatter**2 + floor**2 + of_payload**2 + float(row @ self.coefficients.covariance @ row)
        logarithm = math.log(value) - float(row @ self.coefficients.values)
        return Deviation(logarithm, math.sqrt(variance), self.coefficients.degrees_of_freedom)

    def uncertainty_between(self, setting: Setting, of_baseline: Sequence[Setting]) -> float:
        """Tell what is left open of ln(expected) against the mean of a baseline, beyond what is among its settings [-].

        As :func:`monitor_core.preload.systematic_uncertainty_between` has it for the frequency: no averaging over
        measurements removes it. 1.96 times the result covers 95 %.
        """
        settings = [*of_baseline, setting]
        rows = np.array([self._row(each) for each in settings])
        payloads = (self.payload_exponent or 0.0) * np.log([each.payload_factor for each in settings])
        of_payload = _PAYLOAD_LAW * (payloads - payloads[:-1].mean())
        few = enlargement(self.coefficients.degrees_of_freedom)
        return beyond_others(rows, few**2 * self.coefficients.covariance, of_payload**2)

    @property
    def payload_exponent(self) -> float | None:
        r"""Exponent of the factor :math:`1 + \mu\,\Delta m`, or ``None`` if no payloads have shown it [-]."""
        of = dict(zip(self.terms, self.coefficients.values.tolist(), strict=True))
        return of.get("payload")

    def slope_in_preload(self, setting: Setting) -> float:
        r"""Return :math:`d\ln w/d\ln P` of the expected value [-]."""
        return float(self._slope_row(setting) @ self.coefficients.values)

    def rises_with_preload(self, setting: Setting) -> bool | None:
        """Tell whether it rises with the preload; ``None`` where the calibration does not show that to 95 %."""
        row = self._slope_row(setting)
        slope, variance = float(row @ self.coefficients.values), float(row @ self.coefficients.covariance @ row)
        reach = float(scipy.special.stdtrit(self.coefficients.degrees_of_freedom, 0.975)) * math.sqrt(variance)
        return slope > 0.0 if abs(slope) > reach else None

    def _slope_row(self, setting: Setting) -> FloatArray:
        of = {"preload": 1.0, "preload_squared": 2.0 * math.log(setting.preload)}
        return np.array([of.get(term, 0.0) for term in self.terms])

    def slope_in_theta(self, setting: Setting) -> float:
        r"""Return :math:`dw/d\theta` of the expected value, :math:`\theta = P^{-1/3}` [unit of the witness·N^(1/3)]."""
        return float(self.expected(setting) * self.slope_in_preload(setting) * -3.0 * np.cbrt(setting.preload))

    def _row(self, setting: Setting) -> FloatArray:
        of = _terms_of(setting)
        return np.array([of[term] for term in self.terms])


def fit_witness(name: WitnessName, values: Sequence[float], settings: Sequence[Setting]) -> Witness | None:
    """Fit a witness to the readings of a calibration; ``None`` where they are too few to tell what is usual.

    A term that the settings do not determine is left out; a later measurement far from them then deviates for that, and
    rightly so.
    """
    if len(values) != len(settings) or not all(math.isfinite(value) and value > 0.0 for value in values):
        return None
    rows = [_terms_of(setting) for setting in settings]
    columns = {term: np.array([row[term] for row in rows]) for term in TERMS}
    terms: list[str] = []
    for term in TERMS:
        regressors = np.column_stack([columns[t] for t in terms]) if terms else np.zeros((len(values), 0))
        own = columns[term] - regressors @ np.linalg.lstsq(regressors, columns[term])[0]
        determined = float(own.std()) > _DISTINCT[term] if terms else True
        if determined and len(values) - len(terms) - 1 >= _FEWEST_DEGREES_OF_FREEDOM:
            terms.append(term)
    if not terms:
        return None
    design, observed = np.column_stack([columns[t] for t in terms]), np.log(values)
    beta: FloatArray = np.linalg.lstsq(design, observed)[0].astype(np.float64)
    dof = len(values) - len(terms)
    residual = observed - design @ beta
    variance = float(residual @ residual) / dof
    covariance: FloatArray = (variance * np.linalg.pinv(design.T @ design)).astype(np.float64)
    return Witness(name, tuple(terms), VectorEstimate(beta, covariance, dof), math.sqrt(variance))
