"""State the verdict in sentences: the headline, what the outcome means, and what goes with it."""

import math
from collections.abc import Iterator, Sequence
from typing import Final

from monitor_core.discrepancy import (
    STRAINED,
    VERY_STRONG,
    Described,
    Explanation,
    FoundEffect,
    GapPair,
    Outcome,
    RecordFault,
    WrongRecord,
)
from monitor_core.effects import PREFIX, Form, Law, Variable
from service.documents.explanation_sentences import (
    NAMES,
    against_screw_sentence,
    alternative_sentence,
    assumption_sentences,
    name_of,
    parameter_words,
    texts,
    unfinished_sentence,
)
from service.report.rounding import bound, compared_with_stated, rounded, unit_shown, with_uncertainty

_HELD = " on data that were not used to choose it"
_NOT_HELD = " on the data it was chosen by"
_WHEN_HELD_OUT = "None could be held out; of five positions or more, two would be."
_HARDLY_LESS = 0.95  # of a gap
#: Standard deviations: any of a dozen right parameters is moved farther than the first in one report of seven.
_MOVED, _STRAINED, _FAR = 2.5, 3.0, 5.0
#: Tolerances: the square root of the variance of pulls that is no chance (PULLS of the verdict).
_SCATTERED = 1.73


def headline(explanation: Explanation) -> str:  # noqa: PLR0911 a sentence for each outcome
    """Return the verdict in one sentence."""
    if explanation.against_screw is not None:
        return against_screw_sentence(explanation.against_screw)
    names = listed([_named(effect) for effect in explanation.effects])
    several = len(explanation.effects) > 1
    match explanation.outcome:
        case Outcome.NAMED:
            return f"{_missing(explanation)}: with {'them' if several else 'it'} {_gap_sentence(explanation)}."
        case Outcome.EQUIVALENT:
            representatives = "the first of each" if several else "the first of them"
            gap = _gap_sentence(explanation)
            return f"{_missing(explanation)}, and these data cannot tell which: with {representatives} {gap}."
        case Outcome.PARTIAL | Outcome.UNKNOWN if explanation.unfinished:
            so_far = "nothing has been found so far: " + _gap_as_it_is(explanation)
            if explanation.effects:
                so_far = f"what helps most so far is {names}: {_gap_sentence(explanation)}"
            return f"Time was up; {so_far}."
        case Outcome.PARTIAL:
            gap = _gap_sentence(explanation)
            more = f"{_missing(explanation)}, and there is more that nothing in the catalogue explains: {gap}."
            return more + _without_form(explanation)
        case Outcome.NONE:
            moved = [parameter_words(name) for name in _moved(explanation)]
            once = f", once {listed(moved)} {'is' if len(moved) == 1 else 'are'} as refitted" if moved else ""
            return f"Nothing is missing that these data would show{once}: {_gap_as_it_is(explanation)}."
        case Outcome.DESCRIBED:
            return _described(explanation, names)
        case Outcome.UNKNOWN:
            gap = _gap_as_it_is(explanation)
            if explanation.effects:
                gap = f"with {names}, the best that was found, {_gap_sentence(explanation)}"
            elif beyond := {name: pull for name, pull in _moved(explanation).items() if abs(pull) > STRAINED}:
                each = [f"{parameter_words(name)} by {rounded(abs(pull), 2)}" for name, pull in beyond.items()]
                gap = f"the fit moves {listed(each)} of its tolerances, and then {gap}"
            return f"Something is missing that nothing in the catalogue explains: {gap}.{_without_form(explanation)}"


def _without_form(explanation: Explanation) -> str:
    """Say what is there that no law describes."""
    sentence = listed([described_sentence(described) for described in explanation.described])
    return f" {sentence[0].upper()}{sentence[1:]}." if sentence else ""


def _described(explanation: Explanation, names: str) -> str:
    sentence = listed([described_sentence(described) for described in explanation.described])
    besides = f"The model lacks {names}, and besides:" if explanation.effects else "No name fits, but this holds:"
    return f"{besides} {sentence}; with it {_gap_sentence(explanation)}."


def meaning(explanation: Explanation) -> str:
    """Say what the outcome means, and what it does not."""
    if explanation.against_screw is not None:
        return texts("meaning")["against_screw"]
    if explanation.unfinished:
        return texts("meaning")["unfinished"]
    words = texts("meaning")[explanation.outcome]
    if "{judged}" not in words or not nothing_held_out(explanation):
        return words.format(judged=_HELD)
    return f"{words.format(judged=_NOT_HELD)} {_WHEN_HELD_OUT}"


