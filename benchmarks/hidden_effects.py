"""The blind benchmark: effects hidden in machines that share nothing with the models, and what the workflow names.

``python -m benchmarks.hidden_effects --out FOLDER [--workers 2] [--share 0.1]`` draws the cases, writes what is
measured and, apart, the sealed truth; prints the truth's SHA-256; answers every case from its files alone; then opens
the truth and writes the score card. The form error of the model is learnt first from healthy machines of other seeds.
A run that was stopped goes on where it was.
"""

import argparse
import hashlib
import json
import math
import statistics
import time
import zlib
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from monitor_core.discrepancy.comparing.conditions import default_folds
from monitor_core.discrepancy.comparing.model_form import ModelFormError
from monitor_core.discrepancy.comparing.responses import ResponsesComparison, compare_responses
from monitor_core.discrepancy.explain import explain
from monitor_core.discrepancy.hypothesis import Hypothesis
from monitor_core.discrepancy.judging.classes import covariance
from monitor_core.discrepancy.searching.evidence import yardstick
from monitor_core.discrepancy.searching.fit import fit
from monitor_core.discrepancy.searching.form_learning import learn_form_error
from monitor_core.discrepancy.searching.holding_out import fitted_values
from monitor_core.discrepancy.subject import DriveSubject
from monitor_core.models.families import build_model
from monitor_core.recordings.frf_set import read_frf_set
from monitor_core.recordings.model_file import parse_model
from tests.hidden_effects import cases, frf_file
from tests.hidden_effects.truth import finite_elements, transmission_line

PLANTS = {"finite elements": finite_elements.respond, "transmission line": transmission_line.respond}
NOISES = (0.003, 0.01)
#: Thresholds were set on cases of seeds below 1000; the scored ones lie above, the healthy ones of the form between.
FIRST_SCORED_SEED = 5000
HEALTHY_SEEDS = (900, 901, 902)
OUTSIDE = "outside:"


@dataclass(frozen=True, slots=True)
class Job:
    """One case to be drawn."""

    number: int
    kind: str
    size: str
    noise: float
    family: str
    plant: str

    @property
    def name(self) -> str:
        """How its files are called."""
        return f"case-{self.number:04d}"


def composition() -> list[Job]:
    """Return all cases: every effect in three sizes and two noises, healthy, outside the catalogue, pairs, crude."""
    kinds = cases.all_kinds()
    pairs = [kind for kind in kinds if "+" in kind]
    outside = [kind for kind in kinds if kind.startswith(OUTSIDE)]
    singles = [kind for kind in kinds if kind not in pairs and kind not in outside and kind != "none"]
    drawn = [(kind, size, noise) for kind in singles for size in cases.SIZES for noise in NOISES]
    drawn += [(kind, size, noise) for kind in outside for size in cases.SIZES for noise in NOISES for _ in range(2)]
    drawn += [(kind, size, NOISES[0]) for kind in pairs for size in ("large", "medium")]
    drawn += [("none", "medium", noise) for noise in NOISES for _ in range(30)]
    jobs = []
    for number, (kind, size, noise) in enumerate(drawn):
        plant = "transmission line" if number % 5 in (1, 3) else "finite elements"
        jobs.append(Job(number, kind, size, noise, "receptance", plant))
    crude = [Job(len(jobs) + k, "none", "medium", NOISES[0], "lumped", "finite elements") for k in range(3)]
    return jobs + crude


def draw(job: Job, folder: Path) -> str:
    """Write what is measured and the model, and return the truth as text; nothing is drawn twice."""
    sealed = folder / "sealed" / f"{job.name}.json"
    if not sealed.exists():
        case = cases.draw_case(
            job.kind, job.size, job.noise, FIRST_SCORED_SEED + job.number, job.family, respond=PLANTS[job.plant]
        )
        frf_file.write_case(case, folder / "given", job.name)
        sealed.write_text(json.dumps({"job": asdict(job), "truth": case.truth}, sort_keys=True), encoding="utf-8")
    return sealed.read_text(encoding="utf-8")


def given(name: str, folder: Path, form: ModelFormError) -> tuple[ResponsesComparison, DriveSubject]:
    """Return what a case gives to the workflow, from its files."""
    observations = read_frf_set(folder / "given" / f"{name}.frf.h5").observations
    file = parse_model((folder / "given" / f"{name}.toml").read_text(encoding="utf-8"), name)
    model = build_model(file.family, file.parameters)
    folds = default_folds(one.conditions for one in observations)
    comparison = compare_responses(observations, held_out=folds, form=form)
    return comparison, DriveSubject(model.parameters, dict(file.uncertain), dict(file.effects))


