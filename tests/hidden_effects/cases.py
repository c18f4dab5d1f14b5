"""Blind cases: an axis that is not quite as its maker says, with something hidden in it, measured at many settings.

A case knows the truth; what the workflow is given of it is ``measured`` and ``baseline`` alone. Names of effects and of
their parameters are those of model files.
"""

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tests.hidden_effects.kinds import KINDS, LOCAL_KINDS, PAIRS, SIZES, WRONG_PARTS, Kind, Mechanism
from tests.hidden_effects.situations import Situation, disturbed, wrongly_recorded, wrongly_set
from tests.hidden_effects.truth import finite_elements
from tests.hidden_effects.truth.axis import Axis, Hidden, Parts, Setting
from tests.hidden_effects.truth.measurement import MeasuredFrf, Respond, measure, set_truly

FAMILIES = ("receptance", "lumped")

#: Relative standard deviations that the baseline declares and true parts are drawn with. [-]
TOLERANCES = {
    "bearing_stiffness": 0.2,
    "bracket_stiffness": 0.2,
    "nut_rigidity": 0.1,
    "coupling_stiffness": 0.2,
    "bearing_damping": 0.5,
    "nut_damping": 0.5,
    "coupling_damping": 0.5,
    "table_damping": 0.5,
    "motor_damping": 0.5,
    "youngs_modulus": 0.01,
    "shear_modulus": 0.01,
    "table_mass": 0.005,
    "motor_inertia": 0.02,
}
#: What a model file calls the parts of a receptance baseline.
_NAMES = {
    "table_mass": "table_mass_kg",
    "nut_mass": "nut_mass_kg",
    "screw_length": "screw_length_m",
    "screw_diameter": "screw_diameter_m",
    "screw_lead": "screw_lead_m",
    "youngs_modulus": "youngs_modulus_pa",
    "shear_modulus": "shear_modulus_pa",
    "density": "density_kg_per_m3",
    "motor_inertia": "motor_inertia_kg_m2",
    "coupling_inertia": "coupling_inertia_kg_m2",
    "bearing_stiffness": "bearing_stiffness_n_per_m",
    "bracket_stiffness": "bracket_stiffness_n_per_m",
    "nut_rigidity": "nut_stiffness_n_per_m",
    "coupling_stiffness": "coupling_stiffness_nm_per_rad",
    "bearing_damping": "bearing_damping_ns_per_m",
    "nut_damping": "nut_damping_ns_per_m",
    "coupling_damping": "coupling_damping_nms_per_rad",
    "table_damping": "table_damping_ns_per_m",
    "motor_damping": "motor_damping_nms_per_rad",
}
_NOT_LUMPED = frozenset({"screw_diameter", "density", "bearing_damping", "nut_damping", "coupling_damping",
                         "motor_damping"})  # fmt: skip
#: A lumped axis loses by a factor alone. Its truth has hardly a damper in its joints, but this in its springs. [-]
_LUMPED_LOSS = 0.03
_LUMPED_PARTS = Parts(bearing_damping=30.0, nut_damping=60.0, coupling_damping=5e-4, motor_damping=2e-5)

NONE = "none"


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """One blind case."""

    kind: str
    size: str
    noise: float
    seed: int
    family: str
    measured: tuple[MeasuredFrf, ...]  # in the order in which they were taken, acceleration before angle
    baseline: str  # a model file
    truth: Mapping[str, Mapping[str, float]]  # by key of the effect, values as a model file has them; outside:… too
    axis: Axis
    settings: tuple[Setting, ...]  # how the axis really was set
    wrong_setting: int | None = None  # of which a record is wrong
    wrong_ln_factor: np.ndarray | None = None  # ln of recorded over measured there, shape (2, n_lines); 0 for a tag


def all_kinds() -> tuple[str, ...]:
    """Return every kind that can be drawn."""
    return (NONE, *KINDS, *map(_wrong, WRONG_PARTS), *PAIRS)


