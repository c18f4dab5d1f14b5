"""Which share of the compliance of an axis depends on the preload, by its drive model."""

from functools import lru_cache

from monitor_core.errors import MonitorCoreError
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
