"""Record a drive of transmission lines whose control follows a motion: a session, and all that its parts do meanwhile.

One uninterrupted run; its windows follow each other without pause. All channels are averaged alike, the speed as steps
of the angle, and pass one anti-aliasing filter, so that responses between them are those of the drive.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from datetime import datetime, timedelta

import numpy as np
import scipy

from monitor_core.arrays import FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.generator.session import SimulationSettings, sensed
from monitor_core.models.generator.stated import StatedSimulation
from monitor_core.models.protocol import DriveConditions, DriveModel, MotorEnd
from monitor_core.models.published.transmission_line import DriveRun, TransmissionLineModel, discretise
from monitor_core.recording import Conditions, ExcitationSource, MotionProfile, Window

#: Longest motion, in steps of the lines: some minutes.
MOST_STEPS = 2**26
_STEPS_AT_ONCE = 2**14  # what stays in the cache
#: The lines are averaged to about so many values in a sample, which the filter then takes to one.
_VALUES_IN_A_SAMPLE = 8.0
_CUTOFF = 0.4  # of the sampling rate [-]


@dataclass(frozen=True, slots=True, eq=False)
class RecordedMotion:
    """What a drive does while its control follows a motion, each of shape (n_samples,)."""

    time: FloatArray  # [s]
    commanded_speed: FloatArray  # of the motor [rad/s]
    speed: FloatArray  # of the motor [rad/s]
    force_at_table: FloatArray  # of cutting [N]
    acceleration: FloatArray  # of the table [m/s²]
    travel: FloatArray  # of the table [m]
    motor_torque: FloatArray  # [N·m]
    screw_torque: FloatArray  # behind the coupling [N·m]
    nut_torque: FloatArray  # [N·m]
    bearing_force: FloatArray  # on the mounting of the fixed bearing [N]
    far_bearing_force: FloatArray  # [N]


def simulate_motion(
    model: DriveModel,
    conditions: DriveConditions,
    profile: MotionProfile,
    stated: StatedSimulation,
    settings: SimulationSettings,
    *,
    rng: np.random.Generator,
) -> RecordedMotion:
    """Run a drive in its speed loop along a motion, from rest, the nut moving with the commanded travel.

    ``OutsideValidityError`` if the model is none of transmission lines, states no speed loop, or is asked for a motion
    that takes its nut off the screw, or lasts too long or too short; or if the loop does not hold the table there.
    """
    if not isinstance(model, TransmissionLineModel):
        raise OutsideValidityError("a motion is followed by a model of the family transmission-line, without effects")
    if stated.control is None:
        raise OutsideValidityError("a motion is followed by a drive in its loop; state [simulation.speed-loop]")
    grid, rate = model.grid, settings.sample_rate
    step, length = grid.time_step, model.parameters.screw_length
    if rate * step > 1.0:
        raise OutsideValidityError(f"sample_rate must not exceed that of the lines, {1.0 / step:g} Hz; got {rate:g} Hz")
    averaged = max(1, int(1.0 / (_VALUES_IN_A_SAMPLE * rate * step)))
    n_averages = int(profile.duration / (step * averaged))
    if min(n_averages, profile.duration * rate) < 4.0:
        raise OutsideValidityError(f"a motion must last for four samples, {4.0 / rate:g} s; got {profile.duration:g} s")
    if n_averages * averaged > MOST_STEPS:
        raise OutsideValidityError(
            f"a motion must not exceed {MOST_STEPS * step:.0f} s with this model; got {profile.duration:g} s"
        )
    ratio, known = model.parameters.transmission_ratio, profile.time - profile.time[0]
    cutting = np.zeros_like(known) if profile.force is None else profile.force
    follow = scipy.interpolate.PchipInterpolator(known, profile.values)
    speed, travel = (follow, follow.antiderivative()) if profile.is_speed else (follow.derivative(), follow)
    random = settings.random_speed * rng.standard_normal(int(profile.duration * rate) + 2)
    start = float(travel(0.0))

    def run() -> Iterator[FloatArray]:
        drive = DriveRun(
            discretise(model.parameters, grid, conditions, MotorEnd.FREE, stated.friction, control=stated.control),
            grid,
            length,
        )
        turned = 0.0
        at_once = max(1, _STEPS_AT_ONCE // averaged)
        for first in range(0, n_averages, at_once):
            n = min(at_once, n_averages - first) * averaged
            time = (first * averaged + np.arange(n)) * step
            commanded = (speed(time) + random[(time * rate).astype(np.intp)]) / ratio
            force = np.interp(time, known, cutting)
            position = conditions.position + travel(time) - start
            acceleration, travelled, angle, *others = drive.advance(np.zeros(n), commanded, force, position)
            table = conditions.position + travelled
            off = ~((table >= 0.0) & (table <= length))
            if np.any(off):
                raise OutsideValidityError(
                    "the speed loop is unstable or does not follow the motion: "
                    f"expected the table within 0 and {length:g} m, got {table[off][0]:g} m at {time[off][0]:g} s"
                )
            turning = np.diff(angle, prepend=turned) / step
            turned = angle[-1]
            channels = np.array([commanded, turning, force, acceleration, travelled, *others])
            yield channels.reshape(len(channels), -1, averaged).mean(axis=2)

    values = np.concatenate(list(run()), axis=1)
    every = averaged * step
    smooth = scipy.signal.butter(6, 2.0 * _CUTOFF * rate * every, output="sos")
    at = np.arange(int(n_averages * every * rate)) / rate
    place = (np.arange(n_averages) + 0.5 - 0.5 / averaged) * every
    # between two values a straight line takes away a hundredth at the cut-off, a cubic nothing that counts
    channels = scipy.interpolate.make_interp_spline(place, scipy.signal.sosfilt(smooth, values, axis=1), axis=1)
    commanded, _, *others = channels(at)
    return RecordedMotion(at, commanded, channels(at + 0.5 * step)[1], *others)  # a speed is half a step old


def windows_of_motion(
    motion: RecordedMotion,
    conditions: DriveConditions,
    settings: SimulationSettings,
    *,
    measurement: str,
    starts: datetime,
    rng: np.random.Generator,
) -> tuple[Window, ...]:
    """Return the motion as sensors record it, in windows; of the drive's torque the commanded speed is its reference.

    ``OutsideValidityError`` if the motion is shorter than a window, or a sample does not fit into single precision.
    """
    n = settings.n_samples
    if motion.time.size < n:
        raise OutsideValidityError(
            f"a motion must last for a window of {settings.window_duration:g} s; "
            f"got {motion.time.size / settings.sample_rate:g} s"
        )
    of_drive = settings.excitation_source is ExcitationSource.DRIVE
    acts = motion.motor_torque if of_drive else motion.screw_torque
    torque, acceleration = sensed(acts, motion.acceleration, settings, rng)
    position = conditions.position + motion.travel
    windows = []
    for number in range(motion.time.size // n):
        part = slice(number * n, (number + 1) * n)
        trace = position[part]
        stated = Conditions(
            round(0.5 * float(trace.max() + trace.min()), 6),
            conditions.payload_mass,
            settings.reference_temperature + conditions.temperature_deviation,
            conditions.preload,
        )
        windows.append(
            Window(
                excitation=torque[part],
                response=acceleration[part],
                sample_rate=settings.sample_rate,
                started_at=starts + timedelta(seconds=number * n / settings.sample_rate),
                conditions=stated,
                measurement=measurement,
                excitation_source=settings.excitation_source,
                position_span=float(np.ptp(trace)),
                position_trace=trace,
                reference=motion.commanded_speed[part] if of_drive else None,
            )
        )
    return tuple(windows)


def channels_of_motion(motion: RecordedMotion) -> dict[str, FloatArray]:
    """Return the channels by their names in a file, which end with the unit."""
    units = ("s", "rad_per_s", "rad_per_s", "n", "m_per_s2", "m", "nm", "nm", "nm", "n", "n")
    return {f"{item.name}_{unit}": getattr(motion, item.name) for item, unit in zip(fields(motion), units, strict=True)}
