"""Motion in time with forces fed back that no linear plant has: dry friction at the table, a nut that is not linear.

Where numba is installed the steps run as machine code; without it the same numbers take some two hundred times longer.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft
import scipy.signal

from tests.hidden_effects.truth.oscillators import Oscillators

try:
    from numba import njit
except ImportError:  # an extra

    def njit(**_options):
        """Leave a function as it is."""
        return lambda function: function


#: At 4096 samples a second a step is 61 µs, a ninetieth of a period of the first mode.
STEPS_PER_SAMPLE = 4
#: Inputs of the plants.
TORQUE, TABLE_FORCE, NUT_FORCE = 0, 1, 2
#: Outputs beyond those that are asked for.
TABLE_VELOCITY, NUT_DEFLECTION = -2, -1


@dataclass(frozen=True, slots=True, eq=False)
class FedBack:
    """Forces that follow from the motion."""

    friction: float  # Coulomb, opposes the velocity of the table [N]
    nut_stiffness: np.ndarray  # k of the linear nut, shape (n_settings,) [N/m]
    cubic: float = 0.0  # β: the force in the nut is k (1 + β δ²) δ [1/m²]
    softening: float = 0.0  # share of the stiffness lost where the deflection is large [-]
    softening_deflection: float = 1.0  # where half of that is lost [m]
    backlash: float = 0.0  # half of the way without force [m]
    contact_loss: float = 0.0  # share of the stiffness lost beyond a deflection [-]
    contact_deflection: float = 1.0  # [m]

    @property
    def acts(self) -> bool:
        """Whether there is any."""
        return bool(self.friction or self.cubic or self.softening or self.backlash or self.contact_loss)


def stepped_motion(
    plants: Sequence[Oscillators],
    torque: np.ndarray,
    sample_rate: float,
    delay: float,
    fed_back: FedBack,
    *,
    steps_per_sample: int = STEPS_PER_SAMPLE,
) -> np.ndarray:
    """Return the motion from rest without the last two outputs, shape (n_outputs − 2, n_settings, n_samples).

    Each step is exact in the linear plant. Over a step friction has its full size against the motion; where the table
    turns, it has it on either side of the moment at which it does, or holds the table from then on. The force in the
    nut is linear over a step and solved by Newton's method. Samples are taken behind an anti-aliasing filter that is
    flat to 0.85 of the Nyquist frequency.
    """
    step = 1.0 / (sample_rate * steps_per_sample)
    acting = _between_samples(torque, sample_rate, delay, steps_per_sample)
    taps = scipy.signal.firwin(40 * steps_per_sample + 1, 1.0 / steps_per_sample, window=("kaiser", 8.0))
    law = (
        fed_back.friction, fed_back.cubic, fed_back.softening, fed_back.softening_deflection,
        fed_back.backlash, fed_back.contact_loss, fed_back.contact_deflection,
    )  # fmt: skip
    outputs = []
    for index, plant in enumerate(plants):
        decay, constant, rising = _integrals(plant.pole * step)
        end = (step * rising)[:, None] * plant.participation
        start = (step * constant)[:, None] * plant.participation - end
        observation, feedthrough = np.ascontiguousarray(plant.observation), plant.feedthrough
        stiffness = float(fed_back.nut_stiffness[index])
        motion = _march(decay, start.T.copy(), end.T.copy(), observation, feedthrough, acting[index], stiffness, law)
        outputs.append(scipy.signal.resample_poly(motion, 1, steps_per_sample, axis=1, window=taps))
    return np.stack(outputs, axis=1)


@njit(cache=True)
def _march(decay, start, end, observation, feedthrough, torque, stiffness, law):  # noqa: PLR0917 compiled
    """Return the outputs at every step, shape (n_outputs − 2, n_steps).

    ``start`` and ``end``, shape (3, n_poles), are the changes of the state by inputs that fall to zero over a step and
    that rise from zero.
    """
    friction = law[0]
    bends_nut = law[1] != 0.0 or law[2] != 0.0 or law[4] != 0.0 or law[5] != 0.0
    n_poles, n_outputs = decay.size, observation.shape[0] - 2
    turns, bends = observation[n_outputs], observation[n_outputs + 1]
    velocity_per_force, deflection_per_force = 0.0, 0.0
    for p in range(n_poles):
        velocity_per_force += (turns[p] * (start[1, p] + end[1, p])).real
        deflection_per_force += (bends[p] * end[2, p]).real
    state = np.zeros(n_poles, dtype=np.complex128)
    outputs = np.zeros((n_outputs, torque.size))
    velocity, table_force, nut_force = 0.0, 0.0, 0.0
    for k in range(1, torque.size):
        before = nut_force
        deflection, free = 0.0, 0.0
        for p in range(n_poles):
            z = decay[p] * state[p] + start[0, p] * torque[k - 1] + end[0, p] * torque[k] + start[2, p] * before
            state[p] = z
            deflection += bends[p].real * z.real - bends[p].imag * z.imag
        if bends_nut:
            nut_force = _nut_force(deflection, deflection_per_force, stiffness, law)
            for p in range(n_poles):
                state[p] += end[2, p] * nut_force
        if friction > 0.0:
            for p in range(n_poles):
                free += turns[p].real * state[p].real - turns[p].imag * state[p].imag
            table_force = _friction(velocity, free, velocity_per_force, friction)
            velocity = free + velocity_per_force * table_force
            for p in range(n_poles):
                state[p] += (start[1, p] + end[1, p]) * table_force
        for o in range(n_outputs):
            seen = feedthrough[o, 0] * torque[k] + feedthrough[o, 2] * nut_force
            for p in range(n_poles):
                seen += observation[o, p].real * state[p].real - observation[o, p].imag * state[p].imag
            # friction is a mean over a step: at its end, half of what it was and half of what it will be
            outputs[o, k - 1] += 0.5 * feedthrough[o, 1] * table_force
            outputs[o, k] = seen + 0.5 * feedthrough[o, 1] * table_force
    return outputs


@njit(cache=True)
def _friction(velocity, free, per_force, friction):
    """Return the mean friction over a step from a velocity to one that without it would be ``free``."""
    other = (free - velocity) / per_force  # force of everything else on the table
    if velocity == 0.0:
        return -math.copysign(min(abs(other), friction), other)
    opposing = -math.copysign(friction, velocity)
    if (free + per_force * opposing) * velocity >= 0.0:
        return opposing
    if abs(other) <= friction:
        return -free / per_force  # it stops within the step and is held
    moving_on = -velocity / (per_force * (other + opposing))  # share of the step until it turns
    return (2.0 * moving_on - 1.0) * opposing


@njit(cache=True)
def _nut_force(unloaded, per_force, stiffness, law):
    """Return what the force in the nut exceeds k δ by, at the deflection that this force leaves of ``unloaded``."""
    _, cubic, softening, scale, backlash, lost, beyond = law
    deflection = unloaded
    for _ in range(5):
        square = deflection * deflection
        reached = square / (square + scale * scale)
        force = stiffness * (cubic * square - softening * reached) * deflection
        slope = stiffness * (3.0 * cubic * square - softening * reached * (3.0 - 2.0 * reached))
        side, size = math.copysign(stiffness, deflection), abs(deflection)
        force -= side * min(size, backlash)
        if size < backlash:
            slope -= stiffness
        if size > beyond:
            force -= side * lost * (size - beyond)
            slope -= stiffness * lost
        deflection -= (deflection - unloaded - per_force * force) / (1.0 - per_force * slope)
    return (deflection - unloaded) / per_force


def _integrals(exponent: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return e^x, (e^x − 1)/x and (e^x − 1 − x)/x²."""
    small = np.abs(exponent) < 1e-3
    safe = np.where(small, 1.0, exponent)
    constant = np.where(small, 1.0 + exponent / 2.0 + exponent**2 / 6.0, np.expm1(safe) / safe)
    rising = np.where(small, 0.5 + exponent / 6.0 + exponent**2 / 24.0, (np.expm1(safe) - safe) / safe**2)
    return np.exp(exponent), constant, rising


def _between_samples(torque: np.ndarray, sample_rate: float, delay: float, steps_per_sample: int) -> np.ndarray:
    """Return the delayed torque at every step, such that straight lines between its values have its own spectrum."""
    n = torque.shape[1]
    frequency = scipy.fft.rfftfreq(n, 1.0 / sample_rate)
    straight = np.sinc(frequency / (sample_rate * steps_per_sample)) ** 2
    spectrum = scipy.fft.rfft(torque, axis=1) * np.exp(-2j * np.pi * frequency * delay) / straight
    return scipy.fft.irfft(spectrum, n=n * steps_per_sample, axis=1) * steps_per_sample
