"""The score card of the blind benchmark: answers beside their truths, and what was asked beside what was measured."""

import math
import statistics
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from monitor_core.effects import DRIVE_EFFECTS
from monitor_core.effects.effect import EffectParameter
from monitor_core.fitting.hypothesis import is_size

Case = TypeVar("Case")
NOISES = (0.003, 0.01)
OUTSIDE = "outside:"
_PARAMETERS = {effect.key: effect.parameters for effect in DRIVE_EFFECTS}
_LN_RATIO = EffectParameter("ln_ratio", "-", lower=-1.0, upper=1.0, scale=0.1)  # of any wrong parameter


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
        return [{effect["key"], *effect["same_as"], *effect["equivalent_to"]} for effect in self.answer["effects"]]

    @property
    def claims(self) -> bool:
        """Whether the answer claims to know: unknown and none do not."""
        return self.answer["outcome"] in ("named", "equivalent", "partial")

    @property
    def right(self) -> bool:
        """Whether each finding may be a true effect, and each true effect is in a finding of at most two."""
        of_two = [keys for keys, given in zip(self.classes, self.answer["effects"], strict=True)
                  if len(given["equivalent_to"]) <= 1]  # fmt: skip
        covered = all(any(key in keys for keys in of_two) for key in self.true_keys)
        return self.claims and covered and all(keys & self.true_keys for keys in self.classes)

    @property
    def alone(self) -> bool:
        """Whether the truth was found and nothing stands beside it."""
        return self.right and all(not effect["equivalent_to"] for effect in self.answer["effects"])

    @property
    def wrong(self) -> bool:
        """Whether a finding that is claimed holds no true effect."""
        return self.claims and any(not keys & self.true_keys for keys in self.classes)

    @property
    def held_out_ratio(self) -> float:
        """Gap on held-out data after naming. [σ]."""
        return float(self.answer["gap"]["after"]["held_out"])


