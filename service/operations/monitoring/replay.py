"""Replay of recorded sessions: the windows of a file through the same ingest as live ones."""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Final, Self

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from monitor_core.recordings.session_hdf5 import SessionReader, open_session
from service.errors import UnknownResourceError
from service.jobs import JobHandle, JobRunner
from service.operations.fields import Number
from service.operations.monitoring.intake.batch import WindowStatus
from service.operations.monitoring.intake.ingest import Ingest
from service.store.tables import JobRow

KIND: Final = "replay"
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


class ReplayIn(BaseModel):
    """Which recorded session to replay, and how fast."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, json_schema_extra={"examples": [{"session": "slow-wear", "speed": None}]}
    )

    session: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,99}$", description="one of GET /v1/sessions")]
    speed: Annotated[Number, Field(ge=1e-3, le=1e6)] | None = Field(
        default=None, description="times real time; null is as fast as possible"
    )


@dataclass(frozen=True, slots=True)
class WindowCounts:
    """What became of the windows of a session."""

    windows_posted: int = 0  # those that were not there yet
    windows_refused: int = 0
    windows_already_there: int = 0

    def __add__(self, other: Self) -> "WindowCounts":
        return WindowCounts(
            self.windows_posted + other.windows_posted,
            self.windows_refused + other.windows_refused,
            self.windows_already_there + other.windows_already_there,
        )


COUNTS = TypeAdapter(WindowCounts)


class Replays:
    """Offers the sessions of one folder and replays them; the work of a job of kind ``replay``."""

    def __init__(self, folder: Path, ingest: Ingest, runner: JobRunner) -> None:
        self._folder = folder
        self._ingest = ingest
        self._runner = runner
        runner.work[KIND] = self.run

    def sessions(self) -> list[str]:
        """Return the names of the sessions that can be replayed."""
        if not self._folder.is_dir():
            return []
        return sorted(path.name.removesuffix(SUFFIX) for path in self._folder.glob(f"*{SUFFIX}"))

    def start(self, axis_id: str, asked: ReplayIn) -> JobRow:
        """Begin in the background; UnknownResourceError if there is no such session, or axis."""
        if asked.session not in self.sessions():
            names = ", ".join(self.sessions()) or "none"
            raise UnknownResourceError(
                f"no recorded session '{asked.session}' in the replay folder; there are: {names}"
            )
        return self._runner.submit(KIND, axis_id, asked.model_dump())

    def run(self, job: JobHandle) -> None:
        """Replay one session from where the job was interrupted; windows that are stored already are passed over."""
        arguments = ReplayIn.model_validate(job.arguments)
        with open_session(self._folder / (arguments.session + SUFFIX)) as session:
            take_session(session, self._ingest, job, Pace(arguments.speed, job.sleep))


def take_session(session: SessionReader, ingest: Ingest, job: JobHandle, pace: Pace) -> None:
    """Take the windows of a session as live ones, measurement by measurement, as far as the job has not come yet."""
    counts = COUNTS.validate_python(job.result or {})
    sizes = Counter(session.measurement_of.values())
    total, done = sum(sizes.values()), 0
    job.report(job.done, total, asdict(counts))
    for measurement in session.measurements:
        done += sizes[measurement]
        if done <= job.done:
            continue
        windows = session.windows_of(measurement)
        pace.wait_for(windows[0].started_at)
        receipt = ingest.ingest(job.axis_id, windows, complete=True)
        statuses = Counter(item.status for item in receipt.windows)
        refused = statuses[WindowStatus.REFUSED]
        posted = statuses[WindowStatus.ACCEPTED] + refused
        counts += WindowCounts(posted, refused, statuses[WindowStatus.ALREADY_THERE])
        job.report(done, total, asdict(counts))
