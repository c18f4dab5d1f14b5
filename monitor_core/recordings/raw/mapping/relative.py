"""Take the way of a scale from that of its motor: what is left is the compliance of the drive between them."""

from dataclasses import replace

import numpy as np

from monitor_core.errors import RecordingFormatError
from monitor_core.recordings.raw.mapping.mapped import Record

#: By so much may scale and motor go apart where they go together: at a mode one moves more than the other.
_LEAST, _MOST = 0.5, 2.0


def with_relative_displacement(record: Record) -> Record:
    """Return a record whose response is the way of the motor less that of the scale [m].

    Signals are excitation, scale and motor, both in metres, and others behind them; the scale goes behind these, for it
    says how far the table goes. ``RecordingFormatError`` if one
    goes so much farther than the other that the lead is another one, or if they count against each other.
    """
    excitation, scale, motor, *others = record.signals
    with np.errstate(invalid="ignore"):
        by_scale, by_motor = scale.astype(np.float64), motor.astype(np.float64)
    known = np.isfinite(by_scale) & np.isfinite(by_motor)
    x, y = by_motor[known], by_scale[known]
    x, y = x - x.mean(), y - y.mean()
    together, power = float(x @ y), float(x @ x)
    ratio = together / power if power > 0.0 else 1.0
    if not _LEAST <= ratio <= _MOST:
        raise RecordingFormatError(
            f"{record.file_name}, {record.names[2]}: expected a motor that moves {record.names[1]!r} by lead_mm for a "
            f"turn; it goes {ratio:.3g} times as far: lead_mm times {ratio:.3g} would fit, if the units are right"
        )
    names = (record.names[0], f"{record.names[2]} less {record.names[1]}", *record.names[3:], record.names[1])
    return replace(record, names=names, signals=(excitation, by_motor - by_scale, *others, scale))
