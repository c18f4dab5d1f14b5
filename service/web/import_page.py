"""``/axes/{axis}/import``: drop a file, see at once what is in it and what is missing, take its windows as a job."""

from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from functools import partial
from typing import Final

from fastapi import APIRouter, Request, Response
from fastapi.responses import RedirectResponse
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import FormData

from monitor_core.errors import MonitorCoreError
from service.api.access import needs
from service.api.jobs import JobOut
from service.api.recordings import receive, recording_out
from service.api.services import Services, ServicesOf
from service.documents.map_form import FieldTable, MapField, filled_files, filled_map
from service.errors import ConflictError, ServiceError, status_of
from service.operations.access.scopes import Scope
from service.operations.fields import AxisId, RowId
from service.operations.recordings.recordings import ImportArguments, RecordingView
from service.operations.recordings.upload import MOST_FILES
from service.web.forms import FINAL, moment_of, number_of
from service.web.site import Page, PageOf, done
from service.web.words import CHOICES

router = APIRouter(include_in_schema=False)

_LISTED: Final = 20
#: A few of each file, and those of the map.
_MOST_FIELDS: Final = 10 * MOST_FILES


class FoundChannel(BaseModel):
    """A channel of a file."""

    name: str
    shape: list[int]
    unit: str | None
    sample_rate_hz: float | None
    looks_like: str | None
    remarks: list[str]


class Contents(BaseModel):
    """What is in a session; of raw files the channels say it, and what those without an acceleration show."""

    windows: int | None = None
    measurements: int = 0
    positions_mm: list[float] = []
    preloads_n: list[float] = []
    first_window_at: datetime | None = None
    last_window_at: datetime | None = None
    what_it_shows: str = ""


class FoundFile(BaseModel):
    """What one of several files seems to be measured under."""

    name: str
    preload_n: float | None
    payload_kg: float | None
    position_mm: float | None
    started_at: str | None
    states_start: bool

    def proposed(self, entry: str) -> str:
        """Return what is proposed for an entry, as it stands in a field."""
        value = getattr(self, entry)
        return "" if value is None else value if isinstance(value, str) else f"{value:.10g}"


class Found(BaseModel):
    """What the job that looks into files says, as far as the page shows it."""

    kind: str
    valid: bool
    problems: list[str]
    doubts: list[str]
    contents: Contents
    channels: list[FoundChannel]
    lacks_for_calibration: str | None
    map: str | None
    map_form: list[FieldTable] | None = None
    files: list[FoundFile] = []

    @property
    def columns(self) -> list[str]:
        """What is asked of each of several files: the place, where no channel measures it, too."""
        measured = any(table.name == "position" for table in self.map_form or [])
        return ["preload_n", "payload_kg", *([] if measured else ["position_mm"]), "started_at"] if self.files else []

    @property
    def tables(self) -> list[FieldTable]:
        """The fields of the map that all files have in common."""
        return [
            replace(table, fields=[self._in_common(field) for field in table.fields if not self._is_of_each(field.key)])
            for table in self.map_form or []
        ]

    def _in_common(self, field: MapField) -> MapField:
        """Return a field of all files: one start of all is not asked for where each has its own."""
        return replace(field, required=False) if self.files and field.key == "window.started_at" else field

    def _is_of_each(self, key: str) -> bool:
        of_each = {f"window.{entry}" for entry in (*self.columns, "measurement") if entry != "started_at"}
        return bool(self.files) and key in of_each


@router.get("/axes/{axis}/import", dependencies=[needs(Scope.TRENDS_READ)])
def import_page(axis: AxisId, page: PageOf, on: ServicesOf) -> Response:
    """Show where a file is dropped, and the recordings that the axis has."""
    return _upload_page(page, axis, on)


@router.post("/axes/{axis}/import", dependencies=[needs(Scope.WINDOWS_WRITE)])
async def upload(axis: AxisId, page: PageOf, request: Request, on: ServicesOf) -> Response:
    """Take an upload as it arrives, and lead on to what is in it."""
    try:
        job = await receive(axis, request, check_only=True)
    except (ServiceError, MonitorCoreError) as error:
        if status_of(error)[0] == 404:
            raise
        refused = partial(_upload_page, page, axis, on, refusal=str(error), status=status_of(error)[0])
        return await run_in_threadpool(refused)
    return RedirectResponse(
        f"/axes/{axis}/import/{ImportArguments.model_validate(job.arguments).recording}", status_code=303
    )


