"""A model file after an explanation is the axis that was found, whatever the file had before."""

from dataclasses import replace

import numpy as np
import pytest

from monitor_core.discrepancy.explain_axis import augmented_model
from monitor_core.discrepancy.explanation import Explanation, Gap, GapPair, Outcome
from monitor_core.effects import DRIVE_EFFECTS, MOTION_EFFECTS, sized_for, with_effects
from monitor_core.effects.sizes import motion_sizes
from monitor_core.fitting.axis import AxisDescription
from monitor_core.fitting.machine_sizes import sizes_of_drive
from monitor_core.fitting.observations import ModalObservation
from monitor_core.models.extended import ExtendedModel, ResponseCase, prepare_lines, responses
from monitor_core.models.motion import MotionModel, MotionParameters, MotionPhysics
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, MotorEnd, ResponsePoint
from monitor_core.recordings.model_file import model_file_text, parse_model, read_model_file
from tests.conftest import PROJECT_ROOT

LUMPED = read_model_file(PROJECT_ROOT / "replay_data" / "models" / "lumped.toml")
HYBRID = read_model_file(PROJECT_ROOT / "replay_data" / "models" / "hybrid.toml")
HYBRID_WITH_RATING = replace(HYBRID, parameters={**HYBRID.parameters, "dynamic_load_rating_n": 4000.0})
MOTION = AxisDescription("motion", {"moving_mass_kg": 80.0})
#: Of everything that an effect may act on.
CONDITIONS = DriveConditions(0.3, 200.0, 5.0, 10.0, 0.5)


def explanation(ln_ratios=None, added=None) -> Explanation:
    """Return one that found this, and says nothing else."""
    pair = GapPair(1.0, 1.0)
    return Explanation(
        outcome=Outcome.NAMED, effects=(), localisation=(), remainder=(), gap=Gap("sigma", 1.0, pair, pair), steps=(),
        candidates=(), pulls={}, least_delta_bic=50.0, next_steps=(), ln_ratios=ln_ratios or {},
        added=added or {}, panels=(),
    )  # fmt: skip


def read_back(model: AxisDescription) -> AxisDescription:
    return parse_model(model_file_text(model), "augmented")


def noticeable(effect, share):
    """Return values of which two can be added without leaving what an axis can have."""
    return {
        parameter.name: parameter.null + share * min(parameter.scale, 0.5 * (parameter.upper - parameter.null))
        for parameter in effect.parameters
    }


def response_of(physics):
    cases = [
        ResponseCase(
            np.array([40.0, 160.0, 250.0, 700.0]), CONDITIONS, ExcitationPoint.TORQUE_AT_MOTOR, point, MotorEnd.FREE
        )
        for point in (ResponsePoint.ACCELERATION_AT_TABLE, ResponsePoint.ANGLE_AT_MOTOR)
    ]
    return responses(physics, prepare_lines(cases))


def added_once(effect, stated: AxisDescription):
    return effect.added_to(ExtendedModel.of(stated.build().parameters).physics, noticeable(effect, 0.3))


def drive_of(effect) -> AxisDescription | None:
    """Return a drive that the effect may be added to twice; none where an axis has it once at most."""
    for stated in (LUMPED, HYBRID_WITH_RATING):
        if effect.applies(ExtendedModel.of(stated.build().parameters).physics):
            return stated if effect.applies(added_once(effect, stated)) else None
    return None


#: As these axes are measured under one of the conditions.
DRIVE = sized_for(
    DRIVE_EFFECTS,
    sizes_of_drive(ExtendedModel.of(LUMPED.build().parameters).physics, [ModalObservation(CONDITIONS, 200.0)]),
)
MOTIONS = sized_for(MOTION_EFFECTS, motion_sizes(force=54.0, change=54.0, velocity=0.09, cutoff=100.0))
REPEATABLE = [effect for effect in DRIVE if drive_of(effect) is not None]


def test_only_what_has_a_shape_is_there_once_at_most() -> None:
    once = {effect.key for effect in DRIVE if effect not in REPEATABLE}
    assert once == {
        "base-compliance", "second-mode", "sensor-mounting-resonance", "table-absorber", "nut-absorber"
    }  # fmt: skip