def answer(name: str, folder: Path, form: ModelFormError) -> dict[str, Any]:
    """Answer one case without its truth; an answer that is there is kept."""
    path = folder / "answers" / f"{name}.json"
    if path.exists():
        return dict(json.loads(path.read_text(encoding="utf-8")))
    comparison, subject = given(name, folder, form)
    began = time.process_time()
    found = explain(comparison, subject, subject.candidates())
    document = {
        "name": name,
        "seconds": time.process_time() - began,
        "outcome": str(found.outcome),
        "effects": [
            {
                "key": one.key,
                "equivalent_to": list(one.equivalent_to),
                "same_as": [remark.rpartition(" ")[2] for remark in one.remarks if remark.startswith("the same")],
                "plausible": one.plausible,
                "delta_bic": one.delta_bic,
                "parameters": {key: [item.estimate.value, *item.interval_95] for key, item in one.parameters.items()},
            }
            for one in found.effects
        ],
        "gap": asdict(found.gap),
        "pulls": dict(found.pulls),
    }
    path.write_text(json.dumps(document), encoding="utf-8")
    return document


def detectability(name: str, truth: dict[str, dict[str, float]], folder: Path, form: ModelFormError) -> float:
    """Return d' of the weakest true effect: its size over its standard deviation, all else refitted."""
    comparison, subject = given(name, folder, form)
    by_key = {one.key: one for one in subject.candidates() if one.applies(subject.physics({}))}
    effects = tuple(by_key[key] for key in truth)
    hypothesis = Hypothesis(subject, effects)
    start = np.zeros(hypothesis.n_coordinates)
    for index, (effect, one) in enumerate(hypothesis.unknowns):
        value = truth[effect.key].get(one.name, one.null)
        start[hypothesis.n_uncertain + index] = (value - one.null) / one.scale
    fitted = fit(comparison, hypothesis, start, fitted_values(comparison.layout))
    spread = covariance(fitted, yardstick(fitted))
    weakest = math.inf
    for effect in effects:
        at = [
            hypothesis.n_uncertain + index
            for index, (other, one) in enumerate(hypothesis.unknowns)
            if other.key == effect.key and one.null == 0.0
        ]
        value = fitted.coordinates[at]
        weakest = min(weakest, math.sqrt(float(value @ np.linalg.solve(spread[np.ix_(at, at)], value))))
    return weakest


def learnt_form(folder: Path) -> ModelFormError:
    """Return the form error from healthy machines of both plants."""
    machines = []
    for plant, respond in PLANTS.items():
        for seed in HEALTHY_SEEDS:
            case = cases.draw_case("none", "medium", NOISES[0], seed, "receptance", respond=respond)
            file = parse_model(case.baseline, f"{plant} {seed}")
            model = build_model(file.family, file.parameters)
            machines.append((frf_file.observations(case), DriveSubject(model.parameters, dict(file.uncertain), {})))
    form = learn_form_error(machines)
    text = {str(point): asdict(spectrum) for point, spectrum in form.spectra.items()}
    (folder / "form.json").write_text(json.dumps(text, indent=1), encoding="utf-8")
    return form


@dataclass(frozen=True, slots=True)
class Scored:
    """One case with its answer beside its truth."""

    job: Job
    truth: dict[str, dict[str, float]]
    answer: dict[str, Any]
    d_prime: float  # NaN without a true effect of the catalogue

    @property
    def true_keys(self) -> set[str]:
        """Keys of what is hidden, as far as the catalogue has them."""
        return {key for key in self.truth if not key.startswith(OUTSIDE)}

    @property
    def classes(self) -> list[set[str]]:
        """What each finding may be: its key, what says the same, and what cannot be told from it."""
        return [{one["key"], *one["same_as"], *one["equivalent_to"]} for one in self.answer["effects"]]

    @property
    def claims(self) -> bool:
        """Whether the answer claims to know: unknown and none do not."""
        return self.answer["outcome"] in ("named", "equivalent", "partial")

    @property
    def right(self) -> bool:
        """Whether each finding may be a true effect, and each true effect is in a finding of at most two."""
        of_two = [one for one, given in zip(self.classes, self.answer["effects"], strict=True)
                  if len(given["equivalent_to"]) <= 1]  # fmt: skip
        covered = all(any(key in one for one in of_two) for key in self.true_keys)
        return self.claims and covered and all(one & self.true_keys for one in self.classes)

    @property
    def alone(self) -> bool:
        """Whether the truth was found and nothing stands beside it."""
        return self.right and all(not one["equivalent_to"] for one in self.answer["effects"])

    @property
    def wrong(self) -> bool:
        """Whether a finding that is claimed holds no true effect."""
        return self.claims and any(not one & self.true_keys for one in self.classes)

    @property
    def held_out_ratio(self) -> float:
        """Gap on held-out data after naming. [σ]."""
        return float(self.answer["gap"]["after"]["held_out"])


