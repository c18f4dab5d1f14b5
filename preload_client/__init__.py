"""Talk to Preload Monitor from Python: :class:`Client`. Needs httpx and nothing else of the service."""

from preload_client.client import Client
from preload_client.errors import JobFailedError, PreloadError, ProblemError, UnreachableError
from preload_client.records import Alarm, AlarmEvent, Axis, Job, Receipt, TrendPoint, WindowStatus

__all__ = [
    "Alarm",
    "AlarmEvent",
    "Axis",
    "Client",
    "Job",
    "JobFailedError",
    "PreloadError",
    "ProblemError",
    "Receipt",
    "TrendPoint",
    "UnreachableError",
    "WindowStatus",
]
