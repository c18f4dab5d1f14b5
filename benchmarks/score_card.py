"""The score card of the blind benchmark: answers beside their truths, and what was asked beside what was measured."""

import math
import statistics
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from benchmarks.blind_cases import OUTSIDE, Job
from monitor_core.discrepancy import AMPLITUDE_LAW, TIME_LAW
from monitor_core.discrepancy.verdict.classes import goes_with_amplitude
from monitor_core.effects import DRIVE_EFFECTS
from monitor_core.effects.effect import EffectParameter
from monitor_core.fitting.hypothesis import is_size

Case = TypeVar("Case")
#: d′ at which an effect is large, medium, and below which nothing can be asked.
LARGE, CLEAR, FAINT = 30.0, 12.0, 3.0
#: Where a stranger sits, and the parameters that say it; a frequency within 5 % says it as well.
_STRANGERS = {
    "wandering-absorber": ({"table"}, set[str]()),
    "nut-softening": ({"nut"}, {"nut_stiffness_n_per_m", "preload_n"}),
    "preload-drift": ({"nut"}, {"nut_stiffness_n_per_m", "preload_n"}),
    "backlash": ({"nut"}, {"nut_stiffness_n_per_m", "preload_n"}),
    "contact-loss": ({"nut"}, {"nut_stiffness_n_per_m", "preload_n"}),
    "screw-bending": ({"screw", "nut"}, {"bracket_stiffness_n_per_m", "nut_stiffness_n_per_m"}),
    "rotor-absorber": ({"motor"}, set[str]()),
    "screw-end-absorber": ({"screw end"}, set[str]()),
    "cracked-coupling": ({"motor", "screw"}, {"coupling_stiffness_nm_per_rad"}),
}
#: What is a law of the amplitude: where that is left open beside a name, the truth is among what is said.
_OF_AMPLITUDE = frozenset(f"{OUTSIDE}{kind}" for kind in ("nut-softening", "backlash", "contact-loss")) | {
    effect.key for effect in DRIVE_EFFECTS if goes_with_amplitude(effect)
}
_OF_TIME = f"{OUTSIDE}preload-drift"
_PARAMETERS = {effect.key: effect.parameters for effect in DRIVE_EFFECTS}
_LN_RATIO = EffectParameter("ln_ratio", "-", lower=-1.0, upper=1.0, scale=0.1)  # of any wrong parameter


@dataclass(frozen=True, slots=True)
class Scored:
    """One case with its answer beside its truth."""

    job: Job
    truth: dict[str, dict[str, float]]
    answer: dict[str, Any]
    d_prime: float  # of the weakest of what is hidden; NaN for nothing
    wrong_setting: int | None = None  # of which a record is wrong
    d_prime_of_record: float = math.nan  # of what is wrong with it, beside what is hidden

    @property
    def true_keys(self) -> set[str]:
        """Keys of what is hidden, as far as the catalogue has them."""
        return {key for key in self.truth if not key.startswith(OUTSIDE)}

    @property
    def acceptable_keys(self) -> set[str]:
        """Keys of what is hidden, and of what an answer may leave open that it is."""
        of_amplitude = {AMPLITUDE_LAW} if _OF_AMPLITUDE & self.truth.keys() else set()
        return self.true_keys | of_amplitude | ({TIME_LAW} if _OF_TIME in self.truth else set())

    @property
    def leaves_it_open(self) -> bool:
        """Whether a name stands beside the law of the amplitude or of time that the truth is."""
        laws = {AMPLITUDE_LAW, TIME_LAW} & self.acceptable_keys
        return not self.wrong and self.claims and any(laws & keys for keys in self.classes)

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
        return self.claims and any(not keys & self.acceptable_keys for keys in self.classes)

    @property
    def record_named(self) -> bool:
        """Whether the wrong record is named."""
        return any(
            which // 2 == self.wrong_setting for record in self.answer["records"] for which in record["observations"]
        )

    @property
    def well_described(self) -> bool:
        """Whether a stranger is described at its place by its parameter, or by its frequency within 5 %."""
        places, parameters = _STRANGERS[self.job.kind.removeprefix(OUTSIDE)]
        true = self.truth[self.job.kind].get("frequency_hz", math.nan)
        return self.answer["outcome"] == "described" and any(
            item["place"] in places
            and (item["parameter"] in parameters or abs((item["frequency_hz"] or math.inf) / true - 1.0) < 0.05)
            for item in self.answer["described"]
        )

    @property
    def gap_before(self) -> float:
        """Gap on held-out data as described; of what was fitted where nothing could be held out. [σ]."""
        gap = self.answer["gap"]["before"]
        return float(gap["held_out"] if math.isfinite(gap["held_out"]) else gap["fit"])

    @property
    def held_out_ratio(self) -> float:
        """Gap on held-out data after naming. [σ]."""
        return float(self.answer["gap"]["after"]["held_out"])