def asides(explanation: Explanation) -> tuple[str, ...]:
    """Return what goes with the verdict: assumptions, effects that help but are not named, parameters pulled far."""
    return (
        *([unfinished_sentence(explanation.unfinished, NAMES)] if explanation.unfinished else []),
        *_record_sentences(explanation),
        *assumption_sentences(explanation),
        *_nearest(explanation),
        *_scattered(explanation),
        *_pulled(explanation),
        *_strained_before(explanation),
    )


def nothing_held_out(explanation: Explanation) -> bool:
    """Return whether the data allowed none to be held out."""
    return math.isnan(explanation.gap.after.held_out)


def listed(parts: Sequence[str]) -> str:
    """Join parts as a sentence does; nothing gives an empty text."""
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def _missing(explanation: Explanation) -> str:
    """Say what is missing, and which parameters are other than stated."""
    wrong = [effect for effect in explanation.effects if _is_wrong(effect) and not effect.equivalent_to]
    lacking = listed([_named(effect) for effect in explanation.effects if effect not in wrong])
    stated = listed([f"the {_of_parameter(effect, ' is ')}" for effect in wrong])
    parts = ([f"The model lacks {lacking}"] if lacking else []) + ([stated] if stated else [])
    sentence = ", and ".join(parts)
    return sentence[:1].upper() + sentence[1:]


def _is_wrong(effect: FoundEffect) -> bool:
    return effect.key.startswith(PREFIX)


def _of_parameter(effect: FoundEffect, verb: str) -> str:
    """Say how far a parameter is from what is stated."""
    (size,) = effect.parameters.values()
    ratio = bound(*size.interval_95, compared_with_stated) or compared_with_stated(size.estimate.value)
    words = f"{parameter_words(effect.key.removeprefix(PREFIX))}{verb}{ratio}"
    return words if effect.plausible else f"{words} (a stand-in: that is not plausible)"


def _named(effect: FoundEffect) -> str:
    """Return the name of an effect with one that the data cannot distinguish, and a note if it is not plausible."""
    own = f"“{_of_parameter(effect, ' ')}”" if _is_wrong(effect) else f"“{effect.name}”"
    others = f" or {len(effect.equivalent_to) - 1} more" if len(effect.equivalent_to) > 1 else ""
    name = " or ".join([own, *(f"“{name_of(key)}”" for key in effect.equivalent_to[:1])]) + others
    return name if effect.plausible or _is_wrong(effect) else f"{name} (a stand-in: its value is not plausible)"


def _nearest(explanation: Explanation) -> Iterator[str]:
    """Say what comes nearest to a finding where nothing was found, and how much speaks for it."""
    best = next(iter(explanation.candidates), None)
    if explanation.outcome is Outcome.NONE and best is not None and best.delta_bic > VERY_STRONG:
        evidence, least = rounded(best.delta_bic, 2), rounded(explanation.least_delta_bic, 2)
        yield f"“{name_of(best.key)}” comes nearest to a finding, with a ΔBIC of {evidence} where {least} is asked."


def _scattered(explanation: Explanation) -> Iterator[str]:
    """Say which settings scatter more about what is stated of them than their tolerance allows."""
    for name, spread in explanation.pulls.items():
        if name not in explanation.pulls_before and not name.startswith("gain") and spread > _SCATTERED:
            yield (
                f"What is stated as {parameter_words(name)} scatters by {rounded(spread, 2)} times its tolerance: "
                "check the settings, or state the tolerance."
            )


def _pulled(explanation: Explanation) -> Iterator[str]:
    """Say which declared parameters were moved beyond what is usual, to what, and what it may mean."""
    moved = _moved(explanation)
    if moved:
        each = [
            f"{parameter_words(name)} {compared_with_stated(explanation.ln_ratios[name])} "
            f"({rounded(abs(pull), 2)} standard deviations)"
            for name, pull in moved.items()
        ]
        yield (
            f"The fit has {listed(each)}. That may be a finding of its own, or the stated value is wrong, or it makes "
            "up for a parameter that is taken as exact, or for missing physics."
        )


def _moved(explanation: Explanation) -> dict[str, float]:
    """Return the pulls of the declared parameters that the fit has moved beyond what is usual."""
    pulls = {name: explanation.pulls.get(name, 0.0) for name in explanation.pulls_before}
    return {name: pull for name, pull in pulls.items() if abs(pull) > _MOVED}


