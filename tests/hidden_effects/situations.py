"""Under what a case is measured: machine, design, errors of settings, disturbed channels, a record that is wrong."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tests.hidden_effects import designs
from tests.hidden_effects.machines import BENCH, Machine, scaled
from tests.hidden_effects.truth.axis import Setting
from tests.hidden_effects.truth.measurement import MeasuredFrf, Scatter

#: Errors of settings as they are assumed (0.3 mm, 3 %, gain 0.5 %), and unlike that.
SCATTERS = {
    "assumed": Scatter(),
    "smaller": Scatter(position=0.09e-3, preload=0.009, gain=0.0015),
    "larger": Scatter(position=0.6e-3, preload=0.06, gain=0.01),
    "uniform": Scatter(law="uniform"),
    "heavy": Scatter(law="heavy"),
}
#: What may disturb the channels; changes of the recorder.
DISTURBANCES: dict[str, dict[str, float | bool]] = {
    "clean": {},
    "pink": {"pink": True},
    "hum": {"hum": 0.02},
    "clipped": {"clipped_at": 2.5},
    "loop": {"loop": 50.0},
}
FAULTS = ("position-tag", "preload-tag", "payload-tag", "temperature-tag", "gain", "outlier")
#: How far off, in three sizes: of the length of the screw [-], ln of a preload, ln of a gain, ln of a line [rms].
_OFF = {"position-tag": (0.01, 0.03, 0.08), "preload-tag": (0.2, 0.4, 0.7), "gain": (0.04, 0.1, 0.3),
        "outlier": (0.03, 0.1, 0.3)}  # fmt: skip
#: Fields of what is hidden, and names in a model file, by the unit that they scale with; all others are ratios.
_UNITS = {
    "kg": ("added_mass", "payload_error", "absorber_mass", "nut_absorber_mass", "nut_mass_before_bracket", "mass_kg",
           "screw_end_absorber_mass", "lost_mass"),
    "kg·m²": ("rotor_absorber_inertia", "inertia_kg_m2"),
    "1/kg": ("structure_residue", "residue_per_kg"),
    "m/N": ("series_compliance", "base_compliance", "compliance_m_per_n"),
    "N/m": ("far_bearing_stiffness", "guide_stiffness", "stiffness_n_per_m"),
    "N": ("guide_friction", "friction_n"),
    "m": ("position_offset", "offset_m", "nut_softening_deflection", "nut_backlash", "nut_contact_deflection",
          "bend_eccentricity", "eccentricity_m", "half_width_m"),
    "s": ("torque_delay", "response_delay", "angle_delay", "delay_s"),
    "s²": ("inverse_square_s2",),
    "Hz": ("mounting_frequency", "bandwidth_hz", "base_frequency", "structure_frequency", "absorber_frequency",
           "nut_absorber_frequency", "rotor_absorber_frequency", "screw_end_absorber_frequency", "frequency_hz"),
    "N·m": ("torque_limit", "torque_nm"),
    "N·m/rad": ("servo_stiffness", "stiffness_nm_per_rad"),
    "N·m·s/rad": ("motor_damping", "damping_nms_per_rad"),
    "1/m²": ("cubic_nut_stiffness", "relative_stiffness_per_m2"),
    "1/m": ("absorber_frequency_slope", "inverse_deflection_per_m"),
}  # fmt: skip
_UNIT_OF = {name: unit for unit, names in _UNITS.items() for name in names}
_OF_PRELOAD = ("thermal_preload", "preload_n_per_k")


@dataclass(frozen=True, slots=True)
class WrongRecord:
    """What is wrong with one record, by how much."""

    fault: str  # of FAULTS
    size: int  # 0, 1, 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """Under what a case is measured."""

    machine: Machine = BENCH
    design: str = "rich"
    scatter: Scatter = field(default_factory=Scatter)
    disturbance: str = "clean"
    wrong: WrongRecord | None = None

    def settings(self, rng: np.random.Generator) -> tuple[Setting, ...]:
        """Return the settings as stated."""
        return designs.DESIGNS[self.design](self.machine, rng)

    def sized(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return values of the benchtop axis as they are on the machine, by fields or by names in a model file."""
        found = {name: value * self._factor(name) for name, value in values.items()}
        hardening = {name: min(found[name], self.machine.largest_hardening) for name in _UNITS["1/m²"] if name in found}
        return found | hardening

    def _factor(self, name: str) -> float:
        if name in _OF_PRELOAD:
            return self.machine.preload / BENCH.preload
        return scaled(_UNIT_OF[name], self.machine) if name in _UNIT_OF else 1.0


def wrongly_set(
    wrong: WrongRecord, stated: Sequence[Setting], true: Sequence[Setting], length: float, rng: np.random.Generator
) -> tuple[tuple[Setting, ...], int]:
    """Return the true settings with one that is not as its tag says, and which; of a gain or outlier only which.

    Parameters
    ----------
    wrong : WrongRecord
    stated, true : sequence of Setting
        In the order of the measurement.
    length : float
        Of the screw. [m]
    rng : Generator
    """
    tagged = {
        "payload-tag": [k for k, setting in enumerate(stated) if setting.payload],
        "temperature-tag": [k for k, setting in enumerate(stated) if setting.temperature_deviation],
    }.get(wrong.fault, list(range(len(stated))))
    which = int(rng.choice(tagged))
    was, sign = true[which], float(rng.choice((-1.0, 1.0)))
    if wrong.fault == "position-tag":
        by = _OFF[wrong.fault][wrong.size] * length
        inside = 0.04 * length < was.position + sign * by < 0.96 * length
        was = replace(was, position=was.position + (sign if inside else -sign) * by)
    elif wrong.fault == "preload-tag":
        was = replace(was, preload=was.preload * math.exp(sign * _OFF[wrong.fault][wrong.size]))
    elif wrong.fault == "payload-tag":
        was = replace(was, payload=0.0)
    elif wrong.fault == "temperature-tag":
        was = replace(was, temperature_deviation=0.0)
    return (*true[:which], was, *true[which + 1 :]), which


def wrongly_recorded(
    wrong: WrongRecord, which: int, measured: Sequence[MeasuredFrf], rng: np.random.Generator
) -> tuple[MeasuredFrf, ...]:
    """Return the responses, both of one setting with a wrong gain or lines that are wrong, smoothly over frequency."""
    if wrong.fault not in {"gain", "outlier"}:
        return tuple(measured)
    off = _OFF[wrong.fault][wrong.size]
    channel = int(rng.integers(2))
    at = 2 * which + channel
    frequency = measured[at].frequency
    if wrong.fault == "gain":
        factor = np.full(frequency.size, math.exp(off * float(rng.choice((-1.0, 1.0)))), dtype=complex)
    else:
        turns = np.log(frequency / frequency[0]) * np.array([[3.0], [5.0], [8.0]])
        waves = np.cos(turns + rng.uniform(0.0, 2.0 * math.pi, (2, 3, 1))).sum(axis=1) * math.sqrt(2.0 / 3.0)
        factor = np.exp(off * (waves[0] + 1j * waves[1]))
    response, deviation = measured[at].response * factor, measured[at].standard_deviation * np.abs(factor)
    changed = replace(measured[at], response=response, standard_deviation=deviation)
    return (*measured[:at], changed, *measured[at + 1 :])


def disturbed(situation: Situation) -> Machine:
    """Return the machine with the recorder as it is disturbed."""
    recorder = replace(situation.machine.recorder, **DISTURBANCES[situation.disturbance])
    return replace(situation.machine, recorder=recorder)
