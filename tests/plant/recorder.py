"""Writer of recorded sessions, kept apart from the product's own: byte for byte the same for the same content."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class RecordedWindow:
    """One window as it goes into a file, in the units of the file."""

    measurement: str
    started_at: datetime
    sample_rate_hz: float
    excitation: NDArray[np.float32]  # torque [N·m]
    response: NDArray[np.float32]  # acceleration [m/s²]
    position: NDArray[np.float32]  # [m]
    position_mm: float
    payload_kg: float
    temperature_c: float
    preload_n: float | None = None
    excitation_source: str = "sensor"


def write_session(path: Path, axis_id: str, description: str, created: datetime, windows: list[RecordedWindow]) -> None:
    """Write windows in time order to an HDF5 session."""
    # The latest layout has no B-tree for a dataset of one chunk: 2 kB less for each of the three in a window.
    with h5py.File(path, "w", libver="latest", track_order=False) as file:
        file.attrs["format"] = "preload-session"
        file.attrs["version"] = 1
        file.attrs["axis_id"] = axis_id
        file.attrs["description"] = description
        file.attrs["created"] = created.isoformat()
        group = file.create_group("windows")
        for number, window in enumerate(sorted(windows, key=lambda w: w.started_at)):
            name = f"{number:06d}".encode()
            _write_window(h5py.Group(h5py.h5g.create(group.id, name, gcpl=_compact_attributes())), window)


def _compact_attributes() -> h5py.h5p.PropGCID:
    """Keep a window's attributes in its header: more than eight of them would otherwise get a heap of 2 kB."""
    properties = h5py.h5p.create(h5py.h5p.GROUP_CREATE)
    properties.set_attr_phase_change(32, 0)
    properties.set_obj_track_times(False)
    return properties


def _write_window(group: h5py.Group, window: RecordedWindow) -> None:
    for name in ("excitation", "response", "position"):
        samples = getattr(window, name)
        group.create_dataset(
            name,
            data=samples,
            chunks=samples.shape,
            shuffle=True,
            compression="gzip",
            compression_opts=9,
            track_times=False,
        )
    attributes = {
        "started_at": window.started_at.isoformat(),
        "sample_rate_hz": window.sample_rate_hz,
        "excitation_quantity": "torque",
        "excitation_unit": "N.m",
        "excitation_source": window.excitation_source,
        "response_quantity": "acceleration",
        "response_unit": "m/s2",
        "position_mm": window.position_mm,
        "position_span_mm": round(1e3 * float(np.ptp(window.position.astype(np.float64))), 4),
        "direction": "both",
        "measurement": window.measurement,
        "payload_kg": window.payload_kg,
        "temperature_c": window.temperature_c,
        "preload_n": window.preload_n,
    }
    for name, value in attributes.items():
        if value is not None:
            group.attrs[name] = value
