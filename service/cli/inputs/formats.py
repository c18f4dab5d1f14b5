"""Refuse a file of another kind than a command takes, whatever its name: what it is, and the next step with it."""

from pathlib import Path

from monitor_core.recordings.recognition import CALIBRATION, MODAL_TABLE, MODEL, SESSION, require_format


def of_format(path: Path, *expected: str) -> Path:
    """Return the path of a file if it is of one of these formats; raises as ``require_format``."""
    require_format(path, *expected)
    return path


def calibration_at(path: Path) -> Path:
    """Return the path of a calibration."""
    return of_format(path, CALIBRATION)


def model_at(path: Path) -> Path:
    """Return the path of a drive model."""
    return of_format(path, MODEL)


def session_at(path: Path) -> Path:
    """Return the path of a session."""
    return of_format(path, SESSION)


def is_session(path: Path) -> bool:
    """Tell a session from a modal table; any other file is refused."""
    return require_format(path, SESSION, MODAL_TABLE) == SESSION
