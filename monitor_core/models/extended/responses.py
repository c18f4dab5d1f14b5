"""Compute the responses of the extended drive on prepared lines."""

import numpy as np

from monitor_core.arrays import ComplexArray, acts
from monitor_core.models.extended.amplitude import linearise
from monitor_core.models.extended.by_setting import axes_by_setting
from monitor_core.models.extended.closed_form import Path, entire_parts, path_of, receptances_of
from monitor_core.models.extended.conditions import axis_states
from monitor_core.models.extended.lines import PreparedLines
from monitor_core.models.extended.physics import AxisPhysics


def responses(physics: AxisPhysics, lines: PreparedLines) -> ComplexArray:
    """Return the response per unit excitation of every line, shape (n_lines,), in the unit of its case, as m/(N·m·s²).

    ``OutsideValidityError`` if the physics does not go with a condition (position off the screw, preload and load
    rating, no mass left), or friction holds the table.
    """
    if physics.by_setting:
        return _by_setting(physics, lines)
    states = axis_states(physics, lines.conditions)
    drive = lines.drive
    on_drive = physics.at(drive.case)
    path = path_of(entire_parts(on_drive, drive.omega, states.at(drive.case), drive.ends, drive.memory))
    path = linearise(path, physics, lines, states)
    values = _displacements(path, lines)
    _at_nut(values, path, on_drive, lines)
    _add_second_mode(values, physics, lines)
    values[lines.acceleration] *= -(lines.omega[lines.acceleration] ** 2)
    _through_the_channels(values, physics, lines)
    return values


def _by_setting(physics: AxisPhysics, lines: PreparedLines) -> ComplexArray:
    """Return the responses of an axis that is another one at each setting."""
    values = np.empty(lines.omega.size, dtype=np.complex128)
    for here, part in axes_by_setting(physics, lines):
        values[part.place] = responses(here, part.under(lines.conditions))
    return values


def _displacements(path: Path, lines: PreparedLines) -> ComplexArray:
    """Return displacement or angle per unit excitation."""
    drive, at = receptances_of(path), lines.drive_line
    values = np.asarray(drive.table_per_torque, dtype=np.complex128)[at]
    for lines_of, receptance in (
        (lines.table_per_force, drive.table_per_force),
        (lines.angle_per_torque, drive.angle_per_torque),
    ):
        if lines_of.size:
            values[lines_of] = receptance[at[lines_of]]
    return values


def _at_nut(values: ComplexArray, path: Path, physics: AxisPhysics, lines: PreparedLines) -> None:
    """Put the displacement of the nut where the accelerometer sits there, the nut's own mass before the bracket."""
    at = lines.at_nut
    if at.size:
        more = np.maximum(physics.bodies.nut_mass - physics.added.nut_mass, 0.0)  # what is not there already
        carried = path.carried.with_nut_of(more, lines.drive.omega)
        reached = carried.reached_through(1.0 / path.nut + path.before_bracket)
        per_torque = path.unloaded_travel * reached.nut_per_travel
        drive_line = lines.drive_line[at]
        values[at] = np.where(lines.by_torque[at], per_torque[drive_line], reached.nut_per_force[drive_line])


def _add_second_mode(values: ComplexArray, physics: AxisPhysics, lines: PreparedLines) -> None:
    """Add one modal term to the displacement of table and nut; a torque drives it as the force torque/i."""
    at = lines.beyond_screw
    physics = physics.at(lines.case[at])
    added = physics.added
    if acts(added.second_mode_residue):
        omega, natural = lines.omega[at], 2.0 * np.pi * added.second_mode_frequency
        term = added.second_mode_residue / (
            natural**2 - omega**2 + 2j * added.second_mode_damping_ratio * natural * omega
        )
        values[at] += np.where(lines.by_torque[at], 1.0 / physics.screw.transmission_ratio, 1.0) * term


def _through_the_channels(values: ComplexArray, physics: AxisPhysics, lines: PreparedLines) -> None:
    """Let a torque act late, channels be recorded late and an accelerometer resonate on its mounting."""
    everywhere = physics.at(lines.case).added
    beyond = physics.at(lines.case[lines.beyond_screw]).added
    if acts(beyond.response_delay):
        at = lines.beyond_screw
        values[at] *= np.exp(-1j * beyond.response_delay * lines.omega[at])
    if acts(everywhere.angle_delay):
        late = np.exp(-1j * everywhere.angle_delay * lines.omega)
        late[lines.beyond_screw] = 1.0
        values *= late
    if acts(everywhere.torque_delay):
        values *= np.where(lines.by_torque, np.exp(-1j * everywhere.torque_delay * lines.omega), 1.0)
    if acts(beyond.response_ln_factor):
        values[lines.beyond_screw] *= np.exp(beyond.response_ln_factor)
    if acts(everywhere.torque_ln_factor):
        values *= np.where(lines.by_torque, np.exp(-everywhere.torque_ln_factor), 1.0)
    added = physics.at(lines.case[lines.acceleration]).added
    if acts(added.mounting_inverse_square):
        at = lines.acceleration
        ratio = lines.omega[at] * np.sqrt(added.mounting_inverse_square)
        damper = 2j * added.mounting_damping_ratio * ratio
        values[at] *= (1.0 + damper) / (1.0 - ratio**2 + damper)  # transmissibility of a mass on spring and damper
