"""Record what a search found: effects that were accepted, their rivals, and the fits that led there."""

from dataclasses import dataclass
from typing import Generic

from monitor_core.discrepancy.screening.sizes import Screened
from monitor_core.effects.effect import Effect, Physics
from monitor_core.fitting.evidence import EvidenceScale
from monitor_core.fitting.solver.hypothesis_fit import Fitted


@dataclass(frozen=True, eq=False)
class Rival(Generic[Physics]):
    """An effect that was refitted in the place of an accepted effect."""

    effect: Effect[Physics]
    fitted: Fitted[Physics]
    delta_bic: float  # against the fit without any of them


@dataclass(frozen=True, eq=False)
class Accepted(Generic[Physics]):
    """An effect with its rivals, all against the fit without it."""

    effect: Effect[Physics]
    delta_bic: float
    held_out_gain: float
    rivals: tuple[Rival[Physics], ...]  # best first, the effect itself left out
    without: Fitted[Physics]  # the effect


@dataclass(frozen=True, slots=True)
class Unseen:
    """An effect that the data cannot show as itself, since what tells it from others does not vary."""

    key: str
    instead_of: frozenset[str]  # keys of what was found and would not be needed with it
    delta_bic: float  # of what was found, less that with it in its place


@dataclass(frozen=True, eq=False)
class Found(Generic[Physics]):
    """Where a search ended."""

    baseline: Fitted[Physics]
    steps: tuple[Fitted[Physics], ...]  # after each accepted effect
    final: Fitted[Physics]
    accepted: tuple[Accepted[Physics], ...]
    evidence_scale: EvidenceScale
    screened: tuple[Screened[Physics], ...]  # what is not in the final fit
    least_delta_bic: float  # that one more effect would have needed
    unseen: tuple[Unseen, ...] = ()  # that would do as well as something accepted, or better
