"""How residuals move with stiffnesses, masses, dampings and delays, and which effect is of which kind."""

import numpy as np
import pytest

from monitor_core.discrepancy.explanation import MisfitKind
from monitor_core.discrepancy.localisation import kind_of_effect, signatures
from monitor_core.effects import DRIVE_EFFECTS, wrong_parameter
from monitor_core.fitting.hypothesis import Hypothesis
from monitor_core.fitting.solver.hypothesis_fit import fit
from tests.discrepancy.axes import AXIS, compared, effects_by_key, measured, settings, subject, true_subject
from tests.models.extended_axes import bundled

STIFFNESS, MASS, DAMPING, DELAY = MisfitKind.STIFFNESS, MisfitKind.MASS, MisfitKind.DAMPING, MisfitKind.DELAY
#: What each effect of the table is; those of several quantities, or of none of the four kinds, have none.
KINDS = {
    "added-mass": MASS, "payload-mass": MASS, "series-compliance": STIFFNESS, "far-bearing-stiffness": STIFFNESS,
    "guide-stiffness": STIFFNESS, "servo-stiffness": STIFFNESS, "torque-delay": DELAY,
    "nut-mass": MASS, "screw-loss": DAMPING, "motor-damping": DAMPING, "response-delay": DELAY, "angle-delay": DELAY,
}  # fmt: skip


def test_kinds_of_the_table() -> None:
    found = {effect.key: kind for effect in DRIVE_EFFECTS if (kind := kind_of_effect(effect)) is not None}
    assert {key: found.get(key) for key in KINDS} == KINDS
    beyond = set(found) - set(KINDS)
    assert beyond <= {"loss-factor", "constant-loss-factor"}  # dampings, where stated by one quantity


def test_kinds_of_wrong_parameters(subtests: pytest.Subtests) -> None:
    for family, name, kind in [
        ("lumped", "bracket_stiffness_n_per_m", STIFFNESS),
        ("lumped", "coupling_stiffness_nm_per_rad", STIFFNESS),
        ("lumped", "table_mass_kg", MASS),
        ("lumped", "screw_inertia_kg_m2", MASS),
        ("lumped", "loss_factor", DAMPING),
        ("receptance", "bearing_damping_ns_per_m", DAMPING),
        ("receptance", "coupling_damping_nms_per_rad", DAMPING),
        ("lumped", "screw_length_m", None),
        ("receptance", "density_kg_per_m3", None),
    ]:
        with subtests.test(family=family, name=name):
            assert kind_of_effect(wrong_parameter(name, bundled(family).parameters)) is kind


def test_signatures_are_changes_of_the_residuals() -> None:
    """To a hundredth of what they are before the errors of the settings take up their part."""
    comparison = compared(measured(true_subject(0), settings(positions=(0.2, 0.7))))
    hypothesis = Hypothesis(subject())
    fitted = fit(comparison, hypothesis, hypothesis.null)
    table = effects_by_key()
    chosen = [table["far-bearing-stiffness"], table["added-mass"], wrong_parameter("bracket_stiffness_n_per_m", AXIS)]
    found = signatures(fitted, chosen)
    assert {kind: len(rows) for kind, rows in found.items()} == {STIFFNESS: 2, MASS: 1}
    physics, step = fitted.physics(), 1e-6
    for effect, row in zip(chosen, [found[STIFFNESS][0], found[MASS][0], found[STIFFNESS][1]], strict=True):
        (parameter,) = effect.parameters
        changed = effect.added_to(physics, {parameter.name: step * parameter.scale})
        change = (comparison.misfit(changed) - comparison.misfit(physics)) / step
        largest = np.max(np.abs(change / comparison.layout.standard_deviation))
        expected = (fitted.around.residuals(changed) - fitted.standardised) / step
        np.testing.assert_allclose(row, expected, atol=1e-2 * largest)
        assert np.linalg.norm(row - expected) < 0.05 * np.linalg.norm(expected)


def test_what_moves_nothing_has_no_signature() -> None:
    """A rotor's inertia, where the torque at the screw is given."""
    fitted = fit(
        compared(measured(true_subject(0), settings(positions=(0.2, 0.7)))), Hypothesis(subject()), np.zeros(3)
    )
    assert signatures(fitted, [wrong_parameter("motor_inertia_kg_m2", AXIS)]) == {}
