"""Travels of a screw to and fro: motor torque and encoder position of motion that is meant to be at one speed.

Friction, weight and what repeats with the turn of the screw are functions of the place; noise and what the mains do are
functions of time. Nothing of the product is used.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter


@dataclass(frozen=True)
class Travels:
    """How an axis goes, and what its torque is made of."""

    lead: float = 0.010  # [m]
    stroke: float = 0.300  # [m]
    speed: float = 0.050  # [m/s]
    passes: int = 4  # there and back
    rate: float = 2000.0  # [Hz]
    count: float = 1e-6  # step of the encoder [m]
    ramp: float = 0.1  # [s]
    speed_ripple: float = 0.02  # amplitude, relative ...
    ripple_hz: float = 1.3  # ... at this frequency of time
    spread: float = 0.0  # of the speeds of the passes, relative
    drag: float = 0.8  # [N·m]
    of_place: float = 0.05  # how the friction goes up and down over the stroke, relative
    weight: float = 0.3  # what does not change sign [N·m]
    orders: dict = field(default_factory=dict)  # order → amplitude [N·m]
    mains: float = 0.0  # amplitude of 50 Hz [N·m]
    noise: float = 0.02  # standard deviation, of samples [N·m]
    colour: float = 0.0  # autoregression of the noise from sample to sample
    texture: float = 0.0  # standard deviation of the friction from grain to grain of the screw [N·m]
    grain: float = 0.0005  # [m]
    of_pass: float = 0.0  # standard deviation of the friction from pass to pass [N·m]


def go(how, rng):
    """Return torque and position of a record of all passes."""
    torque, position = [], []
    phases = {order: rng.uniform(0.0, 2.0 * np.pi) for order in how.orders}
    clock = rng.uniform(0.0, 10.0)
    grains = how.texture * rng.spawn(1)[0].normal(size=int(how.stroke / how.grain) + 2)
    for number in range(2 * how.passes):
        sense = 1.0 if number % 2 == 0 else -1.0
        speed = how.speed * (1.0 + how.spread * rng.uniform(-1.0, 1.0))
        # fine steps of time until the stroke is gone, then the ramp down
        n = int(1.2 * (how.stroke / speed + 2.0 * how.ramp) * how.rate)
        t = np.arange(n) / how.rate
        v = speed * np.minimum(t / how.ramp, 1.0)
        v *= 1.0 + how.speed_ripple * np.sin(2.0 * np.pi * how.ripple_hz * (clock + t) + number)
        x = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]))]) / how.rate
        end = int(np.searchsorted(x, how.stroke - 0.5 * speed * how.ramp))
        down = np.arange(1, int(how.ramp * how.rate) + 1) / how.rate
        last = v[end - 1]
        x = np.concatenate([x[:end], x[end - 1] + last * down - 0.5 * last * down**2 / how.ramp])
        x *= how.stroke / x[-1]
        place = x if sense > 0.0 else how.stroke - x
        t = clock + np.arange(x.size) / how.rate
        accelerating = np.gradient(np.gradient(x, 1.0 / how.rate), 1.0 / how.rate)
        friction = how.drag * (1.0 + how.of_place * np.cos(2.0 * np.pi * place / how.stroke))
        friction += np.interp(place / how.grain, np.arange(grains.size), grains)
        of_torque = sense * (friction + how.of_pass * rng.normal() + 0.2 * accelerating) + how.weight
        for order, amplitude in how.orders.items():
            # what is no whole number of times in a turn is the balls, which come back otherwise each time
            phase = phases[order] if float(order).is_integer() else rng.uniform(0.0, 2.0 * np.pi)
            of_torque += amplitude * np.cos(2.0 * np.pi * order * place / how.lead + phase)
        of_torque += how.mains * np.sin(2.0 * np.pi * 50.0 * t) + _noise(how, rng, x.size)
        rest = int(0.2 * how.rate)
        torque += [of_torque, how.weight + _noise(how, rng, rest)]
        position += [place, np.full(rest, place[-1])]
        clock = t[-1] + 0.2
    position = np.round(np.concatenate(position) / how.count) * how.count
    return np.concatenate(torque), position


def _noise(how, rng, n):
    # begun long before it is taken, so that it is as strong at its start
    white = how.noise * np.sqrt(1.0 - how.colour**2) * rng.normal(size=n + 100)
    return lfilter([1.0], [1.0, -how.colour], white)[100:]
