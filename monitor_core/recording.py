"""Records of what was measured: windows, sessions, their conditions, and motions of a rigid axis (ISO 13374: DA)."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from typing import TypeVar

import numpy as np

from monitor_core.arrays import FloatArray, SampleArray, read_only, read_only_samples
from monitor_core.errors import InvalidWindowError, OutsideValidityError

Key = TypeVar("Key")


class ExcitationQuantity(StrEnum):
    """What drives the axis in a window."""

    TORQUE = "torque"  #: [N·m]
    FORCE = "force"  #: [N]
    CURRENT = "current"  #: of the motor, whose torque constant is not known [A]
    ACCELERATION = "acceleration"  #: as commanded [m/s²]

    @property
    def unit(self) -> str:
        """SI unit, as it is read."""
        return _EXCITATION_UNITS[self]

    @property
    def is_relative(self) -> bool:
        """Whether the response per excitation has no scale of a mass: modal mass and friction are then unknown."""
        return self in (ExcitationQuantity.CURRENT, ExcitationQuantity.ACCELERATION)


_EXCITATION_UNITS = {
    ExcitationQuantity.TORQUE: "N·m",
    ExcitationQuantity.FORCE: "N",
    ExcitationQuantity.CURRENT: "A",
    ExcitationQuantity.ACCELERATION: "m/s²",
}


class ExcitationSource(StrEnum):
    """Where the excitation was taken. A calibration holds for one source only (they see different poles)."""

    SENSOR = "sensor"
    DRIVE = "drive"  #: what the drive measures or estimates, as torque from current and torque constant
    DRIVE_BY_REFERENCE = "drive-by-reference"  #: of that, what follows a reference; of measurements, never of a window
    COMMANDED = "commanded"


class ResponseQuantity(StrEnum):
    """What answers the excitation in a window. A calibration holds for one quantity only."""

    ACCELERATION = "acceleration"  #: of the table [m/s²]
    VELOCITY = "velocity"  #: of the table [m/s]
    DISPLACEMENT = "displacement"  #: of the table, from any place [m]
    MOTOR_ANGLE = "motor-angle"  #: [rad]
    MOTOR_SPEED = "motor-speed"  #: [rad/s]
    RELATIVE_DISPLACEMENT = "relative-displacement"  #: motor angle × lead/2π − table [m]

    @property
    def unit(self) -> str:
        """SI unit, as it is read."""
        return _RESPONSE_UNITS[self]

    @property
    def derivatives(self) -> int:
        """How many times it is differentiated until it is an acceleration."""
        if self is ResponseQuantity.ACCELERATION:
            return 0
        return 1 if self in (ResponseQuantity.VELOCITY, ResponseQuantity.MOTOR_SPEED) else 2

    @property
    def is_of_motor(self) -> bool:
        """Whether it is the motor's own motion."""
        return self in (ResponseQuantity.MOTOR_ANGLE, ResponseQuantity.MOTOR_SPEED)


_RESPONSE_UNITS = {
    ResponseQuantity.ACCELERATION: "m/s²",
    ResponseQuantity.VELOCITY: "m/s",
    ResponseQuantity.DISPLACEMENT: "m",
    ResponseQuantity.MOTOR_ANGLE: "rad",
    ResponseQuantity.MOTOR_SPEED: "rad/s",
    ResponseQuantity.RELATIVE_DISPLACEMENT: "m",
}


class Direction(StrEnum):
    """Direction of travel during a window."""

    POSITIVE = "+"
    NEGATIVE = "-"
    BOTH = "both"


