"""Copy a data folder while a service works on it, as the database held it at one moment, and put a copy back.

The database is copied first, by SQLite itself; the waveforms it names were on disk before their rows, and what a row
names never changes. ``backup.json`` says what the copy holds, with a hash of every file.

A copy goes back into an empty data folder alone, after it was verified.
"""

import hashlib
import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from service.clock import now
from service.errors import DataFolderError, StorageError
from service.store.recordings import UNDER_WAY
from service.store.safekeeping.private import private_folder
from service.store.safekeeping.purge_lock import no_purge
from service.store.safekeeping.verification import damaged_windows
from service.store.tables import VERSION_TABLE
from service.store.waveform_files import sync_folder
from service.store.waveforms import WaveformPlace

DATABASE, MANIFEST = "preload.db", "backup.json"
COUNTED = ("axes", "calibrations", "measurements", "windows", "alarms", "jobs")

#: Told each file that is done.
Done = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Manifest:
    """What a backup holds."""

    made_at: str  # RFC 3339
    schema: str  # version of the database
    rows: dict[str, int]  # by table
    files: dict[str, str]  # SHA-256 by path
    damaged: tuple[str, ...] = ()  # windows that could not be read already when it was made, a sentence each


_MANIFEST = TypeAdapter(Manifest)


def back_up(data_dir: Path, folder: Path, done: Done) -> Manifest:
    """Copy a data folder into a new folder, verify the copy, and return what it holds.

    Raises DataFolderError if there is no database to copy, or something in the way; StorageError if the disk does not
    take the copy: a folder without its manifest is no backup.
    """
    source = data_dir / DATABASE
    if not source.is_file():
        raise DataFolderError(
            f"expected an embedded database {source}; got none (one on PostgreSQL: pg_dump, then raw/)"
        )
    require_empty(folder)
    with no_purge(data_dir):
        return _backed_up(data_dir, source, folder, done)


def _backed_up(data_dir: Path, source: Path, folder: Path, done: Done) -> Manifest:
    private_folder(folder)
    try:
        _copy_database(source, folder / DATABASE)
        done(DATABASE)
        for name in (*_waveform_files(folder / DATABASE), *_reports(data_dir), *_recordings(data_dir)):
            if (data_dir / name).is_file():  # one that is not there is told by the windows that it lacks
                copy_file(data_dir / name, folder / name)
                done(name)
        manifest = _describe(folder)
        (folder / MANIFEST).write_bytes(_MANIFEST.dump_json(manifest, indent=1))
    except (OSError, sqlite3.Error) as error:
        raise StorageError(f"the backup in {folder} is not complete, remove it: {error}") from error
    return manifest


def read_manifest(folder: Path) -> Manifest:
    """Return what a backup says that it holds; raises DataFolderError if this is none, or one that broke off."""
    try:
        return _MANIFEST.validate_json((folder / MANIFEST).read_bytes())
    except OSError as error:
        raise DataFolderError(
            f"{folder} is no complete backup: {MANIFEST} cannot be read ({error.strerror})"
        ) from error
    except ValidationError as error:
        raise DataFolderError(f"{folder / MANIFEST} is damaged: {error.errors()[0]['msg']}") from error


def damages(folder: Path, manifest: Manifest) -> Iterator[str]:
    """Yield what is wrong with a copy, a sentence each that names it; what was so when it was made is left out."""
    for name, sha256 in manifest.files.items():
        if not (folder / name).is_file():
            yield f"{name} is missing"
        elif _sha256(folder / name) != sha256:
            yield f"{name} is not what was backed up"
    try:
        held = _describe(folder)
    except (OSError, sqlite3.Error) as error:
        yield f"{DATABASE} cannot be read: {error}"
        return
    if (held.schema, held.rows) != (manifest.schema, manifest.rows):
        yield f"{DATABASE} holds other rows than were backed up"
    yield from (sentence for sentence in held.damaged if sentence not in manifest.damaged)


