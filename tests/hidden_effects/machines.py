"""Machines of five sizes: what their makers would say of them, how they are driven, and over which band they are seen.

Screws, bearings, nuts and couplings are of catalogue size for each; none is another one scaled. Sizes of hidden effects
go with mass, first frequency and length (``scaled``), so that they mean the same on each.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from tests.hidden_effects.truth.axis import Parts
from tests.hidden_effects.truth.measurement import Recorder

#: Relative standard deviation by which the description of a machine differs from the one listed here. [-]
_JITTER = 0.1
_JITTERED = (
    "table_mass", "motor_inertia", "bearing_stiffness", "bracket_stiffness", "nut_rigidity", "coupling_stiffness",
    "bearing_damping", "nut_damping", "coupling_damping", "table_damping", "motor_damping",
)  # fmt: skip
_LENGTH_JITTER = 0.03
#: Of the usual preload, the largest multiple that a design sets: no maker rates a nut below what it is set to.
_LARGEST_MULTIPLE = 1.64
#: Of a nut with a force k (1 + β δ²) δ, β P²/k²: a preload once more finds it five times as stiff.
_LARGEST_HARDENING = 4.0
#: How mass, frequency and length make a unit: exponents of their ratios.
_EXPONENTS = {
    "-": (0, 0, 0), "kg": (1, 0, 0), "1/kg": (-1, 0, 0), "m": (0, 0, 1), "1/m": (0, 0, -1), "s": (0, -1, 0),
    "s²": (0, -2, 0), "Hz": (0, 1, 0), "N": (1, 2, 1), "N/m": (1, 2, 0), "m/N": (-1, -2, 0), "N·m": (1, 2, 2),
    "N·m/rad": (1, 2, 2), "N·m·s/rad": (1, 1, 2), "1/m²": (0, 0, -2), "kg·m²": (1, 0, 2),
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """One size of axis as described, and the test bench that fits it."""

    name: str
    parts: Parts
    preload: float  # as it usually is [N]
    recorder: Recorder

    @property
    def moving_mass(self) -> float:
        """Table and nut. [kg]."""
        return self.parts.table_mass + self.parts.nut_mass

    @property
    def nut_rigidity(self) -> float:
        """At the usual preload. [N/m]."""
        return 0.8 * self.parts.nut_rigidity * (self.preload / self.parts.rated_preload) ** (1.0 / 3.0)

    @property
    def largest_hardening(self) -> float:
        """Of a nut, as the effect's own range has it: by what its preload deflects it. [1/m²]."""
        return _LARGEST_HARDENING * (self.nut_rigidity / self.preload) ** 2

    @property
    def first_frequency(self) -> float:
        """Of the moving mass on bearing, half the screw, nut and bracket in series. [Hz]."""
        parts = self.parts
        area = math.pi / 4.0 * parts.screw_diameter**2
        half = 0.5 * parts.screw_length / (parts.youngs_modulus * area)
        compliance = 1.0 / parts.bearing_stiffness + half + 1.0 / self.nut_rigidity + 1.0 / parts.bracket_stiffness
        return math.sqrt(1.0 / (compliance * self.moving_mass)) / (2.0 * math.pi)

    @property
    def payload(self) -> float:
        """What is easily put on the table: about a quarter of what moves, to two digits. [kg]."""
        return float(f"{0.27 * self.moving_mass:.2g}")

    @property
    def torque(self) -> float:
        """Of a usual excitation, rms. [N·m]."""
        return float(f"{0.15 * scaled('N·m', self):.2g}")


def scaled(unit: str, machine: Machine) -> float:
    """Return how much of a unit is on a machine what 1 is on the benchtop axis (:data:`BENCH`)."""
    ratios = (
        machine.moving_mass / BENCH.moving_mass,
        machine.first_frequency / BENCH.first_frequency,
        machine.parts.screw_length / BENCH.parts.screw_length,
    )
    return math.prod(ratio**power for ratio, power in zip(ratios, _EXPONENTS[unit], strict=True))


