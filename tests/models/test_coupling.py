"""Receptance coupling against assembled matrices, and what it refuses."""

import numpy as np
import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.models.rod import rod_receptance, wave_number
from tests.authorities.receptance_matrices import couple_receptances, ground_receptance, joint_receptance

OMEGA = np.linspace(0.3, 4.0, 40)


def structure(rng, n):
    """Dynamic stiffness of a random damped structure, shape (n_frequencies, n, n)."""
    root = rng.standard_normal((3, n, n))
    mass, stiffness, damping = (np.einsum("kij,kil->kjl", root, root) + 0.3 * np.eye(n)) * [[[1.0]], [[3.0]], [[0.1]]]
    w = OMEGA[:, None, None]
    return stiffness + 1j * w * damping - w**2 * mass


def assembled(a, b, stiffness, point_a, point_b):
    """Dynamic stiffness of both with a spring between two points."""
    n_a, n = a.shape[-1], a.shape[-1] + b.shape[-1]
    whole = np.zeros((OMEGA.size, n, n), dtype=complex)
    whole[:, :n_a, :n_a], whole[:, n_a:, n_a:] = a, b
    gap = np.zeros(n)
    gap[point_a], gap[n_a + point_b] = 1.0, -1.0
    return whole + stiffness[:, None, None] * np.outer(gap, gap)


def test_coupling_through_a_joint_is_the_inverse_of_the_assembled_stiffness():
    rng = np.random.default_rng(1)
    a, b = structure(rng, 3), structure(rng, 4)
    joint = joint_receptance(OMEGA, 2.0 + 0.1j, 0.3)
    coupled = couple_receptances(np.linalg.inv(a), np.linalg.inv(b), (2, 1), joint=joint)
    expected = np.linalg.inv(assembled(a, b, 2.0 + 0.1j + 0.3j * OMEGA, 2, 1))
    np.testing.assert_allclose(coupled, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(coupled, coupled.swapaxes(-1, -2), rtol=1e-9, atol=1e-12)  # reciprocity is kept


def test_rigid_coupling_merges_two_points_into_one():
    rng = np.random.default_rng(2)
    a, b = structure(rng, 3), structure(rng, 2)
    merge = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 0], [0, 0, 0, 1]])  # a's 2 is b's 0
    expected = np.linalg.inv(merge.T @ assembled(a, b, 0.0 * OMEGA, 0, 0) @ merge)
    coupled = couple_receptances(np.linalg.inv(a), np.linalg.inv(b), (2, 0), keep=(0, 1, 2, 4))
    np.testing.assert_allclose(coupled, expected, rtol=1e-9, atol=1e-12)


def test_a_grounded_joint_is_a_joint_to_a_body_without_receptance():
    rng = np.random.default_rng(3)
    a = structure(rng, 3)
    held = a.copy()
    held[:, 1, 1] += 5.0 + 0.2j * OMEGA
    joint = joint_receptance(OMEGA, 5.0, 0.2)
    np.testing.assert_allclose(ground_receptance(np.linalg.inv(a), 1, joint=joint), np.linalg.inv(held), rtol=1e-9)
    bed = couple_receptances(np.linalg.inv(a), np.zeros((OMEGA.size, 1, 1)), (1, 0), joint=joint, keep=(0, 1, 2))
    np.testing.assert_allclose(ground_receptance(np.linalg.inv(a), 1, joint=joint), bed, rtol=1e-12)


def test_two_pieces_of_a_rod_are_the_rod():
    wave = wave_number(2 * np.pi * np.linspace(50.0, 3000.0, 100), 2e11, 7850.0)
    near, far, whole = (rod_receptance(2.5e8, wave, length) for length in (0.6, 2.0, 2.6))
    np.testing.assert_allclose(couple_receptances(near, far, (1, 0), keep=(0, 3)), whole, rtol=1e-8)


def test_printed_joint_is_a_stiffness_and_leaves_the_end_free():
    # Eqs. (6) and (8) print [1/(k + jωc)]⁻¹ = k + jωc where a receptance is added to receptances. A mass on a spring:
    mass, stiffness, omega = 2.0, 8.0e7, np.array([1000.0])
    free = (-1.0 / (mass * omega**2))[:, None, None]
    right = ground_receptance(free, 0, joint=joint_receptance(omega, stiffness, 0.0))
    printed = ground_receptance(free, 0, joint=stiffness + 0j * omega)
    assert right.item() == pytest.approx(1.0 / (stiffness - mass * 1e6))
    assert printed.item() == pytest.approx(free.item(), rel=1e-12)


def test_leading_axes_are_carried_along():
    rng = np.random.default_rng(4)
    a, b = np.linalg.inv(structure(rng, 2)), np.linalg.inv(structure(rng, 2))
    draws = np.stack([a, 2 * a, 3 * a])
    together = couple_receptances(draws, b, (1, 0))
    assert together.shape == (3, OMEGA.size, 4, 4)
    np.testing.assert_allclose(together[2], couple_receptances(3 * a, b, (1, 0)), rtol=1e-12)


def test_what_does_not_fit_is_refused():
    a, b = np.ones((5, 2, 2)), np.ones((5, 1, 1))
    with pytest.raises(OutsideValidityError, match=r"must be square .* got \(5, 2, 1\)"):
        couple_receptances(np.ones((5, 2, 1)), b, (0, 0))
    with pytest.raises(OutsideValidityError, match="must be square"):
        ground_receptance([1.0, 2.0], 0)
    with pytest.raises(OutsideValidityError, match="B has points 0 to 0; got 1"):
        couple_receptances(a, b, (0, 1))
    with pytest.raises(OutsideValidityError, match="the assembly has points 0 to 2; got 3"):
        couple_receptances(a, b, (0, 0), keep=(0, 3))
    with pytest.raises(OutsideValidityError, match=r"matching leading axes; got \(5,\), \(5,\), \(4,\)"):
        couple_receptances(a, b, (0, 0), joint=np.ones(4))
    with pytest.raises(OutsideValidityError, match="matching leading axes"):
        ground_receptance(a, 0, joint=np.ones(4))
    with pytest.raises(OutsideValidityError, match="must have stiffness or damping"):
        joint_receptance(OMEGA, 0.0, 0.0)
