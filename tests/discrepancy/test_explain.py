"""The workflow from end to end on an axis of its own family: what is hidden is named, and nothing else."""

import math
from dataclasses import dataclass, replace
from textwrap import dedent

import numpy as np
import pytest

from monitor_core.discrepancy.explain_comparison import explain_comparison
from monitor_core.discrepancy.explanation import MisfitKind, Outcome, Untested, UntestedReason
from monitor_core.effects import DRIVE_EFFECTS, PREFIX, ConditionAxis, with_effects, wrong_parameter
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.axis import DescribedDrive
from monitor_core.fitting.conditions.groups import Dimension
from monitor_core.models.extended import ExtendedModel, physics_of
from monitor_core.models.protocol import ExcitationPoint
from monitor_core.models.published.receptance import ReceptanceParameters
from monitor_core.recordings.effect_file import read_effect_file
from monitor_core.shown import Panel
from service.documents.explanation_sentences import KEYS, remarks
from tests.discrepancy.axes import (
    AXIS,
    POSITIONS,
    SIZES,
    TOLERANCES,
    LinearAxis,
    LinearComparison,
    compared,
    effects_by_key,
    layout_of,
    measured,
    quantity,
    settings,
    subject,
    true_subject,
)

EFFECTS = effects_by_key()
CONDITIONS = settings(preloads=(220.0,))
SECOND_HALF = settings(preloads=(120.0, 300.0))


def with_hidden(values, seed=0):
    physics = true_subject(seed)
    for key, of_effect in values.items():
        physics = EFFECTS[key].added_to(physics, of_effect)
    return physics


def explained(physics, conditions=CONDITIONS, *, described=None, candidates=None, **measurement):
    described = described or subject()
    comparison = compared(measured(physics, conditions, **measurement))
    return explain_comparison(comparison, described, candidates or described.candidates(SIZES))


def few(*others):
    """Return some of the candidates, where a test is about others than the rest."""
    chosen = ("added-mass", "far-bearing-stiffness", "series-compliance", "loss-factor", "guide-friction",
              "torque-delay", "preload-exponent")  # fmt: skip
    return [EFFECTS[key] for key in (*chosen, *others)]


def keys(answer):
    return [effect.key for effect in answer.effects]


def covered(found, value, times=1.5):
    """Tell whether the 95 % interval, somewhat widened since a single case may be the twentieth, holds a value."""
    low, high = found.interval_95
    return abs(value - found.estimate.value) <= times * 0.5 * (high - low)


# --- nothing, one, two -----------------------------------------------------------------------------------------------


@pytest.mark.release
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_healthy_axis_lacks_nothing(seed) -> None:
    answer = explained(true_subject(seed), SECOND_HALF, seed=seed)
    assert answer.outcome is Outcome.NONE
    assert answer.effects == ()
    assert answer.added == {}
    assert answer.gap.after == answer.gap.before
    assert answer.gap.before.held_out == pytest.approx(answer.gap.noise_floor, rel=0.1)


@pytest.fixture(scope="module")
def far_bearing():
    return explained(with_hidden({"far-bearing-stiffness": {"stiffness_n_per_m": 2e7}}), SECOND_HALF)


def test_a_far_bearing_is_named(far_bearing) -> None:
    """With an interval that holds its stiffness, and a gap that is gone where nothing was fitted."""
    assert far_bearing.outcome is Outcome.NAMED
    (found,) = far_bearing.effects
    assert (found.key, found.equivalent_to, found.plausible) == ("far-bearing-stiffness", (), True)
    stiffness = found.parameters["stiffness_n_per_m"]
    assert stiffness.unit == "N/m"
    assert covered(stiffness, 2e7)
    assert stiffness.estimate.standard_uncertainty < 0.05 * 2e7
    assert found.held_out_log_likelihood_gain > 0.0
    gap = far_bearing.gap
    assert gap.before.held_out > 20.0 * gap.noise_floor
    assert gap.after.held_out < 1.1 * gap.noise_floor
    assert [step.effects for step in far_bearing.steps] == [("far-bearing-stiffness",)]
    assert far_bearing.steps[-1].gap == gap.after


@pytest.mark.release
def test_what_a_tolerance_has_taken_up_is_found_in_its_place() -> None:
    """Compliance in series with bracket and bearing is the same compliance of either: one finding, by both names."""
    answer = explained(with_hidden({"series-compliance": {"compliance_m_per_n": 9e-8}}), SECOND_HALF)
    (found,) = answer.effects
    assert found.key == "series-compliance"
    assert found.equivalent_to == ()
    assert any(key.startswith("wrong-parameter:") for key in found.aliases)
    assert covered(found.parameters["compliance_m_per_n"], 9e-8)
    assert [(step.effects, step.gap) for step in answer.steps] == [((found.key,), answer.gap.after)]
    strained = max(answer.pulls_before, key=lambda name: abs(answer.pulls_before[name]))
    assert abs(answer.pulls_before[strained]) > 8.0
    assert abs(answer.pulls[strained]) < 3.0


