"""Write the report as a page of Markdown: verdict, where, what, evidence, what else, and what to measure next."""

import re
from collections.abc import Sequence

from monitor_core.discrepancy import Explanation
from service.report.content import EffectContent, ReportContent, Row, report_content


def explanation_markdown(explanation: Explanation, model_text: str, subject: str) -> str:
    """Return the report, with the augmented model as TOML; its title says what was compared with what, the subject."""
    content = report_content(explanation)
    effects = content.effects
    sections = [
        [f"# {_text(subject)}", "", f"**{_text(content.headline)}**", "", content.meaning],
        *[[_text(aside)] for aside in content.asides],
        ["## Measure next", "", *([f"* {_text(step)}." for step in content.next_steps] or ["Nothing is proposed."])],
        [f"## {content.misfits_heading}", "", *_misfits(content.misfits)],
        *([[f"## {content.found_heading}"]] if effects else []),
        *[_effect(effect) for effect in effects],
        ["## Gap", "", *_gap(content), "", *_steps(content.steps)],
        *([["## What stays unexplained", "", *_misfits(content.remainder)]] if effects else []),
        [f"## {content.candidates_heading}", "", *_candidates(content)],
        ["## What was set and declared", "", *_pulls(content.pulls)],
        [f"## {content.model_heading}", "", *_fenced(model_text)],
    ]
    return "\n\n".join("\n".join(lines) for lines in sections) + "\n"


def _misfits(misfits: Sequence[Row]) -> list[str]:
    if not misfits:
        return ["No place stands out from the noise."]
    return _table(["where", "misfit, rms", "looks like", "p-value"], misfits)


def _effect(found: EffectContent) -> list[str]:
    effect = found.effect
    lines = [f"### {_text(found.name)} (`{_code(effect.key)}`)", "", _text(effect.physics), ""]
    lines += _table(["parameter", "value ± standard uncertainty", "95 % interval", "plausible"], found.parameters)
    gained = "nothing was held out"
    if found.held_out_gain is not None:
        gained = f"log-likelihood of held-out data {found.held_out_gain} better with it than without"
    lines += ["", f"Evidence: ΔBIC {found.delta_bic}; {gained}."]
    if effect.equivalent_to:
        pairs = zip(found.others, effect.equivalent_to, strict=True)
        names = ", ".join(f"{_text(name)} (`{_code(key)}`)" for name, key in pairs)
        lines += ["", f"These data cannot distinguish it from: {names}."]
    if not effect.plausible:
        lines += ["", "**A stand-in: a value lies outside its plausible range, so the cause is something else.**"]
    return lines + [line for remark in found.remarks for line in ("", f"**Note: {_text(remark)}**")]


def _gap(content: ReportContent) -> list[str]:
    lines = _table(["", "fitted data", "held-out data", "noise floor"], content.gap)
    if content.gap_by_channel:
        lines += ["", *_table(["fitted data by channel", "before", "after"], content.gap_by_channel)]
    return lines


def _steps(steps: Sequence[str]) -> list[str]:
    return [f"{number}. {_text(step)}" for number, step in enumerate(steps, 1)] or ["Nothing was added."]


def _candidates(content: ReportContent) -> list[str]:
    if not content.candidates:
        return ["Nothing else was considered."]
    table = _table(["effect", "evidence (ΔBIC)", "tried", "held-out gain", "detection limit"], content.candidates)
    return [*table, "", content.threshold]


def _pulls(pulls: Sequence[Row]) -> list[str]:
    if not pulls:
        return ["No error of a setting or of a declared parameter was taken into account."]
    words = (
        "In standard deviations; rms over the settings, with its sign for a parameter. Up to 1 or 2 the value is as "
        "stated, far beyond it is not."
    )
    return [*_table(["error of", "pull"], pulls), "", words]


def _table(columns: Sequence[str], rows: Sequence[Row]) -> list[str]:
    lines = [columns, ["---"] * len(columns), *[[_text(str(cell)) for cell in row] for row in rows]]
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
