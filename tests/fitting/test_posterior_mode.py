"""The mode of the posterior, against the likelihood integrated over the errors of the settings."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.optimize import minimize

from monitor_core.discrepancy.verdict.classes import Member, found_parameters
from monitor_core.effects.effect import Effect, EffectParameter
from monitor_core.fitting.evidence import evidence_scale
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import fit, resolved_at
from monitor_core.fitting.solver.posterior_mode import at_mode, integrated_cost
from tests.discrepancy.axes import LinearAxis, layout_of, quantity
from tests.fitting.test_hypothesis_fit import linear

N_SETTINGS, N_VALUES = 24, 6
NOISE, TAG = 0.1, 0.5  # of a value; of the phase of a setting [rad]


@dataclass(frozen=True, eq=False)
class WaveComparison:
    """Amplitude a cos(φ + e) + b sin(φ + e) at settings whose phase is known to e only, some values at each."""

    layout: object
    phase: np.ndarray
    data: np.ndarray
    errors: np.ndarray | float = 0.0
    unit: str = "sigma"
    noise_floor: float = 1.0
    least_delta_bic: float = 10.0
    condition_error_names: tuple = ("phase",)

    def _there(self):
        errors = np.broadcast_to(self.errors, (N_SETTINGS, 1))
        return (self.phase + TAG * errors[:, 0])[self.layout.setting]

    def misfit(self, physics):
        there = self._there()
        return physics[0] * np.cos(there) + physics[1] * np.sin(there) - self.data

    def condition_errors(self, physics, misfit):
        there = self._there()
        return TAG * (-physics[0] * np.sin(there) + physics[1] * np.cos(there))[None, :]

    def shifted(self, errors):
        return replace(self, errors=self.errors + errors)

    def resolved(self, physics, errors):
        return self


def add_wave(theta, values):
    return theta + np.array([values["cosine"], values["sine"]])


WAVE = Effect(
    "wave",
    "A wave",
    "It adds.",
    "this test",
    tuple(EffectParameter(name, "-", lower=-5.0, upper=5.0, scale=1.0) for name in ("cosine", "sine")),
    add_wave,
)


def wave(seed):
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0.0, 2.0 * np.pi, N_SETTINGS)
    layout = layout_of((N_VALUES,) * N_SETTINGS, NOISE)
    there = (phase + TAG * rng.standard_normal(N_SETTINGS))[layout.setting]
    return WaveComparison(layout, phase, np.cos(there) + NOISE * rng.standard_normal(layout.n_values))


def integrated_mode(comparison):
    """Return the amplitude of the most likely wave: each error integrated out on a grid, without any linearisation."""
    errors = np.linspace(-5.0, 5.0, 401)
    angle = comparison.phase[:, None] + TAG * errors
    means = comparison.data.reshape(N_SETTINGS, N_VALUES).mean(axis=1)[:, None]  # sufficient, its noise is known

    def likelihood(a, b):
        residual = (a * np.cos(angle) + b * np.sin(angle) - means) / (NOISE / np.sqrt(N_VALUES))
        return np.sum(np.log(simpson(np.exp(-0.5 * (residual**2 + errors**2)), x=errors, axis=1)))

    return float(np.hypot(*minimize(lambda amplitudes: -likelihood(*amplitudes), [1.0, 0.0], method="Nelder-Mead").x))


@pytest.mark.release
def test_sizes_are_those_of_the_integrated_likelihood() -> None:
    """Least squares make the wave too large, by a twelfth; reference and mode agree to half a hundredth."""
    by_fit, by_mode, integrated = [], [], []
    for seed in range(16):
        comparison = wave(seed)
        found = fit(comparison, Hypothesis(LinearAxis({}, 2), (WAVE,)), np.array([1.0, 0.0]))
        by_fit.append(np.hypot(*found.coordinates))
        by_mode.append(np.hypot(*at_mode(found).coordinates))
        integrated.append(integrated_mode(comparison))
    assert np.mean(np.subtract(by_fit, integrated)) > 0.05
    assert np.max(np.abs(np.subtract(by_mode, integrated))) < 0.005
    by_fit_off, by_mode_off = (np.sqrt(np.mean(np.subtract(sizes, 1.0) ** 2)) for sizes in (by_fit, by_mode))
    assert by_mode_off < 0.4 * by_fit_off


@pytest.mark.release
def test_intervals_of_sizes_cover_where_the_errors_of_the_settings_depend_on_them() -> None:
    """At least 90 % of the true amplitude and phase in 100 tests."""
    covered = []
    for seed in range(100, 200):
        found = fit(wave(seed), Hypothesis(LinearAxis({}, 2), (WAVE,)), np.array([1.0, 0.0]))
        stated = found_parameters(Member(WAVE, found, 0.0, plausible=True), at_mode(found), evidence_scale(found))
        intervals = stated["cosine"].interval_95, stated["sine"].interval_95
        covered.append([low <= true <= high for (low, high), true in zip(intervals, (1.0, 0.0), strict=True)])
    assert np.all(np.mean(covered, axis=0) >= 0.9)


@pytest.mark.parametrize("moved", [0.0, 0.3])
def test_errors_that_act_linearly_are_integrated_by_their_linearisation(moved) -> None:
    """Two errors of each setting: the second goes out in closed form."""
    comparison, subject = linear(n_errors=2)
    hypothesis = Hypothesis(subject, (quantity(1), quantity(2)))
    found = fit(comparison, hypothesis, hypothesis.null)
    there = resolved_at(found, found.coordinates + moved)
    assert np.max(np.abs(there.around.errors)) > 0.3
    assert integrated_cost(there) == pytest.approx(there.cost, rel=1e-6)


def test_an_error_out_of_reach_stays_linear() -> None:
    """Where nothing explains the data the likely errors of the settings lie five standard deviations off."""
    comparison, subject = linear(n_errors=2)
    far = replace(comparison, data=comparison.data + 8.0 * comparison.directions[0])
    found = fit(far, Hypothesis(subject), np.zeros(1))
    assert np.min(np.abs(found.around.errors[:, 0])) > 2.5
    assert integrated_cost(found) == pytest.approx(found.cost, abs=1e-4)


def test_fit_whose_errors_of_settings_do_not_depend_on_it_is_left_as_it_is() -> None:
    comparison, subject = linear()
    hypothesis = Hypothesis(subject, (quantity(2),))
    found = fit(comparison, hypothesis, hypothesis.null)
    assert at_mode(found) is found
