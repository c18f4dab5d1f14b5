"""Read how the axes stand from the service, and lay it out as OPC UA does: value, quality, time of measurement."""

import asyncio
import math
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from asyncua import ua
from pydantic import BaseModel, TypeAdapter, ValidationError

from preload_client import AsyncClient, PreloadError

#: A service that has not answered by then is away.
READ_WITHIN_S = 10.0


class _Doubt(BaseModel):
    reason: str


class _Measurement(BaseModel):
    """The newest measurement of an axis; one that was refused has no preload."""

    started_at: datetime
    preload_n: float | None = None
    interval_95_n: tuple[float | None, float | None] | None = None
    frequency_fall_percent: float | None = None  # without a calibration
    frequency_fall_interval_95_percent: tuple[float | None, float | None] | None = None
    doubts: list[_Doubt] = []


class _LostMotion(BaseModel):
    """The newest lost motion of an axis."""

    measured_at: datetime
    reversal_value_um: float
    reversal_value_interval_95_um: tuple[float, float]
    state: str


class AxisSeen(BaseModel):
    """An axis as ``GET /v1/axes`` gives it."""

    id: str
    name: str
    state: str
    state_since: datetime | None
    last_measurement: _Measurement | None
    lost_motion: _LostMotion | None = None  # an older service says nothing of it


class _Evidence(BaseModel):
    sentence: str | None = None


class AlarmSeen(BaseModel):
    """An open alarm as ``GET /v1/alarms`` gives it."""

    id: int
    axis: str
    kind: str
    raised_at: datetime
    status: str
    shelved_until: datetime | None
    evidence: _Evidence


_AXES, _ALARMS = TypeAdapter(list[AxisSeen]), TypeAdapter(list[AlarmSeen])
_OPEN: tuple[Literal["active"], Literal["acknowledged"]] = ("active", "acknowledged")


@dataclass(frozen=True, slots=True)
class Reading:
    """All that is shown, at one moment."""

    axes: list[AxisSeen]
    alarms: list[AlarmSeen]


class ServiceAwayError(Exception):
    """The service does not answer, or not with what is expected."""


async def read_service(service: AsyncClient) -> Reading:
    """Read axes and open alarms, within bounds of time and bytes. Raises ServiceAwayError."""
    try:
        async with asyncio.timeout(READ_WITHIN_S):
            axes = await service.axes()
            alarms = [alarm for status in _OPEN async for alarm in service.alarms(status=status)]
        return Reading(_AXES.validate_python(axes), _ALARMS.validate_python(alarms))
    except TimeoutError as error:
        raise ServiceAwayError(f"the service has not answered within {READ_WITHIN_S:g} s") from error
    except (PreloadError, ValidationError) as error:
        raise ServiceAwayError(f"the service cannot be read: {error}") from error


def _quality_of_lost_motion(lost: _LostMotion | None) -> ua.StatusCode:
    if lost is None:
        return ua.StatusCode(ua.StatusCodes.BadNoData)
    old = lost.state == "unknown"
    return ua.StatusCode(ua.StatusCodes.UncertainLastUsableValue if old else ua.StatusCodes.Good)


def quality_of(axis: AxisSeen, value: float | None) -> ua.StatusCode:
    """Return the quality of a number of the newest measurement: bad without a value, uncertain if in doubt or old."""
    measured = axis.last_measurement
    if measured is None or value is None:
        return ua.StatusCode(ua.StatusCodes.BadNoData)
    if measured.doubts:
        return ua.StatusCode(ua.StatusCodes.UncertainSubNormal)
    old = axis.state == "unknown"
    return ua.StatusCode(ua.StatusCodes.UncertainLastUsableValue if old else ua.StatusCodes.Good)


def values_of(axis: AxisSeen) -> dict[str, ua.DataValue]:
    """Return what the variables of an axis hold; an interval that is open has an infinite end."""
    measured, at = axis.last_measurement, None
    preload = fall = lower = upper = least = most = None
    if measured is not None:
        at, preload, fall = measured.started_at, measured.preload_n, measured.frequency_fall_percent
        lower, upper = measured.interval_95_n or (None, None)
        least, most = measured.frequency_fall_interval_95_percent or (None, None)
    quality, of_fall = quality_of(axis, preload), quality_of(axis, fall)
    return {
        "Preload": _number(preload, quality, at),
        "PreloadIntervalLow": _number(0.0 if lower is None else lower, quality, at),
        "PreloadIntervalHigh": _number(math.inf if upper is None else upper, quality, at),
        "FrequencyFall": _number(fall, of_fall, at),
        "FrequencyFallIntervalLow": _number(-math.inf if least is None else least, of_fall, at),
        "FrequencyFallIntervalHigh": _number(math.inf if most is None else most, of_fall, at),
        "State": ua.DataValue(ua.Variant(axis.state, ua.VariantType.String), SourceTimestamp=axis.state_since),
        **_values_of_lost_motion(axis.lost_motion),
    }


def _values_of_lost_motion(lost: _LostMotion | None) -> dict[str, ua.DataValue]:
    quality, at = _quality_of_lost_motion(lost), None if lost is None else lost.measured_at
    lower, upper = (None, None) if lost is None else lost.reversal_value_interval_95_um
    state = "unknown" if lost is None else lost.state
    return {
        "LostMotion": _number(None if lost is None else lost.reversal_value_um, quality, at),
        "LostMotionIntervalLow": _number(lower, quality, at),
        "LostMotionIntervalHigh": _number(upper, quality, at),
        "LostMotionState": ua.DataValue(ua.Variant(state, ua.VariantType.String), SourceTimestamp=at),
    }


def _number(value: float | None, quality: ua.StatusCode, at: datetime | None) -> ua.DataValue:
    if value is None or quality.is_bad():
        return ua.DataValue(StatusCode=quality, SourceTimestamp=at)
    return ua.DataValue(ua.Variant(value, ua.VariantType.Double), StatusCode=quality, SourceTimestamp=at)
