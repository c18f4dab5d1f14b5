"""``/v1/axes/{axis}/recordings``: recordings in, kept and removed; stored windows out again."""

from datetime import datetime
from functools import partial
from typing import Annotated, Literal

from fastapi import Query, Request, Response
from fastapi.responses import FileResponse, StreamingResponse
from pydantic import BaseModel, ConfigDict, Field

from service.api.access import needs
from service.api.http.form import FORM_TYPE, FormReader, boundary_of
from service.api.jobs import JobOut, started
from service.api.services import ServicesOf, api_router, services_of
from service.documents.recording import ChannelEntry, FileEntry, LeftOutEntry
from service.errors import NotAcceptableError
from service.operations.access.scopes import Scope
from service.operations.fields import AxisId, Label, RequestModel, RowId
from service.operations.recordings.recordings import RecordingView, contents_of
from service.operations.recordings.upload import LARGEST_MAP_BYTES
from service.store.tables import JobRow

router = api_router("recordings", reads_bodies=True)

HDF5_TYPE, CSV_TYPE = "application/x-hdf5", "text/csv"
#: So much of an upload is parsed and written in one step.
_AT_ONCE = 2**20


class RecordingOut(BaseModel):
    """An uploaded recording: what was found in it, and the job that takes its windows."""

    id: int
    axis: str
    name: Annotated[str, Field(description="of its first file")]
    sha256: Annotated[str, Field(description="of the bytes of its files, one after the other")]
    size_bytes: int
    state: Annotated[
        Literal["uploaded", "checked", "imported"],
        Field(
            description="uploaded: only looked into; checked: its windows are being taken; imported: they are stored"
        ),
    ]
    problems: Annotated[list[str], Field(description="what does not keep it from being taken")]
    map: Annotated[str | None, Field(description="channel map as it was sent; null: it is a session")]
    n_windows: int
    n_measurements: int
    files: list[FileEntry]
    channels: list[ChannelEntry]
    left_out: list[LeftOutEntry]
    job: JobOut
    created_at: datetime


class RecordingsOut(BaseModel):
    """Recordings, newest first; `next_cursor` fetches older ones."""

    recordings: list[RecordingOut]
    next_cursor: int | None


class RecordingsQuery(RequestModel):
    """Which recordings of an axis."""

    cursor: Annotated[int, Field(ge=1, lt=2**63)] | None = Field(default=None, description="next_cursor of a page")
    limit: Annotated[int, Field(ge=1, le=200)] = 50


class RemovedOut(BaseModel):
    """What became of a recording that was removed."""

    id: int
    name: str
    windows_stay: Annotated[int, Field(description="windows that were taken from it; they are stored as before")]
    detail: str


class UploadQuery(RequestModel):
    """What becomes of an upload."""

    check_only: bool = Field(
        default=False,
        description="keep it and say what is in it, as the result of a job of kind check; "
        "POST …/recordings/{recording}/import takes its windows",
    )


