r"""Joints that are stated far from where they are: a table that numbers its modes says where to begin.

By its frequency alone a peak finds its mode only near one of the model. Where a table numbers its modes, its n-th peak
is the n-th elastic mode wherever the model has that, and the springs are moved until

.. math::

    \sum \left( \frac{1}{u} \ln\frac{f_n}{f_t} \right)^2

is least, with f_n the natural frequencies of the drive without its losses (every spring raises every one of them, so
that the way is clear from afar). There modes are given their peaks, and there limits are set. The answer itself is
looked for as it always is.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.errors import MonitorCoreError, NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.coordinates import FreeParameters, is_spring
from monitor_core.fitting.observations import AssignedPeak, ModalObservation, conditions_in_order
from monitor_core.fitting.problem import Bounds
from monitor_core.fitting.residuals.peak_search import relative_frequency_uncertainty
from monitor_core.fitting.solver.least_squares import FitSettings, Patience, fit_local
from monitor_core.models.extended import elastic_frequencies
from monitor_core.models.protocol import DriveConditions, DriveModel, MotorEnd
from monitor_core.models.published.receptance import ReceptanceModel
from monitor_core.models.published.receptance.chain import discretise, undamped_frequencies

#: Gives peaks of a table to the modes of a drive; raises NotIdentifiableError where they belong to none.
Assign = Callable[[FreeParameters], tuple[AssignedPeak, ...]]

#: Springs are looked for within so many decades of what is stated, from there and from corners of a box around it.
_DECADES, _CORNER = 3.0, math.log10(5.0)
_COARSE = FitSettings(patience=Patience(25, flat=1e-3))
_STEP = 1e-4  # of a coordinate for its differences, in decades


def nearer(drive: FreeParameters, observations: Sequence[ModalObservation], assign: Assign) -> Mapping[str, float]:
    """Return parameters from which the modes of a table are found: those stated, or nearer ones where it numbers them.

    Those stated are kept where they give the peaks the numbers of the table, where it has no numbers that rise with the
    frequency, and where springs do not meet it better by its numbers than as the peaks lie. Dampers that go with a
    spring keep their time constant c/k.
    """
    numbered = _numbered(observations)
    as_stated = _assigned(drive, assign)
    if numbered is None or as_stated == numbered:
        return drive.parameters
    by_number = _approached(drive, numbered)
    if by_number is None or _assigned(by_number.drive, assign) != numbered:
        return drive.parameters
    as_they_lie = None if as_stated is None else _approached(drive, as_stated)
    if as_they_lie is not None and as_they_lie.misfit <= by_number.misfit:
        return drive.parameters
    return by_number.drive.parameters


@dataclass(frozen=True, slots=True, eq=False)
class _Approach:
    """A drive whose springs meet a table as well as they can."""

    drive: FreeParameters
    misfit: float  # χ² of the frequencies


@dataclass(frozen=True, slots=True, eq=False)
class _ByNumber:
    """Logarithmic errors of the natural frequencies of a drive without losses, each of a mode by its number."""

    drive: FreeParameters
    peaks: tuple[AssignedPeak, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return self.drive.free

    def residuals(self, coordinates: FloatArray) -> FloatArray:
        model = self.drive.model(coordinates)
        places = conditions_in_order(peak.observation for peak in self.peaks)
        elastic = dict(zip(places, _elastic_frequencies(model, places), strict=True))
        if any(peak.mode > elastic[peak.observation.conditions].size for peak in self.peaks):
            raise OutsideValidityError("the model has fewer elastic modes than the table numbers")
        predicted = [elastic[peak.observation.conditions][peak.mode - 1] for peak in self.peaks]
        measured = [peak.observation.frequency for peak in self.peaks]
        return np.log(np.divide(predicted, measured)) / [
            relative_frequency_uncertainty(p.observation) for p in self.peaks
        ]

    def jacobian(self, coordinates: FloatArray) -> FloatArray:
        here = self.residuals(coordinates)  # to one side: it is the way that matters, not the last digit of its end
        return np.array([self.residuals(coordinates + h) - here for h in _STEP * np.eye(coordinates.size)]).T / _STEP


def _numbered(observations: Sequence[ModalObservation]) -> tuple[AssignedPeak, ...] | None:
    """Return the peaks with the modes that their numbers say; None unless all rise with the frequency everywhere."""
    peaks = tuple(AssignedPeak(each, each.order) for each in observations if each.order is not None)
    for stated in conditions_in_order(observations):
        here = sorted((peak for peak in peaks if peak.observation.conditions == stated), key=lambda peak: peak.mode)
        if np.any(np.diff([peak.mode for peak in here]) == 0):
            return None
        if np.any(np.diff([peak.observation.frequency for peak in here]) <= 0.0):
            return None
    return peaks if len(peaks) == len(observations) else None


def _assigned(drive: FreeParameters, assign: Assign) -> tuple[AssignedPeak, ...] | None:
    try:
        return assign(drive)
    except (NotIdentifiableError, OutsideValidityError):
        return None


def _approached(drive: FreeParameters, peaks: tuple[AssignedPeak, ...]) -> _Approach | None:
    """Move the springs to where they meet the frequencies best; None where that cannot be."""
    springs = tuple(name for name in drive.free if is_spring(name))
    lossless = {name: value if is_spring(name) else 0.0 for name, value in drive.parameters.items()}
    if not springs:
        return None
    problem = _ByNumber(replace(drive, parameters=lossless, free=springs, uncertain={}), peaks)
    stated = problem.drive.start
    bounds = Bounds(stated - _DECADES, stated + _DECADES)
    corners = _CORNER * scipy.linalg.hadamard(2 ** math.ceil(math.log2(stated.size + 1)))[:, 1 : stated.size + 1]
    fits = []
    for start in (stated, *(stated + corners)):  # each spring is softer in half of them, any two alike in half
        try:
            fits.append(fit_local(problem, bounds, start, _COARSE))
        except MonitorCoreError:  # no answer from there
            continue
    if not fits:
        return None
    best = min(fits, key=lambda fit: fit.chi_squared)
    factors = {name: 10.0**moved for name, moved in zip(springs, best.coordinates.values - stated, strict=True)}
    near = {name: value * factors.get(_spring_of(name), 1.0) for name, value in drive.parameters.items()}
    return _Approach(replace(drive, parameters=near, uncertain={}), best.chi_squared)


def _spring_of(name: str) -> str:
    """Return the spring that a damper is beside, or the name itself."""
    joint, _, unit = name.partition("_damping_")
    return f"{joint}_stiffness_{unit.replace('ns', 'n').replace('nms', 'nm')}" if unit else name


def _elastic_frequencies(model: DriveModel, places: Sequence[DriveConditions]) -> list[FloatArray]:
    """Return natural frequencies above zero, rising [Hz]; those of a chain are had in a tenth of the time."""
    if isinstance(model, ReceptanceModel):
        chains = (discretise(model.parameters, stated, MotorEnd.FREE) for stated in places)
        return [undamped_frequencies(chain) / (2.0 * math.pi) for chain in chains]
    return elastic_frequencies(model, places)
