"""Recommend what to measure or check next, in the sizes of the machine: its screw, its mass, its preload, its band.

A step distinguishes effects that look alike, shows those that could not be seen, confirms what was described, or
locates what nothing explains.
"""

import math
from collections.abc import Iterator, Sequence, Set
from itertools import pairwise

import numpy as np

from monitor_core.discrepancy.explanation import Described, NextStep, Outcome, StepEffect, StepKind
from monitor_core.discrepancy.localisation import narrow
from monitor_core.discrepancy.search.workspace import Found
from monitor_core.discrepancy.verdict.classes import AMPLITUDE_LAW, TIME_LAW, EquivalenceClass, Member
from monitor_core.effects import Form, Law, Variable
from monitor_core.effects.effect import ConditionAxis, Effect, Physics
from monitor_core.effects.sizes import MachineSizes, Reference
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.comparison import ChangedConditions, Layout
from monitor_core.fitting.conditions.groups import Extent, groupings, has_lines, levels_of
from monitor_core.fitting.conditions.settings import WARMER, is_testable, known_mass, varied_conditions
from monitor_core.fitting.solver.hypothesis_fit import Fitted

#: With fewer positions many effects differ by a level alone.
_ENOUGH_POSITIONS = 5
#: A measurement that separates two effects by less is not worth it. [standard deviations]
_WORTH_MEASURING = 3.0
#: Of the first natural frequency: the band in which a drive shows its masses, its joints and one more mode. [-]
_BAND_OF_RESPONSES = (0.1, 5.0)


def next_steps(
    found: Found[Physics],
    classes: Sequence[EquivalenceClass[Physics]],
    outcome: Outcome,
    candidates: Sequence[Effect[Physics]],
    sizes: MachineSizes | None = None,
    *,
    described: Sequence[Described] = (),
) -> tuple[NextStep, ...]:
    """Return what to vary or check next; nothing where nothing is open.

    Of an outcome that leaves something open, *unknown*, *partial*, *equivalent* or *described*, there is something. The
    ``sizes`` of the machine give masses, lengths, preloads and bands; without them only those of the settings are
    known.
    """
    layout = found.final.comparison.layout
    steps = [step for group in classes for step in _to_distinguish(group, sizes)]
    steps += [step for description in described for step in _to_confirm(description, layout)]
    if outcome in (Outcome.UNKNOWN, Outcome.PARTIAL):
        steps += steps_to_locate(found.final, sizes)
    if outcome is not Outcome.NAMED:
        lines = has_lines(layout)  # of natural frequencies it is said above what distinguishes what is not tested
        untested = {key for group in classes for key in group.untested if lines}
        reported = {key for group in classes for key in group.keys} - untested
        unseen = [effect for effect in candidates if effect.key not in reported]
        levels_advised = any(AMPLITUDE_LAW in group.other_laws for group in classes)
        steps += _to_see_more(layout, unseen, sizes, {ConditionAxis.LEVEL} if levels_advised else set())
    return tuple(steps)


# --- what distinguishes effects that look alike


def separations(fitted: Fitted[Physics], other: Fitted[Physics]) -> dict[ChangedConditions, float]:
    """Return by how much two fits would differ if all settings were measured again under other conditions.

    In standard deviations, by the change of the conditions; without those under which one of them has no answer.
    """
    physics, of_other = fitted.physics(), other.physics()
    distances = {}
    for change, imagined in fitted.comparison.imagined(physics).items():
        try:
            misfits = imagined.misfit(physics), imagined.misfit(of_other)
        except OutsideValidityError:
            continue
        difference = fitted.comparison.layout.difference(*misfits)
        distances[change] = float(np.linalg.norm(fitted.around.whitened_by(difference)))
    return distances


