"""Small systems and their damping: closed forms, and the laws that every passive system obeys."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from monitor_core.errors import OutsideValidityError
from monitor_core.models.protocol import ExcitationPoint, ResponsePoint
from monitor_core.models.published.small_drive import (
    DriveEquations,
    SecondOrderSystem,
    complex_stiffness,
    drive_natural_frequencies,
    drive_normal_modes,
    drive_response,
    effective_loss_factor,
    equivalent_viscous_damping,
    poles,
    series_stiffness,
    transfer_matrix,
    undamped_modes,
)

SPRING = np.array([[1.0, -1.0], [-1.0, 1.0]])


def one_mass(mass=2.0, damping=0.6, stiffness=50.0 + 0.0j):
    return SecondOrderSystem([[mass]], [[damping]], [[stiffness]])


def random_system(seed, n=4, loss_factor=0.0):
    """Symmetric, positive definite M, C and K; every mode below critical damping."""
    factors = np.random.default_rng(seed).normal(size=(3, n, n))
    mass, damping, stiffness = factors @ factors.transpose(0, 2, 1) + 0.1 * np.eye(n)
    return SecondOrderSystem(mass, 0.005 * damping, 30.0 * stiffness * (1.0 + 1j * loss_factor))


def companion_eigenvalues(system):
    """All 2n eigenvalues of the state space, without any choice among them."""
    n = system.mass.shape[0]
    inverse = np.linalg.inv(system.mass)
    lower = np.hstack([-inverse @ system.stiffness, -inverse @ system.damping])
    return np.linalg.eigvals(np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), lower]))


# --- closed forms ----------------------------------------------------------------------------------------------------


def test_one_mass_on_a_damped_spring():
    omega = np.linspace(0.5, 20.0, 40)
    response = transfer_matrix(one_mass(), 1j * omega)[:, 0, 0]
    assert response == pytest.approx(1.0 / (50.0 - 2.0 * omega**2 + 0.6j * omega), rel=1e-13)
    decay = 0.6 / (2.0 * 2.0)
    assert poles(one_mass()) == pytest.approx([-decay + 1j * np.sqrt(25.0 - decay**2)], rel=1e-13)


def test_one_mass_on_a_spring_with_loss_factor():
    """With m s² = −k(1 + jη) the root above the real axis decays, the one below it grows."""
    system = one_mass(damping=0.0, stiffness=complex_stiffness(50.0, 0.3))
    expected = 5j * np.sqrt(1.0 + 0.3j)
    assert poles(system) == pytest.approx([expected], rel=1e-13)
    assert expected.real < 0.0
    assert max(companion_eigenvalues(system).real) == pytest.approx(-expected.real, rel=1e-12)


def test_two_free_masses_have_one_rigid_body_mode_and_one_elastic():
    system = SecondOrderSystem(np.diag([1.0, 3.0]), np.zeros((2, 2)), 12.0 * SPRING)
    omega, shapes = undamped_modes(system)
    assert omega == pytest.approx([0.0, 4.0], abs=1e-12)  # ω² = k (1/m₁ + 1/m₂)
    assert omega[0] == 0.0
    assert np.abs(shapes) == pytest.approx(np.array([[0.5, np.sqrt(0.75)], [0.5, np.sqrt(0.75) / 3.0]]), rel=1e-12)
    assert np.array_equal(poles(system), 1j * omega)


@pytest.mark.parametrize("loss_factor", [0.0, 0.1])
def test_friction_on_a_free_mass_leaves_one_rigid_body_pole_and_the_elastic_one(loss_factor):
    """The pole against the roots of the characteristic polynomial, in which s = 0 is factored out by hand."""
    k, c = complex_stiffness(12.0, loss_factor), 0.4
    rigid, elastic = poles(SecondOrderSystem(np.diag([1.0, 3.0]), np.diag([c, 0.0]), k * SPRING))
    # (s² + c s + k)(3 s² + k) − k² = s [3 s³ + 3 c s² + 4 k s + c k]
    roots = np.roots([3.0, 3.0 * c, 4.0 * k, c * k])
    assert rigid == 0.0
    assert elastic == pytest.approx(roots[np.argmax(roots.imag)], rel=1e-12)


def test_springs_in_series_add_their_compliances_and_share_the_loss():
    lossy, clean = complex_stiffness(4.0, 0.2), complex_stiffness(12.0, 0.0)
    chain = series_stiffness(lossy, clean, complex_stiffness(float("inf"), 0.2))
    assert chain == pytest.approx(lossy * clean / (lossy + clean), rel=1e-14)
    # to first order the loss factor is weighted by the share in the compliance, here 3/4
    assert effective_loss_factor(chain) == pytest.approx(0.75 * 0.2, rel=0.02)
    assert series_stiffness(4.0, 12.0) == pytest.approx(3.0, rel=1e-15)
    assert complex_stiffness(float("inf"), 0.2) == complex(float("inf"), 0.0)  # what does not give loses nothing


def test_equivalent_viscous_damper_takes_the_energy_of_the_loss_factor():
    """Work of both forces over one cycle of x = X cos ωt, by quadrature: π η k X²."""
    k, eta, omega, amplitude = 2e7, 0.053, 1800.0, 3e-6
    phase = 2.0 * np.pi * np.arange(256) / 256
    velocity = -amplitude * omega * np.sin(phase)
    work = {
        "viscous": np.mean(equivalent_viscous_damping(complex_stiffness(k, eta), omega) * velocity**2),
        "hysteretic": np.mean((complex_stiffness(k, eta) * amplitude * np.exp(1j * phase)).real * velocity),
    }
    for mean_power in work.values():
        assert mean_power * 2.0 * np.pi / omega == pytest.approx(np.pi * eta * k * amplitude**2, rel=1e-12)


# --- laws ------------------------------------------------------------------------------------------------------------


@given(seed=st.integers(0, 10_000), loss_factor=st.sampled_from([0.0, 0.02, 0.2]))
def test_every_pole_makes_the_dynamic_stiffness_singular_and_decays(seed, loss_factor):
    system = random_system(seed, loss_factor=loss_factor)
    found = poles(system)
    assert found.shape == (4,)
    assert np.all(found.imag > 0.0)
    assert np.all(found.real < 0.0)
    for s in found:
        singular = np.linalg.svd(system.mass * s**2 + system.damping * s + system.stiffness, compute_uv=False)
        assert singular[-1] < 1e-10 * singular[0]


@given(seed=st.integers(0, 10_000), omega=st.floats(0.01, 100.0), loss_factor=st.sampled_from([0.0, 0.05]))
def test_responses_are_reciprocal_and_passive(seed, omega, loss_factor):
    response = transfer_matrix(random_system(seed, loss_factor=loss_factor), np.array([1j * omega]))[0]
    scale = np.abs(response).max()
    assert np.abs(response - response.T).max() <= 1e-10 * scale
    # energy flows in, whatever the pattern of forces: the imaginary part is negative semidefinite
    assert np.linalg.eigvalsh(0.5 * (response.imag + response.imag.T)).max() <= 1e-12 * scale


def test_modal_superposition_of_a_proportionally_damped_system_is_its_response():
    base = random_system(5)
    system = SecondOrderSystem(base.mass, 0.02 * base.mass + 1e-3 * base.stiffness.real, base.stiffness)
    equations = DriveEquations(system, np.array([0.0, 1.0, 0.0, 0.0]), np.array([0.0, 0.3, 0.0, 2.0]))
    modes = drive_normal_modes(equations)
    omega_n = 2.0 * np.pi * modes.frequency
    assert modes.damping_ratio == pytest.approx(0.01 / omega_n + 5e-4 * omega_n, rel=1e-10)

    frequency = np.linspace(0.02, 4.0, 200)
    omega = 2.0 * np.pi * frequency[:, None]
    denominator = omega_n**2 - omega**2 + 2j * modes.damping_ratio * omega_n * omega
    summed = np.sum(modes.angle_at_motor * modes.displacement_at_table / denominator, axis=1)
    asked = drive_response(
        equations, frequency, ExcitationPoint.TORQUE_AT_MOTOR, ResponsePoint.DISPLACEMENT_AT_TABLE
    ).response
    assert np.abs(asked - summed).max() < 1e-11 * np.abs(asked).max()


def test_damping_of_close_modes_was_paired_by_magnitude_with_the_wrong_mode():
    """Two masses that do not know of each other; damping lifts the pole of the lower one above that of the other."""
    lossy, clean = complex_stiffness(1.0, 0.3), complex_stiffness(1.005, 0.1)
    system = SecondOrderSystem(np.eye(2), np.zeros((2, 2)), np.diag([lossy, clean]))
    modes = drive_normal_modes(DriveEquations(system, np.zeros(2), np.array([1.0, 0.0])))
    own = 1j * np.sqrt([lossy, clean])
    assert abs(own[0]) > abs(own[1])
    assert modes.frequency * 2.0 * np.pi == pytest.approx([1.0, np.sqrt(1.005)], rel=1e-12)
    assert np.abs(modes.displacement_at_table) == pytest.approx([1.0, 0.0])
    assert modes.damping_ratio == pytest.approx(-own.real / np.abs(own), rel=1e-10)
    assert np.abs(poles(system)) == pytest.approx(np.sort(np.abs(own)))  # the poles themselves stay in their order


def test_natural_frequencies_are_magnitude_and_cosine_of_the_poles():
    equations = DriveEquations(one_mass(), np.array([0.0]), np.array([1.0]))
    (mode,) = drive_natural_frequencies(equations)
    assert mode.frequency * 2.0 * np.pi == pytest.approx(5.0, rel=1e-12)
    assert mode.damping_ratio == pytest.approx(0.6 / (2.0 * 2.0 * 5.0), rel=1e-12)


def test_acceleration_is_minus_omega_squared_times_displacement():
    equations = DriveEquations(one_mass(), np.array([0.0]), np.array([1.0]))
    frequency = np.array([0.2, 0.8, 3.0])
    force = ExcitationPoint.FORCE_AT_TABLE
    accelerance = drive_response(equations, frequency, force, ResponsePoint.ACCELERATION_AT_TABLE)
    receptance = drive_response(equations, frequency, force, ResponsePoint.DISPLACEMENT_AT_TABLE)
    assert (accelerance.quantity, receptance.quantity) == ("accelerance", "receptance")
    ratio = accelerance.response / receptance.response
    assert ratio == pytest.approx(-((2.0 * np.pi * frequency) ** 2), rel=1e-14)


# --- refusals --------------------------------------------------------------------------------------------------------


def test_what_does_not_oscillate_has_no_natural_frequency():
    with pytest.raises(OutsideValidityError, match="beyond critical"):
        poles(one_mass(damping=25.0))  # critical: 2 √(k m) = 20


def test_a_loss_factor_has_no_meaning_below_the_real_axis():
    lossy = one_mass(stiffness=50.0 + 1.0j)
    with pytest.raises(OutsideValidityError, match="positive imaginary part"):
        transfer_matrix(lossy, np.array([1j, -1j]))
    assert transfer_matrix(one_mass(), np.array([-1j])).shape == (1, 1, 1)


@pytest.mark.parametrize(
    ("refused", "match"),
    [
        (lambda: SecondOrderSystem(np.eye(2), np.eye(1), np.eye(2)), "of one size"),
        (lambda: DriveEquations(one_mass(), np.zeros(2), np.zeros(1)), "angle_at_motor"),
        (lambda: series_stiffness(1.0, 0.0), "must not be zero"),
        (lambda: series_stiffness(float("inf")), "nor all of them infinite"),
        (lambda: equivalent_viscous_damping(1.0 + 1.0j, 0.0), "omega must be positive"),
        (
            lambda: drive_response(
                DriveEquations(one_mass(), np.zeros(1), np.ones(1)),
                np.array([1.0]),
                ExcitationPoint.FORCE_AT_TABLE,
                ResponsePoint.ANGLE_AT_MOTOR,
            ),
            "clamped",
        ),
    ],
)
def test_what_does_not_fit_is_refused(refused, match):
    with pytest.raises(OutsideValidityError, match=match):
        refused()
