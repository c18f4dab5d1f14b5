"""Ask, of the fit with one effect, whether what is no effect of the catalogue explains all that is missing.

Then no further effect need be sought. That may be a resonance that wanders, something that swings at a port that the
catalogue has nothing for, or a law of its own by which something follows the excitation. Of the last two, what explains
more is the answer.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic

from monitor_core.discrepancy.description.describe import Description, following_excitation, swinging_at_port
from monitor_core.discrepancy.search.stepwise import findings
from monitor_core.discrepancy.search.workspace import may_lack_more
from monitor_core.discrepancy.verdict.amplitude import goes_with_amplitude
from monitor_core.discrepancy.verdict.outcome import OutcomeSettings
from monitor_core.discrepancy.verdict.wandering import leaves_only_wandering
from monitor_core.effects.effect import Physics
from monitor_core.effects.sizes import MachineSizes
from monitor_core.fitting.evidence import delta_bic, evidence_scale, least_difference
from monitor_core.fitting.solver.hypothesis_fit import Fitted


@dataclass(frozen=True, eq=False)
class Otherwise(Generic[Physics]):
    """What one search may be left for; each question is answered once of a fit."""

    settings: OutcomeSettings
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
        before = next((found for found in self._following.values() if found is not None), None)
        if before is None and fitted not in self._following:
            self._following[fitted] = self._asked_of_excitation(baseline, fitted)
        return before or self._following[fitted]

    def _asked_of_excitation(self, baseline: Fitted[Physics], fitted: Fitted[Physics]) -> Description | None:
        found = findings(fitted)
        may_follow = len(found) == 1 and (may_lack_more(fitted) or goes_with_amplitude(found[0]))
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
            self._wandering[fitted] = leaves_only_wandering(fitted, self.settings)
        return self._wandering[fitted]


def _explains_more(first: Description, other: Description) -> bool:
    """Return whether the first of two that leave nothing else is what the data ask for."""
    if first.fitted is None or other.fitted is None:
        return False
    more = delta_bic(other.fitted, first.fitted, evidence_scale(first.fitted))
    return more > least_difference(first.fitted.comparison)