def _to_distinguish(group: EquivalenceClass[Physics], sizes: MachineSizes | None) -> Iterator[NextStep]:
    """Yield the change that distinguishes most members from the representative, and the members that none does."""
    representative, *others = group.members
    named = StepEffect(representative.effect.key)
    layout = representative.fitted.comparison.layout
    distances = {other.effect.key: separations(representative.fitted, other.fitted) for other in others}
    changes = dict.fromkeys(change for of_other in distances.values() for change in of_other)

    def separated_by(change: ChangedConditions) -> dict[str, float]:
        return {key: of[change] for key, of in distances.items() if of.get(change, 0.0) >= _WORTH_MEASURING}

    def worth(change: ChangedConditions) -> tuple[int, float]:
        return len(separated_by(change)), sum(separated_by(change).values())

    best = max(changes, key=worth, default=None)
    if best is not None and (separated := separated_by(best)):
        effects = (named, *(StepEffect(key, distance, "sigma") for key, distance in separated.items()))
        amount = {_CHANGED_BY[best.axis]: best.amount}
        yield NextStep(StepKind.OTHER_CONDITIONS, best.axis, effects=effects, values=amount)
    inseparable = [
        other for other in others if max(distances[other.effect.key].values(), default=0.0) < _WORTH_MEASURING
    ]
    if inseparable:
        parts = tuple(map(_size_of, (representative, *inseparable)))
        yield NextStep(StepKind.LOOK_AT_PARTS, settings=(layout.settings[0].name,), effects=parts)
    if group.untested and not has_lines(layout):
        effects = (named, *map(StepEffect, group.untested))
        yield NextStep(StepKind.RESPONSES_TO_DISTINGUISH, ConditionAxis.FREQUENCY, effects=effects, values=_band(sizes))
    if TIME_LAW in group.other_laws:
        yield NextStep(StepKind.REPEAT_IN_RANDOM_ORDER, effects=(named, StepEffect(TIME_LAW)))
    if AMPLITUDE_LAW in group.other_laws:
        yield NextStep(StepKind.THREE_LEVELS, ConditionAxis.LEVEL, effects=(named, StepEffect(AMPLITUDE_LAW)))


#: What a change of the conditions is a change by.
_CHANGED_BY = {
    ConditionAxis.PAYLOAD: "mass_kg",
    ConditionAxis.TEMPERATURE: "warming_k",
    ConditionAxis.LEVEL: "ratio_of_levels",
    ConditionAxis.POSITION: "share_of_the_way",
}


def _size_of(member: Member[Physics]) -> StepEffect:
    """Return what a member would be, by its first parameter."""
    effect, parameter = member.effect, member.effect.parameters[0]
    value = member.fitted.hypothesis.values(member.fitted.coordinates)[effect.key][parameter.name]
    return StepEffect(effect.key, value, parameter.unit)


# --- what shows effects that could not be seen


def _to_see_more(
    layout: Layout, candidates: Sequence[Effect[Physics]], sizes: MachineSizes | None, advised: Set[ConditionAxis]
) -> Iterator[NextStep]:
    """Yield what has to vary for the other candidates to be seen, but for what is advised already."""
    varied = varied_conditions(layout)
    stated = {axis for setting in layout.settings for axis in setting.values}
    positions = {
        setting.values[ConditionAxis.POSITION] for setting in layout.settings if ConditionAxis.POSITION in stated
    }
    if positions and len(positions) < _ENOUGH_POSITIONS:
        length = _known(screw_length_m=_size(sizes, Reference.LENGTH))
        yield NextStep(
            StepKind.MORE_POSITIONS, ConditionAxis.POSITION, values={"n_positions": _ENOUGH_POSITIONS, **length}
        )
    if ConditionAxis.PAYLOAD in stated - varied:
        mass = _size(sizes, Reference.MOVING_MASS)
        known = _known(mass_kg=None if mass is None else known_mass(mass))
        yield NextStep(StepKind.KNOWN_MASS, ConditionAxis.PAYLOAD, values=known)
    waiting: dict[ConditionAxis, list[str]] = {}
    for effect in candidates:
        for axis in () if is_testable(effect, layout) else sorted(effect.needs - varied - advised):
            waiting.setdefault(axis, []).append(effect.key)
    for axis, keys in waiting.items():
        if axis is not ConditionAxis.PAYLOAD:
            effects = tuple(map(StepEffect, dict.fromkeys(keys)))
            yield NextStep(StepKind.VARY, axis, effects=effects, values=_by_how_much(axis, sizes))


def _by_how_much(axis: ConditionAxis, sizes: MachineSizes | None) -> dict[str, float]:
    preload, speed = _size(sizes, Reference.PRELOAD), _size(sizes, Reference.VELOCITY)
    match axis:
        case ConditionAxis.FREQUENCY:
            return _band(sizes)
        case ConditionAxis.TEMPERATURE:
            return {"warming_k": WARMER}
        case ConditionAxis.PRELOAD if preload is not None:
            return {"lowest_n": 0.5 * preload, "highest_n": preload}
        case ConditionAxis.RECORD if speed is not None:
            return {"speed_m_per_s": 0.5 * speed}
    return {}


def _size(sizes: MachineSizes | None, reference: Reference) -> float | None:
    """Return a size of the machine, None where it is not known."""
    return None if sizes is None else sizes.values.get(reference)


def _known(**values: float | None) -> dict[str, float]:
    """Return those of some values that are known."""
    return {name: value for name, value in values.items() if value is not None}


