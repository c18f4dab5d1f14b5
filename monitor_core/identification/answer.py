"""Turn fitted coordinates into joints: values with intervals, verdicts, sums, and what the data leave open."""

import math
from collections.abc import Mapping

import numpy as np

from monitor_core.identification.advice import next_positions
from monitor_core.identification.cases import Case, PeakCase, ResponseCase
from monitor_core.identification.directions import Verdict
from monitor_core.identification.identifiability import CoordinateJudgement
from monitor_core.identification.identified_joints import (
    FitQuality,
    FurtherPosition,
    HeldOutErrors,
    IdentifiedJoint,
    KnownSum,
)
from monitor_core.identification.joint_fit import JointFit
from monitor_core.models.parameters import PARAMETERS, name_in_file
from monitor_core.uncertainty import Estimate, Interval

#: Units of what may be free, by its names in files.
_UNITS = {name_in_file(word.name): word.unit for word in PARAMETERS}
_NUT = "nut_stiffness_n_per_m"
#: Relative standard uncertainty up to which a sum is worth stating beside parts that are not told apart.
_WELL_KNOWN = 0.1
#: Share of the starts that must reach the optimum, or it is not to be relied on.
_LEAST_AGREEMENT = 1.0 / 3.0


def joints_of_fit(found: JointFit) -> Mapping[str, IdentifiedJoint]:
    """Return the joints by their names in files."""
    relied_on = found.search.agreement() >= _LEAST_AGREEMENT
    inseparable = {name for pair in found.judged.pairs for name in (pair.first, pair.second)}
    return {
        judged.name: _joint(
            judged,
            relied_on and judged.verdict is not Verdict.NOT_DETERMINED and judged.name not in inseparable,
        )
        for judged in found.judged.coordinates
    }


def what_is_not_identifiable(found: JointFit) -> tuple[str, ...]:
    """Say what the data do not determine: single joints, pairs, and what the fit leaves out."""
    judged, agreement = found.judged, found.search.agreement()
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
    if found.lack_of_fit:
        sentences.append(
            "the model misses the data by more than their uncertainties; no interval holds what it leaves out"
        )
    if judged.better_exists:
        sentences.append("a better fit exists than the search found: search again with another seed")
    return tuple(sentences)


def known_sums(found: JointFit) -> tuple[KnownSum, ...]:
    """Return the sums of stiffnesses, or of dampings, that are known better than their parts."""
    fit = found.fit
    sums = []
    for pair in found.judged.pairs:
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


def quality_of(found: JointFit, case: Case) -> FitQuality:
    """Return how the joints fit the data they were found from."""
    fit, search = found.fit, found.search
    peaks = case if isinstance(case, PeakCase) else None
    return FitQuality(
        kind="whole responses" if isinstance(case, ResponseCase) else "peaks",
        chi_squared=fit.chi_squared,
        degrees_of_freedom=fit.degrees_of_freedom,
        residual_standard_deviation=float(np.sqrt(fit.chi_squared / max(fit.degrees_of_freedom, 1))),
        lack_of_fit=found.lack_of_fit,
        starts=len(search.fits) + len(search.failed),
        starts_agreeing=search.agreement(),
        evaluations=search.n_evaluations,
        seed=found.seed,
        positions=found.trained_on,
        paper_objective=None if peaks is None else peaks.paper_objective(fit.coordinates.values, found.trained_on),
    )


def held_out_errors(found: JointFit) -> HeldOutErrors | None:
    """Return how far predictions are off at positions held out; None where nothing could be held out."""
    return HeldOutErrors(found.held_out, found.leave_one_out, found.not_held_out) if found.held_out else None


def further_positions(case: Case, found: JointFit, screw_length: float) -> tuple[FurtherPosition, ...]:
    """Rank further positions, by the nut where it is free: it is what the axis is watched for."""
    names = found.fit.names
    scale = math.sqrt(found.fit.residual_variance) * math.log(10.0)
    ranked = next_positions(case, found.fit, screw_length, names.index(_NUT) if _NUT in names else None)
    return tuple(
        FurtherPosition(
            there.conditions.position,
            dict(zip(names, (scale * there.standard_uncertainties).tolist(), strict=True)),
        )
        for there in ranked
    )


def _joint(judged: CoordinateJudgement, identifiable: bool) -> IdentifiedJoint:
    value, interval = 10.0**judged.value, judged.interval
    return IdentifiedJoint(
        estimate=Estimate(value, value * math.log(10.0) * judged.standard_uncertainty),
        unit=_UNITS[judged.name],
        interval=Interval(_power(interval.lower), _power(interval.upper), interval.kind, interval.level),
        from_profile=judged.profile is not None,
        verdict=judged.verdict,
        at_limit=judged.at_bound,
        identifiable=identifiable,
    )


def _power(logarithm: float) -> float:
    return float(10.0 ** np.clip(logarithm, -300.0, 300.0))
