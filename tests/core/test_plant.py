"""Laws that the independent plant must obey before anything is judged by it."""

import ast
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import PROJECT_ROOT
from tests.plant.chain import Axis, Condition, assemble_chain, natural_frequency
from tests.plant.friction import Friction, advance_bristles
from tests.plant.measurements import Acquisition, Scatter, simulate_measurements, to_windows
from tests.plant.motion import MoveProgram, Reference, Servo, draw_reference
from tests.plant.recorder import write_session
from tests.plant.scenarios import all_scenarios, hidden, record
from tests.plant.sensors import anti_alias, filter_margin
from tests.plant.simulation import Plant, propagators, simulate
from tests.plant.write_replay_data import checksums

AXIS = Axis()
#: A joint so stiff that it clamps (EA/(kL) of the rod is 5e-6), yet not so stiff that the eigensolver loses digits.
RIGID = 1e13
RATE = 8192


def nearest(frequencies, wanted):
    return frequencies[np.argmin(np.abs(frequencies - wanted))]


@pytest.mark.parametrize("order", [1, 2])
def test_screw_alone_vibrates_as_a_clamped_free_rod(order):
    axis = replace(AXIS, bearing_stiffness=RIGID, far_bearing_stiffness=0.0, nut_rigidity=1e-6)
    frequencies, _, _ = assemble_chain(axis, Condition(0.4)).modes()
    area = np.pi / 4 * axis.screw_minor_diameter**2
    wave_speed = np.sqrt(axis.youngs_modulus * area * axis.screw_length / axis.screw_mass)
    closed_form = (2 * order - 1) * wave_speed / (4 * axis.screw_length)
    # Linear elements of h = 36 mm err by (kh)²/24: 1.4e-4 and 1.3e-3 for the two orders.
    assert nearest(frequencies, closed_form) == pytest.approx(closed_form, rel=[1.5e-4, 1.4e-3][order - 1])


def test_screw_alone_twists_as_a_free_rod():
    axis = replace(AXIS, coupling_inertia=0.0, nut_rigidity=1e-6)
    frequencies, _, _ = assemble_chain(axis, Condition(0.4)).modes()
    polar_moment = np.pi / 32 * axis.screw_minor_diameter**4
    wave_speed = np.sqrt(axis.shear_modulus * polar_moment * axis.screw_length / axis.screw_inertia)
    closed_form = wave_speed / (2 * axis.screw_length)
    assert nearest(frequencies, closed_form) == pytest.approx(closed_form, rel=6e-4)  # (kh)²/24 at h = 36 mm


@pytest.mark.parametrize("position", [0.15, 0.5, 0.85])
def test_static_compliance_is_the_sum_of_the_springs_in_series(position):
    axis = replace(AXIS, far_bearing_stiffness=0.0)
    chain = assemble_chain(axis, Condition(position, preload=200.0))
    held = np.delete(np.arange(chain.mass.shape[0]), chain.drive_rotation)
    force = np.zeros(chain.mass.shape[0])
    force[chain.table] = 1.0
    displacement = np.linalg.solve(chain.stiffness[np.ix_(held, held)], force[held])[held == chain.table]
    area, polar_moment = np.pi / 4 * axis.screw_minor_diameter**2, np.pi / 32 * axis.screw_minor_diameter**4
    in_series = (
        1 / axis.bearing_stiffness
        + position / (axis.youngs_modulus * area)
        + axis.transmission**2 * position / (axis.shear_modulus * polar_moment)
        + 1 / axis.nut_stiffness(200.0)
        + 1 / axis.bracket_stiffness
    )
    assert displacement[0] == pytest.approx(in_series, rel=1e-9)


def test_with_a_rigid_screw_two_bodies_vibrate_against_the_nut():
    axis = replace(AXIS, youngs_modulus=2e15, shear_modulus=8e14, bearing_stiffness=RIGID, bracket_stiffness=RIGID)
    turning = (axis.screw_inertia + axis.coupling_inertia) / axis.transmission**2  # as a mass on the table [kg]
    moving = axis.table_mass + axis.nut_mass
    two_bodies = np.sqrt(axis.nut_stiffness(300.0) * (1 / moving + 1 / turning)) / (2 * np.pi)
    # The screw is still 3000 times as stiff as the nut only: half of that in the frequency.
    assert natural_frequency(0.5, axis=axis) == pytest.approx(two_bodies, rel=3e-4)


