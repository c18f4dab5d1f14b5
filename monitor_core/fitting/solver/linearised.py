r"""Linearise a comparison around the likely errors of its conditions, which all values of a setting share.

With the misfit in its standard deviations, r, and its change T by the standard normal errors of its setting, the
covariance within a setting is :math:`V = I + T^T T`. Multiplied by :math:`V^{-1/2}` the residuals are independent and
standard normal where the model is right. With :math:`T T^T = U \Lambda U^T`, k by k for k errors,

.. math::

    V^{-1/2} = I - T^T U \, \mathrm{diag}\!\left( \frac{1 - (1 + \lambda)^{-1/2}}{\lambda} \right) U^T T

so that nothing larger than k by k is ever factorised. Values of different settings may share an error, too, as that of
the form of a model at one frequency: what is left is then whitened again, with a direction for each such error.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import BoolArray, FloatArray
from monitor_core.effects.effect import Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import CommonErrors, Comparison
from monitor_core.fitting.hypothesis import Hypothesis

#: Share of its variance that the values must determine for an error to have an estimate.
_LEAST_KNOWN = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class _CommonWhitening:
    r"""One direction for each error that values share: :math:`I - a a^T / (1 + \lambda + \sqrt{1 + \lambda})`."""

    group: npt.NDArray[np.intp]  # shape (n_values,)
    direction: FloatArray  # a, deviation of the error over that of the value, shape (n_values,)
    shrink: FloatArray  # shape (n_groups,)

    def __call__(self, values: FloatArray) -> FloatArray:
        """Return values (..., n_values) with the errors they share accounted for."""
        flat = values.reshape(-1, values.shape[-1])
        along = np.array([np.bincount(self.group, weights=self.direction * row) for row in flat])
        return np.asarray(flat - self.direction * (along * self.shrink)[:, self.group]).reshape(values.shape)


@dataclass(frozen=True, slots=True, eq=False)
class _OfAllSettings:
    """The directions of all settings side by side, each as long as the longest, so that one product takes them all."""

    place: npt.NDArray[np.intp]  # of each value, shape (n_settings, n_longest); beyond the last of a setting its last
    directions: FloatArray  # shape (n_settings, n_longest, n_errors); 0 beyond the last
    shrunk: FloatArray  # shape (n_settings, n_errors, n_longest)
    there: npt.NDArray[np.intp]  # of the values in the flat array of these, shape (n_values,)

    def taken_from(self, scaled: FloatArray) -> FloatArray:
        """Return what errors of the settings take from one misfit, shape (n_values,)."""
        along = scaled[self.place][:, None, :] @ self.directions
        return np.asarray((along @ self.shrunk).ravel()[self.there])


@dataclass(frozen=True, slots=True, eq=False)
class Whitening:
    """What turns misfits into independent standard normal residuals."""

    deviation: FloatArray  # of each value, shape (n_values,)
    directions: FloatArray  # T, shape (n_errors, n_values)
    starts: npt.NDArray[np.intp]  # first value of each setting, shape (n_settings,)
    setting: npt.NDArray[np.intp]  # shape (n_values,)
    shrink: FloatArray  # U diag(…) U^T of each setting, shape (n_settings, n_errors, n_errors)
    common: "_CommonWhitening | None"
    grams: FloatArray  # T T^T of each setting, shape (n_settings, n_errors, n_errors)
    of_all: _OfAllSettings

    def __call__(self, misfits: FloatArray) -> FloatArray:
        """Return residuals of misfits, shape (..., n_values)."""
        scaled = misfits / self.deviation
        if self.directions.shape[0] and scaled.ndim == 1:
            # a loop takes twice as long for one misfit; of many, as of a Jacobian, it copies less
            scaled -= self.of_all.taken_from(scaled)
        elif self.directions.shape[0]:
            ends = [*self.starts[1:].tolist(), scaled.shape[-1]]
            for start, end, shrink in zip(self.starts.tolist(), ends, self.shrink, strict=True):
                of_setting, directions = scaled[..., start:end], self.directions[:, start:end]
                of_setting -= (of_setting @ directions.T @ shrink) @ directions
        return scaled if self.common is None else self.common(scaled)

    def log_determinant(self, chosen: BoolArray) -> float:
        """Return ln det V over the settings of the chosen values, without that of the values' own deviations."""
        in_use = np.logical_or.reduceat(chosen, self.starts)
        return float(np.sum(np.linalg.slogdet(np.eye(self.grams.shape[1]) + self.grams[in_use])[1]))

    def errors(self, misfit: FloatArray) -> FloatArray:
        """Return the most likely errors of every setting, in standard deviations, shape (n_settings, n_errors)."""
        n_errors = self.directions.shape[0]
        if not n_errors:
            return np.zeros((self.starts.size, 0))
        scaled = misfit / self.deviation
        along = np.stack([np.add.reduceat(scaled * row, self.starts) for row in self.directions], axis=-1)
        return np.asarray(-np.linalg.solve(np.eye(n_errors) + self.grams, along[..., None])[..., 0])

    def pulls(self, misfit: FloatArray) -> FloatArray:
        """Return the errors in the deviation their estimates have, standard normal where the model is right.

        NaN where the values of a setting say nothing of an error; shape (n_settings, n_errors).
        """
        estimate = self.errors(misfit)
        n_errors = estimate.shape[1]
        inverse = np.linalg.inv(np.eye(n_errors) + self.grams)
        variance = np.einsum("skl,slk->sk", inverse, self.grams)
        determined = variance > _LEAST_KNOWN
        return np.where(determined, estimate / np.sqrt(np.where(determined, variance, 1.0)), np.nan)

    def share_of(self, errors: FloatArray) -> FloatArray:
        """Return the change of the misfit by condition errors, shape (n_values,)."""
        scaled = np.zeros_like(self.deviation)
        for k, row in enumerate(self.directions):
            scaled += row * errors[self.setting, k]
        return scaled * self.deviation


