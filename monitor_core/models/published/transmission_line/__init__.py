"""Transmission-line model (Moreno-Castaneda et al., 2005): waves on the screw, step by step.

``grid`` cuts the lines into sections, ``kernel`` steps the waves through them and through the ``junctions``, ``motion``
runs a drive in time; ``mobility`` and ``modes`` say what the same discretised drive does at a frequency.
"""

from monitor_core.models.published.transmission_line.grid import (
    DriveFriction as DriveFriction,
    LineGrid as LineGrid,
    SpeedControl as SpeedControl,
    StribeckFriction as StribeckFriction,
    TransmissionLineParameters as TransmissionLineParameters,
    closest_common_step_grid as closest_common_step_grid,
    common_step_grid as common_step_grid,
    discretise as discretise,
    synchronised_grid as synchronised_grid,
)
from monitor_core.models.published.transmission_line.model import (
    DriveMotion as DriveMotion,
    DriveRun as DriveRun,
    TransmissionLineModel as TransmissionLineModel,
    simulate_drive as simulate_drive,
)
