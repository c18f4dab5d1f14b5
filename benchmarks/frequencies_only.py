"""Natural frequencies only: what the workflow says of hidden effects where no response was measured.

``python -m benchmarks.frequencies_only [--workers 2] [--share 1.0] [--first-seed 28000] [--out FILE]`` draws machines,
each with a modal table of the finite-element or the transmission-line plant; answers each from its table and model file
alone; and prints the score card. Many effects move frequencies alike, so that a class of several is a right answer
here, and none is one where the answer itself says that the effect could not have been seen. A wrong name never is.
"""

import argparse
import itertools
import json
import statistics
import time
import zlib
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.score_card import OUTSIDE, row, size_of
from monitor_core.discrepancy.explain_comparison import explain_comparison
from monitor_core.discrepancy.explanation import Candidate, Outcome
from monitor_core.fitting.axis import DescribedDrive
from monitor_core.fitting.conditions.settings import default_folds
from monitor_core.fitting.machine_sizes import sizes_of_drive
from monitor_core.fitting.residuals.modes import compare_modes
from monitor_core.models.families import build_model
from monitor_core.recordings.model_file import parse_model
from service.documents.explanation_sentences import next_measurement
from tests.hidden_effects.frequencies import (
    DESIGNS,
    PLANTS,
    ModalCase,
    draw_modal_case,
    with_known_mass,
    with_positions_between,
)

UNCERTAINTIES = (0.001, 0.003)
#: What moves natural frequencies whatever is varied.
_MOVING = (
    "added-mass", "series-compliance", "far-bearing-stiffness", "screw-axial-stiffness", "torsional-flexibility",
    "guide-stiffness", "preload-exponent", "position-offset", "servo-stiffness", "periodic-preload",
    "wrong-parameter:bearing_stiffness_n_per_m", "wrong-parameter:bracket_stiffness_n_per_m",
    "wrong-parameter:nut_stiffness_n_per_m", "wrong-parameter:coupling_stiffness_nm_per_rad",
    "wrong-parameter:table_mass_kg", "wrong-parameter:motor_inertia_kg_m2",
)  # fmt: skip
#: What moves them under some conditions.
_MOVING_WITH_CONDITIONS = ("payload-mass", "thermal-preload", "thermal-stiffness")
#: What moves none, or makes a frequency that the drive has not.
_BEYOND_FREQUENCIES = ("loss-factor", "torque-delay", "sensor-mounting-resonance", "second-mode", "base-compliance")
_OUTSIDE = ("outside:wandering-absorber", "outside:preload-drift")
_PAIRS = (
    "added-mass+far-bearing-stiffness", "series-compliance+guide-stiffness", "torsional-flexibility+preload-exponent",
    "added-mass+payload-mass", "thermal-preload+periodic-preload",
)  # fmt: skip
#: What an answer advises, by words of its sentence, and the test with that besides.
_ADVISED = {"more on the table": with_known_mass, "positions in between": with_positions_between}
_NEXT_MACHINE = 1000  # to the seed of another machine of the same case, out of the way of the other cases
_HEALTHY = 4  # of each design


@dataclass(frozen=True, slots=True)
class Job:
    """One case to be drawn."""

    number: int
    kind: str
    size: str
    design: str
    uncertainty: float
    plant: str

    def case(self, first_seed: int) -> ModalCase:
        """Draw the machine and its modal table; the next machine where every mode is damped too much to show."""
        base, _, more = self.design.partition(" + ")
        design = DESIGNS[base]()
        if more:
            design = _ADVISED[more](design)
        for seed in itertools.count(first_seed + self.number, _NEXT_MACHINE):
            case = draw_modal_case(
                self.kind, self.size, design, self.uncertainty, seed, accelerances=PLANTS[self.plant]
            )
            if case.table:
                return case
        raise AssertionError


