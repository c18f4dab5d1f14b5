"""What was measured for an identification: peaks at positions, or whole frequency responses."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from monitor_core.arrays import ComplexArray, FloatArray, read_only, read_only_complex
from monitor_core.errors import OutsideValidityError
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, ResponsePoint
from monitor_core.response import LineSpread


@dataclass(frozen=True, slots=True)
class ModalObservation:
    """One measured peak of the table's receptance. ``None`` means: not stated."""

    conditions: DriveConditions
    frequency: float  # of the peak [Hz]
    frequency_uncertainty: float | None = None  # standard uncertainty [Hz]
    amplitude: float | None = None  # |H| at the peak [m/N]
    amplitude_uncertainty: float | None = None  # standard uncertainty [m/N]
    order: int | None = None  # as the source counts it, from 1: a label, not the mode of a model
    damping_ratio: float | None = None  # [-]
    damping_ratio_uncertainty: float | None = None  # standard uncertainty [-]

    def __post_init__(self) -> None:
        for name, unit in (
            ("frequency", "Hz"), ("frequency_uncertainty", "Hz"), ("amplitude", "m/N"),
            ("amplitude_uncertainty", "m/N"), ("damping_ratio", ""), ("damping_ratio_uncertainty", ""),
        ):  # fmt: skip
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise OutsideValidityError(f"{name} must be positive and finite; got {value} {unit}".rstrip())
        if self.amplitude is None and self.amplitude_uncertainty is not None:
            raise OutsideValidityError(
                f"an amplitude must be stated with its uncertainty; got {self.amplitude_uncertainty} m/N without one"
            )
        if self.damping_ratio is None and self.damping_ratio_uncertainty is not None:
            raise OutsideValidityError(
                f"a damping ratio must be stated with its uncertainty; got {self.damping_ratio_uncertainty} without one"
            )
        if self.order is not None and self.order < 1:
            raise OutsideValidityError(f"order must count from 1; got {self.order}")

    @property
    def name(self) -> str:
        """How a sentence calls it."""
        return f"the peak at {self.frequency:g} Hz at {self.conditions.position * 1e3:g} mm"


@dataclass(frozen=True, slots=True)
class AssignedPeak:
    """A measured peak with the mode it belongs to."""

    observation: ModalObservation
    mode: int  # of the axis, from 1


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponseObservation:
    """One measured frequency response with the noise of its lines.

    The noise is circular: real and imaginary part have the same standard deviation and are independent, as those of an
    H1 estimate of many averages are.
    """

    conditions: DriveConditions
    frequency: FloatArray  # shape (n_frequencies,), rising [Hz]
    response: ComplexArray  # shape (n_frequencies,), in the unit of the two points [m/N, m/(N·s²), …]
    standard_deviation: FloatArray  # of the real part and of the imaginary part, shape (n_frequencies,), same unit
    excitation: ExcitationPoint = ExcitationPoint.FORCE_AT_TABLE
    response_point: ResponsePoint = ResponsePoint.DISPLACEMENT_AT_TABLE
    #: Reciprocal duration of the Hann windows that a continuous random excitation was averaged in; 0: lines count as
    #: exact. The discrepancy workflow looks at it, an identification does not. [Hz]
    resolution: float = 0.0
    #: What windows of a known excitation show of a response, in the place of what the resolution says. The discrepancy
    #: workflow alone looks at it.
    spread: LineSpread | None = None
    placed: bool = True  # False: the record does not say where its accelerometer sat; it is taken to be at the point

    def __post_init__(self) -> None:
        object.__setattr__(self, "frequency", read_only(self.frequency))
        object.__setattr__(self, "response", read_only_complex(self.response))
        object.__setattr__(self, "standard_deviation", read_only(self.standard_deviation))
        shapes = {self.frequency.shape, self.response.shape, self.standard_deviation.shape}
        if len(shapes) != 1 or self.frequency.ndim != 1 or not self.frequency.size:
            raise OutsideValidityError(
                "frequency, response and standard_deviation must be of one length, at least 1; got shapes "
                f"{self.frequency.shape}, {self.response.shape} and {self.standard_deviation.shape}"
            )
        if not (self.frequency[0] > 0.0 and np.all(np.diff(self.frequency) > 0.0) and self.frequency[-1] < math.inf):
            raise OutsideValidityError("frequencies of a response must be positive, finite and rising")
        if not np.all(np.isfinite(self.response)):
            raise OutsideValidityError("a response must be finite at every frequency")
        if not (np.all(self.standard_deviation > 0.0) and np.all(np.isfinite(self.standard_deviation))):
            raise OutsideValidityError("standard_deviation must be positive and finite at every frequency")
        if not 0.0 <= self.resolution < math.inf:
            raise OutsideValidityError(f"resolution must be finite and not negative; got {self.resolution} Hz")
        if self.spread is not None and self.spread.weights.shape[1] != self.frequency.size:
            raise OutsideValidityError(
                f"a spread must be that of the {self.frequency.size} lines; got {self.spread.weights.shape[1]}"
            )


#: Where an accelerometer may sit that a record does not place.
ACCELEROMETER_POINTS = (ResponsePoint.ACCELERATION_AT_TABLE, ResponsePoint.ACCELERATION_AT_NUT)


def with_accelerometer_at(
    point: ResponsePoint, observations: Sequence[FrequencyResponseObservation]
) -> tuple[FrequencyResponseObservation, ...]:
    """Return responses with the accelerometer at one of ``ACCELEROMETER_POINTS`` unless their records place it."""
    return tuple(
        observation if observation.placed else replace(observation, response_point=point, placed=True)
        for observation in observations
    )


def conditions_in_order(observations: Iterable[ModalObservation]) -> tuple[DriveConditions, ...]:
    """Return the distinct conditions of a table, by position."""
    distinct = dict.fromkeys(observation.conditions for observation in observations)
    return tuple(sorted(distinct, key=lambda stated: (stated.position, stated.payload_mass, stated.preload or 0.0)))
