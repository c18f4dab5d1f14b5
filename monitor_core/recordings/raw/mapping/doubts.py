"""Doubt numbers that are likely of another quantity or unit than the map says; what cannot be is refused.

Each doubt rests on a bound that no ball-screw axis reaches by a wide margin, and names what may have happened instead.
"""

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from monitor_core.arrays import FloatArray, SampleArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recording import ExcitationQuantity, ResponseQuantity, Session, Window
from monitor_core.recordings.elements.units import Quantity, quantity_of_unit, to_millimetres
from monitor_core.recordings.raw.mapping.map_records import MappedChannel, SessionSignals

#: Below, no axial mode of an axis can be in a record: the fit takes up to 0.4 of the rate.
_LEAST_RATE, _LOW_RATE, _HIGH_RATE, _MOST_RATE = 20.0, 200.0, 1e6, 1e7  # [Hz]
_LONGEST_AXIS = 50.0  # [m]
_SMALL_TRAVEL = (2e-5, 2e-3)  # travel that would be 20 mm to 2 m if the numbers were metres instead of mm [m]
_GREAT_ACCELERATION = 2e4  # about 2000 g [m/s²]
_OFFSET = 20.0  # mean of a signal in standard deviations
_GRAVITY = 11.0  # an accelerometer that stands upright may show it [m/s²]
_COUNTS = 1000  # distinct, whole and that large: counts of a converter
#: What moves, as force by acceleration [kg]; the same as torque by acceleration, for leads of 5 to 40 mm [N·m·s²/m].
_MOVING = {ExcitationQuantity.FORCE: (0.05, 1e5, "kg"), ExcitationQuantity.TORQUE: (3e-5, 50.0, "N·m by m/s²")}


def require_vibration_rate(sample_rate: float, where: str) -> None:
    """Refuse a rate at which a record holds no vibration of an axis, or that no converter has [Hz]."""
    if sample_rate < _LEAST_RATE:
        raise RecordingFormatError(
            f"{where}: expected a record of vibrations, sampled at {_LEAST_RATE:g} Hz or more; got {sample_rate:.4g} "
            "Hz: it holds no vibration of an axis, unless the times are in ms and the map says s"
        )
    if sample_rate > _MOST_RATE:
        raise RecordingFormatError(
            f"{where}: expected a sampling rate up to {_MOST_RATE:g} Hz; got {sample_rate:.4g} Hz: the times may be in "
            "s where the map says ms or us"
        )


def require_place(position: SampleArray | float, where: str) -> None:
    """Refuse positions that no axis has [m]."""
    farthest = float(np.max(np.abs(np.nan_to_num(np.asarray(position, dtype=np.float64)))))
    if farthest > _LONGEST_AXIS:
        raise RecordingFormatError(
            f"{where}: expected positions of an axis, up to {_LONGEST_AXIS:g} m; got {farthest:.4g} m: the numbers may "
            "be in mm or um where the map says otherwise"
        )


def doubts_of_rate(sample_rate: float, where: str) -> Iterator[str]:
    """Doubt a rate that is possible and unlikely [Hz]."""
    if sample_rate < _LOW_RATE:
        yield (
            f"{where}: in doubt: sampled at {sample_rate:.4g} Hz, it shows modes below {0.4 * sample_rate:.3g} Hz "
            "only; are the times in ms?"
        )
    elif sample_rate > _HIGH_RATE:
        yield f"{where}: in doubt: sampled at {sample_rate:.4g} Hz; are the times in s?"


#: So many numbers of a channel show what they are.
_MOST_NUMBERS = 1_000_000


def doubts_of_numbers(numbers: SampleArray, source: MappedChannel, where: str) -> Iterator[str]:
    """Doubt the numbers of a channel as the file has them: counts of a converter, or an offset nobody took off."""
    if quantity_of_unit(source.unit) in (Quantity.POSITION, Quantity.ANGLE):
        return  # an encoder counts, from any zero
    values = np.asarray(numbers.reshape(-1)[:_MOST_NUMBERS], dtype=np.float64)
    values = values[np.isfinite(values)]
    if values.size < 2:
        return
    if source.unit != "count" and np.ptp(values) >= _COUNTS and np.all(values == np.rint(values)):
        yield (
            f"{where}: in doubt: whole numbers from {values.min():g} to {values.max():g}, as a converter counts; are "
            f'{source.unit}? unit = "count" takes sensitivity and offset'
        )
    spread, mean = float(values.std()), float(values.mean()) - source.offset
    if spread > 0.0 and abs(mean) > _OFFSET * spread and abs(mean * source.factor) > _GRAVITY:
        yield (
            f"{where}: in doubt: the mean, {mean:.4g} {source.unit}, is {abs(mean) / spread:.0f} times the spread; is "
            "it an offset to take off?"
        )


def doubts_of_session(session: Session, signals: SessionSignals) -> Iterator[str]:
    """Doubt a session in SI: acceleration, force or torque by acceleration, travel."""
    driven = _peak(window.excitation for window in session.windows)
    answer = _peak(_as_acceleration(window) for window in session.windows)
    if answer > _GREAT_ACCELERATION:
        yield (
            f"response {signals.response.channel!r}: in doubt: {answer:.3g} m/s² at most; are the numbers "
            f"{signals.response.unit or 'in the unit that the file says'}, and not mV or counts?"
        )
    low, high, unit = _MOVING.get(signals.quantity, (0.0, math.inf, ""))
    is_scaled = signals.sweep is None and signals.response_quantity is ResponseQuantity.ACCELERATION
    if is_scaled and answer > 0.0 and driven > 0.0 and not low <= driven / answer <= high:
        yield (
            f"excitation {signals.excitation.channel!r}: in doubt: {driven:.3g} {'N' if unit == 'kg' else 'N·m'} and "
            f"{answer:.3g} m/s² at most would mean {driven / answer:.2g} {unit}; are the numbers {signals.quantity} in "
            f"{signals.excitation.unit or 'the unit that the file says'}, and not volts of a sensor?"
        )
    if signals.position is not None:
        traces = [window.position_trace for window in session.windows if window.position_trace is not None]
        yield from doubts_of_travel(traces, signals.position)


def _as_acceleration(window: Window) -> FloatArray:
    """Return at least what the table must accelerate by for these samples [m/s²]; nothing of a motor that turns."""
    quantity = window.response_quantity
    if quantity.is_of_motor:
        return np.zeros(0)
    n = quantity.derivatives
    return np.diff(window.response.astype(np.float64), n) * window.sample_rate**n


def doubts_of_travel(traces: Sequence[FloatArray], source: MappedChannel) -> Iterator[str]:
    """Doubt travel so short that the numbers may be metres where the map says mm."""
    if source.unit in ("m", "") or not traces:
        return
    low, high = min(float(trace.min()) for trace in traces), max(float(trace.max()) for trace in traces)
    if _SMALL_TRAVEL[0] < high - low and max(abs(low), abs(high)) < _SMALL_TRAVEL[1]:
        yield (
            f"position {source.channel!r}: in doubt: {to_millimetres(low):.4g} to {to_millimetres(high):.4g} mm only; "
            f"are the numbers m where the map says {source.unit}?"
        )


def _peak(signals: Iterable[SampleArray]) -> float:
    peaks = (float(np.max(np.abs(np.nan_to_num(values.astype(np.float64))), initial=0.0)) for values in signals)
    return max(peaks, default=0.0)
