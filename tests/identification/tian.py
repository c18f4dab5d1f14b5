"""Tian's published tables as observations."""

import csv
import tomllib
from pathlib import Path

from monitor_core.fitting.coordinates import FreeParameters
from monitor_core.fitting.observations import AssignedPeak, ModalObservation
from monitor_core.fitting.residuals.peak_search import Band
from monitor_core.models.parameters import name_in_file
from monitor_core.models.protocol import DriveConditions
from monitor_core.models.published.receptance import JOINT_NAMES, ReceptanceParameters

PUBLISHED = Path(__file__).resolve().parents[2] / "replay_data" / "published"
POSITIONS = {"l1": 0.6, "l2": 0.8, "l3": 1.0, "l4": 1.3, "l5": 1.6, "l6": 1.9}
#: Where the paper sees its four orders [Hz]: the paper names 24, 115, 540 and 720 Hz and states no bands.
BANDS = {1: Band(12.0, 45.0), 2: Band(85.0, 160.0), 3: Band(470.0, 640.0), 4: Band(650.0, 860.0)}
#: Limits of the joints [SI]: decades around what bearings, nuts and couplings have.
LIMITS = {
    "bearing_stiffness_n_per_m": (5e6, 2e8), "far_bearing_stiffness_n_per_m": (5e6, 2e8),
    "nut_stiffness_n_per_m": (1e8, 3e9), "coupling_stiffness_nm_per_rad": (1.0, 1e4),
    "bearing_damping_ns_per_m": (1e2, 1e5), "far_bearing_damping_ns_per_m": (1e2, 1e5),
    "nut_damping_ns_per_m": (1e2, 1e6), "coupling_damping_nms_per_rad": (1e-4, 10.0),
}  # fmt: skip
#: Table 2 prints "FRF values / m" and means mm/N (docs/reference/errata.md).
METRES_PER_NEWTON = 1e-3


def axis() -> ReceptanceParameters:
    """Table A, with the joints of the shipped model."""
    text = (PUBLISHED.parent / "models" / "receptance.toml").read_text(encoding="utf-8")
    return ReceptanceParameters.from_file_names(tomllib.loads(text)["parameters"], "receptance")


def measured(*names: str) -> tuple[ModalObservation, ...]:
    """Tables 1 and 2 at the named positions; amplitudes where they are printed."""
    with (PUBLISHED / "tian_measured.csv").open(newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row["position"] in names]
    return tuple(
        ModalObservation(
            DriveConditions(float(row["position_m"])),
            float(row["frequency_hz"]),
            amplitude=float(row["amplitude_printed"]) * METRES_PER_NEWTON if row["amplitude_printed"] else None,
            order=int(row["order"]),
        )
        for row in rows
    )


def as_labelled(observations: tuple[ModalObservation, ...]) -> tuple[AssignedPeak, ...]:
    """Take the paper's orders for the modes."""
    return tuple(AssignedPeak(observation, observation.order) for observation in observations)


def free(axis: ReceptanceParameters, *joints: str) -> FreeParameters:
    """Free some joints of an axis, by their names in the record; without any all eight."""
    return FreeParameters(
        "receptance", axis.to_file_names(), tuple(name_in_file(joint) for joint in joints or JOINT_NAMES)
    )
