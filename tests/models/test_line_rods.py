"""Rods alone, on the product's own lines: the nut is let go, so that torsion and tension do not know each other."""

import math

import numpy as np
import pytest
import scipy.optimize

from monitor_core.models.protocol import MotorEnd
from monitor_core.models.published.transmission_line import common_step_grid, synchronised_grid
from monitor_core.models.published.transmission_line.junctions import Bearing, Nut
from monitor_core.models.published.transmission_line.kernel import LineState, advance
from tests.models.line_reference import (
    UNDAMPED,
    drive_on,
    empty_outputs,
    empty_rings,
    in_space,
    inputs_of,
    pole_of_matrix,
    shaft,
    shift,
    step_matrix,
)

EXACT_DENSITY = 80e9 / (1.346 / 421e-6) ** 2  # the density of Eq. (54): 421 steps of 1 µs fit


def without_nut(drive):
    return drive._replace(nut=Nut(drive.nut.half_step, 0.0, 0.0))


def free_end(drive):
    return Bearing(drive.table.half_step, 0.0, 0.0, drive.lines.axial_impedance)


def clamped_end(drive):
    return Bearing(drive.table.half_step, 1.0, 0.0, drive.lines.axial_impedance)


def rings_of_noise(drive, seed):
    rng = np.random.default_rng(seed)
    return type(empty_rings(drive))(*(rng.standard_normal(len(ring)).tolist() for ring in empty_rings(drive)))


def run(drive, places, rings, n):
    return advance(drive, LineState(), rings, inputs_of(np.zeros(n), *places), empty_outputs(n))


def test_free_rods_return_bitwise_after_two_passes():
    drive, *places = drive_on(common_step_grid(shaft(), 40), shaft(), motor_end=MotorEnd.PRESCRIBED)
    drive = without_nut(drive)._replace(bearing=free_end(drive), far_bearing=free_end(drive))
    rings = rings_of_noise(drive, 1)
    start = [np.array(ring) for ring in rings]
    # 400 steps are five periods of 2 · 40 in torsion and eight of 2 · 25 in tension, the first whole number of both
    state = run(drive, places, rings, 400)
    for before, after in zip(start, in_space(rings, state), strict=True):
        np.testing.assert_array_equal(after, before)


def test_clamped_rod_returns_negated_after_two_passes_and_bitwise_after_four():
    drive, *places = drive_on(common_step_grid(shaft(), 40), shaft(), motor_end=MotorEnd.PRESCRIBED)
    drive = without_nut(drive)._replace(bearing=clamped_end(drive), far_bearing=free_end(drive))
    rings = rings_of_noise(drive, 2)
    start = [np.array(ring) for ring in rings[:2]]
    state = run(drive, places, rings, 2 * 25)
    for before, after in zip(start, in_space(rings, state)[:2], strict=True):
        np.testing.assert_array_equal(after, -before)
    step = advance
    state = step(drive, state, rings, inputs_of(np.zeros(50), *places), empty_outputs(50))
    for before, after in zip(start, in_space(rings, state)[:2], strict=True):
        np.testing.assert_array_equal(after, before)


@pytest.fixture(scope="module")
def long_rods():
    """Parameters and drive on the paper's sections: 421 at 1 µs and 2105 at 0.125 µs."""
    p = shaft(density=EXACT_DENSITY, coupling_stiffness=1e9, motor_inertia=0.01, coupling_inertia=0.0, **UNDAMPED)
    p_spring = shaft(**{name: getattr(p, name) for name in ("density", "coupling_stiffness", "motor_inertia")}
                     | {"coupling_inertia": 0.0, "bearing_stiffness": 1e7} | UNDAMPED)  # fmt: skip
    drive, *places = drive_on(synchronised_grid(p, 1e-6), p_spring)
    drive = without_nut(drive)._replace(far_bearing=free_end(drive))
    return p_spring, drive, step_matrix(drive, *places)


@pytest.mark.release
def test_rod_with_an_inertia_at_its_end_is_within_1_ppm(long_rods):
    # Closed form: K J ω²/(K − J ω²) = −Zω tan ωT, rotor J on a stiff coupling K, far end free.
    p, _, matrix = long_rods
    delay = p.screw_length / p.torsional_speed
    z, k, j = p.torsional_rigidity / p.torsional_speed, p.coupling_stiffness, p.rotor_inertia

    def misfit(omega):
        return k * j * omega * math.cos(omega * delay) + (k - j * omega**2) * z * math.sin(omega * delay)

    for mode in (1, 2, 3):  # 651, 1802 and 2982 Hz
        low, high = ((mode - 0.5) * math.pi / delay, mode * math.pi / delay)
        frequency = scipy.optimize.brentq(misfit, low, high, xtol=1e-12) / (2 * math.pi)
        pole = pole_of_matrix(matrix, 1e-6, frequency)
        assert pole.imag / (2 * math.pi) == pytest.approx(frequency, rel=1e-6)
        assert abs(pole.real) < 1e-9 * abs(pole)


