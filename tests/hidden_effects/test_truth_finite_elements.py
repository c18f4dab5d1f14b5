"""The finite-element plant against closed forms, laws, its own matrices solved directly, and the model under test."""

import ast
import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

from monitor_core.effects import with_effects
from monitor_core.models.extended import ExtendedModel, ResponseCase, prepare_lines, responses
from monitor_core.models.protocol import ExcitationPoint, MotorEnd, ResponsePoint
from monitor_core.recordings.frf_set import read_frf_set
from monitor_core.recordings.model_file import parse_model, read_model_file
from tests.conftest import canary
from tests.hidden_effects import truth
from tests.hidden_effects.cases import FAMILIES, all_kinds, baseline_text, design, draw_case
from tests.hidden_effects.frf_file import observations, stated_conditions, write_case
from tests.hidden_effects.kinds import KINDS
from tests.hidden_effects.truth.axis import Axis, Hidden, Parts, Setting
from tests.hidden_effects.truth.finite_elements import assemble, nut_stiffness, plant, respond, transmission
from tests.hidden_effects.truth.maxwell import maxwell_chain
from tests.hidden_effects.truth.measurement import (
    SAMPLE_RATE,
    Scatter,
    estimate,
    measure,
    measured_lines,
    random_torque,
)
from tests.hidden_effects.truth.oscillators import frequency_response
from tests.hidden_effects.truth.oscillators_stepped import FedBack, stepped_motion

HEALTHY = Axis(parts=Parts())
MIDDLE = Setting(position=0.476, preload=250.0, payload=4.0, temperature_deviation=12.0, order=0.7)
LINES = measured_lines()
#: A hundred times as stiff as a drive is, and hardly damped: rigid to some 1e-4 below 100 Hz.
RIGID = Parts(
    bearing_stiffness=1e10, bracket_stiffness=2e10, nut_rigidity=5e10, coupling_stiffness=1e5, youngs_modulus=2e13,
    shear_modulus=8e12, bearing_damping=1.0, nut_damping=1.0, coupling_damping=1e-6,
)  # fmt: skip


def turning_inertia(parts: Parts, payload: float = 0.0) -> float:
    """Everything that moves, as seen by the rotor. [kg·m²]."""
    polar = math.pi / 32.0 * parts.screw_diameter**4
    screw = parts.density * polar * parts.screw_length
    mass = parts.table_mass + parts.nut_mass + payload
    return parts.motor_inertia + parts.coupling_inertia + screw + transmission(parts) ** 2 * mass


def low_torque(n_settings: int, seconds: float, rms: float, highest: float = 400.0) -> np.ndarray:
    """Random torque from 20 Hz to a highest frequency."""
    rng = np.random.default_rng(5)
    n = round(seconds * SAMPLE_RATE)
    frequency = np.fft.rfftfreq(n, 1.0 / SAMPLE_RATE)
    excited = (frequency > 20.0) & (frequency < highest)
    spectrum = np.zeros((n_settings, frequency.size), dtype=complex)
    spectrum[:, excited] = rng.standard_normal((n_settings, excited.sum(), 2)) @ [1.0, 1j]
    torque = np.fft.irfft(spectrum, n=n, axis=1)
    return rms * torque / np.std(torque, axis=1, keepdims=True)


def direct_response(axis: Axis, setting: Setting, frequency: np.ndarray) -> np.ndarray:
    """Displacement of the table and angle of the rotor per torque from the whole matrices, (2, n_lines)."""
    structure, chain = assemble(axis, setting), maxwell_chain(axis.hidden.loss_factor)
    steel = maxwell_chain(axis.hidden.screw_loss_factor).stiffness(frequency)
    path, answers = structure.path, []
    for line, factor, of_steel in zip(frequency, chain.stiffness(frequency), steel, strict=True):
        s = 2j * math.pi * line
        dynamic = s**2 * structure.mass + s * structure.damping + structure.stiffness + of_steel * structure.screw
        for joint in structure.joints:
            dynamic += factor * joint.stiffness * np.outer(joint.direction, joint.direction)
        nut = factor * path.nut + s * path.damping
        behind = 0.0 if math.isinf(path.bracket) else 1.0 / (factor * path.bracket)
        dynamic += np.outer(path.direction, path.direction) / (1.0 / nut + behind)
        moved = scipy.linalg.solve(dynamic, structure.rotor)
        answers.append([structure.table @ moved, structure.rotor @ moved])
    return np.array(answers).T


