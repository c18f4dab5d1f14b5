"""Say what went wrong: each class in one line, the words of the service in the exception."""

from preload_client.records import Document, Job


class PreloadError(Exception):
    """Root of what a client raises."""


class UnreachableError(PreloadError):
    """No service answered; of a request that may not be repeated it is unknown whether it was carried out."""


class ProblemError(PreloadError):
    """The service refused: its problem document (RFC 9457), of which ``name`` is stable."""

    def __init__(self, method: str, path: str, status: int, document: Document) -> None:
        self.status = status
        self.document = document
        self.name = str(document.get("type", "")).rpartition(":")[2]
        self.detail = str(document.get("detail", ""))
        super().__init__(f"{method} {path} was refused with {status}: {self.detail}")


class JobFailedError(PreloadError):
    """A job failed or was cancelled."""

    def __init__(self, job: Job) -> None:
        self.job = job
        super().__init__(
            f"job {job['id']} ({job['kind']} of {job['axis']}) is {job['status']}: {job['error'] or 'none'}"
        )
