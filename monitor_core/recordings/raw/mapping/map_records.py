"""Records of a channel map: what the channels of raw files mean, and what the files do not say."""

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime, tzinfo
from enum import StrEnum

from monitor_core.models.protocol import ExcitationPoint, ResponsePoint
from monitor_core.recording import Direction, ExcitationQuantity, ExcitationSource, ResponseQuantity
from monitor_core.recordings.elements.units import Quantity
from monitor_core.recordings.raw.text.layout import TextLayout

#: What the numbers of a response measure.
RESPONSE_QUANTITIES = {
    ResponseQuantity.ACCELERATION: Quantity.ACCELERATION,
    ResponseQuantity.VELOCITY: Quantity.VELOCITY,
    ResponseQuantity.DISPLACEMENT: Quantity.POSITION,
    ResponseQuantity.MOTOR_ANGLE: Quantity.ANGLE,
    ResponseQuantity.MOTOR_SPEED: Quantity.SPEED,
    ResponseQuantity.RELATIVE_DISPLACEMENT: Quantity.POSITION,
}
#: What a screw makes of a turning motor.
TRAVEL_OF = {Quantity.ANGLE: Quantity.POSITION, Quantity.SPEED: Quantity.VELOCITY}


class WindowsIn(StrEnum):
    """How a two-dimensional array holds several windows."""

    ROWS = "rows"
    COLUMNS = "columns"


class ResampleMethod(StrEnum):
    """How values between samples are found."""

    CUBIC = "cubic"
    LINEAR = "linear"


@dataclass(frozen=True, slots=True)
class MappedChannel:
    """A channel of the file, what its numbers are in, and how they become SI: (number − offset) · factor.

    ``unit`` is empty and ``factor`` NaN where the map leaves the unit to the file: see ``stated_units.resolved``.
    """

    channel: str
    unit: str
    factor: float
    convert: Callable[..., float] = field(repr=False, compare=False)  # factor of a unit; place in ``where``
    offset: float = 0.0  # in the unit of the file
    row: int | None = None  # of a two-dimensional array, counted from 0
    column: int | None = None  # the same; at most one of the two
    time: str | None = None  # channel of the same file that holds the sampling times of this one
    wraps_at: float | None = None  # numbers begin anew there, in the unit of the file
    in_decibels: bool = False  # 20 lg of a magnitude by 1 of the unit
    resolution: float | None = None  # step in which it was taken, in the unit of the file; None: not stated

    @property
    def step(self) -> float | None:
        """Step in which the numbers were taken, in SI: what is stated, and one of what counts; ``None``: not known."""
        resolution = 1.0 if self.resolution is None and self.unit == "count" else self.resolution
        return None if resolution is None else resolution * self.factor


@dataclass(frozen=True, slots=True)
class TimeSource:
    """Which channel holds sampling times, and what they are: numbers of a unit or of samples, or texts of a date."""

    channel: str | None  # None: each signal names its own
    unit: str | None = None  # of numbers; None: texts, or the file says it
    form: str | None = None  # of texts: "iso" or a pattern of strptime
    date: str | None = None  # channel of texts in front of it
    zone: tzinfo | None = None  # where the texts carry none
    row: int | None = None  # of a two-dimensional array, counted from 0
    column: int | None = None  # the same; at most one of the two
    counts_at: float | None = None  # it numbers the samples that were taken at this rate [Hz]


@dataclass(frozen=True, slots=True)
class Resampling:
    """One even clock for channels that have several, or an uneven one."""

    sample_rate: float  # [Hz]
    method: ResampleMethod


@dataclass(frozen=True, slots=True)
class WindowFacts:
    """What the map says about the windows of a file; ``None`` leaves it to the file."""

    started_at: datetime | None = None
    position: float | None = None  # [m]; position and span are None where a channel measures them
    position_span: float | None = None  # [m]
    payload_mass: float | None = None  # [kg]
    temperature: float | None = None  # [°C]
    preload: float | None = None  # [N]
    measurement: str | None = None
    direction: Direction | None = None


