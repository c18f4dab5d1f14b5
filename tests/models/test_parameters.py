"""One vocabulary for all families: names, units, ranges."""

import math
from dataclasses import MISSING, fields

import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.models.families import FAMILIES
from monitor_core.models.motion import MotionParameters
from monitor_core.models.parameters import PARAMETERS, name_in_file, unit_of
from monitor_core.models.published.hybrid import HybridParameters

STATED = {
    "table_mass_kg": 10.0, "screw_length_m": 0.7465, "screw_diameter_m": 0.02, "screw_lead_m": 0.02,
    "youngs_modulus_pa": 2.2e11, "shear_modulus_pa": 0.8e11, "density_kg_per_m3": 7830.0,
    "motor_inertia_kg_m2": 1.56e-4,
    "coupling_stiffness_nm_per_rad": 2.681e4, "bearing_stiffness_n_per_m": 6.21e7, "nut_stiffness_n_per_m": 6.85e7,
}  # fmt: skip


def test_words_are_unique_and_every_family_speaks_them() -> None:
    words = [word.name for word in PARAMETERS]
    assert len(set(words)) == len(words)
    for family in FAMILIES:
        assert {item.name for item in fields(family.parameters)} <= set(words)


def test_every_word_is_used_by_a_family() -> None:
    records = [MotionParameters, *(family.parameters for family in FAMILIES)]
    used = {item.name for record in records for item in fields(record)}
    assert used == {word.name for word in PARAMETERS}


def test_a_name_in_a_file_ends_with_its_unit() -> None:
    assert name_in_file("coupling_damping") == "coupling_damping_nms_per_rad"
    assert unit_of("coupling_damping") == "N·m·s/rad"
    assert name_in_file("loss_factor") == "loss_factor"


def test_names_of_a_file_make_the_record_and_come_back() -> None:
    record = HybridParameters.from_file_names(STATED | {"loss_factor": 0.053}, "hybrid")
    assert record.table_mass == 10.0
    assert record.bracket_stiffness == math.inf  # not stated: rigid
    back = record.to_file_names()
    assert HybridParameters.from_file_names(back, "hybrid") == record
    assert "bracket_stiffness_n_per_m" not in back


def test_what_does_not_fit_is_refused_in_one_sentence(subtests: pytest.Subtests) -> None:
    for changes, said in [
        ({"table_mass": 10.0}, "a hybrid model has no parameter table_mass; it has .*table_mass_kg"),
        ({"screw_mass_kg": 1.0}, "a hybrid model has no parameter screw_mass_kg"),
        ({"table_mass_kg": 0.0}, "table_mass_kg must be positive and finite; got 0.0 kg"),
        ({"table_mass_kg": math.nan}, "table_mass_kg must be positive and finite; got nan kg"),
        ({"motor_damping_nms_per_rad": -1.0}, "must be finite and not negative; got -1.0 N·m·s/rad"),
        ({"bracket_stiffness_n_per_m": 0.0}, "bracket_stiffness_n_per_m must be positive and finite; got 0.0 N/m"),
        ({"screw_diameter_m": 1e300}, "screw_diameter_m must lie within 1e-06 and 1000 m; got 1e\\+300"),
        ({"screw_lead_m": 1e-200}, "screw_lead_m must lie within 1e-06 and 1000 m; got 1e-200"),
        ({"loss_factor": 5.0}, "loss_factor must lie within 0 and 0.9; got 5"),
        ({"loss_factor": math.inf}, "loss_factor must be finite and not negative; got inf$"),
    ]:
        with subtests.test(changes=changes, said=said), pytest.raises(OutsideValidityError, match=said):
            HybridParameters.from_file_names(STATED | changes, "hybrid")


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.name)
def test_what_is_missing_is_named(family) -> None:
    required = [item.name for item in fields(family.parameters) if item.default is MISSING]
    with pytest.raises(OutsideValidityError, match=f"a {family.name} model needs .*{name_in_file(required[-1])}"):
        family.parameters.from_file_names({}, family.name)
