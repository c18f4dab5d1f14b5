"""Keep the recordings of axes: take an upload, say what is in it, import its windows as a job, remove it."""

import asyncio
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar, cast

from pydantic import BaseModel
from sqlalchemy.orm import Session

from monitor_core.errors import MissingReaderError, RecordingFormatError
from monitor_core.recordings.session_hdf5 import open_session
from service.clock import now
from service.documents.recording import FileEntry, LeftOutEntry, RecordingContents
from service.errors import ConflictError, InvalidRequestError, UnknownResourceError
from service.jobs import JobHandle, JobRunner
from service.json_types import JsonObject
from service.operations.foreign_file import reading
from service.operations.monitoring.intake.ingest import Ingest
from service.operations.monitoring.replay import COUNTS, Pace, take_session
from service.operations.own_process import Progress, Reporting
from service.operations.recordings.look import MOST_CHANNELS, Look, bounds_of, look_into, plain
from service.operations.recordings.upload import MAP_NAME, Upload, UploadedFile, write_map
from service.store import jobs, recordings
from service.store.axes import get_axis
from service.store.database import Database
from service.store.recordings import CHECKED, IMPORTED, UPLOADED, RecordingFiles
from service.store.tables import JobRow, RecordingRow

#: Kinds of jobs: one takes windows, the other says what is in the files.
KIND, CHECK = "import", "check"
#: Parts of uploads are written by so many threads; one recording is looked into at a time, since that takes memory.
WRITERS = 2

Done = TypeVar("Done")


class ImportArguments(BaseModel):
    """Which recording of the axis a job imports."""

    recording: int


@dataclass(frozen=True, slots=True)
class RecordingView:
    """A recording and the job that takes its windows."""

    row: RecordingRow
    job: JobRow


@dataclass(frozen=True, slots=True)
class Removed:
    """What became of a recording that was removed."""

    name: str
    windows_taken: int


