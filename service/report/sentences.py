"""What an outcome says, in words: the verdict first, then what it means and what it does not."""

import math
from collections.abc import Iterator, Sequence
from typing import Final

from monitor_core.discrepancy.explanation import Candidate, Explanation, FoundEffect, FoundParameter, GapPair, Outcome
from monitor_core.effects import PREFIX
from service.report.rounding import evidence, quantity, rounded, unit_shown

_MEANING: Final = {
    Outcome.NAMED: (
        "Named: with what is added the model holds{judged}. It does not mean that nothing else is there: an effect "
        "below its detection limit, and one that the catalogue does not hold but that acts alike on these data, would "
        "not be noticed."
    ),
    Outcome.EQUIVALENT: (
        "Equivalent: something is missing, and these data cannot tell which of the effects listed it is. The first "
        "of them stands in the model only because one must; the data do not prefer it to the others."
    ),
    Outcome.PARTIAL: (
        "Partial: what is added holds{judged}, but does not close the gap. Nothing in the catalogue explains the "
        "remainder, and the values found may have taken up part of it."
    ),
    Outcome.NONE: (
        "None: the model, adjusted within its tolerances, agrees with the measurement to its noise. It does not mean "
        "that the axis has no other effect: whatever is smaller than its detection limit below could still hide, and "
        "so could what these data cannot test."
    ),
    Outcome.UNKNOWN: (
        "Unknown: model and measurement disagree by more than noise, and no effect of the catalogue, alone or with "
        "others, explains that to the noise floor. The cause may lie outside of the catalogue, in the measurement, or "
        "in the description of the axis."
    ),
}


_HELD = " on data that were not used to choose it"
_NOT_HELD = " on the data it was chosen by"
_TO_THE_TEST = "None could be held out; of five positions or more, two would be."
_HARDLY_LESS = 0.95  # of a gap
_TIMES = 1.5  # from this ratio on people say "times"
#: Standard deviations: any of a dozen right parameters is moved farther than the first in one report of seven.
_MOVED, _STRAINED, _FAR = 2.5, 3.0, 5.0


def headline(explanation: Explanation) -> str:
    """Return the verdict in one sentence."""
    names = listed([effect_named(one) for one in explanation.effects])
    several = len(explanation.effects) > 1
    gap = _gap_sentence(explanation)
    match explanation.outcome:
        case Outcome.NAMED:
            return f"The model lacks {names}: with {'them' if several else 'it'} {gap}."
        case Outcome.EQUIVALENT:
            first = "the first of each" if several else "the first of them"
            return f"The model lacks {names}, and these data cannot tell which: with {first} {gap}."
        case Outcome.PARTIAL:
            return f"The model lacks {names}, and more that nothing in the catalogue explains: {gap}."
        case Outcome.NONE:
            moved = listed(list(_moved(explanation)))
            once = f", once {moved} {'is' if len(_moved(explanation)) == 1 else 'are'} as refitted" if moved else ""
            return f"Nothing is missing that these data would show{once}: {_none_sentence(explanation)}."
        case Outcome.UNKNOWN:
            return f"Something is missing that nothing in the catalogue explains: {_unknown_sentence(explanation)}."


def meaning(explanation: Explanation) -> str:
    """Say what the outcome means, and what it does not."""
    words = _MEANING[explanation.outcome]
    if "{judged}" not in words or not nothing_held_out(explanation):
        return words.format(judged=_HELD)
    return f"{words.format(judged=_NOT_HELD)} {_TO_THE_TEST}"


def asides(explanation: Explanation) -> tuple[str, ...]:
    """Return what goes with the verdict: what was settled first, what helps unnamed, and what was pulled far."""
    return (
        *explanation.taken_as,
        *_hidden_in_remainder(explanation),
        *_pulled(explanation),
        *_strained_before(explanation),
    )


def _hidden_in_remainder(explanation: Explanation) -> Iterator[str]:
    hidden = explanation.hidden_in_remainder
    if hidden:
        verb, they, are = ("helps", "it", "is") if len(hidden) == 1 else ("help", "they", "are")
        yield (
            f"{listed(hidden)} {verb}, too, but by little beside what is left: whatever is missing may look like that, "
            f"so {they} {are} neither named nor in the model."
        )


