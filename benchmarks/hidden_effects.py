"""The blind benchmark: effects hidden in machines that share nothing with the models, and what the workflow names.

``python -m benchmarks.hidden_effects --out FOLDER [--seed N] [--workers 2] [--share 0.1]`` draws the cases anew, writes
what is measured and, apart, the sealed truth; prints seed and SHA-256 of the truth; answers every case from its files
alone; then opens the truth and writes the score card. The form error of the models is the default one that a user has;
``--learnt`` learns it from healthy benchtop axes instead. A run that was stopped goes on where it was, with its seed.
"""

import argparse
import hashlib
import json
import math
import secrets
import time
import zlib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.blind_cases import NOISES, PLANTS, Job, composition, drawn
from benchmarks.contradictions import contradictions
from benchmarks.detectability import detectability, detectability_of_record
from benchmarks.score_card import Scored, score_card
from monitor_core.discrepancy.explain_comparison import explain_comparison
from monitor_core.discrepancy.explanation import Explanation
from monitor_core.effects import Effect, MachineSizes
from monitor_core.errors import MonitorCoreError
from monitor_core.fitting.axis import DescribedDrive
from monitor_core.fitting.conditions.settings import default_folds
from monitor_core.fitting.learnt_form import learn_form_error
from monitor_core.fitting.machine_sizes import sizes_of_drive
from monitor_core.fitting.residuals.model_form import ModelFormError
from monitor_core.fitting.residuals.responses import ResponsesComparison, compare_responses
from monitor_core.models.extended import AxisPhysics
from monitor_core.models.families import build_model
from monitor_core.recordings.frf_set import read_frf_set
from monitor_core.recordings.model_file import parse_model
from service.blas_threads import compute_in_one_thread
from service.documents.explanation_sentences import untested_sentence
from tests.hidden_effects import cases, frf_file
from tests.hidden_effects.machines import machine_named

HEALTHY_SEEDS = (900, 901, 902)
_NO_GAP = {when: {"fit": math.nan, "held_out": math.nan} for when in ("before", "after")} | {"noise_floor": math.nan}


def make_folders(folder: Path) -> None:
    """Make the folders of a draw: what is given, the sealed truth, and the answers."""
    for part in ("given", "sealed", "answers"):
        (folder / part).mkdir(parents=True, exist_ok=True)


def draw(job: Job, folder: Path, seed: int, form: ModelFormError) -> str:
    """Write what is measured and the model, and return the truth with its d′ as text; nothing is drawn twice."""
    sealed = folder / "sealed" / f"{job.name}.json"
    if not sealed.exists():
        case = drawn(job, seed)
        recorder = machine_named(job.machine).recorder
        frf_file.write_case(case, folder / "given", job.name)
        truth = {
            "job": asdict(job),
            "truth": case.truth,
            "d_prime": detectability(case, recorder, form),
            "wrong_setting": case.wrong_setting,
            "d_prime_of_record": detectability_of_record(case, recorder, form),
        }
        sealed.write_text(json.dumps(truth, sort_keys=True), encoding="utf-8")
    return sealed.read_text(encoding="utf-8")


def given(
    name: str, folder: Path, form: ModelFormError
) -> tuple[ResponsesComparison, DescribedDrive, tuple[Effect[AxisPhysics], ...], MachineSizes]:
    """Return what a case gives to the workflow, from its files: data, axis, what that may lack, and its sizes."""
    observations = read_frf_set(folder / "given" / f"{name}.frf.h5").observations
    file = parse_model((folder / "given" / f"{name}.toml").read_text(encoding="utf-8"), name)
    model = build_model(file.family, file.parameters)
    folds = default_folds(observation.conditions for observation in observations)
    comparison = compare_responses(observations, held_out=folds, form=form)
    subject = DescribedDrive(model.parameters, dict(file.uncertain), dict(file.effects))
    sizes = sizes_of_drive(subject.physics({}), observations)
    return comparison, subject, subject.candidates(sizes), sizes


