"""Read and write a motion record, CSV: ``time_s,position_m,force_n`` (or ``torque_nm``), optionally ``reference_m``.

Sampling is uniform: the rate is that of the first and the last time, and no sample is missing between them.
Other columns are allowed and left out. Decimals carry a point; the text is UTF-8.
"""

from pathlib import Path

import numpy as np

from monitor_core.arrays import FloatArray
from monitor_core.errors import RecordingFormatError
from monitor_core.recording import ExcitationQuantity, MotionProfile, MotionRecord
from monitor_core.recordings.elements.files import naming
from monitor_core.recordings.raw.channels import Channels
from monitor_core.recordings.raw.text import columns

TIME, POSITION, REFERENCE = "time_s", "position_m", "reference_m"
SPEED, CUTTING = "speed_m_per_s", "cutting_force_n"
DRIVES = {"force_n": ExcitationQuantity.FORCE, "torque_nm": ExcitationQuantity.TORQUE}
#: By which a step of time may differ from the mean one, as a part of it: times are printed to few digits, and a sample
#: that is missing makes a step twice as long.
JITTER = 0.5
FEWEST_SAMPLES = 100


def is_motion_header(columns: list[str]) -> bool:
    """Tell a motion record from other columns of numbers by the names in its header."""
    return TIME in columns and POSITION in columns and any(name in columns for name in DRIVES)


def read_motion_record(path: Path) -> MotionRecord:
    """Read a motion record, CSV with a header.

    ``RecordingFormatError`` if a column is missing, both force and torque are there, the sampling is not uniform, or a
    value is not finite.
    """
    channels = columns.read_channels(path)
    drives = [name for name in DRIVES if name in channels.names]
    if len(drives) != 1:
        got = " and ".join(drives) or f"neither in {', '.join(channels.names)[:200]}"
        raise RecordingFormatError(f"{path.name}: expected one of the columns {' and '.join(DRIVES)}; got {got}")
    time, position = _column(channels, TIME), _column(channels, POSITION)
    if time.size < FEWEST_SAMPLES:
        raise RecordingFormatError(
            f"{path.name}: expected a motion of at least {FEWEST_SAMPLES} samples; got {time.size}"
        )
    with naming(path.name):
        return MotionRecord(
            _sample_rate(time, path.name),
            position,
            _column(channels, drives[0]),
            DRIVES[drives[0]],
            _column(channels, REFERENCE) if REFERENCE in channels.names else None,
        )


def read_motion_profile(path: Path) -> MotionProfile:
    """Read a motion that a control shall follow: ``time_s``, ``position_m`` or ``speed_m_per_s``, ``cutting_force_n``.

    Times only rise. ``RecordingFormatError`` if a column is missing, both position and speed are there, or a value is
    not finite.
    """
    channels = columns.read_channels(path)
    followed = [name for name in (POSITION, SPEED) if name in channels.names]
    if len(followed) != 1:
        got = " and ".join(followed) or f"neither in {', '.join(channels.names)[:200]}"
        raise RecordingFormatError(f"{path.name}: expected one of the columns {POSITION} and {SPEED}; got {got}")
    with naming(path.name):
        return MotionProfile(
            _column(channels, TIME),
            _column(channels, followed[0]),
            followed[0] == SPEED,
            _column(channels, CUTTING) if CUTTING in channels.names else None,
        )


def write_motion_record(path: Path, record: MotionRecord) -> None:
    """Write a motion record; what is written is read back to the last bit, time excepted.

    An existing file is replaced.
    """
    drive = next(name for name, quantity in DRIVES.items() if quantity is record.quantity)
    columns = {TIME: record.time, POSITION: record.position, drive: record.drive}
    if record.reference is not None:
        columns[REFERENCE] = record.reference
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _column(channels: Channels, name: str) -> FloatArray:
    return np.asarray(channels.channel(name).samples, dtype=np.float64)


def _sample_rate(time: FloatArray, where: str) -> float:
    steps = np.diff(time)
    mean = float((time[-1] - time[0]) / steps.size)
    if not mean > 0.0:
        raise RecordingFormatError(
            f"{where}, column {TIME!r}: expected times that rise; got {time[0]:g} to {time[-1]:g} s"
        )
    away = np.abs(steps - mean)
    worst = int(away.argmax())
    if not away[worst] <= JITTER * mean:
        raise RecordingFormatError(
            f"{where}, column {TIME!r}: expected uniform sampling, every {mean:g} s; got a step of {steps[worst]:g} s "
            f"after {time[worst]:g} s"
        )
    return 1.0 / mean