def test_the_truth_shares_nothing_with_the_product():
    for file in Path(truth.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                assert name.partition(".")[0] not in {"monitor_core", "service"}, file.name
                assert not name.startswith("tests.") or name.startswith("tests.hidden_effects.truth"), file.name


def test_the_free_screw_has_the_frequencies_of_a_rod():
    """Axially fixed–free, c/4L, and in torsion free–free, n c/2L; 0.05 % is what the mesh is made for."""
    parts = Parts(bearing_stiffness=1e14, bracket_stiffness=1e-6, coupling_stiffness=1e-9)
    structure = assemble(Axis(parts=parts), MIDDLE)
    square = scipy.linalg.eigh(structure.whole_stiffness, structure.mass, eigvals_only=True, subset_by_index=[0, 12])
    found = np.sqrt(np.abs(square)) / (2.0 * math.pi)
    axial, torsional = (math.sqrt(modulus / parts.density) for modulus in (parts.youngs_modulus, parts.shear_modulus))
    length = parts.screw_length
    for expected in (axial / (4.0 * length), torsional / (2.0 * length), torsional / length):
        assert np.min(np.abs(found / expected - 1.0)) < 5e-4


def test_a_rigid_drive_accelerates_as_one_inertia():
    parts = replace(RIGID, table_damping=1e-3, motor_damping=1e-9)
    omega = 2.0 * math.pi * np.array([5.0, 15.0])
    acceleration, angle = frequency_response(plant(Axis(parts=parts), MIDDLE), omega)[:2]
    angular = 1.0 / turning_inertia(parts, MIDDLE.payload)
    np.testing.assert_allclose(-(omega**2) * angle, angular, rtol=1e-4)
    np.testing.assert_allclose(acceleration, transmission(parts) * angular, rtol=1e-4)


def test_a_rigid_drive_on_a_servo_is_one_oscillator():
    """Through torque, time and Welch's average: x = T / (k − ω² J + jωc) with the damper of the rotor alone."""
    parts = replace(RIGID, table_damping=1e-3, motor_damping=0.06)
    axis = Axis(parts=parts, hidden=Hidden(servo_stiffness=60.0))
    setting = replace(MIDDLE, payload=0.0)
    quiet = Scatter(sensor_noise=0.0, gain=0.0)
    _, angle = measure(axis, [setting], [setting], quiet, np.random.default_rng(2), respond=respond)
    omega = 2.0 * math.pi * angle.frequency
    closed = 1.0 / (60.0 - omega**2 * turning_inertia(parts) + 1j * omega * 0.06)
    near = (angle.frequency > 50.0) & (angle.frequency < 100.0)  # the resonance is at 72 Hz
    standardised = np.abs(angle.response - closed)[near] / angle.standard_deviation[near]
    assert np.mean(standardised**2) == pytest.approx(2.0, abs=1.2)  # real and imaginary part, 14 lines
    assert np.median(np.abs(angle.response / closed - 1.0)[angle.frequency < 200.0]) < 2e-3


@pytest.mark.parametrize("on_nut", [
    {}, {"nut_mass_before_bracket": 1.3, "nut_absorber_mass": 0.2, "screw_loss_factor": 0.03, "motor_damping": 0.01},
])  # fmt: skip
def test_reduced_plants_answer_as_their_whole_matrices(on_nut):
    """Every linear mechanism that matrices can hold, at once."""
    hidden = Hidden(
        **on_nut, added_mass=0.7, loss_factor=0.02, far_bearing_stiffness=2e7, base_compliance=2e-9,
        guide_stiffness=2e5, servo_stiffness=3.0, absorber_mass=0.3, series_compliance=1e-9,
        torsional_compliance_share=0.2,
    )  # fmt: skip
    frequency = np.linspace(24.0, 1500.0, 40)
    reduced = frequency_response(plant(Axis(parts=Parts(), hidden=hidden), MIDDLE), 2.0 * math.pi * frequency)
    whole = direct_response(Axis(parts=Parts(), hidden=hidden), MIDDLE, frequency)
    whole[0] *= -((2.0 * math.pi * frequency) ** 2)
    np.testing.assert_allclose(
        reduced[:2], whole, atol=2e-4 * np.median(np.abs(whole), axis=1)[:, None].max(), rtol=2e-3
    )


def test_the_drive_is_reciprocal_and_passive():
    hidden = Hidden(loss_factor=0.05, base_compliance=1e-9, absorber_mass=0.2, far_bearing_stiffness=1e7)
    drive = plant(Axis(parts=Parts(), hidden=hidden), MIDDLE)
    omega = 2.0 * math.pi * np.geomspace(5.0, 3000.0, 200)
    by_torque, by_force = (frequency_response(drive, omega, which) for which in (0, 1))
    np.testing.assert_allclose(by_torque[2], 1j * omega * by_force[1], rtol=1e-6)
    assert np.all(by_force[2].real > 0.0)  # a force on the table never finds it giving energy
    assert np.all((1j * omega * by_torque[1]).real > 0.0)


def test_the_maxwell_chain_loses_evenly_and_stiffens_as_it_must():
    """Over a band of constant loss factor η stiffness rises by 2η/π per unit of ln ω (Kramers and Kronig)."""
    for loss_factor in (0.003, 0.05):
        chain = maxwell_chain(loss_factor)
        stiffness = chain.stiffness(np.geomspace(20.0, 1500.0, 50))
        np.testing.assert_allclose(stiffness.imag / stiffness.real, loss_factor, rtol=0.1)
        assert chain.stiffness(np.array([100.0]))[0].real == pytest.approx(1.0, abs=1e-12)
        rise = math.log(stiffness[-1].real / stiffness[0].real) / math.log(1500.0 / 20.0)
        assert rise == pytest.approx(2.0 * loss_factor / math.pi, rel=0.1)


#: What is felt of each mechanism; companions act with the field that they stand beside.
FELT = {
    "added_mass": {"added_mass": 1.0}, "payload_error": {"payload_error": 1.0},
    "series_compliance": {"series_compliance": 2e-9}, "far_bearing_stiffness": {"far_bearing_stiffness": 1e7},
    "axial_modulus_factor": {"axial_modulus_factor": 0.9},
    "torsional_compliance_share": {"torsional_compliance_share": 0.2}, "loss_factor": {"loss_factor": 0.02},
    "guide_stiffness": {"guide_stiffness": 1e6}, "preload_exponent_change": {"preload_exponent_change": 0.2},
    "thermal_preload": {"thermal_preload": 4.0}, "thermal_stiffness": {"thermal_stiffness": -1e-3},
    "periodic_preload": {"periodic_preload": 0.3},
    "position_offset": {"position_offset": 0.02}, "mounting_frequency": {"mounting_frequency": 3000.0},
    "base_compliance": {"base_compliance": 2e-9}, "servo_stiffness": {"servo_stiffness": 5.0},
    "structure_residue": {"structure_residue": 1e-4}, "absorber_mass": {"absorber_mass": 0.3},
    "preload_drift": {"preload_drift": 0.3},
    "periodic_phase": {"periodic_preload": 0.3, "periodic_phase": 1.0},
    "mounting_damping_ratio": {"mounting_frequency": 3000.0, "mounting_damping_ratio": 0.2},
    "base_frequency": {"base_compliance": 2e-9, "base_frequency": 90.0},
    "base_damping_ratio": {"base_compliance": 2e-9, "base_damping_ratio": 0.1},
    "structure_frequency": {"structure_residue": 1e-4, "structure_frequency": 400.0},
    "structure_damping_ratio": {"structure_residue": 1e-4, "structure_damping_ratio": 0.1},
    "absorber_frequency": {"absorber_mass": 0.3, "absorber_frequency": 400.0},
    "absorber_damping_ratio": {"absorber_mass": 0.3, "absorber_damping_ratio": 0.1},
    "absorber_frequency_slope": {"absorber_mass": 0.3, "absorber_frequency_slope": 1.0},
    "nut_absorber_mass": {"nut_absorber_mass": 0.3},
    "nut_absorber_frequency": {"nut_absorber_mass": 0.3, "nut_absorber_frequency": 400.0},
    "nut_absorber_damping_ratio": {"nut_absorber_mass": 0.3, "nut_absorber_damping_ratio": 0.1},
    "rotor_absorber_inertia": {"rotor_absorber_inertia": 3e-5},
    "rotor_absorber_frequency": {"rotor_absorber_inertia": 3e-5, "rotor_absorber_frequency": 400.0},
    "rotor_absorber_damping_ratio": {"rotor_absorber_inertia": 3e-5, "rotor_absorber_damping_ratio": 0.1},
    "screw_end_absorber_mass": {"screw_end_absorber_mass": 2.0},
    "screw_end_absorber_frequency": {"screw_end_absorber_mass": 2.0, "screw_end_absorber_frequency": 400.0},
    "screw_end_absorber_damping_ratio": {"screw_end_absorber_mass": 2.0, "screw_end_absorber_damping_ratio": 0.1},
    "nut_mass_before_bracket": {"nut_mass_before_bracket": 2.0}, "screw_loss_factor": {"screw_loss_factor": 0.02},
    "motor_damping": {"motor_damping": 0.01}, "bend_eccentricity": {"bend_eccentricity": 0.02},
    "coupling_crack": {"coupling_crack": 5.0},
    "coupling_crack_phase": {"coupling_crack": 5.0, "coupling_crack_phase": 1.0},
    "wear": {"wear": 0.4, "wear_width": 0.5}, "wear_at": {"wear": 0.4, "wear_width": 0.5, "wear_at": 0.1},
    "wear_width": {"wear": 0.4, "wear_at": 0.1, "wear_width": 0.5},
    "pitch_error": {"pitch_error": 0.05}, "pitch_waves": {"pitch_error": 0.05, "pitch_waves": 1.5},
    "lost_mass": {"lost_mass": 2.0},
    "belt_ratio": {"belt_ratio": 2.0}, "belt_stiffness_share": {"belt_stiffness_share": 0.3},
}  # fmt: skip
#: No motion in time has it.
ON_LINES = {"constant_loss_factor"}
IN_TIME = {
    "torque_delay",
    "torque_limit",
    "response_delay",
    "angle_delay",
    "guide_friction",
    "cubic_nut_stiffness",
    "nut_softening",
    "nut_softening_deflection",
    "nut_backlash",
    "nut_contact_loss",
    "nut_contact_deflection",
}


def test_the_nut_follows_its_preload_and_all_that_changes_it():
    """Cube root of what is left of the preload, at the rated 400 N 0.8 K."""
    setting, rated = replace(MIDDLE, order=0.5), 0.8 * Parts().nut_rigidity
    for hidden, preload in (
        (Hidden(), 250.0),
        (Hidden(preload_drift=0.3), 250.0 * 0.85),
        (Hidden(thermal_preload=-2.0), 250.0 - 24.0),
        (Hidden(periodic_preload=0.2, periodic_phase=math.pi), 250.0 * (1.0 - 0.2 * math.cos(2.0 * math.pi / 3.0))),
    ):
        found = nut_stiffness(Axis(parts=Parts(), hidden=hidden), setting)
        assert found == pytest.approx(rated * (preload / 400.0) ** (1.0 / 3.0), rel=1e-12)
    steeper = Axis(parts=Parts(), hidden=Hidden(preload_exponent_change=0.1))
    assert nut_stiffness(steeper, setting) == pytest.approx(rated * (250.0 / 400.0) ** (1.0 / 3.0 + 0.1), rel=1e-12)


def test_a_mass_that_is_lost_at_once_is_as_much_less_as_one_that_goes_steadily():
    omega = 2.0 * math.pi * LINES
    at_once, steadily = (
        frequency_response(plant(Axis(parts=Parts(), hidden=hidden), MIDDLE), omega)
        for hidden in (Hidden(lost_mass=2.0, lost_at=0.5), Hidden(lost_mass=2.0 / MIDDLE.order))
    )
    np.testing.assert_allclose(at_once, steadily, rtol=1e-12)


def test_every_hidden_field_is_looked_at():
    assert set(FELT) | IN_TIME | ON_LINES | {"lost_at"} == {item.name for item in fields(Hidden)}


@pytest.mark.parametrize("field", canary(FELT))
def test_a_mechanism_changes_the_response_and_vanishes_with_its_size(field, monkeypatch):
    if field == "screw_loss_factor":  # it stands in the place of what the steel loses otherwise
        monkeypatch.setattr("tests.hidden_effects.truth.finite_elements.SCREW_LOSS_TIME", 0.0)
    values = FELT[field]
    omega = 2.0 * math.pi * LINES

    def answer(**hidden: float) -> np.ndarray:
        return frequency_response(plant(Axis(parts=Parts(), hidden=Hidden(**hidden)), MIDDLE), omega)[:2]

    def distance(response: np.ndarray, other: np.ndarray) -> float:
        return float(np.median(np.max(np.abs(response / other - 1.0), axis=0)))

    default = {item.name: item.default for item in fields(Hidden)}
    without = {name: value for name, value in values.items() if name != field}
    reference, felt = answer(**without), distance(answer(**values), answer(**without))
    assert felt > 1e-5
    if math.isinf(default[field]):
        little = values[field] * 100.0  # acts with its inverse square
    else:
        little = default[field] + 1e-4 * (values[field] - default[field])
    assert distance(answer(**{**without, field: little}), reference) < 2e-3 * felt + 1e-7


def test_the_sensor_reads_what_its_mounting_passes_on_and_the_table_rides_on_the_structure():
    """Transmissibility of a mass on spring and damper; one modal term, driven by the force torque over i."""
    hidden = Hidden(mounting_frequency=2500.0, mounting_damping_ratio=0.06, structure_residue=1e-3)
    omega = 2.0 * math.pi * LINES
    healthy = frequency_response(plant(HEALTHY, MIDDLE), omega)
    natural = 2.0 * math.pi * hidden.structure_frequency
    term = hidden.structure_residue / transmission(Parts())
    term /= natural**2 - omega**2 + 2j * hidden.structure_damping_ratio * natural * omega
    ratio = LINES / 2500.0
    passed = (1.0 + 2j * 0.06 * ratio) / (1.0 - ratio**2 + 2j * 0.06 * ratio)
    found = frequency_response(plant(Axis(parts=Parts(), hidden=hidden), MIDDLE), omega)
    np.testing.assert_allclose(found[0], (healthy[0] - omega**2 * term) * passed, rtol=1e-7)
    np.testing.assert_allclose(found[1], healthy[1], rtol=1e-7)


@pytest.mark.parametrize(("channel", "name"), [(0, "response_delay"), (1, "angle_delay")])
def test_a_delayed_channel_alone_is_recorded_late(channel, name):
    torque, delay = random_torque(np.array([0.1]), np.random.default_rng(1)), 0.37 / SAMPLE_RATE
    late = respond(Axis(parts=Parts(), hidden=Hidden(**{name: delay})), [MIDDLE], torque, SAMPLE_RATE)
    prompt = respond(HEALTHY, [MIDDLE], torque, SAMPLE_RATE)
    frequency = np.fft.rfftfreq(torque.shape[1], 1.0 / SAMPLE_RATE)
    seen = (frequency > 30.0) & (frequency < 1500.0)
    ratio = np.fft.rfft(late[channel][0])[seen] / np.fft.rfft(prompt[channel][0])[seen]
    np.testing.assert_allclose(ratio, np.exp(-2j * math.pi * frequency[seen] * delay), rtol=1e-6)
    np.testing.assert_array_equal(late[1 - channel], prompt[1 - channel])


def test_a_delayed_torque_shifts_the_motion_by_a_share_of_a_sample():
    torque, delay = random_torque(np.array([0.1]), np.random.default_rng(1)), 0.37 / SAMPLE_RATE
    late = respond(Axis(parts=Parts(), hidden=Hidden(torque_delay=delay)), [MIDDLE], torque, SAMPLE_RATE)[0]
    prompt = respond(HEALTHY, [MIDDLE], torque, SAMPLE_RATE)[0]
    frequency = np.fft.rfftfreq(torque.shape[1], 1.0 / SAMPLE_RATE)
    seen = (frequency > 30.0) & (frequency < 1500.0)
    ratio = np.fft.rfft(late[0])[seen] / np.fft.rfft(prompt[0])[seen]
    np.testing.assert_allclose(ratio, np.exp(-2j * math.pi * frequency[seen] * delay), rtol=1e-9)


@pytest.mark.release
def test_steps_in_time_agree_with_the_steady_motion():
    """The same plant by another road; the rest is what the anti-aliasing filter and straight lines leave."""
    torque = low_torque(1, 5.0, 0.1, highest=1500.0)
    steady = respond(HEALTHY, [MIDDLE], torque, SAMPLE_RATE)
    stepped = respond(Axis(parts=Parts(), hidden=Hidden(guide_friction=1e-12)), [MIDDLE], torque, SAMPLE_RATE)
    kept = slice(round(1.5 * SAMPLE_RATE), -200)
    for motion, other in zip(stepped, steady, strict=True):
        difference = np.diff(motion - other, 2, axis=1)[0, kept]
        assert np.std(difference) < 2e-4 * np.std(np.diff(other, 2, axis=1)[0, kept])


@pytest.mark.release
@pytest.mark.parametrize("share", [0.5, 3.0])
def test_friction_stops_a_drive_or_slows_it_to_its_terminal_speed(share):
    """T = c ω + i (c_t v + F) with v = i ω once it runs; below i F it does not turn at all."""
    friction, parts = 20.0, Parts(motor_damping=0.01)
    i = transmission(parts)
    torque = np.full((1, round(2.0 * SAMPLE_RATE)), share * i * friction)
    axis = Axis(parts=parts, hidden=Hidden(guide_friction=friction))
    _, angle = respond(axis, [MIDDLE], torque, SAMPLE_RATE)
    late = angle[0, round(1.2 * SAMPLE_RATE) : -400]
    speed = (late[-1] - late[0]) / (late.size - 1) * SAMPLE_RATE
    terminal = max(share - 1.0, 0.0) * i * friction / (parts.motor_damping + i**2 * parts.table_damping)
    assert speed == pytest.approx(terminal, rel=1e-3, abs=1e-9)
    assert np.ptp(late) > 1e-3 or share < 1.0


@pytest.mark.release
def test_what_the_torque_puts_in_friction_and_dampers_take_out():
    """Over a long time: mean of T ω = c ω² + i² c_t ω² + i F |ω| in a rigid drive."""
    parts, friction = replace(RIGID, table_damping=100.0, motor_damping=1e-3), 15.0
    i = transmission(parts)
    torque = low_torque(1, 12.0, 0.1, highest=150.0)
    axis = Axis(parts=parts, hidden=Hidden(guide_friction=friction))
    _, angle = respond(axis, [MIDDLE], torque, SAMPLE_RATE)
    kept = slice(round(SAMPLE_RATE), -400)
    speed = np.gradient(angle[0], 1.0 / SAMPLE_RATE)[kept]
    put_in = np.mean(torque[0, kept] * speed)
    damped = (parts.motor_damping + i**2 * parts.table_damping) * np.mean(speed**2)
    rubbed = i * friction * np.mean(np.abs(speed))
    assert rubbed > 0.5 * put_in
    assert put_in == pytest.approx(damped + rubbed, rel=0.01)


@pytest.mark.release  # compiling its steps takes longer than all others here
@pytest.mark.parametrize(
    ("hidden", "louder"),
    [
        (Hidden(guide_friction=1.0), Hidden(guide_friction=3.0)),
        (Hidden(cubic_nut_stiffness=9e12), Hidden(cubic_nut_stiffness=1e12)),
        (Hidden(nut_softening=0.4), Hidden(nut_softening=0.4, nut_softening_deflection=3e-7)),
        (Hidden(nut_backlash=1e-8), Hidden(nut_backlash=3e-8)),
        (Hidden(nut_contact_loss=0.5), Hidden(nut_contact_loss=0.5, nut_contact_deflection=3e-7)),
    ],
)
def test_forces_fed_back_scale_with_the_motion(hidden, louder):
    """Three times the torque with friction, deflection scale, or inverse square root of β three times as large."""
    torque = low_torque(1, 1.0, 0.1)
    motion, threefold = (
        respond(Axis(parts=Parts(), hidden=of), [MIDDLE], factor * torque, SAMPLE_RATE)[0]
        for of, factor in ((hidden, 1.0), (louder, 3.0))
    )
    linear = respond(HEALTHY, [MIDDLE], torque, SAMPLE_RATE)[0]
    np.testing.assert_allclose(threefold, 3.0 * motion, atol=1e-5 * np.std(motion))
    assert np.std((motion - linear)[0, 2000:]) > 0.01 * np.std(linear)


@pytest.mark.release
@pytest.mark.parametrize(
    ("law", "beta"),
    [
        (Hidden(cubic_nut_stiffness=5e11), 5e11),
        (Hidden(nut_softening=0.8, nut_softening_deflection=3e-6), -0.8 / 3e-6**2),  # far below this deflection
    ],
)
def test_a_bent_nut_answers_as_the_spring_that_gaussian_motion_makes_of_it(law, beta):
    """Stiffness k (1 + 3βσ²) at a deflection of rms σ: Roberts & Spanos, chapter 5, exact for little bending."""
    settings = [replace(MIDDLE, payload=0.0)] * 12
    torque = random_torque(np.full(12, 0.15), np.random.default_rng(4))
    omega = 2.0 * math.pi * np.fft.rfftfreq(torque.shape[1], 1.0 / SAMPLE_RATE)[1:]
    deflection = np.fft.rfft(torque)[:, 1:] * frequency_response(plant(HEALTHY, settings[0]), omega)[3]
    share = 1.0 + 3.0 * beta * 2.0 * np.sum(np.abs(deflection) ** 2) / (12 * torque.shape[1] ** 2)
    assert 0.003 < abs(share - 1.0) < 0.03
    stiffer = Axis(parts=replace(Parts(), nut_rigidity=share * Parts().nut_rigidity))
    bent, linear, healthy = (
        np.array(
            [estimate(*pair)[0] for pair in zip(torque, respond(axis, settings, torque, SAMPLE_RATE)[0], strict=True)]
        )
        for axis in (Axis(parts=Parts(), hidden=law), stiffer, HEALTHY)
    )
    expected, seen = ((response / healthy - 1.0)[:, LINES < 500.0] for response in (linear, bent))
    # what is not linear scatters from average to average: 7 % of the effect in one record, 2 % in twelve
    assert np.vdot(expected, seen).real / np.vdot(expected, expected).real == pytest.approx(1.0, abs=0.06)


@pytest.mark.release
def test_smaller_steps_change_friction_hardly():
    torque = random_torque(np.array([0.15]), np.random.default_rng(3))[:, : round(8.0 * SAMPLE_RATE)]
    fed_back = FedBack(2.0, np.array([nut_stiffness(HEALTHY, MIDDLE)]))
    plants = [plant(HEALTHY, MIDDLE)]
    runs = [stepped_motion(plants, torque, SAMPLE_RATE, 0.0, fed_back, steps_per_sample=n)[0, 0] for n in (4, 16)]
    linear = respond(HEALTHY, [MIDDLE], torque, SAMPLE_RATE)[0][0]
    transfers = [estimate(torque[0, 4096:], of_run[4096:])[0] for of_run in (*runs, linear)]
    changed = np.abs(transfers[0] / transfers[1] - 1.0)
    effect = np.abs(transfers[1] / transfers[2] - 1.0)
    assert np.median(changed[LINES < 900.0]) < 0.004 * np.median(effect[LINES < 900.0])


def test_lines_are_apart_and_the_torque_is_what_was_asked_for():
    assert 90 <= LINES.size <= 110
    assert LINES[0] == 24.0
    assert LINES[-1] <= 1500.0
    assert np.min(np.diff(LINES)) >= 3.0
    torque = random_torque(np.array([0.05, 0.3]), np.random.default_rng(0))
    np.testing.assert_allclose(np.std(torque, axis=1), [0.05, 0.3], rtol=0.03)  # 33 000 lines: 0.4 %
    power = np.abs(np.fft.rfft(torque[0])) ** 2
    frequency = np.fft.rfftfreq(torque.shape[1], 1.0 / SAMPLE_RATE)
    outside = (frequency < 20.0) | (frequency > 1600.0)
    assert power[outside].sum() < 1e-12 * power.sum()


def test_the_stated_scatter_is_the_scatter_about_the_true_response():
    """Torque to time to Welch against the plant's own response: noise and leakage are within what is stated."""
    rng = np.random.default_rng(8)
    settings = [Setting(position=x, preload=p, excitation_rms=0.15) for x in (0.083, 0.476, 0.868) for p in (120, 360)]
    measured = measure(HEALTHY, settings, settings, Scatter(gain=0.0), rng, respond=respond)
    omega = 2.0 * math.pi * LINES
    standardised = []
    for number, frf in enumerate(measured):
        true = frequency_response(plant(HEALTHY, frf.stated), omega)[number % 2]
        standardised.append((frf.response - true) / frf.standard_deviation)
    scatter = np.array(standardised)
    for part in (scatter.real, scatter.imag):
        assert np.mean(part**2) == pytest.approx(1.0, abs=0.15)  # 1224 values, of which some are dependent
        assert np.mean(np.abs(part) > 4.0) < 0.005


def product_responses(model: ExtendedModel, settings: list[Setting]) -> np.ndarray:
    """Ask the model under test for the same lines, shape (2, n_settings, n_lines)."""
    cases = [
        ResponseCase(LINES, stated_conditions(setting), ExcitationPoint.TORQUE_AT_MOTOR, point, MotorEnd.FREE)
        for point in (ResponsePoint.ACCELERATION_AT_TABLE, ResponsePoint.ANGLE_AT_MOTOR)
        for setting in settings
    ]
    return responses(model.physics, prepare_lines(cases)).reshape(2, len(settings), -1)


#: Where a mechanism is by its nature not what the model writes: a loss that is causal stiffens the springs with
#: frequency; and an accelerometer that sits on a spring and a damper is dragged by the damper too.
LESS_ALIKE = {"loss-factor": 0.02, "screw-loss": 0.02, "sensor-mounting-resonance": 0.02}


LINEAR = [
    key
    for key in KINDS
    if not key.startswith("outside") and key not in {"guide-friction", "cubic-stiffness", "constant-loss-factor"}
]


@pytest.mark.parametrize("kind", canary(["none", *LINEAR]))
def test_the_model_under_test_agrees_where_nothing_is_missing(kind):
    """At the true parts and with the effect of the true size: median below 900 Hz, away from zeros of the response."""
    model = ExtendedModel.of(parse_model(baseline_text(Parts(), "receptance"), "baseline").build().parameters)
    hidden = Hidden()
    if kind != "none":
        mechanism, stated = KINDS[kind].build(KINDS[kind].sizes[2], np.random.default_rng(5))
        hidden, model = Hidden(**mechanism), with_effects(model, {kind: stated})
    settings = [setting for setting in design(np.random.default_rng(0)) if setting.excitation_rms == 0.15][::3]
    omega = 2.0 * math.pi * LINES
    axis = Axis(parts=Parts(), hidden=hidden)
    own = np.array([frequency_response(plant(axis, setting), omega)[:2] for setting in settings]).swapaxes(0, 1)
    own = own * np.exp(-1j * omega * hidden.torque_delay)
    own[0] *= np.exp(-1j * omega * hidden.response_delay)
    own[1] *= np.exp(-1j * omega * hidden.angle_delay)
    error = np.abs(np.log(own / product_responses(model, settings)))
    assert np.median(error[0][:, LINES < 900.0]) < LESS_ALIKE.get(kind, 1e-3)
    assert np.median(error[1][:, LINES < 900.0]) < LESS_ALIKE.get(kind, 1e-3)
    assert np.median(error[1][:, LINES > 900.0]) < 0.004


@pytest.mark.parametrize("family", canary(FAMILIES))
def test_a_case_is_written_as_files_that_the_product_reads(family, tmp_path):
    case = draw_case("added-mass", "small", seed=3, family=family)
    responses_file, baseline_file = write_case(case, tmp_path)
    read, model = read_frf_set(responses_file), read_model_file(baseline_file)
    assert model.family == family
    assert model.build() is not None
    assert model.uncertain["bearing_stiffness_n_per_m"] == 0.2
    assert len(read.measured) == 2 * len(case.settings) == len(observations(case))
    for observation, written in zip(read.observations, observations(case), strict=True):
        assert observation.conditions == written.conditions
        np.testing.assert_array_equal(observation.response, written.response)
    assert case.truth["added-mass"]["mass_kg"] == pytest.approx(0.5, rel=0.17)


@pytest.mark.release
def test_a_seed_gives_one_case_and_another_seed_another_machine():
    first, again, other = (draw_case("none", seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.measured[5].response, again.measured[5].response)
    assert first.axis == again.axis
    assert first.axis.parts != other.axis.parts
    assert first.truth == {}


def test_settings_vary_all_that_has_to_vary_and_avoid_the_lead():
    settings = design(np.random.default_rng(0))
    assert len({setting.position for setting in settings}) >= 7
    assert all(0.08 <= setting.position <= 0.9 and setting.position % 0.006 > 1e-4 for setting in settings)
    assert {setting.payload for setting in settings} == {0.0, 6.0}
    assert {setting.temperature_deviation for setting in settings} == {0.0, 15.0}
    assert len({setting.excitation_rms for setting in settings}) == 3
    order = [setting.order for setting in settings]
    assert order == sorted(order)
    assert abs(np.corrcoef(order, [setting.position for setting in settings])[0, 1]) < 0.5


def test_kinds_name_what_the_product_knows():
    assert len(set(all_kinds())) == len(all_kinds())
    model = ExtendedModel.of(parse_model(baseline_text(Parts(), "receptance"), "baseline").build().parameters)
    rng = np.random.default_rng(1)
    for key, kind in KINDS.items():
        if not key.startswith("outside"):
            for size in kind.sizes:
                assert with_effects(model, {key: kind.build(size, rng)[1]}).physics != model.physics
    for key in all_kinds():
        if key.startswith("wrong-parameter"):
            assert with_effects(model, {key: {"ln_ratio": 0.1}}).physics != model.physics
