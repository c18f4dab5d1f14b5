"""The EMPS record of others: a real ball-screw axis, four laps at 1 kHz. Nothing of it is kept in the project."""

from functools import cache
from pathlib import Path

import pytest
import scipy.io

from monitor_core.recording import MotionRecord


@cache
def emps_record(measured_data: Path) -> MotionRecord:
    """Return position, reference and motor force: volts times the stated 35.15 N/V."""
    path = measured_data / "emps" / "DATA_EMPS.mat"
    if not path.is_file():
        pytest.skip(f"no EMPS record at {path}")
    data = scipy.io.loadmat(path)
    force = data["vir"].ravel() * data["gtau"].item()
    return MotionRecord(1000.0, data["qm"].ravel(), force, reference=data["qg"].ravel())
