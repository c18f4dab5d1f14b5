"""Receptance of Tian's drive at 2000 frequencies: closed form, coupled matrices, and the equations as they read.

``python -m benchmarks.receptance`` prints milliseconds per receptance and factors. Ratios are what counts: the variants
run in turn, round after round, and the median round is reported, so a busy machine slows all of them alike. The
trigonometry of the position is precomputed for the closed form, as in an identification, where only the joints change.
"""

import math
import statistics
import time
from collections.abc import Callable

import numpy as np

from monitor_core.models.protocol import DriveConditions
from monitor_core.models.published.receptance import ReceptanceParameters
from monitor_core.models.published.receptance.closed_form import (
    position_terms,
    table_receptance,
    table_receptance_gradient,
)
from tests.authorities.receptance_matrices import drive_receptance

FREQUENCY = np.linspace(5.0, 1000.0, 2000)
CONDITIONS = DriveConditions(position=1.0)
ROUNDS = 15
#: Table A and Table 3 of the paper, with the values of ``replay_data/models/receptance.toml`` for the coupling and c_n.
PARAMETERS = ReceptanceParameters(
    table_mass=272.0, screw_length=2.6, screw_diameter=0.04, screw_lead=0.04, youngs_modulus=2e11,
    shear_modulus=7.75e10, density=7850.0, motor_inertia=1e-3, screw_nut_segment_mass=0.25,
    screw_nut_segment_inertia=1e-4, screw_motor_segment_inertia=1e-4, bearing_stiffness=4.28e7,
    far_bearing_stiffness=2.94e7, nut_stiffness=7.09e8, coupling_stiffness=20.7, bearing_damping=2020.0,
    far_bearing_damping=2730.0, nut_damping=2250.0, coupling_damping=0.0036,
)  # fmt: skip


def as_the_equations_read(parameters: ReceptanceParameters, omega: np.ndarray, position: float) -> np.ndarray:
    """Return h_all-6a6a, Eqs. (1)-(24), one frequency after the other with 2 × 2 and 3 × 3 matrices."""
    return np.array([_one_frequency(parameters, float(w), position) for w in omega])


def _one_frequency(p: ReceptanceParameters, w: float, position: float) -> complex:
    axial = _screw(p.axial_rigidity, w * math.sqrt(p.density / p.youngs_modulus), position, p.screw_length)  # (1)-(4)
    for point, stiffness, damping in (
        (0, p.bearing_stiffness, p.bearing_damping),  # (5)-(7)
        (2, p.far_bearing_stiffness, p.far_bearing_damping),  # (8)-(9)
    ):
        axial = _couple(axial, point, 1.0 / (stiffness + 1j * w * damping))
    torsional = _screw(p.torsional_rigidity, w * math.sqrt(p.density / p.shear_modulus), position, p.screw_length)
    coupling = p.coupling_stiffness + 1j * w * p.coupling_damping
    inertia = np.diag([p.motor_inertia, p.screw_motor_segment_inertia])
    motor = np.linalg.inv(coupling * np.array([[1.0, -1.0], [-1.0, 1.0]]) - w**2 * inertia)  # (14)-(16)
    torsional = _couple(torsional, 0, motor[1, 1])  # (17)
    deflection = np.array([1.0, -1.0, -p.transmission_ratio])
    nut = (p.nut_stiffness + 1j * w * p.nut_damping) * np.outer(deflection, deflection)
    mass = np.diag([p.table_mass, p.screw_nut_segment_mass, p.screw_nut_segment_inertia])
    worktable = np.linalg.inv(nut - w**2 * mass)  # (18)-(22)
    with_axial = _couple(worktable, 1, axial[1, 1])  # (23)
    return complex(_couple(with_axial, 2, torsional[1, 1])[0, 0])  # (24)


def _screw(rigidity: float, wave: float, position: float, screw_length: float) -> np.ndarray:
    a, b = (
        np.array([[-1.0 / math.tan(x), -1.0 / math.sin(x)], [-1.0 / math.sin(x), -1.0 / math.tan(x)]])
        / (rigidity * wave)
        for x in (wave * position, wave * (screw_length - position))
    )
    apart = np.array([[a[0, 0], a[0, 1], 0.0], [a[1, 0], a[1, 1], 0.0], [0.0, 0.0, b[1, 1]]], dtype=complex)
    column, row = np.array([-a[0, 1], -a[1, 1], b[1, 0]]), np.array([a[1, 0], a[1, 1], -b[0, 1]])
    return apart + np.outer(column, row) / (a[1, 1] + b[0, 0])


def _couple(receptance: np.ndarray, point: int, other: complex) -> np.ndarray:
    return receptance - np.outer(receptance[:, point], receptance[point]) / (receptance[point, point] + other)


def measure(rounds: int = ROUNDS) -> dict[str, float]:
    """Return the time of each variant in milliseconds: the median over rounds."""
    omega = 2.0 * np.pi * FREQUENCY
    terms, joints = position_terms(PARAMETERS, omega, CONDITIONS), PARAMETERS.joints(CONDITIONS)
    variants: dict[str, tuple[int, Callable[[], object]]] = {
        "equations as they read, loop": (1, lambda: as_the_equations_read(PARAMETERS, omega, CONDITIONS.position)),
        "coupled matrices, all frequencies": (5, lambda: drive_receptance(PARAMETERS, omega, CONDITIONS)),
        "closed form": (200, lambda: table_receptance(terms, joints)),
        "closed form with 8 derivatives": (200, lambda: table_receptance_gradient(terms, joints)),
        "terms of a position, once": (20, lambda: position_terms(PARAMETERS, omega, CONDITIONS)),
    }
    elapsed: dict[str, list[float]] = {name: [] for name in variants}
    for _ in range(rounds + 1):
        for name, (repeats, variant) in variants.items():
            start = time.perf_counter()
            for _ in range(repeats):
                variant()
            elapsed[name].append((time.perf_counter() - start) / repeats * 1e3)
    return {name: statistics.median(times[1:]) for name, times in elapsed.items()}


def main() -> None:
    """Print the table."""
    omega = 2.0 * np.pi * FREQUENCY
    closed = table_receptance(position_terms(PARAMETERS, omega, CONDITIONS), PARAMETERS.joints(CONDITIONS))
    for name, other in (
        ("loop", as_the_equations_read(PARAMETERS, omega, CONDITIONS.position)),
        ("coupled matrices", drive_receptance(PARAMETERS, omega, CONDITIONS)[:, 0, 0]),
    ):
        print(f"closed form against {name}: largest relative difference {np.max(np.abs(closed / other - 1.0)):.1e}")
    times = measure()
    of_closed_form = times["closed form"]
    for name, milliseconds in times.items():
        print(f"{name:36s} {milliseconds:9.3f} ms   {milliseconds / of_closed_form:8.1f} x closed form")


if __name__ == "__main__":
    main()
