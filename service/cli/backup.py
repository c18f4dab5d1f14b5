"""``preload backup FOLDER``: a verified copy of a data folder, while the service runs.

``preload restore FOLDER``: a backup becomes a data folder again.
"""

from pathlib import Path

import click
from pydantic import TypeAdapter

from service.cli.options import data_dir_option, json_option
from service.cli.output import print_json, print_line, progress_bar
from service.errors import DataFolderError
from service.settings import Settings
from service.store.safekeeping.backup import Manifest, back_up, restore as restore_folder


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False, exists=True))
@data_dir_option("Where to, new or empty")
@click.option("--despite-damage", is_flag=True, help="Restore what there is of a damaged backup.")
@json_option
@click.pass_context
def restore(context: click.Context, folder: Path, data_dir: Path | None, despite_damage: bool, as_json: bool) -> None:
    """Verify a backup and copy it into a new or empty data folder; a service can start there then."""
    target = embedded_folder(data_dir)
    with progress_bar() as progress:
        task = progress.add_task("files copied", total=None)
        manifest, damaged = restore_folder(
            folder, target, lambda _: progress.advance(task), despite_damage=despite_damage
        )
    report(target, manifest, damaged, as_json=as_json)
    if damaged:
        context.exit(1)


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@data_dir_option("What to copy")
@json_option
@click.pass_context
def backup(context: click.Context, folder: Path, data_dir: Path | None, as_json: bool) -> None:
    """Copy database, waveforms and reports into a new folder while the service runs, and verify the copy."""
    with progress_bar() as progress:
        task = progress.add_task("files copied", total=None)
        manifest = back_up(embedded_folder(data_dir), folder, lambda _: progress.advance(task))
    report(folder, manifest, manifest.damaged, as_json=as_json)
    if manifest.damaged:
        context.exit(1)


def embedded_folder(stated: Path | None) -> Path:
    """Return the data folder of the settings, or the stated one; refuse where the database is elsewhere."""
    settings = Settings()
    if settings.database_url is not None:
        raise DataFolderError(
            "PRELOAD_DATABASE_URL is set, and only the database in the data folder is copied here: take the tools of "
            "that database (pg_dump), then raw/ and reports/"
        )
    return stated or settings.data_dir


def report(folder: Path, manifest: Manifest, damaged: tuple[str, ...] | list[str], *, as_json: bool) -> None:
    """Print what is in a folder now, and each damage on standard error."""
    if as_json:
        print_json(TypeAdapter(Manifest).dump_python(manifest, mode="json"))
    else:
        rows = ", ".join(f"{count} {table}" for table, count in manifest.rows.items())
        print_line(f"{folder}: {rows}; {len(manifest.files)} files, verified")
    for sentence in damaged:
        print_line(f"preload: damaged: {sentence}", err=True)