class ImportIn(RequestModel):
    """How a recording that was kept is taken."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"map": None}]})

    map: Annotated[str, Field(min_length=1, max_length=LARGEST_MAP_BYTES)] | None = Field(
        default=None, description="channel map (TOML) of raw files; null for a session, and for the map sent with them"
    )


class FileQuery(RequestModel):
    """Which file of a recording."""

    name: Label | None = Field(default=None, description="of a recording of several files: one of them")


class WindowsQuery(RequestModel):
    """Which windows of a measurement, and how."""

    format: Literal["hdf5", "csv"] | None = Field(default=None, description="otherwise as Accept says; hdf5")
    window: Annotated[int, Field(ge=1, le=10**6)] | None = Field(
        default=None, description="one window alone, counted from 1 in the order of GET …/measurements/{measurement}"
    )


_REQUEST = {
    "requestBody": {
        "required": True,
        "content": {
            FORM_TYPE: {
                "schema": {
                    "type": "object",
                    "required": ["file"],
                    "properties": {
                        "file": {
                            "type": "array",
                            "items": {"type": "string", "contentMediaType": "application/octet-stream"},
                            "description": "a session, or raw files that have one map",
                        },
                        "map": {
                            "type": "string",
                            "description": "channel map (TOML) of raw files, as a file or as text; none for a session",
                        },
                    },
                }
            }
        },
    }
}
_BINARY = {"schema": {"type": "string", "contentMediaType": "application/octet-stream"}}


def recording_out(view: RecordingView) -> RecordingOut:
    """Return a recording on the wire."""
    row, contents = view.row, contents_of(view.row)
    return RecordingOut(
        id=row.id, axis=row.axis_id, name=row.name, sha256=row.sha256, size_bytes=row.size_bytes, state=row.state,
        problems=row.problems, map=row.channel_map, n_windows=contents.n_windows,
        n_measurements=contents.n_measurements, files=contents.files, channels=contents.channels,
        left_out=contents.left_out, job=view.job, created_at=row.created_at,
    )  # fmt: skip


@router.post(
    "/axes/{axis}/recordings", status_code=202, openapi_extra=_REQUEST, dependencies=[needs(Scope.WINDOWS_WRITE)]
)
async def post_recording(
    axis: AxisId, request: Request, response: Response, query: Annotated[UploadQuery, Query()]
) -> JobOut:
    """Upload a session, or raw files with their channel map; its windows are taken as those of a replay, as a job.

    The form is written to the disk as it arrives. Every window is made and checked before this answers; what does not
    fit is refused, and then nothing is kept. With `check_only` all of it is kept, and the job only says what is in it:
    nothing has to be sent again. The job names the recording in its `arguments`.
    """
    return started(await receive(axis, request, check_only=query.check_only), response)


async def receive(axis: str, request: Request, *, check_only: bool) -> JobRow:
    """Write an upload to the disk as it arrives, and begin to take it, or only to look into it."""
    services = await services_of(request)
    boundary = boundary_of(request.headers.get("content-type"))
    declared = request.headers.get("content-length", "")
    recordings = services.recordings
    upload = await recordings.begin(axis, int(declared) if declared.isdecimal() else 0)
    try:
        form, waiting = FormReader(boundary, upload), bytearray()
        async for part in request.stream():
            waiting += part
            if len(waiting) >= _AT_ONCE:
                await recordings.write(upload, partial(form.feed, bytes(waiting)))
                waiting.clear()
        await recordings.write(upload, partial(form.feed, bytes(waiting)))
        form.end()
        return await (recordings.keep if check_only else recordings.take)(axis, upload)
    finally:
        await recordings.end(upload)


@router.post("/axes/{axis}/recordings/{recording}/import", status_code=202, dependencies=[needs(Scope.WINDOWS_WRITE)])
def import_recording(
    axis: AxisId, recording: RowId, body: ImportIn, response: Response, services: ServicesOf
) -> JobOut:
    """Take the windows of a recording that was uploaded with `check_only`, as a job.

    Every window is made and checked before this answers. What does not fit is refused, and the recording stays as it
    was, to be tried with another map.
    """
    kept = services.recordings.get(axis, recording).row
    return started(
        services.recordings.take_kept(axis, recording, kept.channel_map if body.map is None else body.map), response
    )


@router.get("/axes/{axis}/recordings", dependencies=[needs(Scope.TRENDS_READ)])
def list_recordings(axis: AxisId, query: Annotated[RecordingsQuery, Query()], services: ServicesOf) -> RecordingsOut:
    """List the uploaded recordings of an axis, newest first."""
    views = services.recordings.list(axis, query.cursor, query.limit)
    cursor = views[-1].row.id if len(views) == query.limit else None
    return RecordingsOut(recordings=[recording_out(view) for view in views], next_cursor=cursor)


@router.get("/axes/{axis}/recordings/{recording}", dependencies=[needs(Scope.TRENDS_READ)])
def get_recording(axis: AxisId, recording: RowId, services: ServicesOf) -> RecordingOut:
    """Return what was found in a recording, and how far its windows are taken."""
    return recording_out(services.recordings.get(axis, recording))


@router.delete("/axes/{axis}/recordings/{recording}")
def delete_recording(axis: AxisId, recording: RowId, services: ServicesOf) -> RemovedOut:
    """Remove the files of a recording. Windows that were taken from it stay, as all that was measured."""
    removed = services.recordings.remove(axis, recording)
    return RemovedOut(
        id=recording,
        name=removed.name,
        windows_stay=removed.windows_taken,
        detail=f"the files are removed; the {removed.windows_taken} windows that were taken from them stay",
    )


@router.get(
    "/axes/{axis}/recordings/{recording}/file",
    response_class=FileResponse,
    responses={200: {"description": "the file, byte by byte", "content": {"application/octet-stream": _BINARY}}},
    dependencies=[needs(Scope.TRENDS_READ)],
)
def get_recording_file(
    axis: AxisId, recording: RowId, query: Annotated[FileQuery, Query()], services: ServicesOf
) -> FileResponse:
    """Download an uploaded file as it was sent."""
    path = services.recordings.file(axis, recording, query.name)
    return FileResponse(path, media_type="application/octet-stream", filename=path.name)


@router.get(
    "/axes/{axis}/recordings/{recording}/session",
    response_class=FileResponse,
    responses={200: {"description": "a session file", "content": {HDF5_TYPE: _BINARY}}},
    dependencies=[needs(Scope.TRENDS_READ)],
)
def get_recording_session(axis: AxisId, recording: RowId, services: ServicesOf) -> FileResponse:
    """Download the session whose windows are taken: as uploaded, or as `preload import` makes it of the same files."""
    path = services.recordings.session_file(axis, recording)
    return FileResponse(path, media_type=HDF5_TYPE, filename=path.name)


@router.get(
    "/axes/{axis}/measurements/{measurement}/windows",
    tags=["windows"],
    response_class=StreamingResponse,
    responses={
        200: {
            "description": "a session file, or one row a sample",
            "content": {HDF5_TYPE: _BINARY, CSV_TYPE: {"schema": {"type": "string"}}},
        }
    },
    dependencies=[needs(Scope.TRENDS_READ)],
)
def get_windows(
    axis: AxisId, measurement: RowId, query: Annotated[WindowsQuery, Query()], request: Request, services: ServicesOf
) -> StreamingResponse:
    """Read the stored windows of a measurement back, refused ones included: samples as they are stored, bit by bit.

    A session can be posted to another service, `POST /v1/axes/{axis}/recordings`, without loss. In a table the digits
    of a number are those that its precision needs.
    """
    kind = query.format or _accepted(request.headers.get("accept", "*/*"))
    name = f"{axis}-{measurement}" + (f"-{query.window}" if query.window else "")
    stored = services.stored_windows
    read, media_type, ending = (
        (stored.table, CSV_TYPE, "csv") if kind == "csv" else (stored.session, HDF5_TYPE, "session.h5")
    )
    file = read(axis, measurement, query.window)
    headers = {"Content-Length": str(file.size_bytes), "Content-Disposition": f'attachment; filename="{name}.{ending}"'}
    return StreamingResponse(file.parts, media_type=media_type, headers=headers)


def _accepted(accept: str) -> Literal["hdf5", "csv"]:
    """Return the format that a reader wants most; raises NotAcceptableError if it wants neither."""
    wanted: list[tuple[float, Literal["hdf5", "csv"]]] = []
    for item in accept.split(","):
        kind, *parameters = (word.strip().lower() for word in item.split(";"))
        weight = next((word[2:] for word in parameters if word.startswith("q=")), "1")
        try:
            quality = float(weight)
        except ValueError:
            quality = 0.0
        if kind in (HDF5_TYPE, "application/*", "*/*", "application/octet-stream"):
            wanted.append((quality, "hdf5"))
        elif kind in (CSV_TYPE, "text/*"):
            wanted.append((quality, "csv"))
    quality, best = max(wanted, key=lambda pair: pair[0], default=(0.0, "hdf5"))
    if not quality > 0.0:
        raise NotAcceptableError(f"windows are read as {HDF5_TYPE} or {CSV_TYPE}; Accept names {accept[:100]!r}")
    return best
