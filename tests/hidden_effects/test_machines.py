"""Machines of five sizes: both plants move each alike, the model agrees with them, and what is measured fits each."""

import itertools
import math

import numpy as np
import pytest

from monitor_core.models.extended import ExtendedModel, ResponseCase, prepare_lines, responses
from monitor_core.models.protocol import ExcitationPoint, MotorEnd, ResponsePoint
from monitor_core.recordings.model_file import parse_model
from tests.hidden_effects.cases import baseline_text
from tests.hidden_effects.designs import DESIGNS
from tests.hidden_effects.frf_file import stated_conditions
from tests.hidden_effects.machines import BENCH, MACHINES, jittered, scaled
from tests.hidden_effects.situations import Situation
from tests.hidden_effects.truth import transmission_line
from tests.hidden_effects.truth.axis import Axis, Setting
from tests.hidden_effects.truth.finite_elements import plant
from tests.hidden_effects.truth.measurement import measured_lines
from tests.hidden_effects.truth.oscillators import frequency_response

each_machine = pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.name)


def inner_settings(machine) -> list[Setting]:
    length, level = machine.parts.screw_length, machine.preload
    return [
        Setting(position=0.21 * length, preload=0.6 * level),
        Setting(position=0.52 * length, preload=level, payload=machine.payload),
        Setting(position=0.87 * length, preload=1.6 * level),
    ]


@each_machine
def test_both_plants_and_the_model_agree_on_every_size(machine) -> None:
    """Finite elements, travelling waves and the product's model: the median line is within what their losses differ."""
    settings, frequency = inner_settings(machine), measured_lines(machine.recorder)
    axis = Axis(parts=machine.parts)
    elements = [frequency_response(plant(axis, each), 2.0 * math.pi * frequency)[:2] for each in settings]
    waves = [transmission_line.frequency_response(axis, each, frequency) for each in settings]
    model = ExtendedModel.of(parse_model(baseline_text(machine.parts, "receptance"), "machine").build().parameters)
    cases = [
        ResponseCase(frequency, stated_conditions(each), ExcitationPoint.TORQUE_AT_MOTOR, point, MotorEnd.FREE)
        for each in settings
        for point in (ResponsePoint.ACCELERATION_AT_TABLE, ResponsePoint.ANGLE_AT_MOTOR)
    ]
    modelled = responses(model.physics, prepare_lines(cases)).reshape(len(settings), 2, -1)
    low = frequency < 3.0 * machine.first_frequency
    for other in (np.array(waves), modelled):
        apart = np.abs(np.log(np.array(elements) / other))
        assert np.median(apart[..., low]) < 1e-3
        assert np.median(apart) < 3e-3


@each_machine
def test_the_main_mode_is_inside_the_band_with_room_on_both_sides(machine) -> None:
    frequency = measured_lines(machine.recorder)
    setting = inner_settings(machine)[1]
    fine = np.linspace(frequency[0], frequency[-1], 4000)
    response = np.abs(frequency_response(plant(Axis(parts=machine.parts), setting), 2.0 * math.pi * fine)[0])
    peak = fine[np.argmax(response)]
    assert 3.0 * frequency[0] < peak < frequency[-1] / 3.0
    assert peak == pytest.approx(machine.first_frequency, rel=0.35)  # one spring and one mass, and a payload less


def test_sizes_are_apart_and_rise_while_frequencies_fall() -> None:
    masses = [machine.moving_mass for machine in MACHINES]
    assert all(larger > 2.5 * smaller for smaller, larger in itertools.pairwise(masses))
    frequencies = [machine.first_frequency for machine in MACHINES]
    assert frequencies == sorted(frequencies, reverse=True)
    assert (masses[0], masses[-1]) == (4.0, 1450.0)
    lengths = [machine.parts.screw_length for machine in MACHINES]
    assert (lengths[0], lengths[-1]) == (0.3, 3.0)


@each_machine
def test_no_two_of_a_size_are_the_same_and_their_nuts_keep_contact(machine) -> None:
    rng = np.random.default_rng(4)
    first, second = jittered(machine, rng), jittered(machine, rng)
    assert first.parts != second.parts
    assert first.moving_mass == pytest.approx(machine.moving_mass, rel=0.4)
    assert 0.03 < machine.preload / (10.0 * machine.parts.rated_preload) < 0.1  # of the load rating, as catalogues say


def test_units_go_with_mass_frequency_and_length() -> None:
    assert all(scaled(unit, BENCH) == 1.0 for unit in ("kg", "N/m", "N·m·s/rad"))
    gantry = MACHINES[-1]
    assert scaled("m", gantry) == pytest.approx(3.0 / 0.971)
    assert scaled("N/m", gantry) == pytest.approx(
        scaled("kg", gantry) * (gantry.first_frequency / BENCH.first_frequency) ** 2
    )


@each_machine
def test_designs_fit_the_screw_and_avoid_the_lead(machine, subtests: pytest.Subtests) -> None:
    for name in DESIGNS:
        with subtests.test(name=name):
            settings = DESIGNS[name](machine, np.random.default_rng(1))
            length, lead = machine.parts.screw_length, machine.parts.screw_lead
            places = np.array([setting.position for setting in settings])
            assert np.all((places > 0.05 * length) & (places < 0.95 * length))
            within = places % lead / lead
            assert np.all((within > 0.02) & (within < 0.98))
            assert np.ptp(within) > 0.3
            assert [setting.order for setting in settings] == sorted(setting.order for setting in settings)
            assert len(settings) == {"rich": 31, "usual": 21, "poor": 12}[name]
            varied = {setting.payload for setting in settings}, {setting.excitation_rms for setting in settings}
            assert [len(values) for values in varied] == {"rich": [2, 3], "usual": [2, 2], "poor": [1, 1]}[name]
            again = DESIGNS[name](machine, np.random.default_rng(2))
            assert settings != again


@each_machine
def test_no_nut_is_drawn_that_hardens_beyond_any(machine) -> None:
    """The largest plausible size of the effect is 5 over the square of what the preload deflects the nut."""
    drawn = Situation(machine=machine).sized({"cubic_nut_stiffness": 1.7e12, "relative_stiffness_per_m2": 1.7e12})
    deflection = machine.preload / machine.nut_rigidity
    assert len(set(drawn.values())) == 1
    assert drawn["cubic_nut_stiffness"] * deflection**2 <= 4.0
