"""Noisy receptances of a known axis from finite elements, which share nothing with the model that is fitted."""

from dataclasses import replace

import numpy as np

from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.models.protocol import DriveConditions, MotorEnd
from monitor_core.models.published.receptance import ReceptanceParameters
from tests.models.finite_elements import Assembly
from tests.models.test_receptance import axis_of

#: 850 lines from 8 to 1000 Hz, closer where the modes are closer together on a logarithmic scale.
FREQUENCY = np.concatenate([np.linspace(8, 60, 150), np.linspace(61, 200, 200), np.linspace(202, 1000, 500)])
#: Positions [m], each with its elements before and behind the nut: all of 5 mm, off by 4e-6 of a frequency.
MESHES = {0.6: (120, 400), 1.0: (200, 320), 1.6: (320, 200)}


def receptances(axis: ReceptanceParameters) -> dict[float, np.ndarray]:
    """Exact receptance of the table at each position, shape (850,) [m/N]."""
    assemblies = {x: Assembly(axis_of(axis, MotorEnd.FREE), *mesh, x) for x, mesh in MESHES.items()}
    return {x: assembly.response(2 * np.pi * FREQUENCY, assembly.table)[:, 0] for x, assembly in assemblies.items()}


def noisy(
    exact: dict[float, np.ndarray], rng: np.random.Generator, noise: float = 0.05
) -> tuple[FrequencyResponseObservation, ...]:
    """Add circular noise whose rms is a share of |H|."""
    observations = []
    for position, response in exact.items():
        deviation = noise * np.abs(response) / np.sqrt(2)
        scatter = rng.standard_normal(FREQUENCY.size) + 1j * rng.standard_normal(FREQUENCY.size)
        observations.append(
            FrequencyResponseObservation(
                DriveConditions(position), FREQUENCY, response + deviation * scatter, deviation
            )
        )
    return tuple(observations)


def factored(
    observations: tuple[FrequencyResponseObservation, ...],
    rng: np.random.Generator,
    gain: float = 0.02,
    phase: float = np.radians(1.2),
) -> tuple[FrequencyResponseObservation, ...]:
    """Give each response a gain and a phase of its own, of these standard deviations [-], [rad]."""
    factors = [(1.0 + gain * rng.standard_normal()) * np.exp(1j * phase * rng.standard_normal()) for _ in observations]
    return tuple(
        replace(each, response=factor * each.response, standard_deviation=abs(factor) * each.standard_deviation)
        for each, factor in zip(observations, factors, strict=True)
    )


def picked_peak(observation: FrequencyResponseObservation, near: float) -> tuple[float, float]:
    """Read frequency and height off the highest line within 5 % of a frequency, by a parabola through log|H|."""
    level = np.log(np.abs(observation.response))
    inside = np.flatnonzero(np.abs(observation.frequency / near - 1) < 0.05)
    k = inside[1:-1][level[inside[1:-1]].argmax()]
    below, top, above = level[k - 1 : k + 2]
    bend = below - 2 * top + above
    offset = float(np.clip(0.5 * (below - above) / bend, -0.5, 0.5)) if bend < 0 else 0.0
    spacing = observation.frequency[k + 1] - observation.frequency[k]
    return float(observation.frequency[k] + offset * spacing), float(np.exp(top - 0.25 * (below - above) * offset))
