"""Define the errors of the service, and the one table from error class to HTTP status."""

import logging
import math
from typing import TYPE_CHECKING

from monitor_core.errors import (
    InvalidWindowError,
    MissingReaderError,
    MonitorCoreError,
    NotIdentifiableError,
    OutsideValidityError,
    RecordingFormatError,
)

if TYPE_CHECKING:
    from pydantic import ValidationError
    from pydantic_core import ErrorDetails


class ServiceError(Exception):
    """Root of what the service refuses on purpose."""


class UnknownResourceError(ServiceError):
    """Nothing is stored under that name."""


class ConflictError(ServiceError):
    """What was sent contradicts what is stored."""


class UnreadableBodyError(ServiceError):
    """The request body is not what its content type says."""


class BodyTooLargeError(ServiceError):
    """The request body holds more than is read at once."""


class BodyTooSlowError(ServiceError):
    """The request body did not arrive in time."""


class InvalidRequestError(ServiceError):
    """The request lacks something, or holds what does not belong there."""


class NotAcceptableError(ServiceError):
    """The resource is not there in the format that the caller reads."""


class UnsupportedContentError(ServiceError):
    """The content type is not one that this resource reads."""


class PreconditionError(ServiceError):
    """The resource changed since the caller last saw it."""


class WaveformDamagedError(ServiceError):
    """A stored waveform is missing or not what was written."""


class LetGoError(ServiceError):
    """A waveform was let go by rule: it is not there any more, on purpose."""


class DocumentDamagedError(ServiceError):
    """A stored document is damaged, or of a version that this program does not read."""


class DataFolderError(ServiceError):
    """The service does not start on this data folder, or this database: told when it starts."""


class BusyError(ServiceError):
    """Too much work is waiting; the caller should come back."""


class UnauthenticatedError(ServiceError):
    """Nobody is known by what was sent, and somebody has to be."""


class ForbiddenError(ServiceError):
    """Whoever asks may not do this."""


class TooManyTriesError(ServiceError):
    """Too many wrong keys or passwords came; the next one has to wait."""

    def __init__(self, sentence: str, wait_s: float = 1.0) -> None:
        super().__init__(sentence)
        self.wait_s = wait_s

    @property
    def retry_after(self) -> str:
        """Return the value of the header ``Retry-After``: whole seconds, at least one."""
        return str(max(1, math.ceil(self.wait_s)))


class StorageError(ServiceError):
    """Disk or database did not take what was to be stored; nothing of it counts as stored."""


#: Most specific class first. The name of the problem type is stable; clients may rely on it.
STATUS_OF_ERROR: tuple[tuple[type[Exception], int, str], ...] = (
    (UnauthenticatedError, 401, "unauthenticated"),
    (ForbiddenError, 403, "forbidden"),
    (TooManyTriesError, 429, "too-many-tries"),
    (UnknownResourceError, 404, "unknown-resource"),
    (ConflictError, 409, "conflict"),
    (UnreadableBodyError, 400, "unreadable-body"),
    (BodyTooLargeError, 413, "body-too-large"),
    (BodyTooSlowError, 408, "body-too-slow"),
    (InvalidRequestError, 422, "invalid-request"),
    (NotAcceptableError, 406, "not-acceptable"),
    (UnsupportedContentError, 415, "unsupported-content"),
    (PreconditionError, 412, "precondition-failed"),
    (LetGoError, 410, "let-go"),
    (WaveformDamagedError, 500, "waveform-damaged"),
    (DocumentDamagedError, 500, "document-damaged"),
    (DataFolderError, 503, "data-folder"),
    (BusyError, 503, "busy"),
    (StorageError, 503, "storage-failed"),
    (InvalidWindowError, 422, "invalid-window"),
    (NotIdentifiableError, 422, "not-identifiable"),
    (OutsideValidityError, 422, "outside-validity"),
    (RecordingFormatError, 422, "recording-format"),
    (MissingReaderError, 501, "missing-reader"),
    (MonitorCoreError, 422, "refused"),
)


def status_of(error: Exception) -> tuple[int, str]:
    """Return the HTTP status and the stable problem name of an error."""
    for kind, status, name in STATUS_OF_ERROR:
        if isinstance(error, kind):
            return status, name
    return 500, "internal-error"


def refusal_in(error: BaseException | None) -> Exception | None:
    """Return the refusal that an error is, or that a library made its own error of; None for a fault of the program."""
    while error is not None:
        if isinstance(error, ServiceError | MonitorCoreError):
            return error
        error = error.__cause__
    return None


def tell_failure(log: logging.Logger, what: str, error: Exception) -> None:
    """Log what failed: a refusal in one line, a fault of the program with where it came from."""
    refusal = refusal_in(error)
    if refusal is None:
        log.error(what, exc_info=error)
    else:
        log.warning("%s: %s", what, refusal)


def sentence_of(item: "ErrorDetails") -> str:
    """Return what was expected of a member and, where it is short enough to be shown, what was got."""
    message = str(item["msg"]).removeprefix("Value error, ")
    got = item.get("input", item)
    if isinstance(got, str | int | float | None) and item["type"] != "missing" and "got" not in message:
        message += f"; got {got[:50]!r}" if isinstance(got, str) else f"; got {got}"
    return message


def first_refusal(error: "ValidationError", *, shows_input: bool = True) -> str:
    """Return which member was refused first and why; without ``shows_input``, a secret in it is not told."""
    item = error.errors(include_url=False, include_input=shows_input)[0]
    member = ".".join(str(part) for part in item["loc"] if part != "[key]")
    return f"{member}: {sentence_of(item)}" if member else sentence_of(item)