@dataclass(frozen=True, eq=False)
class AnsweringNearby(LinearComparison):
    """Has no answer where the first quantity is above two, and draws what it is asked to draw."""

    def misfit(self, physics):
        if physics[0] > 2.0 and np.all(self.errors == 0.0):
            raise OutsideValidityError("no answer at the settings as stated")
        return super().misfit(physics)

    def panels(self, models):
        self.misfit(models["before"])
        return tuple(Panel(name, "x", "y", np.zeros(1), np.zeros(1), {name: np.zeros(1)}) for name in models)


def test_a_model_without_an_answer_at_the_settings_as_stated_is_left_out_of_the_pictures() -> None:
    """It fits with the likely errors of the settings, and is still what was found."""
    layout = layout_of((40, 40), 1.0)
    rng = np.random.default_rng(2)
    design = np.column_stack([np.ones(80), rng.standard_normal(80)])
    data = design @ [3.0, 0.0] + rng.standard_normal(80)
    comparison = AnsweringNearby(layout, design, data, np.full((1, 80), 0.3), errors=np.zeros((2, 1)))
    answer = explain_comparison(comparison, LinearAxis({}, 2), [quantity(0, lower=0.0)])
    assert keys(answer) == ["quantity-0"]
    assert [panel.title for panel in answer.panels] == ["before"]


def test_the_augmented_model_is_the_axis(far_bearing) -> None:
    """The description, moved by the ratios and with what was added, is as the true axis is."""
    described = replace(
        AXIS,
        bearing_stiffness=AXIS.bearing_stiffness * math.exp(far_bearing.ln_ratios["bearing_stiffness_n_per_m"]),
        bracket_stiffness=AXIS.bracket_stiffness * math.exp(far_bearing.ln_ratios["bracket_stiffness_n_per_m"]),
        loss_factor=AXIS.loss_factor * math.exp(far_bearing.ln_ratios["loss_factor"]),
    )
    model = with_effects(ExtendedModel(described, physics_of(described)), far_bearing.added)
    truth = with_hidden({"far-bearing-stiffness": {"stiffness_n_per_m": 2e7}})
    found, true = (compared(measured(physics, SECOND_HALF, seed=99)) for physics in (model.physics, truth))
    assert np.sqrt(np.mean((found.misfit(truth) - true.misfit(truth)) ** 2)) < 0.01


def test_the_misfit_is_located_before_and_gone_after(far_bearing) -> None:
    assert far_bearing.localisation
    assert far_bearing.remainder == ()
    assert [str(picture.over) for picture in far_bearing.maps] == ["position", "preload"]
    for misfit_map in far_bearing.maps:
        assert np.nanmax(misfit_map.before) > 20.0
        assert np.nanmax(misfit_map.after) < 2.0


@pytest.mark.release
def test_a_misfit_is_located_where_the_effect_acts() -> None:
    """A weak far bearing is a stiffness, and is felt where the table is far from the fixed one."""
    answer = explained(with_hidden({"far-bearing-stiffness": {"stiffness_n_per_m": 1e6}}), SECOND_HALF)
    assert keys(answer) == ["far-bearing-stiffness"]
    first = answer.localisation[0]
    assert first.kind is MisfitKind.STIFFNESS
    (positions,) = (extent for extent in first.place.extents if extent.dimension is Dimension.POSITION)
    assert positions.numbers[-1] == pytest.approx(0.8683)


def test_pictures_show_both_models(far_bearing) -> None:
    assert len(far_bearing.panels) == len(SECOND_HALF)
    for panel in far_bearing.panels:
        before, after = (
            np.std(np.log(panel.models[name] / panel.measured)) for name in ("before", "after")
        )  # fmt: skip
        assert after < 0.01
        assert before > after


def test_pulls_are_those_of_a_healthy_axis(far_bearing) -> None:
    assert set(far_bearing.pulls) == {"position", "preload", "gain 1", *TOLERANCES}
    assert max(abs(pull) for pull in far_bearing.pulls.values()) < 3.0


