"""Store the reports of jobs as files ``reports/<job>.html``, written whole or not at all."""

from pathlib import Path

from service.errors import StorageError, UnknownResourceError


class ReportStore:
    """Writes and reads the pages below one folder."""

    def __init__(self, root: Path) -> None:
        self._folder = root / "reports"

    def write(self, job_id: str, page: str) -> None:
        """Write the report of a job; an earlier one, of a run that was interrupted, is replaced.

        Raises StorageError if the disk does not take it.
        """
        path = self._path(job_id)
        half_written = path.with_suffix(".part")
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            half_written.write_text(page, encoding="utf-8")
            half_written.replace(path)
        except OSError as error:
            raise StorageError(f"the report of job {job_id} was not stored: {error}") from error

    def read(self, job_id: str) -> str:
        """Return the report of a job.

        Raises UnknownResourceError if there is none.
        """
        try:
            return self._path(job_id).read_text(encoding="utf-8")
        except FileNotFoundError as error:
            raise UnknownResourceError(f"job '{job_id}' has no report") from error

    def _path(self, job_id: str) -> Path:
        return self._folder / f"{job_id}.html"