def _strained_before(explanation: Explanation) -> Iterator[str]:
    """Say that the model before had to move its parameters far to come near the data."""
    strained = _eased(explanation, _FAR)
    if strained:
        each = [f"{parameter_words(name)} {rounded(abs(pull), 2)}" for name, pull in strained.items()]
        yield (
            "The gap before is that of a model whose parameters were moved far to fit the data, in standard "
            f"deviations: {listed(each)}."
        )


def _gap_sentence(explanation: Explanation) -> str:
    gap, unit = explanation.gap, unit_shown(explanation.gap.unit)
    gap_before, gap_after, judged_on = _judged(gap.before), _judged(gap.after), _judged_on(explanation)
    floor = f"(noise floor {rounded(gap.noise_floor)}{unit})"
    eased = _eased(explanation, _STRAINED)
    if gap_after > _HARDLY_LESS * gap_before and eased:
        name = max(eased, key=lambda parameter: abs(eased[parameter]))
        words = parameter_words(name)
        return (
            f"the gap stays at {rounded(gap_after)}{unit}, {judged_on} {floor}, but without, the {words} would have to "
            f"be {rounded(abs(eased[name]), 2)} standard deviations from what is stated"
        )
    verb = "falls" if gap_after < gap_before else "does not fall"
    return f"the gap {verb}, from {rounded(gap_before)} to {rounded(gap_after)}{unit}, {judged_on} {floor}"


def _gap_as_it_is(explanation: Explanation) -> str:
    gap, unit = explanation.gap, unit_shown(explanation.gap.unit)
    return (
        f"the gap is {rounded(_judged(gap.before))}{unit} {_judged_on(explanation)}, at a noise floor of "
        f"{rounded(gap.noise_floor)}{unit}"
    )


def _judged(pair: GapPair) -> float:
    """Return the gap that counts: on data held out where there are any."""
    return pair.fit if math.isnan(pair.held_out) else pair.held_out


def _judged_on(explanation: Explanation) -> str:
    """Say which data the gaps of the verdict are of."""
    if nothing_held_out(explanation):
        return "on the data that were fitted, since none could be held out"
    return "on data that were not fitted"


def _eased(explanation: Explanation, beyond: float) -> dict[str, float]:
    """Return the pulls before, beyond so much, of the declared parameters that what was found has eased."""
    return {
        name: pull
        for name, pull in explanation.pulls_before.items()
        if abs(pull) > beyond and abs(explanation.pulls.get(name, 0.0)) < 0.5 * abs(pull)
    }


# --- records that are wrong

#: What is wrong, and what more and less of it is called.
_TAGS: Final = {
    RecordFault.POSITION: ("its position is", "further than", "short of what is"),
    RecordFault.PRELOAD: ("its preload is", "higher than", "lower than"),
    RecordFault.PAYLOAD: ("its payload is", "more than", "less than"),
    RecordFault.TEMPERATURE: ("it is", "warmer than", "colder than"),
}


def _record_sentences(explanation: Explanation) -> Iterator[str]:
    """Yield a sentence for each record that does not go with the others."""
    for record in explanation.records:
        yield (
            f"Record {record.number} ({record.setting}) is wrong: {_fault(record)} (ΔBIC {rounded(record.delta_bic)}). "
            "It was taken out, and what is said here rests on the others."
        )


def _fault(record: WrongRecord) -> str:
    if record.fault is RecordFault.OUTLIER:
        return (
            f"it is {rounded(record.misfit, 2)} standard deviations from what the others say, and no tag and no gain "
            "explains that"
        )
    if record.fault is RecordFault.GAIN:
        return f"its gain is {with_uncertainty(record.found, record.standard_uncertainty)} times what it should be"
    what, more, less = _TAGS[record.fault]
    change = record.found - record.stated
    size = with_uncertainty(abs(change), record.standard_uncertainty)
    return f"{what} {size} {record.unit} {more if change > 0.0 else less} stated"


# --- what was described

_VARIABLES: Final = {
    Variable.EXCITATION: ("the excitation", 1.0, ""),
    Variable.POSITION: ("the position", 1e3, " mm"),
    Variable.PRELOAD: ("the preload", 1.0, " N"),
    Variable.PAYLOAD: ("the payload", 1.0, " kg"),
    Variable.TEMPERATURE: ("the temperature", 1.0, " K"),
    Variable.ORDER: ("the order of measurement", 1.0, ""),
    Variable.NOTHING: ("nothing", 1.0, ""),
}