class RejectionReason(StrEnum):
    """Why a window or a measurement was refused. Stored and counted like any other outcome."""

    # of one window
    NOT_FINITE = "not-finite"
    CLIPPED = "clipped"
    DEAD_CHANNEL = "dead-channel"
    STUCK_CHANNEL = "stuck-channel"
    TOO_SHORT = "too-short"
    SLOW_LENGTH = "slow-length"
    SAMPLE_RATE_MISMATCH = "sample-rate-mismatch"
    LENGTH_MISMATCH = "length-mismatch"
    POSITION_WRAPS = "position-wraps"
    POSITION_SPAN_TOO_WIDE = "position-span-too-wide"
    LITTLE_EXCITATION = "little-excitation"
    OUTLYING_WINDOW = "outlying-window"
    POSITION_MISMATCH = "position-mismatch"
    CLOCK_AHEAD = "clock-ahead"
    TOO_LATE = "too-late"
    # of one measurement
    TOO_FEW_AVERAGES = "too-few-averages"
    NO_PEAK_IN_BAND = "no-peak-in-band"
    LOW_COHERENCE = "low-coherence"
    WRONG_PHASE = "wrong-phase"
    AMBIGUOUS_MODES = "ambiguous-modes"
    UNCERTAIN_FREQUENCY = "uncertain-frequency"
    FIT_FAILED = "fit-failed"
    EXCITATION_SOURCE_MISMATCH = "excitation-source-mismatch"
    NOT_CALIBRATED = "not-calibrated"
    OUTSIDE_CALIBRATION = "outside-calibration"
    MOVED_MASS_MISMATCH = "moved-mass-mismatch"
    DAMPING_MISMATCH = "damping-mismatch"
    WAVEFORM_DAMAGED = "waveform-damaged"


@dataclass(frozen=True, slots=True)
class Rejection:
    """A refusal: an outcome, not an exception."""

    reason: RejectionReason
    detail: str  # what was expected, what was got, with units


class DoubtReason(StrEnum):
    """What speaks against a number that is given all the same."""

    # of what windows state twice
    POSITION_CONTRADICTS_TRACE = "position-contradicts-trace"
    TRACE_CONTRADICTS_MOTION = "trace-contradicts-motion"
    RATE_CONTRADICTS_TIMES = "rate-contradicts-times"
    # of a measurement against its calibration, or its session
    DAMPING_CHANGED = "damping-changed"
    MASS_OR_MOUNTING_CHANGED = "mass-or-mounting-changed"
    MOVED_MASS_CHANGED = "moved-mass-changed"
    GAIN_CHANGED = "gain-changed"
    FRICTION_CHANGED = "friction-changed"
    EXCITATION_CHANGED = "excitation-changed"
    NOISE_CHANGED = "noise-changed"
    SECOND_MODE = "second-mode"
    PLACES_DISAGREE = "places-disagree"
    PRELOAD_RISEN = "preload-risen"


@dataclass(frozen=True, slots=True)
class Doubt:
    """A reason not to rely on a number, in words."""

    reason: DoubtReason
    detail: str  # what was expected, what was got, with units


