"""Modal tests of hidden machines: natural frequencies alone, as a fit of the peaks of two responses gives them.

A hammer at the table shows what the table takes part in, the torque of a free rotor and its encoder what the rotor
does. Both responses come from the two plants; a rational function is fitted about each peak. Nothing here is solved
with the models that the frequencies are compared with.
"""

import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy.signal

from monitor_core.fitting.conditions.settings import known_mass
from monitor_core.fitting.observations import ModalObservation
from monitor_core.models.protocol import DriveConditions, MotorEnd
from tests.hidden_effects.cases import TOLERANCES, baseline_text
from tests.hidden_effects.kinds import KINDS, SIZES, WRONG_PARTS
from tests.hidden_effects.truth import finite_elements
from tests.hidden_effects.truth.axis import Axis, Hidden, Parts, Setting
from tests.hidden_effects.truth.measurement import Scatter, set_truly
from tests.hidden_effects.truth.oscillators import frequency_response
from tests.hidden_effects.truth.wave_network import lines_of, network_of

#: Accelerance over frequencies [Hz] of the table under a force on it [1/kg], of the rotor under a torque [1/(kg·m²)].
Accelerances = Callable[[Axis, Setting, np.ndarray], tuple[np.ndarray, np.ndarray]]

NONE = "none"
WRONG = "wrong-parameter:"
#: Parts that may be wrong, by what a model file calls them.
_PART_OF = {
    "bearing_stiffness_n_per_m": "bearing_stiffness",
    "bracket_stiffness_n_per_m": "bracket_stiffness",
    "nut_stiffness_n_per_m": "nut_rigidity",
    "coupling_stiffness_nm_per_rad": "coupling_stiffness",
    "table_mass_kg": "table_mass",
    "motor_inertia_kg_m2": "motor_inertia",
}
#: So heavy a rotor stands still. [kg·m²]
_HELD = 1e3

_LINES = np.arange(15.0, 1000.0, 0.5)  # of a response [Hz]
_LEAST_PROMINENCE = 0.1  # of a peak, in ln |H|: what a modal test would take for a mode [-]
_ONE_MODE = 0.05  # frequencies of two responses that are no further apart, relatively, are of one mode [-]
_HIGHEST_DAMPING_RATIO = 0.1  # a broader hump is not taken for a mode [-]
_ABOUT_A_PEAK = 0.08  # half width of what is fitted, relative [-]


@dataclass(frozen=True, slots=True)
class Design:
    """How a modal test is laid out."""

    settings: tuple[Setting, ...]
    motor_end: MotorEnd
    n_modes: int  # the lowest ones that are taken from each response


@dataclass(frozen=True, slots=True, eq=False)
class ModalCase:
    """One machine with its modal table; what the workflow is given of it is ``table``, ``motor_end`` and ``baseline``.

    ``truth`` is by keys of effects and names of parameters in model files, of outside:… mechanisms, too.
    """

    table: tuple[ModalObservation, ...]
    motor_end: MotorEnd
    baseline: str  # a model file
    truth: Mapping[str, Mapping[str, float]]
    axis: Axis


def plain_design() -> Design:
    """Return seven positions, three preloads, two modes, the rotor free."""
    settings = [Setting(position=x, preload=preload) for x in _POSITIONS for preload in (120.0, 220.0, 360.0)]
    return Design(tuple(settings), MotorEnd.FREE, 2)


def short_design() -> Design:
    """Return three positions, six preloads, one mode, the brake closed."""
    preloads = (100.0, 150.0, 200.0, 250.0, 300.0, 350.0)
    settings = [Setting(position=x, preload=preload) for x in (0.15, 0.45, 0.75) for preload in preloads]
    return Design(tuple(settings), MotorEnd.CLAMPED, 1)


def full_design() -> Design:
    """Return the plain one with a payload at every other position, and warmer at three."""
    plain = plain_design()
    more = [Setting(position=x, preload=220.0, payload=6.0) for x in _POSITIONS[::2]]
    more += [Setting(position=x, preload=220.0, temperature_deviation=15.0) for x in _POSITIONS[1::2]]
    return replace(plain, settings=(*plain.settings, *more))


_POSITIONS = (0.083, 0.211, 0.3455, 0.476, 0.6045, 0.739, 0.868)
DESIGNS: Mapping[str, Callable[[], Design]] = {"plain": plain_design, "short": short_design, "full": full_design}


def with_known_mass(design: Design) -> Design:
    """Return a design with every setting measured once more with a known mass on the table."""
    declared = Parts()
    mass = known_mass(declared.table_mass + declared.nut_mass)
    heavier = (replace(setting, payload=setting.payload + mass) for setting in design.settings)
    return replace(design, settings=(*design.settings, *heavier))


def with_positions_between(design: Design) -> Design:
    """Return a design measured once more halfway to the next position, wherever there is one."""
    positions = sorted({setting.position for setting in design.settings})
    between = {low: 0.5 * (low + high) for low, high in pairwise(positions)}
    moved = (
        replace(setting, position=between[setting.position])
        for setting in design.settings
        if setting.position in between
    )
    return replace(design, settings=(*design.settings, *moved))