#: 0.3 m × 15.5 mm, 4 kg: an axis for wafers or lenses.
MINI = Machine(
    name="mini",
    parts=Parts(
        screw_length=0.3, screw_diameter=0.0155, screw_lead=0.005, table_mass=3.7, nut_mass=0.3, motor_inertia=2.2e-5,
        coupling_inertia=4e-6, bearing_stiffness=60e6, bracket_stiffness=1.2e8, nut_rigidity=2.2e8, rated_preload=250.0,
        coupling_stiffness=500.0, bearing_damping=1.2e3, nut_damping=1.6e3, coupling_damping=8e-3, table_damping=60.0,
        motor_damping=5e-4,
    ),
    preload=130.0,
    recorder=Recorder(sample_rate=8192.0),
)  # fmt: skip
#: 0.97 m × 18.6 mm, 22 kg: the axis on which this benchmark began.
BENCH = Machine(name="bench", parts=Parts(), preload=220.0, recorder=Recorder(sample_rate=4096.0))
#: 1.3 m × 28 mm, 130 kg: a machining centre.
CENTRE = Machine(
    name="centre",
    parts=Parts(
        screw_length=1.3, screw_diameter=0.028, screw_lead=0.010, table_mass=126.0, nut_mass=4.0, motor_inertia=1.1e-3,
        coupling_inertia=2e-4, bearing_stiffness=3.2e8, bracket_stiffness=7e8, nut_rigidity=9e8, rated_preload=2200.0,
        coupling_stiffness=5500.0, bearing_damping=2e4, nut_damping=3e4, coupling_damping=0.5, table_damping=700.0,
        motor_damping=1.5e-2,
    ),
    preload=1000.0,
    recorder=Recorder(sample_rate=3072.0),
)  # fmt: skip
#: 2 m × 42 mm, 480 kg: a lathe or a mill.
MILL = Machine(
    name="mill",
    parts=Parts(
        screw_length=2.0, screw_diameter=0.042, screw_lead=0.012, table_mass=468.0, nut_mass=12.0, motor_inertia=5e-3,
        coupling_inertia=1.5e-3, bearing_stiffness=7e8, bracket_stiffness=1.2e9, nut_rigidity=1.5e9,
        rated_preload=5500.0, coupling_stiffness=21e3, bearing_damping=5e4, nut_damping=8e4, coupling_damping=2.5,
        table_damping=2000.0, motor_damping=5e-2,
    ),
    preload=2400.0,
    recorder=Recorder(sample_rate=2048.0),
)  # fmt: skip
#: 3 m × 60 mm, 1450 kg: a gantry.
GANTRY = Machine(
    name="gantry",
    parts=Parts(
        screw_length=3.0, screw_diameter=0.060, screw_lead=0.020, table_mass=1415.0, nut_mass=35.0, motor_inertia=2e-2,
        coupling_inertia=8e-3, bearing_stiffness=1.2e9, bracket_stiffness=2e9, nut_rigidity=2.4e9, rated_preload=11e3,
        coupling_stiffness=80e3, bearing_damping=1.2e5, nut_damping=2e5, coupling_damping=15.0, table_damping=5000.0,
        motor_damping=0.3,
    ),
    preload=5000.0,
    recorder=Recorder(sample_rate=1280.0),
)  # fmt: skip
MACHINES = (MINI, BENCH, CENTRE, MILL, GANTRY)


def machine_named(name: str) -> Machine:
    """Return the machine of a name."""
    (found,) = (machine for machine in MACHINES if machine.name == name)
    return found


def jittered(machine: Machine, rng: np.random.Generator) -> Machine:
    """Return another machine of that size: no two makers build the same one, nor describe it."""
    parts = {name: _about(getattr(machine.parts, name), _JITTER, rng) for name in _JITTERED}
    parts["screw_length"] = _about(machine.parts.screw_length, _LENGTH_JITTER, rng)
    preload = min(_about(machine.preload, _JITTER, rng), machine.parts.rated_preload / _LARGEST_MULTIPLE)
    return replace(machine, parts=replace(machine.parts, **parts), preload=preload)


def _about(value: float, share: float, rng: np.random.Generator) -> float:
    return float(f"{value * math.exp(share * rng.standard_normal()):.4g}")
