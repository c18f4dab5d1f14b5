r"""Find the records that a fit has bent to: with a tag of their own and everything else refitted, much would be taken.

A wrong record pulls the fit towards itself. What is left of its misfit is small then, and other records stand out in
its place. With the residuals r of the fit, their derivatives J by its coordinates, the precision
:math:`G = J^T J + \Pi` with the priors', and the change d of the residuals by a tag of one record, a linear refit with
that tag free takes

.. math::

    \Delta\chi^2 = \frac{(d^T r)^2}{d^T d - d^T J G^{-1} J^T d}

Added-variable test of a mean shift (Cook and Weisberg, Residuals and Influence in Regression, 1982, section 2.2).
"""

import math
from collections.abc import Iterator

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.explanation import RecordFault
from monitor_core.discrepancy.records.faults import TAGS, slope_by_tag
from monitor_core.effects.effect import Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import HasRecords
from monitor_core.fitting.evidence import VERY_STRONG, evidence_scale
from monitor_core.fitting.solver.hypothesis_fit import Fitted

#: Of the squares of a direction, what a refit must leave of it for it to say anything.
_LEAST_LEFT = 1e-3
#: Of a range of tags, to see how the misfit moves with one.
_STEP = 1e-3


def bent_to(fitted: Fitted[Physics], records: HasRecords[Physics]) -> dict[int, float]:
    """Return the records of a fit that would very strongly have a tag or gain of their own, with the evidence for it.

    By their places, best first. ``records`` is the comparison that was fitted. A record that was held out has bent
    nothing.
    """
    taken = np.max([taken_by_each(fitted, row) for row in _directions(fitted, records)], axis=0)
    scale = evidence_scale(fitted)
    price = 2.0 * math.log(taken.size * len(RecordFault))
    evidence = scale.factor * taken - scale.penalty(1) - price
    order = np.argsort(-evidence, kind="stable")
    return {index: float(evidence[index]) for index in order.tolist() if evidence[index] > VERY_STRONG}


def _directions(fitted: Fitted[Physics], records: HasRecords[Physics]) -> Iterator[FloatArray]:
    """Yield the changes of the misfit by the condition errors, and by the tags that are none, shape (n_values,)."""
    whitened_by = fitted.around.whitened_by
    yield from whitened_by.directions * whitened_by.deviation
    physics = fitted.physics()
    ranges = records.tag_ranges(physics, 0)
    for tag in TAGS:
        if tag in ranges and tag not in {"position", "preload"}:
            at, (low, high) = records.tags(tag), ranges[tag]
            try:
                yield slope_by_tag(records, physics, tag, at, np.full_like(at, _STEP * (high - low)))
            except OutsideValidityError:
                continue


def taken_by_each(fitted: Fitted[Physics], change: FloatArray) -> FloatArray:
    """Return what an unknown amount of a change of the misfit in one record alone takes of χ², (n_settings,).

    Everything else is refitted, as far as the misfit is linear in it.
    """
    chosen, setting = fitted.fitted, fitted.comparison.layout.setting
    n_settings = len(fitted.comparison.layout.settings)
    along = np.where(chosen, fitted.around.whitened_by(change), 0.0)
    inverse = np.linalg.pinv(fitted.precision(), hermitian=True)

    def sums(values: FloatArray) -> FloatArray:
        return np.bincount(setting, weights=along * values, minlength=n_settings).astype(np.float64)

    square = sums(along)
    with_coordinates = np.array([sums(column) for column in fitted.jacobian.T]).reshape(-1, n_settings)
    left = square - np.einsum("ks,kl,ls->s", with_coordinates, inverse, with_coordinates)
    known = left > _LEAST_LEFT * square
    return np.where(known, sums(fitted.standardised) ** 2 / np.where(known, left, 1.0), 0.0)
