"""Tian's tables against the model, and each misprint of the paper shown (``docs/reference/errata.md``)."""

import csv
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.receptance import ReceptanceModel, ReceptanceParameters
from monitor_core.models.published.receptance.closed_form import position_terms, table_receptance
from tests.authorities.receptance_matrices import (
    couple_receptances,
    drive_receptance,
    ground_receptance,
    nut_pattern,
)

POSITIONS = {"l1": 0.6, "l2": 0.8, "l3": 1.0, "l4": 1.3, "l5": 1.6, "l6": 1.9}
#: Where the paper has its four orders [Hz], and a grid fine enough for a parabola through three lines of a peak.
WINDOWS = {1: (12.0, 45.0, 0.05), 2: (85.0, 160.0, 0.1), 3: (470.0, 640.0, 0.2), 4: (650.0, 860.0, 0.2)}
#: Names of the vocabulary for the symbols of Table 3.
SYMBOLS = {
    "k_al": "bearing_stiffness", "k_ar": "far_bearing_stiffness", "k_n": "nut_stiffness", "k_m": "coupling_stiffness",
    "c_al": "bearing_damping", "c_ar": "far_bearing_damping", "c_n": "nut_damping", "c_m": "coupling_damping",
}  # fmt: skip
CONSTANTS = {
    "E": "youngs_modulus", "G": "shear_modulus", "rho": "density", "d": "screw_diameter", "h": "screw_lead",
    "L": "screw_length", "m_s": "screw_nut_segment_mass", "J_s": "screw_nut_segment_inertia",
    "J_j": "screw_motor_segment_inertia", "m_b": "table_mass", "J_m": "motor_inertia",
}  # fmt: skip
#: What is changed of the print; c_n in the multi-position set only.
COUPLING = {"coupling_stiffness": 20.7, "coupling_damping": 0.0036}
NUT_DAMPING = {"nut_damping": 2.25e3}

Response = Callable[[ReceptanceParameters, FloatArray, float], ComplexArray]


