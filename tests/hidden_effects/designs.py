"""Designs of settings: at how many positions, preloads, payloads, levels and temperatures a machine is measured.

No position is a multiple of the lead, and their places within the lead differ; the order is random.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tests.hidden_effects.machines import Machine
from tests.hidden_effects.truth.axis import Setting

#: Multiples of the usual preload.
_PRELOADS = (0.55, 1.0, 1.64)
_WARMER = 15.0  # [K]
_BETWEEN = 0.25  # a setting that is near another one, of a lead away [-]


def rich(machine: Machine, rng: np.random.Generator) -> tuple[Setting, ...]:
    """Return 31 settings: 7 positions × 3 preloads, and at two inner ones all else that can be varied."""
    places = _places(7, machine, rng)
    settings = [_usual(machine, x, preload) for x in places for preload in _PRELOADS]
    for x in (places[2], places[4]):
        usual = _usual(machine, x)
        settings += [
            replace(usual, excitation_rms=0.3 * usual.excitation_rms),
            replace(usual, excitation_rms=3.0 * usual.excitation_rms),
            replace(usual, payload=machine.payload),
            replace(usual, temperature_deviation=_WARMER),
        ]
    lead = machine.parts.screw_lead
    settings += [_usual(machine, _rounded(places[3] + share * lead)) for share in (_BETWEEN, 2.0 * _BETWEEN)]
    return _in_random_order(settings, rng)


def usual(machine: Machine, rng: np.random.Generator) -> tuple[Setting, ...]:
    """Return 21 settings: 5 positions × 3 preloads, and at two of them a payload, a level and a temperature."""
    places = _places(5, machine, rng)
    settings = [_usual(machine, x, preload) for x in places for preload in _PRELOADS]
    for x in (places[1], places[3]):
        at = _usual(machine, x)
        settings += [
            replace(at, excitation_rms=3.0 * at.excitation_rms),
            replace(at, payload=machine.payload),
            replace(at, temperature_deviation=_WARMER),
        ]
    return _in_random_order(settings, rng)


def poor(machine: Machine, rng: np.random.Generator) -> tuple[Setting, ...]:
    """Return 12 settings: 3 positions × 4 preloads, and nothing else is varied."""
    preloads = (0.55, 0.8, 1.15, 1.64)
    settings = [_usual(machine, x, preload) for x in _places(3, machine, rng) for preload in preloads]
    return _in_random_order(settings, rng)


DESIGNS: dict[str, Callable[[Machine, np.random.Generator], tuple[Setting, ...]]] = {
    "rich": rich,
    "usual": usual,
    "poor": poor,
}


def _places(n: int, machine: Machine, rng: np.random.Generator) -> tuple[float, ...]:
    """Return positions from a twelfth to nine tenths of the screw, each somewhere else within the lead. [m]."""
    length, lead = machine.parts.screw_length, machine.parts.screw_lead
    evenly = np.linspace(0.085 * length, 0.9 * length, n)
    turns = np.floor(evenly / lead) + 0.08 + 0.84 * (rng.permutation(n) + rng.uniform(0.2, 0.8, n)) / n
    return tuple(_rounded(float(x)) for x in turns * lead)


def _usual(machine: Machine, position: float, preload: float = 1.0) -> Setting:
    stated = float(f"{preload * machine.preload:.3g}")
    return Setting(position=position, preload=stated, excitation_rms=machine.torque)


def _rounded(position: float) -> float:
    """Return a position as it would be written down, to a tenth of a millimetre. [m]."""
    return round(position, 4)


def _in_random_order(settings: Sequence[Setting], rng: np.random.Generator) -> tuple[Setting, ...]:
    order, last = rng.permutation(len(settings)), len(settings) - 1
    return tuple(replace(settings[which], order=time / last) for time, which in enumerate(order))