def score_card(scored: Sequence[Scored], digest: str) -> str:
    """Return the score card as Markdown."""
    singles = [case for case in scored if len(case.true_keys) == 1 and case.job.family == "receptance"]
    pairs = [case for case in scored if len(case.true_keys) == 2 and case.job.family == "receptance"]
    healthy = [case for case in scored if case.job.kind == "none" and case.job.family == "receptance"]
    outside = [case for case in scored if case.job.kind.startswith(OUTSIDE)]
    crude = [case for case in scored if case.job.family == "lumped"]
    floors = {
        noise: statistics.median(case.held_out_ratio for case in healthy if case.job.noise == noise) for noise in NOISES
    }
    clear = [case for case in singles if case.d_prime >= 12.0]
    faint = [case for case in singles if case.d_prime < 3.0]
    ratios = sorted(case.held_out_ratio / floors[case.job.noise] for case in singles + pairs if case.right)
    of_healthy = [case.held_out_ratio / case.answer["gap"]["noise_floor"] for case in healthy]
    seconds = [case.answer["seconds"] for case in scored]
    lines = [
        f"{len(scored)} cases, {sum(case.job.plant == 'transmission line' for case in scored)} of them of the "
        f"transmission-line plant; SHA-256 of the sealed truth `{digest}`.",
        "",
        "| what | asked | measured |",
        "|---|---|---|",
        row("d' ≥ 12: truth named, or in a class of at most two", "≥ 97 %", clear, lambda case: case.right),
        row("large effects (d' ≥ 12) named alone", "≥ 85 %",
             [case for case in clear if case.job.size == "large"], lambda case: case.alone),
        row("a wrong name, all but the crude ones", "≤ 0.5 %",
             [case for case in scored if case.job.family == "receptance"], lambda case: case.wrong),
        row("d' < 3: none", "all", faint, lambda case: case.answer["outcome"] == "none"),
        row("d' < 3: none, and the truth is below the limit stated, or said not to be testable", "all", faint,
             _is_below_limit),
        row("healthy: none", "≥ 99 %", healthy, lambda case: case.answer["outcome"] == "none"),
        row("outside the catalogue: named", "0", outside,
             lambda case: case.answer["outcome"] in ("named", "equivalent")),
        row("outside, gap ≥ 2 × floor: unknown", "all",
             [case for case in outside if case.answer["gap"]["before"]["held_out"] >= 2.0 * floors[case.job.noise]],
             lambda case: case.answer["outcome"] == "unknown"),
        row("outside, all: unknown", "≥ 80 %", outside, lambda case: case.answer["outcome"] == "unknown"),
        row("two large effects: both right and alone", "≥ 85 %",
             [case for case in pairs if case.job.size == "large"], lambda case: case.alone),
        row("two medium effects: both right and alone", "≥ 60 %",
             [case for case in pairs if case.job.size == "medium"], lambda case: case.alone),
        row("two effects, d' of the weaker ≥ 12: both right", "–",
             [case for case in pairs if case.d_prime >= 12.0], lambda case: case.right),
        row("two effects: a wrong one, not flagged", "0", pairs, lambda case: case.wrong),
        row("crude baseline: ≤ 1.1 × the floor of its data", "all", crude,
             lambda case: case.held_out_ratio <= 1.1 * case.answer["gap"]["noise_floor"]),
        f"| held-out gap of healthy cases over the floor of their data: median, largest | 1 | "
        f"{statistics.median(of_healthy):.3f}, {max(of_healthy):.3f} |",
        f"| held-out gap after naming over the floor, median | ≤ 1.05 | {_quantile(ratios, 0.5):.3f} |",
        f"| held-out gap after naming over the floor, 90th percentile | ≤ 1.25 | {_quantile(ratios, 0.9):.3f} |",
        *_parameter_rows(singles),
        f"| seconds a case, one core: median, 90 %, longest | ≤ 15 | {statistics.median(seconds):.1f}, "
        f"{_quantile(sorted(seconds), 0.9):.1f}, {max(seconds):.1f} |",
        "",
        "Errors of sizes that were named alone, beside their stated standard uncertainties (rms over the cases):",
        "",
        *_size_rows(singles),
        "",
        "What was not right:",
        "",
        *[_complaint(case) for case in scored if _is_complaint(case)],
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _is_below_limit(case: Scored) -> bool:
    """Tell whether the answer is none and says that the true effect would not have been seen."""
    ((key, values),) = case.truth.items()
    limit = case.answer["detection_limits"].get(key)
    return case.answer["outcome"] == "none" and (limit is None or limit > size_of(key, values))


def size_of(key: str, values: dict[str, float]) -> float:
    """Return how large an effect is; one with two components, their norm."""
    first, *others = _PARAMETERS.get(key, (_LN_RATIO,))
    components = [first, *(parameter for parameter in others if is_size(parameter) and parameter.unit == first.unit)]
    return math.hypot(*(values.get(parameter.name, parameter.null) for parameter in components))


def row(what: str, asked: str, among: Sequence[Case], test: Callable[[Case], bool]) -> str:
    """Return the line of a table: of how many cases something holds."""
    n = sum(1 for case in among if test(case))
    share = f"{100.0 * n / len(among):.1f} %" if among else "–"
    return f"| {what} | {asked} | {n} of {len(among)} ({share}) |"


def _parameter_rows(singles: Iterable[Scored]) -> list[str]:
    errors, covered, friction = [], [], []
    for case, key, truth, found in _named_alone(singles):
        name, (_, low, high) = next(iter(found["parameters"].items()))
        covered.append(low <= truth[name] <= high)
        if case.d_prime >= 30.0:
            sizes = {of_effect: estimate for of_effect, (estimate, _, _) in found["parameters"].items()}
            error = abs(size_of(key, sizes) / size_of(key, truth) - 1.0)
            (friction if key == "guide-friction" else errors).append(error)
    share = 100.0 * sum(covered) / max(len(covered), 1)
    return [
        f"| 95 % intervals of the parameter that cover | ≥ 90 % | {sum(covered)} of {len(covered)} ({share:.1f} %) |",
        row(
            "error of the parameter at d' ≥ 30, but for friction: at most 10 %",
            "all",
            errors,
            lambda relative_error: relative_error <= 0.1,
        ),
        f"| the same: median, 90 %, largest | – | {_percent(errors)} |",
        f"| of friction: median, 90 %, largest | ≤ 30 % | {_percent(friction)} |",
    ]


def _size_rows(singles: Iterable[Scored]) -> list[str]:
    """Return what `form_share` of each effect has to be set by: errors beyond the scatter that is stated without it."""
    of_effect: dict[str, list[tuple[float, float]]] = {}
    for _, key, truth, found in _named_alone(singles):
        name, (value, low, high) = next(iter(found["parameters"].items()))
        error, stated = value - truth[name], (high - low) / (2.0 * 1.959964)
        of_effect.setdefault(key, []).append((100.0 * error / truth[name], 100.0 * stated / truth[name]))
    rows = ["| effect | cases | error | stated |", "|---|---|---|---|"]
    for key, pairs in of_effect.items():
        error, stated = np.sqrt(np.mean(np.square(pairs), axis=0))
        rows.append(f"| {key} | {len(pairs)} | {error:.1f} % | {stated:.1f} % |")
    return rows


def _named_alone(
    singles: Iterable[Scored],
) -> Iterator[tuple[Scored, str, dict[str, float], dict[str, Any]]]:
    """Yield the cases whose true effect is the only answer, with its key, its true values and what was found."""
    for case in singles:
        (key, truth), effects = next(iter(case.truth.items())), case.answer["effects"]
        if case.alone and effects[0]["key"] == key:
            yield case, key, truth, effects[0]


def _percent(errors: list[float]) -> str:
    if not errors:
        return "–"
    ranked = sorted(errors)
    return f"{100 * _quantile(ranked, 0.5):.1f}, {100 * _quantile(ranked, 0.9):.1f}, {100 * ranked[-1]:.1f} %"


def _quantile(ranked: Sequence[float], share: float) -> float:
    return float(np.quantile(ranked, share)) if len(ranked) else math.nan


def _is_complaint(case: Scored) -> bool:
    if case.job.kind.startswith(OUTSIDE):
        return case.answer["outcome"] != "unknown"
    if case.job.kind == "none":
        return case.answer["outcome"] != "none" and case.job.family == "receptance"
    return case.wrong or (case.d_prime >= 12.0 and not case.right)


def _complaint(case: Scored) -> str:
    found = "; ".join(
        " = ".join([effect["key"], *effect["equivalent_to"]]) + f" (ΔBIC {effect['delta_bic']:.0f})"
        for effect in case.answer["effects"]
    )
    gap = case.answer["gap"]
    return (
        f"- {case.job.name}: {case.job.kind}, {case.job.size}, noise {case.job.noise:g}, {case.job.plant}, d' "
        f"{case.d_prime:.1f} → *{case.answer['outcome']}* {found}; held-out gap {gap['before']['held_out']:.2f} → "
        f"{gap['after']['held_out']:.2f}"
    )
