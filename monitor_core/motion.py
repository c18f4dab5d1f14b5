"""Record of a rigid axis driven through its working motion."""

import math
from dataclasses import dataclass

import numpy as np

from monitor_core.arrays import FloatArray, read_only
from monitor_core.errors import OutsideValidityError
from monitor_core.recording import ExcitationQuantity


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
