"""One wrong record among many, alone or beside a hidden effect: what of both is named, and is anything else.

``python -m benchmarks.wrong_records [--draws N] [--healthy N] [--only KIND]`` draws machines of both plants, makes one
record wrong (a tag, a gain, or lines that are not of this axis), explains them, and prints a line for each and a table.
"""

import argparse
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.hidden_effects import PLANTS, learnt_form
from monitor_core.discrepancy.explain_comparison import explain_comparison
from monitor_core.discrepancy.explanation import Explanation
from monitor_core.discrepancy.records import cleared
from monitor_core.fitting.axis import DescribedDrive
from monitor_core.fitting.conditions.settings import default_folds
from monitor_core.fitting.machine_sizes import sizes_of_drive
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.fitting.residuals.model_form import ModelFormError
from monitor_core.fitting.residuals.responses import compare_responses
from monitor_core.models.families import build_model
from monitor_core.recordings.model_file import parse_model
from tests.hidden_effects import cases, frf_file

FAULTS = ("position-tag", "preload-tag", "payload-tag", "temperature-tag", "gain", "outlier")
#: Beside the wrong record: nothing, or a large effect.
HIDDEN = (
    "none", "far-bearing-stiffness", "added-mass", "none", "thermal-preload", "torque-delay", "payload-mass",
    "series-compliance",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Spoilt:
    """Responses of which one record, two responses of a setting, is wrong."""

    observations: tuple[FrequencyResponseObservation, ...]
    setting: int  # from 1
    sentence: str


def spoil(observations: Sequence[FrequencyResponseObservation], fault: str, rng: np.random.Generator) -> Spoilt:
    """Make one record wrong, in a size that matters."""
    settings = list(dict.fromkeys(observation.conditions for observation in observations))
    # of two warm records, and no other, nothing says which of them was as warm as stated
    eligible = [each for each in settings if fault != "temperature-tag" or not each.temperature_deviation]
    at = eligible[int(rng.integers(len(eligible)))]
    sign = float(rng.choice((-1.0, 1.0)))
    size = 0.0
    changed = at
    if fault == "position-tag":
        size = sign * float(rng.uniform(0.02, 0.08))
        size = -size if not 0.05 < at.position + size < 0.9 else size
        changed = replace(at, position=at.position + size)
    elif fault == "preload-tag":
        size = float(rng.uniform(1.3, 1.8)) ** sign
        changed = replace(at, preload=(at.preload or 0.0) * size)
    elif fault == "payload-tag":
        size = float(rng.uniform(3.0, 8.0)) if not at.payload_mass else -at.payload_mass
        changed = replace(at, payload_mass=at.payload_mass + size)
    elif fault == "temperature-tag":
        size = float(rng.uniform(12.0, 25.0))
        changed = replace(at, temperature_deviation=at.temperature_deviation + size)
    elif fault == "gain":
        size = float(rng.uniform(1.1, 1.4)) ** sign
    elif fault == "outlier":
        size = float(np.exp(rng.uniform(np.log(60.0), np.log(800.0))))  # [Hz]
    spoilt = []
    for each in observations:
        if each.conditions != at:
            spoilt.append(each)
            continue
        response, deviation = each.response, each.standard_deviation
        if fault == "gain":
            response, deviation = size * response, size * deviation
        if fault == "outlier":  # a bump of a resonance that no other record has
            ratio = each.frequency / size
            response = response * (1.0 + 0.3 / (1.0 - ratio**2 + 0.1j * ratio))
        spoilt.append(replace(each, conditions=changed, response=response, standard_deviation=deviation))
    return Spoilt(tuple(spoilt), settings.index(at) + 1, f"{fault} {size:.3g}")


@dataclass(frozen=True, slots=True)
class Answered:
    """What became of a draw."""

    fault: str
    hidden: str
    named: bool  # the record
    right_fault: bool
    others: int  # records that are named and are not wrong
    found: bool  # the hidden effect
    wrong_effect: bool
    explanation: Explanation
    seconds: float


def answer(fault: str, hidden: str, seed: int, form: ModelFormError | None = None) -> Answered:
    """Draw, spoil and explain one machine."""
    case = cases.draw_case(hidden, "large", 0.003, seed, respond=PLANTS[_plant(seed)])
    measured, drive = frf_file.observations(case), _drive(case)
    setting = 0
    if fault != "none":
        spoilt = spoil(measured, fault, np.random.default_rng(seed))
        measured, setting = spoilt.observations, spoilt.setting
    candidates = drive.candidates(sizes_of_drive(drive.physics({}), measured))
    folds = default_folds(observation.conditions for observation in measured)
    began = time.process_time()
    found = explain_comparison(compare_responses(measured, held_out=folds, form=form), drive, candidates)
    keys = [{effect.key, *effect.equivalent_to} for effect in found.effects]
    sure = str(found.outcome) in ("named", "equivalent", "partial")
    numbers = {record.number for record in found.records}
    return Answered(
        fault,
        hidden,
        setting in numbers,
        any(record.number == setting and str(record.fault) == fault for record in found.records),
        len(numbers - {setting}),
        sure and all(any(key in each for each in keys) for key in case.truth) if case.truth else not found.effects,
        sure and any(not each & set(case.truth) for each in keys),
        found,
        time.process_time() - began,
    )


def draws(n: int, only: str | None, first: int) -> Iterator[tuple[str, str, int]]:
    """Yield faults, hidden effects and seeds."""
    for number in range(n):
        for place, fault in enumerate(FAULTS):
            # a temperature matters only where something depends on it
            hidden = "thermal-preload" if fault == "temperature-tag" else HIDDEN[(number + place) % len(HIDDEN)]
            if only in (None, fault):
                yield fault, hidden, first + number * len(FAULTS) + place


def named_of_healthy(seed: int, form: ModelFormError) -> int:
    """Return how many records of a healthy machine are taken out; what follows is fitted to the same records."""
    case = cases.draw_case("none", "medium", 0.003, seed, respond=PLANTS[_plant(seed)])
    measured, drive = frf_file.observations(case), _drive(case)
    folds = default_folds(observation.conditions for observation in measured)
    records = cleared(compare_responses(measured, held_out=folds, form=form), drive, lambda _: None)
    return len(records.wrong)


def _plant(seed: int) -> str:
    return "transmission line" if seed % 2 else "finite elements"


def _drive(case: cases.Case) -> DescribedDrive:
    file = parse_model(case.baseline, case.kind)
    return DescribedDrive(build_model(file.family, file.parameters).parameters, dict(file.uncertain), {})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=8)
    parser.add_argument("--healthy", type=int, default=60)
    parser.add_argument("--only")
    parser.add_argument("--first-seed", type=int, default=61000)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        form = learnt_form(Path(folder))
    answers = []
    for fault, hidden, seed in draws(options.draws, options.only, options.first_seed):
        got = answer(fault, hidden, seed, form)
        answers.append(got)
        records = "; ".join(
            f"{each.number} ({each.setting}) {each.fault} {each.stated:.4g} → {each.found:.4g} "
            f"± {each.standard_uncertainty:.2g} {each.unit}, ΔBIC {each.delta_bic:.0f}"
            for each in got.explanation.records
        )
        effects = ", ".join(effect.key for effect in got.explanation.effects)
        print(
            f"{seed} {fault} + {hidden}: {'named' if got.named else '-'} others {got.others} | {records} | "
            f"{got.explanation.outcome} {effects} {'ok' if got.found else 'MISSED'}"
            f"{' WRONG' if got.wrong_effect else ''} | {got.seconds:.1f} s",
            flush=True,
        )
    print(table(answers))
    healthy = [named_of_healthy(options.first_seed + 5000 + number, form) for number in range(options.healthy)]
    print(f"\n{len(healthy)} healthy machines: a record named in {sum(map(bool, healthy))}")


def table(answers: Sequence[Answered]) -> str:
    """Return the card."""
    lines = ["| fault | n | record named | as what it is | effect right | wrong effect | other records named |"]
    lines += ["|---|---|---|---|---|---|---|"]
    for fault in Counter(each.fault for each in answers):
        of = [each for each in answers if each.fault == fault]
        cells = (
            len(of), sum(each.named for each in of), sum(each.right_fault for each in of),
            sum(each.found for each in of), sum(each.wrong_effect for each in of),
            sum(each.others > 0 for each in of),
        )  # fmt: skip
        lines.append(f"| {fault} | " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
