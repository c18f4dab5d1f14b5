"""What can go wrong in the core: one tree, each class one sentence.

A refused window or measurement is no error but an outcome: see :class:`monitor_core.recording.Rejection`.
"""


class MonitorCoreError(Exception):
    """Root of every error that the core raises on purpose."""


class InvalidWindowError(MonitorCoreError, ValueError):
    """The parts of a window do not fit each other."""


class OutsideValidityError(MonitorCoreError, ValueError):
    """An argument lies outside the range in which the equation holds."""


class NotIdentifiableError(MonitorCoreError, ValueError):
    """The data cannot determine what was asked of them."""


class RecordingFormatError(MonitorCoreError, ValueError):
    """A file is not what its format promises."""


class MissingReaderError(MonitorCoreError, ImportError):
    """A file format, a picture or a table needs an optional library that is not installed."""
