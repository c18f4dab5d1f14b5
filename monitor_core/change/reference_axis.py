"""Fit what the description of an axis leaves open to its reference measurements, with the covariance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.change.cells import ChangeTolerances
from monitor_core.change.reference_ratio import ThenAndNow, compare_reference
from monitor_core.effects.drive_effects import WARMING
from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.axis import DescribedDrive
from monitor_core.fitting.evidence import covariance, evidence_scale
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.observations import (
    ACCELEROMETER_POINTS,
    FrequencyResponseObservation,
    with_accelerometer_at,
)
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit
from monitor_core.models.protocol import ResponsePoint

#: A direction in which the reference leaves less than this is as good as known, in prior standard deviations.
_KNOWN = 1e-4
#: Beyond it, in deviations of the form, a model is wrong in more than its form.
_LARGEST_GAP = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Unchanged:
    """A drive that is the same at both times, as the reference is fitted with."""

    drive: DescribedDrive

    @property
    def uncertain(self) -> Mapping[str, float]:
        """As the drive."""
        return self.drive.uncertain

    def physics(self, ln_ratios: Mapping[str, float]) -> ThenAndNow:
        """Return the axis with these parameters moved, at both times."""
        axis = self.drive.physics(ln_ratios)
        return ThenAndNow(then=axis, now=axis)


@dataclass(frozen=True, slots=True)
class SettledAxis:
    """An axis at two times that leaves nothing open: it has no uncertain parameters."""

    axis: ThenAndNow

    @property
    def uncertain(self) -> Mapping[str, float]:
        """Return nothing."""
        return {}

    def physics(self, ln_ratios: Mapping[str, float]) -> ThenAndNow:
        """Return the axis."""
        del ln_ratios
        return self.axis


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceAxis:
    """A drive as its reference shows it; its uncertain parameters are independent and standard normal.

    They are the principal directions of what the reference leaves open of the drive's own parameters.
    """

    drive: DescribedDrive
    names: tuple[str, ...]  # of the drive's uncertain parameters
    centre: FloatArray  # their ln-ratios, shape (n_names,)
    root: FloatArray  # covariance = root @ root.T, shape (n_names, n_directions)
    accelerometer: ResponsePoint
    gap: float  # rms misfit of the reference after the fit, in standard deviations
    reported_warming: float = 0.0  # by the windows, now less then [K]

    def as_fitted(self) -> "SettledAxis":
        """Return the axis with nothing left open."""
        return SettledAxis(self.physics({}))

    @property
    def uncertain(self) -> Mapping[str, float]:
        """Return the directions."""
        return {f"direction {index + 1}": 1.0 for index in range(self.root.shape[1])}

    def physics(self, ln_ratios: Mapping[str, float]) -> ThenAndNow:
        """Return the axis, now as warm as the windows report."""
        along = np.array([ln_ratios.get(name, 0.0) for name in self.uncertain])
        ratios = self.centre + self.root @ along
        axis = self.drive.physics(dict(zip(self.names, ratios.tolist(), strict=True)))
        return ThenAndNow(then=axis, now=WARMING.added_to(axis, {"temperature_k": self.reported_warming}))


def fit_reference(
    drive: DescribedDrive, reference: Sequence[FrequencyResponseObservation], tolerances: ChangeTolerances
) -> ReferenceAxis:
    """Fit what a description leaves open to the reference, with the accelerometer where that fits better.

    Raises NotIdentifiableError as :func:`compare_reference`, or if the model does not describe the reference: what it
    says of changes would be worth no more; OutsideValidityError if the model has no answer under one of the conditions.
    """
    hypothesis = Hypothesis(Unchanged(drive))
    trials = []
    for point in ACCELEROMETER_POINTS:
        comparison = compare_reference(with_accelerometer_at(point, reference), tolerances)
        trials.append((fit(comparison, hypothesis, hypothesis.null), point))
    axis = _about(drive, *min(trials, key=lambda trial: trial[0].cost))
    if axis.gap > _LARGEST_GAP:
        raise NotIdentifiableError(
            f"the model must describe the reference of its axis to {100.0 * _LARGEST_GAP * tolerances.form:.0f} % rms; "
            f"got {100.0 * axis.gap * tolerances.form:.0f} %: find what it lacks first"
        )
    return axis


def _about(drive: DescribedDrive, fitted: Fitted[ThenAndNow], accelerometer: ResponsePoint) -> ReferenceAxis:
    hypothesis = fitted.hypothesis
    of_coordinates = covariance(fitted, evidence_scale(fitted))
    variances, directions = np.linalg.eigh(of_coordinates)
    still_open = variances > _KNOWN**2
    deviations = np.array([drive.uncertain[name] for name in hypothesis.uncertain])
    root = deviations[:, None] * directions[:, still_open] * np.sqrt(variances[still_open])
    ratios = hypothesis.ln_ratios(fitted.coordinates)
    return ReferenceAxis(drive, hypothesis.uncertain, np.array(list(ratios.values())), root, accelerometer, fitted.gap)