def draw_machine(kind: str, size: str, rng: np.random.Generator) -> tuple[Axis, dict[str, dict[str, float]]]:
    """Draw a machine about its description, and what is hidden in it; several kinds are joined by "+"."""
    declared = Parts()
    drawn = {
        part: getattr(declared, part) * math.exp(tolerance * rng.standard_normal())
        for part, tolerance in TOLERANCES.items()
    }
    hidden: dict[str, float] = {}
    truth: dict[str, dict[str, float]] = {}
    for key in kind.split("+") if kind != NONE else ():
        if key.startswith(WRONG):
            part = _PART_OF[key.removeprefix(WRONG)]
            drawn[part] *= math.exp(_value(WRONG_PARTS[part], size, rng, either_sign=True))
            truth[key] = {"ln_ratio": math.log(drawn[part] / getattr(declared, part))}
        else:
            value = _value(KINDS[key].sizes, size, rng, either_sign=KINDS[key].either_sign)
            mechanism, stated = KINDS[key].build(value, rng)
            hidden |= mechanism
            truth[key] = dict(stated)
    return Axis(parts=replace(declared, **drawn), hidden=Hidden(**hidden)), truth


def draw_modal_case(
    kind: str, size: str, design: Design, uncertainty: float, seed: int, *, accelerances: Accelerances
) -> ModalCase:
    """Draw a machine and put it through a modal test.

    Parameters
    ----------
    kind : str
        "none", keys of :data:`KINDS`, "wrong-parameter:…", several joined by "+".
    size : str
        One of :data:`SIZES`.
    design : Design
    uncertainty : float
        Standard uncertainty of a frequency, relative. [-]
    seed : int
        A machine of one seed, kind and size is the same in every design that begins with the same settings.
    accelerances : callable
        Of the plant.
    """
    of_machine = np.random.default_rng([seed, zlib.crc32(f"{kind}/{size}".encode())])
    axis, truth = draw_machine(kind, size, of_machine)
    rng = np.random.default_rng([seed, 1])
    true_settings = set_truly(design.settings, Scatter(), rng)
    tested = replace(axis, parts=replace(axis.parts, motor_inertia=_HELD)) if _held(design) else axis
    table: list[ModalObservation] = []
    # In random order, as a test is to be made: a drift is not taken for what was varied last.
    turns = np.random.default_rng([seed, 2]).permutation(len(design.settings))
    for turn, stated, true in zip(turns.tolist(), design.settings, true_settings, strict=True):
        ordered = replace(true, order=turn / max(len(design.settings) - 1, 1))
        table += _observed(stated, modal_test(accelerances, tested, ordered)[: design.n_modes], uncertainty, rng)
    return ModalCase(tuple(table), design.motor_end, baseline_text(Parts(), "receptance"), truth, axis)


def modal_test(accelerances: Accelerances, axis: Axis, setting: Setting) -> list[float]:
    """Return the natural frequencies of the modes that show as peaks of a response, each once, rising. [Hz]."""
    found: list[float] = []
    for which, response in enumerate(accelerances(axis, setting, _LINES)):
        peaks, _ = scipy.signal.find_peaks(np.log(np.abs(response)), prominence=_LEAST_PROMINENCE)
        for peak in peaks:
            frequency, damping_ratio = fitted_mode(accelerances, axis, setting, which, float(_LINES[peak]))
            apart = all(abs(frequency / earlier - 1.0) > _ONE_MODE for earlier in found)
            if damping_ratio < _HIGHEST_DAMPING_RATIO and apart:
                found.append(frequency)
    return sorted(found)


def fitted_mode(
    accelerances: Accelerances, axis: Axis, setting: Setting, which: int, peak: float
) -> tuple[float, float]:
    r"""Return ω_n/2π [Hz] and damping ratio of the pole about a peak of one of the responses.

    :math:`H (s^2 + d_1 s + d_0) = n_0 + n_1 s + n_2 s^2 + n_3 s^3` is linear in its unknowns; s is taken over the peak.
    """
    frequency = peak * np.linspace(1.0 - _ABOUT_A_PEAK, 1.0 + _ABOUT_A_PEAK, 81)
    response = accelerances(axis, setting, frequency)[which]
    response = response / np.max(np.abs(response))
    s = 1j * frequency / peak
    columns = np.array([response, response * s, *(-(s**power) for power in range(4))]).T
    right = -response * s**2
    unknown, *_ = np.linalg.lstsq(np.r_[columns.real, columns.imag], np.r_[right.real, right.imag], rcond=None)
    natural = math.sqrt(float(unknown[0]))
    return peak * natural, float(unknown[1]) / (2.0 * natural)


def finite_elements_accelerances(axis: Axis, setting: Setting, frequency: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return both accelerances in finite elements."""
    omega, plant = 2.0 * np.pi * frequency, finite_elements.plant(axis, setting)
    return frequency_response(plant, omega, 1)[0], -(omega**2) * frequency_response(plant, omega, 0)[1]


def transmission_line_accelerances(
    axis: Axis, setting: Setting, frequency: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return both accelerances with the screw as wave lines."""
    network = network_of(axis, setting, lines_of(axis, frequency))
    return network.seen(0.0, 1.0)[0], network.s**2 * network.seen(1.0)[1]


PLANTS: Mapping[str, Accelerances] = {
    "finite elements": finite_elements_accelerances,
    "transmission line": transmission_line_accelerances,
}


def _observed(
    stated: Setting, frequencies: Sequence[float], uncertainty: float, rng: np.random.Generator
) -> list[ModalObservation]:
    conditions = DriveConditions(
        stated.position, stated.preload, stated.payload, temperature_deviation=stated.temperature_deviation
    )
    scattered = sorted(frequency * (1.0 + uncertainty * rng.standard_normal()) for frequency in frequencies)
    return [ModalObservation(conditions, frequency, uncertainty * frequency) for frequency in scattered]


def _held(design: Design) -> bool:
    return design.motor_end is MotorEnd.CLAMPED


def _value(sizes: tuple[float, float, float], size: str, rng: np.random.Generator, *, either_sign: bool) -> float:
    value = sizes[SIZES.index(size)] * math.exp(rng.uniform(-0.15, 0.15))
    return float(value * (rng.choice((-1.0, 1.0)) if either_sign else 1.0))
