"""A, B, C, D for a controller design: against scipy, a free rod in closed form, and the model's own responses."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from monitor_core.errors import OutsideValidityError
from monitor_core.models.published.hybrid import HybridModel
from monitor_core.models.published.small_drive import SecondOrderSystem, transfer_matrix
from monitor_core.models.state_space import relative_error, state_space
from tests.models.test_hybrid import AS_PUBLISHED, AT_300_MM, UNDAMPED

LINES = 2j * np.pi * np.geomspace(1.0, 1000.0, 2001)


# scipy goes by way of polynomials, and says of rounding in their first coefficients that it leaves it out
pytestmark = pytest.mark.filterwarnings("ignore:Badly conditioned filter coefficients")


def freqresp(space):
    """Return the responses of a state space by scipy, of one input at a time, shape (n_lines, outputs, inputs)."""
    columns = [
        scipy.signal.StateSpace(space.A, space.B[:, [i]], space.C[[j]], space.D[[j]][:, [i]])
        for j in range(len(space.C))
        for i in range(space.B.shape[1])
    ]
    responses = [column.freqresp(LINES.imag)[1] for column in columns]
    return np.array(responses).T.reshape(LINES.size, len(space.C), -1)


def test_without_loss_factor_it_is_eq_13_and_scipys():
    """Damped by the motor alone, which damps no mode by itself: G of Eq. (13) by its matrices, to rounding."""
    system = HybridModel(replace(UNDAMPED, motor_damping=0.026)).equations(AT_300_MM).system
    space = state_space(system, 2)
    assert relative_error(transfer_matrix(system, LINES), freqresp(space)) < 1e-4  # rounding of its polynomials
    assert relative_error(transfer_matrix(system, LINES), space.transfer_matrix(LINES)) < 1e-11


def test_a_loss_factor_becomes_a_viscous_damping_that_loses_as_much_at_the_resonance():
    model = HybridModel(AS_PUBLISHED)
    space = state_space(model.equations(AT_300_MM).system, 2)
    poles = np.linalg.eigvals(space.A)
    assert poles.real.max() < 1e-6  # one is that of a drive at rest anywhere
    elastic = poles[np.argmax(poles.imag)]
    assert round(-100.0 * elastic.real / abs(elastic), 2) == 2.87  # printed
    exact = model.transfer_matrix(LINES, AT_300_MM)
    # between the lines 2ζ = η is off by η_e at most: what a constant loss angle loses away from the resonance
    assert 0.02 < relative_error(exact, freqresp(space)) < 0.0435
    at_resonance = np.array([1j * 1863.4])
    stiffness = model.equations(AT_300_MM).system.stiffness
    assert np.linalg.norm(stiffness.imag) / np.linalg.norm(stiffness.real) == pytest.approx(0.0435, abs=1e-4)
    apart = relative_error(model.transfer_matrix(at_resonance, AT_300_MM), space.transfer_matrix(at_resonance))
    assert apart < 1e-3


def free_rod(n_elements):
    """Return a steel bar of 1.3 m as finite elements with consistent mass, its E S and ρ S."""
    rigidity, per_length, step = 2e11 * 1.2566e-3, 7850.0 * 1.2566e-3, 1.3 / n_elements
    mass, stiffness = np.zeros((2, n_elements + 1, n_elements + 1))
    for i in range(n_elements):
        piece = np.s_[i : i + 2, i : i + 2]
        mass[piece] += per_length * step / 6.0 * np.array([[2.0, 1.0], [1.0, 2.0]])
        stiffness[piece] += rigidity / step * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return SecondOrderSystem(mass, np.zeros_like(mass), stiffness), rigidity, per_length


def test_a_free_rod_of_few_modes_is_its_closed_form_with_the_static_share_of_the_others():
    """−cot λl/(E S λ) at an end. Modes stand at n · 1941 Hz: up to 1 kHz the others act by their springs alone."""
    system, rigidity, per_length = free_rod(200)
    wave = LINES.imag * np.sqrt(per_length / rigidity)
    closed = -1.0 / (np.tan(wave * 1.3) * rigidity * wave)
    across = -1.0 / (np.sin(wave * 1.3) * rigidity * wave)
    exact = np.array([[closed, across], [across, closed]]).transpose(2, 0, 1)
    errors, without = [], []
    for n_modes in (1, 2, 4, 8):
        space = state_space(system, n_modes)
        ends = space.transfer_matrix(LINES)[:, [0, -1]][:, :, [0, -1]]
        errors.append(relative_error(exact, ends))
        without.append(relative_error(exact, ends - space.D[[0, -1]][:, [0, -1]]))
        assert space.A.shape == (2 * n_modes, 2 * n_modes)
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1e-3
    # of what the modes left out do, their springs leave (f/f_r)² at most; f = 1 kHz, f_r = n · 1941 Hz
    bounds = [(1000.0 / 1941.0 / n_modes) ** 2 for n_modes in (1, 2, 4, 8)]
    assert [e < b * w for e, b, w in zip(errors, bounds, without, strict=True)] == [True] * 4
    assert without[-1] > 0.04


@pytest.mark.parametrize("n_modes", [0, 3])
def test_modes_that_a_drive_has_not_are_refused(n_modes):
    with pytest.raises(OutsideValidityError, match="must be 1 to 2"):
        state_space(HybridModel(UNDAMPED).equations(AT_300_MM).system, n_modes)
