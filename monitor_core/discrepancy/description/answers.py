"""Define what a description may answer, in which fits it is sought, and when it is believed.

An answer is the law of one quantity, or what swings at a port, in a fit of everything. Where no law holds, the free
variation of a quantity is a candidate like any law. It claims no more than that something is there: the evidence must
be for it, and it must take away what is missing on lines that its values were not found from.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.description.variation import (
    FreeVariation,
    Place,
    TriedLaw,
    evidence_of_variables,
    fitted_settings,
    scale_of,
)
from monitor_core.discrepancy.explanation import Described, DescribedAlternative, FoundParameter
from monitor_core.discrepancy.screening import Screened, measured_band, screen
from monitor_core.discrepancy.verdict.classes import Member, found_parameters
from monitor_core.discrepancy.verdict.outcome import explained_share, remainder_of
from monitor_core.effects import PORT_EFFECTS, Effect, Form, MachineSizes, Port, port_of, sized_for
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.conditions.groups import has_lines
from monitor_core.fitting.evidence import EvidenceScale, delta_bic, evidence_scale, least_difference
from monitor_core.fitting.hold_out import gain, judged_gap
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.costs_of_settings import fitted_numbers
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit, unfitted
from monitor_core.models.extended import AxisPhysics

#: Effects of the catalogue by which something hangs on a port of the drive.
_OF_CATALOGUE = ("table-absorber", "nut-absorber")
#: Of the ports that the catalogue has nothing for, how many are fitted: those that promise most.
_FITTED = 2


@dataclass(frozen=True, eq=False)
class Base:
    """A fit from which a description may start."""

    fitted: Fitted[AxisPhysics]
    port: Effect[AxisPhysics] | None = None  # by which something hangs on a port that the catalogue has nothing for
    before: Fitted[AxisPhysics] | None = None  # the fit without that; of what was not fitted, the one that was
    named: frozenset[str] = frozenset()  # keys of the effects with names in it, which a description may stand beside

    @property
    def is_unfitted(self) -> bool:
        """Whether this is the axis as stated; what it leaves does not compare with what fits leave."""
        return self.port is None and self.before is not None

    @property
    def hangs_last(self) -> bool:
        """Whether the last of its effects is what hangs on table or nut."""
        effects = self.fitted.hypothesis.effects
        return bool(effects) and effects[-1].key in _OF_CATALOGUE


def bases(
    baseline: Fitted[AxisPhysics], final: Fitted[AxisPhysics], candidates: Sequence[Effect[AxisPhysics]]
) -> Iterator[Base]:
    """Yield fits that may lack no more than one quantity's dependence on the setting."""
    plain = Base(baseline, named=baseline.hypothesis.keys)
    yield plain
    if baseline.tolerance:  # the fit went astray; as stated, the axis may lack no more than one dependence
        with suppress(OutsideValidityError):
            yield replace(plain, fitted=unfitted(baseline), before=baseline)
    if final.hypothesis.effects:
        yield Base(final, named=final.hypothesis.keys)
    if not judged_gap(baseline).exceeds_healthy:
        return  # settings differ from what is stated, but no response has a resonance too many
    known = _applying(baseline, [effect for effect in candidates if effect.key in _OF_CATALOGUE])
    for screened in screen(baseline, known) if known else ():
        yield from (Base(fitted) for fitted in _with_port(baseline, screened))


def bases_at_ports(from_here: Sequence[Fitted[AxisPhysics]], sizes: MachineSizes | None) -> Iterator[Base]:
    """Yield fits, those given with something on a port that the catalogue has nothing for.

    They are tried where the ``sizes`` of the machine are known, and whole responses were measured.
    """
    seen = has_lines(from_here[0].comparison.layout)
    own = () if sizes is None or not seen else sized_for(PORT_EFFECTS, sizes)
    for before in dict.fromkeys(from_here):
        applying = _applying(before, own)
        screened = [port for port in screen(before, applying) if _promises(port, before)] if applying else []
        fits = [(port.effect, fitted) for port in screened[:_FITTED] for fitted in _with_port(before, port)]
        yield from (Base(fitted, effect, before, before.hypothesis.keys) for effect, fitted in fits)
        if any(not judged_gap(fitted).exceeds_healthy for _, fitted in fits):
            return