def rows(published_data: Path, name: str) -> list[dict[str, str]]:
    with (published_data / name).open(newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def printed(published_data: Path) -> dict[str, ReceptanceParameters]:
    """Table A with each set of joint parameters of Table 5, as printed."""
    axis = {CONSTANTS[r["symbol"]]: float(r["value"]) for r in rows(published_data, "tian_constants.csv")}
    joints = rows(published_data, "tian_joint_parameters.csv")
    return {
        name: ReceptanceParameters(**axis, **{SYMBOLS[row["symbol"]]: float(row[name]) for row in joints})
        for name in ("multi", "l3", "l5")
    }


@pytest.fixture(scope="module")
def changed(printed: dict[str, ReceptanceParameters]) -> dict[str, ReceptanceParameters]:
    """Table A with k_m and c_m changed, and c_n in the multi-position set."""
    return {
        name: replace(parameters, **COUPLING, **(NUT_DAMPING if name == "multi" else {}))
        for name, parameters in printed.items()
    }


@pytest.fixture(scope="module")
def calculated(published_data: Path) -> list[tuple[str, float, int, float]]:
    """Tables 4 and 6 to 9: set, position [m], order, calculated frequency [Hz]."""
    table = rows(published_data, "tian_predicted.csv")
    return [(r["identified_from"], POSITIONS[r["position"]], int(r["order"]), float(r["frequency_hz"])) for r in table]


def free(parameters: ReceptanceParameters, omega: FloatArray, position: float) -> ComplexArray:
    conditions = DriveConditions(position)
    return table_receptance(position_terms(parameters, omega, conditions), parameters.joints(conditions))


def without_motor(parameters: ReceptanceParameters, omega: FloatArray, position: float) -> ComplexArray:
    conditions = DriveConditions(position)
    terms = position_terms(parameters, omega, conditions, MotorEnd.PRESCRIBED)
    return table_receptance(terms, parameters.joints(conditions))


def peak(response: Response, parameters: ReceptanceParameters, position: float, window) -> tuple[float, float] | None:
    """Highest local maximum of |H| inside a window, frequency [Hz] and height [m/N]; None if there is none."""
    low, high, step = window
    frequency = np.arange(low, high, step)
    level = np.log(np.abs(response(parameters, 2 * np.pi * frequency, position)))
    tops = np.flatnonzero((level[1:-1] > level[:-2]) & (level[1:-1] >= level[2:])) + 1
    if not tops.size:
        return None
    k = tops[np.argmax(level[tops])]
    left, top, right = level[k - 1 : k + 2]
    offset = 0.5 * (left - right) / (left - 2 * top + right)
    return float(frequency[k] + offset * step), float(np.exp(top - 0.25 * (left - right) * offset))


def misses(response: Response, sets, calculated, order: int) -> list[float]:
    """Relative deviation from each calculated frequency of an order [%]; infinite where there is no peak."""
    found = [(peak(response, sets[s], x, WINDOWS[o]), f) for s, x, o, f in calculated if o == order]
    return [abs(top[0] / f - 1.0) * 100.0 if top else np.inf for top, f in found]


# --- what reproduces


@pytest.mark.parametrize(("order", "count", "limit"), [(1, 13, 2.7), (2, 13, 1.4), (3, 10, 0.7), (4, 13, 0.5)])
def test_three_changed_values_give_all_calculated_frequencies(changed, calculated, order, count, limit):
    deviations = misses(free, changed, calculated, order)
    assert len(deviations) == count
    assert max(deviations) < limit


@pytest.mark.parametrize(("order", "limit"), [(2, 1.7), (3, 0.7), (4, 0.505)])
def test_without_motor_orders_two_to_four_are_there_too(changed, calculated, order, limit):
    # k_m and c_m then play no part; the largest of order 4 is 0.504 %, 3.6 Hz at l2 with the l3 set
    assert max(misses(without_motor, changed, calculated, order)) < limit


def test_second_order_falls_along_the_screw_but_rises_with_the_l5_set(changed):
    order_2 = {
        name: [peak(free, parameters, x, WINDOWS[2])[0] for x in POSITIONS.values()]
        for name, parameters in changed.items()
    }
    assert np.all(np.diff(order_2["multi"]) < 0.0)
    assert np.all(np.diff(order_2["l3"]) < 0.0)
    assert np.all(np.diff(order_2["l5"]) > 0.0)


def test_third_order_is_highest_at_mid_span_where_the_nut_does_not_move_it(changed):
    frequencies = [peak(free, changed["multi"], x, WINDOWS[3])[0] for x in POSITIONS.values()]
    assert np.argmax(frequencies) == list(POSITIONS).index("l4")
    softer = replace(changed["multi"], nut_stiffness=0.9 * changed["multi"].nut_stiffness)
    moved = [
        abs(peak(free, softer, x, WINDOWS[3])[0] / f - 1) for x, f in zip(POSITIONS.values(), frequencies, strict=True)
    ]
    assert np.argmin(moved) == list(POSITIONS).index("l4")
    assert moved[3] < 1e-4


def test_model_file_is_the_table_with_the_three_changes(published_data, changed):
    text = (published_data.parent / "models" / "receptance.toml").read_text(encoding="utf-8")
    model = tomllib.loads(text)
    assert ReceptanceParameters.from_file_names(model["parameters"], "receptance") == changed["multi"]


# --- what does not: k_m and c_m, c_n


def test_printed_coupling_has_no_mode_near_24_hz(printed):
    # k_m = 5.53e3 N·m/rad on a rotor of 1e-3 kg·m²: measured and calculated are 23 and 24 Hz
    for parameters in printed.values():
        for position in POSITIONS.values():
            assert peak(free, parameters, position, (5.0, 60.0, 0.02)) is None
            modes = ReceptanceModel(parameters).natural_frequencies(DriveConditions(position))
            assert modes[1].frequency > 100.0


def test_printed_coupling_misses_the_second_and_third_order_too(printed, calculated):
    sets = {**printed, "multi": replace(printed["multi"], **NUT_DAMPING)}
    assert min(misses(free, sets, calculated, 2)) > 5.0
    assert min(misses(free, sets, calculated, 3)) > 5.0


def test_printed_nut_damping_of_the_multi_set_is_too_high_by_a_hundred(printed, changed, calculated):
    singles = [printed[name].nut_damping for name in ("l3", "l5")]
    assert printed["multi"].nut_damping > 50 * max(singles)
    assert 2 * np.pi * 720 * printed["multi"].nut_damping / printed["multi"].nut_stiffness > 1.4
    as_printed = {**changed, "multi": replace(changed["multi"], nut_damping=printed["multi"].nut_damping)}
    multi = [row for row in calculated if row[0] == "multi"]
    assert max(misses(free, changed, multi, 3)) < 0.6  # with a hundredth of it; as printed:
    assert max(misses(free, as_printed, multi, 3)) > 2.0
    assert min(misses(free, as_printed, multi, 4)) > 7.0  # and at three of five positions no peak


# --- misprints in the equations


def literal_receptance(parameters: ReceptanceParameters, omega: FloatArray, position: float, **print_) -> ComplexArray:
    """Eqs. (1)-(24) written out once more; each keyword puts a misprint back."""
    p, i_b = parameters, parameters.screw_lead / (2 * np.pi)
    rods = []
    for modulus, section, speed_modulus in (
        (p.youngs_modulus, np.pi * p.screw_diameter**2 / 4, p.youngs_modulus),
        (p.shear_modulus, np.pi * p.screw_diameter**4 / 32, print_.get("torsion_runs_on", p.shear_modulus)),
    ):
        wave = omega * np.sqrt(p.density / speed_modulus)
        pieces = []
        for length in (position, p.screw_length - position):
            on_diagonal = np.cos(wave * length) if print_.get("cosine") and not rods else 1 / np.tan(wave * length)
            matrix = np.array([[-on_diagonal, -1 / np.sin(wave * length)], [-1 / np.sin(wave * length), -on_diagonal]])
            pieces.append(np.moveaxis(matrix, -1, 0) / (modulus * section * wave)[:, None, None])
        rods.append(couple_receptances(*pieces, (1, 0), keep=(0, 1, 3)))
    axial, torsional = rods
    for point, stiffness in (
        (0, p.bearing_stiffness + 1j * omega * p.bearing_damping),
        (2, p.far_bearing_stiffness + 1j * omega * p.far_bearing_damping),
    ):
        axial = ground_receptance(axial, point, joint=stiffness if print_.get("joint_as_printed") else 1 / stiffness)
    coupling = (p.coupling_stiffness + 1j * omega * p.coupling_damping)[:, None, None]
    rotor_and_h = coupling * np.array([[1, -1], [-1, 1]]) - omega[:, None, None] ** 2 * np.diag(
        [p.motor_inertia, print_.get("segment_h", p.screw_motor_segment_inertia)]
    )
    torsional = couple_receptances(torsional, np.linalg.inv(rotor_and_h), (0, 1), keep=(0, 1, 2))
    pattern = np.array([[1, -1, -i_b], [-1, 1, i_b], [-i_b, i_b, i_b**2]])
    if print_.get("eq_19"):
        pattern = printed_eq_19(i_b)
    nut = (p.nut_stiffness + 1j * omega * p.nut_damping)[:, None, None]
    masses = np.diag([p.table_mass, p.screw_nut_segment_mass, p.screw_nut_segment_inertia])
    worktable = np.linalg.inv(nut * pattern - omega[:, None, None] ** 2 * masses)
    with_axial = couple_receptances(worktable, axial, (1, 1), keep=(0, 1, 2))
    return couple_receptances(with_axial, torsional, (2, 1), keep=(0, 1, 2))[:, 0, 0]


def printed_eq_19(i_b: float) -> FloatArray:
    return np.array([[1.0, -i_b, -i_b], [-i_b, 1.0, i_b], [-i_b, i_b, i_b**2]])


def test_equations_written_out_again_give_the_model(changed):
    omega = 2 * np.pi * np.linspace(10.0, 900.0, 200)
    again = literal_receptance(changed["multi"], omega, 0.8)
    np.testing.assert_allclose(again, free(changed["multi"], omega, 0.8), rtol=1e-10)
    np.testing.assert_allclose(
        again, drive_receptance(changed["multi"], omega, DriveConditions(0.8))[:, 0, 0], rtol=1e-10
    )


@pytest.mark.parametrize(
    ("misprint", "lost_orders"),
    [
        ({"cosine": True}, (2,)),
        ({"joint_as_printed": True}, (2,)),
        ({"torsion_runs_on": 2e11}, (2, 3)),
        ({"eq_19": True}, (2,)),
    ],
    ids=["cos-in-eqs-1-2", "stiffness-in-eqs-6-8", "e-in-torsion", "eq-19"],
)
def test_a_misprinted_equation_loses_an_order(changed, calculated, misprint, lost_orders):
    def misprinted(parameters, omega, position):
        return literal_receptance(parameters, omega, position, **misprint)

    for order in lost_orders:
        assert min(misses(misprinted, changed, calculated, order)) > 5.0


def test_nut_stiffness_matrix_is_an_energy_and_eq_19_is_none():
    i_b = 0.04 / (2 * np.pi)
    pattern = nut_pattern(i_b)
    assert np.linalg.eigvalsh(pattern).min() > -1e-15
    # screwing the table along with the screw, and carrying it, deforms nothing
    for motion in ((i_b, 0.0, 1.0), (1.0, 1.0, 0.0)):
        np.testing.assert_allclose(pattern @ motion, 0.0, atol=1e-18)
    printed_pattern = printed_eq_19(i_b)
    assert np.linalg.eigvalsh(printed_pattern).min() == pytest.approx(-4.0e-5, rel=0.05)
    for motion in ((i_b, 0.0, 1.0), (1.0, 1.0, 0.0)):
        assert np.linalg.norm(printed_pattern @ motion) > 1e-5


def test_segment_h_counts_once(changed, calculated):
    # J_sH of Eq. (14) is J_j of Table A; without it order 3 is off by more than twice as much
    def without_segment_h(parameters, omega, position):
        return literal_receptance(parameters, omega, position, segment_h=0.0)

    def twice(parameters, omega, position):
        return literal_receptance(parameters, omega, position, segment_h=2e-4)

    right = max(misses(free, changed, calculated, 3))
    assert max(misses(without_segment_h, changed, calculated, 3)) > 2 * right
    assert max(misses(twice, changed, calculated, 3)) > 2 * right


# --- misprints in the tables


def test_amplitudes_of_table_2_are_millimetres_per_newton(published_data, changed):
    measured = [r for r in rows(published_data, "tian_measured.csv") if r["amplitude_printed"]]
    assert len(measured) == 12
    for row in measured:
        order, amplitude = int(row["order"]), float(row["amplitude_printed"])
        _, height = peak(free, changed["multi"], float(row["position_m"]), WINDOWS[order])
        assert 0.5 < height / (amplitude * 1e-3) < 2.0
        if order == 1:  # in metres the table would move a thousand times further than if nothing held it
            mass_line = 1.0 / (changed["multi"].table_mass * (2 * np.pi * float(row["frequency_hz"])) ** 2)
            assert 1000.0 < amplitude / mass_line < 3000.0


def test_table_6_means_24_hz_where_it_prints_23(published_data):
    # multi-position set at l3: printed errors 0, 0.86, 2.12, 0.28 and overall 2.31 %, Eq. (27)
    measured = {
        int(r["order"]): float(r["frequency_hz"])
        for r in rows(published_data, "tian_measured.csv")
        if r["position"] == "l3"
    }
    found = {
        int(r["order"]): float(r["frequency_hz"])
        for r in rows(published_data, "tian_predicted.csv")
        if (r["identified_from"], r["position"]) == ("multi", "l3")
    }

    def errors(calculated_frequency):
        return [abs(calculated_frequency[q] / measured[q] - 1.0) * 100 for q in (1, 2, 3, 4)]

    as_printed = errors({**found, 1: 23.0})
    np.testing.assert_allclose(errors(found), [0.0, 0.86, 2.12, 0.28], atol=0.005)
    assert np.hypot.reduce(errors(found)) == pytest.approx(2.31, abs=0.01)
    assert as_printed[0] == pytest.approx(4.17, abs=0.005)
    assert np.hypot.reduce(as_printed) == pytest.approx(4.76, abs=0.01)
