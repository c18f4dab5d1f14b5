"""Define and simulate the year of the trial machine: its measurements, and what people did.

The year ends when the trial is asked for. Everything else is the same each time: the story, the moves, the noise.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from enum import StrEnum
from functools import cache
from itertools import count
from pathlib import Path
from typing import Final
from zlib import crc32

import numpy as np

from monitor_core.models import DriveConditions, DriveModel
from monitor_core.recording import Window

#: One measurement every second day; more would say the same, and take longer to simulate.
EVERY: Final = timedelta(days=2)
N_MEASUREMENTS: Final = 183
#: Preload that the axis was put into service with. [N]
COMMISSIONED: Final = 300.0
#: Measurements that are simulated, sent and reported together.
_TOGETHER: Final = 8

#: The story, in days since the first measurement.
_PAYLOAD_DAYS: Final = (90, 120)
_PAYLOAD: Final = 9.0  # [kg]
_LOOSE_DAYS: Final = (150, 164)
_LOOSE: Final = 238.0  # [N]
_SEEN_DAY: Final = 158
_LUBRICATED_DAY: Final = 240
_WEAR_FROM: Final = 322
_WEAR: Final = 1.5  # [N a day]
#: On these days the accelerometer was not plugged in.
_DEAD_DAYS: Final = (60, 262)


class Action(StrEnum):
    """What people did after some measurements."""

    CALIBRATE = "calibrate"
    SEE_ALARM = "see the alarm"
    REPAIR = "repair, and clear the alarm"
    LUBRICATE = "lubricate"


@dataclass(frozen=True, slots=True)
class Reading:
    """What a measurement is taken at."""

    name: str
    at: datetime
    position: float  # of the table from the fixed bearing [m]
    preload: float  # in truth [N]
    payload: float = 0.0  # [kg]
    temperature: float = 21.0  # [°C]
    preload_is_known: bool = False  # set on purpose, by a load cell
    sensor_is_dead: bool = False


@dataclass(frozen=True, slots=True)
class Chapter:
    """Measurements that follow each other, and what was done after them."""

    readings: tuple[Reading, ...]
    action: Action | None = None

    @property
    def ended_at(self) -> datetime:
        """When its last measurement was taken."""
        return self.readings[-1].at


def story(ends_at: datetime) -> tuple[Chapter, ...]:
    """Return the year that ends at a moment."""
    rng = np.random.default_rng(2018)
    year = tuple(_year(ends_at, rng))
    *earlier, last = _calibration(year[0].at - timedelta(days=1))
    chapters = [*map(Chapter, earlier), Chapter(last, Action.CALIBRATE)]
    actions = {_SEEN_DAY: Action.SEE_ALARM, _LOOSE_DAYS[1] - 2: Action.REPAIR, _LUBRICATED_DAY: Action.LUBRICATE}
    began: list[Reading] = []
    for number, reading in enumerate(year):
        began.append(reading)
        action = actions.get(number * EVERY.days)
        if action is not None or len(began) == _TOGETHER or reading is year[-1]:
            chapters.append(Chapter(tuple(began), action))
            began = []
    return tuple(chapters)


def sister_story(ends_at: datetime) -> tuple[Chapter, ...]:
    """Return the year of the other axis of the machine, which is well: it is measured every eighth day."""
    rng = np.random.default_rng(2019)
    readings = [
        replace(reading, preload=COMMISSIONED - 2.0 + float(rng.normal(0.0, 1.5)), payload=0.0, sensor_is_dead=False)
        for reading in _year(ends_at, rng)
    ][::4]
    return tuple(Chapter(tuple(readings[begin : begin + _TOGETHER])) for begin in range(0, len(readings), _TOGETHER))


def _calibration(from_: datetime) -> list[tuple[Reading, ...]]:
    """Return positions at each of some preloads set on purpose, then with a payload, then at other temperatures."""
    settings = [
        *([(x, preload, 0.0, 21.0) for x in (0.2, 0.35, 0.5, 0.65, 0.8)] for preload in (150.0, 230.0, 310.0, 390.0)),
        [(x, COMMISSIONED, payload, 21.0) for payload in (8.0, 10.0) for x in (0.3, 0.5, 0.7)],
        [(x, COMMISSIONED, 0.0, temperature) for temperature in (14.0, 28.0) for x in (0.35, 0.65)],
    ]
    number = count()
    return [
        tuple(
            Reading(
                f"calibration-{(n := next(number)):02d}", from_ + n * timedelta(minutes=10),
                *setting, preload_is_known=True,
            )
            for setting in together
        )
        for together in settings
    ]  # fmt: skip


def _year(ends_at: datetime, rng: np.random.Generator) -> Iterator[Reading]:
    for number in range(N_MEASUREMENTS):
        day = number * EVERY.days
        season = 5.0 * math.sin(2.0 * math.pi * (day - 100.0) / 365.0)
        yield Reading(
            name=f"day-{day:03d}",
            at=ends_at - (N_MEASUREMENTS - 1 - number) * EVERY,
            position=round(float(rng.uniform(0.3, 0.7)), 3),
            preload=_preload(day) + float(rng.normal(0.0, 1.5)),
            payload=_PAYLOAD if _PAYLOAD_DAYS[0] <= day < _PAYLOAD_DAYS[1] else 0.0,
            temperature=round(21.0 + season + float(rng.normal(0.0, 0.8)), 1),
            sensor_is_dead=day in _DEAD_DAYS,
        )


def _preload(day: int) -> float:
    if _LOOSE_DAYS[0] <= day < _LOOSE_DAYS[1]:
        return _LOOSE
    return COMMISSIONED - _WEAR * max(0, day - _WEAR_FROM)


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
    from monitor_core.recordings.model_file import parse_model  # noqa: PLC0415  # a start pays for no analysis

    return replace(parse_model(machine_text(), MACHINE.name), effects=_SOFTENING).build()


def measurements_of(readings: Sequence[Reading]) -> Iterator[list[Window]]:
    """Yield the windows of each reading; the same ones whenever they are asked for."""
    from monitor_core.models.generator import (  # noqa: PLC0415
        GuideFriction,
        RampMoves,
        SimulationSettings,
        simulate_measurements,
    )

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