def test_the_mesh_is_fine_enough_for_the_first_mode():
    coarse, fine = (assemble_chain(AXIS, Condition(0.37), n).modes()[0][1] for n in (16, 64))
    assert coarse == pytest.approx(fine, rel=3e-6)  # 0.0006 Hz, against 0.02 Hz of the best estimate


def test_eq_8_holds_on_the_truth_when_its_coefficients_are_regressed():
    position, preload = (a.ravel() for a in np.meshgrid(np.linspace(0.15, 0.85, 8), [50.0, 80, 120, 200, 300, 400]))
    frequency = natural_frequency(position, preload)
    design = np.column_stack([position**2, position, preload ** (-1 / 3), np.ones_like(position)])
    weight = frequency**3 / 2  # df = -f³/2 d(1/f²)
    coefficients, *_ = np.linalg.lstsq(design * weight[:, None], frequency**-2 * weight, rcond=None)
    residual = (design @ coefficients) ** -0.5 - frequency
    assert 0.0 < np.sqrt(np.mean(residual**2)) < 0.01  # [Hz]; a form of its own, so not zero
    assert 170 < frequency.min() < frequency.max() < 200


def test_influences_on_the_truth_are_as_stated():
    cold, warm = natural_frequency([0.2, 0.5, 0.8], temperature=[[20.0], [30.0]])
    assert (warm / cold - 1) / 10 == pytest.approx(-146e-6, abs=2e-6)  # replay_data/README.md
    low, high = natural_frequency([0.2, 0.5, 0.8], preload=[[100.0], [300.0]])
    assert np.all((high - low > 2.5) & (high - low < 3.6))  # [Hz]; Nguyen's Table 2: 3.8 to 4.5 Hz
    assert natural_frequency(0.45, payload=9.0) / natural_frequency(0.45) == pytest.approx(0.858, abs=0.001)


def test_without_losses_a_step_neither_gains_nor_loses_energy():
    lossless = replace(AXIS, screw_loss_factor=0.0, joint_loss_factor=0.0, coupling_damping=0.0)
    for axis, spread in ((lossless, 1e-7), (AXIS, 1.0)):
        (matrix,) = propagators(axis, [Condition(0.4)], 1 / RATE)
        n = matrix.shape[1] - 4
        growth = np.abs(np.linalg.eigvals(matrix[:n, :n]))
        assert np.all(growth < 1 + 1e-6)  # the rigid-body mode is a double root at 1: accurate to √eps only
        assert growth.min() > 1 - spread * (1 if axis is AXIS else 10)


def test_sliding_bristles_dissipate_coulomb_work_and_small_cycles_almost_none():
    limit, step = np.array(25e-6), 1e-4
    phase = np.linspace(0, 4 * np.pi, 20001)
    # Per newton of Coulomb friction. Each of the two reversals saves twice the presliding deflection: ∫ 2 exp(-s/z) ds.
    for amplitude, expected in ((5e-3, 4 * (5e-3 - 25e-6)), (2.5e-8, 0.0)):
        travel = amplitude * np.sin(phase)
        bristle, work = np.array(0.0), 0.0
        for k, move in enumerate(np.diff(travel)):
            after = advance_bristles(bristle, np.array(move / step), limit, step)
            work += 0.5 * (bristle + after) / limit * move if k >= 10000 else 0.0
            bristle = after
        # Far below the presliding deflection a cycle loses little: a share of the order of amplitude / deflection.
        assert work == pytest.approx(expected, rel=1e-5, abs=4e-3 * amplitude if expected == 0.0 else None)