@dataclass(frozen=True, slots=True)
class Conditions:
    """Influence quantities of a window or a measurement. ``None`` means: not stated."""

    position: float  # table position from the fixed bearing [m]
    payload_mass: float | None = None  # workpiece and fixture on the table [kg]
    temperature: float | None = None  # [°C]
    preload: float | None = None  # only where it was set on purpose, as in a calibration [N]

    def __post_init__(self) -> None:
        for name, unit in (("position", "m"), ("payload_mass", "kg"), ("temperature", "°C"), ("preload", "N")):
            value = getattr(self, name)
            if value is not None and not math.isfinite(value):
                raise InvalidWindowError(f"{name} must be finite; got {value} {unit}")
        if self.payload_mass is not None and self.payload_mass < 0.0:
            raise InvalidWindowError(f"payload_mass must not be negative; got {self.payload_mass} kg")
        if self.temperature is not None and self.temperature <= -273.15:
            raise InvalidWindowError(f"temperature must lie above -273.15 °C; got {self.temperature} °C")
        if self.preload is not None and self.preload <= 0.0:
            raise InvalidWindowError(f"preload must be positive; got {self.preload} N")


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """One simultaneous record of an excitation (torque, force, current …) and of what answers it.

    The samples keep the precision in which they were recorded and may contain anything that an acquisition system can
    produce: whether they are fit to be judged is the question of :mod:`monitor_core.quality`, not of this record.
    """

    excitation: SampleArray  # shape (n_samples,) [unit of its quantity]
    response: SampleArray  # shape (n_samples,) [unit of its quantity]
    sample_rate: float  # [Hz]
    started_at: datetime  # with a time zone
    conditions: Conditions
    measurement: str  # its name; which windows of one name are averaged together says measurements_of
    excitation_quantity: ExcitationQuantity = ExcitationQuantity.TORQUE
    excitation_source: ExcitationSource = ExcitationSource.SENSOR
    direction: Direction = Direction.BOTH
    position_span: float = 0.0  # travel during the window [m]
    position_trace: FloatArray | None = None  # shape (n_samples,) [m]
    response_quantity: ResponseQuantity = ResponseQuantity.ACCELERATION
    reference: SampleArray | None = None  # what the control commanded meanwhile, shape (n_samples,) [any unit]
    response_resolution: float | None = None  # step that the response is quantised in; None: not stated [its unit]

    def __post_init__(self) -> None:
        object.__setattr__(self, "excitation", read_only_samples(self.excitation))
        object.__setattr__(self, "response", read_only_samples(self.response))
        if self.excitation.ndim != 1 or self.excitation.shape != self.response.shape:
            raise InvalidWindowError(
                "excitation and response must be one-dimensional and of one length; "
                f"got shapes {self.excitation.shape} and {self.response.shape}"
            )
        if self.excitation.size == 0:
            raise InvalidWindowError("a window must hold at least one sample; got none")
        if self.position_trace is not None:
            object.__setattr__(self, "position_trace", read_only(self.position_trace))
            if self.position_trace.shape != self.excitation.shape:
                raise InvalidWindowError(
                    f"position must have as many samples as the excitation ({self.excitation.size}); "
                    f"got shape {self.position_trace.shape}"
                )
        # of another source it would make H1 another estimate, which no calibration of that source could tell
        if self.source is ExcitationSource.DRIVE_BY_REFERENCE and self.excitation_source is not ExcitationSource.DRIVE:
            raise InvalidWindowError(f"excitation_source must be drive, with a reference; got {self.excitation_source}")
        if self.reference is not None:
            object.__setattr__(self, "reference", read_only_samples(self.reference))
            if self.reference.shape != self.excitation.shape:
                raise InvalidWindowError(
                    f"reference must have as many samples as the excitation ({self.excitation.size}); "
                    f"got shape {self.reference.shape}"
                )
        if not (np.isfinite(self.sample_rate) and self.sample_rate > 0.0):
            raise InvalidWindowError(f"sample_rate must be positive; got {self.sample_rate} Hz")
        if self.started_at.tzinfo is None:
            raise InvalidWindowError(f"started_at must carry a time zone; got {self.started_at.isoformat()}")
        if not self.position_span >= 0.0:
            raise InvalidWindowError(f"position_span must not be negative; got {self.position_span} m")
        resolution = self.response_resolution
        if resolution is not None and not 0.0 < resolution < math.inf:
            raise InvalidWindowError(
                f"response_resolution must be positive; got {resolution} {self.response_quantity.unit}"
            )
        if not self.measurement:
            raise InvalidWindowError("measurement must name the measurement the window belongs to; got an empty text")

    @property
    def n_samples(self) -> int:
        """Number of samples in each channel."""
        return int(self.excitation.size)

    @property
    def ended_at(self) -> datetime:
        """When its last sample ended."""
        return self.started_at + timedelta(seconds=self.n_samples / self.sample_rate)

    @property
    def source(self) -> ExcitationSource:
        """What a calibration must be of: with a reference, the drive's torque shows the axis without its loop."""
        return self.excitation_source if self.reference is None else ExcitationSource.DRIVE_BY_REFERENCE

    @property
    def placed(self) -> "Placed":
        """What tells which measurement it is of."""
        conditions = self.conditions
        return Placed(self.measurement, self.started_at, self.ended_at, conditions.position, conditions.preload)


