"""Draw the commanded moves of a simulated session: short ramps to and fro, no two alike."""

from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError

#: Where the two moves of a window begin, as shares of its length, uniform: most of their ringing ends within it.
STARTS = ((0.03, 0.13), (0.33, 0.48))


@dataclass(frozen=True, slots=True)
class RampMoves:
    """A move: ramp up, cruise, ramp down. Each duration is drawn anew, uniformly, for every move of every window.

    The acceleration of a ramp of duration t_r is a raised cosine, whose spectrum is zero at 2/t_r, 3/t_r, …; the two
    ramps of a move cancel at the multiples of 1/(t_r + t_cruise). With equal moves such a null may sit on the mode
    and hide it from every average; drawn durations put it elsewhere each time.
    """

    speed: float = 0.06  # of the first move; the second returns over the same distance [m/s]
    ramp: tuple[float, float] = (3.0e-3, 4.5e-3)  # shortest and longest [s]
    cruise: tuple[float, float] = (30e-3, 60e-3)  # shortest and longest [s]

    def __post_init__(self) -> None:
        if not (np.isfinite(self.speed) and self.speed > 0.0):
            raise OutsideValidityError(f"speed must be positive; got {self.speed} m/s")
        for name in ("ramp", "cruise"):
            low, high = getattr(self, name)
            if not (np.isfinite(high) and 0.0 < low <= high):
                raise OutsideValidityError(f"{name} must rise from above 0 s; got {low} to {high} s")

    @property
    def longest(self) -> float:
        """Duration of the longest move in seconds."""
        return 2.0 * self.ramp[1] + self.cruise[1]


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """What the table shall do, from rest at zero back to rest at zero; shape (n_samples, n_windows)."""

    travel: FloatArray  # [m]
    speed: FloatArray  # [m/s]
    acceleration: FloatArray  # [m/s²]


def draw_reference(moves: RampMoves, time: FloatArray, duration: float, rng: np.random.Generator, n: int) -> Reference:
    """Draw ``n`` windows of travel, speed and acceleration: out and back, in either direction first.

    The time counts from the beginning of the window, shape (n_samples,), which lasts ``duration`` [s].
    ``OutsideValidityError`` if the longest move does not fit between the starts within a window.
    """
    room = (STARTS[1][0] - STARTS[0][1]) * duration
    if moves.longest > room:
        raise OutsideValidityError(
            f"a move takes up to {moves.longest:g} s, of which a window of {duration:g} s has {room:g} s to spare; "
            "take longer windows or shorter moves"
        )
    signed = moves.speed * rng.choice((-1.0, 1.0), n)
    distance = np.zeros(n)
    total = [np.zeros((time.size, n)) for _ in range(3)]
    for number, (first, last) in enumerate(STARTS):
        start = duration * rng.uniform(first, last, n)
        ramp, cruise = rng.uniform(*moves.ramp, n), rng.uniform(*moves.cruise, n)
        speed = signed if number == 0 else -distance / (ramp + cruise)
        distance = speed * (ramp + cruise)
        for begin, change in ((start, speed), (start + ramp + cruise, -speed)):
            for all_moves, part in zip(total, _change_of_speed(time[:, None] - begin, change, ramp), strict=True):
                np.add(all_moves, part, out=all_moves)
    return Reference(*total)


def _change_of_speed(
    since: FloatArray, change: FloatArray, ramp: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return travel, speed and acceleration since a raised-cosine ramp began; shape (n_samples, n_windows)."""
    share = np.clip(since / ramp, 0.0, 1.0)
    turn = 2.0 * np.pi * share
    after = np.maximum(since - ramp, 0.0)
    travel = change * (ramp * (0.5 * share**2 + (np.cos(turn) - 1.0) / (4.0 * np.pi**2)) + after)
    speed = change * (share - np.sin(turn) / (2.0 * np.pi))
    acceleration = change / ramp * (1.0 - np.cos(turn))
    return travel, speed, acceleration
