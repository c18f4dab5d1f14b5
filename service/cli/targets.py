"""Check what a command is to write before it works: a refusal after an hour's search comes an hour too late."""

import tempfile
from collections.abc import Iterable
from pathlib import Path

import click

#: What is written, and the endings of its name.
ENDINGS = {
    "session file": (".h5", ".hdf5"),
    "calibration": (".json",),
    "model file": (".toml",),
    "table": (".csv",),
    "channel map": (".toml",),
    "page": (".html", ".htm"),
    "transfer matrix": (".csv", ".svg"),
    "state space": (".mat",),
    "picture": (".svg",),
    "channels of a motion": (".csv", ".svg"),
}


def require_target(
    path: Path | None, kind: str, *, inputs: Iterable[Path] = (), ending_needed: bool = False, replaces: bool = True
) -> None:
    """Refuse a file that could not be written in the end; what is there stays as it is.

    ``kind``: one of :data:`ENDINGS`; ``inputs``: files that are read, none of which may be replaced;
    ``ending_needed``: whether readers know it by its ending. An ending that says something else is a slip in any case;
    ``replaces``: whether a file that is there is written over.
    ``click.UsageError`` says what is wrong.
    """
    if path is None:
        return
    ending, own = path.suffix.lower(), ENDINGS[kind]
    if ending not in own and (ending_needed or any(ending in others for others in ENDINGS.values())):
        raise click.UsageError(f"a {kind} ends in {' or '.join(own)}; got {path.name}")
    if not path.parent.is_dir():
        wrong = "is no folder" if path.parent.exists() else "does not exist"
        raise click.UsageError(f"cannot write {path.name}: folder {path.parent} {wrong}")
    if path.is_dir():
        raise click.UsageError(f"cannot write {path.name}: it is a folder; a file is written here")
    if path.exists() and any(path.samefile(read) for read in inputs if read.exists()):
        raise click.UsageError(f"cannot write {path.name}: it is read by this command, and would be lost")
    if path.exists() and not replaces:
        raise click.UsageError(
            f"cannot write {path.name}: it is already there, perhaps filled in; give another name or remove it"
        )
    try:
        if path.exists():
            path.open("ab").close()
        else:
            _try_new(path)
    except OSError as error:
        raise click.UsageError(f"cannot write {path.name}: {error.strerror or error}") from error


def require_target_folder(path: Path | None) -> None:
    """Refuse a folder that could not be made, or written into, in the end; none is made yet."""
    if path is None:
        return
    try:
        there = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
        if not there.is_dir():
            raise click.UsageError(f"cannot write into {path}: {there} is no folder")
        tempfile.TemporaryFile(dir=there).close()
    except OSError as error:
        raise click.UsageError(f"cannot write into {path}: {error.strerror or error}") from error


def _try_new(path: Path) -> None:
    """Make the file and take it away again: rights, a full disk and names that are too long show in no other way."""
    path.open("xb").close()
    path.unlink()
