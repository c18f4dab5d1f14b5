"""Collect what a report says, once for the page, for Markdown and for the terminal: sentences, headings and tables."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from monitor_core.discrepancy import (
    Candidate,
    Explanation,
    FoundEffect,
    FoundParameter,
    GapPair,
    Misfit,
    Outcome,
)
from monitor_core.effects import PREFIX
from service.documents.explanation_sentences import (
    NAMES,
    name_of,
    parameter_words,
    place_sentence,
    remarks,
    step_sentence,
    untested_sentence,
)
from service.report import verdict
from service.report.rounding import (
    TIMES,
    UNKNOWN,
    between,
    bound,
    evidence,
    notation,
    probability,
    quantity,
    ratio_interval,
    ratio_with_uncertainty,
    ratio_words,
    rounded,
    unit_shown,
    with_uncertainty,
)


@dataclass(frozen=True, slots=True)
class Cell:
    """What a cell of a table shows."""

    text: str
    value: float = math.nan  # the number in full, for programs; NaN where there is none or it is not known
    note: str = ""  # after the number
    key: str = ""  # what files and programs call it: small print of the page

    def __str__(self) -> str:
        return self.text + self.note


Row = tuple[Cell, ...]


@dataclass(frozen=True, slots=True)
class EffectContent:
    """A found effect."""

    effect: FoundEffect
    name: str
    others: tuple[str, ...]  # names of what these data cannot distinguish from it
    remarks: tuple[str, ...]
    parameters: tuple[Row, ...]  # name, value, 95 % interval, plausible
    delta_bic: Cell
    held_out_gain: Cell | None  # None: nothing was held out


@dataclass(frozen=True, slots=True)
class ReportContent:
    """What a report of an explanation says."""

    headline: str
    meaning: str
    asides: tuple[str, ...]
    misfits_heading: str
    misfits: tuple[Row, ...]  # where, size, kind, p-value
    remainder: tuple[Row, ...]
    found_heading: str
    effects: tuple[EffectContent, ...]
    gap: tuple[Row, ...]  # before or after, fitted data, held-out data, noise floor
    gap_by_channel: tuple[Row, ...]  # channel, before, after; none for a single channel
    steps: tuple[str, ...]
    candidates_heading: str
    candidates: tuple[Row, ...]  # effect, ΔBIC, how it was tried, held-out gain, detection limit
    threshold: str
    pulls: tuple[Row, ...]  # error, pull
    next_steps: tuple[str, ...]  # what to measure or check next
    model_heading: str


def report_content(explanation: Explanation) -> ReportContent:
    """Return what a report of an explanation says."""
    gap, outcome = explanation.gap, explanation.outcome
    unknown, none = outcome is Outcome.UNKNOWN, outcome is Outcome.NONE
    held_out = not verdict.nothing_held_out(explanation)
    channels = explanation.gap_by_channel.items() if len(explanation.gap_by_channel) > 1 else ()
    model = "The model, as refitted" if none else "The model, with what was added"
    return ReportContent(
        headline=verdict.headline(explanation),
        meaning=verdict.meaning(explanation),
        asides=verdict.asides(explanation),
        misfits_heading="Patterns within the noise" if none else "Where model and measurement differ",
        misfits=_misfit_rows(explanation.localisation),
        remainder=_misfit_rows(explanation.remainder),
        found_heading="What helped most, and is not named as the cause" if unknown else "What was found",
        effects=tuple(_effect_content(effect, held_out=held_out) for effect in explanation.effects),
        gap=tuple(
            (Cell(words), *(_quantity(size, gap.unit) for size in (pair.fit, pair.held_out, gap.noise_floor)))
            for words, pair in (("before", gap.before), ("after", gap.after))
        ),
        gap_by_channel=tuple((Cell(name), *(_quantity(size, gap.unit) for size in both)) for name, both in channels),
        steps=tuple(_step_sentence(added_words(step.effects), step.gap, gap.unit) for step in explanation.steps),
        candidates_heading="What could still hide" if none else "What else was considered",
        candidates=tuple(_candidate_row(candidate) for candidate in sorted(explanation.candidates, key=_order)),
        threshold=f"One more effect would need a ΔBIC of {evidence(explanation.least_delta_bic)}.",
        pulls=tuple(
            (Cell(parameter_words(name), key=name), Cell(rounded(pull, 2), pull))
            for name, pull in explanation.pulls.items()
        ),
        next_steps=tuple(_capitalised(step_sentence(step, NAMES)) for step in explanation.next_steps),
        model_heading="The model, as it was: what helped most is not in it" if unknown else model,
    )


def _capitalised(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


def added_words(keys: Iterable[str]) -> str:
    """Return the names of the effects of a step."""
    return " + ".join(map(name_of, keys))


def _quantity(value: float, unit: str) -> Cell:
    return Cell(quantity(value, unit), value)


def _misfit_rows(misfits: Sequence[Misfit]) -> tuple[Row, ...]:
    return tuple(
        (
            Cell(place_sentence(misfit.place, NAMES)),
            _quantity(misfit.size, "sigma"),
            Cell(str(misfit.kind)),
            Cell(probability(misfit.p_value)),
        )
        for misfit in misfits
    )


def _effect_content(effect: FoundEffect, *, held_out: bool) -> EffectContent:
    gain = effect.held_out_log_likelihood_gain
    return EffectContent(
        effect,
        name_of(effect.key) if effect.key.startswith(PREFIX) else effect.name,
        tuple(name_of(key) for key in effect.equivalent_to),
        tuple(remarks(effect, NAMES)),
        tuple(_parameter_row(effect.key, name, parameter) for name, parameter in effect.parameters.items()),
        Cell(evidence(effect.delta_bic), effect.delta_bic),
        Cell(evidence(gain), gain) if held_out else None,
    )


def _parameter_row(key: str, name: str, size: FoundParameter) -> Row:
    value, uncertainty, unit = size.estimate.value, size.estimate.standard_uncertainty, unit_shown(size.unit)
    plausible = Cell("yes" if size.plausible else "NO")
    if key.startswith(PREFIX):  # known by the logarithm of the ratio to what is stated
        parameter = key.removeprefix(PREFIX)
        at_bound = bound(*size.interval_95, ratio_words)
        shown = Cell(at_bound or ratio_with_uncertainty(value, uncertainty), value)
        return (
            Cell(parameter_words(parameter), key=parameter),
            shown,
            Cell(at_bound or ratio_interval(*size.interval_95)),
            plausible,
        )
    if at_bound := bound(*size.interval_95, lambda end: rounded(end) + unit):
        return Cell(parameter_words(name), key=name), Cell(at_bound, value), Cell(at_bound), plausible
    return (
        Cell(parameter_words(name), key=name),
        Cell(with_uncertainty(value, uncertainty) + unit, value),
        Cell(between(*size.interval_95, notation(value, uncertainty)) + unit),
        plausible,
    )


def _step_sentence(effect: str, gap: GapPair, unit: str) -> str:
    held_out = "nothing held out" if math.isnan(gap.held_out) else f"{quantity(gap.held_out, unit)} held out"
    return f"with {effect}: {quantity(gap.fit, unit)} fitted, {held_out}"


def _order(candidate: Candidate) -> tuple[bool, bool, float]:
    """Put those that were tested first, the best supported before the others."""
    return (candidate.untested is not None, math.isnan(candidate.delta_bic), -candidate.delta_bic)


def _candidate_row(candidate: Candidate) -> Row:
    """Return a candidate with its evidence, how it was tried, and its detection limit."""
    tried, limit = "in addition", _detection_limit(candidate)
    if candidate.untested is not None:
        tried, limit = UNKNOWN, Cell(f"untestable: {untested_sentence(candidate.untested)}")
    elif candidate.substitution_for is not None:
        tried = f"instead of {name_of(candidate.substitution_for)}"
    delta_bic, held_out = (Cell(evidence(gain), gain) for gain in (candidate.delta_bic, candidate.held_out))
    return (Cell(name_of(candidate.key), key=candidate.key), delta_bic, Cell(tried), held_out, limit)


def _detection_limit(candidate: Candidate) -> Cell:
    """Return the size from which on an effect would be seen.

    For a wrong parameter it is a ratio, or near one the share by which it is above what is stated.
    """
    limit = candidate.detection_limit
    if limit is None:
        return Cell("not known")
    if candidate.key.startswith(PREFIX):  # known by its logarithm
        ratio = math.exp(limit)
        if ratio < TIMES:
            more, less = 100.0 * (ratio - 1.0), 100.0 * (1.0 - 1.0 / ratio)
            return Cell(f"{rounded(more, 2)} % more or {rounded(less, 2)} % less than stated", more)
        return Cell(f"{rounded(ratio, 2)} times what is stated, or as many times less", ratio)
    return Cell(quantity(limit, candidate.unit, 2), limit)
