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
import time
import zlib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.score_card import NOISES, OUTSIDE, Job, Scored, score_card
from monitor_core.discrepancy.explain_comparison import explain_comparison
from monitor_core.discrepancy.explanation import Explanation
from monitor_core.effects import Effect
from monitor_core.errors import MonitorCoreError, OutsideValidityError
from monitor_core.fitting.conditions.settings import default_folds
from monitor_core.fitting.described_axis import DescribedDrive
from monitor_core.fitting.evidence import evidence_scale
from monitor_core.fitting.hold_out import fitted_values
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.learnt_form import learn_form_error
from monitor_core.fitting.machine_sizes import sizes_of_drive
from monitor_core.fitting.residuals.model_form import ModelFormError
from monitor_core.fitting.residuals.responses import ResponsesComparison, compare_responses
from monitor_core.fitting.solver.hypothesis_fit import fit
from monitor_core.models.extended import AxisPhysics
from monitor_core.models.families import build_model
from monitor_core.recordings.frf_set import read_frf_set
from monitor_core.recordings.model_file import parse_model
from tests.hidden_effects import cases, frf_file
from tests.hidden_effects.truth import finite_elements, transmission_line

PLANTS = {"finite elements": finite_elements.respond, "transmission line": transmission_line.respond}
#: What no motion in time has.
ON_LINES = ("constant-loss-factor",)
#: Thresholds were set, and the form error is learnt, on cases of seeds below the scored ones.
FIRST_SCORED_SEED = 29000
HEALTHY_SEEDS = (900, 901, 902)
_NO_GAP = {when: {"fit": math.nan, "held_out": math.nan} for when in ("before", "after")}


def composition() -> list[Job]:
    """Return all cases: every effect in three sizes and two noises, healthy, outside the catalogue, pairs, crude."""
    kinds = cases.all_kinds()
    pairs = [kind for kind in kinds if "+" in kind]
    outside = [kind for kind in kinds if kind.startswith(OUTSIDE)]
    singles = [kind for kind in kinds if kind not in pairs and kind not in outside and kind != "none"]
    drawn = [(kind, size, noise) for kind in singles for size in cases.SIZES for noise in NOISES]
    drawn += [(kind, size, noise) for kind in outside for size in cases.SIZES for noise in NOISES for _ in range(2)]
    drawn += [(kind, size, NOISES[0]) for kind in pairs for size in ("large", "medium") for _ in range(2)]
    drawn += [("none", "medium", noise) for noise in NOISES for _ in range(30)]
    jobs = []
    for number, (kind, size, noise) in enumerate(drawn):
        plant = "transmission line" if number % 5 in (1, 3) or kind in ON_LINES else "finite elements"
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


def given(
    name: str, folder: Path, form: ModelFormError
) -> tuple[ResponsesComparison, DescribedDrive, tuple[Effect[AxisPhysics], ...]]:
    """Return what a case gives to the workflow, from its files: data, axis, and what that may lack."""
    observations = read_frf_set(folder / "given" / f"{name}.frf.h5").observations
    file = parse_model((folder / "given" / f"{name}.toml").read_text(encoding="utf-8"), name)
    model = build_model(file.family, file.parameters)
    folds = default_folds(observation.conditions for observation in observations)
    comparison = compare_responses(observations, held_out=folds, form=form)
    subject = DescribedDrive(model.parameters, dict(file.uncertain), dict(file.effects))
    return comparison, subject, subject.candidates(sizes_of_drive(subject.physics({}), observations))


def answer(name: str, folder: Path, form: ModelFormError) -> dict[str, Any]:
    """Answer one case without its truth; an answer that is there is kept."""
    path = folder / "answers" / f"{name}.json"
    if path.exists():
        return dict(json.loads(path.read_text(encoding="utf-8")))
    comparison, subject, candidates = given(name, folder, form)
    began = time.process_time()
    try:
        found = explain_comparison(comparison, subject, candidates)
    except MonitorCoreError as error:  # counts as an answer that is not right
        document = {"name": name, "outcome": f"refused: {error}", "effects": [], "gap": _NO_GAP, "detection_limits": {}}
    else:
        document = _document(name, found)
    document["seconds"] = time.process_time() - began
    path.write_text(json.dumps(document), encoding="utf-8")
    return document


def _document(name: str, found: Explanation) -> dict[str, Any]:
    return {
        "name": name,
        "outcome": str(found.outcome),
        "effects": [
            {
                "key": effect.key,
                "equivalent_to": list(effect.equivalent_to),
                "same_as": [remark.rpartition(" ")[2] for remark in effect.remarks if remark.startswith("the same")],
                "plausible": effect.plausible,
                "delta_bic": effect.delta_bic,
                "parameters": {
                    key: [item.estimate.value, *item.interval_95] for key, item in effect.parameters.items()
                },
            }
            for effect in found.effects
        ],
        "gap": asdict(found.gap),
        "detection_limits": {candidate.key: candidate.detection_limit for candidate in found.candidates},
        "pulls": dict(found.pulls),
    }


def detectability(name: str, truth: dict[str, dict[str, float]], folder: Path, form: ModelFormError) -> float:
    """Return d' of the weakest true effect: the root of the evidence that it brings when all else is refitted."""
    comparison, subject, candidates = given(name, folder, form)
    by_key = {candidate.key: candidate for candidate in candidates if candidate.applies(subject.physics({}))}
    effects = tuple(by_key[key] for key in truth)
    chosen = fitted_values(comparison.layout)
    plain, hypothesis = Hypothesis(subject), Hypothesis(subject, effects)
    baseline = fit(comparison, plain, plain.null, chosen)
    fits = []
    for uncertain in (plain.null, baseline.coordinates):
        start = hypothesis.carried_over(plain, uncertain)
        for index, (effect, parameter) in enumerate(hypothesis.unknowns):
            value = truth[effect.key].get(parameter.name, parameter.null)
            start[hypothesis.n_uncertain + index] = (value - parameter.null) / parameter.scale
        try:
            fits.append(fit(comparison, hypothesis, start, chosen))
        except OutsideValidityError:
            continue
    fitted = min(fits, key=lambda attempt: attempt.cost)
    factor = evidence_scale(fitted).factor
    weakest = math.inf
    for effect in effects:
        without = hypothesis.without(effect.key)
        lesser = fit(comparison, without, without.carried_over(hypothesis, fitted.coordinates), chosen)
        cost = lesser.cost if without.effects else min(lesser.cost, baseline.cost)
        weakest = min(weakest, math.sqrt(max(factor * (cost - fitted.cost), 0.0)))
    return weakest


def learnt_form(folder: Path) -> ModelFormError:
    """Return the form error from healthy machines of both plants."""
    machines = []
    for plant, respond in PLANTS.items():
        for seed in HEALTHY_SEEDS:
            case = cases.draw_case("none", "medium", NOISES[0], seed, "receptance", respond=respond)
            file = parse_model(case.baseline, f"{plant} {seed}")
            model = build_model(file.family, file.parameters)
            machines.append((frf_file.observations(case), DescribedDrive(model.parameters, dict(file.uncertain), {})))
    form = learn_form_error(machines)
    text = {str(point): asdict(spectrum) for point, spectrum in form.spectra.items()}
    (folder / "form.json").write_text(json.dumps(text, indent=1), encoding="utf-8")
    return form


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
        truths = [json.loads(text)["truth"] for text in sealed]
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
