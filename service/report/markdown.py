"""The report as one page of Markdown: verdict, where, what, evidence, what else, and what to measure next."""

import re
from collections.abc import Sequence

from monitor_core.discrepancy.explanation import Explanation, FoundEffect, FoundParameter, Misfit
from service.report.rounding import (
    between,
    evidence,
    notation,
    probability,
    quantity,
    rounded,
    unit_shown,
    with_uncertainty,
)
from service.report.sentences import (
    asides,
    beside_what_is_stated,
    candidates_heading,
    candidates_in_order,
    found_heading,
    headline,
    meaning,
    misfits_heading,
    model_heading,
    nothing_held_out,
    place,
    seen_from,
    step_sentence,
    threshold,
)


def explanation_markdown(explanation: Explanation, model_text: str, subject: str) -> str:
    """Return the report.

    Parameters
    ----------
    explanation : Explanation
    model_text : str
        The augmented drive model, as TOML.
    subject : str
        What was compared with what, as the title says it.
    """
    sections = [
        [f"# {_text(subject)}", "", f"**{_text(headline(explanation))}**", "", meaning(explanation)],
        *[[_text(one)] for one in asides(explanation)],
        [f"## {misfits_heading(explanation.outcome)}", "", *_misfits(explanation.localisation)],
        *([[f"## {found_heading(explanation.outcome)}"]] if explanation.effects else []),
        *[_effect(one, held_out_data=not nothing_held_out(explanation)) for one in explanation.effects],
        ["## Gap", "", *_gap(explanation), "", *_steps(explanation)],
        *([["## What stays unexplained", "", *_misfits(explanation.remainder)]] if explanation.effects else []),
        [f"## {candidates_heading(explanation.outcome)}", "", *_candidates(explanation)],
        ["## Next measurement", "", _text(explanation.next_measurement) or "None is proposed."],
        ["## What was set and declared", "", *_pulls(explanation)],
        [f"## {model_heading(explanation.outcome)}", "", *_fenced(model_text)],
    ]
    return "\n\n".join("\n".join(lines) for lines in sections) + "\n"


def _misfits(misfits: Sequence[Misfit]) -> list[str]:
    if not misfits:
        return ["No place stands out from the noise."]
    rows = [[one.where, f"{rounded(one.size)} σ", str(one.kind), probability(one.p_value)] for one in misfits]
    return _table(["where", "misfit, rms", "looks like", "p-value"], rows)


def _effect(one: FoundEffect, *, held_out_data: bool) -> list[str]:
    lines = [f"### {_text(one.name)} (`{_code(one.key)}`)", "", _text(one.physics), ""]
    lines += _table(
        ["parameter", "value ± standard uncertainty", "95 % interval", "plausible"],
        [_parameter(one.key, name, found) for name, found in one.parameters.items()],
    )
    held_out = one.held_out_log_likelihood_gain
    gained = f"log-likelihood of held-out data {evidence(held_out)} better with it than without"
    lines += ["", f"Evidence: ΔBIC {evidence(one.delta_bic)}; {gained if held_out_data else 'nothing was held out'}."]
    if one.equivalent_to:
        lines += ["", f"These data cannot tell it from: {', '.join(f'`{_code(key)}`' for key in one.equivalent_to)}."]
    if not one.plausible:
        lines += ["", "**A stand-in: a value lies outside its plausible range, so the cause is something else.**"]
    return lines + [line for remark in one.remarks for line in ("", f"**Note: {_text(remark)}**")]


def _parameter(key: str, name: str, found: FoundParameter) -> list[str]:
    value, uncertainty = found.estimate.value, found.estimate.standard_uncertainty
    unit = unit_shown(found.unit)
    interval = between(*found.interval_95, notation(value, uncertainty))
    return [
        name,
        f"{with_uncertainty(value, uncertainty)}{unit}{beside_what_is_stated(key, found)}",
        f"{interval}{unit}",
        "yes" if found.plausible else "NO",
    ]


def _gap(explanation: Explanation) -> list[str]:
    gap = explanation.gap
    rows = [
        [words, quantity(pair.fit, gap.unit), quantity(pair.held_out, gap.unit), quantity(gap.noise_floor, gap.unit)]
        for words, pair in (("before", gap.before), ("after", gap.after))
    ]
    by_channel = [
        [name, quantity(before, gap.unit), quantity(after, gap.unit)]
        for name, (before, after) in explanation.gap_by_channel.items()
    ]
    channels = ["", *_table(["fitted data by channel", "before", "after"], by_channel)] if len(by_channel) > 1 else []
    return [*_table(["", "fitted data", "held-out data", "noise floor"], rows), *channels]


def _steps(explanation: Explanation) -> list[str]:
    if not explanation.steps:
        return ["Nothing was added."]
    unit = explanation.gap.unit
    return [f"{i}. {_text(step_sentence(one.effect, one.gap, unit))}" for i, one in enumerate(explanation.steps, 1)]


def _candidates(explanation: Explanation) -> list[str]:
    if not explanation.candidates:
        return ["Nothing else was thought of."]
    rows = [
        [one.key, evidence(one.delta_bic), place(one), evidence(one.held_out), seen_from(one)]
        for one in candidates_in_order(explanation.candidates)
    ]
    table = _table(["effect", "ΔBIC", "place", "held-out gain", "would be seen from"], rows)
    return [*table, "", threshold(explanation)]


def _pulls(explanation: Explanation) -> list[str]:
    if not explanation.pulls:
        return ["No error of a setting or of a declared parameter was taken into account."]
    rows = [[name, rounded(pull, 2)] for name, pull in explanation.pulls.items()]
    words = (
        "In standard deviations, of settings rms, of parameters by sign: up to 1 or 2 is as stated, far beyond is not."
    )
    return [*_table(["error of", "pull"], rows), "", words]


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [columns, ["---"] * len(columns), *[[_text(cell) for cell in row] for row in rows]]
    return [f"| {' | '.join(line)} |" for line in lines]


def _text(words: str) -> str:
    """Return words that Markdown shows as they are: names may come from a user's file.

    An underscore within a word needs no escape, and is easier to read without.
    """
    return re.sub(r"([\\`*|<>\[\]#&]|\b_|_\b)", r"\\\1", " ".join(words.split()))


def _code(words: str) -> str:
    """Return words for between backticks, where nothing else is an escape."""
    return " ".join(words.split()).replace("`", "'")


def _fenced(text: str) -> list[str]:
    fence = "`" * max([3, *(len(run) + 1 for run in re.findall(r"`+", text))])
    return [f"{fence}toml", text.rstrip("\n"), fence]