def answer(name: str, folder: Path, form: ModelFormError) -> dict[str, Any]:
    """Answer one case without its truth; an answer that is there is kept."""
    path = folder / "answers" / f"{name}.json"
    if path.exists():
        return dict(json.loads(path.read_text(encoding="utf-8")))
    comparison, subject, candidates, sizes = given(name, folder, form)
    began = time.process_time()
    try:
        found = explain_comparison(comparison, subject, candidates, sizes=sizes)
    except MonitorCoreError as error:  # counts as an answer that is not right
        document = {"name": name, "outcome": f"refused: {error}", "effects": [], "gap": _NO_GAP, "candidates": {},
                    "pulls": {}, "records": [], "described": [], "contradictions": []}  # fmt: skip
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
                "same_as": list(effect.aliases),
                "plausible": effect.plausible,
                "delta_bic": effect.delta_bic,
                "parameters": {
                    key: [item.estimate.value, *item.interval_95] for key, item in effect.parameters.items()
                },
            }
            for effect in found.effects
        ],
        "gap": asdict(found.gap),
        "candidates": {
            candidate.key: [
                candidate.detection_limit,
                candidate.delta_bic,
                None if candidate.untested is None else untested_sentence(candidate.untested),
            ]
            for candidate in found.candidates
        },
        "pulls": dict(found.pulls),
        "records": [
            {"observations": list(record.observations), "fault": str(record.fault)} for record in found.records
        ],
        "described": [
            {
                "place": item.place,
                "parameter": item.parameter,
                "frequency_hz": item.frequency_hz,
                "has_no_form": item.has_no_form,
            }
            for item in found.described
        ],
        "contradictions": list(contradictions(found)),
    }


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


def chosen(share: float, seed: int) -> list[Job]:
    """Return a share of the cases, spread over the kinds by their numbers."""
    jobs = composition(seed)
    return [job for job in jobs if zlib.crc32(f"{seed}/{job.name}".encode()) % 1000 < 1000 * share]


def seed_of(folder: Path, wanted: int | None) -> int:
    """Return the seed of a run: the one that it began with, the one that is wanted, or a fresh one."""
    path = folder / "seed.txt"
    if path.exists():
        begun = int(path.read_text(encoding="utf-8"))
        if wanted not in {None, begun}:
            raise SystemExit(f"{folder} holds a run of seed {begun}; give --out another folder for seed {wanted}")
        return begun
    seed = secrets.randbelow(10**9) if wanted is None else wanted
    path.write_text(str(seed), encoding="utf-8")
    return seed


def main() -> None:
    """Draw, answer, score."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--share", type=float, default=1.0)
    parser.add_argument("--learnt", action="store_true")
    options = parser.parse_args()
    folder = options.out
    make_folders(folder)
    compute_in_one_thread()
    seed = seed_of(folder, options.seed)
    jobs, form = chosen(options.share, seed), learnt_form(folder) if options.learnt else ModelFormError()
    with ProcessPoolExecutor(options.workers, initializer=compute_in_one_thread) as pool:
        n = len(jobs)
        sealed = list(pool.map(draw, jobs, [folder] * n, [seed] * n, [form] * n))
        digest = hashlib.sha256("\n".join(sealed).encode()).hexdigest()
        print(f"{n} cases drawn, seed {seed}; SHA-256 of the sealed truth: {digest}", flush=True)
        answers = []
        for found in pool.map(answer, [job.name for job in jobs], [folder] * n, [form] * n):
            answers.append(found)
            print(f"{len(answers)} of {n} answered: {found['name']} {found['outcome']}", flush=True)
    truths = [json.loads(text) for text in sealed]
    scored = [
        Scored(job, truth["truth"], found, truth["d_prime"], truth["wrong_setting"], truth["d_prime_of_record"])
        for job, truth, found in zip(jobs, truths, answers, strict=True)
    ]
    card = score_card(scored, digest, seed, learnt=options.learnt)
    (folder / "score-card.md").write_text(card, encoding="utf-8")
    print(card)


if __name__ == "__main__":
    main()
