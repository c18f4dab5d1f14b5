"""What an identification answers, from fitted coordinates: joints with intervals, verdicts, sums, what is left open."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray, read_only
from monitor_core.fitting.axis import AxisDescription
from monitor_core.identification.cases import Case, DroppedPeak, PeakCase, PredictionError, ResponseCase, positions_of
from monitor_core.identification.identifiability import CoordinateJudgement, Verdict
from monitor_core.identification.joint_fit import JointFit
from monitor_core.identification.sensitivity import Detectability, next_positions
from monitor_core.models.parameters import PARAMETERS, name_in_file
from monitor_core.preload import Calibration
from monitor_core.uncertainty import Estimate, Interval


@dataclass(frozen=True, slots=True)
class IdentifiedJoint:
    """One joint."""

    estimate: Estimate  # SI; its uncertainty infinite where the model misses the data
    unit: str
    interval: (
        Interval | None
    )  # 95 % coverage, SI; none where the model misses the data: it would not hold what is missed
    from_profile: bool  # whether the interval is that of the profile of χ² and not linear in the logarithm
    verdict: Verdict
    at_limit: bool
    identifiable: bool  # whether the value may be relied on by itself


@dataclass(frozen=True, slots=True)
class KnownSum:
    """A sum of two stiffnesses, or of two dampings, that is known better than its parts."""

    of: tuple[str, str]  # names in files
    estimate: Estimate  # SI
    unit: str


@dataclass(frozen=True, slots=True)
class FitQuality:
    """How the joints fit the data that they were found from, and how far the search is to be relied on."""

    kind: str  # "whole responses" or "peaks"
    chi_squared: float  # [-]
    degrees_of_freedom: int
    residual_standard_deviation: float  # in units of the stated uncertainties [-]
    lack_of_fit: bool  # the model misses the data by more than their uncertainties
    starts: int
    starts_agreeing: float  # share of the starts that reached the optimum [-]
    evaluations: int
    seed: int
    positions: tuple[float, ...]  # that the fit saw [m]
    paper_objective: float | None  # y of Eq. (26) of Tian et al., of peaks of a receptance model [-]


@dataclass(frozen=True, slots=True)
class HeldOutErrors:
    """How far predictions are off where they were not fitted."""

    errors: tuple[PredictionError, ...]  # at least one
    leave_one_out: bool  # from as many fits as there are positions, each without one
    not_held_out: tuple[float, ...]  # positions that cannot be left out [m]

    @property
    def worst(self) -> PredictionError:
        """The largest of the errors."""
        return max(self.errors, key=lambda error: abs(error.relative_error))


@dataclass(frozen=True, slots=True)
class FromPositions:
    """Joints as some positions give them, and what these joints are worth at every position."""

    positions: tuple[float, ...]  # [m]
    joints: Mapping[str, float]  # SI, by their names in files
    errors: tuple[PredictionError, ...]  # at all positions, their own among them


@dataclass(frozen=True, slots=True)
class FurtherPosition:
    """What a further measurement at a position would bring."""

    position: float  # [m]
    relative_uncertainties: Mapping[str, float]  # predicted standard uncertainty of each joint; inf: still unseen [-]


@dataclass(frozen=True, slots=True, eq=False)
class IdentifiedJoints:
    """The whole answer."""

    joints: Mapping[str, IdentifiedJoint]  # by their names in files
    correlations: FloatArray  # in the order of the joints, shape (n_joints, n_joints) [-]
    not_identifiable: tuple[str, ...]  # what the data do not determine, in sentences
    sums: tuple[KnownSum, ...]
    quality: FitQuality
    held_out: HeldOutErrors | None  # None where nothing could be held out
    robustness: tuple[FromPositions, ...]  # each position alone, then all that were not held out; else empty
    missing_modes: tuple[str, ...]  # modes that a position does not show, in sentences
    dropped_peaks: tuple[DroppedPeak, ...]  # that are no axial mode
    next_positions: tuple[FurtherPosition, ...]  # the most helpful first
    modes_to_monitor: tuple[Detectability, ...]  # the best first; empty where the family does not tell
    assumptions: tuple[str, ...]  # what was settled before the fit, in sentences
    calibration: Calibration | None  # predicted from the joints where asked for
    model: AxisDescription  # the description with the joints found

    def __post_init__(self) -> None:
        object.__setattr__(self, "correlations", read_only(self.correlations))


#: Units of what may be free, by its names in files.
_UNITS = {name_in_file(word.name): word.unit for word in PARAMETERS}
_NUT = "nut_stiffness_n_per_m"
#: Relative standard uncertainty up to which a sum is worth stating beside parts that are not told apart.
_WELL_KNOWN = 0.1
#: Share of the starts that must reach the optimum, or it is not to be relied on.
_LEAST_AGREEMENT = 1.0 / 3.0


def joints_of_fit(fit: JointFit) -> Mapping[str, IdentifiedJoint]:
    """Return the joints by their names in files."""
    relied_on = fit.search.agreement() >= _LEAST_AGREEMENT
    inseparable = {name for pair in fit.judged.pairs for name in (pair.first, pair.second)}
    return {
        judged.name: _joint(
            judged,
            fit.lack_of_fit,
            relied_on and judged.verdict is not Verdict.NOT_DETERMINED and judged.name not in inseparable,
        )
        for judged in fit.judged.coordinates
    }


def what_is_not_identifiable(fit: JointFit) -> tuple[str, ...]:
    """Say what the data do not determine: single joints, pairs, and what the fit leaves out."""
    judged, agreement = fit.judged, fit.search.agreement()
    sentences = [
        f"{joint.name} is not determined by these data" + (": it ended at its limit" if joint.at_bound else "")
        for joint in judged.coordinates
        if joint.verdict is Verdict.NOT_DETERMINED
    ]
    sentences += [
        f"{pair.first} and {pair.second} are not told apart: their correlation is {pair.correlation:.3f}"
        for pair in judged.pairs
    ]
    if agreement < _LEAST_AGREEMENT:
        sentences.append(
            f"only {agreement:.0%} of the starts reached this optimum: another seed may find a better one, and "
            "nothing of this one is to be relied on"
        )
    if fit.lack_of_fit:
        sentences.append(
            "the model misses the data by more than their uncertainties; no interval would hold what it leaves out, so "
            "that none is stated, and no calibration is predicted"
        )
    if judged.better_exists:
        sentences.append("a better fit exists than the search found: search again with another seed")
    return tuple(sentences)


def known_sums(joint_fit: JointFit) -> tuple[KnownSum, ...]:
    """Return the sums of stiffnesses, or of dampings, that are known better than their parts; none to a lack of fit."""
    fit = joint_fit.fit
    sums: list[KnownSum] = []
    if joint_fit.lack_of_fit:
        return ()
    for pair in joint_fit.judged.pairs:
        if pair.correlation > 0.0 or _UNITS[pair.first] != _UNITS[pair.second]:
            continue
        places = [fit.names.index(name) for name in (pair.first, pair.second)]
        values = 10.0 ** fit.coordinates.values[places]
        gradient = np.zeros(len(fit.names))
        gradient[places] = np.log(10.0) * values
        value, uncertainty = float(values.sum()), fit.standard_uncertainty_of(gradient)
        if uncertainty <= _WELL_KNOWN * value:
            sums.append(KnownSum((pair.first, pair.second), Estimate(value, uncertainty), _UNITS[pair.first]))
    return tuple(sums)


def quality_of(joint_fit: JointFit, case: Case) -> FitQuality:
    """Return how the joints fit the data they were found from."""
    fit, search = joint_fit.fit, joint_fit.search
    peaks = case if isinstance(case, PeakCase) else None
    return FitQuality(
        kind="whole responses" if isinstance(case, ResponseCase) else "peaks",
        chi_squared=fit.chi_squared,
        degrees_of_freedom=fit.degrees_of_freedom,
        residual_standard_deviation=float(np.sqrt(fit.chi_squared / max(fit.degrees_of_freedom, 1))),
        lack_of_fit=joint_fit.lack_of_fit,
        starts=len(search.fits) + len(search.failed),
        starts_agreeing=search.agreement(),
        evaluations=search.n_evaluations,
        seed=joint_fit.seed,
        positions=joint_fit.trained_on,
        paper_objective=None if peaks is None else peaks.paper_objective(fit.coordinates.values, joint_fit.trained_on),
    )


def held_out_errors(fit: JointFit) -> HeldOutErrors | None:
    """Return how far predictions are off at positions held out; None where nothing could be held out."""
    return HeldOutErrors(fit.held_out, fit.leave_one_out, fit.not_held_out) if fit.held_out else None


def robustness_of(case: Case, fit: JointFit) -> tuple[FromPositions, ...]:
    """Return what each position alone would give, and at last all of them together; empty where none was fitted."""
    if not fit.alone:
        return ()
    fits = {(position,): values for position, values in fit.alone.items()} | {
        fit.trained_on: fit.fit.coordinates.values
    }
    return tuple(
        FromPositions(
            positions,
            dict(zip(fit.fit.names, (10.0**values).tolist(), strict=True)),
            case.prediction_errors(values, positions_of(case)),
        )
        for positions, values in fits.items()
    )


def further_positions(case: Case, fit: JointFit, screw_length: float) -> tuple[FurtherPosition, ...]:
    """Rank further positions, by the nut where it is free: it is what the axis is watched for."""
    names = fit.fit.names
    scale = math.sqrt(fit.fit.residual_variance) * math.log(10.0)
    ranked = next_positions(case, fit.fit, screw_length, names.index(_NUT) if _NUT in names else None)
    return tuple(
        FurtherPosition(
            there.conditions.position,
            dict(zip(names, (scale * there.standard_uncertainties).tolist(), strict=True)),
        )
        for there in ranked
    )


def _joint(judged: CoordinateJudgement, lack_of_fit: bool, identifiable: bool) -> IdentifiedJoint:
    value, ends = 10.0**judged.value, judged.interval
    uncertainty = math.inf if lack_of_fit else value * math.log(10.0) * judged.standard_uncertainty
    interval = Interval(_power(ends.lower), _power(ends.upper), ends.kind, ends.level)
    return IdentifiedJoint(
        estimate=Estimate(value, uncertainty),
        unit=_UNITS[judged.name],
        interval=None if lack_of_fit else interval,
        from_profile=judged.profile is not None,
        verdict=judged.verdict,
        at_limit=judged.at_bound,
        identifiable=identifiable,
    )


def _power(logarithm: float) -> float:
    return float(10.0 ** np.clip(logarithm, -300.0, 300.0))