def test_candidates_say_why_they_cannot_be_judged(far_bearing) -> None:
    """No payload, temperature and level were varied; a rotor that is not part of the path moves nothing."""
    reasons = {candidate.key: candidate.untested for candidate in far_bearing.candidates}
    assert reasons["payload-mass"] == Untested(UntestedReason.NOT_VARIED, (ConditionAxis.PAYLOAD,))
    assert reasons["thermal-preload"] == Untested(UntestedReason.NOT_VARIED, (ConditionAxis.TEMPERATURE,))
    assert reasons["servo-stiffness"] == Untested(UntestedReason.WITHOUT_TRACE)
    assert reasons["position-offset"] == Untested(UntestedReason.BELOW_NOISE)
    assert reasons["added-mass"] is None
    assert "far-bearing-stiffness" not in reasons
    limits = {candidate.key: candidate.detection_limit for candidate in far_bearing.candidates}
    assert limits["payload-mass"] is None
    assert 0.0 < limits["torque-delay"] < 5e-3


@pytest.mark.release
def test_two_effects_are_both_named() -> None:
    answer = explained(
        with_hidden({"far-bearing-stiffness": {"stiffness_n_per_m": 2e7}, "torque-delay": {"delay_s": 5e-5}}),
        candidates=few(),
    )
    assert answer.outcome is Outcome.NAMED
    assert set(keys(answer)) == {"far-bearing-stiffness", "torque-delay"}
    found = {effect.key: effect.parameters for effect in answer.effects}
    assert covered(found["far-bearing-stiffness"]["stiffness_n_per_m"], 2e7)
    assert covered(found["torque-delay"]["delay_s"], 5e-5)
    assert answer.gap.after.held_out < 1.1 * answer.gap.noise_floor
    for key, parameters in found.items():  # one axis: what is stated is what is written
        assert {name: parameter.estimate.value for name, parameter in parameters.items()} == answer.added[key]


@pytest.mark.release
def test_a_wrong_parameter_is_named_and_moves_its_ratio() -> None:
    """A bracket of twice the stated stiffness, fourteen of its tolerances off: no compliance more makes it stiffer."""
    described = DescribedDrive(AXIS, {"bracket_stiffness_n_per_m": 0.05, "loss_factor": 0.3}, {})
    answer = explained(physics_of(replace(AXIS, bracket_stiffness=2.0 * AXIS.bracket_stiffness)), described=described)
    assert answer.outcome is Outcome.NAMED
    assert keys(answer) == [f"{PREFIX}bracket_stiffness_n_per_m"]
    assert answer.added == {}
    assert answer.ln_ratios["bracket_stiffness_n_per_m"] == pytest.approx(math.log(2.0), abs=0.1)
    assert answer.ln_ratios["bracket_stiffness_n_per_m"] == answer.effects[0].parameters["ln_ratio"].estimate.value


# --- what is not to be believed --------------------------------------------------------------------------------------


@pytest.mark.release
def test_an_effect_beyond_its_plausible_range_is_a_stand_in() -> None:
    """Were far bearings softer than 10 N/µm, one of 30 N/µm would stand for something that nobody has thought of."""
    far = EFFECTS["far-bearing-stiffness"]
    soft = replace(far, parameters=(replace(far.parameters[0], upper=1e7, scale=5e6),))
    candidates = [soft if candidate.key == far.key else candidate for candidate in subject().candidates(SIZES)]
    answer = explained(with_hidden({far.key: {"stiffness_n_per_m": 3e7}}), candidates=candidates)
    assert answer.outcome is Outcome.UNKNOWN
    (found,) = answer.effects
    assert not found.plausible
    *_, remark = remarks(found, KEYS)
    assert remark.startswith("a stand-in for something else: stiffness_n_per_m = 3.")


WIPERS = """
    from dataclasses import replace

    from monitor_core.effects.effect import Effect, EffectParameter


    def _add(axis, values):
        damping = axis.bodies.table_damping + values["damping_ns_per_m"]
        return replace(axis, bodies=replace(axis.bodies, table_damping=damping))


    EFFECTS = (
        Effect(
            key="wipers",
            name="Wipers of the guides",
            physics="They drag in proportion to the speed of the table.",
            source="no source: a damper to ground",
            parameters=(EffectParameter("damping_ns_per_m", "N·s/m", lower=0.0, upper=1e5, scale=200.0),),
            add=_add,
        ),
    )
"""


def dragging():
    physics = true_subject(0)
    return replace(physics, bodies=replace(physics.bodies, table_damping=1500.0))


def test_what_the_catalogue_lacks_stays_unknown() -> None:
    answer = explained(dragging(), candidates=few())
    assert answer.outcome is Outcome.UNKNOWN
    assert answer.remainder
    assert answer.gap.after.fit > 2.0 * answer.gap.noise_floor


