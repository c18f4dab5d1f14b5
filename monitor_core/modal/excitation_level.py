"""Say which measurements are hardly comparable, because the axis was driven with another force.

Joints with play or friction are softer under a large force: the natural frequency of a wing with bolted joints (the
F-16 of the benchmarks of nonlinear identification) fell by 2 % at eight times the force. On an axis that reads as a
loss.
"""

import math
import statistics
from collections.abc import Sequence

from monitor_core.modal.measure import ModalMeasurement
from monitor_core.recording import ExcitationQuantity

#: An excitation this many times above or below the usual one is said. The calibration doubts from here on, too.
COMPARABLE_FACTOR = 1.5

#: Units of an excitation level, rms per root hertz.
LEVEL_UNITS = {ExcitationQuantity.TORQUE: "N·m/√Hz", ExcitationQuantity.FORCE: "N/√Hz"}


def excitation_remark(measurement: ModalMeasurement, usual: float, of_what: str) -> str | None:
    """Return what is said of a measurement whose excitation is not the usual one; ``None`` where it is.

    ``usual``: the level to compare with [N·m/√Hz] or [N/√Hz]; ``of_what``: whose it is, for the sentence.
    """
    ratio = measurement.excitation_level / usual
    if not (ratio > COMPARABLE_FACTOR or ratio < 1.0 / COMPARABLE_FACTOR):
        return None
    unit = LEVEL_UNITS[measurement.excitation_quantity]
    return (
        f"the excitation is {ratio:.2g} times that of {of_what} ({measurement.excitation_level:.2g} against "
        f"{usual:.2g} {unit} around the mode): where the frequency follows the force, that would pass for a change of "
        "preload"
    )


def session_remarks(measurements: Sequence[ModalMeasurement]) -> tuple[str | None, ...]:
    """Return a remark for each measurement of a session that was driven otherwise than most of its kind.

    The usual level is the median over the logarithms, of the same quantity from the same source: of two measurements
    each is compared with their geometric mean, so that the remark begins at a factor of 2.25 between them.
    """
    kinds = [(m.excitation_quantity, m.excitation_source) for m in measurements]
    usual = {
        kind: math.exp(
            statistics.median(
                math.log(m.excitation_level)
                for m, of in zip(measurements, kinds, strict=True)
                if of == kind and m.excitation_level > 0.0
            )
        )
        for kind in {kind for m, kind in zip(measurements, kinds, strict=True) if m.excitation_level > 0.0}
    }
    return tuple(
        excitation_remark(m, usual[kind], "the session's median") if kind in usual else None
        for m, kind in zip(measurements, kinds, strict=True)
    )