def draw_case(
    kind: str,
    size: str = "medium",
    noise: float = 0.003,
    seed: int = 0,
    family: str = "receptance",
    *,
    respond: Respond = finite_elements.respond,
    situation: Situation | None = None,
) -> Case:
    """Draw a machine about its description, hide something in it and measure it.

    Parameters
    ----------
    kind : str
        One of :func:`all_kinds`; several, joined by "+", are hidden together.
    size : str
        "small", "medium" or "large"; each value is drawn within 15 % of that of its kind, with either sign where the
        kind has one.
    noise : float
        Of every sensor over the rms of its channel. [-]
    situation : Situation, optional
        Machine, design and whatever else a case is measured under; the benchtop axis at 31 fixed settings otherwise.
    seed : int
        Cases of different seeds, kinds, sizes and noise are different machines.
    family : str
        Of the baseline: "receptance" has all but what is hidden, "lumped" lacks the distributed mass and inertia of the
        screw besides.
    respond : callable
        The plant.
    """
    rng = np.random.default_rng([seed, zlib.crc32(f"{kind}/{size}/{noise}/{family}".encode())])
    under = situation or Situation()
    declared = under.machine.parts if family == "receptance" else _LUMPED_PARTS
    drawn = _drawn_parts(declared, rng)
    hidden: dict[str, float] = {}
    unstated: tuple[str, ...] = ()
    truth: dict[str, dict[str, float]] = {}
    if family == "lumped":
        hidden["loss_factor"] = _LUMPED_LOSS * math.exp(0.2 * rng.standard_normal())
        truth = {"screw-distributed-mass": {"share": 1.0}, "torsional-flexibility": {"inertia_share": 1.0}}
    for key in kind.split("+") if kind != NONE else ():
        if key.startswith("wrong-parameter:"):
            drawn = _with_wrong_part(drawn, key, SIZES.index(size), rng)
            truth[key] = {"ln_ratio": _ln_ratio(drawn, declared, key)}
        else:
            kind_ = (KINDS | LOCAL_KINDS)[key]
            mechanism, stated = map(under.sized, _drawn_mechanism(kind_, size, rng))
            if "loss_factor" in hidden and "loss_factor" in mechanism:  # beside the one that is declared
                mechanism["loss_factor"] += hidden["loss_factor"]
            hidden |= mechanism
            unstated += kind_.unstated
            truth[key] = truth.get(key, {}) | stated
    drawn, declared = (replace(parts, **dict.fromkeys(unstated, 0.0)) for parts in (drawn, declared))
    axis = Axis(parts=drawn, hidden=Hidden(**hidden))
    if bending := axis.bending(0.5 * drawn.screw_length):
        truth["outside:screw-bending"]["frequency_hz"] = bending[0].omega / (2.0 * math.pi)
    stated_settings = under.settings(rng) if situation else design(rng)
    scatter, which = replace(under.scatter, sensor_noise=noise), None
    true_settings = set_truly(stated_settings, scatter, rng)
    if under.wrong:
        true_settings, which = wrongly_set(under.wrong, stated_settings, true_settings, drawn.screw_length, rng)
    measured = measure(
        axis, stated_settings, true_settings, scatter, rng, respond=respond, recorder=disturbed(under).recorder
    )
    ln_factor = None
    if under.wrong and which is not None:
        right, measured = measured, wrongly_recorded(under.wrong, which, measured, rng)
        both = slice(2 * which, 2 * which + 2)
        pairs = zip(measured[both], right[both], strict=True)
        ln_factor = np.array(
            [
                np.zeros(was.frequency.size) if wrong is was else np.log(wrong.response / was.response)
                for wrong, was in pairs
            ]
        )
    baseline = baseline_text(declared, family)
    return Case(kind, size, noise, seed, family, measured, baseline, truth, axis, true_settings, which, ln_factor)