def _applying(fitted: Fitted[AxisPhysics], effects: Sequence[Effect[AxisPhysics]]) -> tuple[Effect[AxisPhysics], ...]:
    physics = fitted.physics()
    return tuple(effect for effect in effects if effect.applies(physics))


def _promises(screened: Screened[AxisPhysics], before: Fitted[AxisPhysics]) -> bool:
    return screened.predicted_gain >= before.comparison.least_delta_bic


def _with_port(before: Fitted[AxisPhysics], port: Screened[AxisPhysics]) -> Iterator[Fitted[AxisPhysics]]:
    """Yield the fit with something on a port, if the model has an answer with it.

    Where the gap is large, what a fit without the port made of everything else leads astray: a fit also starts from the
    axis as stated, with the port as it was found.
    """
    hypothesis = before.hypothesis.with_effect(port.effect)
    as_fitted = hypothesis.carried_over(before.hypothesis, before.coordinates)
    fits = list[Fitted[AxisPhysics]]()
    for start in port.starts[:1]:
        for others in (start, as_fitted):
            with suppress(OutsideValidityError):
                fits = [_fit_from(before, hypothesis, others, start)]
                break
    if fits and judged_gap(fits[0]).exceeds_healthy:
        with suppress(OutsideValidityError):
            fits.append(_fit_from(before, hypothesis, hypothesis.null, fits[0].coordinates))
    yield from sorted(fits, key=lambda fitted: fitted.cost)[:1]


def _fit_from(
    before: Fitted[AxisPhysics], hypothesis: Hypothesis[AxisPhysics], others: FloatArray, port: FloatArray
) -> Fitted[AxisPhysics]:
    """Return the fit from the last effect of one start and everything else of another."""
    start, n_own = others.copy(), len(hypothesis.effects[-1].parameters)
    start[start.size - n_own :] = port[port.size - n_own :]
    return fit(before.comparison, hypothesis, start, before.fitted)


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
    def n_found(self) -> int:
        """How many numbers its law has."""
        return 0 if self.tried is None else self.tried.n_found

    def is_of_same(self, other: "Answer") -> bool:
        """Return whether another answer is of the same quantity in the same fit."""
        both = self.tried and other.tried and self.tried.variation.quantity == other.tried.variation.quantity
        return bool(both) and self.base is other.base

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

    def evidence(self, without: Fitted[AxisPhysics], scale: EvidenceScale) -> float:
        """Return ΔBIC over a fit without it; what was chosen among levels is paid for like what is fitted."""
        n_chosen = 0 if self.tried is None else self.tried.n_chosen
        return delta_bic(without, self.fitted, scale) - scale.penalty(n_chosen)


def settled(answer: Answer) -> Answer:
    """Return an answer from where a fit begun anew falls no further: a law may end in a flat and bent valley."""
    for _ in range(_MOST_RESTARTS if answer.tried is not None else 0):
        fitted = answer.fitted
        try:
            again = fit(fitted.comparison, fitted.hypothesis, fitted.coordinates, fitted.fitted)
        except OutsideValidityError:  # with settings as stated, and not as they are likely to be
            break
        fallen = fitted.cost - again.cost
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
    return answer.evidence(answer.before, answer.scale) >= fitted.comparison.least_delta_bic


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
    as_free = answer.tried.law.form in (Form.LEVELS, Form.CONSTANT)  # which takes as much as can be, or what all share
    if as_free or answer.base.is_unfitted:  # what varied there was weighed otherwise
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
        delta_bic=answer.evidence(answer.before, scale),
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
    scale = scale_of(fitted, best)
    evidence = 2.0 * max(evidence_of_variables(best, fitted_settings(fitted), scale.factor).values())
    taken = best.alike_everywhere - best.judged
    beyond_noise = best.alike_everywhere - fitted.fitted.size * scale.mean_square
    if evidence < fitted.comparison.least_delta_bic or taken < _LEAST_TAKEN * beyond_noise:
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
        held_out_log_likelihood_gain=0.5 * scale.factor * taken,
        factors=dict(zip(names, best.factors.tolist(), strict=True)),
    )
