"""Forces on the lines of an axis that are not linear in its motion: friction of the guides, a nut with a bent spring.

They act upon the lines, and follow from the motion that they and the torque make of the lines.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import scipy.fft

from tests.hidden_effects.truth.axis import Axis, Setting
from tests.hidden_effects.truth.volterra import Laws, solve_volterra
from tests.hidden_effects.truth.wave_network import (
    ComplexArray,
    FloatArray,
    Network,
    Spectrum,
    lines_of,
    network_of,
    nut_stiffness,
)

STEP_RATE = 16384.0  # of the forces, at least [Hz]
LEAD_IN = 2.0  # of the record that is run before its beginning, so that the forces have settled where it begins [s]
MEMORY = 4.0  # over which the lines forget a force; a free drive does so by its motor's damping [s]
MASS_DECAY = 600.0  # of a mass by itself in some viscous medium: what is put in exactly and may be anything [1/s]


@dataclass(frozen=True, slots=True)
class Record:
    """How a record is sampled, and how finely the nonlinear forces are."""

    n_samples: int
    sample_rate: float  # [Hz]

    @property
    def finer(self) -> int:
        """Steps of the nonlinear forces per sample."""
        return math.ceil(STEP_RATE / self.sample_rate)

    @property
    def step_rate(self) -> float:
        """Of the nonlinear forces. [Hz]."""
        return self.finer * self.sample_rate

    @property
    def inside(self) -> slice:
        """Which lines of a transform lie between zero and half the sampling rate."""
        return slice(1, (self.n_samples + 1) // 2)

    @property
    def frequency(self) -> FloatArray:
        """Of these lines, shape (n_lines,). [Hz]."""
        return scipy.fft.rfftfreq(self.n_samples, 1.0 / self.sample_rate)[self.inside]


class Port(StrEnum):
    """Where a force acts that is not linear."""

    TABLE = "table"  # a force on the table; its velocity at the end of a step
    NUT = "nut"  # a force beside that of the nut's spring; the nut's deflection, mean over a step

    def motion(self, network: Network, torque: Spectrum, on_table: float = 0.0, in_nut: float = 0.0) -> ComplexArray:
        """Return the motion that the force depends on."""
        if self is Port.TABLE:
            return network.s * network.table_travel(torque, on_table, in_nut)
        return network.deflection(torque, on_table, in_nut)

    def motion_per_force(self, network: Network, other: "Port") -> ComplexArray:
        """Return the motion here per force at a port."""
        return self.motion(network, 0.0, float(other is Port.TABLE), float(other is Port.NUT))

    def of_step(self, phase: ComplexArray) -> ComplexArray:
        """Return what a step takes from a line of motion that turns by a phase meanwhile."""
        return np.exp(phase) if self is Port.TABLE else np.asarray(np.expm1(phase) / phase)


def ports_of(axis: Axis) -> tuple[Port, ...]:
    """Return where the axis is not linear."""
    h = axis.hidden
    acting = {Port.TABLE: h.guide_friction, Port.NUT: h.cubic_nut_stiffness or h.nut_softening}
    return tuple(port for port, present in acting.items() if present)


def laws_of(axis: Axis, settings: Sequence[Setting], ports: Sequence[Port]) -> Laws:
    """Return how force and motion go together at each port."""
    h = axis.hidden
    at_table = np.array([[float(port is Port.TABLE)] for port in ports]) * np.ones(len(settings))
    stiffness = np.array([nut_stiffness(axis, setting) for setting in settings])
    shape = np.ones_like(at_table)
    return Laws(
        friction=h.guide_friction * at_table,
        stiffness=stiffness * shape,
        cubic=h.cubic_nut_stiffness * shape,
        softening=h.nut_softening * shape,
        scale=h.nut_softening_deflection * shape,
    )


def nonlinear_forces(axis: Axis, settings: Sequence[Setting], spectra: ComplexArray, record: Record) -> ComplexArray:
    """Return the spectra of the forces on table and in nut beside the linear ones, shape (2, n_settings, n_lines).

    Parameters
    ----------
    axis : Axis
    settings : sequence of Setting
    spectra : ndarray, shape (n_settings, n_lines)
        Of the torque, as ``rfft`` gives it on the lines of the record.
    record : Record
    """
    forces = np.zeros((2, *spectra.shape), dtype=np.complex128)
    ports = ports_of(axis)
    if not ports:
        return forces
    free = free_motion(axis, settings, spectra, record)
    lead_in = round(LEAD_IN * record.step_rate)
    steps = solve_volterra(
        laws_of(axis, settings, ports),
        np.take(free, np.arange(-lead_in, free.shape[-1]), axis=-1, mode="wrap"),
        step_responses(axis, settings, record.step_rate),
    )
    phase = 2j * math.pi * record.frequency / record.step_rate
    held = -np.expm1(-phase) / phase / record.finer  # each force is held over its step
    for port, force in zip(ports, steps, strict=True):
        forces[list(Port).index(port)] = held * scipy.fft.rfft(force[:, lead_in:])[:, record.inside]
    return forces


def free_motion(axis: Axis, settings: Sequence[Setting], spectra: ComplexArray, record: Record) -> FloatArray:
    """Return the motion of each step at the ports without their forces, shape (n_ports, n_settings, n_steps)."""
    ports, n_steps = ports_of(axis), record.n_samples * record.finer
    phase = 2j * math.pi * record.frequency / record.step_rate
    lines = lines_of(axis, record.frequency)
    motion = np.empty((len(ports), len(settings), n_steps))
    whole = np.zeros(n_steps // 2 + 1, dtype=np.complex128)
    for k, setting in enumerate(settings):
        network = network_of(axis, setting, lines)
        for a, port in enumerate(ports):
            line = port.motion(network, network.late * spectra[k]) * port.of_step(phase)
            whole[record.inside] = record.finer * line
            motion[a, k] = scipy.fft.irfft(whole, n_steps)
    return motion


def step_responses(axis: Axis, settings: Sequence[Setting], step_rate: float) -> FloatArray:
    """Return the motion of each step after a force of 1 held over the first.

    Shape (n_ports, n_ports, n_settings, n_steps), the port that moves first. Lines beyond the step rate no longer
    count, but for those of the table's mass under friction: what that does alone is put in as it is in time.
    """
    ports = ports_of(axis)
    n_steps = 2 ** round(math.log2(MEMORY * step_rate))
    frequency = np.arange(n_steps + 1) * (step_rate / n_steps)
    frequency[0] = frequency[1]  # not zero, where nothing holds a free drive; what it does there is found below
    lines = lines_of(axis, frequency)
    phase = lines.s / step_rate
    held = -np.expm1(-phase) / phase
    in_time = np.exp(-np.arange(n_steps) * MASS_DECAY / step_rate) * -math.expm1(-MASS_DECAY / step_rate) / MASS_DECAY
    responses = np.empty((len(ports), len(ports), len(settings), n_steps))
    for k, setting in enumerate(settings):
        network = network_of(axis, setting, lines)
        mass = float((network.table[-1] / lines.s[-1] ** 2).real)
        for a, port in enumerate(ports):
            for b, other in enumerate(ports):
                alone = 1.0 / mass if port is other is Port.TABLE else 0.0
                line = port.motion_per_force(network, other) - alone / (lines.s + MASS_DECAY)
                twice_a_step = scipy.fft.irfft(2.0 * line * held * port.of_step(phase), 2 * n_steps)
                responses[a, b, k] = twice_a_step[::2] + alone * in_time
                responses[a, b, k] -= np.mean(responses[a, b, k, -n_steps // 8 :])  # at the end all is forgotten
    return responses