def design(rng: np.random.Generator) -> tuple[Setting, ...]:
    """Return 31 settings in random order: positions × preloads, and what else has to vary at two middle positions.

    No position is a multiple of the lead of 6 mm, and their places within the lead differ.
    """
    positions = (0.083, 0.211, 0.3455, 0.476, 0.6045, 0.739, 0.868)
    level = 0.15
    settings = [
        Setting(position=x, preload=preload, excitation_rms=level)
        for x in positions
        for preload in (120.0, 220.0, 360.0)
    ]
    for x in (0.3455, 0.6045):
        usual = Setting(position=x, preload=220.0, excitation_rms=level)
        settings += [
            replace(usual, excitation_rms=0.3 * level),
            replace(usual, excitation_rms=3.0 * level),
            replace(usual, payload=6.0),
            replace(usual, temperature_deviation=15.0),
        ]
    settings += [Setting(position=x, preload=220.0, excitation_rms=level) for x in (0.4775, 0.479)]
    order = rng.permutation(len(settings))
    last = len(settings) - 1
    return tuple(replace(settings[which], order=time / last) for time, which in enumerate(order))


def baseline_text(declared: Parts, family: str) -> str:
    """Return the description of the parts as a model file of a family, with their tolerances."""
    stated = {name: getattr(declared, part) for part, name in _NAMES.items()}
    stated["dynamic_load_rating_n"] = 10.0 * declared.rated_preload
    uncertain = {_NAMES[part]: tolerance for part, tolerance in TOLERANCES.items() if getattr(declared, part)}
    if family == "lumped":
        area, polar = math.pi / 4.0 * declared.screw_diameter**2, math.pi / 32.0 * declared.screw_diameter**4
        stated |= {
            "screw_mass_kg": declared.density * area * declared.screw_length,
            "screw_inertia_kg_m2": declared.density * polar * declared.screw_length,
            "screw_minor_diameter_m": declared.screw_diameter,
            "loss_factor": _LUMPED_LOSS,
        }
        uncertain["loss_factor"] = 0.2
        dropped = {_NAMES[part] for part in _NOT_LUMPED}
        stated = {name: value for name, value in stated.items() if name not in dropped}
        uncertain = {name: value for name, value in uncertain.items() if name not in dropped}
    lines = [f'family = "{family}"', "", "[parameters]", *(f"{name} = {value!r}" for name, value in stated.items())]
    lines += ["", "[uncertain]", *(f"{name} = {value!r}" for name, value in uncertain.items())]
    return "\n".join(lines) + "\n"


def _drawn_parts(declared: Parts, rng: np.random.Generator) -> Parts:
    """Return the parts as they really are: log-normal about what is declared."""
    changes = {
        part: getattr(declared, part) * math.exp(tolerance * rng.standard_normal())
        for part, tolerance in TOLERANCES.items()
    }
    return replace(declared, **changes)


def _drawn_mechanism(kind: Kind, size: str, rng: np.random.Generator) -> Mechanism:
    value = kind.sizes[SIZES.index(size)] * math.exp(rng.uniform(-0.15, 0.15))
    sign = rng.choice((-1.0, 1.0)) if kind.either_sign else 1.0
    return kind.build(float(sign * value), rng)


def _with_wrong_part(drawn: Parts, kind: str, size: int, rng: np.random.Generator) -> Parts:
    """Return the parts with one of them far from what is declared, to either side."""
    part = part_of(kind)
    ln_ratio = WRONG_PARTS[part][size] * math.exp(rng.uniform(-0.15, 0.15)) * rng.choice((-1.0, 1.0))
    return replace(drawn, **{part: getattr(drawn, part) * math.exp(ln_ratio)})


def _ln_ratio(drawn: Parts, declared: Parts, kind: str) -> float:
    """Return ln of the true over the declared value of a wrong part, its tolerance included."""
    part = part_of(kind)
    return math.log(getattr(drawn, part) / getattr(declared, part))


def _wrong(part: str) -> str:
    return f"wrong-parameter:{_NAMES[part]}"


def part_of(kind: str) -> str:
    """Return the field of parts that a wrong parameter is."""
    return next(part for part in WRONG_PARTS if _wrong(part) == kind)
