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
from monitor_core.discrepancy.description.describe import (
    Description,
    following_excitation,
    refit_with_law,
    swinging_at_port,
)
from monitor_core.discrepancy.description.variation import QUANTITIES, tried_laws, vary_freely
from monitor_core.discrepancy.search.search import findings
from monitor_core.discrepancy.search.workspace import may_lack_more
from monitor_core.discrepancy.verdict.classes import PRELOAD_EXPONENT, WRONG_NUT_STIFFNESS, goes_with_amplitude
from monitor_core.discrepancy.verdict.outcome import leaves_only_wandering
from monitor_core.effects import Variable
from monitor_core.effects.effect import Physics
from monitor_core.effects.sizes import MachineSizes
from monitor_core.fitting.evidence import delta_bic, evidence_scale, least_difference
from monitor_core.fitting.hold_out import gain
from monitor_core.fitting.solver.hypothesis_fit import Fitted
from monitor_core.models.extended import AxisPhysics


@dataclass(frozen=True, eq=False)
class Otherwise(Generic[Physics]):
    """What one search may be left for; each question is answered once of a fit."""

    sizes: MachineSizes | None
    progress: Callable[[str], None]
    _wandering: dict[Fitted[Physics], bool] = field(default_factory=dict, init=False)
    _swinging: dict[Fitted[Physics], Description | None] = field(default_factory=dict, init=False)
    _following: dict[Fitted[Physics], Description | None] = field(default_factory=dict, init=False)

    def explains(self, baseline: Fitted[Physics], fitted: Fitted[Physics]) -> bool:
        """Return whether it explains all that is missing; ``baseline`` is the fit without any effect."""
        if self.follows(baseline, fitted) is not None:
            return True
        return may_lack_more(fitted) and (self._wanders(fitted) or self._swings(baseline, fitted) is not None)

    def follows(self, baseline: Fitted[Physics], fitted: Fitted[Physics]) -> Description | None:
        """Return what follows the excitation in the place of the one name of this fit, or of one asked about before."""
        known_follower = next((follower for follower in self._following.values() if follower is not None), None)
        if known_follower is None and fitted not in self._following:
            self._following[fitted] = self._asked_of_excitation(baseline, fitted)
        return known_follower or self._following[fitted]

    def _asked_of_excitation(self, baseline: Fitted[Physics], fitted: Fitted[Physics]) -> Description | None:
        effects = findings(fitted)
        may_follow = len(effects) == 1 and (may_lack_more(fitted) or goes_with_amplitude(effects[0]))
        if not may_follow or self._wanders(fitted):
            return None
        follows = following_excitation(baseline, fitted, self.progress)
        if follows is None:
            return None
        swings = self._swings(baseline, fitted)
        return None if swings is not None and _explains_more(swings, follows) else follows

    def _swings(self, baseline: Fitted[Physics], fitted: Fitted[Physics]) -> Description | None:
        if fitted not in self._swinging:
            self._swinging[fitted] = swinging_at_port(baseline, fitted, self.sizes, self.progress)
        return self._swinging[fitted]

    def _wanders(self, fitted: Fitted[Physics]) -> bool:
        if fitted not in self._wandering:
            self._wandering[fitted] = leaves_only_wandering(fitted)
        return self._wandering[fitted]


def _explains_more(first: Description, other: Description) -> bool:
    """Return whether the first of two that leave nothing else is what the data ask for."""
    if first.fitted is None or other.fitted is None:
        return False
    more = delta_bic(other.fitted, first.fitted, evidence_scale(first.fitted))
    return more > least_difference(first.fitted.comparison)


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
