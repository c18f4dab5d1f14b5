"""Turn rows of a modal table into the core's readings and observations."""

import numpy as np

from monitor_core.fitting.observations import ModalObservation
from monitor_core.models.protocol import DriveConditions
from monitor_core.preload import ModalReading
from monitor_core.recording import Conditions
from monitor_core.recordings.modal_csv import ModalRow


def modal_reading(row: ModalRow) -> ModalReading:
    """Return the reading; positions are metres on both sides."""
    return ModalReading(
        frequency=row.frequency,
        conditions=Conditions(row.position, row.payload_mass, row.temperature, row.preload),
        frequency_std=row.frequency_std,
        n_readings=row.n_readings or 1,
    )


def modal_observation(row: ModalRow) -> ModalObservation:
    """Return a row of a modal table as a peak; its amplitude is the table's receptance, in m/N.

    The table states no uncertainty of a damping ratio.
    """
    uncertainty = None if row.frequency_std is None else row.frequency_std / np.sqrt(row.n_readings or 1)
    return ModalObservation(
        DriveConditions(row.position, row.preload, row.payload_mass or 0.0),
        row.frequency,
        None if uncertainty is None else float(uncertainty),
        amplitude=row.amplitude,
        order=row.mode,
        damping_ratio=row.damping_ratio,
    )
