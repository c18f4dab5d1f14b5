"""Define what a description may answer: the law of one quantity, or what swings at a port, in a fit of everything."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

from monitor_core.discrepancy.description.bases import Base
from monitor_core.discrepancy.description.laws import TriedLaw
from monitor_core.discrepancy.description.quantities import Place
from monitor_core.discrepancy.explanation import Described, DescribedAlternative, FoundParameter
from monitor_core.discrepancy.screening.sizes import measured_band
from monitor_core.discrepancy.verdict.classes import Member, found_parameters
from monitor_core.discrepancy.verdict.outcome import explained_share, remainder_of
from monitor_core.effects import Effect, Port, port_of
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.evidence import EvidenceScale, delta_bic, evidence_scale
from monitor_core.fitting.hold_out import gain
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit
from monitor_core.models.extended import AxisPhysics

#: A fit of a law that is begun anew, how often, and the fall of χ² below which it has settled.
_MOST_RESTARTS, _SETTLED = 3, 1.0
_PLACES = {Port.ROTOR: Place.MOTOR, Port.SCREW_END: Place.SCREW_END, Port.BASE: Place.BASE, Port.SCREW: Place.SCREW}


@dataclass(frozen=True, eq=False)
class Answer:
    """A law of a quantity, or without one what swings at a port, in a fit of everything."""

    base: Base
    fitted: Fitted[AxisPhysics]
    effect: Effect[AxisPhysics]
    tried: TriedLaw | None = None

    @property
    def before(self) -> Fitted[AxisPhysics]:
        """The fit without it."""
        law_on_port = self.tried is not None and self.base.port is not None
        return self.base.fitted if law_on_port or self.base.before is None else self.base.before

    @property
    def place(self) -> str:
        """Where something varies or swings."""
        port = port_of(self.effect)
        return str(self.tried.variation.quantity.place if self.tried else "" if port is None else _PLACES[port])

    @property
    def as_alternative(self) -> DescribedAlternative:
        """What it is beside a better one."""
        if self.tried is None:
            return DescribedAlternative(self.place)
        return DescribedAlternative(self.place, self.tried.variation.quantity.name, self.tried.law.variable)

    @cached_property
    def scale(self) -> EvidenceScale:
        """What it leaves counts as noise."""
        return evidence_scale(self.fitted)


def settled(answer: Answer) -> Answer:
    """Return an answer from where a fit begun anew falls no further: a law may end in a flat and bent valley."""
    for _ in range(_MOST_RESTARTS if answer.tried is not None else 0):
        at = answer.fitted
        try:
            again = fit(at.comparison, at.hypothesis, at.coordinates, at.fitted)
        except OutsideValidityError:  # with settings as stated, and not as they are likely to be
            break
        fallen = at.cost - again.cost
        if fallen > 0.0:
            answer = replace(answer, fitted=again)
        if fallen < _SETTLED:
            break
    return answer


def is_evident(answer: Answer) -> bool:
    """Return whether the data ask for it: a law beyond what swings without one, that beyond nothing."""
    fitted = answer.fitted
    if answer.tried is None and not _swings_in_the_band(answer):
        return False
    return delta_bic(answer.before, fitted, answer.scale) >= fitted.comparison.least_delta_bic


def _swings_in_the_band(answer: Answer) -> bool:
    """Return whether what swings does so where it was measured, and is nothing that no axis could have.

    Of a screw that bends the first mode may swing below that, where others do not.
    """
    parameters, (lowest, highest) = _parameters(answer, answer.scale), measured_band(answer.fitted)
    lowest = 0.0 if port_of(answer.effect) is Port.SCREW else lowest
    within = lowest < parameters["frequency_hz"].estimate.value < highest
    return within and all(parameter.plausible for parameter in parameters.values())


def share_of_free(answer: Answer) -> float:
    """Return what a law takes away of what its quantity would if it varied freely; 1 of what swings without one."""
    if answer.tried is None:
        return 1.0
    if answer.base.is_unfitted:  # what varied there was weighed otherwise
        return explained_share(answer.before, answer.fitted, remainder_of(answer.fitted).misfit)
    variation = answer.tried.variation
    room = variation.alike - variation.free
    return min((variation.alike - answer.tried.cost) / room, 1.0) if room > 0.0 else 0.0


def _parameters(answer: Answer, scale: EvidenceScale) -> dict[str, FoundParameter]:
    evidence = delta_bic(answer.before, answer.fitted, scale)
    return found_parameters(Member(answer.effect, answer.fitted, evidence, True), answer.fitted, scale)


def described_by(answer: Answer, alike: tuple[DescribedAlternative, ...], scale: EvidenceScale) -> Described:
    """Return an answer as an explanation has it, with what is ``alike``."""
    fitted, tried = answer.fitted, answer.tried
    frequency, size, name = _swinging(answer)
    return Described(
        place=answer.place,
        parameter="impedance" if tried is None else tried.variation.quantity.name,
        law=None if tried is None else tried.law,
        parameters=_parameters(answer, scale),
        effects=(answer.effect,) if tried is None or answer.base.port is None else (answer.base.port, answer.effect),
        alternatives=alike,
        share=share_of_free(answer),
        delta_bic=delta_bic(answer.before, fitted, scale),
        held_out_log_likelihood_gain=gain(answer.before.held_out, fitted.held_out, scale),
        frequency_hz=frequency,
        mass_kg=size if name == "mass" else None,
        inertia_kg_m2=size if name == "inertia" else None,
    )


def _swinging(answer: Answer) -> tuple[float | None, float | None, str]:
    """Return frequency and size of what swings where the answer is, and whether that is a mass or an inertia."""
    record = answer.tried.variation.quantity.record if answer.tried else ""
    if record == "bending" or port_of(answer.effect) is Port.SCREW:
        return answer.fitted.physics().bending.frequency, None, ""
    added, port = answer.fitted.physics().added, port_of(answer.effect)
    own = answer.tried.variation.quantity.field if answer.tried else f"{port}_absorber".replace("-", "_")
    own = own.removesuffix("_frequency").removesuffix("_mass").removesuffix("_inertia")
    if own.endswith("absorber") and port is not Port.BASE:
        name = "inertia" if own == "rotor_absorber" else "mass"
        return getattr(added, f"{own}_frequency"), getattr(added, f"{own}_{name}"), name
    if own in ("base", "base_absorber"):
        omega = 2.0 * math.pi * added.base_frequency
        return added.base_frequency, 1.0 / (added.base_compliance * omega**2), "mass"
    return None, None, ""