def _pulled(explanation: Explanation) -> Iterator[str]:
    """Say which declared parameters were moved beyond what is usual, to what, and what it may mean."""
    moved = _moved(explanation)
    if moved:
        each = [
            f"{name} at {rounded(math.exp(explanation.ln_ratios[name]), 3)} times what is stated "
            f"({rounded(pull, 2)} standard deviations)"
            for name, pull in moved.items()
        ]
        yield (
            f"The fit has {listed(each)}. That may be a finding of its own, or the statement is wrong, or it makes "
            "up for a parameter that is taken as exact, or for physics that is missing."
        )


def _moved(explanation: Explanation) -> dict[str, float]:
    """Return the pulls of the declared parameters that the fit has moved beyond what is usual."""
    pulls = {name: explanation.pulls.get(name, 0.0) for name in explanation.pulls_before}
    return {name: pull for name, pull in pulls.items() if abs(pull) > _MOVED}


def _strained_before(explanation: Explanation) -> Iterator[str]:
    """Say that the gap before is of a model that was bent to the data."""
    strained = _eased(explanation, _FAR)
    if strained:
        each = [f"{name} {rounded(abs(pull), 2)}" for name, pull in strained.items()]
        yield (
            f"The gap before is that of a model bent to the data, in standard deviations of its parameters: "
            f"{listed(each)}."
        )


def beside_what_is_stated(key: str, found: FoundParameter) -> str:
    """Say of a wrong parameter between what it lies for people who do not read logarithms; of others nothing."""
    if not key.startswith(PREFIX):
        return ""
    low, high = (math.exp(end) for end in found.interval_95)
    if low > 1.0 / _TIMES and high < _TIMES:
        low, high = 100.0 * (low - 1.0), 100.0 * (high - 1.0)
        return f" ({rounded(low, 2)} to {rounded(high, 2)} % beside what is stated)"
    return f" ({rounded(low, 2)} to {rounded(high, 2)} times what is stated)"


def effect_named(one: FoundEffect) -> str:
    """Return the name of an effect with one the data cannot tell from it, and a word where it is not believed."""
    others = f" or {len(one.equivalent_to) - 1} more" if len(one.equivalent_to) > 1 else ""
    name = " or ".join([f"“{one.name}”", *one.equivalent_to[:1]]) + others
    return name if one.plausible else f"{name} (a stand-in: its value is not plausible)"


def listed(parts: Sequence[str]) -> str:
    """Join as a sentence does; nothing is an empty text."""
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def found_heading(outcome: Outcome) -> str:
    """Return the heading over the effects: where the cause is unknown they are not it."""
    return "What helped most, and is not named as the cause" if outcome is Outcome.UNKNOWN else "What was found"


def misfits_heading(outcome: Outcome) -> str:
    """Return the heading over the places of misfit: where nothing is missing they are patterns within the noise."""
    return "Patterns within the noise" if outcome is Outcome.NONE else "Where model and measurement part"


def model_heading(outcome: Outcome) -> str:
    """Return the heading over the model: where the cause is unknown, what helped most is not in it."""
    if outcome is Outcome.UNKNOWN:
        return "The model, as it was: what helped most is not in it"
    return "The model, as refitted" if outcome is Outcome.NONE else "The model, with what was added"


def judged_gap(pair: GapPair) -> float:
    """Return the gap that counts: on data held out where there are any."""
    return pair.fit if math.isnan(pair.held_out) else pair.held_out


def nothing_held_out(explanation: Explanation) -> bool:
    """Tell whether the data allowed none to be held out."""
    return math.isnan(explanation.gap.after.held_out)


def judged_on(explanation: Explanation) -> str:
    """Say which data the gaps of the verdict are of."""
    if nothing_held_out(explanation):
        return "on the data that were fitted, since none could be held out"
    return "on data that were not fitted"


def step_sentence(effect: str, gap: GapPair, unit: str) -> str:
    """Say what an effect left."""
    return f"with {effect}: {quantity(gap.fit, unit)} fitted, {held_out(gap, unit)}"


