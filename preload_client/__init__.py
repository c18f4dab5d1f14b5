"""Talk to Preload Monitor from Python: :class:`Client`. Needs httpx and nothing else of the service."""

from preload_client.client import Client as Client
from preload_client.errors import (
    JobFailedError as JobFailedError,
    PreloadError as PreloadError,
    ProblemError as ProblemError,
    UnreachableError as UnreachableError,
)
from preload_client.records import (
    Alarm as Alarm,
    AlarmEvent as AlarmEvent,
    Axis as Axis,
    Job as Job,
    LostMotionPoint as LostMotionPoint,
    LostMotionReceipt as LostMotionReceipt,
    Receipt as Receipt,
    TrendPoint as TrendPoint,
    WindowStatus as WindowStatus,
)
