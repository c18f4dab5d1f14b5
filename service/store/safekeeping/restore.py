"""Put a backup back into an empty data folder, after it was verified."""

from pathlib import Path

from service.errors import DataFolderError, StorageError
from service.store.safekeeping.backup import DATABASE, Done, Manifest, copy_file, damages, read_manifest, require_empty


def restore(folder: Path, data_dir: Path, done: Done, *, despite_damage: bool = False) -> tuple[Manifest, list[str]]:
    """Copy a backup into an empty data folder; return what it holds, and what is wrong with it, a sentence each.

    Raises DataFolderError if it is damaged, unless it is wanted all the same, or if the data folder is not empty; then
    nothing is written. The database is put in place last: a service does not start on what broke off before.
    """
    manifest = read_manifest(folder)
    require_empty(data_dir)
    found = list(damages(folder, manifest))
    if found and not despite_damage:
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        raise DataFolderError(f"the backup {folder} is damaged: {found[0]}{more}; nothing was restored")
    try:
        for name in sorted(manifest.files, key=lambda name: name == DATABASE):
            if (folder / name).is_file():
                copy_file(folder / name, data_dir / name)
                done(name)
    except OSError as error:
        raise StorageError(f"the data folder {data_dir} is not complete, remove it: {error}") from error
    return manifest, found
