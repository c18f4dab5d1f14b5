"""The described axis: parameters move within their tolerances, effects of the file stay, candidates are complete."""

import math
from dataclasses import replace

import pytest

from monitor_core.effects import DRIVE_EFFECTS, PREFIX
from monitor_core.errors import OutsideValidityError
from monitor_core.fitting.axis import DescribedDrive
from monitor_core.models.extended import physics_of
from tests.discrepancy.axes import AXIS, SIZES, TOLERANCES, subject


def test_moved_parameters_are_those_of_an_axis_built_with_them() -> None:
    moved = subject().physics({"bearing_stiffness_n_per_m": 0.3, "loss_factor": -0.7})
    built = replace(AXIS, bearing_stiffness=1e8 * math.exp(0.3), loss_factor=0.03 * math.exp(-0.7))
    assert moved == physics_of(built)


def test_effects_of_the_file_are_part_of_the_axis() -> None:
    """Beside the uncertain parameters, which move as they do without them."""
    present = {"far-bearing-stiffness": {"stiffness_n_per_m": 2e7}, "added-mass": {"mass_kg": 1.5}}
    found = DescribedDrive(AXIS, TOLERANCES, present).physics({"bearing_stiffness_n_per_m": 0.3})
    plain = subject().physics({"bearing_stiffness_n_per_m": 0.3})
    assert found.joints == replace(plain.joints, far_bearing_stiffness=2e7)
    assert found.added == replace(plain.added, table_mass=1.5)


def test_a_wrong_parameter_of_the_file_is_carried_out() -> None:
    """As a file may state what an earlier explanation found."""
    present = {f"{PREFIX}table_mass_kg": {"ln_ratio": 0.1}}
    assert DescribedDrive(AXIS, {}, present).physics({}).bodies.table_mass == pytest.approx(20.0 * math.exp(0.1))


def test_an_axis_that_cannot_be_is_refused() -> None:
    with pytest.raises(OutsideValidityError, match=r"loss_factor must lie within 0 and 0\.9; got 60"):
        subject().physics({"loss_factor": math.log(2000.0)})


def test_candidates_are_the_table_and_what_is_uncertain() -> None:
    found = [candidate.key for candidate in subject().candidates(SIZES)]
    assert found == [*(effect.key for effect in DRIVE_EFFECTS), *(f"{PREFIX}{name}" for name in TOLERANCES)]


def test_what_is_stated_at_its_null_values_is_known_to_be_absent() -> None:
    """One end that is free, as the text of a paper says: no candidate. What is stated with a size may be another."""
    for stiffness, sought in ((0.0, False), (1e7, True)):
        present = {"far-bearing-stiffness": {"stiffness_n_per_m": stiffness}}
        drive = DescribedDrive(AXIS, {}, present)
        plain = {each.key for each in DescribedDrive(AXIS, {}, {}).candidates(SIZES)}
        assert {each.key for each in drive.candidates(SIZES)} == plain - (set() if sought else present.keys())
        assert drive.physics({}).joints.far_bearing_stiffness == stiffness


def test_without_tolerances_any_part_may_be_wrong_but_no_plain_shape() -> None:
    """Lengths, diameters, materials are measured with a rule or taken from a table."""
    found = {
        candidate.key.removeprefix(PREFIX)
        for candidate in DescribedDrive(AXIS, {}, {}).candidates(SIZES)[len(DRIVE_EFFECTS) :]
    }
    assert found == {
        "table_mass_kg", "screw_mass_kg", "nut_mass_kg", "screw_inertia_kg_m2", "bearing_stiffness_n_per_m",
        "bracket_stiffness_n_per_m", "nut_stiffness_n_per_m", "dynamic_load_rating_n", "coupling_stiffness_nm_per_rad",
        "motor_inertia_kg_m2", "loss_factor",
    }  # fmt: skip
