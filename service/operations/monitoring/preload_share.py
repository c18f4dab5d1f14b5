"""What a drive model says of an axis without a calibration: the share of the preload, and the law of the position."""

from functools import lru_cache

from monitor_core.errors import MonitorCoreError
from monitor_core.preload import DriveLaw
from monitor_core.recording import ExcitationSource
from monitor_core.uncertainty import Interval


@lru_cache(maxsize=1024)  # of one model the modes are computed once
def preload_share(drive_model: str | None) -> Interval | None:
    """Return the interval of that share [-]; None without a drive model, or where its nut follows no preload."""
    if drive_model is None:
        return None
    from monitor_core.models.preload_share import share_of_preload  # noqa: PLC0415  # many axes have no model
    from monitor_core.recordings.model_file import parse_model  # noqa: PLC0415

    try:
        return share_of_preload(parse_model(drive_model, "drive_model").build())
    except MonitorCoreError:
        return None


@lru_cache(maxsize=1024)
def drive_law(drive_model: str | None, excitation_source: str) -> DriveLaw | None:
    """Return how 1/f² follows the position by a drive model; None without one, or where it does not say enough."""
    if drive_model is None:
        return None
    from monitor_core.identification import law_of_drive  # noqa: PLC0415  # many axes have no model
    from monitor_core.recordings.model_file import parse_model  # noqa: PLC0415

    try:
        return law_of_drive(parse_model(drive_model, "drive_model"), ExcitationSource(excitation_source))
    except MonitorCoreError:
        return None