def described_sentence(described: Described) -> str:
    """Return what varies where, with what and by which law; or what swings there; or that no law says how."""
    others = " or ".join(alternative_sentence(other, NAMES) for other in described.alternatives)
    or_else = f" (or {others}, which these data do not distinguish)" if others else ""
    parameter = parameter_words(described.parameter)
    if described.has_no_form:
        least, most = (rounded(end(described.factors.values()), 3) for end in (min, max))
        return (
            f"{parameter} at the {described.place}{or_else} would have to be another one at each setting, {least} to "
            f"{most} times what it is, by no law that was tried"
        )
    swings = _swings(described) or _bends(described)
    if described.law is None:
        return f"{swings}{or_else}, the same at every setting"
    with_what, factor, unit = _VARIABLES[described.law.variable]
    what = f"{swings}; its {parameter}" if swings else f"{parameter} at the {described.place}"
    if described.law.variable is Variable.NOTHING:
        return f"{what}{or_else} is another one than stated, by {_law(described, described.law, factor, unit)} alike"
    return (
        f"{what} varies with {with_what}{or_else}, as {_law(described, described.law, factor, unit)}{_ends(described)}"
    )


def _ends(described: Described) -> str:
    """Say which coefficients stand at an end of the range that is searched: the form may be another; else nothing."""
    ends = " and ".join(name.replace("_", " ") for name, value in described.parameters.items() if value.at_end)
    return f"; its {ends} would go beyond what is searched, so that the form is only the nearest tried" if ends else ""


def _swings(described: Described) -> str:
    """Return what swings there on a spring; empty where nothing does."""
    size, unit = (described.mass_kg, "kg") if described.inertia_kg_m2 is None else (described.inertia_kg_m2, "kg·m²")
    if described.frequency_hz is None or size is None:
        return ""
    return (
        f"something of {rounded(size, 3)} {unit} on a spring, {rounded(described.frequency_hz, 4)} Hz, hangs on the "
        + (described.place)
    )


def _bends(described: Described) -> str:
    """Return how the screw bends; empty where it does not."""
    if described.place != "screw" or described.frequency_hz is None:
        return ""
    size = described.parameters.get("compliance_m_per_n")
    yields = "" if size is None else f", by up to {rounded(1e9 * size.estimate.value, 3)} nm/N along it"
    return f"the screw bends under the force in the nut{yields}, first at {rounded(described.frequency_hz, 4)} Hz"


def _law(described: Described, law: Law, factor: float, unit: str) -> str:
    values = described.parameters
    reference, scale = f"{rounded(factor * law.reference, 3)}{unit}", f"{rounded(factor * law.scale, 3)}{unit}"

    def shown(name: str) -> str:
        value, (low, high) = values[name].estimate.value, values[name].interval_95
        at_bound = bound(low, high, lambda end: rounded(end, 2))
        return f"({at_bound or f'{rounded(value, 2)}; 95 %: {rounded(low, 2)} to {rounded(high, 2)}'})"

    u, low, high = f"u = (x − {reference})/{scale}", law.reference - law.scale, law.reference + law.scale
    shown_of = {name: shown(name) for name in values}
    if law.form is Form.LEVELS:
        levels = zip(shown_of.values(), law.knots, strict=True)
        return "; ".join(f"1 + {words} at {rounded(factor * level, 4)}{unit}" for words, level in levels)
    step = f"{rounded(factor * low, 4)} and {rounded(factor * high, 4)}{unit}"
    return _FORMS[law.form].format(**shown_of, u=u, step=step, reference=reference, scale=scale)


_FORMS: Final = {
    Form.CONSTANT: "1 + {change} at every setting",
    Form.LINEAR: "1 + {change} u with {u}",
    Form.QUADRATIC: "1 + {change} u + {curvature} u² with {u}",
    Form.PERIODIC: "1 + {cosine} cos φ + {sine} sin φ with φ = 2πx/{scale}",
    Form.YIELDING: "1/(1 + c + {cosine} cos φ + {sine} sin φ) with φ = 2πx/{scale}, and c so that it is as stated at "
    "one angle",
    Form.POWER: "the power {exponent} of x/{reference}",
    Form.SATURATING: "1 + {change} x/(x + h) with h = {half_at} × {scale}",
    Form.CLIPPED: "that of a signal that is clipped at {scale}/c with c = {scale_over_limit}",
    Form.STEP: "1 + {change} beyond a step between {step}",
    Form.DIP: "1 + {change} exp(−u²/2) with {u}",
}