def span_of(trace: FloatArray) -> float:
    """Return how far a position trace reaches, of its finite samples [m]; which others it has, the gate refuses."""
    finite = trace[np.isfinite(trace)]
    return float(np.ptp(finite)) if finite.size else 0.0


@dataclass(frozen=True, slots=True)
class Placed:
    """What tells which measurement a window is of."""

    name: str  # of the measurement
    started_at: datetime
    ended_at: datetime
    position: float  # [m]
    preload: float | None  # only where it was set on purpose [N]


@dataclass(frozen=True, slots=True)
class Visit:
    """How far windows of one measurement may be apart."""

    pause: timedelta = timedelta(minutes=10)  # from the end of a window to the start of the next
    span: float = 0.020  # between positions [m]


#: Measurements farther apart than this are of different sessions.
SESSION_GAP = timedelta(hours=12)
#: A sender that never pauses begins another measurement at noon and at midnight (UTC): what came hours later is another
#: state. The cut hangs on the clock, so that one more window moves the next cut, and not all that follow; what began
#: within the last half of it goes on to the next.
_HALF_DAY, _A_MIDNIGHT = timedelta(hours=12), datetime(2000, 1, 1, tzinfo=UTC)
#: Windows of a measurement: the most that it can be set to wait for. It is read and judged again with each further one.
_MOST_WINDOWS = 1000
#: Preloads that were set on purpose and differ by more are two settings; readings of a load cell scatter by less.
_OTHER_SETTING = 0.05
_ROUNDING = 1e-9  # of positions that were millimetres [m]


def measurements_of(windows: Iterable[Placed], visit: Visit = Visit()) -> list[list[Placed]]:
    """Tell which windows make one measurement: a name is not enough, senders use one again and again.

    A measurement is the windows of one name that follow each other in their own time, with no longer pause than
    ``visit.pause``, at one place, and at one preload that was set or all at none. A window farther away begins another
    measurement of the same name, and so does one at a place that was left and is come back to. What never pauses is cut
    at noon and midnight (UTC), and after a thousand windows.

    Parameters
    ----------
    windows : iterable of Placed
        In any order: what they make does not depend on it.
    visit : Visit
        How far they may be apart.

    Returns
    -------
    list of list of Placed
        The windows of each measurement in the order of their time; measurements in that of their first windows.
    """
    going_on: dict[str, list[Placed]] = {}
    found: list[list[Placed]] = []
    for window in sorted(windows, key=lambda window: window.started_at):
        windows_of_it = going_on.get(window.name)
        if windows_of_it is None or _begins_another(windows_of_it, window, visit):
            windows_of_it = going_on[window.name] = []
            found.append(windows_of_it)
        windows_of_it.append(window)
    return found


def _begins_another(measurement: list[Placed], window: Placed, visit: Visit) -> bool:
    first, before = measurement[0], measurement[-1]
    if window.started_at - before.ended_at > visit.pause or len(measurement) >= _MOST_WINDOWS:
        return True
    begun, now = first.started_at - _A_MIDNIGHT, window.started_at - _A_MIDNIGHT
    if now // _HALF_DAY > (begun + _HALF_DAY / 2) // _HALF_DAY:
        return True
    if abs(window.position - first.position) > visit.span + _ROUNDING:
        return True
    if window.preload is None or first.preload is None:  # what was not set on purpose is no setting
        return window.preload is not first.preload
    return abs(window.preload - first.preload) > _OTHER_SETTING * max(window.preload, first.preload)