@dataclass(frozen=True, slots=True)
class Cutting:
    """How records become windows, and how several files follow each other."""

    samples_per_window: int | None = None
    windows_in: WindowsIn | None = None
    window_interval: float | None = None  # [s]
    file_interval: float | None = None  # [s]
    position_step: float | None = None  # [m]


@dataclass(frozen=True, slots=True)
class NamedNumbers:
    """Names of single numbers of the file that stand in place of numbers of the map; ``None``: the map says them."""

    sample_rate: str | None = None
    samples_per_window: str | None = None


@dataclass(frozen=True, slots=True)
class Sweep:
    """Settings of a resonance test, and what it moved."""

    start: float  # first frequency [Hz]
    end: float  # last frequency [Hz]
    acceleration_per_frequency: float  # [m/s²/Hz]
    frequency_rate: float  # [Hz/s]
    slow_acceleration: float  # [m/s²]
    slow_period: float  # [s]; 0: without
    moving_mass: float  # [kg]


@dataclass(frozen=True, slots=True)
class SessionSignals:
    """The channels of a session."""

    excitation: MappedChannel
    quantity: ExcitationQuantity
    source: ExcitationSource
    response: MappedChannel
    position: MappedChannel | None
    response_quantity: ResponseQuantity = ResponseQuantity.ACCELERATION
    motor: MappedChannel | None = None  # whose travel [m] the response, a scale, is subtracted from
    sweep: Sweep | None = None  # what the excitation is worked out from, where no channel holds it
    reference: MappedChannel | None = None  # what the control commanded


@dataclass(frozen=True, slots=True)
class MotionSignals:
    """The channels of a motion record."""

    position: MappedChannel
    drive: MappedChannel
    quantity: ExcitationQuantity
    reference: MappedChannel | None


@dataclass(frozen=True, slots=True)
class ResponseLines:
    """Where the lines of a frequency response stand, and what was excited and answers."""

    excitation: ExcitationPoint
    response_point: ResponsePoint
    response: MappedChannel | None  # name of a frequency response of the file; None: columns
    frequency: MappedChannel | None
    parts: tuple[MappedChannel, MappedChannel] | None  # real and imaginary part, or magnitude and phase
    polar: bool  # the latter
    standard_deviation: float | None  # of real and imaginary part, in the unit of the response
    relative_deviation: float | None  # the same, of the magnitude of each line
    deviation: MappedChannel | None  # the same, a column
    resolution: float  # [Hz]
    excitation_level: float  # [N·m] or [N]; 0: small signals


@dataclass(frozen=True, slots=True)
class Tolerances:
    """How well the settings are known; ``None``: not stated."""

    position_mm: float | None = None
    preload: float | None = None  # relative
    gain: float | None = None  # relative

    @property
    def attributes(self) -> dict[str, float | None]:
        """By the names of the files."""
        return {
            "position_tolerance_mm": self.position_mm,
            "preload_tolerance": self.preload,
            "gain_tolerance": self.gain,
        }


class MapKind(StrEnum):
    """What a map makes of raw files."""

    SESSION = "session"
    MOTION = "motion record"
    FRF_SET = "FRF set"


_KINDS: dict[type, MapKind] = {
    SessionSignals: MapKind.SESSION,
    MotionSignals: MapKind.MOTION,
    ResponseLines: MapKind.FRF_SET,
}


@dataclass(frozen=True, slots=True)
class ChannelMap:
    """Meaning of the channels of raw files."""

    signals: SessionSignals | MotionSignals | ResponseLines
    axis_id: str  # empty where a motion or a response names none
    window: WindowFacts
    description: str = ""
    text: TextLayout | None = None
    time: TimeSource | None = None
    resampling: Resampling | None = None
    sample_rate: float | None = None  # [Hz]; None: the file says it
    cutting: Cutting = field(default_factory=Cutting)
    files: tuple[tuple[str, WindowFacts], ...] = ()  # name of a file, and facts that go before those of the window
    tolerances: Tolerances = field(default_factory=Tolerances)
    named: NamedNumbers = field(default_factory=NamedNumbers)

    @property
    def kind(self) -> MapKind:
        """What it makes of raw files."""
        return _KINDS[type(self.signals)]