@dataclass(frozen=True, slots=True)
class Answered:
    """One case with what was said of it."""

    job: Job
    true_keys: frozenset[str]  # of the catalogue
    outcome: Outcome
    classes: tuple[frozenset[str], ...]  # what each finding may be: its key, what says the same, what it may be as well
    leaders: tuple[str, ...]
    admitted: bool  # whether the answer lists each true effect as untestable or below its detection limit
    advice: str
    gap: tuple[float, float]  # before and after, over the floor [-]
    evidence: tuple[float, ...]
    seconds: float

    @property
    def claims(self) -> bool:
        """Whether the answer claims to know."""
        return self.outcome in (Outcome.NAMED, Outcome.EQUIVALENT, Outcome.PARTIAL)

    @property
    def wrong(self) -> bool:
        """Whether a finding that is claimed holds no true effect."""
        return self.claims and any(not keys & self.true_keys for keys in self.classes)

    @property
    def right(self) -> bool:
        """Whether each finding may be a true effect, and at least one true effect is found."""
        return self.claims and not self.wrong

    @property
    def alone(self) -> bool:
        """Whether all that is true was named and nothing beside it."""
        named = self.outcome is Outcome.NAMED
        return named and self.right and all(any(key in keys for keys in self.classes) for key in self.true_keys)

    @property
    def advised(self) -> Job | None:
        """The same machine with the measurement that is to part what was not told apart; None where none is known."""
        if self.outcome is not Outcome.EQUIVALENT:
            return None
        words = next((phrase for phrase in _ADVISED if phrase in self.advice), None)
        return None if words is None else replace(self.job, design=f"{self.job.design} + {words}")

    @property
    def said(self) -> str:
        """In which of the groups of the score card the answer is."""
        if self.wrong:
            return "wrong"
        if self.right:
            return "alone" if self.alone else "in class"
        if self.outcome is Outcome.UNKNOWN:
            return "unknown"
        return "none, admitted" if self.admitted else "none, not admitted"