def whitening(
    deviation: FloatArray,
    directions: FloatArray,
    setting: npt.NDArray[np.intp],
    common: CommonErrors | None = None,
) -> Whitening:
    """Prepare the whitening of misfits whose values stand in the order of their settings.

    ``deviation`` is that of each value without the errors of its setting, shape (n_values,); ``directions`` are the
    changes of the misfit per standard deviation of each error, shape (n_errors, n_values).
    """
    starts = np.flatnonzero(np.r_[True, np.diff(setting) > 0])
    position = np.cumsum(np.r_[False, np.diff(setting) > 0])
    scaled = directions / deviation
    n_errors = scaled.shape[0]
    grams = np.zeros((starts.size, n_errors, n_errors))
    for k in range(n_errors):
        for other in range(n_errors):
            grams[:, k, other] = np.add.reduceat(scaled[k] * scaled[other], starts)
    values, vectors = np.linalg.eigh(grams)
    values = np.maximum(values, 0.0)
    factor = 1.0 / (1.0 + values + np.sqrt(1.0 + values))  # (1 − (1+λ)^(-1/2))/λ without cancellation
    shrink = np.einsum("skl,sl,sml->skm", vectors, factor, vectors)
    of_all = _side_by_side(scaled, starts, shrink)
    return Whitening(deviation, scaled, starts, position, shrink, _common(common, deviation), grams, of_all)


def _side_by_side(directions: FloatArray, starts: npt.NDArray[np.intp], shrink: FloatArray) -> _OfAllSettings:
    sizes = np.diff(np.r_[starts, directions.shape[1]])
    number = np.arange(np.max(sizes))
    place, there = starts[:, None] + np.minimum(number, sizes[:, None] - 1), number < sizes[:, None]
    padded = np.where(there, directions[:, place], 0.0).transpose(1, 0, 2)
    along = np.ascontiguousarray(padded.transpose(0, 2, 1))
    return _OfAllSettings(place, along, shrink @ padded, np.flatnonzero(there))


def _common(common: CommonErrors | None, deviation: FloatArray) -> _CommonWhitening | None:
    if common is None:
        return None
    direction = common.deviation / deviation
    power = np.bincount(common.group, weights=direction**2)
    return _CommonWhitening(common.group, direction, 1.0 / (1.0 + power + np.sqrt(1.0 + power)))


Answer = TypeVar("Answer")

_LIKELY = 3.0  # standard deviations: a condition error that seems larger is another misfit, and taken as linear