def score_card(scored: Sequence[Scored], digest: str) -> str:
    """Return the score card as Markdown."""
    singles = [one for one in scored if len(one.true_keys) == 1 and one.job.family == "receptance"]
    pairs = [one for one in scored if len(one.true_keys) == 2 and one.job.family == "receptance"]
    healthy = [one for one in scored if one.job.kind == "none" and one.job.family == "receptance"]
    outside = [one for one in scored if one.job.kind.startswith(OUTSIDE)]
    crude = [one for one in scored if one.job.family == "lumped"]
    floors = {
        noise: statistics.median(one.held_out_ratio for one in healthy if one.job.noise == noise) for noise in NOISES
    }
    clear = [one for one in singles if one.d_prime >= 12.0]
    faint = [one for one in singles if one.d_prime < 3.0]
    ratios = sorted(one.held_out_ratio / floors[one.job.noise] for one in singles + pairs if one.right)
    seconds = [one.answer["seconds"] for one in scored]
    lines = [
        f"{len(scored)} cases, {sum(one.job.plant == 'transmission line' for one in scored)} of them of the "
        f"transmission-line plant; SHA-256 of the sealed truth `{digest}`.",
        "",
        "| what | asked | measured |",
        "|---|---|---|",
        _row("d' ≥ 12: truth named, or in a class of at most two", "≥ 97 %", clear, lambda one: one.right),
        _row("large effects (d' ≥ 12) named alone", "≥ 85 %",
             [one for one in clear if one.job.size == "large"], lambda one: one.alone),
        _row("a wrong name, all cases", "≤ 0.5 %", scored, lambda one: one.wrong),
        _row("d' < 3: none", "all", faint, lambda one: one.answer["outcome"] == "none"),
        _row("healthy: none", "≥ 99 %", healthy, lambda one: one.answer["outcome"] == "none"),
        _row("outside the catalogue: named", "0", outside,
             lambda one: one.answer["outcome"] in ("named", "equivalent")),
        _row("outside, gap ≥ 2 × floor: unknown", "all",
             [one for one in outside if one.answer["gap"]["before"]["held_out"] >= 2.0 * floors[one.job.noise]],
             lambda one: one.answer["outcome"] == "unknown"),
        _row("outside, all: unknown", "≥ 80 %", outside, lambda one: one.answer["outcome"] == "unknown"),
        _row("two large effects: both right and alone", "≥ 85 %",
             [one for one in pairs if one.job.size == "large"], lambda one: one.alone),
        _row("two medium effects: both right and alone", "≥ 60 %",
             [one for one in pairs if one.job.size == "medium"], lambda one: one.alone),
        _row("crude baseline: ≤ 1.1 × floor", "all", crude,
             lambda one: one.held_out_ratio <= 1.1 * floors[one.job.noise]),
        f"| held-out gap after naming over the floor, median | ≤ 1.05 | {_quantile(ratios, 0.5):.3f} |",
        f"| held-out gap after naming over the floor, 90th percentile | ≤ 1.25 | {_quantile(ratios, 0.9):.3f} |",
        *_parameter_rows(singles),
        f"| seconds a case, one core: median, 90 %, longest | ≤ 15 | {statistics.median(seconds):.1f}, "
        f"{_quantile(sorted(seconds), 0.9):.1f}, {max(seconds):.1f} |",
        "",
        "What was not right:",
        "",
        *[_complaint(one) for one in scored if _is_complaint(one)],
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _row(what: str, asked: str, among: Sequence[Scored], test: Callable[[Scored], bool]) -> str:
    n = sum(1 for one in among if test(one))
    share = f"{100.0 * n / len(among):.1f} %" if among else "–"
    return f"| {what} | {asked} | {n} of {len(among)} ({share}) |"


def _parameter_rows(singles: Iterable[Scored]) -> list[str]:
    errors, covered, friction = [], [], []
    for one in singles:
        if not one.alone:
            continue
        (key, truth), found = next(iter(one.truth.items())), one.answer["effects"][0]
        name = next(iter(truth))
        if found["key"] != key or name not in found["parameters"]:
            continue
        value, low, high = found["parameters"][name]
        covered.append(low <= truth[name] <= high)
        if one.d_prime >= 30.0:
            (friction if key == "guide-friction" else errors).append(abs(value / truth[name] - 1.0))
    share = 100.0 * sum(covered) / max(len(covered), 1)
    return [
        f"| 95 % intervals of the parameter that cover | ≥ 90 % | {sum(covered)} of {len(covered)} ({share:.1f} %) |",
        f"| error of the parameter at d' ≥ 30: median, 90 %, largest | ≤ 10 % | {_percent(errors)} |",
        f"| the same, friction | ≤ 30 % | {_percent(friction)} |",
    ]


def _percent(errors: list[float]) -> str:
    if not errors:
        return "–"
    ranked = sorted(errors)
    return f"{100 * _quantile(ranked, 0.5):.1f}, {100 * _quantile(ranked, 0.9):.1f}, {100 * ranked[-1]:.1f} %"


def _quantile(ranked: Sequence[float], share: float) -> float:
    return float(np.quantile(ranked, share)) if len(ranked) else math.nan


def _is_complaint(one: Scored) -> bool:
    if one.job.kind.startswith(OUTSIDE):
        return one.answer["outcome"] != "unknown"
    if one.job.kind == "none":
        return one.answer["outcome"] != "none" and one.job.family == "receptance"
    return one.wrong or (one.d_prime >= 12.0 and not one.right)


def _complaint(one: Scored) -> str:
    found = "; ".join(
        " = ".join([effect["key"], *effect["equivalent_to"]]) + f" (ΔBIC {effect['delta_bic']:.0f})"
        for effect in one.answer["effects"]
    )
    gap = one.answer["gap"]
    return (
        f"- {one.job.name}: {one.job.kind}, {one.job.size}, noise {one.job.noise:g}, {one.job.plant}, d' "
        f"{one.d_prime:.1f} → *{one.answer['outcome']}* {found}; held-out gap {gap['before']['held_out']:.2f} → "
        f"{gap['after']['held_out']:.2f}"
    )


def chosen(share: float) -> list[Job]:
    """Return a share of the cases, spread over the kinds by their numbers."""
    return [job for job in composition() if zlib.crc32(job.name.encode()) % 1000 < 1000 * share]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--share", type=float, default=1.0)
    options = parser.parse_args()
    folder = options.out
    for part in ("given", "sealed", "answers"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    jobs = chosen(options.share)
    form = learnt_form(folder)
    with ProcessPoolExecutor(options.workers) as pool:
        sealed = list(pool.map(draw, jobs, [folder] * len(jobs)))
        digest = hashlib.sha256("\n".join(sealed).encode()).hexdigest()
        print(f"{len(jobs)} cases drawn; SHA-256 of the sealed truth: {digest}", flush=True)
        answers = []
        for found in pool.map(answer, [job.name for job in jobs], [folder] * len(jobs), [form] * len(jobs)):
            answers.append(found)
            print(f"{len(answers)} of {len(jobs)} answered: {found['name']} {found['outcome']}", flush=True)
        truths = [json.loads(one)["truth"] for one in sealed]
        known = [
            (job, truth) for job, truth in zip(jobs, truths, strict=True)
            if job.family == "receptance" and truth and not job.kind.startswith(OUTSIDE)
        ]  # fmt: skip
        measured = pool.map(
            detectability, [job.name for job, _ in known], [truth for _, truth in known],
            [folder] * len(known), [form] * len(known),
        )  # fmt: skip
        d_primes = {job.name: value for (job, _), value in zip(known, measured, strict=True)}
    scored = [
        Scored(job, truth, found, d_primes.get(job.name, math.nan))
        for job, truth, found in zip(jobs, truths, answers, strict=True)
    ]
    card = score_card(scored, digest)
    (folder / "score-card.md").write_text(card, encoding="utf-8")
    print(card)


if __name__ == "__main__":
    main()
