"""Section 4 of Moreno-Castaneda et al. (2005) recomputed, and what its misprints would do."""

import csv
import math

import numpy as np
import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.models.published.transmission_line import (
    closest_common_step_grid,
    common_step_grid,
    synchronised_grid,
)
from tests.models.line_reference import UNDAMPED, continuous_frequency, shaft

LENGTH, STEP = 1.346, 1e-6
G, RHO = 80e9, 7850.0
U_T = math.sqrt(G / RHO)  # Eq. (46)


@pytest.fixture(scope="module")
def printed(published_data):
    with (published_data / "moreno_constants.csv").open(encoding="utf-8") as file:
        return {row["parameter"]: row["value"] for row in csv.DictReader(file)}


def test_constants_of_section_4_follow_from_the_paper_s_shaft(printed):
    # Eqs. (50)-(55), (57), (58): length, shear modulus, density and step are stated, the rest is computed.
    p = shaft()
    assert p.screw_length == float(printed["screw length"])
    assert p.shear_modulus == float(printed["shear modulus"])
    assert p.density == float(printed["density"])
    grid = synchronised_grid(p, float(printed["torsional time step"]))
    assert grid.torsional_sections == int(printed["sections torsional"])
    assert grid.axial_sections == 2105
    u_t = p.screw_length / (grid.torsional_sections * grid.time_step)
    u_a = p.screw_length / (grid.axial_sections * grid.axial_step)
    assert u_t == pytest.approx(float(printed["torsional wave speed"]), abs=0.005)
    assert u_a == pytest.approx(float(printed["axial wave speed"]), abs=0.005)
    assert p.shear_modulus / u_t**2 == pytest.approx(float(printed["adjusted density"]), abs=0.01)
    assert grid.axial_impedance(p) == pytest.approx(float(printed["axial impedance"]), abs=0.005)
    assert grid.torsional_impedance(p) == pytest.approx(float(printed["torsional impedance"]), abs=0.005)


def test_eq_55_carries_a_rounded_factor_and_eq_58_a_rounded_area():
    assert pytest.approx(6.298, abs=0.001) == 1.97e-3 * 3197.15  # not 6.29
    assert pytest.approx(36552.5, abs=0.1) == 7826.43 * 9.13e-4 * 5115.44  # not 36563.32
    assert math.pi / 4 * 0.0341**2 == pytest.approx(9.13269e-4, rel=1e-6)  # A of 34.1 mm, J of 40 mm


def test_eq_12_needs_the_polar_moment_where_it_prints_the_modulus():
    # Z_t = ρGu would be 2e18; Eq. (55) itself uses ρJu.
    assert pytest.approx(2.0e18, rel=0.01) == RHO * G * U_T
    grid = synchronised_grid(shaft(), STEP)
    u = LENGTH / (421 * STEP)
    assert grid.torsional_impedance(shaft()) == pytest.approx(G / u**2 * math.pi * 0.04**4 / 32 * u, rel=1e-12)


def test_eq_43_is_1_6087_and_table_2_says_so():
    assert math.sqrt(206 / 79.6) == pytest.approx(1.6087, abs=5e-5)
    assert pytest.approx(1.6097, abs=5e-5) == 1027 / 638
    assert math.sqrt(206 / 79.5) == pytest.approx(1.6097, abs=5e-5)
    table_2 = [[math.sqrt(e * 206 / (g * 79.6)) for e in (1.01, 0.99)] for g in (1.01, 0.99)]
    np.testing.assert_allclose(table_2, [[1.6087, 1.5927], [1.6249, 1.6087]], atol=5e-5)


def test_eight_fifths_is_the_ratio_of_smallest_denominator_in_the_range_of_table_2():
    ratios = [(d, n) for d in range(1, 6) for n in range(1, 2 * d + 1) if 1.5927 <= n / d <= 1.6249]
    assert ratios == [(5, 8)]
    assert pytest.approx(204.8e9, rel=1e-12) == 80e9 * (8 / 5) ** 2


def test_the_two_changes_of_length_are_tenfold_what_is_printed():
    section = U_T * STEP  # Eq. (47)
    assert section == pytest.approx(3.1923e-3, abs=5e-8)
    assert LENGTH / section == pytest.approx(421.63, abs=0.005)  # Eq. (48)
    assert (422 - LENGTH / section) * section == pytest.approx(1170.66e-6, abs=0.02e-6)  # Eq. (49): 117.06 µm
    assert pytest.approx(3096.5e-6, abs=0.1e-6) == (422 - 421.03) * 3.1923e-3  # as printed
    lighter = math.sqrt(G / 7800) * STEP
    assert round(LENGTH / lighter) == 420
    assert 420 * lighter - LENGTH == pytest.approx(-923.5e-6, abs=0.5e-6)  # text: 92.35 µm
    assert pytest.approx(0.0064, abs=5e-5) == 1 - 7800 / 7850  # text: 0.63 %


