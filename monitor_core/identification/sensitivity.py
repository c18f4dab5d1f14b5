r"""Compute what each peak says of a joint: which mode to monitor, the least change that shows, where to measure next.

The nut's rigidity follows the preload, :math:`k_n \propto P^{1/3}` (Eq. (1) of Nguyen et al., ISO 3408-4), so that a
mode of sensitivity :math:`S = \partial \ln f/\partial \ln k_n` falls by :math:`\frac{S}{3} \Delta \ln P`: a tenth of
the preload is a third of a tenth of the rigidity, and of that the frequency shows the share S.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import NotIdentifiableError, OutsideValidityError
from monitor_core.fitting.residuals.peak_search import Band, Place, find_peaks_with_gradient, peak_grid
from monitor_core.fitting.solver.least_squares import LocalFit
from monitor_core.identification.cases import Case, positions_of
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.receptance import ReceptanceModel
from monitor_core.models.published.receptance.parameters import JOINT_NAMES, ReceptanceParameters

#: Eq. (1) of Nguyen et al. (2018): exponent of the preload in the nut's rigidity.
_PRELOAD_EXPONENT = 1.0 / 3.0
#: Relative eigenvalue of the information below which a direction is not seen.
_UNSEEN = 1e-12


@dataclass(frozen=True, slots=True)
class PeakSensitivity:
    """How the peak of a mode at a position answers to a joint."""

    conditions: DriveConditions
    mode: int  # from 1
    frequency: float  # [Hz]
    of_frequency: float  # ∂ ln f/∂ ln joint [-]
    of_amplitude: float  # ∂ ln |H|/∂ ln joint [-]


@dataclass(frozen=True, slots=True)
class Detectability:
    """The smallest loss that one measurement of a peak shows."""

    peak: PeakSensitivity
    relative_frequency_uncertainty: float  # standard uncertainty of ln f, of one measurement [-]
    stiffness_loss: float | None  # relative; None: no loss of the joint, however large, shows [-]
    preload_loss: float | None  # relative, where the joint is the nut and follows the preload [-]


@dataclass(frozen=True, slots=True, eq=False)
class NextPosition:
    """What a further position would bring."""

    conditions: DriveConditions
    standard_uncertainties: FloatArray  # predicted, of all coordinates; infinite where still unseen, (n_parameters,)
    log_volume: float  # ln of the determinant of the predicted covariance; infinite where a direction is unseen

    def __post_init__(self) -> None:
        object.__setattr__(self, "standard_uncertainties", read_only(self.standard_uncertainties))


def peak_sensitivities(
    parameters: ReceptanceParameters,
    conditions: Sequence[DriveConditions],
    bands: Mapping[int, Band],
    *,
    joint: str = "nut_stiffness",
    motor_end: MotorEnd = MotorEnd.FREE,
) -> tuple[PeakSensitivity, ...]:
    """Return how each peak answers to one of ``JOINT_NAMES``; a mode without a peak in its band is left out.

    Raises OutsideValidityError if the joint is none, or a position is not on the screw.
    """
    if joint not in JOINT_NAMES:
        raise OutsideValidityError(f"joint must be one of {', '.join(JOINT_NAMES)}; got {joint}")
    row, sensitivities = JOINT_NAMES.index(joint), []
    for stated in conditions:
        joints = parameters.joints(stated)
        grid = peak_grid(parameters, [Place(stated, band) for band in bands.values()], motor_end)
        here, value = find_peaks_with_gradient(grid, joints), getattr(joints, joint)
        sensitivities += [
            PeakSensitivity(
                stated,
                mode,
                float(here.peaks.frequency[k]),
                float(here.log_frequency[row, k] * value),
                float(here.log_amplitude[row, k] * value),
            )
            for k, mode in enumerate(bands)
            if here.peaks.found[k]
        ]
    return tuple(sensitivities)


def rank_modes_to_monitor(
    peaks: Sequence[PeakSensitivity],
    relative_frequency_uncertainty: Mapping[int, float],
    *,
    false_alarm: float = 0.05,
    detection: float = 0.90,
) -> tuple[Detectability, ...]:
    r"""Rank peaks by the smallest loss of stiffness that shows in their frequency; blind ones last.

    A fall is told from scatter, with the probabilities α of calling a loss where there is none, one-sided, and d of
    seeing one, once it is

    .. math::

        \Delta \ln f = (z_{1-\alpha} + z_{d})\, u, \qquad
        \frac{\Delta k}{k} = 1 - e^{-\Delta \ln f/S}, \qquad \frac{\Delta P}{P} = 1 - e^{-3 \Delta \ln f/S}

    for one measurement, with the standard uncertainty u of ln f of its mode, against a known healthy frequency;
    :math:`\sqrt 2` more where the healthy one is measured once too. S is taken as constant over the loss. A loss of
    preload follows from peaks with the sensitivity to the nut's stiffness.

    Raises OutsideValidityError if a mode has no positive uncertainty or a probability is not between 0 and 1.
    """
    if not (0.0 < false_alarm < 1.0 and 0.0 < detection < 1.0):
        raise OutsideValidityError(
            f"false_alarm and detection must lie between 0 and 1; got {false_alarm} and {detection}"
        )
    needed = float(scipy.special.ndtri(1.0 - false_alarm) + scipy.special.ndtri(detection))
    ranked = []
    for peak in peaks:
        uncertainty = relative_frequency_uncertainty.get(peak.mode, 0.0)
        if not uncertainty > 0.0:
            raise OutsideValidityError(f"mode {peak.mode} needs a positive relative_frequency_uncertainty")
        fall = needed * uncertainty / peak.of_frequency if peak.of_frequency > 0.0 else math.inf
        ranked.append(Detectability(peak, uncertainty, _loss(fall), _loss(fall / _PRELOAD_EXPONENT)))
    return tuple(sorted(ranked, key=lambda shown: -shown.peak.of_frequency / shown.relative_frequency_uncertainty))


def _loss(fall: float) -> float | None:
    """Return the relative loss of a fall of the logarithm; None where hardly anything would be left."""
    loss = -math.expm1(-fall)
    return loss if loss < 0.999 else None


def rank_next_positions(
    jacobian: FloatArray,
    candidates: Sequence[tuple[DriveConditions, FloatArray]],
    *,
    parameter: int | None = None,
) -> tuple[NextPosition, ...]:
    r"""Rank further positions by the uncertainty that the fit would have with one of them added.

    .. math::

        \mathbf C = \left( \mathbf J^T \mathbf J + \mathbf J_+^T \mathbf J_+ \right)^{-1}

    at the identified joints: what a measurement brings does not depend on what it will read. J, shape
    (n_residuals, n_parameters), is of the residuals in units of their uncertainty, and so is J₊ of each candidate, for
    example of :func:`~monitor_core.identification.cases.peaks.planned_peaks`. The variance of the ``parameter`` in this
    place is to be smallest (c-optimal); without it the determinant of the covariance is (D-optimal).

    Raises OutsideValidityError if there is no candidate or the shapes do not fit; NotIdentifiableError if no candidate
    makes the stated parameter, or the determinant, finite.
    """
    information = jacobian.T @ jacobian
    n = information.shape[0]
    if not candidates or any(added.shape[1:] != (n,) for _, added in candidates):
        raise OutsideValidityError(f"a next position needs candidates, each with a Jacobian of {n} columns")
    if parameter is not None and not 0 <= parameter < n:
        raise OutsideValidityError(f"parameter must be the place of one of {n} coordinates; got {parameter}")
    ranked = [_predicted(conditions, information + added.T @ added) for conditions, added in candidates]

    def worth(there: NextPosition) -> float:
        return there.log_volume if parameter is None else float(there.standard_uncertainties[parameter])

    ranked.sort(key=worth)
    if not math.isfinite(worth(ranked[0])):
        raise NotIdentifiableError(
            "no candidate position lets the data determine what was asked for; state another criterion or fix a joint"
        )
    return tuple(ranked)


def _predicted(conditions: DriveConditions, information: FloatArray) -> NextPosition:
    """Invert the information, scaled so that units do not decide what counts as unseen."""
    diagonal = np.diag(information)
    scale = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    seen = values > _UNSEEN * values[-1]
    inverse = np.where(seen, 1.0 / np.where(seen, values, 1.0), 0.0)
    variance = (vectors**2) @ inverse / scale**2
    blind = (vectors[:, ~seen] ** 2).sum(axis=1) > _UNSEEN
    uncertainty = np.where(blind, np.inf, np.sqrt(variance))
    log_volume = float(-np.sum(np.log(values)) - 2.0 * np.sum(np.log(scale))) if seen.all() else math.inf
    return NextPosition(conditions, uncertainty, log_volume)


#: Of one monitored frequency: what a judged measurement of some twenty windows states on the bundled sessions.
MONITORED_UNCERTAINTY = 1e-3
#: How many positions are weighed, and how far beyond those measured, as a part of the range that they span.
N_CANDIDATES, BEYOND = 15, 0.25
#: No position closer to a bearing than this part of the screw: the nut has a length.
_NEAREST_BEARING = 0.05


def modes_to_monitor(
    axis: ReceptanceParameters,
    conditions: Sequence[DriveConditions],
    frequencies: tuple[float, float],
    *,
    relative_frequency_uncertainty: float = MONITORED_UNCERTAINTY,
    motor_end: MotorEnd = MotorEnd.FREE,
) -> tuple[Detectability, ...]:
    """Rank the peaks of the table's receptance by the smallest loss of preload that they show, the best first.

    ``conditions`` are those one may monitor under, ``frequencies`` the lowest and highest that are measured [Hz].
    """
    peaks = [
        peak
        for stated in {each.position: each for each in conditions}.values()
        for peak in peak_sensitivities(
            axis, [stated], bands_at(axis, stated, frequencies, motor_end), motor_end=motor_end
        )
    ]
    return rank_modes_to_monitor(peaks, {peak.mode: relative_frequency_uncertainty for peak in peaks})


def bands_at(
    axis: ReceptanceParameters,
    conditions: DriveConditions,
    frequencies: tuple[float, float],
    motor_end: MotorEnd = MotorEnd.FREE,
) -> dict[int, Band]:
    """Return a band for each mode between two frequencies [Hz]: half way (geometrically) to its neighbours.

    It holds at one position: where modes change places along the screw, bands that hold at all positions do not exist.
    """
    modes = ReceptanceModel(axis).natural_frequencies(conditions, motor_end)
    elastic = [mode.frequency for mode in modes if mode.frequency > 0.0]
    edges = [elastic[0] / 2.0, *(math.sqrt(a * b) for a, b in itertools.pairwise(elastic))]
    edges.append(elastic[-1] * 1.5)
    return {
        mode: Band(edges[mode - 1], edges[mode])
        for mode, frequency in enumerate(elastic, start=1)
        if frequencies[0] <= frequency <= frequencies[1] and edges[mode - 1] < edges[mode]
    }


def next_positions(case: Case, fit: LocalFit, screw_length: float, parameter: int | None) -> tuple[NextPosition, ...]:
    """Rank positions at which a further measurement of the same kind would help most; none where no position helps.

    They are ranked by the variance of a ``parameter``, or without one by the determinant of the covariance.
    """
    measured = positions_of(case)
    candidates = [replace(case.conditions[0], position=position) for position in _candidates(measured, screw_length)]
    planned = case.planned(fit.coordinates.values, candidates)
    if not planned:
        return ()
    try:
        return rank_next_positions(fit.jacobian, planned, parameter=parameter)
    except NotIdentifiableError:
        return ()


def _candidates(measured: Sequence[float], screw_length: float) -> list[float]:
    reach = BEYOND * (measured[-1] - measured[0])
    low = max(measured[0] - reach, _NEAREST_BEARING * screw_length)
    high = min(measured[-1] + reach, (1.0 - _NEAREST_BEARING) * screw_length)
    candidates: list[float] = np.linspace(low, high, N_CANDIDATES).tolist()
    return candidates
