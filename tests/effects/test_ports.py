"""What hangs on a port of the drive: absent without a size, passive, and written as the user's own."""

import pytest

from monitor_core.effects import DRIVE_EFFECTS, PORT_EFFECTS, Port, at_port, port_of, sized_for
from monitor_core.effects.sizes import drive_sizes
from monitor_core.models.extended import physics_of
from monitor_core.recordings.effect_file import effect_file_text, read_effect_file
from tests.models.extended_axes import bundled

AXIS = physics_of(bundled("receptance").parameters)
SIZES = drive_sizes(
    moving_mass=20.0, axial_stiffness=4e7, bearing_stiffness=1e8, nut_rigidity=2e8, turning_inertia=3e-4, length=1.0,
    preload=300.0, payload=5.0, excitation_force=50.0, bending_frequency=40.0,
)  # fmt: skip


@pytest.mark.parametrize("port", Port)
def test_a_port_has_an_effect_that_the_catalogue_has_not(port) -> None:
    effect = at_port(port)
    assert port_of(effect) is port
    assert effect.key not in {known.key for known in DRIVE_EFFECTS}
    without = {**effect.null_values(), "frequency_hz": 200.0}
    assert effect.added_to(AXIS, without) != AXIS
    assert not effect.applies(effect.added_to(AXIS, {**without, effect.parameters[0].name: 1e-9}))


def test_ranges_are_those_of_the_machine() -> None:
    inertia, frequency, _ = sized_for(PORT_EFFECTS, SIZES)[0].parameters
    assert inertia.upper == pytest.approx(3e-4)
    assert frequency.upper == pytest.approx(25.0 * (4e7 / 20.0) ** 0.5 / 6.283185307)
    bending = at_port("screw").sized(SIZES)
    assert bending.frequency is not None
    assert (bending.frequency.null, bending.frequency.upper) == pytest.approx((40.0, 96.0))


def test_a_port_is_written_into_an_effect_file_and_read_back(tmp_path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(effect_file_text(sized_for(PORT_EFFECTS, SIZES)), encoding="utf-8")
    assert read_effect_file(path) == PORT_EFFECTS


def test_no_other_effect_is_of_a_port() -> None:
    assert all(port_of(effect) is None for effect in DRIVE_EFFECTS)
