"""A rod against its modal series, against itself, and against the print."""

import numpy as np
import pytest

from monitor_core.models.rod import rod_receptance, rod_waves, wave_number
from tests.models.rods import condensed_stiffness, rod_dynamic_stiffness

LENGTH, DIAMETER, DENSITY, YOUNGS, SHEAR = 1.3, 0.04, 7850.0, 2e11, 7.75e10
AREA, POLAR = np.pi * DIAMETER**2 / 4, np.pi * DIAMETER**4 / 32
OMEGA = 2 * np.pi * np.linspace(20.0, 5000.0, 301)


def modal_series(rigidity, inertia, omega, n_modes=20_000):
    """Receptance of a free rod from its modes, cos(nπx/l); inertia per length [kg/m] or [kg·m]."""
    n = np.arange(1, n_modes)
    elastic = 2.0 / (inertia * LENGTH * ((rigidity / inertia) * (n * np.pi / LENGTH) ** 2 - omega[:, None] ** 2))
    rigid = -1.0 / (inertia * LENGTH * omega**2)
    return rigid + elastic.sum(axis=1), rigid + (elastic * (-1.0) ** n).sum(axis=1)


@pytest.mark.parametrize(("modulus", "section"), [(YOUNGS, AREA), (SHEAR, POLAR)], ids=["axial", "torsional"])
def test_receptance_is_the_sum_over_the_modes_of_a_free_rod(modulus, section):
    own, across = modal_series(modulus * section, DENSITY * section, OMEGA)
    receptance = rod_receptance(modulus * section, wave_number(OMEGA, modulus, DENSITY), LENGTH)
    scale = 2.0 * LENGTH / (modulus * section)  # the series is cut off: what is left is (2l/ES)/(π² n_modes)
    np.testing.assert_allclose(receptance[:, 0, 0], own, rtol=1e-9, atol=1e-5 * scale)
    np.testing.assert_allclose(receptance[:, 0, 1], across, rtol=1e-9, atol=1e-8 * scale)


def test_printed_cosine_is_no_receptance_of_a_free_rod():
    # Eqs. (1)-(2) print −cos for −cot: it stays finite where the rod resonates, and at rest it has half the rigid mass
    rigidity = YOUNGS * AREA
    wave = wave_number(OMEGA, YOUNGS, DENSITY)
    printed = -np.cos(wave * LENGTH) / (rigidity * wave)
    own, _ = modal_series(rigidity, DENSITY * AREA, OMEGA, 2000)
    first_mode = np.argmin(np.abs(wave * LENGTH - np.pi))
    assert abs(own[first_mode]) > 50 * abs(printed[first_mode])
    mass_line = -1.0 / (DENSITY * AREA * LENGTH * OMEGA[0] ** 2)
    assert own[0] / mass_line == pytest.approx(1.0, abs=1e-2)
    assert abs(printed[0] / mass_line - 1.0) > 0.5


def test_dynamic_stiffness_is_the_inverse_of_the_receptance():
    wave = wave_number(OMEGA, SHEAR, DENSITY)
    wave = wave[np.abs(np.sin(wave * LENGTH)) > 0.01]  # at its own resonances the rod has neither of the two
    product = rod_receptance(SHEAR * POLAR, wave, LENGTH) @ rod_dynamic_stiffness(SHEAR * POLAR, wave, LENGTH)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(2), product.shape), atol=1e-9)


def test_condensed_stiffness_is_the_dynamic_stiffness_with_one_end_eliminated():
    wave = wave_number(OMEGA, YOUNGS, DENSITY)
    end = 4e7 + 1j * OMEGA * 2e3 - 0.5 * OMEGA**2
    matrix = rod_dynamic_stiffness(YOUNGS * AREA, wave, LENGTH)
    eliminated = matrix[:, 0, 0] - matrix[:, 0, 1] ** 2 / (matrix[:, 1, 1] + end)
    np.testing.assert_allclose(condensed_stiffness(YOUNGS * AREA, wave, LENGTH, end), eliminated, rtol=1e-9)


def test_waves_run_on_e_axially_and_on_g_in_torsion():
    # speeds of sound in steel
    assert OMEGA[0] / wave_number(OMEGA[:1], YOUNGS, DENSITY) == pytest.approx(5048, abs=1)
    assert OMEGA[0] / wave_number(OMEGA[:1], SHEAR, DENSITY) == pytest.approx(3142, abs=1)


def test_complex_frequency_continues_the_real_one():
    # Cauchy-Riemann: the derivative along the imaginary axis is j times that along the real one
    def waves(omega):
        parts = rod_waves(YOUNGS * AREA, wave_number(np.array([omega], dtype=complex), YOUNGS, DENSITY), LENGTH)
        return np.array([parts.cosine[0], parts.sine_over_z[0], parts.z_sine[0]])

    along = waves(3000.0 + 1e-3) - waves(3000.0 - 1e-3)
    beside = waves(3000.0 + 1e-3j) - waves(3000.0 - 1e-3j)
    np.testing.assert_allclose(beside, 1j * along, rtol=1e-6)
    cosine, sine_over_z, z_sine = waves(3000.0 + 200.0j)
    assert cosine**2 + sine_over_z * z_sine == pytest.approx(1.0, abs=1e-12)
