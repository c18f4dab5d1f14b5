"""Replay of recorded sessions: the windows of a file through the same ingest as live ones."""

import time
from collections import Counter
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

from monitor_core.recordings.session_hdf5 import open_session
from service.errors import UnknownResourceError
from service.jobs import JobHandle
from service.operations.monitoring.ingest import Ingest, WindowStatus

SUFFIX = ".session.h5"


class Pace:
    """Waits so that recorded time passes at a multiple of real time; without a speed it never waits."""

    def __init__(self, speed: float | None, sleep: Callable[[float], None] = time.sleep) -> None:
        self._speed = speed
        self._sleep = sleep
        self._origin: tuple[datetime, float] | None = None

    def wait_for(self, moment: datetime) -> None:
        """Return when the recorded moment has come."""
        if self._speed is None:
            return
        if self._origin is None:
            self._origin = (moment, time.monotonic())
        recorded, started = self._origin
        due = started + (moment - recorded).total_seconds() / self._speed
        self._sleep(max(0.0, due - time.monotonic()))


class Replays:
    """Offers the sessions of one folder and replays them; the work of a job of kind ``replay``."""

    def __init__(self, folder: Path, ingest: Ingest) -> None:
        self._folder = folder
        self._ingest = ingest

    def sessions(self) -> list[str]:
        """Return the names of the sessions that can be replayed."""
        if not self._folder.is_dir():
            return []
        return sorted(path.name.removesuffix(SUFFIX) for path in self._folder.glob(f"*{SUFFIX}"))

    def require(self, session: str) -> None:
        """Refuse the name of a session that is not there."""
        if session not in self.sessions():
            known = ", ".join(self.sessions()) or "none"
            raise UnknownResourceError(f"no recorded session '{session}' in the replay folder; there are: {known}")

    def run(self, job: JobHandle) -> None:
        """Replay one session from where the job was interrupted; windows that are stored already are passed over."""
        pace = Pace(job.arguments["speed"], job.sleep)
        counts = job.result or {"windows_posted": 0, "windows_refused": 0, "windows_already_there": 0}
        with open_session(self._folder / (job.arguments["session"] + SUFFIX)) as session:
            sizes = Counter(session.measurement_of.values())
            total, done = sum(sizes.values()), 0
            job.report(job.done, total, counts)
            for measurement in session.measurements:
                done += sizes[measurement]
                if done <= job.done:
                    continue
                windows = session.windows_of(measurement)
                pace.wait_for(windows[0].started_at)
                receipt = self._ingest.ingest(job.axis_id, windows, complete=True)
                statuses = Counter(item.status for item in receipt.windows)
                counts = {
                    "windows_posted": counts["windows_posted"]
                    + statuses[WindowStatus.ACCEPTED]
                    + statuses[WindowStatus.REFUSED],
                    "windows_refused": counts["windows_refused"] + statuses[WindowStatus.REFUSED],
                    "windows_already_there": counts["windows_already_there"] + statuses[WindowStatus.ALREADY_THERE],
                }
                job.report(done, total, counts)