def _band(sizes: MachineSizes | None) -> dict[str, float]:
    frequency = _size(sizes, Reference.FREQUENCY)
    if frequency is None:
        return {}
    lowest, highest = (share * frequency for share in _BAND_OF_RESPONSES)
    return {"lowest_hz": lowest, "highest_hz": highest}


# --- what confirms what was described, or shows its form

#: What a law may follow that is set.
_SET = {
    Variable.POSITION: ConditionAxis.POSITION,
    Variable.PRELOAD: ConditionAxis.PRELOAD,
    Variable.PAYLOAD: ConditionAxis.PAYLOAD,
    Variable.TEMPERATURE: ConditionAxis.TEMPERATURE,
    Variable.EXCITATION: ConditionAxis.LEVEL,
}
#: About a resonance, what shows it whole. [of its frequency]
_ABOUT = (0.8, 1.2)


def _to_confirm(described: Described, layout: Layout) -> Iterator[NextStep]:
    """Yield what to measure next of one thing that was described."""
    if described.has_no_form:
        ranked = sorted(described.factors, key=lambda name: described.factors[name])
        least, most = ranked[0], ranked[-1]
        factors = {"factor_at_first": described.factors[least], "factor_at_second": described.factors[most]}
        yield NextStep(
            StepKind.TWO_SETTINGS,
            quantity=described.parameter, place=described.place, settings=(least, most), values=factors,
        )  # fmt: skip
        return
    if described.frequency_hz is not None:
        yield from _part_that_swings(described, described.frequency_hz, layout)
    if described.law is not None:
        yield from _at_other_levels(described, described.law, layout)


def _part_that_swings(described: Described, frequency: float, layout: Layout) -> Iterator[NextStep]:
    size = _known(mass_kg=described.mass_kg, inertia_kg_m2=described.inertia_kg_m2)
    if described.inertia_kg_m2 is not None:
        size.pop("mass_kg", None)
    if size:
        low, high = (share * frequency for share in _ABOUT)
        values = {"frequency_hz": frequency, **size, "lowest_hz": low, "highest_hz": high}
        yield NextStep(StepKind.HOLD_PART, place=described.place, settings=(layout.settings[0].name,), values=values)
    elif described.place == "screw":
        yield NextStep(StepKind.TAP_SCREW, place=described.place, values={"frequency_hz": frequency})


