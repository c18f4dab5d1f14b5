"""What may be hidden in an axis, in three sizes, and what a model file would have to say of it.

Sizes: with noise of 0.3 %, and after everything declared and every error of a setting has explained what it can, small
is at most 10 standard deviations, medium about 10 to 50, and large is plain to see. Of wrong parameters, against whom
their tolerance alone may speak, even large ones are about 10.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

SIZES = ("small", "medium", "large")

#: Hidden mechanism of a drawn value, and what a model file would have to say.
Mechanism = tuple[dict[str, float], dict[str, float]]


@dataclass(frozen=True, slots=True)
class Kind:
    """Something that may be hidden, in three sizes."""

    sizes: tuple[float, float, float]
    build: Callable[[float, np.random.Generator], Mechanism]
    either_sign: bool = False
    unstated: tuple[str, ...] = ()  # parts that the machine has none of but what is hidden, and its description neither


def _plain(field: str, name: str) -> Callable[[float, np.random.Generator], Mechanism]:
    return lambda value, _rng: ({field: value}, {name: value})


def _axial(value: float, _rng: np.random.Generator) -> Mechanism:
    return {"axial_modulus_factor": 1.0 + value}, {"relative_change": value}


def _periodic(value: float, rng: np.random.Generator) -> Mechanism:
    phase = rng.uniform(-math.pi, math.pi)
    stated = {"cosine_amplitude": value * math.cos(phase), "sine_amplitude": value * math.sin(phase)}
    return {"periodic_preload": value, "periodic_phase": phase}, stated


def _mounting(inverse_square: float, rng: np.random.Generator) -> Mechanism:
    frequency, ratio = 1.0 / (2.0 * math.pi * math.sqrt(inverse_square)), rng.uniform(0.03, 0.07)
    stated = {"inverse_square_s2": inverse_square, "bandwidth_hz": 2.0 * ratio * frequency}
    return {"mounting_frequency": frequency, "mounting_damping_ratio": ratio}, stated


def _base(value: float, rng: np.random.Generator) -> Mechanism:
    frequency, ratio = rng.uniform(45.0, 110.0), rng.uniform(0.01, 0.03)
    stated = {"compliance_m_per_n": value, "frequency_hz": frequency, "damping_ratio": ratio}
    return {"base_compliance": value, "base_frequency": frequency, "base_damping_ratio": ratio}, stated


def _structure(value: float, rng: np.random.Generator) -> Mechanism:
    frequency, ratio = rng.uniform(250.0, 450.0), rng.uniform(0.01, 0.03)
    stated = {"residue_per_kg": value, "frequency_hz": frequency, "damping_ratio": ratio}
    return {"structure_residue": value, "structure_frequency": frequency, "structure_damping_ratio": ratio}, stated


def _absorber(place: str) -> Callable[[float, np.random.Generator], Mechanism]:
    def build(value: float, rng: np.random.Generator) -> Mechanism:
        frequency, ratio = rng.uniform(250.0, 450.0), rng.uniform(0.01, 0.04)
        stated = {"mass_kg": value, "frequency_hz": frequency, "damping_ratio": ratio}
        hidden = {f"{place}_mass": value, f"{place}_frequency": frequency, f"{place}_damping_ratio": ratio}
        return hidden, stated

    return build


def _swinging_at(place: str, size: str, name: str) -> Callable[[float, np.random.Generator], Mechanism]:
    def build(value: float, rng: np.random.Generator) -> Mechanism:
        frequency, ratio = rng.uniform(150.0, 450.0), rng.uniform(0.01, 0.04)
        hidden = {
            f"{place}_absorber_{size}": value,
            f"{place}_absorber_frequency": frequency,
            f"{place}_absorber_damping_ratio": ratio,
        }
        return hidden, {name: value, "frequency_hz": frequency}

    return build


def _wandering(value: float, rng: np.random.Generator) -> Mechanism:
    frequency = rng.uniform(250.0, 450.0)
    return (
        {"absorber_mass": value, "absorber_frequency": frequency, "absorber_frequency_slope": 0.3},
        {"mass_kg": value, "frequency_hz": frequency},
    )


def _softening(value: float, _rng: np.random.Generator) -> Mechanism:
    return {"nut_softening": value, "nut_softening_deflection": 1.5e-7}, {"share": value}


def _contact_loss(value: float, _rng: np.random.Generator) -> Mechanism:
    return {"nut_contact_loss": 0.5, "nut_contact_deflection": 1.0 / value}, {"inverse_deflection_per_m": value}


def _cracked(value: float, rng: np.random.Generator) -> Mechanism:
    return {"coupling_crack": value, "coupling_crack_phase": rng.uniform(-math.pi, math.pi)}, {"share": value}


#: By the keys of effects.
KINDS: dict[str, Kind] = {
    "added-mass": Kind((0.5, 1.0, 2.5), _plain("added_mass", "mass_kg")),
    "payload-mass": Kind((0.1, 0.4, 1.5), _plain("payload_error", "mass_kg"), either_sign=True),
    "series-compliance": Kind((3e-9, 3e-8, 8e-8), _plain("series_compliance", "compliance_m_per_n")),
    "far-bearing-stiffness": Kind((4e5, 1.6e6, 3e7), _plain("far_bearing_stiffness", "stiffness_n_per_m")),
    "screw-axial-stiffness": Kind((0.05, 0.1, 0.25), _axial, either_sign=True),
    "torsional-flexibility": Kind((0.06, 0.2, 0.8), _plain("torsional_compliance_share", "compliance_share")),
    "loss-factor": Kind((0.002, 0.006, 0.03), _plain("loss_factor", "loss_factor")),
    "guide-friction": Kind((0.03, 0.15, 1.0), _plain("guide_friction", "friction_n")),
    "guide-stiffness": Kind((1.2e4, 5e4, 4e5), _plain("guide_stiffness", "stiffness_n_per_m")),
    "preload-exponent": Kind(
        (0.06, 0.15, 0.27), _plain("preload_exponent_change", "exponent_change"), either_sign=True
    ),
    "thermal-preload": Kind((2.0, 5.0, 8.0), _plain("thermal_preload", "preload_n_per_k"), either_sign=True),
    "thermal-stiffness": Kind(
        (3e-5, 1e-4, 5e-4), _plain("thermal_stiffness", "relative_change_per_k"), either_sign=True
    ),
    "position-offset": Kind((0.002, 0.006, 0.025), _plain("position_offset", "offset_m"), either_sign=True),
    "torque-delay": Kind((5e-7, 2e-6, 5e-5), _plain("torque_delay", "delay_s")),
    "sensor-mounting-resonance": Kind((1e-10, 6e-10, 4e-9), _mounting),
    "base-compliance": Kind((2e-11, 1e-10, 2e-9), _base),
    "servo-stiffness": Kind((0.015, 0.06, 2.0), _plain("servo_stiffness", "stiffness_nm_per_rad")),
    "periodic-preload": Kind((0.05, 0.15, 0.35), _periodic),
    "cubic-stiffness": Kind((6e10, 6e11, 1.5e12), _plain("cubic_nut_stiffness", "relative_stiffness_per_m2")),
    "second-mode": Kind((5e-7, 2e-6, 5e-5), _structure),
    "nut-mass": Kind((0.3, 1.0, 3.0), _plain("nut_mass_before_bracket", "mass_kg")),
    "constant-loss-factor": Kind((0.002, 0.006, 0.03), _plain("constant_loss_factor", "loss_factor")),
    "screw-loss": Kind((0.008, 0.015, 0.05), _plain("screw_loss_factor", "loss_factor")),
    "table-absorber": Kind((0.03, 0.1, 0.4), _absorber("absorber")),
    "nut-absorber": Kind((0.03, 0.1, 0.4), _absorber("nut_absorber")),
    "motor-damping": Kind(
        (2e-4, 1e-3, 1e-2), _plain("motor_damping", "damping_nms_per_rad"), unstated=("motor_damping",)
    ),
    "response-delay": Kind((5e-7, 2e-6, 5e-5), _plain("response_delay", "delay_s")),
    "angle-delay": Kind((5e-7, 2e-6, 5e-5), _plain("angle_delay", "delay_s")),
    "outside:wandering-absorber": Kind((0.03, 0.1, 0.4), _wandering),
    "outside:nut-softening": Kind((0.1, 0.25, 0.5), _softening),
    "outside:preload-drift": Kind((0.08, 0.2, 0.4), _plain("preload_drift", "share")),
    "outside:backlash": Kind((3e-9, 1e-8, 4e-8), _plain("nut_backlash", "half_width_m")),
    "outside:contact-loss": Kind((3e6, 6e6, 2e7), _contact_loss),
    "outside:rotor-absorber": Kind((2e-6, 1e-5, 4e-5), _swinging_at("rotor", "inertia", "inertia_kg_m2")),
    "outside:screw-end-absorber": Kind((0.5, 2.0, 6.0), _swinging_at("screw_end", "mass", "mass_kg")),
    "outside:screw-bending": Kind((2e-3, 6e-3, 2e-2), _plain("bend_eccentricity", "eccentricity_m")),
    "outside:cracked-coupling": Kind((3.0, 10.0, 30.0), _cracked),
}


def _worn(value: float, rng: np.random.Generator) -> Mechanism:
    place, width = rng.uniform(0.25, 0.75), rng.uniform(0.04, 0.12)
    return {"wear": value, "wear_at": place, "wear_width": width}, {"share": value, "place": place, "width": width}


def _worn_beyond(value: float, rng: np.random.Generator) -> Mechanism:
    place = rng.uniform(0.3, 0.7)
    return {"wear": value, "wear_at": place, "wear_width": math.inf}, {"share": value, "place": place}


def _pitch(value: float, rng: np.random.Generator) -> Mechanism:
    waves = rng.uniform(0.4, 1.2)
    return {"pitch_error": value, "pitch_waves": waves}, {"share": value, "waves": waves}


def _belt(value: float, rng: np.random.Generator) -> Mechanism:
    ratio = rng.uniform(1.3, 2.0)
    return {"belt_ratio": ratio, "belt_stiffness_share": value}, {"ratio": ratio, "stiffness_share": value}


def _lost_at_once(value: float, rng: np.random.Generator) -> Mechanism:
    when = rng.uniform(0.3, 0.7)
    return {"lost_mass": value, "lost_at": when}, {"mass_kg": value, "when": when}


#: Outside the catalogue too, and no part of the benchmark's draw: what goes with a variable by more than a smooth form.
LOCAL_KINDS: dict[str, Kind] = {
    "outside:local-wear": Kind((0.5, 0.75, 0.92), _worn),
    "outside:wear-beyond": Kind((0.5, 0.75, 0.92), _worn_beyond),
    "outside:torque-limit": Kind((0.5, 0.35, 0.25), _plain("torque_limit", "torque_nm")),
    "outside:pitch-error": Kind((0.05, 0.1, 0.2), _pitch),
    "outside:belt": Kind((0.6, 0.3, 0.15), _belt),
    "outside:mass-lost": Kind((1.0, 2.0, 4.0), _plain("lost_mass", "mass_kg")),
    "outside:mass-lost-at-once": Kind((1.0, 2.0, 4.0), _lost_at_once),
}
#: A declared part that is not within its tolerance: ln of true over declared.
WRONG_PARTS: dict[str, tuple[float, float, float]] = {
    "bearing_stiffness": (1.0, 1.4, 2.0),
    "bracket_stiffness": (1.0, 1.4, 2.0),
    "nut_rigidity": (0.5, 0.7, 1.1),
    "coupling_stiffness": (1.0, 1.4, 2.0),
    "table_mass": (0.025, 0.05, 0.12),
    "motor_inertia": (0.1, 0.2, 0.4),
}
#: Some that look alike, some that have nothing to do with each other.
PAIRS = (
    "added-mass+far-bearing-stiffness",
    "added-mass+loss-factor",
    "far-bearing-stiffness+torque-delay",
    "series-compliance+guide-stiffness",
    "guide-friction+payload-mass",
    "torsional-flexibility+preload-exponent",
    "base-compliance+position-offset",
    "screw-axial-stiffness+servo-stiffness",
    "second-mode+sensor-mounting-resonance",
    "thermal-preload+periodic-preload",
    "cubic-stiffness+added-mass",
    "loss-factor+guide-stiffness",
)