def told_apart(windows: Mapping[Key, Placed]) -> dict[str, tuple[Key, ...]]:
    """Return the measurements of a session: the keys of their windows, by name.

    A name that several measurements have is followed by the start of each; ``windows``: by any key, in time order.
    """
    keys = {id(window): key for key, window in windows.items()}
    measured = measurements_of(windows.values())
    repeated: dict[str, int] = {}
    for members in measured:
        repeated[members[0].name] = repeated.get(members[0].name, 0) + 1
    named: dict[str, tuple[Key, ...]] = {}
    for members in measured:
        name = members[0].name
        if repeated[name] > 1:
            name = f"{name} ({members[0].started_at.isoformat()})"
        while name in named:  # two that start at one moment, or another that is called so
            name += "'"
        named[name] = tuple(keys[id(window)] for window in members)
    return named


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """A recorded series of windows of one axis, in time order."""

    axis_id: str
    windows: tuple[Window, ...]
    description: str = ""
    created: datetime | None = None
    _members: Mapping[str, tuple[int, ...]] = field(init=False, repr=False)  # numbers of windows, by measurement

    def __post_init__(self) -> None:
        placed = {number: window.placed for number, window in enumerate(self.windows)}
        object.__setattr__(self, "_members", told_apart(placed))

    @property
    def measurements(self) -> tuple[str, ...]:
        """Names, in order of first appearance; one that is repeated with the start of each measurement."""
        return tuple(self._members)

    def windows_of(self, measurement: str) -> tuple[Window, ...]:
        """Return the windows of one measurement, in time order."""
        return tuple(self.windows[number] for number in self._members.get(measurement, ()))


@dataclass(frozen=True, slots=True, eq=False)
class MotionRecord:
    """Position and drive force of one uninterrupted motion, uniformly sampled."""

    sample_rate: float  # [Hz]
    position: FloatArray  # measured, shape (n_samples,) [m]
    drive: FloatArray  # force or torque of the motor, shape (n_samples,) [N or N·m]
    quantity: ExcitationQuantity = ExcitationQuantity.FORCE  # what ``drive`` is
    reference: FloatArray | None = None  # position that was commanded, shape (n_samples,) [m]

    def __post_init__(self) -> None:
        if not (math.isfinite(self.sample_rate) and self.sample_rate > 0.0):
            raise OutsideValidityError(f"sample_rate must be positive and finite; got {self.sample_rate} Hz")
        if self.quantity.is_relative:
            raise OutsideValidityError(f"a motion needs a force or a torque; got {self.quantity}")
        for name in ("position", "drive", "reference"):
            samples = getattr(self, name)
            if samples is None:
                continue
            object.__setattr__(self, name, read_only(samples))
            if samples.shape != self.position.shape or samples.ndim != 1:
                raise OutsideValidityError(
                    f"position, drive and reference must be of one length; got {name} of shape {samples.shape}"
                )
            if not np.all(np.isfinite(samples)):
                raise OutsideValidityError(
                    f"{name} must be finite; sample {int(np.argmin(np.isfinite(samples)))} is not"
                )

    @property
    def time(self) -> FloatArray:
        """Since the first sample, shape (n_samples,) [s]."""
        return np.arange(self.position.size) / self.sample_rate


@dataclass(frozen=True, slots=True, eq=False)
class MotionProfile:
    """What a control commands over time, and the force of cutting on the table meanwhile; each of shape (n,)."""

    time: FloatArray  # rising [s]
    values: FloatArray  # speed of the table [m/s], or its position, from any place [m]
    is_speed: bool
    force: FloatArray | None = None  # [N]

    def __post_init__(self) -> None:
        for name in ("time", "values", "force"):
            samples = getattr(self, name)
            if samples is None:
                continue
            object.__setattr__(self, name, read_only(samples))
            if samples.shape != self.time.shape or samples.ndim != 1 or samples.size < 2:
                raise OutsideValidityError(
                    f"a motion must have two instants or more, and as many values; got {name} of shape {samples.shape}"
                )
            if not np.all(np.isfinite(samples)):
                raise OutsideValidityError(f"{name} of a motion must be finite")
        if not np.all(np.diff(self.time) > 0.0):
            raise OutsideValidityError("times of a motion must rise from each to the next")

    @property
    def duration(self) -> float:
        """From the first instant to the last [s]."""
        return float(self.time[-1] - self.time[0])
