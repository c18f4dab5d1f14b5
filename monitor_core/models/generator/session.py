"""Simulate a recorded session of a drive model: torque at the motor end, acceleration and position of the table.

What modal superposition leaves out of a response is added to it: damping between modes, hysteresis, higher modes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from itertools import product

import numpy as np
import numpy.typing as npt
import scipy

from monitor_core.arrays import ComplexArray, FloatArray
from monitor_core.errors import OutsideValidityError
from monitor_core.models.generator.moves import RampMoves, Reference, draw_reference
from monitor_core.models.generator.scan import GuideFriction, Motion, advance_modes, modes_below
from monitor_core.models.protocol import (
    DriveConditions,
    DriveModel,
    ExcitationPoint,
    MotorEnd,
    NormalModes,
    ResponsePoint,
)
from monitor_core.recording import Conditions, ExcitationSource, Session, Window

#: A record continued by as many zeros: what still rings after twice its length would come around to its beginning.
_LENGTHS = 2


def acceleration_beyond_modes(
    model: DriveModel,
    conditions: DriveConditions,
    excitation: ExcitationPoint,  # where the torque acts
    *,
    modes: NormalModes,  # that were advanced; of those above half the sampling rate there is no motion
    torque: FloatArray,  # from rest to rest, shape (n_samples, n_windows) [N·m]
    sample_rate: float,  # [Hz]
) -> FloatArray:
    r"""Return what is missing from the acceleration of advanced modes for it to be the model's own, in m/s².

    .. math:: a(t) = \mathcal{F}^{-1}\left\{ \left[ H(f) + \sum_n \frac{\omega^2 \varphi_n \phi_n}
        {\omega_n^2 - \omega^2 + 2j \zeta_n \omega_n \omega} \right] T(f) \right\}

    with the model's torque accelerance H and the shapes φ where the torque acts and at the table. At rest both are the
    motion of the rigid drive. Shape as the torque.
    """
    n_samples = torque.shape[0]
    frequency = scipy.fft.rfftfreq(_LENGTHS * n_samples, 1.0 / sample_rate)
    asked = model.frequency_response(
        frequency[1:], conditions, excitation=excitation, response=ResponsePoint.ACCELERATION_AT_TABLE
    )
    missing = np.zeros(frequency.size, dtype=np.complex128)
    missing[1:] = asked.response - _of_modes(modes_below(modes, 0.5 * sample_rate), frequency[1:])
    spectrum = missing[:, None] * scipy.fft.rfft(torque, _LENGTHS * n_samples, axis=0)
    return np.asarray(scipy.fft.irfft(spectrum, _LENGTHS * n_samples, axis=0)[:n_samples])


def _of_modes(modes: NormalModes, frequency: FloatArray) -> ComplexArray:
    """Return the torque accelerance by modal superposition, shape (n_frequencies,)."""
    omega, own = 2.0 * np.pi * frequency, 2.0 * np.pi * modes.frequency[:, None]
    shapes = (modes.angle_at_motor * modes.displacement_at_table)[:, None]
    stiffness = own**2 - omega**2 + 2j * modes.damping_ratio[:, None] * own * omega
    return np.asarray(-(omega**2) * np.sum(shapes / stiffness, axis=0))


#: What a torque leaves free to move: measured behind the coupling it is given there, and hides the motor.
MOTOR_END = {ExcitationSource.SENSOR: MotorEnd.PRESCRIBED, ExcitationSource.DRIVE: MotorEnd.FREE}
#: Where it acts.
EXCITED = {
    ExcitationSource.SENSOR: ExcitationPoint.TORQUE_AT_SCREW,
    ExcitationSource.DRIVE: ExcitationPoint.TORQUE_AT_MOTOR,
}
#: Windows that advance together hold about so many samples: more save no time and take memory.
BATCH_SAMPLES = 2**22
#: A window begins so many window lengths after the one before it: the table comes to rest in between.
WINDOW_SPACING = 2.0
#: Bound of a measurement: advancing it takes some 130 bytes a sample, 2.2 GB. An hour in one window has 2**23.8.
MOST_SAMPLES = 2**24
_FEWEST_SAMPLES_PER_RAMP = 4.0


@dataclass(frozen=True, slots=True)
class SimulationSettings:
    """How a simulated session is taken."""

    windows_per_measurement: int = 15
    window_duration: float = 1.0  # [s]
    sample_rate: float = 4096.0  # [Hz]
    excitation_source: ExcitationSource = ExcitationSource.SENSOR
    moves: RampMoves = field(default_factory=RampMoves)
    friction: GuideFriction = field(default_factory=GuideFriction)
    torque_noise: float = 0.005  # standard deviation of white noise [N·m]
    acceleration_noise: float = 0.05  # the same [m/s²]
    random_speed: float = 0.0  # added to a motion that a control follows, white up to half the rate [m/s rms]
    encoder_resolution: float = 1e-7  # travel of one count; 0: none [m]
    reference_temperature: float = 20.0  # at which the temperature deviation is zero [°C]

    def __post_init__(self) -> None:
        if self.windows_per_measurement < 1:
            raise OutsideValidityError(
                f"windows_per_measurement must be at least 1; got {self.windows_per_measurement}"
            )
        for name, unit in (("window_duration", "s"), ("sample_rate", "Hz")):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise OutsideValidityError(f"{name} must be positive; got {value} {unit}")
        for name, unit in (
            ("torque_noise", "N·m"), ("acceleration_noise", "m/s²"), ("random_speed", "m/s"),
            ("encoder_resolution", "m"),
        ):  # fmt: skip
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise OutsideValidityError(f"{name} must not be negative; got {value} {unit}")
        least = _FEWEST_SAMPLES_PER_RAMP / self.moves.ramp[0]
        if self.sample_rate < least:
            raise OutsideValidityError(
                f"a ramp of {self.moves.ramp[0]:g} s needs a sample_rate of at least {least:g} Hz; "
                f"got {self.sample_rate:g} Hz"
            )
        samples = self.windows_per_measurement * self.window_duration * self.sample_rate
        if samples > MOST_SAMPLES:
            raise OutsideValidityError(
                f"a measurement must not exceed {MOST_SAMPLES:,} samples; {self.windows_per_measurement} x "
                f"{self.window_duration:g} s at {self.sample_rate:g} Hz are {samples:.3g}; take fewer or shorter ones"
            )

    @property
    def n_samples(self) -> int:
        """Samples in a window."""
        return round(self.window_duration * self.sample_rate)


def condition_grid(
    positions: Sequence[float],
    preloads: Sequence[float | None] = (None,),
    payload_masses: Sequence[float] = (0.0,),
    temperature_deviations: Sequence[float] = (0.0,),
) -> tuple[DriveConditions, ...]:
    """Return every combination: positions [m] run fastest, then preloads [N], payloads [kg], temperatures [K]."""
    return tuple(
        DriveConditions(position, preload, payload, deviation)
        for deviation, payload, preload, position in product(
            temperature_deviations, payload_masses, preloads, positions
        )
    )


def simulate_session(
    model: DriveModel,
    conditions: Sequence[DriveConditions],
    settings: SimulationSettings,
    *,
    axis_id: str,
    started_at: datetime,
    rng: np.random.Generator,
) -> Session:
    """Record one measurement of a model under each of some conditions.

    The table goes out and back in each window, between rests. A window's modes are those at its condition: travel of
    some millimetres moves them by less than the friction does. To the torque the table answers as the model's frequency
    response says, to friction by its normal modes below half the sampling rate.

    There is one condition for each measurement, in time order; the first window starts at ``started_at``, with a time
    zone. Moves and noise come from ``rng``, each measurement with a stream of its own, so that it does not depend on
    the others; the same arguments give the same session. ``OutsideValidityError`` if the model refuses a condition or
    has no rigid-body mode, the moves do not fit into the windows or do not overcome the friction, or a sample does not
    fit into single precision.

    Examples
    --------
    What is recorded of the axis of Nguyen et al. (2018) is judged to be what it was made of: its natural frequency.

    >>> from datetime import UTC, datetime
    >>> from pathlib import Path
    >>> import numpy as np
    >>> import monitor_core as mc
    >>> from monitor_core import recordings
    >>> from monitor_core.models.generator import SimulationSettings
    >>> axis = recordings.read_model_file(Path("replay_data/models/lumped.toml")).build()
    >>> at = mc.DriveConditions(0.5, preload=200.0)
    >>> start, rng = datetime(2026, 3, 2, tzinfo=UTC), np.random.default_rng(1)
    >>> session = mc.simulate_session(axis, [at], SimulationSettings(), axis_id="mill", started_at=start, rng=rng)
    >>> mc.Trend(mc.judge_session(session, mc.AxisSettings(search_band=(150.0, 300.0))))
    Trend of 1 measurements
      first 208.8 Hz (208.8 to 208.8) on 2026-03-02, last 208.8 Hz (208.8 to 208.8) on 2026-03-02
    >>> round(axis.natural_frequencies(at, mc.MotorEnd.PRESCRIBED)[1].frequency, 1)
    208.8
    """
    measurements = simulate_measurements(model, conditions, settings, started_at=started_at, rng=rng)
    return Session(axis_id, tuple(window for windows in measurements for window in windows))


def simulate_measurements(
    model: DriveModel,
    conditions: Sequence[DriveConditions],
    settings: SimulationSettings,
    *,
    started_at: datetime,
    rng: np.random.Generator,
) -> Iterator[tuple[Window, ...]]:
    """Yield the windows of one measurement after the other; see :func:`simulate_session`."""
    streams = rng.spawn(len(conditions))
    n = settings.windows_per_measurement
    at_once = max(1, BATCH_SAMPLES // (n * settings.n_samples))
    spacing = timedelta(seconds=WINDOW_SPACING * settings.window_duration)
    for first in range(0, len(conditions), at_once):
        batch = range(first, min(first + at_once, len(conditions)))
        references = [_draw(settings, streams[i]) for i in batch]
        modes = [model.normal_modes(conditions[i], MOTOR_END[settings.excitation_source]) for i in batch]
        for each in modes:
            _require_moves_that_overcome(settings.friction, settings.moves, each)
        stacked = Reference(*(np.stack([getattr(r, name) for r in references], axis=1) for name in Reference.__slots__))
        motion = advance_modes(modes, stacked, settings.friction, 1.0 / settings.sample_rate)
        for place, i in enumerate(batch):
            beyond = acceleration_beyond_modes(
                model, conditions[i], EXCITED[settings.excitation_source],
                modes=modes[place], torque=motion.torque[:, place], sample_rate=settings.sample_rate,
            )  # fmt: skip
            yield _record(
                motion, place, beyond, conditions[i], settings,
                reference=references[place], measurement=f"m{i:04d}", starts=started_at + i * n * spacing,
                rng=streams[i],
            )  # fmt: skip


def _require_moves_that_overcome(friction: GuideFriction, moves: RampMoves, modes: NormalModes) -> None:
    """Refuse friction above the force that accelerates the rigid drive at the peak of the gentlest ramp, 2 m v/t_r.

    Such moves no longer strike the drive: they first wind it up against the guides, and the table flies from there.
    """
    resistance = friction.coulomb + friction.viscous * moves.speed
    reflected = modes.displacement_at_table[:1] ** -2.0 if resistance else np.full(1, np.inf)
    strongest = 2.0 * reflected * moves.speed / moves.ramp[1]
    if np.any(resistance > strongest):
        raise OutsideValidityError(
            f"friction of the guides must not exceed the {strongest[0]:.4g} N with which a ramp of {moves.ramp[1]:g} s "
            f"accelerates the drive; got {resistance:g} N at {moves.speed:g} m/s"
        )


def _draw(settings: SimulationSettings, rng: np.random.Generator) -> Reference:
    time = np.arange(settings.n_samples + 1) / settings.sample_rate
    return draw_reference(settings.moves, time, settings.window_duration, rng, settings.windows_per_measurement)


def _record(
    motion: Motion,
    place: int,
    beyond: FloatArray,
    condition: DriveConditions,
    settings: SimulationSettings,
    *,
    reference: Reference,
    measurement: str,
    starts: datetime,
    rng: np.random.Generator,
) -> tuple[Window, ...]:
    """Return what the sensors and the linear encoder of the table make of one condition's motion."""
    torque, acceleration = sensed(motion.torque[:, place], motion.acceleration[:, place] + beyond, settings, rng)
    # the travel of the window is centred on the stated position
    travel = reference.travel
    centre = 0.5 * (travel.max(axis=0) + travel.min(axis=0))
    encoder = _counted(condition.position - centre + motion.travel[:, place], settings.encoder_resolution)
    spacing = timedelta(seconds=WINDOW_SPACING * settings.window_duration)
    stated = Conditions(
        position=condition.position,
        payload_mass=condition.payload_mass,
        temperature=settings.reference_temperature + condition.temperature_deviation,
        preload=condition.preload,
    )
    return tuple(
        Window(
            excitation=torque[:, w],
            response=acceleration[:, w],
            sample_rate=settings.sample_rate,
            started_at=starts + w * spacing,
            conditions=stated,
            measurement=measurement,
            excitation_source=settings.excitation_source,
            position_span=float(np.ptp(encoder[:, w])),
            position_trace=encoder[:, w],
        )
        for w in range(settings.windows_per_measurement)
    )


def sensed(
    torque: FloatArray, acceleration: FloatArray, settings: SimulationSettings, rng: np.random.Generator
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return torque and acceleration with the noise of their sensors, in single precision."""
    return (
        _single(_with_noise(torque, settings.torque_noise, rng), "torque", "N·m"),
        _single(_with_noise(acceleration, settings.acceleration_noise, rng), "acceleration", "m/s²"),
    )


def _with_noise(samples: FloatArray, noise: float, rng: np.random.Generator) -> FloatArray:
    with np.errstate(over="ignore"):  # what does not fit is refused with its unit
        return samples + noise * rng.standard_normal(samples.shape) if noise else samples


def _single(samples: FloatArray, name: str, unit: str) -> npt.NDArray[np.float32]:
    largest = float(np.finfo(np.float32).max)
    if not np.all(np.abs(samples) <= largest):
        raise OutsideValidityError(
            f"samples of the {name} must fit into single precision, up to {largest:.2g} {unit}; "
            f"got up to {np.max(np.abs(samples)):.2g} {unit}"
        )
    return samples.astype(np.float32)


def _counted(travel: FloatArray, resolution: float) -> FloatArray:
    counted: FloatArray = np.round(travel / resolution) * resolution if resolution else travel
    return counted