def test_eq_50_rounds_down_what_eq_48_rounds_to_the_nearest():
    assert round(LENGTH / (U_T * STEP)) == 422
    assert synchronised_grid(shaft(), STEP).torsional_sections == 421


def test_eqs_17_to_19_depend_on_the_unit_of_length():
    # mod(l/m − 0.5) of a length and a number is no index; round(l/l_axial) is one, in any unit.
    bearing, section = 0.05, LENGTH / 2105  # Eq. (59): 0.6394 mm

    def printed_index(length):
        return math.fmod(length / 2105 - 0.5, 1.0)

    assert printed_index(bearing) != pytest.approx(printed_index(bearing * 1e3), abs=1e-3)
    assert round(bearing / section) == round(bearing * 1e3 / (section * 1e3)) == 78


def test_the_axial_step_of_eq_56_is_five_times_too_long():
    # An axial wave crosses an axial section in t_t/n_a; Eqs. (42) and (56) give the time over a torsional section.
    grid = synchronised_grid(shaft(), STEP)
    assert grid.axial_step == pytest.approx(LENGTH / 2105 / 5115.44, rel=1e-6)
    assert grid.axial_step == pytest.approx(0.125e-6, rel=1e-12)
    assert 0.625e-6 / grid.axial_step == pytest.approx(5.0, rel=1e-12)


def test_with_the_printed_axial_step_the_first_mode_falls_by_a_third():
    # 2105 sections at 0.625 µs are a wave speed of 1023 m/s; with Z_a as printed EA = Z u is a fifth of what it is.
    p = shaft(density=RHO * (421.6333 / 421) ** -2, **UNDAMPED)
    right = continuous_frequency(p, 0.6, 133.5)
    speed = LENGTH / (2105 * 0.625e-6)
    wrong = continuous_frequency(p, 0.6, 90.0, within=0.2, rigidity=36563.32 * speed, speed=speed)
    assert speed == pytest.approx(1023.1, abs=0.05)
    assert 0.60 < wrong / right < 0.70


def test_common_step_has_eight_torsional_for_five_axial_sections():
    grid = common_step_grid(shaft(), 424)
    assert (grid.torsional_sections, grid.axial_sections, grid.axial_substeps) == (424, 265, 1)
    assert grid.time_step == pytest.approx(1e-6, rel=0.01)
    assert grid.time_step * 424 == pytest.approx(LENGTH / shaft().torsional_speed, rel=1e-12)
    assert grid.time_step * 265 == pytest.approx(LENGTH / shaft().axial_speed, rel=1e-12)


def test_static_stiffness_of_a_line_is_exact_however_its_delay_is_rounded():
    p = shaft(youngs_modulus=206e9)  # the ratio of speeds is not 8/5
    grid = common_step_grid(p, 40)
    assert grid.axial_sections * grid.time_step != pytest.approx(LENGTH / p.axial_speed, rel=1e-3)
    stiffness = grid.axial_impedance(p) / (grid.axial_sections * grid.time_step)
    assert stiffness == pytest.approx(206e9 * math.pi / 4 * 0.0341**2 / LENGTH, rel=1e-12)


def test_the_closest_grid_rounds_the_axial_delay_less_than_its_neighbours():
    # 206 and 79.6 GPa: the ratio is 1.6087, for which 8/5 is off by 0.5 % and 37/23 by 9e-6.
    p = shaft(youngs_modulus=206e9, shear_modulus=79.6e9)
    grid = closest_common_step_grid(p, 80)
    assert 80 <= grid.torsional_sections <= 160
    assert grid.axial_sections * grid.time_step == pytest.approx(LENGTH / p.axial_speed, rel=1e-5)
    assert grid.torsional_sections * grid.time_step == pytest.approx(LENGTH / p.torsional_speed, rel=1e-12)


def test_grids_that_cannot_be_are_refused():
    with pytest.raises(OutsideValidityError, match="at least 12 sections"):
        common_step_grid(shaft(), 11)
    with pytest.raises(OutsideValidityError, match="least_torsional_sections must be at least 12"):
        closest_common_step_grid(shaft(), 0)
    with pytest.raises(OutsideValidityError, match="time_step must be positive"):
        synchronised_grid(shaft(), 0.0)
