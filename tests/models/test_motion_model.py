"""Kinematics and force of a rigid axis, in closed form; the model file; what a motion model is no use for."""

import numpy as np
import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.axis import AxisDescription
from monitor_core.models.motion import (
    Kinematics,
    MotionModel,
    MotionParameters,
    MotionPhysics,
    cutoff_frequency,
    forces,
    kinematics_of,
)
from monitor_core.recordings.model_file import read_model_file, write_model_file
from tests.models.extended_axes import bundled
from tests.models.simulated_motion import Motion
from tests.service.test_cli import assert_refused

STATED = {"moving_mass_kg": 95.0, "viscous_friction_ns_per_m": 200.0}
FILE = AxisDescription(
    "motion",
    STATED,
    {"moving_mass_kg": 0.1},
    {
        "coulomb-friction": {"friction_n": 20.0},
        "stribeck-friction": {"friction_n": -10.0, "velocity_m_per_s": 0.02},
        "wrong-parameter:viscous_friction_ns_per_m": {"ln_ratio": 0.5},
    },
)


def moving(velocity, acceleration, rate=1000.0):
    return Kinematics(rate, np.array(velocity), np.array(acceleration))


def test_derivatives_of_a_known_motion() -> None:
    time = np.arange(4000) / 1000.0
    inner = slice(200, -200)
    found = kinematics_of(Motion().at(time, 0), 1000.0)
    for derivative, values in ((1, found.velocity), (2, found.acceleration)):
        expected = Motion().at(time, derivative)
        # at 2 Hz the filter and the central differences are right to 1e-4, and nothing is delayed
        assert np.max(np.abs(values - expected)[inner]) < 2e-4 * np.max(np.abs(expected))


def test_cutoff_is_that_of_the_published_identification_or_less_at_a_low_sample_rate() -> None:
    assert [cutoff_frequency(rate) for rate in (200.0, 1000.0, 8000.0)] == pytest.approx([20.0, 100.0, 100.0])


def test_a_motion_of_a_few_samples_is_refused() -> None:
    with pytest.raises(OutsideValidityError, match="at least 40 samples; got 12"):
        kinematics_of(np.zeros(12), 1000.0)
    with pytest.raises(OutsideValidityError, match="must be of one length"):
        moving([0.0, 1.0], [0.0])


def test_every_term_of_the_force_by_hand() -> None:
    axis = MotionPhysics(
        moving_mass=2.0, viscous_friction=10.0, coulomb_friction=3.0, viscous_difference=4.0, stribeck_friction=1.0,
        stribeck_velocity=0.5, force_offset=0.25, force_gain_error=0.1,
    )  # fmt: skip
    low = np.exp(-1.0)  # at 0.5 m/s
    expected = 1.1 * np.array([2.0 + 5.0 + 1.0 + 3.0 + low, -2.0 - 5.0 + 1.0 - 3.0 - low, 0.0]) + 0.25
    np.testing.assert_allclose(forces(axis, moving([0.5, -0.5, 0.0], [1.0, -1.0, 0.0])), expected, rtol=1e-14)


@pytest.mark.parametrize("delay", [-0.0131, -0.0005, 0.0005, 0.003, 0.0131])
def test_a_recorded_force_is_that_of_a_delay_later(delay) -> None:
    time = np.arange(2000) / 1000.0
    axis = MotionPhysics(moving_mass=1.0, force_delay=delay)
    recorded = forces(axis, moving(np.zeros(2000), np.sin(2 * np.pi * 5.0 * time)))
    later = np.sin(2 * np.pi * 5.0 * (time + delay))
    np.testing.assert_allclose(recorded[20:-20], later[20:-20], atol=1e-4)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"moving_mass": 0.0}, "moving_mass must be positive; got 0.0"),
        ({"stribeck_velocity": -1.0}, "stribeck_velocity must be positive; got -1.0"),
        ({"coulomb_friction": -1.0}, "coulomb_friction must not be negative; got -1.0"),
        ({"viscous_friction": -1.0}, "viscous_friction must not be negative; got -1.0"),
        ({"force_delay": float("nan")}, "force_delay must be finite; got nan"),
    ],
)
def test_no_axis_is_like_that(changes, sentence) -> None:
    with pytest.raises(OutsideValidityError, match=sentence):
        MotionPhysics(**({"moving_mass": 1.0} | changes))


# --- files -----------------------------------------------------------------------------------------------------------


def test_a_motion_model_is_read_back_and_built(tmp_path) -> None:
    write_model_file(tmp_path / "axis.toml", FILE)
    read = read_model_file(tmp_path / "axis.toml")
    assert read == FILE
    model = read.build_motion()
    assert model.parameters == MotionParameters(moving_mass=95.0, viscous_friction=200.0)
    assert model.physics == MotionPhysics(
        moving_mass=95.0,
        viscous_friction=model.physics.viscous_friction,
        coulomb_friction=20.0,
        stribeck_friction=-10.0,
        stribeck_velocity=0.02,
    )
    assert model.physics.viscous_friction == pytest.approx(200.0 * np.exp(0.5), rel=1e-12)


def test_a_model_without_effects_is_the_axis_as_stated() -> None:
    model = AxisDescription("motion", STATED).build_motion()
    motion = moving([0.1, -0.2], [1.0, 0.0])
    np.testing.assert_allclose(model.forces(motion), [115.0, -40.0], rtol=1e-14)
    assert model == MotionModel.of(MotionParameters(moving_mass=95.0, viscous_friction=200.0))


def test_an_effect_of_a_drive_is_none_of_a_motion() -> None:
    with pytest.raises(OutsideValidityError, match=r"one of coulomb-friction, force-offset, .*; got 'added-mass'"):
        AxisDescription("motion", STATED, effects={"added-mass": {"mass_kg": 1.0}}).build_motion()


def test_the_two_kinds_of_model_are_not_taken_for_each_other() -> None:
    with pytest.raises(
        OutsideValidityError, match=r"natural frequencies, of the family lumped, .*; got a motion model"
    ):
        AxisDescription("motion", STATED).build()
    with pytest.raises(OutsideValidityError, match="expected a model of the family motion; got one of hybrid"):
        AxisDescription("hybrid", bundled("hybrid").parameters.to_file_names()).build_motion()


@pytest.mark.parametrize("command", ["modes", "simulate", "identify"])
def test_commands_that_need_a_drive_refuse_a_motion_model(tmp_path, preload, command, published_data) -> None:
    path = tmp_path / "axis.toml"
    write_model_file(path, AxisDescription("motion", STATED))
    arguments = {
        "modes": [str(path), "--position-mm", "300"],
        "simulate": [str(path), "--out", str(tmp_path / "trial.session.h5")],
        "identify": [str(published_data / "nguyen_table2.csv"), "--model", str(path)],
    }
    assert_refused(preload(command, *arguments[command]), "lumped, hybrid, receptance, transmission-line; got")


def test_torque_becomes_force_only_with_a_stated_lead() -> None:
    stated = MotionParameters(moving_mass=95.0, screw_lead=0.02)
    np.testing.assert_allclose(stated.force_of_torque(np.array([1.0])), 100.0 * np.pi, rtol=1e-14)
    with pytest.raises(OutsideValidityError, match="needs screw_lead_m in the motion model"):
        MotionParameters(moving_mass=95.0).force_of_torque(np.array([1.0]))
    with pytest.raises(OutsideValidityError, match="screw_lead_m must be positive and finite; got 0"):
        MotionParameters(moving_mass=95.0, screw_lead=0.0)