class Recordings:
    """Keeps uploaded recordings; :meth:`run` is the work of a job of kind ``import``."""

    def __init__(
        self, database: Database, files: RecordingFiles, ingest: Ingest, runner: JobRunner, most_bytes: int
    ) -> None:
        self._database = database
        self._files = files
        self._ingest = ingest
        self._runner = runner
        self._most_bytes = most_bytes
        self._taking = threading.Lock()  # one at a time: it takes memory, and writes into the folder
        self._writers = ThreadPoolExecutor(max_workers=WRITERS, thread_name_prefix="uploads")
        self._lookers = ThreadPoolExecutor(max_workers=1, thread_name_prefix="recordings")
        with database.read() as session:
            files.clean_up(recordings.folders(session))

    async def begin(self, axis_id: str, declared_bytes: int) -> Upload:
        """Make room for an upload before it arrives.

        Raises UnknownResourceError, BusyError or StorageError if it could not be taken.
        """
        return await self._by(self._writers, partial(self._begin, axis_id, declared_bytes))

    async def write(self, upload: Upload, step: Callable[[], None]) -> None:
        """Do a step of an upload in a thread for such steps; raises what it raises."""
        await self._by(self._writers, partial(_at_work, upload, step))

    async def take(self, axis_id: str, upload: Upload) -> JobRow:
        """Look into what arrived, keep it, and begin to import its windows: one recording at a time.

        Raises what :func:`look_into` raises, and as :meth:`begin`; then nothing of it is kept.
        """
        return await self._by(self._lookers, partial(_at_work, upload, partial(self._take, axis_id, upload)))

    async def keep(self, axis_id: str, upload: Upload) -> JobRow:
        """Keep what arrived, and begin to look into it; its windows are taken when :meth:`take_kept` is asked to.

        Raises as :meth:`begin`; then nothing of it is kept.
        """
        return await self._by(self._writers, partial(_at_work, upload, partial(self._keep, axis_id, upload)))

    async def end(self, upload: Upload) -> None:
        """Remove what is not kept of an upload."""
        await self._by(self._writers, upload.close)

    def close(self) -> None:
        """Finish what is under way."""
        self._lookers.shutdown()
        self._writers.shutdown()

    @staticmethod
    async def _by(threads: ThreadPoolExecutor, step: Callable[[], Done]) -> Done:
        return await asyncio.get_running_loop().run_in_executor(threads, step)

    def _begin(self, axis_id: str, declared_bytes: int) -> Upload:
        self._runner.require_place(KIND, axis_id)
        self._files.require_room(declared_bytes)
        return Upload(self._files.begin(), self._most_bytes, self._files.require_room)

    def _take(self, axis_id: str, upload: Upload) -> JobRow:
        upload.require_whole()
        look = self._look(upload.paths, None if upload.map_text is None else upload.map_path, upload.folder.path)
        return self._stored(axis_id, upload, look, CHECKED, KIND)

    def _keep(self, axis_id: str, upload: Upload) -> JobRow:
        upload.require_whole()
        return self._stored(axis_id, upload, Look(upload.paths[0], axis_id, 0, 0, []), UPLOADED, CHECK)

    def _stored(self, axis_id: str, upload: Upload, look: Look, state: str, kind: str) -> JobRow:
        """Keep what arrived, and begin the job that goes on with it."""
        folder = upload.folder
        folder.sync()

        def store(session: Session, job: JobRow) -> JsonObject:
            row = RecordingRow(
                axis_id=axis_id, name=upload.files[0].name, sha256=upload.sha256, size_bytes=upload.size_bytes,
                state=state, problems=_problems(look, axis_id), channel_map=upload.map_text,
                contents=_contents(look, upload.files, folder.path).model_dump(mode="json"), folder=folder.name,
                job_id=job.id, created_at=now(),
            )  # fmt: skip
            session.add(row)
            session.flush()
            folder.keep()  # before the commit: one that fails may yet have happened (a lost connection)
            return ImportArguments(recording=row.id).model_dump()

        job = self._runner.submit(kind, axis_id, {}, store)
        self._files.folder(folder.name)
        return job

    def _look(self, paths: Sequence[Path], map_path: Path | None, folder: Path) -> Look:
        bounds = bounds_of(self._most_bytes, self._files.room())
        with reading(Reporting(partial(look_into, paths, map_path, folder, bounds)), paths[0].name) as process:
            return cast(Look, process.answer())

    def take_kept(self, axis_id: str, recording_id: int, map_text: str | None) -> JobRow:
        """Look into a recording that was kept, with the map of its channels, and begin to import its windows.

        Raises what :func:`look_into` raises: then it stays as it was, to be tried with another map. ConflictError if
        somebody else has begun to, or it is being looked into.
        """
        row = self.get(axis_id, recording_id).row
        self._require_kept(row)
        folder, files = self._files.folder(row.folder), contents_of(row).files
        map_path = folder / MAP_NAME
        with self._taking:
            self._require_kept(self.get(axis_id, recording_id).row)
            if map_text is not None:
                write_map(map_path, map_text)
            paths = [folder / "files" / file.name for file in files]
            look = self._look(paths, None if map_text is None else map_path, folder)

            def store(session: Session, job: JobRow) -> JsonObject:
                kept = recordings.get_recording(session, axis_id, recording_id)
                self._require_kept(kept)
                kept.state, kept.problems, kept.channel_map = CHECKED, _problems(look, axis_id), map_text
                kept.contents = _contents(look, files, folder).model_dump(mode="json")
                kept.job_id = job.id
                return ImportArguments(recording=recording_id).model_dump()

            return self._runner.submit(KIND, axis_id, {}, store)

    def _require_kept(self, row: RecordingRow) -> None:
        if row.state != UPLOADED:
            raise ConflictError(f"the windows of recording {row.id} are taken already, by job {row.job_id}")

    def list(self, axis_id: str, cursor: int | None, limit: int) -> list[RecordingView]:
        """Return recordings of an axis, newest first."""
        with self._database.read() as session:
            get_axis(session, axis_id)
            rows = recordings.list_recordings(session, axis_id, cursor, limit)
            return [RecordingView(row, jobs.get_job(session, row.job_id)) for row in rows]

    def get(self, axis_id: str, recording_id: int) -> RecordingView:
        """Return one recording."""
        with self._database.read() as session:
            row = recordings.get_recording(session, axis_id, recording_id)
            return RecordingView(row, jobs.get_job(session, row.job_id))

    def file(self, axis_id: str, recording_id: int, name: str | None) -> Path:
        """Return where an uploaded file is; of several the name says which."""
        row = self.get(axis_id, recording_id).row
        names = [file.name for file in contents_of(row).files]
        if name is None and len(names) > 1:
            raise InvalidRequestError(
                f"/name: expected one of its {len(names)} files: {', '.join(names)[:500]}; got none"
            )
        if name is not None and name not in names:
            known = ", ".join(names)[:500]
            raise UnknownResourceError(f"recording {recording_id} has no file {name[:100]!r}; it has {known}")
        return self._existing(row, f"files/{name or names[0]}")

    def session_file(self, axis_id: str, recording_id: int) -> Path:
        """Return where the session is whose windows are taken: as uploaded, or made of raw files and their map."""
        row = self.get(axis_id, recording_id).row
        return self._existing(row, contents_of(row).session)

    def remove(self, axis_id: str, recording_id: int) -> Removed:
        """Remove a recording and its files; windows that were taken from it stay.

        Raises ConflictError while they are being taken.
        """
        folder = None
        try:
            with self._database.write() as session:
                row = recordings.get_recording(session, axis_id, recording_id)
                job = jobs.get_job(session, row.job_id)
                if job.status in (jobs.QUEUED, jobs.RUNNING):
                    raise ConflictError(
                        f"the windows of recording {recording_id} are being taken; cancel job {job.id}, or wait for it"
                    )
                session.delete(row)
                session.flush()
                folder = row.folder
                self._files.begin_removal(folder)
        except BaseException:
            if folder is not None:
                self._files.undo_removal(folder)
            raise
        self._files.end_removal(folder)
        counts = COUNTS.validate_python(job.result or {})
        return Removed(row.name, counts.windows_posted + counts.windows_already_there)

    def check(self, job: JobHandle) -> None:
        """Look into the files of a recording, in a process of its own; what is in them is the result of the job."""
        from service.operations.recordings.file_check import checked, unreadable  # noqa: PLC0415  # a start reads no file

        number = ImportArguments.model_validate(job.arguments).recording
        row = self.get(job.axis_id, number).row
        folder = self._files.folder(row.folder) / "files"
        paths = [folder / file.name for file in contents_of(row).files]

        def report(progress: Progress) -> None:
            job.report(progress.done, progress.total, {})

        try:
            with reading(Reporting(partial(checked, paths, job.axis_id)), paths[0].name) as process:
                contents = cast(JsonObject, process.answer(report, Progress(0, len(paths))))
        except (RecordingFormatError, MissingReaderError) as error:
            contents = unreadable(paths[0].name, str(error))
        job.report(len(paths), len(paths), contents)

    def run(self, job: JobHandle) -> None:
        """Import the windows of a recording from where the job was interrupted, as a replay does."""
        number = ImportArguments.model_validate(job.arguments).recording
        with open_session(self.session_file(job.axis_id, number)) as session:
            take_session(session, self._ingest, job, Pace(None))
        with self._database.write() as write:
            recordings.get_recording(write, job.axis_id, number).state = IMPORTED

    def _existing(self, row: RecordingRow, name: str) -> Path:
        path = self._files.folder(row.folder) / name
        if not path.is_file():
            raise UnknownResourceError(f"the file of recording {row.id} is missing in the data folder")
        return path


def _at_work(upload: Upload, step: Callable[[], Done]) -> Done:
    with upload.at_work():
        return step()


def contents_of(row: RecordingRow) -> RecordingContents:
    """Return what was found in a recording."""
    return RecordingContents.model_validate(row.contents)


def _contents(look: Look, files: Sequence[UploadedFile | FileEntry], folder: Path) -> RecordingContents:
    return RecordingContents(
        axis_id=look.axis_id,
        session=str(look.session_path.relative_to(folder)),
        n_windows=look.n_windows,
        n_measurements=look.n_measurements,
        files=[FileEntry(name=file.name, size_bytes=file.size_bytes, sha256=file.sha256) for file in files],
        channels=look.channels,
        left_out=[LeftOutEntry(what=plain(item.what), why=plain(item.why)) for item in look.left_out[:MOST_CHANNELS]],
    )


def _problems(look: Look, axis_id: str) -> list[str]:
    """Return what does not keep a recording from being taken, a sentence each."""
    problems = [plain(remark) for remark in look.remarks]
    if look.axis_id != axis_id:
        problems.append(
            f"the recording says that it is of axis '{look.axis_id}'; its windows are taken for '{axis_id}'"
        )
    return problems
