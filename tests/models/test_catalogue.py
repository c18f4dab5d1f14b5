"""A drive of catalogue data: its band holds what was measured, and moves as physics has it."""

import csv
import math
from dataclasses import replace

import pytest

from monitor_core.errors import OutsideValidityError
from monitor_core.models import DriveConditions, MotorEnd
from monitor_core.models.catalogue import (
    BearingArrangement,
    CatalogueData,
    NutKind,
    drive_from_catalogue,
    expected_mode,
)
from monitor_core.models.extended import ExtendedModel
from monitor_core.models.published.receptance import ReceptanceModel
from tests.conftest import PROJECT_ROOT

PUBLISHED = PROJECT_ROOT / "replay_data" / "published"
#: What Table 1 of Nguyen et al. (2018) has of a catalogue: nothing of bearings, bracket and coupling.
NGUYEN = CatalogueData(
    screw_diameter=0.020, screw_lead=0.006, screw_length=0.971, moved_mass=20.54 + 1.3, nut_stiffness=470e6,
    dynamic_load_rating=4000.0, preload=300.0,
)  # fmt: skip


@pytest.mark.parametrize("motor_end", [MotorEnd.PRESCRIBED, MotorEnd.FREE])
def test_the_band_holds_every_frequency_of_table_2(motor_end) -> None:
    with (PUBLISHED / "nguyen_table2.csv").open() as file:
        measured = [float(row["frequency_hz"]) for row in csv.DictReader(file)]
    low, high = expected_mode(drive_from_catalogue(NGUYEN), motor_end).band
    assert len(measured) == 18
    assert low < min(measured)
    assert max(measured) < high
    assert high / low < 2.0  # an octave: it leaves one mode to be found


def test_the_line_is_what_the_receptance_model_of_the_paper_says() -> None:
    drive = drive_from_catalogue(NGUYEN)
    mode = expected_mode(drive, MotorEnd.PRESCRIBED)
    found = ReceptanceModel(drive.parameters).natural_frequencies(
        DriveConditions(float(mode.position[2]), 300.0), MotorEnd.PRESCRIBED
    )
    assert mode.frequency[2] == pytest.approx(found[1].frequency, rel=1e-6)


def test_four_times_the_mass_halves_the_frequency_of_a_heavy_table() -> None:
    heavy = replace(NGUYEN, moved_mass=2000.0)
    frequency = [
        expected_mode(drive_from_catalogue(data), MotorEnd.CLAMPED).frequency
        for data in (heavy, replace(heavy, moved_mass=8000.0))
    ]
    assert frequency[0] / frequency[1] == pytest.approx(2.0, rel=2e-3)  # but for the screw's own mass


def test_a_screw_held_at_both_ends_is_stiffer_and_alike_from_both() -> None:
    one_end, both = (
        expected_mode(drive_from_catalogue(replace(NGUYEN, bearings=arrangement)), MotorEnd.PRESCRIBED).frequency
        for arrangement in (BearingArrangement.FIXED_FREE, BearingArrangement.FIXED_FIXED)
    )
    assert (both > one_end).all()
    assert both[0] == pytest.approx(both[-1], rel=0.02)  # torsion alone knows the motor's end


def test_makers_preload_double_nuts_higher() -> None:
    assert CatalogueData().set_preload > CatalogueData(nut_kind=NutKind.OVERSIZE_BALLS).set_preload
    assert CatalogueData(preload=123.0).set_preload == 123.0


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"preload": 401.0}, "at most 10 % of the dynamic load rating, 400 N; got 401 N"),
        ({"screw_diameter": 0.0}, "screw_diameter_m must be positive"),
        ({"screw_length": 100.0}, "at most 4 m long, or it would not stay straight; got 100 m"),
        ({"moved_mass": math.nan}, "table_mass_kg must be positive"),
    ],
)
def test_what_is_no_axis_is_refused_in_a_sentence(change, sentence) -> None:
    with pytest.raises(OutsideValidityError, match=sentence):
        drive_from_catalogue(replace(NGUYEN, **change))


def test_a_drive_without_a_mode_that_could_be_watched_is_refused_in_a_sentence() -> None:
    short = drive_from_catalogue(replace(NGUYEN, screw_length=0.001))
    with pytest.raises(OutsideValidityError, match="a natural frequency below 2000 Hz; got one without"):
        expected_mode(short, MotorEnd.PRESCRIBED)


def test_a_screw_with_a_crowd_of_modes_is_refused_before_they_are_sought() -> None:
    soft = replace(drive_from_catalogue(NGUYEN).parameters, shear_modulus=1e-3)
    with pytest.raises(OutsideValidityError, match="at most 500 natural frequencies below 2000 Hz; got"):
        ExtendedModel.of(soft).natural_frequencies(DriveConditions(0.5, 300.0))
