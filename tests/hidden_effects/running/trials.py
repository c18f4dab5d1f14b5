"""Trials: one machine, its reference, and what the product says after each thing that may happen to it."""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from monitor_core.change.attribution import ChangeAttribution, attribute_change
from monitor_core.change.cells import ChangeTolerances
from monitor_core.change.reference_ratio import compare_times
from monitor_core.discrepancy.explanation import Outcome
from monitor_core.fitting.axis import DescribedDrive
from monitor_core.recordings.model_file import parse_model
from tests.hidden_effects.running.sessions import (
    HAPPENINGS,
    OUTSIDE,
    POSITIONS,
    PRELOAD,
    Happened,
    description,
    drawn_axis,
    measured,
)


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """What was said of one thing that happened."""

    truth: str  # the cause that is to be named
    happened: Happened
    explanation: ChangeAttribution
    n_values: int  # compared: real and imaginary parts of all cells
    seconds: float  # of the explanation alone

    @property
    def right(self) -> bool:
        """Whether the cause was named, and it alone; or none where nothing happened."""
        if self.truth in OUTSIDE:
            return self.explanation.outcome is Outcome.UNKNOWN
        expected = Outcome.NONE if self.truth == "none" else Outcome.NAMED
        return self.explanation.outcome is expected and self.explanation.cause == self.truth


def described_axis() -> DescribedDrive:
    """Return the machine as its description has it."""
    file = parse_model(description(), "description")
    return DescribedDrive(file.build().parameters, file.uncertain, file.effects)


def trials(
    seed: int,
    happenings: Mapping[str, Happened] = HAPPENINGS,
    *,
    positions: Sequence[float] = POSITIONS,
    days: tuple[int, int] = (3, 3),
) -> Iterator[Trial]:
    """Draw a machine, measure it on some days for a reference, and again on some days after each thing."""
    rng = np.random.default_rng([77, seed])
    machine, drive = drawn_axis(rng), described_axis()
    reference = measured(machine, Happened(), rng, positions=positions, days=days[0])
    for truth, happened in happenings.items():
        recent = measured(machine, happened, rng, positions=positions, days=days[1])
        began = time.perf_counter()
        explanation = attribute_change(drive, reference, recent, preload=PRELOAD)
        seconds = time.perf_counter() - began
        comparison = compare_times(reference, recent, ChangeTolerances())
        yield Trial(truth, happened, explanation, comparison.layout.n_values, seconds)
