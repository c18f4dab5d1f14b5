"""How the rms motion follows the drive, to first order."""

import numpy as np
import pytest

from monitor_core.models.extended import physics_of, prepare_lines
from monitor_core.models.extended.conditions import axis_states
from monitor_core.models.extended.rms_motion import RmsSlopes, motion_at
from monitor_core.models.protocol import DriveConditions, ExcitationPoint
from tests.models.extended_axes import add, bundled, case_of

PARAMETERS = bundled("receptance").parameters
BAND = np.geomspace(60.0, 500.0, 30)
TORQUE, FORCE = ExcitationPoint.TORQUE_AT_MOTOR, ExcitationPoint.FORCE_AT_TABLE
CASES = [
    case_of(PARAMETERS, BAND, DriveConditions(0.52, excitation_level=1.0), TORQUE),
    case_of(PARAMETERS, BAND, DriveConditions(0.21, excitation_level=3.0), TORQUE),
    case_of(PARAMETERS, BAND[:12], DriveConditions(0.7, excitation_level=20.0), FORCE),
]
DAMPING, HARDENING = np.array([30.0, 200.0, 5.0]), np.array([0.3, 0.02, 0.1])


def motion(**added):
    lines = prepare_lines(CASES)
    axis = add(physics_of(PARAMETERS), guide_friction=5.0, cubic_nut_stiffness=1e9, **added)
    return motion_at(axis, lines, axis_states(axis, lines.conditions))


@pytest.mark.parametrize(("what", "size"), [("table_mass", 2.0), ("series_compliance", 2e-10), ("nut_mass", 0.3)])
def test_rms_motion_follows_the_drive_as_its_slopes_foretell(what, size) -> None:
    """As by central differences of the rms values themselves."""
    step = 1e-5
    ahead, here, behind = (motion(**{what: size * share}) for share in (1.0 + step, 1.0, 1.0 - step))
    change = ahead.at_knots(DAMPING, HARDENING) - behind.at_knots(DAMPING, HARDENING)
    foretold = RmsSlopes.at(here.excitations, here.at_knots(DAMPING, HARDENING)).along(change)
    found = np.log(ahead.rms(DAMPING, HARDENING) / behind.rms(DAMPING, HARDENING))
    assert foretold.shape == (2, 3)
    np.testing.assert_allclose(foretold, found, rtol=1e-4, atol=1e-3 * np.max(np.abs(found)))
