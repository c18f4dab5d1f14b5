"""Fits from which a description may start: the axis as stated, with what was found, with something hung on a port.

What hangs on a port has the driving-point impedance of a mass on a spring and a damper, which is positive real with
any values that are not negative; a law may then say how one of them varies. On table and nut, where the catalogue has
it, that alone is no description. Where the catalogue has none, on the rotor, at the far end of the screw and under the
bearings, it is one by itself: every such port is screened, and the best are fitted.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

from monitor_core.arrays import FloatArray
from monitor_core.discrepancy.screening.screen import screen
from monitor_core.discrepancy.screening.sizes import Screened
from monitor_core.effects import PORT_EFFECTS, Effect, MachineSizes, sized_for
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.conditions.groups import has_lines
from monitor_core.fitting.hold_out import judged_gap
from monitor_core.fitting.hypothesis import Hypothesis
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
    yield Base(baseline)
    if baseline.tolerance:  # the fit went astray; as stated, the axis may lack no more than one dependence
        with suppress(OutsideValidityError):
            yield Base(unfitted(baseline), before=baseline)
    if final.hypothesis.effects:
        yield Base(final)
    if not judged_gap(baseline).exceeds_healthy:
        return  # settings differ from what is stated, but no response has a resonance too many
    known = _applying(baseline, [effect for effect in candidates if effect.key in _OF_CATALOGUE])
    for found in screen(baseline, known) if known else ():
        yield from (Base(fitted) for fitted in _with_port(baseline, found))


def bases_at_ports(from_here: Sequence[Fitted[AxisPhysics]], sizes: MachineSizes | None) -> Iterator[Base]:
    """Yield fits, those given with something on a port that the catalogue has nothing for.

    They are tried where the ``sizes`` of the machine are known, and whole responses were measured.
    """
    seen = has_lines(from_here[0].comparison.layout)
    own = () if sizes is None or not seen else sized_for(PORT_EFFECTS, sizes)
    for before in dict.fromkeys(from_here):
        applying = _applying(before, own)
        screened = [found for found in screen(before, applying) if _promises(found, before)] if applying else []
        fits = [(found.effect, fitted) for found in screened[:_FITTED] for fitted in _with_port(before, found)]
        yield from (Base(fitted, effect, before) for effect, fitted in fits)
        if any(not judged_gap(fitted).exceeds_healthy for _, fitted in fits):
            return


def _applying(fitted: Fitted[AxisPhysics], effects: Sequence[Effect[AxisPhysics]]) -> tuple[Effect[AxisPhysics], ...]:
    physics = fitted.physics()
    return tuple(effect for effect in effects if effect.applies(physics))


def _promises(screened: Screened[AxisPhysics], before: Fitted[AxisPhysics]) -> bool:
    return screened.predicted_gain >= before.comparison.least_delta_bic


def _with_port(before: Fitted[AxisPhysics], found: Screened[AxisPhysics]) -> Iterator[Fitted[AxisPhysics]]:
    """Yield the fit with something on a port, if the model has an answer with it.

    Where the gap is large, what a fit without the port made of everything else leads astray: a fit also starts from the
    axis as stated, with the port as it was found.
    """
    hypothesis = before.hypothesis.with_effect(found.effect)
    as_fitted = hypothesis.carried_over(before.hypothesis, before.coordinates)
    fits = list[Fitted[AxisPhysics]]()
    for start in found.starts[:1]:
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
