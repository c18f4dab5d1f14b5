"""What conditions are called, which of them are held out, and what was varied."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from monitor_core.effects.effect import ConditionAxis
from monitor_core.fitting.conditions.settings import (
    default_folds,
    fitted_still,
    is_testable,
    setting_of,
    varied_conditions,
)
from monitor_core.models.protocol import DriveConditions
from tests.discrepancy.axes import POSITIONS, effects_by_key, layout_of, settings
from tests.hidden_effects.designs import DESIGNS
from tests.hidden_effects.machines import BENCH


def test_name_of_a_setting_says_what_is_stated() -> None:
    assert setting_of(DriveConditions(0.3)).name == "300 mm"
    stated = DriveConditions(
        0.3455, 250.0, payload_mass=6.0, temperature_deviation=-15.0, excitation_level=0.0456
    )  # fmt: skip
    found = setting_of(stated)
    assert found.name == "345.5 mm, 250 N, +6 kg, -15 K, level 0.0456"
    assert found.values == {
        ConditionAxis.POSITION: 0.3455, ConditionAxis.PRELOAD: 250.0, ConditionAxis.PAYLOAD: 6.0,
        ConditionAxis.TEMPERATURE: -15.0, ConditionAxis.LEVEL: 0.0456,
    }  # fmt: skip


def test_what_is_not_stated_has_no_value() -> None:
    """No preload and no level were stated; no payload is one of 0 kg."""
    values = setting_of(DriveConditions(0.3)).values
    assert set(values) == {ConditionAxis.POSITION, ConditionAxis.PAYLOAD, ConditionAxis.TEMPERATURE}


def test_of_five_positions_two_inner_ones_are_held_out() -> None:
    """At every preload; the ends of the screw are fitted, so that a model is judged within its range."""
    conditions = settings(preloads=(120.0, 220.0, 360.0))
    (fold,) = default_folds(reversed(conditions))
    assert fold == {setting for setting in conditions if setting.position in (POSITIONS[1], POSITIONS[-2])}


@pytest.mark.parametrize(
    ("name", "values"),
    [("payload_mass", (6.0, 6.0)), ("temperature_deviation", (15.0, 15.0)), ("excitation_level", (0.05, 0.5, 0.05))],
)
def test_of_each_variation_the_last_one_is_held_out(name, values) -> None:
    """So that held-out data tell of effects which that variation alone shows; a variation measured once is fitted."""
    usual = settings(preloads=(220.0,), **({"excitation_level": 0.15} if name == "excitation_level" else {}))
    varied = [replace(usual[at], **{name: value}) for at, value in zip((2, 3, 4), values, strict=False)]
    (fold,) = default_folds(usual + varied)
    assert fold == {usual[1], usual[-2], varied[1] if len(values) == 2 else varied[2]}


def test_of_a_temperature_that_drifts_the_coldest_and_the_warmest_are_held_out() -> None:
    """Each kelvin comes by twice; each of them held out would leave little to fit."""
    visits = [setting for _ in range(3) for setting in settings(preloads=(220.0,))]
    drifting = [replace(setting, temperature_deviation=float(number // 2 - 5)) for number, setting in enumerate(visits)]
    (fold,) = default_folds(drifting)
    inner = {setting for setting in drifting if setting.position in (POSITIONS[1], POSITIONS[-2])}
    others = Counter(setting.temperature_deviation for setting in drifting if setting not in inner)
    twice = sorted(temperature for temperature, count in others.items() if count > 1)
    assert len(twice) > 2
    held = {setting.temperature_deviation for setting in fold - inner}
    assert held  # the most common one of all is the usual one, and stays
    assert held <= {twice[0], twice[-1]}


def test_a_variation_that_was_measured_once_is_fitted() -> None:
    """At a position that is held out, too: nothing that is fitted would show what it alone shows."""
    usual = settings(preloads=(220.0,))
    loaded = replace(usual[1], payload_mass=6.0)
    (fold,) = default_folds([*usual, loaded])
    assert fold == {usual[1], usual[-2]}


def test_where_the_one_that_was_fitted_is_taken_out_the_other_of_its_level_is_fitted() -> None:
    usual = settings(preloads=(220.0,))
    warm = [replace(usual[1], temperature_deviation=15.0), replace(usual[3], temperature_deviation=15.0)]
    conditions = [*usual, *warm]
    fold = frozenset({usual[1], usual[3], warm[1]})
    assert fitted_still(fold, conditions, conditions) == fold
    assert fitted_still(fold, conditions, [*usual, warm[1]]) == fold - {warm[1]}
    assert fitted_still(fold, conditions, [*usual, warm[0]]) == fold
    # what never was fitted stays unseen
    apart = frozenset({usual[1], *warm})
    assert fitted_still(apart, conditions, [*usual, warm[1]]) == apart


@pytest.mark.parametrize("name", ["payload_mass", "temperature_deviation", "excitation_level"])
@pytest.mark.parametrize("design", ["usual", "rich"])
def test_of_what_was_varied_twice_one_is_fitted_and_one_is_held_out(design, name) -> None:
    """Of 21 settings at five positions all that was varied stood at the two that are held out."""
    conditions = [
        DriveConditions(each.position, each.preload, payload_mass=each.payload,
                        temperature_deviation=each.temperature_deviation, excitation_level=each.excitation_rms)
        for each in DESIGNS[design](BENCH, np.random.default_rng(3))
    ]  # fmt: skip
    (fold,) = default_folds(conditions)
    counts = Counter(getattr(each, name) for each in conditions)
    usual = counts.most_common(1)[0][0]
    for varied in counts.keys() - {usual}:
        assert sorted(each in fold for each in conditions if getattr(each, name) == varied) == [False, True]
    # and one position is seen by no fit at all
    places = {each.position for each in conditions}
    assert any(all(each in fold for each in conditions if each.position == place) for place in places)


def test_a_table_of_few_positions_leaves_out_its_preloads_in_turn() -> None:
    """Nguyen et al. (2018), Table 2: 3 positions at 6 preloads."""
    conditions = settings(positions=(0.25, 0.5, 0.75), preloads=(50.0, 100.0, 150.0, 200.0, 250.0, 300.0))
    folds = default_folds(conditions)
    assert [{setting.preload for setting in fold} for fold in folds] == [
        {50.0},
        {100.0},
        {150.0},
        {200.0},
        {250.0},
        {300.0},
    ]
    assert set().union(*folds) == set(conditions)


@pytest.mark.parametrize(("n_positions", "n_preloads"), [(4, 3), (1, 1), (2, 2)])
def test_where_everything_is_needed_nothing_is_held_out(n_positions, n_preloads) -> None:
    preloads = (100.0, 200.0, 300.0)[:n_preloads]
    assert default_folds(settings(positions=POSITIONS[:n_positions], preloads=preloads)) == ()


def test_preloads_that_nobody_stated_are_not_held_out() -> None:
    assert default_folds([DriveConditions(position) for position in POSITIONS[:4]]) == ()


def test_a_condition_varies_if_it_takes_two_values() -> None:
    stated = [DriveConditions(0.2, 100.0), DriveConditions(0.2, 200.0), DriveConditions(0.2, 200.0, payload_mass=3.0)]
    layout = replace(layout_of([1, 1, 1], 1.0), settings=tuple(setting_of(conditions) for conditions in stated))
    assert varied_conditions(layout) == {ConditionAxis.PRELOAD, ConditionAxis.PAYLOAD}


def test_lines_of_responses_vary_the_frequency_and_natural_frequencies_do_not() -> None:
    lines = layout_of([30, 30], 1.0, frequency=np.tile(np.linspace(50.0, 500.0, 30), 2))
    modes = layout_of([1] * 30, 1e-3, frequency=np.linspace(150.0, 200.0, 30))
    assert ConditionAxis.FREQUENCY in varied_conditions(lines)
    assert ConditionAxis.FREQUENCY not in varied_conditions(modes)


def test_a_mode_that_stays_at_all_positions_may_be_of_something_else() -> None:
    """What makes it has a frequency of its own; two positions do not tell, nor does more scatter than is stated."""
    scatter = 1e-3 * np.random.default_rng(5).standard_normal(30)
    base, delay = (effects_by_key()[key] for key in ("base-compliance", "torque-delay"))
    stays = layout_of([1] * 30, 1e-3, frequency=71.0 * np.exp(scatter))
    assert is_testable(base, stays)
    assert not is_testable(delay, stays)
    assert not is_testable(base, layout_of([1] * 30, 1e-3, frequency=710.0 * np.exp(scatter)))
    assert not is_testable(base, layout_of([1] * 30, 1e-3, frequency=71.0 * np.exp(3.0 * scatter)))
    assert not is_testable(base, layout_of([1] * 2, 1e-3, frequency=np.array([71.0, 71.0])))
