"""The registry of drive models, and sessions of every family judged by the product's own road."""

from dataclasses import fields, replace
from datetime import UTC, datetime

import numpy as np
import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.models.families import FAMILIES, build_model, family_named
from monitor_core.models.generator import MOTOR_END, SimulationSettings, condition_grid, simulate_session
from monitor_core.models.generator.scan import GuideFriction
from monitor_core.models.parameters import name_in_file
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, ResponsePoint
from monitor_core.models.published.lumped import feature_coefficients
from monitor_core.pipeline import AxisSettings, calibrate_from_measurements, check_window, judge_measurement
from monitor_core.recording import ExcitationSource
from monitor_core.recordings.model_file import read_model_file
from tests.conftest import PROJECT_ROOT

NAMES = [family.name for family in FAMILIES]
FILES = {name: read_model_file(PROJECT_ROOT / "replay_data" / "models" / f"{name}.toml") for name in NAMES}
DAMPINGS = ("loss_factor", "_ns_per_m", "_nms_per_rad")


def axis_of(name, *, damping=1.0):
    """Return the paper's axis, with a share of its damping, and conditions at three positions."""
    stated = FILES[name].parameters
    values = {key: value * (damping if key.endswith(DAMPINGS) else 1.0) for key, value in stated.items()}
    preload = 200.0 if "dynamic_load_rating_n" in values else None
    length = values["screw_length_m"]
    return build_model(name, values), condition_grid([share * length for share in (0.25, 0.5, 0.75)], (preload,))


def simulated(model, conditions, settings, seed=4):
    started_at = datetime(2025, 3, 1, tzinfo=UTC)
    return simulate_session(
        model, conditions, settings, axis_id="axis", started_at=started_at, rng=np.random.default_rng(seed)
    )


# --- registry --------------------------------------------------------------------------------------------------------


def test_families_are_those_of_the_file_format():
    assert NAMES == ["lumped", "hybrid", "receptance", "transmission-line"]


@pytest.mark.parametrize("name", NAMES)
def test_a_model_is_built_from_names_with_units_and_says_them_back(name):
    model = build_model(name, FILES[name].parameters)
    assert type(model.parameters) is family_named(name).parameters
    assert FILES[name].parameters.items() <= model.parameters.to_file_names().items()
    for item in fields(model.parameters):
        stated = FILES[name].parameters.get(name_in_file(item.name))
        assert stated is None or getattr(model.parameters, item.name) == stated


def test_an_unknown_family_is_refused_with_the_known_ones():
    with pytest.raises(OutsideValidityError) as caught:
        build_model("spring", {})
    assert str(caught.value) == ("family must be one of lumped, hybrid, receptance, transmission-line; got 'spring'")


@pytest.mark.parametrize("name", NAMES)
def test_missing_unknown_and_impossible_parameters_are_refused(name):
    values = dict(FILES[name].parameters)
    with pytest.raises(OutsideValidityError, match="needs table_mass_kg"):
        build_model(name, {key: value for key, value in values.items() if key != "table_mass_kg"})
    with pytest.raises(OutsideValidityError, match="no parameter table_mass;"):
        build_model(name, values | {"table_mass": 1.0})
    with pytest.raises(OutsideValidityError, match=r"table_mass_kg must be positive and finite; got -1\.0 kg"):
        build_model(name, values | {"table_mass_kg": -1.0})


# --- sessions --------------------------------------------------------------------------------------------------------


def first_pole(model, condition, source):
    return next(m for m in model.natural_frequencies(condition, MOTOR_END[source]) if m.frequency > 0.0)


def judged(name, settings):
    """Yield measured frequency and that of the model's pole, whose windows must all pass the gates.

    Tian's axis with a free motor has its first mode at 24 Hz, below where the road looks unless told.
    """
    model, conditions = axis_of(name)
    session = simulated(model, conditions, settings)
    for condition, measurement in zip(conditions, session.measurements, strict=True):
        truth = first_pole(model, condition, settings.excitation_source).frequency
        axis = AxisSettings(search_band=(0.6 * truth, 1.5 * truth))
        windows = session.windows_of(measurement)
        assert all(check_window(window, axis, None) is None for window in windows)
        yield judge_measurement(windows, axis, None).modal.mode.frequency, truth