def _at_other_levels(described: Described, law: Law, layout: Layout) -> Iterator[NextStep]:
    """Yield settings between those measured, where the law says what no measurement has."""
    parameter, first_setting = described.parameter, (layout.settings[0].name,)

    def at(*levels: float) -> tuple[tuple[float, float], ...]:
        return tuple((level, _factor(described, law, level)) for level in levels)

    if law.variable is Variable.NOTHING:
        yield NextStep(StepKind.CHECK_PART, quantity=parameter, place=described.place, expected=at(0.0))
        return
    if law.variable is Variable.ORDER:
        yield NextStep(StepKind.REPEAT_NOW, quantity=parameter, settings=first_setting, expected=at(1.0))
        return
    axis = _SET[law.variable]
    measured = levels_of(layout, axis)
    levels = np.unique(measured[np.isfinite(measured)])
    if levels.size < 2:
        return
    if law.form in (Form.PERIODIC, Form.YIELDING):
        start = float(levels[levels.size // 2])
        kind = StepKind.WITHIN_TURN if law.form is Form.PERIODIC else StepKind.WITHIN_TURN_OF_STATED
        within = at(*(start + share * law.scale for share in (0.25, 0.5, 0.75)))
        yield NextStep(kind, axis, parameter, expected=within)
        return
    pairs = list(pairwise(levels.tolist()))
    if law.form in (Form.STEP, Form.DIP):  # what is local is there, and nowhere else
        low, high = min(pairs, key=lambda pair: abs(pair[0] + pair[1] - 2.0 * law.reference))
    else:
        low, high = max(pairs, key=lambda pair: pair[1] - pair[0])
    middle = math.sqrt(low * high) if law.variable is Variable.EXCITATION and low > 0.0 else 0.5 * (low + high)
    settings = first_setting if axis is ConditionAxis.LEVEL else ()
    yield NextStep(StepKind.BETWEEN_LEVELS, axis, parameter, settings=settings, expected=at(middle, low, high))


def _factor(described: Described, law: Law, level: float) -> float:
    coefficients = tuple(described.parameters[item.name].estimate.value for item in law.parameters)
    try:
        return law.factor(level, coefficients)
    except OutsideValidityError:
        return math.nan


# --- what locates a misfit that nothing explains

#: A record stands out by more than any of a hundred right ones would. [standard deviations]
_STANDS_OUT = 4.0
#: Variance of what settings are pulled by, from which on they drift, as in the verdict. [-]
_DRIFTS = 3.0
_BANDS = 24


def steps_to_locate(fitted: Fitted[Physics], sizes: MachineSizes | None) -> tuple[NextStep, ...]:
    """Return what to check or repeat, cheapest first; never empty."""
    return tuple(_to_locate(fitted, sizes))


def _to_locate(fitted: Fitted[Physics], sizes: MachineSizes | None) -> Iterator[NextStep]:
    layout = fitted.comparison.layout
    first_setting = (layout.settings[0].name,)
    yield from _record_that_stands_out(fitted)
    every = np.ones(layout.n_values, dtype=np.bool_)
    ways = groupings(layout, _BANDS)
    chosen = narrow(ways, fitted.standardised**2, every)
    for index, groups in chosen.items():
        yield from _closer_look(ways[index].axis, ways[index].extent(groups), first_setting)
    if not any(ConditionAxis.POSITION in setting.values for setting in layout.settings):
        yield from _another_motion(sizes)
    elif ConditionAxis.LEVEL not in varied_conditions(layout) and has_lines(layout):
        yield NextStep(StepKind.LOWER_LEVEL, ConditionAxis.LEVEL, settings=first_setting)
    yield NextStep(StepKind.REPEAT_FIRST, settings=first_setting)


def _record_that_stands_out(fitted: Fitted[Physics]) -> Iterator[NextStep]:
    """Yield which tag to check: of the setting that is pulled most, or of all where they drift."""
    settings, names = fitted.comparison.layout.settings, fitted.comparison.condition_error_names
    if not names:
        return
    pulls = np.abs(np.nan_to_num(fitted.around.whitened_by.pulls(fitted.misfit)))
    setting, error = (int(index) for index in np.unravel_index(np.argmax(pulls), pulls.shape))
    largest, others = float(pulls[setting, error]), float(np.median(pulls[:, error]))
    if largest > _STANDS_OUT * max(1.0, others):
        kind, values = StepKind.CHECK_TAG, {"pull": largest, "pull_of_others": others}
    elif (variance := float(np.var(pulls[:, error]))) > _DRIFTS:
        kind, values = StepKind.READ_TAGS, {"scatter_over_stated": math.sqrt(variance)}
    else:
        return
    yield NextStep(kind, quantity=names[error], settings=(settings[setting].name,), values=values)


#: What a closer look is, by the condition that the misfit is at, and the unit in the names of its values.
_CLOSER = {
    ConditionAxis.FREQUENCY: (StepKind.SECOND_ACCELEROMETER, "hz"),
    ConditionAxis.POSITION: (StepKind.FINER_POSITIONS, "m"),
    ConditionAxis.PRELOAD: (StepKind.MORE_PRELOADS, "n"),
    ConditionAxis.PAYLOAD: (StepKind.WEIGH_PAYLOAD, "kg"),
    ConditionAxis.TEMPERATURE: (StepKind.COLD_AGAIN, "k"),
    ConditionAxis.LEVEL: (StepKind.MORE_LEVELS, "level"),
}


def _closer_look(axis: ConditionAxis | None, extent: Extent, first_setting: tuple[str]) -> Iterator[NextStep]:
    """Yield a measurement that is finer where the misfit is, or with another sensor for a channel."""
    if axis is None:
        yield NextStep(StepKind.ANOTHER_SENSOR, quantity=extent.names[0], settings=first_setting)
    elif axis in _CLOSER:
        kind, unit = _CLOSER[axis]
        ends = {f"lowest_{unit}": extent.numbers[0], f"highest_{unit}": extent.numbers[-1]}
        yield NextStep(kind, axis, settings=first_setting, values=ends)


def _another_motion(sizes: MachineSizes | None) -> Iterator[NextStep]:
    """Yield what else to do with a rigid axis in motion."""
    speed, mass = _size(sizes, Reference.VELOCITY), _size(sizes, Reference.MOVING_MASS)
    if speed is not None:
        values = {"slower_m_per_s": 0.5 * speed, "faster_m_per_s": 2.0 * speed}
        yield NextStep(StepKind.OTHER_SPEEDS, ConditionAxis.RECORD, values=values)
    if mass is not None:
        yield NextStep(StepKind.MOVE_KNOWN_MASS, ConditionAxis.PAYLOAD, values={"mass_kg": known_mass(mass)})
