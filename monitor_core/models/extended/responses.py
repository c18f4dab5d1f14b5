"""Compute the responses of the extended drive on prepared lines."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from monitor_core.arrays import ComplexArray, NumberArray, acts
from monitor_core.models.extended.amplitude import linearise
from monitor_core.models.extended.closed_form import Path, entire_parts, path_of, receptances_of
from monitor_core.models.extended.conditions import axis_states
from monitor_core.models.extended.lines import PreparedLines
from monitor_core.models.extended.physics import AxisPhysics
from monitor_core.models.extended.settings import axes_by_setting


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
    values = np.empty(lines.omega.size, dtype=np.complex128)
    for seeing, motion in motions(path, on_drive, lines):
        values[seeing] = np.asarray(motion)[lines.drive_line[seeing]]
    return observed(values, physics, lines)


def _by_setting(physics: AxisPhysics, lines: PreparedLines) -> ComplexArray:
    """Return the responses of an axis that is another one at each setting."""
    values = np.empty(lines.omega.size, dtype=np.complex128)
    for here, part in axes_by_setting(physics, lines):
        values[part.place] = responses(here, part.under(lines.conditions))
    return values


def motions(
    path: Path, physics: AxisPhysics, lines: PreparedLines
) -> Iterator[tuple[npt.NDArray[np.intp], NumberArray]]:
    """Yield displacements or angles per unit excitation on the lines of the drive, and the lines that see each."""
    drive, seen = receptances_of(path), np.zeros(lines.omega.size, dtype=np.bool_)
    for seeing, receptance in (
        (np.setdiff1d(lines.table_per_force, lines.at_nut, assume_unique=True), drive.table_per_force),
        (lines.angle_per_torque, drive.angle_per_torque),
        *_at_nut(path, physics, lines),
    ):
        seen[seeing] = True
        if seeing.size:
            yield seeing, receptance
    if not np.all(seen):
        yield np.flatnonzero(~seen), drive.table_per_torque


def observed(values: ComplexArray, physics: AxisPhysics, lines: PreparedLines) -> ComplexArray:
    """Return what channels record of displacements and angles of the drive, shape (n_lines,)."""
    values = with_second_mode(values, physics, lines)
    values[lines.acceleration] *= -(lines.omega[lines.acceleration] ** 2)
    _through_the_channels(values, physics, lines)
    return values


def _at_nut(
    path: Path, physics: AxisPhysics, lines: PreparedLines
) -> Iterator[tuple[npt.NDArray[np.intp], NumberArray]]:
    """Yield the displacement of the nut where the accelerometer sits there, the nut's own mass before the bracket."""
    nut_lines = lines.at_nut
    if nut_lines.size:
        more = np.maximum(physics.bodies.nut_mass - physics.added.nut_mass, 0.0)  # what is not there already
        carried = path.carried.with_nut_of(more, lines.drive.omega)
        reached = carried.reached_through(1.0 / path.nut + path.before_bracket)
        yield nut_lines[lines.by_torque[nut_lines]], path.unloaded_travel * reached.nut_per_travel
        yield nut_lines[~lines.by_torque[nut_lines]], reached.nut_per_force


def with_second_mode(values: ComplexArray, physics: AxisPhysics, lines: PreparedLines) -> ComplexArray:
    """Return displacements and angles with a modal term at table and nut; a torque drives it as the force torque/i."""
    values, beyond = values.copy(), lines.beyond_screw
    physics = physics.at(lines.case[beyond])
    added = physics.added
    if acts(added.second_mode_residue):
        omega, natural = lines.omega[beyond], 2.0 * np.pi * added.second_mode_frequency
        term = added.second_mode_residue / (
            natural**2 - omega**2 + 2j * added.second_mode_damping_ratio * natural * omega
        )
        values[beyond] += np.where(lines.by_torque[beyond], 1.0 / physics.screw.transmission_ratio, 1.0) * term
    return values


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
