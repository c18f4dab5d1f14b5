"""Compute how residuals move with stiffnesses, masses, dampings and delays: the signatures of kinds of misfit."""

from collections.abc import Sequence

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.explanation import MisfitKind
from monitor_core.effects import PREFIX
from monitor_core.effects.effect import Effect, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.solver.hypothesis_fit import Fitted
from monitor_core.fitting.solver.jacobian import derivative

#: By the unit that ends the name of what an effect, or a wrong parameter, is stated in.
_KINDS = (
    ("ns_per_m", MisfitKind.DAMPING),
    ("nms_per_rad", MisfitKind.DAMPING),
    ("loss_factor", MisfitKind.DAMPING),
    ("n_per_m", MisfitKind.STIFFNESS),
    ("nm_per_rad", MisfitKind.STIFFNESS),
    ("m_per_n", MisfitKind.STIFFNESS),
    ("_kg", MisfitKind.MASS),
    ("kg_m2", MisfitKind.MASS),
    ("delay_s", MisfitKind.DELAY),
)


def signatures(fitted: Fitted[Physics], effects: Sequence[Effect[Physics]]) -> dict[MisfitKind, FloatArray]:
    """Return the change of the residuals with each effect that is a stiffness, a mass, a damping or a delay.

    Shape (n_effects, n_values) for each kind. Effects of no plain kind, and those of several quantities, are passed
    over.
    """
    rows: dict[MisfitKind, list[FloatArray]] = {}
    for effect in effects:
        kind = kind_of_effect(effect)
        if kind is None:
            continue
        hypothesis = fitted.hypothesis.with_effect(effect)
        at = hypothesis.carried_over(fitted.hypothesis, fitted.coordinates)
        try:
            slope = derivative(fitted.around, hypothesis, at, fitted.misfit, at.size - 1)
        except OutsideValidityError:
            continue
        if np.any(slope):
            rows.setdefault(kind, []).append(fitted.around.whitened_by(slope))
    return {kind: np.array(found) for kind, found in rows.items()}


def kind_of_effect(effect: Effect[Physics]) -> MisfitKind | None:
    """Return what kind of quantity an effect adds, None where it is of no plain kind."""
    if len(effect.parameters) != 1:
        return None
    name = effect.key.removeprefix(PREFIX) if effect.key.startswith(PREFIX) else effect.parameters[0].name
    return next((kind for ending, kind in _KINDS if name.endswith(ending)), None)