@dataclass(frozen=True, eq=False)
class Linearised(Generic[Physics]):
    """A comparison around likely condition errors, in which its misfit is linear.

    With the errors e that the settings are taken to have, and the change S of the misfit by them, the misfit of a
    setting with unknown errors is that at e less S e; whitening then finds whatever errors are most likely.
    """

    comparison: Comparison[Physics]  # shifted by the errors
    errors: FloatArray  # e, shape (n_settings, n_errors)
    whitened_by: Whitening
    offset: FloatArray  # −S e, shape (n_values,)
    here: FloatArray  # misfit of the physics around which it was linearised, shape (n_values,)

    def misfit(self, physics: Physics) -> FloatArray:
        """Return the misfit, shape (n_values,)."""
        return self.comparison.misfit(physics) + self.offset

    def residuals(self, physics: Physics) -> FloatArray:
        """Return independent residuals, standard normal where the physics is right, shape (n_values,)."""
        return self.whitened_by(self.misfit(physics))


def linearise(
    comparison: Comparison[Physics], physics: Physics, errors: FloatArray, deviation: FloatArray
) -> Linearised[Physics]:
    """Linearise a comparison around condition errors of shape (n_settings, n_errors)."""
    return _around(comparison.shifted(errors), physics, errors, deviation)


def linearise_again(around: Linearised[Physics], physics: Physics) -> Linearised[Physics]:
    """Linearise around the same condition errors for other physics near by, resolved as for those before."""
    return _around(around.comparison, physics, around.errors, around.whitened_by.deviation)


def _around(
    shifted: Comparison[Physics], physics: Physics, errors: FloatArray, deviation: FloatArray
) -> Linearised[Physics]:
    misfit, layout = shifted.misfit(physics), shifted.layout
    whitened_by = whitening(deviation, shifted.condition_errors(physics, misfit), layout.setting, layout.common)
    offset = -whitened_by.share_of(errors)
    return Linearised(shifted, errors, whitened_by, offset, misfit + offset)


def resolved_at_errors(
    comparison: Comparison[Physics], hypothesis: Hypothesis[Physics], errors: FloatArray, coordinates: FloatArray
) -> Comparison[Physics]:
    """Return a comparison as a finer resolution would have shown its data, at some coordinates and condition errors."""
    return _answer_at(partial(comparison.resolved, hypothesis.physics(coordinates)), errors)


def linearise_at_likely_errors(
    comparison: Comparison[Physics],
    hypothesis: Hypothesis[Physics],
    errors: FloatArray,
    deviation: FloatArray,
    coordinates: FloatArray,
    *,
    estimated_by: Whitening | None = None,
) -> Linearised[Physics]:
    """Linearise a comparison around the errors that are likely at coordinates, sought from other errors.

    Errors that stayed where they were likely before would let a search run far along what they almost make up for: the
    nut's stiffness, say, against a preload that was wrong in all settings alike. How the misfit goes with the errors
    may be ``estimated_by`` what it did near by, with the same deviation.
    """
    physics = hypothesis.physics(coordinates)
    resolved = resolved_at_errors(comparison, hypothesis, errors, coordinates)
    likely = partial(_likely_errors, resolved, physics, deviation=deviation, estimated_by=estimated_by)
    return _answer_at(partial(linearise, resolved, physics, deviation=deviation), _answer_at(likely, errors))


def _likely_errors(
    comparison: Comparison[Physics],
    physics: Physics,
    errors: FloatArray,
    deviation: FloatArray,
    estimated_by: Whitening | None,
) -> FloatArray:
    """Return the condition errors that are likely, within what is linear, sought from others."""
    if estimated_by is None:
        around = linearise(comparison, physics, errors, deviation)
        estimated_by, here = around.whitened_by, around.here
    else:
        here = comparison.shifted(errors).misfit(physics) - estimated_by.share_of(errors)
    return np.clip(estimated_by.errors(here), -_LIKELY, _LIKELY)


def _answer_at(ask: Callable[[FloatArray], Answer], errors: FloatArray) -> Answer:
    """Return the answer with condition errors, or without them where the model has no answer at those."""
    try:
        return ask(errors)
    except OutsideValidityError:
        return ask(np.zeros_like(errors))
