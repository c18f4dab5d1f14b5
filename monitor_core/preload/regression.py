"""Solve the least squares of a calibration with full covariance; refuse readings that cannot determine Eq. (8)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.preload.calibration import ModalReading, Weighting
from monitor_core.uncertainty import VectorEstimate

#: Condition number of the column-scaled design above which settings differ by less than they can be set: for Eq. (8)
#: three positions within about a millimetre of each other. (Table 2 of Nguyen et al.: 45.)
CONDITION_LIMIT = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class ReadingRows:
    """Readings as rows of a regression that is linear in 1/f²."""

    design: FloatArray  # shape (n, p) [s² / unit of the coefficient]
    inverse_square: FloatArray  # 1/f², shape (n,) [s²]
    weight: FloatArray  # inverse standard deviations up to a common factor, shape (n,) [1/s²]
    slope: FloatArray  # 2/f³, shape (n,) [s³]
    stated: FloatArray  # stated standard uncertainties, 0 where not stated, shape (n,) [Hz]


@dataclass(frozen=True, slots=True, eq=False)
class LeastSquaresFit:
    """Outcome of :func:`weighted_least_squares`."""

    parameters: VectorEstimate  # covariance scaled by the residual variance
    residual: FloatArray  # observed − fitted, shape (n,), in the unit of the observations
    estimator: FloatArray  # G in β = G·observed, shape (p, n)
    leverage: FloatArray  # diagonal of the (weighted) hat matrix, shape (n,)
    condition_number: float  # of the weighted, column-scaled design

    def __post_init__(self) -> None:
        object.__setattr__(self, "residual", read_only(self.residual))
        object.__setattr__(self, "estimator", read_only(self.estimator))
        object.__setattr__(self, "leverage", read_only(self.leverage))

    def covariance_under(self, variance: FloatArray) -> FloatArray:
        """Return the covariance of the parameters if the observations scatter with these variances, shape (n,)."""
        return (self.estimator * variance) @ self.estimator.T


@dataclass(frozen=True, slots=True, eq=False)
class CoefficientFit:
    """What a calibration takes from the regression of its coefficients, with a prior or without."""

    parameters: VectorEstimate
    reproducibility: float  # scatter between measurements beyond their own stated uncertainty [Hz]
    condition_number: float


def weighted_least_squares(design: FloatArray, observed: FloatArray, weight: FloatArray) -> LeastSquaresFit:
    r"""Solve :math:`\min_\beta \sum_i w_i^2 (y_i - X_i\beta)^2` and tell how well the data determine β.

    The columns of the design X, shape (n, p), may differ by orders of magnitude: they are scaled to unit length. The
    weights w, shape (n,), are inverse standard deviations up to a common factor, which cancels in the covariance
    :math:`s^2 (X^T W^2 X)^{-1}`, :math:`s^2 = \sum w_i^2 r_i^2/(n-p)`. ``NotIdentifiableError`` if there are no more
    observations y, shape (n,), than parameters, or if the columns are dependent.

    Examples
    --------
    The line through (1, 1), (2, 2), (3, 2), as in any textbook: 2/3 + x/2.

    >>> x = np.array([1.0, 2.0, 3.0])
    >>> fit = weighted_least_squares(np.column_stack([np.ones(3), x]), np.array([1.0, 2.0, 2.0]), np.ones(3))
    >>> fit.parameters.values.round(4).tolist()
    [0.6667, 0.5]
    """
    n, p = design.shape
    if n <= p:
        raise NotIdentifiableError(f"{p} coefficients need at least {p + 1} readings to be judged; got {n}")
    weighted = design * weight[:, np.newaxis]
    scale = np.linalg.norm(weighted, axis=0)
    if not np.all(scale > 0.0):
        raise NotIdentifiableError("a coefficient has no influence on any reading: its column of the design is zero")
    u, singular, vt = np.linalg.svd(weighted / scale, full_matrices=False)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0.0 else float("inf")
    if condition > CONDITION_LIMIT:
        raise NotIdentifiableError(
            f"the readings cannot separate the {p} coefficients: condition number {condition:.1e}, "
            f"at most {CONDITION_LIMIT:.0e} expected; spread positions, preloads and influence quantities further"
        )
    estimator = (vt.T / singular) @ u.T * weight / scale[:, np.newaxis]
    beta = estimator @ observed
    residual = observed - design @ beta
    variance = float(np.sum((weight * residual) ** 2)) / (n - p)
    covariance = variance * (estimator / weight**2) @ estimator.T
    return LeastSquaresFit(
        VectorEstimate(beta, covariance, n - p), residual, estimator, np.sum(u**2, axis=1), condition
    )


def excess_variance(rows: ReadingRows, residual: FloatArray, leverage: FloatArray) -> float:
    r"""Return the variance between measurements that their stated uncertainties do not explain, in Hz².

    Method of moments (DerSimonian–Laird for a regression): the weighted sum of squares of the residuals [s²] has the
    expectation :math:`\sum (1-h_i) w_i^2 g_i^2 (\sigma_i^2 + c^2)`, g the slope, h the leverage of
    :class:`LeastSquaresFit`; solved for :math:`c^2`. Negative where the stated ones explain more than there is.
    """
    share = (1.0 - leverage) * (rows.weight * rows.slope) ** 2
    return float((np.sum((rows.weight * residual) ** 2) - np.sum(share * rows.stated**2)) / np.sum(share))


#: Positions closer than this are one position: a table does not stop better than that, and Eq. (8) does not care [m].
POSITION_RESOLUTION = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class ReadingColumns:
    """The readings as columns, each of shape (n_windows,)."""

    frequency: FloatArray  # [Hz]
    standard_uncertainty: FloatArray  # 0 where not stated [Hz]
    position: FloatArray  # [m]
    preload: FloatArray  # [N]
    payload: FloatArray  # [kg]
    temperature: FloatArray | None  # [°C]

    @property
    def payload_excess(self) -> FloatArray:
        """Above the lowest payload, the reference [kg]."""
        return self.payload - float(self.payload.min())

    @property
    def temperature_excess(self) -> FloatArray:
        """Above the mean temperature, the reference; 0 where not stated [K]."""
        if self.temperature is None:
            return np.zeros_like(self.payload)
        return self.temperature - float(self.temperature.mean())

    @property
    def inverse_square(self) -> FloatArray:
        """1/f² [s²]."""
        return 1.0 / self.frequency**2

    @property
    def slope(self) -> FloatArray:
        """|d(1/f²)/df| = 2/f³ [s³]."""
        return 2.0 / self.frequency**3


def reading_columns(readings: Sequence[ModalReading], weighting: Weighting) -> ReadingColumns:
    """Lay the readings out as columns; refuse a quantity that only some of them state."""

    def stated(name: str, values: list[float | None]) -> FloatArray | None:
        if all(v is None for v in values):
            return None
        if any(v is None for v in values):
            raise OutsideValidityError(
                f"{name} must be stated for all readings or for none; missing in {values.count(None)} of {len(values)}"
            )
        return np.array(values, dtype=np.float64)

    preload = stated("preload", [r.conditions.preload for r in readings])
    if preload is None:
        raise OutsideValidityError(f"a calibration needs the preload of every reading; got none of {len(readings)}")
    uncertainty = [r.standard_uncertainty for r in readings]
    if weighting is Weighting.STD and not all(uncertainty):
        raise OutsideValidityError(
            "weighting by scatter needs a positive frequency_std for every reading; "
            f"missing or zero in {sum(not u for u in uncertainty)} of {len(readings)}"
        )
    payload = stated("payload_mass", [r.conditions.payload_mass for r in readings])
    return ReadingColumns(
        frequency=np.array([r.frequency for r in readings]),
        standard_uncertainty=np.array([u or 0.0 for u in uncertainty]),
        position=np.array([r.conditions.position for r in readings]),
        preload=preload,
        payload=np.zeros(len(readings)) if payload is None else payload,
        temperature=stated("temperature", [r.conditions.temperature for r in readings]),
    )


def position_groups(position: FloatArray) -> list[FloatArray]:
    """Return the row numbers of the readings at each distinct position."""
    order = np.argsort(position, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(position[order]) > POSITION_RESOLUTION) + 1)


def refuse_too_few_settings(position: FloatArray, preload: FloatArray) -> None:
    """Raise NotIdentifiableError, naming what is missing, where Eq. (8) has more unknowns than settings."""
    positions, preloads = len(position_groups(position)), np.unique(preload).size
    missing = []
    if positions < 3:
        missing.append(f"three positions (at least 1 mm apart) for k1, k2, k4, got {positions}")
    if preloads < 2:
        missing.append(f"two preloads for k3, got {preloads}")
    if missing:
        raise NotIdentifiableError(
            f"a calibration needs, at one payload, at least {' and '.join(missing)}; with a prior (an earlier "
            "calibration, one predicted from identified joints, or a drive model, which asks for no known preload) "
            "one reading will do, and the interval is wide"
        )
