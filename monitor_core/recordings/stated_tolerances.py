"""Read how well the settings of a session or an FRF set are known: attributes of the root of either file."""

from collections.abc import Mapping
from pathlib import Path

from monitor_core.recordings.elements.files import refusing
from monitor_core.recordings.elements.hdf5 import attributes, open_hdf5

#: By name; the unit is said in a message.
UNITS = {
    "position_tolerance_mm": "mm",
    "preload_tolerance": "1",
    "gain_tolerance": "1",
    "payload_tolerance_kg": "kg",
    "temperature_tolerance_k": "K",
}


def read_tolerances(path: Path) -> Mapping[str, float]:
    """Return the tolerances that a file states, by the names of its attributes.

    ``RecordingFormatError`` if the file is no HDF5 file or one of them is no positive number.
    """
    with open_hdf5(path) as file, refusing(path.name, "readable attributes"):
        root = attributes(file, frozenset(UNITS), f"{path.name} /")
        return {name: root.positive(name, unit) for name, unit in UNITS.items() if name in root}
