r"""Plan a calibration: which setting to measure next, how many are left, and which loss it will be able to see.

A reading at position x and preload P is a row of Eq. (8) of Nguyen et al. (2018). What rows X leave unknown of a
reading at a healthy preload :math:`P_0` is

.. math:: s^2 \left(1 + a^T (X^T X)^{-1} a\right), \qquad a = (x^2, x, P_0^{-1/3}, 1)

and a loss is seen where it lowers the frequency by :math:`t_{.95} + t_{.90}` of that, with n − 4 degrees of freedom: as
:func:`monitor_core.preload.minimum_detectable_loss`, with what the coefficients themselves leave open.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.preload.calibration import feature_design
from monitor_core.preload.feature import PreloadFeatureCoefficients, axial_frequency, preload_from_feature
from monitor_core.preload.regression import refuse_too_few_settings

#: Standard deviation of a reading where nothing is known of an axis, of its frequency: 0.22 Hz about Eq. (8) at 178 Hz,
#: Table 2 of Nguyen et al. (2018).
USUAL_SCATTER: Final = 1.25e-3
#: Rows of a design that are not enough to fit by are compared as if so much of each column were known before.
_RIDGE: Final = 1e-6
#: A plan that needs more measurements than this is none.
_MOST: Final = 200


@dataclass(frozen=True, slots=True)
class PlannedSetting:
    """Where the table stands and which preload is set."""

    position: float  # [m]
    preload: float  # [N]


@dataclass(frozen=True, slots=True)
class ExpectedReadings:
    """What readings of the axis are expected to be like: from a calibration of before, or from a model."""

    coefficients: PreloadFeatureCoefficients
    scatter: float  # standard deviation of a reading [Hz]


@dataclass(frozen=True, slots=True)
class CalibrationPlan:
    """What is measured of a grid of settings, and what to do next."""

    holes: tuple[PlannedSetting, ...]  # settings of the grid that were not measured
    proposed: PlannedSetting
    smallest_loss: float | None  # that is seen with what was measured; None: not enough for a fit [N]
    smallest_loss_then: float | None  # with the proposed setting, too [N]
    n_left: int | None  # measurements until the wished loss is seen; None: the scatter of the axis does not let it


def plan_calibration(
    measured: Sequence[PlannedSetting],
    grid: Sequence[PlannedSetting],
    expected: ExpectedReadings | None,
    *,
    healthy_preload: float,
    wished_loss: float,
) -> CalibrationPlan:
    """Propose what to measure next of a grid of settings, after what was measured.

    Of the grid that setting is proposed after which the smallest loss is seen; as long as there is no fit, the one that
    determines most of it (the determinant of its design). Without expected readings no loss is predicted, and the
    measurements that are left are the holes of the grid. ``NotIdentifiableError`` if the grid has fewer than three
    positions or two preloads; ``OutsideValidityError`` if a preload is not positive.
    """
    if not (healthy_preload > 0.0 and wished_loss > 0.0):
        raise OutsideValidityError(
            f"healthy preload and wished loss must be positive; got {healthy_preload:g} and {wished_loss:g} N"
        )
    _rows(grid)
    refuse_too_few_settings(np.array([item.position for item in grid]), np.array([item.preload for item in grid]))
    places = sorted({item.position for item in grid})

    def loss(settings: Sequence[PlannedSetting]) -> float | None:
        return None if expected is None else smallest_loss(settings, expected, places, healthy_preload)

    holes = tuple(item for item, times in zip(grid, _times_measured(grid, measured), strict=True) if times == 0)
    proposed = proposed_setting(measured, grid, expected, healthy_preload)
    now = loss(measured)
    return CalibrationPlan(
        holes,
        proposed,
        now,
        loss([*measured, proposed]),
        len(holes) if expected is None else _left(measured, grid, expected, healthy_preload, wished_loss),
    )


def smallest_loss(
    settings: Sequence[PlannedSetting], expected: ExpectedReadings, positions: Sequence[float], healthy_preload: float
) -> float | None:
    """Predict which loss of preload readings at these settings let one more reading see, at the worst position [N].

    None if they are not enough for a fit; infinite or as large as the preload where nothing is seen.
    """
    if not _suffice(settings):
        return None
    dof = len(settings) - 4
    k, places = expected.coefficients, np.asarray(positions, dtype=np.float64)
    a = feature_design(places, np.full_like(places, healthy_preload))
    leverage = _leverage(_rows(settings), a)
    reach = (scipy.special.stdtrit(dof, 0.95) + scipy.special.stdtrit(dof, 0.90)) * expected.scatter
    slope = 2.0 / axial_frequency(places, healthy_preload, k) ** 3
    feature = k.k3 * np.cbrt(1.0 / healthy_preload) + reach * slope * np.sqrt(1.0 + leverage)
    return float(np.max(healthy_preload - preload_from_feature(feature, k)))


def proposed_setting(
    measured: Sequence[PlannedSetting],
    grid: Sequence[PlannedSetting],
    expected: ExpectedReadings | None,
    healthy_preload: float,
) -> PlannedSetting:
    """Return the setting of the grid after which most is known; of equal ones that which was measured least."""
    places = sorted({item.position for item in grid})
    scale = np.linalg.norm(_rows(grid), axis=0)

    def cost(item: PlannedSetting, again: int) -> tuple[bool, float, int]:
        settings = [*measured, item]
        loss = None if expected is None else smallest_loss(settings, expected, places, healthy_preload)
        if loss is not None:
            return False, round(loss, 9), again
        rows = _rows(settings) / scale
        determinant = float(np.linalg.slogdet(rows.T @ rows + _RIDGE * np.eye(4))[1])
        return True, -round(determinant, 9), again

    costs = [cost(item, again) for item, again in zip(grid, _times_measured(grid, measured), strict=True)]
    return grid[costs.index(min(costs))]


def _left(
    measured: Sequence[PlannedSetting],
    grid: Sequence[PlannedSetting],
    expected: ExpectedReadings,
    healthy_preload: float,
    wished_loss: float,
) -> int | None:
    """Count the measurements, each the best next one, until the wished loss is seen."""
    places = sorted({item.position for item in grid})
    k, reach = expected.coefficients, (scipy.special.ndtri(0.95) + scipy.special.ndtri(0.90)) * expected.scatter
    slope = 2.0 / axial_frequency(np.asarray(places), healthy_preload, k) ** 3
    limit = healthy_preload - preload_from_feature(k.k3 * np.cbrt(1.0 / healthy_preload) + reach * slope, k)
    if float(np.max(limit)) >= wished_loss:
        return None
    settings = list(measured)
    for count in range(_MOST):
        loss = smallest_loss(settings, expected, places, healthy_preload)
        if loss is not None and loss <= wished_loss:
            return count
        settings.append(proposed_setting(settings, grid, expected, healthy_preload))
    return None


def _rows(settings: Sequence[PlannedSetting]) -> FloatArray:
    preloads = np.array([item.preload for item in settings])
    if not np.all(preloads > 0.0):
        raise OutsideValidityError(f"the preload of a setting must be positive; got {preloads.min():g} N")
    return feature_design(np.array([item.position for item in settings]), preloads)


def _leverage(rows: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return aᵀ(XᵀX)⁻¹a of each wanted row, columns scaled so that their units do not matter."""
    scale = np.linalg.norm(rows, axis=0)
    _, r = np.linalg.qr(rows / scale)
    solved = np.linalg.solve(r.T, (wanted / scale).T)
    return np.asarray(np.sum(solved**2, axis=0))


def _suffice(settings: Sequence[PlannedSetting]) -> bool:
    if len(settings) < 5:
        return False
    try:
        refuse_too_few_settings(
            np.array([item.position for item in settings]), np.array([item.preload for item in settings])
        )
    except NotIdentifiableError:
        return False
    return bool(np.linalg.matrix_rank(_rows(settings) / np.linalg.norm(_rows(settings), axis=0), tol=1e-8) == 4)


#: A table that stands nearer than this to a setting, with a preload that differs by less, was measured there.
NEAR_POSITION, NEAR_PRELOAD = 0.02, 0.1  # [m], [-]


def _times_measured(grid: Sequence[PlannedSetting], measured: Sequence[PlannedSetting]) -> list[int]:
    """Count for each setting of the grid how often it was measured."""
    positions, preloads = (
        tuple(np.array([getattr(item, name) for item in items]) for items in (grid, measured))
        for name in ("position", "preload")
    )
    near = np.abs(np.subtract.outer(*positions)) <= NEAR_POSITION
    near &= np.abs(np.subtract.outer(*preloads)) <= NEAR_PRELOAD * preloads[0][:, np.newaxis]
    return [int(times) for times in near.sum(axis=1)]
