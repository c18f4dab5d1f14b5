r"""Work out the acceleration that a resonance test commanded, and lay it over a record of the answer alone.

Klipper's ``TEST_RESONANCES`` writes what the accelerometer saw, and not what it told the motors. That follows from the
settings of the test [1]_: the acceleration is ±a in turn, a quarter of a period 1/f each, with

.. math:: a = c f, \qquad f \leftarrow f + \tfrac{h}{2 f}

from half period to half period (c ``accel_per_hz``, h ``hz_per_sec``), and ±``sweeping_accel`` besides, which turns
every half ``sweeping_period``, the first times after √2/8 and 1/4 + √2/8 of it. When the test began in the record is
found where it is slow: there the table does what it is told.

References
----------
.. [1] Klipper documentation, *Measuring Resonances* and *Configuration reference*, ``[resonance_tester]``.
"""

import math
from dataclasses import replace

import numpy as np
import scipy

from monitor_core.arrays import FloatArray, SampleArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.raw.mapping.map_records import Sweep
from monitor_core.recordings.raw.mapping.mapped import Record

#: The test is laid over the record by so much of its beginning: until the frequency has grown by half, but not shorter.
_GROWN, _SHORTEST = 1.5, 2.0  # [-], [s]
#: A record begins before and ends behind the test; by more than this, the test was another one [s].
_MOST_BESIDE = 5.0
#: What the axis answers of the command while that is slow: all of it, or more below a mode.
_LEAST, _MOST = 0.7, 2.0
_MOST_PIECES = 100_000


def with_commanded_force(record: Record, sweep: Sweep) -> Record:
    """Return a record of an answer, with the force in front of it that the test commanded: moving mass × acceleration.

    The acceleration is the mean over each step of the clock. ``RecordingFormatError`` if the test lasts longer than the
    record or ends long before it, or if the table did not follow it where it is slow: then the settings are of another
    test, or the channel of another axis.
    """
    answer, rate = record.signals[0], record.sample_rate
    ends, velocity, n_slow = _velocity(sweep)
    lasts = answer.size / rate
    if answer.ndim != 1 or not 0.0 <= lasts - ends[-1] <= _MOST_BESIDE:
        raise RecordingFormatError(
            f"{record.file_name}: expected one test without a break, which lasts {ends[-1]:.4g} s by its map; "
            f"got {lasts:.4g} s"
        )
    slow = _mean_acceleration(ends, velocity, np.arange(int(ends[n_slow] * rate)) / rate, rate)
    late, follows = _found(answer[: slow.size + int((lasts - ends[-1]) * rate)], slow, rate, sweep.start)
    if not _LEAST <= follows <= _MOST:
        raise RecordingFormatError(
            f"{record.file_name}, {record.names[0]}: expected an axis that follows the map where that is slow, "
            f"near {sweep.start:g} Hz; it answers {follows:.2f} of it: another axis, or other settings"
        )
    commanded = _mean_acceleration(ends, velocity, np.arange(answer.size) / rate - late, rate)
    remark = (
        f"{record.file_name}: the commanded acceleration is worked out from [sweep]; the test began {late:.4f} s "
        f"into the record, where the axis answers {follows:.2f} of it"
    )
    return replace(
        record, names=("commanded", *record.names), signals=(sweep.moving_mass * commanded, *record.signals),
        remarks=(*record.remarks, remark),
    )  # fmt: skip


def _found(answer: SampleArray, slow: FloatArray, rate: float, frequency: float) -> tuple[float, float]:
    """Return when the slow part of a test begins in an answer [s], and which share of it the axis follows.

    To a sample from the likeness of the two, then from the phase by frequency about that of the test: edges arrive
    later than that, by the period of the mode, which is what is looked for.
    """
    centred = answer.astype(np.float64) - float(np.mean(answer, dtype=np.float64))
    first = int(np.argmax(np.abs(scipy.signal.fftconvolve(centred, slow[::-1], mode="valid"))))
    lines = np.fft.rfftfreq(slow.size, 1.0 / rate)
    near = (lines >= frequency) & (lines <= _GROWN * frequency)
    command = np.fft.rfft(slow)[near]
    cross, power = np.fft.rfft(centred[first : first + slow.size])[near] * command.conj(), np.abs(command) ** 2
    sign = 1.0 if float(cross.real.sum()) >= 0.0 else -1.0
    late = -float(np.sum(lines[near] * np.angle(sign * cross) * power) / np.sum(lines[near] ** 2 * power)) / (
        2.0 * np.pi
    )
    in_phase = sign * cross * np.exp(2j * np.pi * lines[near] * late)
    return first / rate + late, float(in_phase.real.sum() / power.sum())


def _velocity(sweep: Sweep) -> tuple[FloatArray, FloatArray, int]:
    """Return the ends of the pieces of constant acceleration [s], the velocity there [m/s], and how many are slow."""
    times, accelerations = [0.0], list[float]()
    frequency, sign, n_slow = sweep.start, 1.0, 0
    while frequency <= sweep.end + 1e-6:
        quarter, level = 0.25 / frequency, sign * sweep.acceleration_per_frequency * frequency
        times += [times[-1] + quarter, times[-1] + 2.0 * quarter]
        accelerations += [level, -level]
        if frequency <= _GROWN * sweep.start or times[-1] <= _SHORTEST:
            n_slow = len(times) - 1
        frequency, sign = frequency + 2.0 * quarter * sweep.frequency_rate, -sign
        if len(times) > _MOST_PIECES:
            raise RecordingFormatError(f"expected a [sweep] of at most {_MOST_PIECES} turns; got more")
    ends = np.array(times)
    velocity = np.concatenate([[0.0], np.cumsum(np.array(accelerations) * np.diff(ends))])
    if sweep.slow_period == 0.0:
        return ends, velocity, n_slow
    n_turns = 2.0 * float(ends[-1]) / sweep.slow_period
    if not n_turns <= _MOST_PIECES:
        raise RecordingFormatError(
            f"expected a sweeping_period of at least {2.0 * ends[-1] / _MOST_PIECES:.2g} s in [sweep], which turns "
            f"{_MOST_PIECES} times; got {sweep.slow_period:g} s"
        )
    first = math.sqrt(2.0) / 8.0
    turns = sweep.slow_period * np.concatenate(
        [[0.0, first], first + 0.25 + first + 0.5 * np.arange(math.ceil(n_turns))]
    )
    signs = np.where(np.arange(turns.size - 1) % 2 == 0, 1.0, -1.0)
    slow = np.concatenate([[0.0], np.cumsum(sweep.slow_acceleration * signs * np.diff(turns))])
    corners = np.union1d(ends, turns[turns < ends[-1]])
    both = np.interp(corners, ends, velocity) + np.interp(corners, turns, slow)
    return corners, both, int(np.searchsorted(corners, ends[n_slow]))


def _mean_acceleration(ends: FloatArray, velocity: FloatArray, times: FloatArray, rate: float) -> FloatArray:
    """Return the acceleration over the step of the clock about each time: the change of velocity by its length."""
    edges = np.append(times, times[-1] + 1.0 / rate) - 0.5 / rate
    mean: FloatArray = np.diff(np.interp(edges, ends, velocity)) * rate
    return mean
