"""Convert rows of a modal table to the core's readings."""

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