def copy_file(source: Path, copy: Path) -> None:
    """Copy a file durably; it has its name when it is whole."""
    copy.parent.mkdir(parents=True, exist_ok=True)
    part = copy.with_name(copy.name + ".part")
    with source.open("rb") as read, part.open("wb") as written:
        shutil.copyfileobj(read, written)
        written.flush()
        os.fsync(written.fileno())
    part.replace(copy)
    sync_folder(copy.parent)


def require_empty(folder: Path) -> None:
    """Refuse a folder that holds something; raises DataFolderError."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise DataFolderError(f"expected a new or empty folder; got {folder}, which holds something")


def _copy_database(source: Path, copy: Path) -> None:
    """Copy what is committed at one moment; writers go on meanwhile."""
    with (
        closing(sqlite3.connect(f"{source.absolute().as_uri()}?mode=ro", uri=True)) as read,
        closing(sqlite3.connect(copy)) as written,
    ):
        read.backup(written)
        written.execute("PRAGMA journal_mode=DELETE")  # one file, whole by itself


def _describe(folder: Path) -> Manifest:
    """Read a copy from end to end."""
    with closing(_opened(folder / DATABASE)) as database:
        (verdict,) = database.execute("PRAGMA integrity_check(1)").fetchone()
        if verdict != "ok":
            raise sqlite3.DatabaseError(verdict)
        (schema,) = database.execute(f"SELECT version_num FROM {VERSION_TABLE}").fetchone()  # noqa: S608
        rows = {table: database.execute(f"SELECT count(*) FROM {table}").fetchone()[0] for table in COUNTED}  # noqa: S608
        places = (
            WaveformPlace(*row)
            for row in database.execute(
                "SELECT file_path, offset_in_file, index_in_frame, content_sha256 FROM windows "
                "WHERE file_path <> '' ORDER BY file_path, offset_in_file, index_in_frame"
            )
        )
        damaged = tuple(damage.reason for damage in damaged_windows(folder, places))
    names = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    files = {name: _sha256(folder / name) for name in names if name != MANIFEST}
    return Manifest(now().isoformat(), schema, rows, files, damaged)


def _waveform_files(database: Path) -> list[str]:
    with closing(_opened(database)) as connection:
        return [
            path
            for (path,) in connection.execute(
                "SELECT DISTINCT file_path FROM windows WHERE file_path <> '' ORDER BY file_path"
            )
        ]


def _reports(data_dir: Path) -> list[str]:
    return sorted(str(path.relative_to(data_dir)) for path in (data_dir / "reports").glob("*.html"))


def _recordings(data_dir: Path) -> list[str]:
    """Return the files of recordings; of those that arrive or leave at this moment no row of the copy tells."""
    folders = [path for path in (data_dir / "recordings").glob("*") if path.suffix not in UNDER_WAY]
    files = (path for folder in folders for path in folder.rglob("*") if path.is_file())
    return sorted(str(path.relative_to(data_dir)) for path in files)


def _opened(database: Path) -> sqlite3.Connection:
    # immutable: nobody writes into a copy, and nothing is to be written beside it
    return sqlite3.connect(f"{database.absolute().as_uri()}?mode=ro&immutable=1", uri=True)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def restore(folder: Path, data_dir: Path, done: Done, *, despite_damage: bool = False) -> tuple[Manifest, list[str]]:
    """Copy a backup into an empty data folder; return what it holds, and what is wrong with it, a sentence each.

    Raises DataFolderError if it is damaged, unless it is wanted all the same, or if the data folder is not empty; then
    nothing is written. The database is put in place last: a service does not start on what broke off before.
    """
    manifest = read_manifest(folder)
    require_empty(data_dir)
    wrong = list(damages(folder, manifest))
    if wrong and not despite_damage:
        more = f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""
        raise DataFolderError(f"the backup {folder} is damaged: {wrong[0]}{more}; nothing was restored")
    private_folder(data_dir)
    try:
        for name in sorted(manifest.files, key=lambda name: name == DATABASE):
            if (folder / name).is_file():
                copy_file(folder / name, data_dir / name)
                done(name)
    except OSError as error:
        raise StorageError(f"the data folder {data_dir} is not complete, remove it: {error}") from error
    return manifest, wrong
