"""Talk to Preload Monitor from Python: :class:`Client`, or :class:`AsyncClient` in an event loop. Needs httpx alone."""

from preload_client.client import AsyncClient as AsyncClient, Client as Client
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
    Calibration as Calibration,
    Calibrations as Calibrations,
    Job as Job,
    LostMotionPoint as LostMotionPoint,
    LostMotionReceipt as LostMotionReceipt,
    MaintenanceEntry as MaintenanceEntry,
    Measurement as Measurement,
    Receipt as Receipt,
    TrendPoint as TrendPoint,
    WindowStatus as WindowStatus,
)
