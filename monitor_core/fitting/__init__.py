"""The bench: described axes, observations, residuals, fits and their evidence.

Identifying and explaining stand on it: what an axis is said to be (:class:`AxisDescription`), what was observed of it,
what differs (``residuals``, ``conditions``), what may be adjusted (``coordinates``, ``hypothesis``), the one fit
(``solver``), and what the fit is evidence of (``evidence``, ``hold_out``).
"""

from monitor_core.fitting.accelerometer import PLACES
from monitor_core.fitting.comparison import Panel
from monitor_core.fitting.described_axis import DescribedDrive
from monitor_core.fitting.description import AxisDescription
from monitor_core.fitting.observations import FrequencyResponseObservation, ModalObservation

__all__ = [
    "PLACES",
    "AxisDescription",
    "DescribedDrive",
    "FrequencyResponseObservation",
    "ModalObservation",
    "Panel",
]