def composition() -> list[Job]:
    """Return all cases."""
    drawn = [(kind, "medium", "full") for kind in _MOVING]
    drawn += [(kind, "large", design) for kind in _MOVING for design in ("plain", "short")]
    drawn += [(kind, size, "full") for kind in _MOVING_WITH_CONDITIONS for size in ("medium", "large")]
    drawn += [(kind, "large", "plain") for kind in _BEYOND_FREQUENCIES]
    drawn += [(kind, "large", "full") for kind in (*_OUTSIDE, *_PAIRS)]
    drawn += [("none", "medium", design) for design in DESIGNS for _ in range(_HEALTHY)]
    plants = tuple(PLANTS)
    return [
        Job(number, kind, size, design, UNCERTAINTIES[number % 2], plants[number // 2 % 2])
        for number, (kind, size, design) in enumerate(drawn)
    ]


def answer(job: Job, first_seed: int) -> Answered:
    """Draw a case and answer it from its table and model file."""
    case = job.case(first_seed)
    file = parse_model(case.baseline, "description")
    subject = DescribedDrive(build_model(file.family, file.parameters).parameters, file.uncertain, file.effects)
    folds = default_folds(observation.conditions for observation in case.table)
    comparison = compare_modes(case.table, case.motor_end, held_out=folds)
    began = time.process_time()
    candidates = subject.candidates(sizes_of_drive(subject.physics({}), case.table))
    found = explain_comparison(comparison, subject, candidates)
    true_keys = frozenset(key for key in case.truth if not key.startswith(OUTSIDE))
    return Answered(
        job,
        true_keys,
        found.outcome,
        tuple(frozenset((effect.key, *effect.aliases, *effect.equivalent_to)) for effect in found.effects),
        tuple(effect.key for effect in found.effects),
        admits(found.candidates, case),
        next_measurement(found.next_steps),
        (found.gap.before.fit / found.gap.noise_floor, found.gap.after.fit / found.gap.noise_floor),
        tuple(effect.delta_bic for effect in found.effects),
        time.process_time() - began,
    )  # fmt: skip


def admits(candidates: Sequence[Candidate], case: ModalCase) -> bool:
    """Tell whether an answer lists each true effect as untestable, or as too small to be seen."""
    listed = {candidate.key: candidate for candidate in candidates}
    for key, values in case.truth.items():
        found = listed.get(key)
        if found is None or (found.untested is None and (found.detection_limit or 0.0) < size_of(key, values)):
            return False
    return True


def score_card(answers: Sequence[Answered], followed: Sequence[tuple[Answered, Answered]]) -> str:
    """Return the score card as Markdown.

    ``followed`` has answers that were not told apart with those after the measurement they advise.
    """
    groups = ("alone", "in class", "none, admitted", "none, not admitted", "unknown", "wrong")
    lines = [
        f"{len(answers)} modal tables, {sum(answered.job.plant == 'transmission line' for answered in answers)} of "
        "them of the transmission-line plant.",
        "",
        "| cases | n | " + " | ".join(groups) + " |",
        "|---|---" + "|---" * len(groups) + "|",
    ]
    singles = [answered for answered in answers if answered.job.kind in (*_MOVING, *_MOVING_WITH_CONDITIONS)]
    rows: dict[str, list[Answered]] = {
        f"{design}, {size}": [
            answered for answered in singles if answered.job.design == design and answered.job.size == size
        ]
        for design in DESIGNS
        for size in ("small", "medium", "large")
    }
    rows["moves no frequency, or adds one"] = [
        answered for answered in answers if answered.job.kind in _BEYOND_FREQUENCIES
    ]
    rows["outside the catalogue"] = [answered for answered in answers if answered.job.kind.startswith(OUTSIDE)]
    rows["two effects"] = [answered for answered in answers if answered.job.kind in _PAIRS]
    rows["healthy"] = [answered for answered in answers if answered.job.kind == "none"]
    rows["all"] = list(answers)
    for name, of_row in rows.items():
        if of_row:
            counts = [str(sum(answered.said == group for answered in of_row)) for group in groups]
            lines.append(f"| {name} | {len(of_row)} | " + " | ".join(counts) + " |")
    classes = [len(keys) for answered in answers if answered.said == "in class"
               for keys in answered.classes if keys & answered.true_keys]  # fmt: skip
    equivalent = [answered for answered in answers if answered.outcome is Outcome.EQUIVALENT]
    seconds = sorted(answered.seconds for answered in answers)
    lines += [
        "",
        "| what | asked | measured |",
        "|---|---|---|",
        row("a wrong name, all cases", "≤ 2 %", answers, lambda answered: answered.said == "wrong"),
        row("healthy: none", "–", rows["healthy"], lambda answered: answered.outcome is Outcome.NONE),
        row("a measurement that would decide beside *equivalent*", "all", equivalent,
             lambda answered: bool(answered.advice)),
        f"| effects in a class that holds the truth: median, largest | – | {_ends(classes)} |",
        f"| after the measurement advised: alone, or fewer in the class | – | "
        f"{sum(fewer(*pair) for pair in followed)} of {len(followed)} |",
        row("after the measurement advised: a wrong name", "≤ 2 %", [after for _, after in followed],
             lambda answered: answered.wrong),
        f"| seconds a case, one core: median, longest | – | {statistics.median(seconds):.1f}, {seconds[-1]:.1f} |",
        "",
        "What was wrong:",
        "",
        *[_complaint(answered) for answered in (*answers, *(after for _, after in followed))
          if answered.said == "wrong"],
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def fewer(before: Answered, after: Answered) -> bool:
    """Tell whether a second answer is right and leaves less open than the first."""
    return after.right and (after.alone or sum(map(len, after.classes)) < sum(map(len, before.classes)))


def _ends(sizes: Sequence[int]) -> str:
    return f"{statistics.median(sizes):g}, {max(sizes)}" if sizes else "–"


def _complaint(answered: Answered) -> str:
    found = "; ".join(
        f"{leader} = {', '.join(sorted(of_class - {leader})) or 'nothing else'} (ΔBIC {evidence:.0f})"
        for leader, of_class, evidence in zip(answered.leaders, answered.classes, answered.evidence, strict=True)
    )
    job = answered.job
    return (
        f"- {job.number}: {job.kind}, {job.size}, {job.design}, {100 * job.uncertainty:g} %, {job.plant} → "
        f"*{answered.outcome}* {found}; gap {answered.gap[0]:.2f} → {answered.gap[1]:.2f} floors"
    )


def _as_json(answered: Answered) -> str:
    job = answered.job
    return json.dumps({
        "case": [job.number, job.kind, job.size, job.design, job.uncertainty, job.plant], "said": answered.said,
        "outcome": str(answered.outcome), "leaders": answered.leaders,
        "classes": [sorted(keys) for keys in answered.classes],
        "delta_bic": answered.evidence, "gap": answered.gap, "advice": answered.advice, "seconds": answered.seconds,
    })  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--share", type=float, default=1.0)
    parser.add_argument("--first-seed", type=int, default=28000)
    parser.add_argument("--out", type=Path, help="what was said of each case, one JSON object a line")
    options = parser.parse_args()
    jobs = [job for job in composition() if zlib.crc32(b"%d" % job.number) % 1000 < 1000 * options.share]
    answers = []
    with ProcessPoolExecutor(options.workers) as pool:
        for answered in pool.map(answer, jobs, [options.first_seed] * len(jobs)):
            answers.append(answered)
            job = answered.job
            print(f"{len(answers)} of {len(jobs)}: {job.kind} {job.size} {job.design} → {answered.said}", flush=True)
            if options.out:
                with options.out.open("a", encoding="utf-8") as file:
                    file.write(_as_json(answered) + "\n")
        not_told_apart = [answered for answered in answers if answered.advised is not None]
        after = list(
            pool.map(
                answer, [answered.advised for answered in not_told_apart], [options.first_seed] * len(not_told_apart)
            )
        )
    print(score_card(answers, list(zip(not_told_apart, after, strict=True))))


if __name__ == "__main__":
    main()