def test_torque_at_constant_speed_is_the_drag_of_nut_guides_and_bearing():
    time = np.arange(RATE // 2) / RATE
    speed = 0.06 * np.clip((time - 0.02) / 5e-3, 0, 1)[:, None, None]
    reference = Reference(np.cumsum(speed, axis=0) / RATE, speed, np.gradient(speed, axis=0) * RATE)
    plant = Plant()
    motion = simulate(plant, [Condition(0.5, preload=250.0)], reference, 1 / RATE)
    friction = plant.friction
    assert friction is not None
    turning = 0.06 / AXIS.transmission
    nut = 0.05 * (0.006 / (np.pi * 0.02)) ** -0.5 * 250.0 * 0.006 / (2 * np.pi)  # THK: drag torque of a preloaded nut
    expected = (
        nut
        + friction.bearing_torque
        + 2 * friction.screw_viscosity * turning
        + (friction.guide_force + friction.guide_viscosity * 0.06) * AXIS.transmission
    )
    assert motion.sensor_torque[3 * RATE // 8 :].mean() == pytest.approx(expected, rel=2e-3)


def noise_free_moves(plant, rate, seed=5):
    time = np.arange(round(1.6 * rate)) / rate - 0.4
    rng = np.random.default_rng(seed)
    reference = draw_reference(MoveProgram(starts=((0.05, 0.10), (0.25, 0.30))), rng, (1, 2), time, 1.0)
    return simulate(plant, [Condition(0.4)], reference, 1 / rate)


def test_response_from_rest_to_rest_is_the_frequency_response_of_the_matrices():
    motion = noise_free_moves(Plant(friction=None), RATE)
    torque, acceleration = (np.fft.rfft(a, axis=0)[:, 0, 0] for a in (motion.sensor_torque, motion.nut_acceleration))
    frequency = np.fft.rfftfreq(motion.sensor_torque.shape[0], 1 / RATE)
    band = (frequency > 120) & (frequency < 260)
    chain = assemble_chain(AXIS, Condition(0.4))
    natural, shapes, damping = chain.modes()
    f = frequency[band][:, None]
    receptances = shapes[chain.nut] * shapes[chain.drive_rotation] / (natural**2 - f**2 + 2j * damping * natural * f)
    exact = -(f[:, 0] ** 2) * receptances.sum(axis=1)
    simulated = (acceleration / torque)[band]
    # 1 %: the motion has not quite died out when the record ends, and modes above 5 kHz are left out.
    assert np.max(np.abs(simulated - exact) / np.abs(exact)) < 0.01


def knocked(rate):
    """Nut acceleration after a smooth knock on a table at rest, with friction and a servo without torque."""
    time = (np.arange(rate // 4) + 0.5) / rate  # at the middle of each step, over which the force is held
    force = 400.0 * np.sin(np.pi * time / 6e-3) ** 2 * (time < 6e-3)
    still = np.zeros((time.size, 1, 1))
    plant = Plant(servo=Servo(torque_limit=0.0))
    motion = simulate(plant, [Condition(0.4)], Reference(still, still, still), 1 / rate, force[:, None, None])
    return motion.nut_acceleration[:: rate // RATE, 0, 0]


@pytest.mark.release
def test_half_the_step_gives_the_same_motion_with_friction():
    error = [np.std(knocked(rate) - knocked(8 * RATE)) / np.std(knocked(8 * RATE)) for rate in (RATE, 2 * RATE)]
    assert error[0] < 0.002
    assert error[1] < 0.3 * error[0]  # second order: a quarter


def test_anti_aliasing_keeps_the_mode_and_its_phase_and_stops_what_would_fold():
    factor, rate = 8, RATE / 8
    margin = filter_margin(factor)
    time = (np.arange(RATE + 2 * margin) - margin) / RATE
    kept = anti_alias(np.sin(2 * np.pi * 200.0 * time)[:, None], factor)[:, 0]
    assert kept == pytest.approx(np.sin(2 * np.pi * 200.0 * np.arange(kept.size) / rate), abs=1e-3)
    assert np.abs(anti_alias(np.sin(2 * np.pi * 540.0 * time)[:, None], factor)).max() < 1e-3


def levy_frequency(frequency, response):
    """Fit (fn² - f² + j c f) H = b0 + b1 f, linear in fn², c and the complex b."""
    f, h = frequency, response
    ones = np.ones_like(f)
    design = np.column_stack([h, 1j * f * h, -ones, -1j * ones, -f, -1j * f])
    target = f**2 * h
    unknowns, *_ = np.linalg.lstsq(
        np.vstack([design.real, design.imag]), np.concatenate([target.real, target.imag]), rcond=None
    )
    return float(np.sqrt(unknowns[0]))


def test_a_measurement_shows_the_mode_and_friction_raises_it():
    acquisition, truth = Acquisition(n_windows=12), float(natural_frequency(0.45))
    found = {}
    for guide_force in (0.0, 6.0, 30.0):
        plant = Plant(friction=Friction(guide_force=guide_force) if guide_force else None)
        recorded = simulate_measurements([Condition(0.45)], np.random.default_rng(3), acquisition, plant=plant)
        taper = np.hanning(recorded.response.shape[-1])
        u, y = (np.fft.rfft(a[0].astype(float) * taper) for a in (recorded.excitation, recorded.response))
        s_uy, s_uu, s_yy = (y * u.conj()).mean(0), (np.abs(u) ** 2).mean(0), (np.abs(y) ** 2).mean(0)
        band = np.arange(round(truth) - 8, round(truth) + 9)  # lines of 1 Hz
        found[guide_force] = levy_frequency(band.astype(float), (s_uy / s_uu)[band])
        if guide_force < 10.0:
            assert (np.abs(s_uy) ** 2 / s_uu / s_yy)[band].mean() > 0.9
    assert found[0.0] == pytest.approx(truth, abs=0.25)  # the taper's leakage and the noise bias so plain a fit
    assert 0.1 < found[6.0] - found[0.0] < 0.6  # presliding bristles stiffen the guides
    assert found[30.0] - found[0.0] > 1.0


def test_scatter_of_the_truth_behind_the_tags_is_as_stated():
    rng = np.random.default_rng(11)
    true = [Scatter().draw(Condition(0.5, preload=300.0), rng) for _ in range(4000)]
    # 4000 draws give a standard deviation to 1.1 %.
    assert np.std([c.preload for c in true]) == pytest.approx(1.5, rel=0.05)
    assert np.std([c.position for c in true]) == pytest.approx(0.2e-3, rel=0.05)
    assert np.std([c.temperature for c in true]) == pytest.approx(0.3, rel=0.05)
    assert np.std([c.friction_scale for c in true]) == pytest.approx(0.05, rel=0.05)


def test_measurements_become_windows_with_their_tags():
    tagged = [Condition(0.3, preload=200.0, payload=5.0, temperature=25.0), Condition(0.6)]
    acquisition = Acquisition(n_windows=2, duration=0.5)
    recorded = simulate_measurements(tagged, np.random.default_rng(1), acquisition)
    begin = datetime(2025, 3, 1, tzinfo=UTC)
    windows = to_windows(recorded, tagged, [begin, begin + timedelta(days=1)], acquisition, preload_known=True)
    assert [w.measurement for w in windows] == ["m0000", "m0000", "m0001", "m0001"]
    first = windows[0]
    assert (first.n_samples, first.sample_rate) == (512, 1024.0)
    assert (first.conditions.preload, first.conditions.payload_mass, first.conditions.temperature) == (200.0, 5.0, 25.0)
    assert 0.002 < first.position_span < 0.004  # 30 to 60 ms at 0.06 m/s, and the ramps
    assert first.position_trace is not None
    assert first.position_trace.mean() == pytest.approx(0.3, abs=2e-3)


@pytest.mark.release
def test_the_same_content_gives_the_same_bytes(tmp_path):
    scenario = replace(hidden(), measurements=hidden().measurements[:1])
    for name in ("a", "b"):
        windows = record(scenario)
        write_session(tmp_path / name, "axis", "text", windows[-1].started_at, windows)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_bundled_sessions_are_complete_small_and_unchanged():
    folder = PROJECT_ROOT / "replay_data"
    assert (folder / "SHA256SUMS").read_text() == checksums(folder)
    sessions = list(folder.glob("*.session.h5"))
    assert {f"{s.key}.session.h5" for s in all_scenarios()} == {f.name for f in sessions}
    assert max(f.stat().st_size for f in sessions) < 5e6
    assert sum(f.stat().st_size for f in sessions) < 25e6


@pytest.mark.release
def test_bundled_hidden_session_is_what_the_plant_gives():
    h5py = pytest.importorskip("h5py")
    with h5py.File(PROJECT_ROOT / "replay_data" / "hidden.session.h5") as file:
        stored = list(file["windows"].values())
        for group, window in zip(stored, record(hidden()), strict=True):
            assert group.attrs["measurement"] == window.measurement
            # Another machine's rounding may tip a converter by a step, seldom and never more: 2^-9 m/s².
            assert np.max(np.abs(group["response"][()] - window.response)) <= 2.0**-9


def test_the_plant_shares_nothing_with_the_product_but_its_records():
    for path in Path(PROJECT_ROOT / "tests" / "plant").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [f"{node.module}.{a.name}" for a in node.names]
            product = [n for n in names if n.split(".")[0] in {"monitor_core", "service"}]
            assert all(n.startswith("monitor_core.recording") and "recordings" not in n for n in product), path.name