@pytest.mark.release
def test_an_effect_of_a_users_own_is_named(tmp_path) -> None:
    """The same axis, with a file that has what the catalogue lacks."""
    (tmp_path / "mine.py").write_text(dedent(WIPERS), encoding="utf-8")
    own = read_effect_file(tmp_path / "mine.py")
    described = DescribedDrive(AXIS, TOLERANCES, {}, (*DRIVE_EFFECTS, *own))
    answer = explained(dragging(), described=described)
    assert (answer.outcome, keys(answer)) == (Outcome.NAMED, ["wipers"])
    assert covered(answer.effects[0].parameters["damping_ns_per_m"], 1500.0)
    assert list(answer.added) == ["wipers"]


@pytest.mark.release
def test_held_out_positions_that_contradict_are_believed() -> None:
    """A far bearing holds the screw while five positions are measured, and does not at the other two."""
    held = with_hidden({"far-bearing-stiffness": {"stiffness_n_per_m": 2e6}})
    free = true_subject(0)
    answer = explained(
        lambda at: free if at.position in (POSITIONS[1], POSITIONS[-2]) else held,
        candidates=few("screw-axial-stiffness"),
    )
    assert answer.outcome is Outcome.UNKNOWN
    assert keys(answer) == []


# --- a baseline of another family ------------------------------------------------------------------------------------


def test_a_lumped_baseline_of_a_distributed_screw() -> None:
    """Mass and inertia of the screw are spread along it: both are missing, and both are found to be all of it."""
    diameter, density = AXIS.screw_minor_diameter, 7850.0
    common = {
        name: getattr(AXIS, name)
        for name in ("table_mass", "nut_mass", "screw_length", "screw_lead", "youngs_modulus", "shear_modulus",
                     "bearing_stiffness", "bracket_stiffness", "nut_stiffness", "dynamic_load_rating",
                     "coupling_stiffness", "motor_inertia", "loss_factor")
    }  # fmt: skip
    true = physics_of(ReceptanceParameters(screw_diameter=diameter, density=density, **common))
    described = subject(
        screw_mass=density * math.pi / 4.0 * diameter**2 * AXIS.screw_length,
        screw_inertia=density * math.pi / 32.0 * diameter**4 * AXIS.screw_length,
    )
    answer = explained(
        true, described=described, candidates=few("screw-distributed-mass", "torsional-flexibility"),
        excitation=ExcitationPoint.TORQUE_AT_MOTOR, lines=np.geomspace(40.0, 1500.0, 40),
    )  # fmt: skip
    assert answer.outcome is Outcome.NAMED
    assert set(keys(answer)) == {"screw-distributed-mass", "torsional-flexibility"}
    found = {effect.key: effect.parameters for effect in answer.effects}
    assert found["screw-distributed-mass"]["share"].estimate.value == pytest.approx(1.0, abs=0.01)
    assert found["torsional-flexibility"]["inertia_share"].estimate.value == pytest.approx(1.0, abs=0.01)
    assert found["torsional-flexibility"]["compliance_share"].estimate.value == pytest.approx(0.0, abs=0.01)
    assert answer.gap.after.held_out < 1.1 * answer.gap.noise_floor


def test_an_axis_without_an_answer_is_refused() -> None:
    comparison = compared(measured(true_subject(0), CONDITIONS))
    with pytest.raises(OutsideValidityError, match="position must lie on the screw"):
        explain_comparison(comparison, subject(screw_length=0.6), [wrong_parameter("bearing_stiffness_n_per_m", AXIS)])


@pytest.mark.release
@pytest.mark.parametrize("apart", [0.1, 0.15, 0.2])
def test_what_would_do_in_the_place_of_another_is_in_its_class(apart) -> None:
    """Of two look-alikes one is found beside a third effect; the other may stand for it."""
    rng = np.random.default_rng(0)
    first, rest, third = np.linalg.qr(rng.standard_normal((400, 3)))[0].T
    design = np.column_stack([first, first * math.sqrt(1.0 - apart**2) + rest * apart, third])
    data = design @ [60.0, 60.0, 80.0] + 1.6 * rng.standard_normal(400)
    comparison = LinearComparison(layout_of([4] * 100, 1.0), design, data, np.zeros((0, 400)))
    answer = explain_comparison(comparison, LinearAxis({}, 3), [quantity(index, upper=500.0) for index in range(3)])
    named = {key for effect in answer.effects for key in (effect.key, *effect.equivalent_to)}
    assert named == {"quantity-0", "quantity-1", "quantity-2"}