@router.get("/axes/{axis}/import/{recording}", dependencies=[needs(Scope.TRENDS_READ)])
def recording_page(axis: AxisId, recording: RowId, page: PageOf, on: ServicesOf) -> Response:
    """Show what is in a recording, the map of its channels to be filled in, and how far its windows are taken."""
    return _recording_page(page, on, on.recordings.get(axis, recording))


@router.post("/axes/{axis}/import/{recording}", dependencies=[needs(Scope.WINDOWS_WRITE)])
async def take(axis: AxisId, recording: RowId, request: Request, page: PageOf, on: ServicesOf) -> Response:
    """Take the windows of a recording; what does not fit is said, and all that was typed stays."""
    form = await request.form(max_fields=_MOST_FIELDS)
    return await run_in_threadpool(_take, axis, recording, form, page, on)


def _take(axis: str, recording: int, form: FormData, page: Page, on: Services) -> Response:
    view = on.recordings.get(axis, recording)
    found, typed = _found(view), {key: value for key, value in form.items() if isinstance(value, str)}
    map_text = view.row.channel_map
    if found is not None and found.map_form is not None and map_text is None:
        map_text = filled_map(found.tables, typed)
    try:
        if found is not None and found.files and view.row.channel_map is None:
            map_text = f"{map_text}{_of_files(found, typed)}"
        on.recordings.take_kept(axis, recording, map_text)
    except ConflictError:
        raise
    except (ServiceError, MonitorCoreError) as error:
        return _recording_page(page, on, view, refusal=str(error), typed=typed, status=status_of(error)[0])
    return done(f"/axes/{axis}/import/{recording}", "import-begun")


def _of_files(found: Found, typed: Mapping[str, str]) -> str:
    """Return what was typed of each file, as the map says it; raises InvalidRequestError where it cannot be read."""
    values: dict[str, dict[str, str]] = {}
    for number, file in enumerate(found.files):
        own = {entry: typed.get(f"files.{number}.{entry}", "").strip() for entry in found.columns}
        at = moment_of(own.pop("started_at"), typed.get("zone", "UTC"))
        numbers = {entry: number_of(text, f"{file.name}, {entry}") for entry, text in own.items()}
        values[file.name] = {entry: "" if value is None else repr(value) for entry, value in numbers.items()}
        values[file.name]["started_at"] = "" if at is None else at.isoformat()
    return filled_files([file.name for file in found.files], values)


def _upload_page(page: Page, axis: str, on: Services, *, refusal: str = "", status: int = 200) -> Response:
    views = on.recordings.list(axis, None, _LISTED)
    return page.show(
        "import.html",
        status=status,
        axis=on.axes.get(axis),
        recordings=[recording_out(view) for view in views],
        refusal=refusal,
    )


@router.post("/axes/{axis}/import/{recording}/remove", dependencies=[needs(Scope.ADMIN), FINAL])
def remove(axis: AxisId, recording: RowId, on: ServicesOf) -> Response:
    """Remove the files of a recording; the windows that were taken from it stay."""
    on.recordings.remove(axis, recording)
    return done(f"/axes/{axis}/import", "removed")


def _recording_page(
    page: Page, on: Services, view: RecordingView, *, refusal: str = "", typed: Mapping[str, str] | None = None,
    status: int = 200
) -> Response:  # fmt: skip
    found = _found(view)
    tables = found.tables if found is not None and view.row.channel_map is None else None
    return page.show(
        "recording.html",
        status=status,
        axis=on.axes.get(view.row.axis_id),
        recording=recording_out(view),
        job=JobOut.model_validate(view.job),
        found=found,
        tables=tables or [],
        choices=CHOICES,
        typed=typed or {},
        refusal=refusal,
    )


def _found(view: RecordingView) -> Found | None:
    """Return what is in a recording whose files were looked into; None while they are, and once it is taken."""
    is_known = view.row.state == "uploaded" and view.job.status == "done"
    found = Found.model_validate(view.job.result) if is_known else None
    if found is not None and found.map is not None and found.map_form is None:
        earlier = "an earlier version looked into this file, and proposed no form: give the file once more"
        return found.model_copy(update={"valid": False, "problems": [earlier]})
    return found
