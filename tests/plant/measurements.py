"""Measurements on the plant: from conditions to recorded arrays and to the product's windows."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from monitor_core import recording
from tests.plant.chain import Condition
from tests.plant.motion import MoveProgram, draw_reference
from tests.plant.sensors import ACCELERATION, ENCODER, anti_alias, convert, filter_margin
from tests.plant.simulation import Plant, simulate
from tests.plant.surroundings import Surroundings

#: Rate at which the plant runs, and of which the recorded rate is a part. [Hz]
INTERNAL_RATE = 8192
#: Simulated before each window, with one move in it. [s]
LEAD_IN = 0.3
#: Windows that advance together: enough to share the cost of a step, few enough for the memory.
BATCH = 320


@dataclass(frozen=True, slots=True)
class Scatter:
    """What differs between two measurements of the same axis that are tagged alike: independent and normal.

    Preload and friction really vary; position and temperature are where the tags err. Standard deviations.
    """

    preload: float = 1.5  # day to day, about the level that wear leaves [N]
    position: float = 0.2e-3  # homing and mounting of the encoder [m]
    temperature: float = 0.3  # the sensor sits on the bearing, not in the screw [K]
    friction: float = 0.05  # lubrication, relative [-]

    def draw(self, tagged: Condition, rng: np.random.Generator) -> Condition:
        """Return the true condition behind a tagged one."""
        preload, position, temperature, friction = rng.standard_normal(4)
        return replace(
            tagged,
            preload=tagged.preload + self.preload * preload,
            position=tagged.position + self.position * position,
            temperature=tagged.temperature + self.temperature * temperature,
            friction_scale=tagged.friction_scale * (1.0 + self.friction * friction),
        )


#: Every tag is true. The recorder knows the preload of a calibration, so that only the tags and the friction scatter.
NO_SCATTER = Scatter(0.0, 0.0, 0.0, 0.0)
CALIBRATION_SCATTER = Scatter(preload=0.0)


@dataclass(frozen=True, slots=True)
class Acquisition:
    """How a measurement is taken."""

    n_windows: int = 15
    duration: float = 1.0  # of a window [s]
    sample_rate: int = 1024  # [Hz]
    drive_torque: bool = False  # record the motor's torque instead of the torque sensor
    program: MoveProgram = field(default_factory=MoveProgram)
    knock: float = 0.0  # peak of a half sine of 2 ms on the table, once in each window; no torque tells of it [N]
    surroundings: Surroundings = field(default_factory=Surroundings)


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """Sampled channels, shape (n_measurements, n_windows, n_samples)."""

    excitation: NDArray[np.float32]  # torque [N·m]
    response: NDArray[np.float32]  # acceleration of the nut [m/s²]
    position: NDArray[np.float32]  # encoder, from the fixed bearing [m]

    @property
    def span(self) -> NDArray[np.float64]:
        """Travel in each window, shape (n_measurements, n_windows) [m]."""
        travel: NDArray[np.float64] = np.ptp(self.position.astype(np.float64), axis=2)
        return travel


def simulate_measurements(
    tagged: Sequence[Condition],
    rng: np.random.Generator,
    acquisition: Acquisition | None = None,
    *,
    scatter: Scatter = NO_SCATTER,
    plant: Plant | None = None,
    true: Sequence[Condition] | None = None,
) -> Recorded:
    """Simulate one measurement for each condition and return what the acquisition records.

    Parameters
    ----------
    tagged : sequence of Condition
        What the measurements will be tagged with.
    rng : numpy.random.Generator
        Source of moves, noise and scatter.
    acquisition : Acquisition, optional
        By default 15 windows of 1 s at 1024 Hz.
    scatter : Scatter
        How the true conditions differ from the tags.
    plant : Plant, optional
        By default the machine of the recorded sessions.
    true : sequence of Condition, optional
        What the axis really is at, where the tags are wrong; by default what they say. ``scatter`` comes on top.

    Returns
    -------
    Recorded
        Excitation, response and position, shape (n_measurements, n_windows, n_samples).
    """
    acquisition, plant = acquisition or Acquisition(), plant or Plant()
    drawn = [scatter.draw(c, rng) for c in true or tagged]
    per_batch = max(1, BATCH // acquisition.n_windows)
    batches = [
        _simulate_batch(tagged[i : i + per_batch], drawn[i : i + per_batch], rng, acquisition, plant)
        for i in range(0, len(drawn), per_batch)
    ]
    return Recorded(*(np.concatenate([getattr(b, name) for b in batches]) for name in Recorded.__dataclass_fields__))


def _simulate_batch(
    tagged: Sequence[Condition],
    true: list[Condition],
    rng: np.random.Generator,
    acquisition: Acquisition,
    plant: Plant,
) -> Recorded:
    factor, rest = divmod(INTERNAL_RATE, acquisition.sample_rate)
    if rest:
        raise ValueError(f"sample_rate must divide {INTERNAL_RATE} Hz; got {acquisition.sample_rate} Hz")
    margin = filter_margin(factor)
    lead_in, n_window = round(LEAD_IN * INTERNAL_RATE), round(acquisition.duration * INTERNAL_RATE)
    time = (np.arange(lead_in + n_window + margin) - lead_in) / INTERNAL_RATE
    shape = (len(true), acquisition.n_windows)
    reference = draw_reference(acquisition.program, rng, shape, time, acquisition.duration)
    table_force = None
    if acquisition.knock:
        since = time[:, None, None] - rng.uniform(0.0, acquisition.duration, shape)
        table_force = acquisition.knock * np.sin(np.pi * since / 2e-3) * ((since >= 0.0) & (since < 2e-3))
    around = acquisition.surroundings
    if around.floor_force:
        shaking = around.floor(rng, (time.size, *shape), INTERNAL_RATE)
        table_force = shaking if table_force is None else table_force + shaking
    motion = simulate(plant, true, reference, 1.0 / INTERNAL_RATE, table_force)
    acceleration = motion.nut_acceleration + around.second_mode_acceleration(motion.sensor_torque, INTERNAL_RATE)
    if around.coloured_noise:
        acceleration += around.colour(rng, acceleration.shape, INTERNAL_RATE)
    recorded = []
    for channel, sensor in (
        (motion.motor_torque if acquisition.drive_torque else motion.sensor_torque, around.torque_sensor),
        (acceleration, ACCELERATION),
        (motion.motor_travel + np.array([c.position for c in tagged])[:, None], ENCODER),
    ):
        samples = anti_alias(channel[lead_in - margin :], factor)
        recorded.append(convert(np.ascontiguousarray(np.moveaxis(samples, 0, -1)), sensor, rng))
    return Recorded(*recorded)


def to_windows(
    recorded: Recorded,
    tagged: Sequence[Condition],
    started_at: Sequence[datetime],
    acquisition: Acquisition | None = None,
    *,
    preload_known: bool = False,
) -> tuple[recording.Window, ...]:
    """Turn measurements into the product's windows, named ``m0000`` onwards, one window every two seconds."""
    acquisition = acquisition or Acquisition()
    source = recording.ExcitationSource.DRIVE if acquisition.drive_torque else recording.ExcitationSource.SENSOR
    spans = recorded.span
    return tuple(
        recording.Window(
            excitation=recorded.excitation[m, w],
            response=recorded.response[m, w],
            sample_rate=float(acquisition.sample_rate),
            started_at=begin + timedelta(seconds=2.0 * acquisition.duration * w),
            conditions=recording.Conditions(
                position=condition.position,
                payload_mass=condition.payload,
                temperature=condition.temperature,
                preload=condition.preload if preload_known else None,
            ),
            measurement=f"m{m:04d}",
            excitation_source=source,
            position_span=float(spans[m, w]),
            position_trace=recorded.position[m, w].astype(np.float64),
        )
        for m, (condition, begin) in enumerate(zip(tagged, started_at, strict=True))
        for w in range(acquisition.n_windows)
    )
