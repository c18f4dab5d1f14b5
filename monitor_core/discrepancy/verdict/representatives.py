"""Group each accepted effect with its indistinguishable alternatives; refit with the representatives."""

from collections.abc import Sequence

from monitor_core.discrepancy.search.found import Found
from monitor_core.discrepancy.verdict.classes import EquivalenceClass, Member, equivalence_class
from monitor_core.effects.effect import Effect, Physics
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit


def classes_with_fit(
    found: Found[Physics], candidates: Sequence[Effect[Physics]]
) -> tuple[tuple[EquivalenceClass[Physics], ...], Fitted[Physics]]:
    """Return the classes of the accepted effects, and the fit with their representatives.

    What has no answer together with the other representatives represents no class.
    """
    classes: list[EquivalenceClass[Physics]] = []
    final = found.final
    for accepted in found.accepted:
        representing = {other.representative.effect.key for other in classes}
        barred: set[str] = set()
        while True:
            grouped = equivalence_class(found, accepted, candidates, representing=representing, barred=barred)
            refitted = _with_representative(final, accepted.effect, grouped.representative)
            if refitted is not None:
                break
            barred.add(grouped.representative.effect.key)
        final = refitted
        classes.append(grouped)
    return tuple(classes), final


def _with_representative(
    final: Fitted[Physics], accepted: Effect[Physics], member: Member[Physics]
) -> Fitted[Physics] | None:
    """Return a fit with a member in the place of the accepted effect; None where it has no answer."""
    if member.effect.key == accepted.key:
        return final
    hypothesis = final.hypothesis.without(accepted.key).with_effect(member.effect)
    if hypothesis.keys == member.fitted.hypothesis.keys:
        return member.fitted
    start = hypothesis.carried_over(final.hypothesis, final.coordinates)
    own = hypothesis.carried_over(member.fitted.hypothesis, member.fitted.coordinates)
    n_own = len(member.effect.parameters)
    start[start.size - n_own :] = own[own.size - n_own :]
    try:
        return fit(final.comparison, hypothesis, start, final.fitted)
    except OutsideValidityError:
        return None
