"""A linear plant as decoupled first-order oscillators, and its steady motion under a torque."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
import scipy.linalg


@dataclass(frozen=True, slots=True, eq=False)
class StateSpace:
    """ẋ = A x + B u, y = C x + D u."""

    a: np.ndarray  # shape (n_states, n_states)
    b: np.ndarray  # shape (n_states, n_inputs)
    c: np.ndarray  # shape (n_outputs, n_states)
    d: np.ndarray  # shape (n_outputs, n_inputs)


@dataclass(frozen=True, slots=True, eq=False)
class Oscillators:
    """ż = λ z + p u, y = Re(o z) + D u: of each pair of poles the one with Im λ > 0, whose o is doubled."""

    pole: np.ndarray  # λ, shape (n_poles,) [1/s]
    participation: np.ndarray  # p, shape (n_poles, n_inputs)
    observation: np.ndarray  # o, shape (n_outputs, n_poles)
    feedthrough: np.ndarray  # D, shape (n_outputs, n_inputs)

    def seen_by(self, n_outputs: int) -> "Oscillators":
        """Return the plant with its first outputs alone."""
        return replace(self, observation=self.observation[:n_outputs], feedthrough=self.feedthrough[:n_outputs])


def decouple(system: StateSpace) -> Oscillators:
    """Return the plant in the coordinates of its complex modes."""
    pole, shapes = scipy.linalg.eig(system.a)
    participation = np.linalg.solve(shapes, system.b.astype(complex))
    observation = system.c @ shapes
    kept = pole.imag >= 0.0
    twice = np.where(pole[kept].imag > 0.0, 2.0, 1.0)
    return Oscillators(pole[kept], participation[kept], observation[:, kept] * twice, system.d)


def frequency_response(plant: Oscillators, omega: np.ndarray, which: int = 0) -> np.ndarray:
    """Return all outputs per unit of one input, shape (n_outputs, n_lines)."""
    residue = 0.5 * plant.observation * plant.participation[:, which]
    line = 1j * omega
    response = residue @ (1.0 / (line - plant.pole[:, None]))
    response += residue.conj() @ (1.0 / (line - plant.pole.conj()[:, None]))
    return response + plant.feedthrough[:, [which]]


def steady_motion(
    plants: Sequence[Oscillators], torque: np.ndarray, sample_rate: float, delay: float, n_outputs: int
) -> np.ndarray:
    """Return the first outputs in steady motion under a torque that repeats, shape (n_outputs, n_settings, n_samples).

    Exact for a torque that is band-limited between its samples. Its mean is left out: the drive would run away.
    """
    spectrum = scipy.fft.rfft(torque, axis=1)
    omega = 2.0 * np.pi * scipy.fft.rfftfreq(torque.shape[1], 1.0 / sample_rate)
    driven = np.max(np.abs(spectrum), axis=0) > 1e-9 * np.max(np.abs(spectrum))
    driven[0] = False
    acting = spectrum[:, driven] * np.exp(-1j * omega[driven] * delay)
    answer = np.zeros((n_outputs, *spectrum.shape), dtype=complex)
    for index, plant in enumerate(plants):
        answer[:, index, driven] = frequency_response(plant.seen_by(n_outputs), omega[driven]) * acting[index]
    return scipy.fft.irfft(answer, n=torque.shape[1], axis=2)