def score_card(scored: Sequence[Scored], digest: str, seed: int, *, learnt: bool = False) -> str:
    """Return the score card as Markdown."""
    whole = [case for case in scored if case.job.family == "receptance"]
    plain = [case for case in whole if not case.job.fault]
    singles = [case for case in plain if len(case.true_keys) == 1]
    pairs = [case for case in plain if len(case.true_keys) == 2]
    healthy = [case for case in whole if case.job.healthy]
    outside = [case for case in plain if case.job.outside]
    records = [case for case in whole if case.job.fault]
    crude = [case for case in scored if case.job.family == "lumped"]
    floors = {case.job.name: _floor(case, healthy) for case in scored}
    clear = [case for case in singles if case.d_prime >= CLEAR]
    faint = [case for case in singles if case.d_prime < FAINT]
    ratios = sorted(case.held_out_ratio / floors[case.job.name] for case in singles + pairs
                    if case.right and math.isfinite(case.held_out_ratio))  # fmt: skip
    open_gap = [case for case in outside if case.gap_before >= 2.0 * floors[case.job.name]]
    beside = [case for case in records if case.true_keys]
    seen = [case for case in records if case.gap_before >= 1.15 * floors[case.job.name]]
    seconds = [case.answer["seconds"] for case in scored]
    lines = [
        "# Score card of the blind benchmark",
        "",
        f"    python -m benchmarks.hidden_effects --seed {seed} --out FOLDER --workers 2"
        + " --learnt" * learnt,
        "",
        "What it prints (`FOLDER/score-card.md`). How machines are drawn and what d' and the other figures mean is in "
        "`docs/explanation/hidden-effects.md`.",
        "",
        f"{len(scored)} cases, {sum(case.job.plant == 'transmission line' for case in scored)} of them of the "
        f"transmission-line plant; seed {seed}, SHA-256 of the sealed truth `{digest}`. Form error of the models: "
        f"{'learnt from healthy benchtop axes' if learnt else 'the default'}.",
        "",
        "| what | asked | measured |",
        "|---|---|---|",
        row("d' ≥ 12: truth named, or in a class of at most two", "≥ 97 %", clear, lambda case: case.right),
        row(f"large effects (d' ≥ {LARGE:.0f}) named alone", "≥ 85 %",
            [case for case in clear if case.d_prime >= LARGE], lambda case: case.alone),
        row("a wrong name, all but the crude ones", "≤ 0.5 %", whole, lambda case: case.wrong),
        row("d' < 3: none", "–", faint, lambda case: case.answer["outcome"] == "none"),
        row("d' < 3: none, and the truth is below the limit stated, or said not to be testable", "–", faint,
            _is_below_limit),
        row("healthy: none", "≥ 99 %", healthy, lambda case: case.answer["outcome"] == "none"),
        row(f"two large effects (d' of the weaker ≥ {LARGE:.0f}): both right and alone", "≥ 85 %",
            [case for case in pairs if case.d_prime >= LARGE], lambda case: case.alone),
        row(f"two medium effects (d' of the weaker {CLEAR:.0f} to {LARGE:.0f}): both right and alone", "≥ 60 %",
            [case for case in pairs if CLEAR <= case.d_prime < LARGE], lambda case: case.alone),
        row("two effects: a wrong one, not flagged", "0", pairs, lambda case: case.wrong),
        row("answers that contradict themselves", "0", scored, lambda case: bool(case.answer["contradictions"])),
        *_parameter_rows(singles),
        f"| held-out gap after naming over the floor, median | ≤ 1.05 | {_quantile(ratios, 0.5):.3f} |",
        f"| held-out gap after naming over the floor, 90th percentile | ≤ 1.25 | {_quantile(ratios, 0.9):.3f} |",
        row(f"a wrong record of d' ≥ {CLEAR:.0f} is named", "≥ 90 %",
            [case for case in records if case.d_prime_of_record >= CLEAR], lambda case: case.record_named),
        row("a wrong record where the gap, an effect beside it or not, is ≥ 1.15 × floor: named", "≥ 90 %", seen,
            lambda case: case.record_named),
        row("a wrong record, all: named", "–", records, lambda case: case.record_named),
        row("the effect beside a wrong record (d' ≥ 12) is found", "≥ 80 %",
            [case for case in beside if case.d_prime >= CLEAR], lambda case: case.right),
        row("a wrong record: a wrong name", "0", records, lambda case: case.wrong),
        row("outside the catalogue: a wrong name", "0", outside, lambda case: case.wrong),
        row("outside: a name, and beside it, right, a law of the amplitude or of time", "–", outside,
            lambda case: case.leaves_it_open),
        row("outside, gap ≥ 2 × floor: described at its place, with its parameter or frequency", "≥ 70 %", open_gap,
            lambda case: case.well_described),
        row("the same: held-out gap then ≤ 1.2 × floor", "≥ 70 %",
            [case for case in open_gap if case.answer["outcome"] == "described"],
            lambda case: case.held_out_ratio <= 1.2 * floors[case.job.name]),
        row("outside, gap ≥ 2 × floor: unknown or described", "–", open_gap,
            lambda case: case.answer["outcome"] in ("unknown", "described")),
        row("crude baseline: ≤ 1.1 × the floor of its data", "all", crude,
            lambda case: case.held_out_ratio <= 1.1 * case.answer["gap"]["noise_floor"]),
        f"| seconds a case, one core: median, 95 %, longest | ≤ 3, 20, 60 | {statistics.median(seconds):.1f}, "
        f"{_quantile(sorted(seconds), 0.95):.1f}, {max(seconds):.1f} |",
        "",
        *_breakdown(whole),
        "",
        "Errors of sizes that were named alone, beside their stated standard uncertainties (rms over the cases):",
        "",
        *_size_rows(singles),
        "",
        "What was not right, and why:",
        "",
        *[_line_of(case, floors[case.job.name]) for case in scored if _is_complaint(case)],
        "",
        "Every other case:",
        "",
        *[_line_of(case, floors[case.job.name]) for case in scored if not _is_complaint(case)],
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _floor(case: Scored, healthy: Sequence[Scored]) -> float:
    """Return what healthy machines leave under the same noise and errors of settings, or the floor that is stated."""
    for alike in (
        [other for other in healthy if (other.job.noise, other.job.scatter) == (case.job.noise, case.job.scatter)],
        [other for other in healthy if other.job.noise == case.job.noise],
    ):
        left = [other.held_out_ratio for other in alike if math.isfinite(other.held_out_ratio)]
        if left:
            return statistics.median(left)
    return float(case.answer["gap"]["noise_floor"])


def _breakdown(cases: Sequence[Scored]) -> list[str]:
    """Return of each machine, design, scatter and disturbance: what was asked and met, healthy ones and wrong names."""
    rows = ["| among | d' ≥ 12 right | healthy: none | wrong names |", "|---|---|---|---|"]
    for name in ("machine", "design", "scatter", "disturbance", "plant"):
        for value in dict.fromkeys(getattr(case.job, name) for case in cases):
            among = [case for case in cases if getattr(case.job, name) == value]
            clear = [case for case in among
                     if len(case.true_keys) == 1 and not case.job.fault and case.d_prime >= CLEAR]  # fmt: skip
            healthy = [case for case in among if case.job.healthy]
            none = sum(case.answer["outcome"] == "none" for case in healthy)
            rows.append(
                f"| {name} {value} | {sum(case.right for case in clear)} of {len(clear)} | {none} of {len(healthy)} | "
                f"{sum(case.wrong for case in among)} of {len(among)} |"
            )
    return rows


def _is_below_limit(case: Scored) -> bool:
    """Tell whether the answer is none and says that the true effect would not have been seen."""
    ((key, values),) = case.truth.items()
    limit, *_ = case.answer["candidates"].get(key, (None,))
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
        f"| 95 % intervals that cover | 92 to 98 % | {sum(covered)} of {len(covered)} ({share:.1f} %) |",
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
    if case.wrong or case.answer["contradictions"]:
        return True
    if case.job.fault:
        return not case.record_named or (case.d_prime >= CLEAR and not case.right)
    if case.job.outside:
        return not case.well_described
    if case.job.kind == "none":
        return case.answer["outcome"] != "none" and case.job.family == "receptance"
    return case.d_prime >= CLEAR and not case.right


def _line_of(case: Scored, floor: float) -> str:
    """Return a case in a line: under what, its d', the answer, and, where that is not right, what it says of it."""
    found = "; ".join(
        " = ".join([effect["key"], *effect["equivalent_to"]]) + f" (ΔBIC {effect['delta_bic']:.0f})"
        for effect in case.answer["effects"]
    )
    gap, job = case.answer["gap"], case.job
    hidden = f"{job.kind}, {job.size}" + (f", {job.fault} {job.fault_size}" if job.fault else "")
    described = [f"{item['place']} {item['parameter']}" for item in case.answer["described"]]
    return (
        f"- {job.name}: {hidden}; {job.machine}, {job.design}, {job.scatter}, {job.disturbance}, noise {job.noise:g}, "
        f"{job.plant}; d' {case.d_prime:.1f} → *{case.answer['outcome']}* {found}{' '.join(described)}; held-out gap "
        f"{gap['before']['held_out']:.2f} → {gap['after']['held_out']:.2f}, floor {floor:.2f}, "
        f"{case.answer['seconds']:.0f} s" + "".join(f". {reason}" for reason in _reasons(case) if _is_complaint(case))
    )


def _reasons(case: Scored) -> list[str]:
    """Return what the answer itself says of why it is not right."""
    reasons = [f"Contradicts itself: {words}" for words in case.answer["contradictions"]]
    reasons += [
        f"Wrong: {effect['key']}"
        for keys, effect in zip(case.classes, case.answer["effects"], strict=True)
        if not keys & case.acceptable_keys and case.claims
    ]
    covered = set().union(*case.classes) if case.classes else set[str]()
    for key in sorted(case.true_keys):
        limit, delta_bic, untestable = case.answer["candidates"].get(key, (None, math.nan, None))
        if key in covered:
            wide = any(key in keys and len(effect["equivalent_to"]) > 1
                       for keys, effect in zip(case.classes, case.answer["effects"], strict=True))  # fmt: skip
            reasons += [f"{key} is in a class of more than two"] * wide
            continue
        size = size_of(key, case.truth[key])
        reasons.append(
            f"{key} of {size:.3g} not found"
            + (f", said not to be testable: {untestable}" if untestable else "")
            + (f", below the limit of {limit:.3g}" if limit is not None and limit > size else "")
            + (f", refitted it would bring ΔBIC {delta_bic:.0f}" if math.isfinite(delta_bic) else "")
        )
    if case.job.fault and not case.record_named:
        named = [record["fault"] for record in case.answer["records"]]
        reasons.append(f"The wrong record is not named{f', others are: {named}' if named else ''}")
    strained = [f"{name} {pull:.1f}" for name, pull in case.answer["pulls"].items() if abs(pull) > 3.0]
    return reasons + ([f"Strained: {', '.join(strained)}"] if strained else [])