def test_effect_of_the_file_and_the_same_found_once_more_are_both_in_the_model(subtests: pytest.Subtests) -> None:
    for effect in REPEATABLE:
        with subtests.test(effect=effect):
            stated = drive_of(effect)
            once = added_once(effect, stated)
            first, second = noticeable(effect, 0.3), noticeable(effect, 0.5)
            model = augmented_model(
                replace(stated, effects={effect.key: first}), explanation(added={effect.key: second}), DRIVE_EFFECTS
            )
            twice = with_effects(ExtendedModel.of(stated.build().parameters), read_back(model).effects).physics
            # the response is that of the axis to which it was added twice
            np.testing.assert_allclose(response_of(twice), response_of(effect.added_to(once, second)), rtol=1e-9)
            assert not np.allclose(response_of(twice), response_of(once), rtol=1e-9)


@pytest.mark.parametrize("effect", MOTIONS, ids=lambda effect: effect.key)
def test_effect_of_a_motion_model_found_once_more(effect) -> None:
    axis = MotionModel.of(MotionParameters(moving_mass=80.0)).physics
    first, second = noticeable(effect, 0.3), noticeable(effect, 0.5)
    once = effect.added_to(axis, first)
    if not effect.applies(once):  # then a search does not find it once more
        assert effect.key in ("stribeck-friction", "viscous-friction")
        return
    model = augmented_model(
        replace(MOTION, effects={effect.key: first}), explanation(added={effect.key: second}), MOTION_EFFECTS
    )
    found = with_effects(MotionModel.of(MotionParameters(moving_mass=80.0)), read_back(model).effects).physics
    expected = effect.added_to(once, second)
    for name in MotionPhysics.__dataclass_fields__:
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-12), name


def test_effect_without_size_takes_the_shape_of_what_was_found() -> None:
    absent = {"residue_per_kg": 0.0, "frequency_hz": 300.0, "damping_ratio": 0.02}
    found = {"residue_per_kg": 1e-3, "frequency_hz": 210.0, "damping_ratio": 0.01}
    model = augmented_model(
        replace(HYBRID, effects={"second-mode": absent}), explanation(added={"second-mode": found}), DRIVE_EFFECTS
    )
    assert read_back(model).effects == {"second-mode": found}


def test_parameters_move_by_their_ratio_and_stay_uncertain() -> None:
    stated = replace(HYBRID, uncertain={"bearing_stiffness_n_per_m": 0.2}, effects={"added-mass": {"mass_kg": 1.5}})
    ratios = {"bearing_stiffness_n_per_m": np.log(1.25), "table_mass_kg": np.log(0.5)}
    model = read_back(augmented_model(stated, explanation(ratios, {"torque-delay": {"delay_s": 1e-4}}), DRIVE_EFFECTS))
    assert model.parameters["bearing_stiffness_n_per_m"] == pytest.approx(1.25 * 6.21e7, rel=1e-12)
    assert model.parameters["table_mass_kg"] == pytest.approx(5.0, rel=1e-12)
    others = set(HYBRID.parameters) - set(ratios)
    assert {name: model.parameters[name] for name in others} == {name: HYBRID.parameters[name] for name in others}
    assert model.uncertain == stated.uncertain
    assert model.effects == {"added-mass": {"mass_kg": 1.5}, "torque-delay": {"delay_s": 1e-4}}
    model.build()


def test_file_that_corrects_its_parameters_is_the_axis_with_the_parameters_corrected() -> None:
    effects = {
        "wrong-parameter:bracket_stiffness_n_per_m": {"ln_ratio": -0.7},
        "added-mass": {"mass_kg": 1.5},
        "wrong-parameter:screw_length_m": {"ln_ratio": 0.05},
        "wrong-parameter:nut_stiffness_n_per_m": {"ln_ratio": 0.3},
    }
    stated = replace(LUMPED, effects=effects)
    corrected = stated.with_corrected_parameters()
    assert corrected.effects == {"added-mass": {"mass_kg": 1.5}}
    assert corrected.parameters["bracket_stiffness_n_per_m"] == pytest.approx(2.1e8 * np.exp(-0.7), rel=1e-12)
    frequencies = [
        [mode.frequency for mode in model.build().natural_frequencies(CONDITIONS)] for model in (stated, corrected)
    ]
    np.testing.assert_allclose(*frequencies, rtol=1e-9)