@pytest.mark.release
@pytest.mark.parametrize("source", MOTOR_END)
@pytest.mark.parametrize("name", NAMES)
def test_the_road_finds_the_mode_of_every_family(name, source):
    for frequency, truth in judged(name, replace(SimulationSettings(), excitation_source=source)):
        assert abs(frequency.value - truth) < 3.0 * frequency.standard_uncertainty
        assert frequency.standard_uncertainty < 1e-4 * truth


@pytest.mark.release
@pytest.mark.parametrize("name", NAMES)
def test_friction_of_5_newtons_moves_the_mode_by_less_than_four_tenths_of_a_hertz(name):
    for frequency, truth in judged(name, replace(SimulationSettings(), friction=GuideFriction(5.0))):
        assert -3.0 * frequency.standard_uncertainty < frequency.value - truth < 0.4


@pytest.mark.parametrize("source", MOTOR_END)
@pytest.mark.parametrize("name", NAMES)
def test_the_modes_that_friction_moves_are_the_poles_of_the_model(name, source):
    """Pole and undamped mode differ in the second order of the damping."""
    model, conditions = axis_of(name)
    for condition in conditions:
        modes = model.normal_modes(condition, MOTOR_END[source])
        pole = first_pole(model, condition, source)
        assert pole.frequency == pytest.approx(modes.frequency[1], rel=2.0 * modes.damping_ratio[1] ** 2 + 1e-9)
        assert pole.damping_ratio == pytest.approx(modes.damping_ratio[1], rel=0.02)


@pytest.mark.release
@pytest.mark.parametrize("name", NAMES)
def test_the_record_has_the_frequency_response_of_the_family(name):
    """Ratio of the transforms of windows from rest to rest, from 20 Hz to half as much again as the first mode.

    Above it Tian's second mode, damped by 0.005 %, rings on beyond windows of eight seconds.
    """
    model, (_, condition, _) = axis_of(name)
    settings = replace(
        SimulationSettings(), torque_noise=0.0, acceleration_noise=0.0, window_duration=8.0, windows_per_measurement=4
    )
    windows = simulated(model, (condition,), settings).windows
    frequency = np.fft.rfftfreq(settings.n_samples, 1.0 / settings.sample_rate)
    near = (frequency > 20.0) & (frequency < 1.5 * first_pole(model, condition, ExcitationSource.SENSOR).frequency)
    excitation, response = (
        np.array([np.fft.rfft(getattr(w, channel))[near] for w in windows]) for channel in ("excitation", "response")
    )
    measured = np.sum(response * excitation.conj(), axis=0) / np.sum(np.abs(excitation) ** 2, axis=0)
    expected = model.frequency_response(
        frequency[near],
        condition,
        excitation=ExcitationPoint.TORQUE_AT_SCREW,
        response=ResponsePoint.ACCELERATION_AT_TABLE,
    )
    assert expected.quantity == "torque_accelerance"
    assert np.abs(measured / expected.response - 1.0).max() < 0.01


def test_calibration_on_a_simulated_session_gives_the_closed_k3_back():
    """The torque at the screw moves the screw's inertia J too, where Eq. (6) clamps it: k3 J/(J + i² Σm).

    Damped at the guides: loss factors change the stiffness of the series in their second order, k3 by 0.01 %.
    """
    model = build_model("lumped", {**FILES["lumped"].parameters, "loss_factor": 0.0, "table_damping_ns_per_m": 800.0})
    conditions = condition_grid((0.2, 0.4, 0.6, 0.8), (100.0, 200.0, 300.0, 400.0))
    session = simulated(model, conditions, SimulationSettings())
    modal = [judge_measurement(session.windows_of(name), AxisSettings(), None).modal for name in session.measurements]
    calibration = calibrate_from_measurements(modal, settings=AxisSettings())
    index = calibration.parameter_names.index("k3")
    value = calibration.parameters.values[index]
    uncertainty = np.sqrt(calibration.parameters.covariance[index, index])
    parameters = model.parameters
    moving = parameters.table_mass + parameters.screw_mass + parameters.nut_mass
    inertia = parameters.screw_inertia
    share = inertia / (inertia + parameters.transmission_ratio**2 * moving)
    expected = share * feature_coefficients(parameters).k3
    assert uncertainty < 0.002 * expected
    assert abs(value - expected) < 2.0 * uncertainty


def test_a_model_without_preload_law_takes_no_preload():
    model, _ = axis_of("hybrid")
    with pytest.raises(OutsideValidityError, match="dynamic_load_rating_n"):
        simulated(model, (DriveConditions(0.3, preload=200.0),), SimulationSettings())
