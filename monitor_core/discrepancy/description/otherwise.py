"""Ask whether what is no effect of the catalogue does as well as what was found, so that the search may end there.

That may be a resonance that wanders, something that swings at a port that the catalogue has nothing for, or a law of
its own by which something follows the excitation. Of the last two, what explains more is the answer.

Settings are measured one after the other. What the preload loses or gains meanwhile goes along with positions, preloads
and temperatures as far as these come in an order, and an effect that follows them explains it, too.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, Generic

from monitor_core.discrepancy.description.answers import Base, is_evident
from monitor_core.discrepancy.description.describe import Description, describe_in_place, refit_with_law
from monitor_core.discrepancy.description.variation import QUANTITIES, tried_laws, vary_freely
from monitor_core.discrepancy.search.search import findings
from monitor_core.discrepancy.search.workspace import may_lack_more
from monitor_core.discrepancy.verdict.classes import PRELOAD_EXPONENT, WRONG_NUT_STIFFNESS
from monitor_core.discrepancy.verdict.outcome import leaves_only_wandering
from monitor_core.effects import Variable
from monitor_core.effects.effect import Physics
from monitor_core.effects.sizes import MachineSizes
from monitor_core.fitting.evidence import delta_bic
from monitor_core.fitting.hold_out import gain
from monitor_core.fitting.solver.hypothesis_fit import Fitted
from monitor_core.models.extended import AxisPhysics


@dataclass(frozen=True, eq=False)
class Otherwise(Generic[Physics]):
    """What one search may be left for; each question is answered once of a fit."""

    sizes: MachineSizes | None
    progress: Callable[[str], None]
    _wandering: dict[Fitted[Physics], bool] = field(default_factory=dict, init=False)
    _in_place: dict[Fitted[Physics], Description | None] = field(default_factory=dict, init=False)

    def explains(self, baseline: Fitted[Physics], fitted: Fitted[Physics]) -> bool:
        """Return whether it explains all that is missing; ``baseline`` is the fit without any effect."""
        if self._wanders(fitted):
            return may_lack_more(fitted)
        return self._asked(baseline, fitted) is not None

    def follows(self, baseline: Fitted[Physics], fitted: Fitted[Physics]) -> Description | None:
        """Return what follows the excitation in the place of the one name of this fit, or of one asked about before."""
        if len(findings(fitted)) == 1 and not self._wanders(fitted):
            self._asked(baseline, fitted)
        return next((each for each in self._in_place.values() if each and each.follows_excitation), None)

    def _asked(self, baseline: Fitted[Physics], fitted: Fitted[Physics]) -> Description | None:
        if fitted not in self._in_place:
            self._in_place[fitted] = describe_in_place(baseline, fitted, self.sizes, self.progress)
        return self._in_place[fitted]

    def _wanders(self, fitted: Fitted[Physics]) -> bool:
        if fitted not in self._wandering:
            self._wandering[fitted] = leaves_only_wandering(fitted)
        return self._wandering[fitted]


#: What changes the stiffness of the nut from setting to setting.
OF_NUT: Final = frozenset({"periodic-preload", "thermal-preload", PRELOAD_EXPONENT, WRONG_NUT_STIFFNESS})
_NUT_STIFFNESS = next(each for each in QUANTITIES if each.field == "nut_stiffness")
_REFITS = 2


def goes_with_time(without: Fitted[Any], final: Fitted[Any], margin: float, progress: Callable[[str], None]) -> bool:
    """Return whether a law of time of the nut's stiffness does as well as an effect, within a ``margin`` of BIC.

    ``without`` is the fit without the effect and ``final`` that with it. The law has to gain on held-out data, too. It
    need not explain most of what is missing: the effect need not either, beside settings that scatter.
    """
    axis = without.physics()
    if not isinstance(axis, AxisPhysics):
        return False
    progress("asking whether it changes with time")
    variation = vary_freely(without, _NUT_STIFFNESS)
    if variation is None:
        return False
    tried = tried_laws(without, variation)
    of_time = [each for each in tried if each.law.variable is Variable.ORDER]
    answers = (refit_with_law(Base(without), each, progress) for each in of_time[:_REFITS])
    return any(
        answer is not None
        and is_evident(answer)
        and not gain(without.held_out, answer.fitted.held_out, answer.scale) <= 0.0  # NaN: nothing is held out
        and delta_bic(final, answer.fitted, answer.scale) >= -margin
        for answer in answers
    )
