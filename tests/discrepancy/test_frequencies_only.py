"""Natural frequencies alone: what a modal test of a hidden machine gives, and what is said of it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from monitor_core.discrepancy.explain_comparison import explain_comparison
from monitor_core.discrepancy.explanation import Outcome, StepKind, Untested, UntestedReason
from monitor_core.effects import ConditionAxis
from monitor_core.fitting.axis import DescribedDrive
from monitor_core.fitting.residuals.modes import compare_modes
from monitor_core.models.protocol import MotorEnd
from monitor_core.recordings.model_file import parse_model
from tests.discrepancy.axes import effects_by_key
from tests.hidden_effects.frequencies import (
    PLANTS,
    Design,
    draw_machine,
    draw_modal_case,
    modal_test,
    plain_design,
    short_design,
    transmission_line_accelerances,
)
from tests.hidden_effects.truth import finite_elements
from tests.hidden_effects.truth.axis import Axis, Parts, Setting

EFFECTS = effects_by_key()
AT = Setting(position=0.476, preload=220.0)


@pytest.mark.parametrize("position", [0.083, 0.476, 0.868])
def test_both_plants_give_the_pole_of_the_finite_elements(position) -> None:
    """The lowest mode, |λ|; the second one, of the rotor, loses a twelfth a cycle, and its peak tells 0.2 %."""
    axis, setting = draw_machine("none", "medium", np.random.default_rng(3))[0], replace(AT, position=position)
    poles = finite_elements.plant(axis, setting).pole
    elastic = np.sort(np.abs(poles[poles.imag > 60.0])) / (2.0 * math.pi)
    for accelerances in PLANTS.values():
        first, second = modal_test(accelerances, axis, setting)[:2]
        assert first == pytest.approx(elastic[0], rel=3e-4)
        assert second == pytest.approx(elastic[1], rel=2e-3)


def test_what_scatters_is_what_is_stated() -> None:
    """A table of one setting over and over: relative standard deviation of a frequency, and its stated uncertainty."""
    design = Design((AT,) * 60, MotorEnd.FREE, 1)
    table = draw_modal_case("none", "medium", design, 0.01, 5, accelerances=transmission_line_accelerances).table
    frequencies = np.array([observation.frequency for observation in table])
    # errors of the setting add hardly 0.1 %; a standard deviation of 60 draws is known to 9 %
    assert np.std(frequencies) / np.mean(frequencies) == pytest.approx(0.01, rel=0.3)
    assert [observation.frequency_uncertainty / observation.frequency for observation in table] == pytest.approx(
        [0.01] * 60
    )


def test_a_closed_brake_hides_the_rotor() -> None:
    shown = [
        draw_modal_case("none", "medium", design, 1e-6, 7, accelerances=transmission_line_accelerances).table
        for design in (Design((AT,), MotorEnd.FREE, 9), Design((AT,), MotorEnd.CLAMPED, 9))
    ]
    assert [len(table) for table in shown] == [2, 1]


def test_more_mass_is_a_root_of_the_mass_lower() -> None:
    """Little of the first mode moves but the table: f ∝ m^(-1/2), less what screw and rotor take part with."""
    axis = Axis(parts=Parts())
    heavier = replace(axis, parts=replace(axis.parts, table_mass=1.2 * axis.parts.table_mass))
    first, second = (modal_test(transmission_line_accelerances, drive, AT)[0] for drive in (axis, heavier))
    moving = axis.parts.table_mass + axis.parts.nut_mass
    expected = math.sqrt(moving / (moving + 0.2 * axis.parts.table_mass))
    assert expected < second / first < expected**0.85


def answered(kind, size, design, seed, *keys):
    case = draw_modal_case(kind, size, design, 0.001, seed, accelerances=transmission_line_accelerances)
    file = parse_model(case.baseline, "description")
    subject = DescribedDrive(file.build().parameters, file.uncertain, file.effects)
    comparison = compare_modes(case.table, case.motor_end)
    return explain_comparison(comparison, subject, [EFFECTS[key] for key in keys])


def steps_of(answer):
    """Return what to do next, by its kind."""
    kinds = dict.fromkeys(step.kind for step in answer.next_steps)
    return {kind: [step for step in answer.next_steps if step.kind is kind] for kind in kinds}


@pytest.mark.release
def test_a_healthy_machine_lacks_nothing_and_what_is_not_seen_is_listed() -> None:
    design = replace(plain_design(), settings=plain_design().settings[1::3])
    answer = answered("none", "medium", design, 1, "added-mass", "payload-mass", "second-mode")
    assert answer.outcome is Outcome.NONE
    because = {candidate.key: candidate.untested for candidate in answer.candidates}
    assert because["payload-mass"] == Untested(UntestedReason.NOT_VARIED, (ConditionAxis.PAYLOAD,))
    assert because["second-mode"] == Untested(UntestedReason.NOT_VARIED, (ConditionAxis.FREQUENCY,))
    assert StepKind.KNOWN_MASS in steps_of(answer)


@pytest.mark.release
def test_a_mode_that_stays_where_it_is_may_be_none_of_the_drive() -> None:
    """A rotor on the spring of its servo makes one as low as that of the base, and a frequency does not tell them."""
    design = replace(plain_design(), settings=plain_design().settings[1::3])
    answer = answered("base-compliance", "large", design, 3, *EFFECTS)
    assert answer.outcome is Outcome.EQUIVALENT
    (found,) = answer.effects
    assert {found.key, *found.equivalent_to} >= {"base-compliance", "second-mode"}
    (responses,) = steps_of(answer)[StepKind.RESPONSES_TO_DISTINGUISH]
    assert responses.effects[0].key == found.key
    unseen = {effect.key for step in steps_of(answer).get(StepKind.VARY, ()) for effect in step.effects}
    assert not {found.key, *found.equivalent_to} & unseen
    assert not {found.key, *found.equivalent_to} & {
        candidate.key for candidate in answer.candidates if candidate.untested
    }


@pytest.mark.release
def test_a_mode_that_moves_with_the_table_is_of_the_drive() -> None:
    """A bearing many times too soft leaves no mode near to those measured, but position and preload move them."""
    design = replace(plain_design(), settings=plain_design().settings[1::3])
    answer = answered("wrong-parameter:bearing_stiffness_n_per_m", "large", design, 3, *EFFECTS)
    assert answer.effects
    assert not {"base-compliance", "second-mode"} & set(answer.effects[0].equivalent_to)


@pytest.mark.release
def test_a_mass_from_three_positions_is_one_of_several_and_a_known_mass_would_decide() -> None:
    design = replace(short_design(), settings=short_design().settings[::3])
    keys = ("added-mass", "screw-axial-stiffness", "far-bearing-stiffness")
    answer = answered("added-mass", "large", design, 2, *keys)
    assert answer.outcome is Outcome.EQUIVALENT
    (found,) = answer.effects
    assert {found.key, *found.equivalent_to} >= {"added-mass", "screw-axial-stiffness"}
    (positions,) = steps_of(answer)[StepKind.MORE_POSITIONS]
    assert positions.values["n_positions"] == 5
    (conditions,) = steps_of(answer)[StepKind.OTHER_CONDITIONS]
    assert conditions.condition is ConditionAxis.PAYLOAD
