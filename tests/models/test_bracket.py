"""An accelerometer on the nut against a drive of three bodies, solved as one system of equations."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from monitor_core.models.bracket import beyond_contacts, nut_from_table, nut_receptances

OMEGA = 2.0 * np.pi * np.linspace(20.0, 900.0, 150)
S = 1j * OMEGA
SCREW_INERTIA, RATIO = 1.5e-4, 1.6e-3  # [kg·m²], [m/rad]
CONTACTS, GROUND, BRACKET = 4.7e8 * (1.0 + 0.03j), 6.0e7 * (1.0 + 0.03j), 4.5e7 * (1.0 + 0.03j)  # [N/m]
TABLE, NUT, GUIDE = 20.0, 1.3, 500.0  # [kg], [kg], [N·s/m]


def chain(nut_mass_at_nut: bool) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return the inverse of the dynamic stiffness of screw, nut and table, and the column that a torque loads.

    The screw turns freely at its end and is held axially by a spring to ground: its coordinates are its turning θ and
    its travel; the nut's contacts press along iθ + travel.
    """
    table_mass, nut_mass = (TABLE, NUT) if nut_mass_at_nut else (TABLE + NUT, 0.0)
    contact = np.array([RATIO, 1.0, -1.0, 0.0])  # of (θ, travel, nut, table)
    bracket = np.array([0.0, 0.0, 1.0, -1.0])
    stiffness = CONTACTS * np.outer(contact, contact) + BRACKET * np.outer(bracket, bracket)
    stiffness[1, 1] += GROUND
    mass = np.diag([SCREW_INERTIA, 0.0, nut_mass, table_mass])
    damping = np.diag([0.0, 0.0, 0.0, GUIDE])
    at = S[:, None, None]
    return np.linalg.inv(mass * at**2 + damping * at + stiffness), np.array([1.0, 0.0, 0.0, 0.0])


def test_nut_of_a_chain_with_its_mass_at_the_table_is_that_of_the_chain_with_it_at_the_nut() -> None:
    true, torque = chain(nut_mass_at_nut=True)
    model, _ = chain(nut_mass_at_nut=False)
    beyond = beyond_contacts(
        S, table_mass=TABLE, nut_mass=NUT, table_damping=GUIDE, bracket_stiffness=4.5e7, loss_factor=0.03
    )
    per_force, per_torque = nut_from_table(model[:, 3, 3], (model @ torque)[:, 3], beyond)
    np.testing.assert_allclose(per_force, true[:, 2, 3], rtol=1e-8)
    np.testing.assert_allclose(per_torque, (true @ torque)[:, 2], rtol=1e-8)
    # the mass of the nut counts: with it on the table the nut would answer otherwise
    assert np.max(np.abs((model @ torque)[:, 2] / per_torque - 1.0)) > 0.05


def test_antiresonance_of_the_nut_is_the_table_on_its_bracket() -> None:
    swinging = np.array([1j * math.sqrt(4.5e7 / TABLE)])
    beyond = beyond_contacts(swinging, table_mass=TABLE, nut_mass=NUT, bracket_stiffness=4.5e7)
    _, per_torque = nut_receptances(np.array([6e-8 + 0j]), np.array([1e-3 + 0j]), beyond)
    assert abs(per_torque[0]) < 1e-15
    _, elsewhere = nut_receptances(
        np.array([6e-8 + 0j]),
        np.array([1e-3 + 0j]),
        beyond_contacts(0.9 * swinging, table_mass=TABLE, nut_mass=NUT, bracket_stiffness=4.5e7),
    )
    assert abs(elsewhere[0]) > 1e-5


def test_without_a_bracket_the_nut_is_the_table() -> None:
    compliance, travel = np.full(S.size, 6e-8 + 1e-9j), np.full(S.size, 1e-3 + 0j)
    beyond = beyond_contacts(S, table_mass=TABLE, nut_mass=NUT, table_damping=GUIDE)
    table = (TABLE + NUT) * S**2 + GUIDE * S
    per_force, per_torque = nut_receptances(compliance, travel, beyond)
    np.testing.assert_allclose(per_force, compliance / (1.0 + compliance * table), rtol=1e-12)
    np.testing.assert_allclose(per_torque, travel / (1.0 + compliance * table), rtol=1e-12)


@pytest.mark.parametrize("loss_factor", [0.0, 0.05])
def test_rigid_bracket_yields_nothing_whatever_its_loss(loss_factor: float) -> None:
    assert beyond_contacts(S, table_mass=TABLE, loss_factor=loss_factor).bracket == 0.0
