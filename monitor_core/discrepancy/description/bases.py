"""Fits from which a description may start: the axis as stated, with what was found, with something hung on a port.

What hangs on a port has the driving-point impedance of a mass on a spring and a damper, which is positive real with
any values that are not negative; a law may then say how one of them varies.
"""

from collections.abc import Iterator, Sequence

from monitor_core.discrepancy.screening.screen import screen
from monitor_core.effects import Effect
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.hold_out import judged_gap
from monitor_core.fitting.solver.hypothesis_fit import Fitted, fit
from monitor_core.models.extended import AxisPhysics

#: Effects by which something hangs on a port of the drive.
_PORTS = ("table-absorber", "nut-absorber")


def bases(
    baseline: Fitted[AxisPhysics], final: Fitted[AxisPhysics], candidates: Sequence[Effect[AxisPhysics]]
) -> Iterator[Fitted[AxisPhysics]]:
    """Yield fits that may lack no more than one quantity's dependence on the setting."""
    yield baseline
    if final.hypothesis.effects:
        yield final
    if not judged_gap(baseline).exceeds_healthy:
        return  # settings differ from what is stated, but no response has a resonance too many
    for effect in candidates:
        with_port = _with_port(baseline, effect) if effect.key in _PORTS else None
        if with_port is not None:
            yield with_port


def _with_port(baseline: Fitted[AxisPhysics], effect: Effect[AxisPhysics]) -> Fitted[AxisPhysics] | None:
    if not effect.applies(baseline.physics()):
        return None
    for screened in screen(baseline, [effect]):
        try:
            hypothesis = baseline.hypothesis.with_effect(effect)
            return fit(baseline.comparison, hypothesis, screened.starts[0], baseline.fitted)
        except (OutsideValidityError, IndexError):
            continue
    return None