@pytest.mark.release
def test_rod_on_a_spring_is_within_1_ppm(long_rods):
    # Closed form: Zω tan ωT = k with the other end free. A rigid rod would swing at 162.3 Hz.
    p, _, matrix = long_rods
    delay = p.screw_length / p.axial_speed
    z, k = p.axial_rigidity / p.axial_speed, 1e7
    assert math.sqrt(k / (z * delay)) / (2 * math.pi) == pytest.approx(162.3, abs=0.05)
    for mode in (0, 1, 2):  # 160.3, 1914 and 3807 Hz
        low, high = (mode * math.pi / delay + 1e-6, (mode + 0.5) * math.pi / delay - 1e-6)
        omega = scipy.optimize.brentq(
            lambda w: z * w * math.sin(w * delay) - k * math.cos(w * delay), low, high, xtol=1e-12
        )
        pole = pole_of_matrix(matrix, 1e-6, omega / (2 * math.pi))
        assert pole.imag == pytest.approx(omega, rel=1e-6)
        if mode == 0:
            assert omega / (2 * math.pi) == pytest.approx(160.3, abs=0.05)


def printed_bearing(stiffness, steps, sections=60, node=1):
    """Run a free rod with the bearing of Eqs. (22)-(27) as printed; return its momentum over time, and its waves."""
    impedance, step = 36563.32, 1.346 / 5115.44 / sections
    z = step / 2 * stiffness  # Eq. (27)
    b, a, e = np.ones(sections), -np.ones(sections), 0.0  # a uniform velocity
    momentum = []
    for _ in range(steps):
        incident, opposite = b[node - 1], a[node]
        force = (z * (incident + opposite) + impedance * e) / (2 * z + impedance)  # Eq. (22)
        v, v_other = 2 * (incident - force) / impedance, 2 * (force - opposite) / impedance  # Eq. (23)
        e = 2 * force - e  # Eq. (25)
        b[node - 1], a[node] = opposite + v_other * impedance, incident - v * impedance  # Eq. (26)
        shift(b, a, -a[0], -b[-1])  # free ends, Eq. (21)
        momentum.append(step * float(np.sum(b - a)))
    return np.array(momentum), (b, a)


def test_bearing_as_printed_is_a_cut_and_not_a_support():
    # A rod on a spring to ground swings to and fro, its momentum with it. As printed no force comes from outside:
    # the momentum stays what it was, whatever the stiffness, and the rod drifts away.
    for stiffness in (1e5, 1e7, 1e9):
        momentum, _ = printed_bearing(stiffness, 1200)
        np.testing.assert_allclose(momentum, momentum[0], rtol=1e-11)
    p = shaft(bearing_stiffness=1e7, **UNDAMPED)
    drive, *places = drive_on(common_step_grid(p, 96), p)
    drive = without_nut(drive)._replace(far_bearing=free_end(drive))
    rings = empty_rings(drive)
    rings.axial_right[:], rings.axial_left[:] = [1.0] * 60, [-1.0] * 60
    run(drive, places, rings, 710)  # half a period of 160.3 Hz
    assert sum(rings.axial_right) - sum(rings.axial_left) == pytest.approx(-120.0, rel=0.02)


def test_bearing_as_printed_does_not_clamp_however_stiff():
    # k → ∞ as printed leaves the rod as if there were no bearing: free–free, back after two passes.
    _, (b, a) = printed_bearing(1e18, 120)
    np.testing.assert_allclose(b, 1.0, rtol=1e-6)
    np.testing.assert_allclose(a, -1.0, rtol=1e-6)
    p = shaft(bearing_stiffness=1e18, **UNDAMPED)
    drive, *places = drive_on(common_step_grid(p, 96), p)
    drive = without_nut(drive)._replace(far_bearing=free_end(drive))
    rings = empty_rings(drive)
    rings.axial_right[:], rings.axial_left[:] = [1.0] * 60, [-1.0] * 60
    run(drive, places, rings, 120)  # a clamped rod has turned round by then
    np.testing.assert_allclose(rings.axial_right, -1.0, rtol=1e-6)