def held_out(gap: GapPair, unit: str) -> str:
    """Say the gap on data held out, or that there were none."""
    return "nothing held out" if math.isnan(gap.held_out) else f"{quantity(gap.held_out, unit)} held out"


def candidates_heading(outcome: Outcome) -> str:
    """Return the heading over what else was thought of: where nothing was found, it is what could still hide."""
    return "What could still hide" if outcome is Outcome.NONE else "What else was thought of"


def candidates_in_order(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return those that were tested first, the best supported before the others."""
    return sorted(
        candidates,
        key=lambda one: (one.untestable_because is not None, math.isnan(one.delta_bic), -one.delta_bic),
    )


def seen_from(one: Candidate) -> str:
    """Say from what size on an effect would be seen, or why it cannot be."""
    if one.untestable_because is not None:
        return f"untestable: {one.untestable_because}"
    return detection_limit(one)[1]


def place(one: Candidate) -> str:
    """Say whether the evidence is for an effect instead of something that was found, or in addition to it."""
    if one.untestable_because is not None:
        return "—"
    return "in addition" if one.in_place_of is None else f"instead of {one.in_place_of}"


def detection_limit(one: Candidate) -> tuple[float, str]:
    """Return from what size on an effect would be seen, as a number and in words.

    Of a wrong parameter that is a ratio, or the share by which it is above what is stated where the ratio is near one.
    """
    if one.detection_limit is None:
        return math.nan, "not known"
    if one.key.startswith(PREFIX):  # known by its logarithm
        ratio = math.exp(one.detection_limit)
        if ratio < _TIMES:
            more, less = 100.0 * (ratio - 1.0), 100.0 * (1.0 - 1.0 / ratio)
            return more, f"{rounded(more, 2)} % more or {rounded(less, 2)} % less than stated"
        return ratio, f"{rounded(ratio, 2)} times what is stated, or as many times less"
    return one.detection_limit, quantity(one.detection_limit, one.unit, 2)


def threshold(explanation: Explanation) -> str:
    """Say how much evidence one more effect needs."""
    return f"One more effect would need a ΔBIC of {evidence(explanation.least_delta_bic)}."


def _gap_sentence(explanation: Explanation) -> str:
    gap, unit = explanation.gap, unit_shown(explanation.gap.unit)
    before, after = judged_gap(gap.before), judged_gap(gap.after)
    if after > _HARDLY_LESS * before and (strained := _would_have_to_be(explanation)):
        return (
            f"the gap stays at {rounded(after)}{unit}, {judged_on(explanation)} (noise floor "
            f"{rounded(gap.noise_floor)}{unit}), but without, {strained}"
        )
    verb = "falls" if after < before else "does not fall"
    return (
        f"the gap {verb}, from {rounded(before)} to {rounded(after)}{unit}, {judged_on(explanation)} "
        f"(noise floor {rounded(gap.noise_floor)}{unit})"
    )


def _would_have_to_be(explanation: Explanation) -> str:
    """Say which declared parameter would have to be far off in the place of what was found; empty if none."""
    eased = _eased(explanation, _STRAINED)
    if not eased:
        return ""
    name = max(eased, key=lambda one: abs(eased[one]))
    return f"{name} would have to be {rounded(abs(eased[name]), 2)} standard deviations from what is stated"


def _eased(explanation: Explanation, beyond: float) -> dict[str, float]:
    """Return the pulls before, beyond so much, of the declared parameters that what was found has eased."""
    return {
        name: pull
        for name, pull in explanation.pulls_before.items()
        if abs(pull) > beyond and abs(explanation.pulls.get(name, 0.0)) < 0.5 * abs(pull)
    }


def _none_sentence(explanation: Explanation) -> str:
    gap, unit = explanation.gap, unit_shown(explanation.gap.unit)
    return (
        f"the gap is {rounded(judged_gap(gap.before))}{unit} {judged_on(explanation)}, at a noise floor of "
        f"{rounded(gap.noise_floor)}{unit}"
    )


def _unknown_sentence(explanation: Explanation) -> str:
    if not explanation.effects:
        return _none_sentence(explanation)
    best = listed([effect_named(one) for one in explanation.effects])
    return f"with {best}, the best that was found, {_gap_sentence(explanation)}"
