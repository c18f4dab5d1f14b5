"""Say what varies where no law of ours says how: a quantity of which each setting has a value of its own.

The free variation is a candidate like any law, with as many coefficients as there are settings. It claims no more than
that something is there: it must take away what is missing on lines that its values were not found from, and by so much
that a value for each setting is not too many.
"""

from collections.abc import Sequence

import numpy as np

from monitor_core.discrepancy.description.free_variation import FreeVariation
from monitor_core.discrepancy.explanation import Described, DescribedAlternative
from monitor_core.fitting.evidence import EvidenceScale, evidence_scale, least_difference
from monitor_core.fitting.solver.costs_of_settings import fitted_numbers
from monitor_core.fitting.solver.hypothesis_fit import Fitted
from monitor_core.models.extended import AxisPhysics

#: Of the misfit beyond noise, what the values must take away on lines that they were not found from.
_LEAST_TAKEN = 0.8


def without_form(
    variations: Sequence[tuple[Fitted[AxisPhysics], FreeVariation]],
) -> Described | None:
    """Return the quantity whose free variation leaves least on lines that were held out; None where none takes enough.

    Each variation stands with the fit that it is about.
    """
    if not variations:
        return None
    fitted, best = min(variations, key=lambda pair: pair[1].judged)
    scale = _scale(fitted, best)
    evidence = _evidence(best, scale)
    beyond_noise = best.alike - np.count_nonzero(fitted.fitted) * scale.mean_square
    if evidence < fitted.comparison.least_delta_bic or best.alike - best.judged < _LEAST_TAKEN * beyond_noise:
        return None
    margin = least_difference(fitted.comparison) / scale.factor
    alike = [other.quantity for _, other in variations if other.judged < best.judged + margin]
    settings = fitted.comparison.layout.settings
    names = [settings[number].name for number in fitted_numbers(fitted).tolist()]
    return Described(
        place=str(best.quantity.place),
        parameter=best.quantity.name,
        law=None,
        parameters={},
        effects=(),
        alternatives=tuple(
            dict.fromkeys(
                DescribedAlternative(str(other.place), other.name) for other in alike if other is not best.quantity
            )
        ),
        share=1.0,
        delta_bic=evidence,
        held_out_log_likelihood_gain=0.5 * scale.factor * (best.alike - best.judged),
        factors=dict(zip(names, best.factors.tolist(), strict=True)),
    )


def _scale(fitted: Fitted[AxisPhysics], variation: FreeVariation) -> EvidenceScale:
    """Return the evidence scale at which what the free variation leaves counts as noise."""
    scale = evidence_scale(fitted)
    left = variation.free / max(scale.n_values - variation.cost.shape[0], 1)
    return EvidenceScale(max(left, 1.0), scale.correlation, scale.n_values)


def _evidence(variation: FreeVariation, scale: EvidenceScale) -> float:
    return scale.factor * (variation.alike - variation.free) - scale.penalty(variation.cost.shape[0] - 1)
