"""Simulate the measurements of the trial: short windows of the machine in ``machine.toml``, with friction and noise."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import timedelta
from functools import cache
from pathlib import Path
from typing import Final
from zlib import crc32

import numpy as np

from monitor_core.models import DriveConditions, DriveModel
from monitor_core.models.generator import GuideFriction, RampMoves, SimulationSettings, simulate_measurements
from monitor_core.recording import Window
from monitor_core.recordings.model_file import parse_model
from service.operations.trial.story import Reading

MACHINE: Final = Path(__file__).parent / "machine.toml"
#: The first mode is looked for here. [Hz]
BAND: Final = (140.0, 230.0)
SAMPLE_RATE: Final = 1400.0  # [Hz]
N_WINDOWS: Final = 8
#: Half a second: the mode has rung down by then, and the trial is there in seconds.
_SECONDS: Final = 0.5
#: Long enough at one speed for the drag torque, short enough for two moves in a window. [s]
_CRUISES: Final = (0.07, 0.085)
#: What the maker's description does not say: the drive softens as it warms.
_SOFTENING: Final = {"thermal-stiffness": {"relative_change_per_k": -0.00029}}
#: Friction of the guides, and what the nut adds to it by its preload. [N], [N/N]
_GUIDES, _NUT = 3.0, 0.02
#: What is stated of position and temperature scatters about the truth. [m], [K]
_POSITION_SCATTER, _TEMPERATURE_SCATTER = 0.2e-3, 0.3


def machine_text() -> str:
    """Return the description of the machine by its maker."""
    return MACHINE.read_text(encoding="utf-8")


@cache
def _machine() -> DriveModel:
    return replace(parse_model(machine_text(), MACHINE.name), effects=_SOFTENING).build()


def measurements_of(readings: Sequence[Reading]) -> Iterator[list[Window]]:
    """Yield the windows of each reading; the same ones whenever they are asked for."""
    mean = float(np.mean([reading.preload for reading in readings]))
    settings = SimulationSettings(
        windows_per_measurement=N_WINDOWS,
        window_duration=_SECONDS,
        sample_rate=SAMPLE_RATE,
        moves=RampMoves(cruise=_CRUISES),
        friction=GuideFriction(coulomb=_GUIDES + _NUT * mean, viscous=60.0),
        torque_noise=0.02,
        acceleration_noise=0.2,
    )
    conditions = [
        DriveConditions(
            reading.position, reading.preload, reading.payload, reading.temperature - settings.reference_temperature
        )
        for reading in readings
    ]
    rng = np.random.default_rng(crc32(readings[0].name.encode()))
    simulated = simulate_measurements(_machine(), conditions, settings, started_at=readings[0].at, rng=rng)
    for reading, windows in zip(readings, simulated, strict=True):
        yield _as_recorded(reading, windows, rng)


def _as_recorded(reading: Reading, windows: Sequence[Window], rng: np.random.Generator) -> list[Window]:
    """Return windows at their time, with what somebody would state of them."""
    stated = replace(
        windows[0].conditions,
        position=reading.position + float(rng.normal(0.0, _POSITION_SCATTER)),
        temperature=reading.temperature + float(rng.normal(0.0, _TEMPERATURE_SCATTER)),
        preload=reading.preload if reading.preload_is_known else None,
    )
    return [
        replace(
            window,
            started_at=reading.at + number * timedelta(seconds=2.0 * _SECONDS),
            measurement=reading.name,
            conditions=stated,
            response=np.zeros_like(window.response) if reading.sensor_is_dead else window.response,
        )
        for number, window in enumerate(windows)
    ]
